"""The output of a command: its result on stdout, as tables or JSON; narration and progress on stderr.

Texts are printed as they are, but no terminal obeys them: control characters, and characters that the encoding of the
stream lacks, are written as escapes.
"""

import sys
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitopt.cli.signals import interruptible
from gaitopt.threads import cached_property

if TYPE_CHECKING:
    from rich.console import Console


INTERNAL_ERROR, USAGE, NOT_A_GAIT, NOT_VERIFIED, STORAGE = 1, 2, 4, 5, 6
BROKEN_PIPE = 141
"""The reader of the output has closed it: as a shell reports a program that SIGPIPE has ended."""

LAYOUT = "\n\t"
"""Control characters that a text may contain."""

Progress = Callable[[int, Any], None]
Record = Mapping[str, Any]


def printable(text: str) -> str:
    r"""The text with control and format characters written as escapes such as \x1b, except line ends and tabs."""
    return "".join(char.encode("unicode_escape").decode("ascii") if _is_control(char) else char for char in text)


def allow_any_encoding() -> None:
    r"""Write characters that the encoding of stdout or stderr lacks as escapes such as \xe9 from now on."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a caller may have put anything else there
            stream.reconfigure(errors="backslashreplace")


def _is_control(char: str) -> bool:
    """Whether its Unicode category is C (control, format, surrogate, ...), Zl or Zp (line and paragraph separator)."""
    category = unicodedata.category(char)
    return char not in LAYOUT and (category[0] == "C" or category in ("Zl", "Zp"))


class Terminal:
    """Output of one command: results on stdout, as tables or with --json as JSON; narration and progress on stderr."""

    def __init__(self, *, json: bool, quiet: bool) -> None:
        self.json, self._quiet = json, quiet

    @cached_property
    def narration(self) -> "Console":
        """The console of narration and progress, silent with --quiet."""
        from gaitopt.cli.console import console

        return console(stderr=True, quiet=self._quiet)

    @cached_property
    def results(self) -> "Console":
        """The console of results; texts are printed as they are, without markup."""
        from gaitopt.cli.console import console

        return console(stderr=False)

    def say(self, words: str) -> None:
        """Print a sentence of narration."""
        self.narration.print(words, soft_wrap=True)

    def show(self, record: Record, table: Callable[["Console", Any], None], *places: str) -> None:
        """Print a result: its record as JSON, or its table and then the files and folders under the keys ``places``."""
        if self.json:
            self.print_json(record)
            return
        table(self.results, record)
        for key in places:
            self.results.print(f"{key}: {record[key]}", soft_wrap=True)

    def print_json(self, record: Record) -> None:
        """Print a record as one line of JSON."""
        from gaitopt.store.formats import json_text

        sys.stdout.write(json_text(record) + "\n")

    def print_paths(self, paths: Iterable[Path]) -> None:
        """Print one path per line."""
        for path in paths:
            self.results.print(str(path), soft_wrap=True)

    @contextmanager
    def working(self, jobs: str) -> Iterator[tuple[Progress, Callable[[], bool]]]:
        """Show progress in ``jobs``; yields a callback (done, total), and a function that tells whether to stop."""
        from gaitopt.api.progress import job_progress

        with interruptible() as interrupted, job_progress(self.narration, jobs) as progress:
            yield progress, interrupted

    @contextmanager
    def solving(self, name: str) -> Iterator[tuple[Progress, Callable[[], bool]]]:
        """Show the iterations of a solver; yields a callback, and a function that tells whether to stop."""
        from gaitopt.api.progress import solver_progress

        with interruptible() as interrupted, solver_progress(self.narration, f"solving {name}") as progress:
            yield progress, interrupted
