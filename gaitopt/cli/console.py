"""Consoles of rich that escape control characters; apart from ``terminal``, because importing rich takes a while."""

import os
import sys
from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from gaitopt.cli.terminal import printable

PIPED_WIDTH = 160
"""Width of tables that do not go to a terminal [characters]."""


class ResultConsole(Console):
    """A console that escapes control characters and raises BrokenPipeError, for which ``main`` has an exit code."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render with control characters escaped in all texts, but not in the styles of the console itself."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(printable(segment.text), segment.style)

    def on_broken_pipe(self) -> None:
        """Raise the error, where rich would exit."""
        raise BrokenPipeError


def console(*, stderr: bool, quiet: bool = False) -> Console:
    """A console on stdout or stderr that prints texts as they are, without markup."""
    stream = sys.stderr if stderr else sys.stdout
    width = None if stream.isatty() or "COLUMNS" in os.environ else PIPED_WIDTH
    return ResultConsole(stderr=stderr, quiet=quiet, width=width, markup=False, highlight=False, emoji=False)
