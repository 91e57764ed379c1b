"""Options that commands share, and the readers of their texts: ``KEY=VALUE``, ranges, grids, states, numbers.

Angles may have the unit deg or rad.
"""

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gaitopt.errors import ProblemError
from gaitopt.requests import (
    FindRequest,
    Request,
    SimulateRequest,
    SolveRequest,
    SweepRequest,
    WorkersRequest,
    entries,
)

if TYPE_CHECKING:
    from gaitopt.api.families import Over
    from gaitopt.problem.floor import Floor


Texts = Iterable[str] | None
UNKNOWN_STEPS = 1000
"""Number of random tiles for a walk that ends at a time, whose number of steps is unknown. The last tile repeats."""


def key_value(text: str, option: str) -> tuple[str, str]:
    """Split ``KEY=VALUE``."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip() or not value.strip():
        raise typer.BadParameter(f"{option} {text}: write {option} {key.strip() or 'KEY'}=VALUE")
    return key.strip(), value.strip()


def overrides(texts: Texts) -> dict[str, object]:
    """Values by dotted key from ``--set`` options, read as YAML; if a key occurs twice, the last value counts."""
    from gaitopt.problem.source import parse_value

    values: dict[str, object] = {}
    for key, text in (key_value(entry, "--set") for entry in texts or ()):
        try:
            values[key] = parse_value(text)
        except ProblemError as error:
            raise ProblemError(f"--set {key}: {error}") from error
    return values


def grid(texts: Iterable[str]) -> "Over":
    """The ranges of ``--over KEY=LO:HI:N`` options by key, in the form that the library takes."""
    from gaitopt.model.units import parse_count
    from gaitopt.runs.grid import Grid, axis_of

    ranges: dict[str, tuple[str, str, int]] = {}
    try:
        axes = []
        for text in texts:
            key, span = key_value(text, "--over")
            ends = span.split(":")
            count = parse_count(ends[2].strip()) if len(ends) == 3 else None
            if count is None:
                raise ValueError(f"{text}: write --over {key}=LO:HI:N, for instance {key}=0.1:0.3:20")
            ranges[key] = (ends[0], ends[1], count)
            axes.append(axis_of(key, *ranges[key]))
        Grid(tuple(axes))
    except ValueError as error:
        raise typer.BadParameter(f"--over {error}") from error
    return ranges


def intervals(texts: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Ends by key from ``--over KEY=LO:HI`` options."""
    spans = dict[str, tuple[str, str]]()
    for text in texts:
        key, span = key_value(text, "--over")
        ends = span.split(":")
        if len(ends) != 2 or key in spans:
            fault = "is given twice" if key in spans else f"write --over {key}=LO:HI"
            raise typer.BadParameter(f"--over {text}: {fault}")
        spans[key] = (ends[0], ends[1])
    return spans


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
            raise typer.BadParameter(f"--within {text}: the range is empty, because {lower:g} is not below {upper:g}")
        spans[key] = (lower, upper)
    return spans


def state(texts: Texts) -> dict[str, float]:
    """Finite numbers by state name from ``--state theta1=-0.15,dtheta1=0.7``."""
    values: dict[str, float] = {}
    for entry in (entry for text in texts or () for entry in text.split(",") if entry.strip()):
        name, text = key_value(entry, "--state")
        values[name] = number(text, f"--state {name}: ")
        if not math.isfinite(values[name]):
            raise typer.BadParameter(f"--state {name}: {text} is not a finite number")
    return values


def number(text: str, prefix: str = "") -> float:
    """The number in a text, read as YAML, or an angle; ``prefix`` begins the message of an error."""
    from gaitopt.model.units import parse_angle
    from gaitopt.problem.source import parse_value

    wrong = typer.BadParameter(f"{prefix}{text}: write a number, or an angle such as 2 deg")
    try:
        value = parse_angle(parse_value(text))
    except (ProblemError, ValueError) as error:
        raise wrong from error
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise wrong
    return float(value)


def floor(tiles: str | None, random: str | None, seed: int, steps: int | None) -> "Floor | None":
    """The floor of ``--floor``, which is a text or a CSV file; or that of ``--random``, with a tile for every step."""
    from gaitopt.problem.floor import Floor, RandomFloor

    if tiles is not None and random is not None:
        raise typer.BadParameter("--floor and --random: give one of them")
    if random is None and seed:
        raise typer.BadParameter("--seed: only a floor of --random has a seed")
    if random is not None:
        return RandomFloor.parse(random, seed).draw((steps or UNKNOWN_STEPS) + 1)
    if tiles is None:
        return None
    return Floor.parse(tiles) if "=" in tiles or not tiles.strip() else Floor.read(tiles)


def counts(texts: Texts) -> dict[str, int]:
    """The levels N of ``--follow KIND=N`` options for all kinds; 0 for kinds that are not given."""
    from gaitopt.branches.request import FOLLOWS
    from gaitopt.model.units import parse_count

    numbers = dict.fromkeys(FOLLOWS.values(), 0)
    for text in texts or ():
        key, value = key_value(text, "--follow")
        count = parse_count(value)
        if key not in numbers or count is None:
            kinds = ", ".join(f"{kind}=N" for kind in numbers)
            raise typer.BadParameter(f"--follow {text}: write --follow with one of {kinds} and a whole number N")
        numbers[key] = count
    return numbers


def scheduler_address(text: str | None) -> str | None:
    """The address of a scheduler; an invalid one is refused before any work."""
    if text is not None:
        from gaitopt.workers.cluster import check_address

        check_address(text)
    return text


def option(
    request: type[Request],
    name: str,
    flag: str = "",
    *,
    metavar: str | None = None,
    check: Callable[..., Any] | None = None,
) -> Any:
    """The option for a field of a request, with help, bounds and choices; its name is ``flag`` or that of the field.

    Parameters
    ----------
    check : called with the value of a text, and returns it or raises an error.
    """
    field = entries(request)[name]
    return typer.Option(
        flag or f"--{name.replace('_', '-')}",
        metavar=metavar or "|".join(field.choices) or None,
        parser=(number if metavar else field.read) if field.is_number else None,
        callback=field.checked if field.is_number or field.choices or field.about.items else check,
        help=" ".join(filter(None, (field.about.help, field.about.span and f"[{field.about.span}]"))),
        show_default=field.default is not None,
    )


ProblemArgument = Annotated[str, typer.Argument(metavar="PROBLEM", help="A name from `gaitopt list`, or a .yaml file.")]
RunArgument = Annotated[str, typer.Argument(metavar="RUN", help="A run folder, or a PROBLEM.")]
RunArguments = Annotated[list[str], typer.Argument(metavar="RUN", help="Run folders, or PROBLEMs.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Change a value of the problem: friction=0.2, walker.slope='2 deg'."
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="DIR", help="Run folder. Default: results/NAME-HASH.", show_default=False),
]
OverOption = Annotated[
    list[str],
    typer.Option("--over", metavar="KEY=LO:HI:N", help="Vary one key: N equidistant values from LO to HI."),
]
GridOption = Annotated[
    list[str],
    typer.Option(
        "--over",
        metavar="KEY=LO:HI:N",
        help="Vary a key: N equidistant values from LO to HI. Give --over once for every key of the grid.",
    ),
]
EngineOption = Annotated[str, option(SimulateRequest, "engine")]
MethodOption = Annotated[str, option(SolveRequest, "method")]
GuessOption = Annotated[bool, option(SweepRequest, "from_guess")]
WorkersOption = Annotated[int | None, option(WorkersRequest, "workers")]
SchedulerOption = Annotated[str | None, option(WorkersRequest, "scheduler", metavar="ADDRESS", check=scheduler_address)]
SamplesOption = Annotated[int, option(FindRequest, "starts")]
SecondsOption = Annotated[float | None, option(FindRequest, "seconds")]
SeedOption = Annotated[int, option(FindRequest, "seed")]
