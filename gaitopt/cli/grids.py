"""What commands over grids share: ``--over KEY=LO:HI:N`` and workers."""

from typing import TYPE_CHECKING, Annotated

import typer

from gaitopt.cli.options import key_value

if TYPE_CHECKING:
    from gaitopt.runs.grid import Axis, Grid

OverOption = Annotated[
    list[str], typer.Option("--over", metavar="KEY=LO:HI:N", help="N values of a key; repeat it for a grid.")
]
WorkersOption = Annotated[
    int | None,
    typer.Option("--workers", min=1, help="Processes; by default one per core.", show_default=False),
]
SchedulerOption = Annotated[
    str | None, typer.Option("--scheduler", metavar="ADDRESS", help="An existing Dask scheduler, tcp://host:8786.")
]
LONGEST_COUNT = 100
"""Characters of a number of values that are read; far fewer are accepted."""


def grid(texts: list[str]) -> "Grid":
    """The grid of ``--over`` options; angles may carry deg or rad.

    Raises
    ------
    typer.BadParameter
        If one is not of the form KEY=LO:HI:N, or a range is empty.
    """
    from gaitopt.runs.grid import Grid

    try:
        return Grid(tuple(_axis(text) for text in texts))
    except ValueError as error:
        raise typer.BadParameter(f"--over {error}") from error


def _axis(text: str) -> "Axis":
    from gaitopt.runs.grid import axis_of

    key, spans = key_value(text, "--over")
    parts = spans.split(":")
    if len(parts) != 3 or not parts[2].strip().isdecimal() or len(parts[2]) > LONGEST_COUNT:
        raise ValueError(f"{text}: write --over {key}=LO:HI:N, for instance {key}=0.1:0.3:20")
    return axis_of(key, parts[0], parts[1], int(parts[2]))
