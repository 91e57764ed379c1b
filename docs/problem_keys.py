"""Write the reference of the problem file, ``problem-keys*.md``, from the schema: ``python docs/problem_keys.py``."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from gaitopt import problem_schema
from gaitopt.model.units import LARGEST, SMALLEST

MODES = ("stick", "slip_forward", "slip_backward", "flight")
LIMITS = ("minimum", "maximum")
PAGE = Path(__file__).with_name("problem-keys.md")
HEAD = """# Keys of the problem file

A dot leads into a mapping: `gait.phases` is the key `phases` of the mapping `gait`. [Walkers](problem-keys-walker.md)
and [control laws](problem-keys-control.md) have their own pages. `gaitopt schema > gaitopt.schema.json` writes the
schema from which `python docs/problem_keys.py` generates these pages. An editor completes keys and shows their units if
the first line of the file is

    # yaml-language-server: $schema=gaitopt.schema.json

| type | value |
|---|---|
| number | number in the unit of the row |
| angle | number in rad, or a text such as `1 deg` |
| unknown | `{{free: [lo, hi], guess: value}}`: a design finds the value between these bounds |
| mode | {modes}; or [a mapping](problem-file.md) for stops, switches or several contacts |
| list, mapping | `[a, b]`, `{{key: value}}`; *numbers by name* maps names, such as those of motors, to numbers |

Values outside the range are errors. Unusual values only trigger a warning on stderr. Ranges may be in natural units of
the walker: l is its leg length (radius), m its total mass, g gravity. All numbers are at most 1e30 in size, and numbers
that must be more than 0 are at least 1e-30. A key that is neither required nor has a default may be left out.
"""
MORE = """# Keys of the problem file: {}

{} [Keys of the problem file](problem-keys.md) explains types and ranges.
"""
HEADS = {
    PAGE: HEAD.format(modes=", ".join(f"`{mode}`" for mode in MODES)),
    PAGE.with_name("problem-keys-walker.md"): MORE.format("walkers", "`walker.model` selects one of these walkers."),
    PAGE.with_name("problem-keys-control.md"): MORE.format("control", "`control.type` selects one of these laws."),
}
TOP = "top level"
UNIT = re.compile(r" \[((?:(?:, or |[ /])?(?:kg|rad|[NJms1])(?:\^\d)?)+)\]")
"""A unit in a description."""
RANGE = re.compile(r"(usually )?(from|at most|at least) [-+.\de]+ ?.*")
"""A part of a description that is a range."""


def pages() -> dict[Path, str]:
    """The pages as Markdown; places with the same keys share a table."""
    sections = dict[tuple[str, str], list[Mapping[str, Any]]]()
    for title, variant in _mappings_below(problem_schema(), ""):
        sections.setdefault((title, variant.get("description", "")), []).append(variant)
    tables = dict[tuple[Path, str], list[str]]()
    for (title, about), variants in sections.items():
        place = next((path for path in HEADS if title.startswith(path.stem.removeprefix("problem-keys-"))), PAGE)
        words = [] if title == TOP or not about else [f"{_sentence(about.replace('``', '`'))}\n"]
        tables.setdefault((place, "\n".join([*words, *_table(title, variants), ""])), []).append(title)
    texts: dict[Path, list[str]] = {path: [head] for path, head in HEADS.items()}
    for (place, table), titles in tables.items():
        heading = titles[0] if titles == [TOP] else ", ".join(f"`{title}`" for title in dict.fromkeys(titles))
        texts[place] += [f"## {heading}\n", table]
    return {path: "\n".join(lines) for path, lines in texts.items()}


def _mappings_below(schema: Mapping[str, Any], path: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """A mapping and those in it, each with its path; those that only restrict others have no types."""
    if any(_kind(value) != "any" for value in schema["properties"].values()):
        yield path or TOP, schema
    for key, value in schema["properties"].items():
        variants = [] if _kind(value) in ("mode", "list of modes") else _mappings(value)
        for variant in variants:
            others = {name for other in variants if other is not variant for name in other.get("required", ())}
            yield from _mappings_below(variant, _named(f"{path}.{key}" if path else key, variant, others))


def _table(title: str, variants: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The keys of a mapping, whose variants belong to different walkers; keys that mean the same share a row."""
    rows = dict[tuple[str, ...], dict[str, None]]()
    for key, value in ((key, value) for variant in variants for key, value in variant["properties"].items()):
        required = all(key in variant.get("required", ()) for variant in variants)
        default = "" if value.get("default") in (None, "", {}) else f"`{_yaml(value['default'])}`"
        about, *rest = value.get("description", "").split("; ")
        stated = [part for part in rest if RANGE.fullmatch(part)]
        meaning = "; ".join([about, *(part for part in rest if part not in stated)])
        units = UNIT.findall(meaning)
        if len(units) == 1:
            meaning = UNIT.sub("", meaning)
        if "const" in value and key == "type":
            meaning, units = "selects this control law", []
        unit = units[0] if len(units) == 1 else ""
        cells = _kind(value), unit, _range(value, stated), "required" if required else default, _sentence(meaning)
        rows.setdefault(tuple(map(_cell, cells)), {})[f"`{key}`"] = None
    if len(variants) > 1 and any(
        variant["properties"].keys() != variants[0]["properties"].keys() for variant in variants
    ):
        yield "The keys depend on the walker.\n"
    yield "| key | type | unit | range | default | meaning |\n|---|---|---|---|---|---|"
    yield from (f"| {', '.join(keys)} | {' | '.join(cells)} |" for cells, keys in rows.items())


def _yaml(value: Any) -> str:
    return str(value).replace("'", "")


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:].rstrip('.')}." if words else ""


def _named(path: str, variant: Mapping[str, Any], others: Collection[str]) -> str:
    """Path of a mapping, with the key that selects it among its alternatives, which require the keys ``others``."""
    for key in ("model", "type", "phases"):
        choice = variant["properties"].get(key, {})
        if "const" in choice:
            return f"{path} {{{key}: {choice['const']}}}"
    selecting = next((key for key in variant.get("required", ()) if key not in others), None)
    return path if selecting is None or not others else f"{path} {{{selecting}: ...}}"


def _mappings(value: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The mappings with named keys that a value may be; unknowns are explained at the head of the page."""
    mappings = [value] if value.get("properties") and not _is_bounds(value) else []
    for variant in (*value.get("oneOf", ()), *value.get("anyOf", ())):
        mappings += _mappings(variant) if variant.get("description") != "an unknown" else []
    return mappings


def _is_bounds(value: Mapping[str, Any]) -> bool:
    return set(value.get("properties", ())) == {"min", "max"}


def _kind(value: Mapping[str, Any]) -> str:
    """The type of a value, as the head of the page explains it."""
    if _is_bounds(value):
        return "`{min: a, max: b}`"
    if "const" in value:
        return f"`{value['const']}`"
    variants = (*value.get("oneOf", ()), *value.get("anyOf", ()))
    if any(variant.get("enum") == [*MODES] for variant in variants):
        return "mode"
    if "enum" in value:
        return ", ".join(f"`{choice}`" for choice in value["enum"])
    if value.get("properties"):
        return "mapping"
    kinds = dict.fromkeys("unknown" if v.get("description") == "an unknown" else _kind(v) for v in variants)
    if "angle" in kinds:  # which is a number too
        kinds.pop("number", None)
    words = [kind for kind in kinds if kind not in ("any", "null")]
    if words:
        return " or ".join(words)
    kind = value.get("type", "any")
    if kind == "array":
        entries = [_kind(entry) for entry in value.get("prefixItems", [value.get("items", {})])]
        return f"list of {f'{len(entries)} ' if 'prefixItems' in value else ''}{_plural(entries[0])}"
    if kind == "string":
        return "angle" if "deg" in value.get("pattern", "") else "text"
    if kind == "object":
        entry = _kind(value.get("additionalProperties") or {})
        return "mapping" if entry == "any" or "mapping" in entry else f"{_plural(entry)} by name"
    return str(kind)


def _plural(kind: str) -> str:
    """``numbers or unknowns`` for ``number or unknown``."""
    if kind.startswith(("list", "`")) or kind.endswith("by name"):
        return kind.replace("list of", "lists of", 1)
    return " or ".join(f"{word}s" for word in kind.split(" or "))


def _range(value: Mapping[str, Any], stated: Sequence[str]) -> str:
    """The range of a number: that of the description in natural units, or the limits of the schema."""
    limits, inner = dict[str, float](), [value]
    for entry in inner:  # grows by the alternatives, and the values of lists and mappings
        limits |= {key: entry[key] for key in LIMITS if abs(entry.get(key, LARGEST)) != LARGEST}
        below = (entry.get(key) for key in ("items", "additionalProperties"))
        inner += [*entry.get("anyOf", ()), *(found for found in below if isinstance(found, dict))]
    least, most = (limits.get(key) for key in LIMITS)
    possible = [part.removeprefix("from ") for part in stated if not part.startswith("usually")]
    if least == SMALLEST:
        upper = possible[0].removeprefix("0 to ") if possible else "" if most is None else f"{most:.6g}"
        words = f"more than 0{f', at most {upper}' if upper else ''}"
    elif possible:
        words = possible[0]
    elif least is not None and most is not None:
        words = f"{least:.6g} to {most:.6g}"
    else:
        words = f"at least {least:.6g}" if least is not None else "" if most is None else f"at most {most:.6g}"
    usual = [part.replace("usually from", "usually") for part in stated if part.startswith("usually")]
    return "; ".join(filter(None, (words, *usual)))


def _cell(text: str) -> str:
    return str(text).replace("|", "\\|")


if __name__ == "__main__":
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")
