"""Progress of IPOPT on stderr."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

SOLVED = 1e-10
"""Violation at which the bar is full."""


@contextmanager
def solver_progress(console: Console, what: str) -> Iterator[Callable[[int, float], None]]:
    """Give a callback that shows iteration and violation: a bar on a terminal, one line per iteration elsewhere.

    The bar counts the decimal digits that the violation has lost.
    """
    if not console.is_terminal:
        console.print(what)
        yield lambda iteration, violation: console.print(f"  iteration {iteration}, violation {violation:.1e}")
        return
    columns = (TextColumn("{task.description}", markup=False), BarColumn(bar_width=20), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task(what, total=-math.log10(SOLVED))

        def show(iteration: int, violation: float) -> None:
            digits = -math.log10(max(violation, SOLVED))
            words = f"{what}  iteration {iteration}, violation {violation:.1e}"
            progress.update(bar, completed=max(digits, 0.0), description=words)

        yield show
