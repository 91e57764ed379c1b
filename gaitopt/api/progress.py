"""Progress of long work: a bar on a terminal or in a notebook, lines elsewhere, or calls of a function."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from importlib.util import find_spec

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from gaitopt.display import counted

FULL_BAR = 1e-10
"""Constraint violation at which the bar of a solver is full."""
MOST_PREDICTED_BY_FIRST = 10
"""Largest number of jobs for which the time of the first one predicts the remaining time."""
FIRST_LINES = 10
"""Number of iterations that have a line each if the output is not a terminal."""
LINE_EVERY = 5.0
"""Smallest time between two lines of progress if the output is not a terminal [s]."""

CountProgress = bool | Callable[[int, int], None]
"""Argument ``progress`` of a call with countable jobs: whether to show it, or a function of finished jobs and total."""
ValueProgress = bool | Callable[[int, float], None]
"""Argument ``progress`` of a solution or continuation: whether to show it, or a function of a number and a value."""
Bar = tuple[Callable[..., None], Callable[..., None]]
TextProgress = bool | Callable[[str], None]
"""Argument ``progress`` of a call that describes its stages: whether to show them, or a function of the text."""


@contextmanager
def shown(
    progress: bool | Callable[..., None], bar: Callable[..., AbstractContextManager[Callable[..., None]]], *labels: str
) -> Iterator[Callable[..., None]]:
    """The callback for the argument ``progress``: the argument itself if it is a function, or that of a bar.

    A bar is only shown on the standard error of a terminal, or in the output of a notebook.
    """
    if callable(progress):
        yield progress
        return
    console = Console(stderr=True) if progress else None
    if console is None or not _is_live(console):
        yield lambda *_: None
        return
    with bar(console, *labels) as show:
        yield show


def _is_live(console: Console) -> bool:
    """Whether a bar is wanted and can be redrawn, for which a notebook needs ipywidgets."""
    if console.quiet:  # otherwise a notebook would show an empty widget
        return False
    return find_spec("ipywidgets") is not None if console.is_jupyter else console.is_terminal


@contextmanager
def _bar(console: Console, what: str, *columns: ProgressColumn, total: float | None = None) -> Iterator[Bar]:
    """Yield the two functions that update and restart a bar with these columns after its description."""
    described = TextColumn("{task.description}", markup=False)
    with Progress(described, *columns, console=console, transient=True, disable=console.quiet) as progress:
        task = progress.add_task(what, total=total)
        yield partial(progress.update, task), partial(progress.reset, task)


@contextmanager
def solver_progress(console: Console, what: str) -> Iterator[Callable[[int, float], None]]:
    """Yield a callback that shows iteration and violation: a bar on a terminal, some twenty lines elsewhere.

    The bar shows the negative decimal logarithm of the violation. Without a terminal the first iterations have a line
    each, and later a line is printed whenever their number has doubled.
    """
    if not _is_live(console):
        console.print(what)
        calls, due = 0, 1

        def tell(iteration: int, violation: float) -> None:
            nonlocal calls, due
            calls += 1
            if calls == due:
                due = calls + 1 if calls < FIRST_LINES else 2 * calls
                console.print(f"  iteration {iteration}, violation {violation:.1e}")

        yield tell
        return
    with _bar(console, what, BarColumn(bar_width=20), TimeElapsedColumn(), total=-math.log10(FULL_BAR)) as (update, _):

        def show(iteration: int, violation: float) -> None:
            digits = -math.log10(max(violation, FULL_BAR))
            description = f"{what}  iteration {iteration}, violation {violation:.1e}"
            update(completed=max(digits, 0.0), description=description)

        yield show


@contextmanager
def value_progress(console: Console, what: str, parameter: str) -> Iterator[Callable[[int, float], None]]:
    """Yield a callback that shows the number of gaits and the parameter beside a clock."""
    with word_progress(console, what) as say:
        yield lambda n, value: say(f"{counted(n, 'gait')}, {parameter} = {value:.6g}")


@contextmanager
def word_progress(console: Console, what: str) -> Iterator[Callable[[str], None]]:
    """Yield a callback that shows a text beside a clock."""
    with _bar(console, what, TimeElapsedColumn()) as (update, _):
        yield lambda text: update(description=f"{what}  {text}")


@contextmanager
def stage_progress(console: Console, what: str) -> Iterator[Callable[[str, int, int], None]]:
    """Yield a callback (stage, done, total) that shows the stages of a computation, each with a bar of its parts.

    A text begins a new stage. With an empty text, the callback updates the finished parts of the current stage.
    """
    last = time.monotonic()
    if not _is_live(console):

        def tell(stage: str, done: int, total: int) -> None:
            nonlocal last
            if stage or time.monotonic() - last > LINE_EVERY:
                last = time.monotonic()
                console.print(stage or f"  {done} of {total} parts", soft_wrap=True)

        yield tell
        return
    with _bar(console, what, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()) as (update, restart):

        def show(stage: str, done: int, total: int) -> None:
            if stage:
                restart(description=stage, total=None)
            else:
                update(completed=done, total=total)

        yield show


@contextmanager
def job_progress(console: Console, what: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a callback (done, total) that shows progress and the remaining time."""
    if _is_live(console):
        with _bar(console, what, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()) as (update, _):
            yield lambda done, total: update(completed=done, total=total)
        return
    began = last = time.monotonic()
    # the first job also builds the functions that all jobs need; its time does not predict that of the others
    first: tuple[int, float] | None = None

    def show(done: int, total: int) -> None:
        nonlocal last, first
        now = time.monotonic()
        counted_from, since = first = (done, now) if first is None or done < first[0] else first
        if now - last < LINE_EVERY and done < total:
            return
        rate = (done - counted_from) / (now - since) if done > counted_from else 1 / (now - began)
        last, left = now, (total - done) / rate
        known = done > counted_from or total <= MOST_PREDICTED_BY_FIRST
        times = f", about {left:.0f} s left" * known if done < total else f", {now - began:.0f} s"
        console.print(f"  {what}: {done} of {total}{times}")

    yield show
