"""Write ``problem-keys.md``, the reference of the problem file, from the schema: ``python docs/problem_keys.py``."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from gaitopt import problem_schema
from gaitopt.model.units import LARGEST, SMALLEST

PAGE = Path(__file__).with_name("problem-keys.md")
HEAD = """# Keys of the problem file

Written by `python docs/problem_keys.py` from the schema that `gaitopt schema` prints. A dot leads into a mapping:
`gait.phases` is the key `phases` of the mapping `gait`. *or an unknown* means that the value may be
`{free: [lo, hi], guess: value}`: a design then finds it. An angle is a number in rad, or a text such as `1 deg`.

Values outside a range are errors; unusual values only trigger a warning on stderr. Ranges in natural units refer to the
walker of the file: l is its leg length (radius), m its total mass, g gravity. Numbers are at most 1e30 in size, and
numbers that must be more than 0 are at least 1e-30.

Point your editor at the schema (`gaitopt schema > gaitopt.schema.json`), and with this first line in the file it
completes keys and shows units as you type:

    # yaml-language-server: $schema=gaitopt.schema.json
"""
BOUNDS = (
    ("minimum", "at least"),
    ("maximum", "at most"),
)
TOP = "top level"


def page() -> str:
    """The page as Markdown."""
    return "\n".join([HEAD, *_sections(problem_schema(), "")])


def _sections(schema: Mapping[str, Any], path: str) -> Iterator[str]:
    """A table of the keys of a mapping, followed by those of the mappings in it."""
    required, inner = schema.get("required", ()), list[tuple[str, Mapping[str, Any]]]()
    yield f"## {f'`{path}`' if path else TOP}\n"
    if path and "description" in schema:
        yield f"{_cell(schema['description'])}\n"
    yield "| key | means | value |\n|---|---|---|"
    for key, value in schema["properties"].items():
        name = f"{path}.{key}" if path else key
        inner += [(_named(name, variant), variant) for variant in _mappings(value)]
        default = f"default `{value['default']}`" if value.get("default") not in (None, "", {}) else ""
        presence = "required" if key in required else default
        words = f"{_kind(value)}{'; ' if presence else ''}{presence}"
        yield f"| `{key}` | {_cell(value.get('description', ''))} | {_cell(words)} |"
    yield ""
    for name, variant in inner:
        yield from _sections(variant, name)


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
        return " or ".join(dict.fromkeys(kinds))
    kind = value.get("type", "any")
    if kind == "array":
        return f"list of {_kind(value.get('items', {}))}"
    if kind == "string" and "deg" in value.get("pattern", ""):
        return "angle"
    limits = [(words, value[key]) for key, words in BOUNDS if key in value and abs(value[key]) != LARGEST]
    bounds = " and ".join("more than 0" if x == SMALLEST else f"{words} {x:.6g}" for words, x in limits)
    return f"{'mapping' if kind == 'object' else kind}{f', {bounds}' if bounds else ''}"


def _cell(text: str) -> str:
    return str(text).replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
