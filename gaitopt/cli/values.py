"""How the texts of options are read: ``KEY=VALUE``, ranges, grids, states and numbers; angles may carry deg or rad."""

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import typer

from gaitopt.errors import ProblemError

if TYPE_CHECKING:
    from gaitopt.runs.grid import Axis, Grid

LONGEST_COUNT = 100
"""Characters of a number of values that are read; far fewer are accepted."""
Texts = Iterable[str] | None


def key_value(text: str, option: str) -> tuple[str, str]:
    """Split ``KEY=VALUE``."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip() or not value.strip():
        raise typer.BadParameter(f"{option} {text}: write {option} {key.strip() or 'KEY'}=VALUE")
    return key.strip(), value.strip()


def overrides(texts: Texts) -> dict[str, object]:
    """Values by dotted key from ``--set`` options, as YAML reads them; the last one counts."""
    from gaitopt.problem import parse_value

    values: dict[str, object] = {}
    for key, text in (key_value(entry, "--set") for entry in texts or ()):
        try:
            values[key] = parse_value(text)
        except ProblemError as error:
            raise ProblemError(f"--set {key}: {error}") from error
    return values


def grid(texts: Iterable[str]) -> "Grid":
    """The grid of ``--over`` options."""
    from gaitopt.runs.grid import Grid

    try:
        return Grid(tuple(map(_axis, texts)))
    except ValueError as error:
        raise typer.BadParameter(f"--over {error}") from error


def _axis(text: str) -> "Axis":
    from gaitopt.runs.grid import axis_of

    key, spans = key_value(text, "--over")
    parts = spans.split(":")
    if len(parts) != 3 or not parts[2].strip().isdecimal() or len(parts[2]) > LONGEST_COUNT:
        raise ValueError(f"{text}: write --over {key}=LO:HI:N, for instance {key}=0.1:0.3:20")
    return axis_of(key, parts[0], parts[1], int(parts[2]))


def ranges(texts: Texts) -> dict[str, tuple[float, float]]:
    """Ranges by name from ``--within`` options."""
    from gaitopt.runs.grid import number_or_angle

    spans = {}
    for text in texts or ():
        key, span = key_value(text, "--within")
        try:
            lower, upper = map(number_or_angle, span.split(":"))
        except ValueError as error:
            raise typer.BadParameter(f"--within {text}: write --within {key}=LO:HI ({error})") from error
        if not lower < upper:
            raise typer.BadParameter(f"--within {text}: an empty range, {lower:g} is not below {upper:g}")
        spans[key] = (lower, upper)
    return spans


def state(texts: Texts) -> dict[str, float]:
    """Finite numbers by state name from ``--state theta1=-0.15,dtheta1=0.7``."""
    values: dict[str, float] = {}
    for entry in (entry for text in texts or () for entry in text.split(",") if entry.strip()):
        name, text = key_value(entry, "--state")
        values[name] = number(text, f"--state {name}:")
        if not math.isfinite(values[name]):
            raise typer.BadParameter(f"--state {name}: {text} is not a finite number")
    return values


def number(text: str, option: str) -> float:
    """A number as YAML reads it, or an angle."""
    from gaitopt.mechanics.units import parse_angle
    from gaitopt.problem import parse_value

    wrong = typer.BadParameter(f"{option} {text}: write a number, or an angle such as 2 deg")
    try:
        value = parse_angle(parse_value(text))
    except (ProblemError, ValueError) as error:
        raise wrong from error
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise wrong
    return float(value)


def counts(texts: Texts) -> dict[str, int]:
    """How many times branches of each kind are followed, from ``--follow KIND=N``."""
    from gaitopt.families.request import FOLLOWS

    numbers = dict.fromkeys(FOLLOWS.values(), 0)
    for text in texts or ():
        key, value = key_value(text, "--follow")
        if key not in numbers or not value.isdecimal():
            kinds = ", ".join(f"{kind}=N" for kind in numbers)
            raise typer.BadParameter(f"--follow {text}: write --follow with one of {kinds} and a whole number N")
        numbers[key] = int(value)
    return numbers
