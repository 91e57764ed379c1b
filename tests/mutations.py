"""Problem files spoiled at random, from a seed: keys, values, types and structure, and single characters."""

import json
import math
from collections.abc import Iterator

import numpy as np

from gaitopt import load_problem, problem_names
from gaitopt.problem.source import parse_source

VALUES = (
    None, True, False, "", "x", "stick", "slip_forward", "1 deg", "90 deg", "compass-passive-b", [], {}, [[]], [1],
    {"free": [0, 1], "guess": 0.5}, {"free": [1], "guess": 0}, {"min": 1}, {"max": -1}, 0, 1, -1, 3, 0.5, 1e-9, 1e-30,
    1e-300, 1e9, 1e30, 1e300, -1e300, math.nan, math.inf, -math.inf, 2**70, "a" * 300, "../..", "\u0000", "\u202e", "é",
)  # fmt: skip
MODES = ("stick", "slip_forward", "slip_backward")
FACTORS = (0, -1, 0.5, 2, 1.1, 0.9, 10, 1e-3, 1e3, 1e-12, 1e12)
KEYS = ("friction", "min", "max", "free", "guess", "walker", "state.dx", "period", "model", "type", "", "0")
CHARACTERS = tuple(" \t\n:#-{}[],&*!|>'\"%@`0.eE~\u0001\u2028é")


def mutated_texts(seed: int, count: int, names: tuple[str, ...] = ()) -> Iterator[str]:
    """Texts of named problems with one to three changes each; the n-th depends on seed and n alone."""
    sources = [(load_problem(name).text, name) for name in names or problem_names()]
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        text, name = sources[rng.integers(len(sources))]
        if rng.random() < 0.25:
            for _ in range(rng.integers(1, 4)):
                text = _spoiled_text(text, rng)
            yield text
            continue
        data = parse_source(text, name).data
        for _ in range(rng.integers(1, 4)):
            _spoil(data, rng)
        yield json.dumps(data, indent=1, ensure_ascii=False).replace("NaN", ".nan").replace("Infinity", ".inf")


def mutated_numbers(seed: int, count: int, names: tuple[str, ...]) -> Iterator[str]:
    """Texts of named problems with some numbers larger or smaller by up to twelve decades, or with another mode."""
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        name = names[rng.integers(len(names))]
        data = parse_source(load_problem(name).text, name).data
        for _ in range(rng.integers(1, 4)):
            entries = [(holder, key) for holder, key in _entries(data) if isinstance(holder[key], int | float)]
            holder, key = entries[rng.integers(len(entries))]
            holder[key] *= float(rng.choice([-1, 1]) if rng.random() < 0.2 else 10 ** (3 * rng.standard_normal()))
        if rng.random() < 0.2:
            phases = data["gait"].get("steps", [data["gait"]])[0]["phases"]
            phases.insert(int(rng.integers(len(phases) + 1)), MODES[rng.integers(3)])
        yield json.dumps(data, indent=1)


def _spoiled_text(text: str, rng: np.random.Generator) -> str:
    lines = text.splitlines(keepends=True)
    k = int(rng.integers(len(lines)))
    action = rng.integers(4)
    if action == 0:
        del lines[k]
    elif action == 1:
        lines.insert(k, lines[int(rng.integers(len(lines)))])
    else:
        column, character = int(rng.integers(len(lines[k]))), CHARACTERS[rng.integers(len(CHARACTERS))]
        lines[k] = lines[k][:column] + character + lines[k][column + (action == 2) :]
    return "".join(lines)


def _spoil(data: object, rng: np.random.Generator) -> None:
    """Change one entry somewhere in nested mappings and lists."""
    entries = list(_entries(data))
    if not entries:
        return
    holder, key = entries[rng.integers(len(entries))]
    value, action = holder[key], rng.integers(6)
    if action <= 2 and isinstance(value, int | float) and not isinstance(value, bool):
        holder[key] = value * FACTORS[rng.integers(len(FACTORS))]
    elif action == 3 and isinstance(holder, dict):
        holder[KEYS[rng.integers(len(KEYS))]] = holder.pop(key)
    elif action == 4:
        del holder[key]
    elif action == 5 and isinstance(holder, list):
        holder.append(value)
    else:
        holder[key] = json.loads(json.dumps(VALUES[rng.integers(len(VALUES))]))


def _entries(data: object) -> Iterator[tuple[dict | list, str | int]]:
    """Every mapping or list with each of its keys."""
    pairs = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in pairs:
        yield data, key
        yield from _entries(value)
