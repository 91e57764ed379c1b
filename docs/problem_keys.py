"""Write the reference of the problem file, ``problem-keys.md``, from the schema: ``python docs/problem_keys.py``."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from gaitopt import problem_schema
from gaitopt.model.units import LARGEST_SIZE, SMALLEST_SIZE

MODES = ("stick", "slip_forward", "slip_backward", "flight")
LIMITS = ("minimum", "maximum")
PAGE = Path(__file__).with_name("problem-keys.md")
HEAD = """# Keys of the problem file

A dot leads into a mapping: `gait.phases` is the key `phases` of the mapping `gait`. `gaitopt schema` prints the schema
from which `python docs/problem_keys.py` generates this page. After `gaitopt schema > gaitopt.schema.json`, an editor
completes keys and shows their units if the first line of a file is

    # yaml-language-server: $schema=gaitopt.schema.json

| type | value |
|---|---|
| number | number in the unit of the row |
| angle | number in rad, or a text such as `1 deg` |
| number\\*, angle\\* | the same, or an unknown `{{free: [lo, hi], guess: value}}` that a design finds |
| mode | {modes}; or [a mapping](problem-file.md#modes) for stops, switches or several contacts |
| list, mapping | `[a, b]`, `{{key: value}}`; *numbers by name* maps names, such as those of motors, to numbers |

Values outside the range are rejected; those outside the range after "usually" only trigger a warning. Ranges may be in
natural units: l is the leg length (radius), m the total mass, g gravity; "±100 X" means from -100 X to 100 X. All
numbers are at most 1e30 in size, and positive ones at least 1e-30. A key that is neither required nor has a default may
be left out.

```{{raw}} html
<p><input type="search" id="find-key" placeholder="Search keys and meanings" aria-label="Search keys and meanings"></p>
```
"""
PARTS = {
    "": HEAD.format(modes=", ".join(f"`{mode}`" for mode in MODES)),
    "walker": "## Walkers\n\n`walker.model` selects one of these walkers; the table below explains their keys.\n",
    "control": "## Control laws\n\n`control.type` selects one of these laws.\n",
}
"""Parts of the page by the key to which they belong, each with its beginning."""
TOP = "top level"
FREE = r"\*"
"""Mark of a number that may be an unknown."""
SIGNS = {"more than ": ">", "at most ": "≤", "at least ": "≥", " to ": "…"}
"""Signs in place of words of a range."""
UNIT = re.compile(r" \[((?:(?:, or |[ /])?(?:kg|rad|[NJms1])(?:\^\d)?)+)\]")
"""A unit in a description."""
SIZE = re.compile(r"at most ([^;]*?) in size")
"""A range that is symmetric about zero."""
RANGE = re.compile(r"(usually )?(from|at most|at least) [-+.\de]+ ?.*")
"""A part of a description that is a range."""


def page() -> str:
    """The page as Markdown; places with the same keys share a table."""
    sections = dict[tuple[str, str], list[Mapping[str, Any]]]()
    for title, variant in _mappings_below(problem_schema(), ""):
        sections.setdefault((title, variant.get("description", "")), []).append(variant)
    tables, models = dict[tuple[str, str], list[str]](), dict[str, Mapping[str, Any]]()
    for (title, about), variants in sections.items():
        if model := re.fullmatch(r"walker \{model: (\w+)\}", title):
            models[model[1]] = variants[0]
            continue
        part = next((key for key in PARTS if key and title.startswith(key)), "")
        words = [] if title == TOP or not about else [f"{_sentence(about.replace('``', '`'))}\n"]
        tables.setdefault((part, "\n".join([*words, *_table(title, variants), ""])), []).append(title)
    texts = {part: [head] for part, head in PARTS.items()}
    for (part, table), titles in tables.items():
        heading, *others = dict.fromkeys(titles)
        level = "###" if part else "##"
        also = f"The same keys: {', '.join(f'`{title}`' for title in others)}.\n" if others else ""
        texts[part] += [f"{level} {heading if heading == TOP else f'`{heading}`'}\n", *([also] if also else []), table]
    texts["walker"][1:1] = _walkers(models)
    return "\n".join(line for lines in texts.values() for line in lines)


def _walkers(models: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Every walker with its keys, and a table of all keys, in which equal rows of several walkers are one."""
    rows, about = dict[tuple[str, str], list[str]](), list[str]()
    for model, variant in models.items():
        own = {key: value for key, value in variant["properties"].items() if key != "model"}
        keys = ", ".join(f"`{key}`" for key in own)
        about.append(f"- **`{model}`**: {_sentence(variant.get('description', '')).rstrip('.')}. Keys: {keys}.")
        for row in [*_table("", [{**variant, "properties": own}])][1:]:
            for key, rest in [row[2:].split(" | ", 1)]:
                for one in key.split(", "):
                    rows.setdefault((one, rest), []).append(model)
    several = {key for key, _ in rows if sum(other == key for other, _ in rows) > 1}
    table = ["| key | type | unit | range | default | meaning |\n|---|---|---|---|---|---|"]
    for (key, rest), names in sorted(rows.items()):
        owners = f" of {', '.join(names)}" if key in several else ""
        table.append(f"| {key}{owners} | {rest}")
    return [*about, "", *table, ""]


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
    words = [kind for kind in kinds if kind not in ("any", "null", "unknown")]
    if words:
        return " or ".join(
            f"{kind}{FREE}" if "unknown" in kinds and kind in ("number", "angle") else kind for kind in words
        )
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
    return " or ".join(f"{word.removesuffix(FREE)}s{FREE * word.endswith(FREE)}" for word in kind.split(" or "))


def _range(value: Mapping[str, Any], stated: Sequence[str]) -> str:
    """The range of a number: that of the description in natural units, or the limits of the schema."""
    limits, inner = dict[str, float](), [value]
    for entry in inner:  # grows by the alternatives, and the values of lists and mappings
        limits |= {key: entry[key] for key in LIMITS if abs(entry.get(key, LARGEST_SIZE)) != LARGEST_SIZE}
        below = (entry.get(key) for key in ("items", "additionalProperties"))
        inner += [*entry.get("anyOf", ()), *(found for found in below if isinstance(found, dict))]
    least, most = (limits.get(key) for key in LIMITS)
    possible = [part.removeprefix("from ") for part in stated if not part.startswith("usually")]
    if least == SMALLEST_SIZE:
        upper = possible[0].removeprefix("0 to ") if possible else "" if most is None else f"{most:.6g}"
        words = f"more than 0{f', at most {upper}' if upper else ''}"
    elif possible:
        words = possible[0]
    elif least is not None and most is not None:
        words = f"{least:.6g} to {most:.6g}"
    else:
        words = f"at least {least:.6g}" if least is not None else "" if most is None else f"at most {most:.6g}"
    usual = [part.replace("usually from", "usually") for part in stated if part.startswith("usually")]
    return "; ".join(_short(part) for part in filter(None, (words, *usual)))


def _short(part: str) -> str:
    """A range with signs in place of words: ``> 0, ≤ 1000·m·g·l``."""
    part = SIZE.sub(r"±\1", part)
    for words, sign in SIGNS.items():
        part = part.replace(words, sign)
    return re.sub(r"(?<=[\w)]) (?=[mgl]\b|sqrt)", "·", part)


def _cell(text: str) -> str:
    return str(text).replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
