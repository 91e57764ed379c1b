"""Progress of IPOPT on stderr, and Ctrl-C during it."""

import math
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event
from types import FrameType

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
    columns = (TextColumn("{task.description}"), BarColumn(bar_width=20), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task(what, total=-math.log10(SOLVED))

        def show(iteration: int, violation: float) -> None:
            digits = -math.log10(max(violation, SOLVED))
            words = f"{what}  iteration {iteration}, violation {violation:.1e}"
            progress.update(bar, completed=max(digits, 0.0), description=words)

        yield show


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Remember a Ctrl-C, and give the question whether there was one.

    CasADi swallows the KeyboardInterrupt and returns as if nothing had happened, or turns it into an error of its own,
    so a flag is kept beside it.
    """
    pressed = Event()

    def remember(signum: int, frame: FrameType | None) -> None:
        pressed.set()
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, remember)
    try:
        yield pressed.is_set
    except Exception as error:
        if pressed.is_set():
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, before)
