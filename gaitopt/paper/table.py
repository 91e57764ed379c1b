"""The table of truth: printed and computed numbers side by side, as Markdown and JSON."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gaitopt.paper.archive import Archive
from gaitopt.paper.numbers import NUMBERS, Printed
from gaitopt.paper.reasons import EXPLANATIONS, Reason
from gaitopt.paper.sentences import SENTENCES, Sentence

SLACK = 1e-9
"""A number half a digit away agrees in spite of rounding."""
DIGITS = 5
"""Significant digits in the Markdown table; the JSON has all of them."""
INTRODUCTION = """# Gamus & Or (2013): every printed number, computed again

Written by `gaitopt reproduce gamus-or-2013`. *agrees* means to the last printed digit. A reason stands where a number
differs, or where the paper had to be read differently for it to agree; the list of reasons is below. Nothing was fitted
to a printed digit.
"""


def row(archive: Archive, number: Printed) -> dict[str, Any]:
    """One number as a JSON object."""
    computed = number.compute(archive)
    difference = computed - float(number.printed)
    return {
        "where": number.where,
        "quantity": number.quantity,
        "printed": number.printed,
        "computed": computed,
        "difference": difference,
        "agrees": abs(difference) <= number.half_digit + SLACK,
        "reason": None if number.reason is None else str(number.reason),
        "otherwise": {words: compute(archive) for words, compute in number.otherwise.items()},
    }


def statement(archive: Archive, sentence: Sentence) -> dict[str, Any]:
    """One sentence as a JSON object."""
    return {"where": sentence.where, "sentence": sentence.words, "holds": sentence.holds(archive)}


def record(archive: Archive) -> dict[str, Any]:
    """The whole table as one JSON object."""
    return {
        "numbers": [row(archive, number) for number in NUMBERS],
        "sentences": [statement(archive, sentence) for sentence in SENTENCES],
        "reasons": {str(reason): words for reason, words in EXPLANATIONS.items()},
    }


def markdown(table: Mapping[str, Any]) -> str:
    """The same for people."""
    reasons = [f"- **{reason}**: {EXPLANATIONS[reason]}" for reason in Reason]
    sections = (INTRODUCTION, *_numbers(table["numbers"]), "", "## Reasons", "", *reasons, "")
    return "\n".join([*sections, "## Sentences without a number", "", *_sentences(table["sentences"]), ""])


def _numbers(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield _line("where", "quantity", "printed", "computed", "difference", "agrees", "reason", "otherwise")
    yield "|---|---|---:|---:|---:|---|---|---|"
    for entry in rows:
        yield _line(
            entry["where"],
            entry["quantity"].replace("|", "\\|"),
            entry["printed"],
            f"{entry['computed']:.{DIGITS}g}",
            f"{entry['difference']:+.2g}",
            "yes" if entry["agrees"] else "no",
            entry["reason"] or "",
            ", ".join(f"{words}: {value:.{DIGITS}g}" for words, value in entry["otherwise"].items()),
        )


def _sentences(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield _line("where", "the paper says", "holds")
    yield "|---|---|---|"
    for entry in rows:
        yield _line(entry["where"], entry["sentence"], "yes" if entry["holds"] else "no")


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"
