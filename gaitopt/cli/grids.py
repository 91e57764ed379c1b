"""What commands over grids share: ``--over KEY=LO:HI:N``, workers, and a progress that says when it will end."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from gaitopt.cli.options import key_value

if TYPE_CHECKING:
    from rich.console import Console

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
LINE_EVERY = 5.0
"""Seconds between two lines of progress where there is no terminal."""


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
    from gaitopt.runs.grid import Axis

    key, spans = key_value(text, "--over")
    parts = spans.split(":")
    if len(parts) != 3 or not parts[2].strip().isdecimal() or len(parts[2]) > LONGEST_COUNT:
        raise ValueError(f"{text}: write --over {key}=LO:HI:N, for instance {key}=0.1:0.3:20")
    lower, upper = map(number_or_angle, parts[:2])
    return Axis(key=key, lower=lower, upper=upper, count=int(parts[2]))


def number_or_angle(text: str) -> float:
    """A number, or an angle with its unit in rad.

    Raises
    ------
    ValueError
        If it is neither.
    """
    from gaitopt.mechanics.units import parse_angle

    try:
        return float(text)
    except ValueError:
        return float(str(parse_angle(text.strip())))


@contextmanager
def job_progress(console: "Console", what: str) -> Iterator[Callable[[int, int], None]]:
    """Give a callback (done, total) that shows progress and the time that is left."""
    if console.is_terminal:
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=console, transient=True) as progress:
            bar = progress.add_task(what, total=None)
            yield lambda done, total: progress.update(bar, completed=done, total=total)
        return
    clock = _Clock()

    def show(done: int, total: int) -> None:
        words = clock.look(done, total)
        if words:
            console.print(f"  {what}: {done} of {total}{words}")

    yield show


class _Clock:
    """When to print a line, and how long it will still take at the pace so far."""

    def __init__(self) -> None:
        self._began = self._last = time.monotonic()
        self._first: int | None = None

    def look(self, done: int, total: int) -> str:
        now = time.monotonic()
        self._first = done - 1 if self._first is None else self._first
        if now - self._last < LINE_EVERY and done < total:
            return ""
        self._last = now
        left = (now - self._began) / max(done - self._first, 1) * (total - done)
        return f", about {left:.0f} s left" if done < total else f", {now - self._began:.0f} s"
