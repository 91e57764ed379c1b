"""The exact values that a theorem is about: decimals as the problem's file writes them, and pi where it writes deg.

What a file does not state as a number, an override or a value that a design has found, counts as the shortest decimal
of its double.
"""

import re
from collections.abc import Iterator, Mapping
from typing import Any

from flint import arb
from ruamel.yaml import YAML
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode

from gaitopt.mechanics.units import parse_angle
from gaitopt.problem import Problem
from gaitopt.proof.certificate import EXACT_VALUE

INTERVAL = ".."
"""Between the ends of an interval."""


def exact_texts(problem: Problem, values: Mapping[str, float]) -> dict[str, str]:
    """Every parameter of a system as the text of its exact value: ``0.14``, ``1 deg``.

    Parameters
    ----------
    values : the parameters as doubles by dotted key.
    """
    written = dict(_scalars(YAML(typ="safe", pure=True).compose(problem.text))) if problem.text else {}
    return {key: _text(written.get(key), float(value)) for key, value in values.items()}


def ball(text: str) -> arb:
    """The ball of an exact value as ``exact_texts`` writes it, or of an interval ``lo..hi`` of such values.

    Raises
    ------
    ValueError
        If it is not a decimal number, with ``deg`` or ``rad`` where it is an angle.
    """
    lower, between, upper = text.partition(INTERVAL)
    if between:
        return ball(lower.strip()).union(ball(upper.strip()))
    number, _, unit = text.partition(" ")
    value = arb(number)
    if unit not in ("", "rad", "deg") or not value.is_finite():
        raise ValueError(f"{text!r} is no exact value; write a decimal number, or one with deg or rad")
    return value * arb.pi() / 180 if unit == "deg" else value


def _text(written: str | None, value: float) -> str:
    """The text of the file if it stands for this very double, otherwise the double's shortest decimal."""
    text = "" if written is None else " ".join(written.split())
    return text if re.fullmatch(EXACT_VALUE, text) and _double(text) == value else repr(value)


def _double(text: str) -> Any:
    """The double of a number in a file, or what is no number."""
    try:
        return float(text)
    except ValueError:
        pass
    try:
        return parse_angle(text)
    except ValueError:
        return None


def _scalars(node: Node, path: tuple[str, ...] = ()) -> Iterator[tuple[str, str]]:
    if isinstance(node, MappingNode):
        for key, value in node.value:
            yield from _scalars(value, (*path, key.value))
    elif isinstance(node, ScalarNode):
        yield ".".join(path), node.value
