"""What a command says: its result on stdout, as tables or JSON; narration and progress on stderr."""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitopt.cli.signals import interruptible

if TYPE_CHECKING:
    from rich.console import Console

Progress = Callable[[int, Any], None]
Record = Mapping[str, Any]


class Terminal:
    """Where the words of one command go, as its options --json and --quiet ask for."""

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
        """Narrate."""
        self.narration.print(words, soft_wrap=True)

    def show(self, record: Record, table: Callable[["Console", Any], None], *places: str) -> None:
        """Print a result: its record as one line of JSON, or a table and the files or folders under some keys."""
        if self.json:
            self.print_json(record)
            return
        table(self.results, record)
        for key in places:
            self.results.print(f"{key}: {record[key]}", soft_wrap=True)

    def print_json(self, record: Record) -> None:
        """Print a record as one line of JSON."""
        from gaitopt.store import json_text

        sys.stdout.write(json_text(record) + "\n")

    def print_paths(self, paths: Iterable[Path]) -> None:
        """Print files, one a line."""
        for path in paths:
            self.results.print(str(path), soft_wrap=True)

    @contextmanager
    def working(self, jobs: str) -> Iterator[tuple[Progress, Callable[[], bool]]]:
        """Show the progress of work that consists of ``jobs``; a callback for it, and whether Ctrl-C was pressed."""
        from gaitopt.library.progress import job_progress

        with interruptible() as interrupted, job_progress(self.narration, jobs) as progress:
            yield progress, interrupted

    @contextmanager
    def solving(self, name: str) -> Iterator[tuple[Progress, Callable[[], bool]]]:
        """The same for the solution of one problem."""
        from gaitopt.library.progress import solver_progress

        with interruptible() as interrupted, solver_progress(self.narration, f"solving {name}") as progress:
            yield progress, interrupted
