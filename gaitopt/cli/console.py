"""Consoles that print what files hold without obeying it. NO_COLOR and narrow terminals are rich's business."""

import os
import sys
from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from gaitopt.cli.terminal import printable

PIPED_WIDTH = 160
"""Columns where no terminal says how many it has."""


class ResultConsole(Console):
    """A console that escapes control characters and lets a broken pipe through to where exit codes are decided."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render as usual; what a terminal would obey in a text is shown instead, only styles of our own are not."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(printable(segment.text), segment.style)

    def on_broken_pipe(self) -> None:
        """Raise what rich would turn into an exit."""
        raise BrokenPipeError


def console(*, stderr: bool, quiet: bool = False) -> Console:
    """A console on stdout or stderr that prints texts as they are, without markup."""
    stream = sys.stderr if stderr else sys.stdout
    width = None if stream.isatty() or "COLUMNS" in os.environ else PIPED_WIDTH
    return ResultConsole(stderr=stderr, quiet=quiet, width=width, markup=False, highlight=False, emoji=False)
