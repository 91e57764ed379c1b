"""Write the reference of the problem file, ``problem-keys*.md``, from the schema: ``python docs/problem_keys.py``."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from gaitopt import problem_schema
from gaitopt.model.units import LARGEST, SMALLEST

PAGE = Path(__file__).with_name("problem-keys.md")
HEAD = """# Keys of the problem file

A dot leads into a mapping: `gait.phases` is the key `phases` of the mapping `gait`. [Walkers](problem-keys-walker.md)
and [control laws](problem-keys-control.md) have their own pages. *or an unknown* means that the value may be `{free:
[lo, hi], guess: value}`: a design then finds it. An angle is a number in rad, or a text such as `1 deg`.

Values outside a range are errors; unusual values only trigger a warning on stderr. Ranges in natural units refer to the
walker of the file: l is its leg length (radius), m its total mass, g gravity. Numbers are at most 1e30 in size, and
numbers that must be more than 0 are at least 1e-30.

Point your editor at the schema (`gaitopt schema > gaitopt.schema.json`), and with this first line in the file it
completes keys and shows units as you type:

    # yaml-language-server: $schema=gaitopt.schema.json

`python docs/problem_keys.py` writes these pages from the schema.
"""
MORE = """# Keys of the problem file: {}

{} See [the other keys](problem-keys.md) for how to read the tables.
"""
HEADS = {
    PAGE: HEAD,
    PAGE.with_name("problem-keys-walker.md"): MORE.format("walkers", "`walker.model` selects one of these walkers."),
    PAGE.with_name("problem-keys-control.md"): MORE.format("control", "`control.type` selects one of these laws."),
}
TOP = "top level"


def pages() -> dict[Path, str]:
    """The pages as Markdown."""
    sections = dict[tuple[str, str], list[Mapping[str, Any]]]()
    for title, variant in _mappings_below(problem_schema(), ""):
        sections.setdefault((title, variant.get("description", "")), []).append(variant)
    texts: dict[Path, list[str]] = {path: [head] for path, head in HEADS.items()}
    for (title, about), variants in sections.items():
        place = next((path for path in HEADS if title.startswith(path.stem.removeprefix("problem-keys-"))), PAGE)
        words = [] if title == TOP or not about else [f"{_cell(about)}\n"]
        texts[place] += [f"## {title if title == TOP else f'`{title}`'}\n", *words, *_table(variants), ""]
    return {path: "\n".join(lines) for path, lines in texts.items()}


def _mappings_below(schema: Mapping[str, Any], path: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """A mapping and those in it, each with its path; those that only restrict others have no types."""
    if any(_kind(value) != "any" for value in schema["properties"].values()):
        yield path or TOP, schema
    for key, value in schema["properties"].items():
        for variant in _mappings(value):
            yield from _mappings_below(variant, _named(f"{path}.{key}" if path else key, variant))


def _table(variants: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The keys of a mapping, whose variants belong to different walkers; keys that mean the same share a row."""
    rows = dict[tuple[str, str], dict[str, None]]()
    for key, value in ((key, value) for variant in variants for key, value in variant["properties"].items()):
        required = all(key in variant.get("required", ()) for variant in variants)
        default = "" if value.get("default") in (None, "", {}) else f"default `{_yaml(value['default'])}`"
        cells = filter(None, (_kind(value), "required" if required else default))
        rows.setdefault((_cell(value.get("description", "")), _cell("; ".join(cells))), {})[f"`{key}`"] = None
    if len(variants) > 1 and any(
        variant["properties"].keys() != variants[0]["properties"].keys() for variant in variants
    ):
        yield "The keys depend on the walker.\n"
    yield "| key | meaning | value |\n|---|---|---|"
    yield from (f"| {', '.join(keys)} | {words} | {kind} |" for (words, kind), keys in rows.items())


def _yaml(value: Any) -> str:
    return str(value).replace("'", "")


def _named(path: str, variant: Mapping[str, Any]) -> str:
    """Path of a mapping, with the key that selects it among its alternatives."""
    for key in ("model", "type", "phases"):
        choice = variant["properties"].get(key, {})
        if "const" in choice:
            return f"{path} {{{key}: {choice['const']}}}"
    return path


def _mappings(value: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The mappings with named keys that a value may be; unknowns are explained at the head of the page."""
    mappings = [value] if value.get("properties") and not _is_range(value) else []
    for variant in (*value.get("oneOf", ()), *value.get("anyOf", ())):
        mappings += _mappings(variant) if variant.get("description") != "an unknown" else []
    return mappings


def _is_range(value: Mapping[str, Any]) -> bool:
    return set(value.get("properties", ())) == {"min", "max"}


def _kind(value: Mapping[str, Any]) -> str:
    if _is_range(value):
        return "`{min: a, max: b}`"
    if "const" in value:
        return f"`{value['const']}`"
    if "enum" in value:
        return ", ".join(f"`{choice}`" for choice in value["enum"])
    variants = (*value.get("oneOf", ()), *value.get("anyOf", ()))
    if variants:
        kinds = ["an unknown" if v.get("description") == "an unknown" else _kind(v) for v in variants]
        return " or ".join(kind for kind in dict.fromkeys(kinds) if kind != "any")
    kind = value.get("type", "any")
    if kind == "array":
        return f"list of {_kind(value.get('items', {}))}"
    if kind == "string" and "deg" in value.get("pattern", ""):
        return "angle"
    limits = {key: value[key] for key in ("minimum", "maximum") if abs(value.get(key, LARGEST)) != LARGEST}
    words = {"minimum": "at least", "maximum": "at most"}
    bounds = " and ".join("more than 0" if x == SMALLEST else f"{words[key]} {x:.6g}" for key, x in limits.items())
    if limits.keys() == words.keys() and limits["minimum"] != SMALLEST:
        bounds = f"{limits['minimum']:.6g} to {limits['maximum']:.6g}"
    return f"{'mapping' if kind == 'object' else kind}{f', {bounds}' if bounds else ''}"


def _cell(text: str) -> str:
    return str(text).replace("|", "\\|")


if __name__ == "__main__":
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")
