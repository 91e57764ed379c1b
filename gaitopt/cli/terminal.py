"""The output of a command, and the signals that end it.

The result goes to stdout, as tables or JSON; narration and progress go to stderr. Control characters in texts, and
characters that the encoding of the stream lacks, are written as escapes, so that a terminal does not interpret them.

Ctrl-C and SIGTERM end every command in the same way; all finished results are then on the disk.
"""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, TextIO

from gaitopt.errors import printable
from gaitopt.threads import cached_property

if TYPE_CHECKING:
    from rich.console import Console


INTERNAL_ERROR, USAGE, NOT_A_GAIT, NOT_VERIFIED, STORAGE = 1, 2, 4, 5, 6
INTERRUPTED, BROKEN_PIPE, TERMINATED = 130, 141, 143
"""Exit codes with which a shell reports that SIGINT, SIGPIPE or SIGTERM has ended a program."""
PIPED_WIDTH = 160
"""Width of tables that do not go to a terminal [characters]."""
NARROWEST_WIDTH, WIDEST_WIDTH = 20, 10_000
"""Bounds of the width that COLUMNS may state [characters]. The narrowest shows a table of one column; the widest is
wider than any screen."""

STOPPING = "stopping after this iteration; press Ctrl-C again to stop at once"
"""The line that the first Ctrl-C prints during a solve."""

Progress = Callable[[int, Any], None]
Record = Mapping[str, Any]


def allow_any_encoding() -> None:
    r"""From now on, write characters that the encoding of stdout or stderr lacks as escapes such as \xe9."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a caller may have replaced the streams
            stream.reconfigure(errors="backslashreplace")


def console(*, stderr: bool, quiet: bool = False) -> "Console":
    """A console on stdout or stderr that prints texts as they are, without markup, and escapes control characters.

    It raises BrokenPipeError, for which ``main`` has an exit code.
    """
    from rich.console import Console  # importing rich takes a while, and help needs none of it
    from rich.segment import Segment

    class ResultConsole(Console):
        def render(self, renderable: Any, options: Any = None) -> Iterable[Segment]:
            """Escape control characters in all texts, but not in the styles of the console itself."""
            for segment in super().render(renderable, options):
                yield segment if segment.control else Segment(printable(segment.text), segment.style)

        def on_broken_pipe(self) -> None:
            """Raise the error, where rich would exit."""
            raise BrokenPipeError

    stream = sys.stderr if stderr else sys.stdout
    width = _width(stream)
    return ResultConsole(stderr=stderr, quiet=quiet, width=width, markup=False, highlight=False, emoji=False)


def _width(stream: TextIO) -> int | None:
    """Width of the tables on a stream [characters]; None for the width of its terminal.

    A terminal that does not know its size exports COLUMNS=0; the console would then print nothing.
    """
    from gaitopt.model.units import parse_count

    stated = os.environ.get("COLUMNS", "").strip()
    columns = parse_count(stated)
    if columns:
        return min(max(columns, NARROWEST_WIDTH), WIDEST_WIDTH)
    return None if stream.isatty() and not stated.isdigit() else PIPED_WIDTH


class Terminal:
    """Output of one command: results on stdout, as tables or with --json as JSON; narration and progress on stderr.

    Attributes
    ----------
    json : whether results are printed as JSON.
    every : whether tables print every value, however many there are.
    typed : for each problem by its name, the arguments that named it, with its ``--set`` options.
    """

    def __init__(self, *, json: bool = False, quiet: bool = False, every: bool = False) -> None:
        self.json, self._quiet, self.every = json, quiet, every
        self.typed: dict[str, list[str]] = {}

    @cached_property
    def narration(self) -> "Console":
        """The console of narration and progress, silent with --quiet."""
        return console(stderr=True, quiet=self._quiet)

    @cached_property
    def results(self) -> "Console":
        """The console of results; texts are printed as they are, without markup."""
        return console(stderr=False)

    def say(self, sentence: str) -> None:
        """Print a sentence of narration."""
        self.narration.print(sentence, soft_wrap=True)

    def show(self, record: Record, table: Callable[["Console", Any], None], *paths: str) -> None:
        """Print a result: its record as JSON, or its table and then the files and folders under the keys ``paths``."""
        if self.json:
            self.print_json(record)
            return
        table(self.results, record)
        for key in paths:
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
        """Show progress in ``jobs``; yields a callback (done, total) and a function that returns whether to stop."""
        from gaitopt.api.progress import job_progress

        with interruptible() as interrupted, job_progress(self.narration, jobs) as progress:
            yield progress, interrupted

    @contextmanager
    def solving(self, name: str) -> Iterator[tuple[Progress, Callable[[], bool]]]:
        """Show the iterations of a solver; yields a callback and a function that returns whether to stop."""
        from gaitopt.api.progress import solver_progress

        with (
            interruptible(lambda: self.narration.print(STOPPING)) as interrupted,
            solver_progress(self.narration, f"solving {name}") as progress,
        ):
            yield progress, interrupted


class SignalRecord:
    """The signals that the command has received; it is true if there are any."""

    def __init__(self) -> None:
        self._received: list[int] = []

    def interrupt(self, signum: int, frame: FrameType | None) -> None:
        """Handle SIGINT."""
        self._received.append(signum)
        raise KeyboardInterrupt

    def terminate(self, signum: int, frame: FrameType | None) -> None:
        """Handle SIGTERM by the current handler of SIGINT."""
        self._received.append(signum)
        signal.raise_signal(signal.SIGINT)

    def __bool__(self) -> bool:
        return bool(self._received)

    @property
    def exit_code(self) -> int:
        """The exit code for the first signal; an interrupt without a signal counts as Ctrl-C."""
        return TERMINATED if self._received[:1] == [signal.SIGTERM] else INTERRUPTED

    @property
    def message(self) -> str:
        """The message for the user."""
        return "terminated" if self.exit_code == TERMINATED else "interrupted"


@contextmanager
def listening() -> Iterator[SignalRecord]:
    """Turn SIGINT and SIGTERM into a KeyboardInterrupt within the block, in the main thread."""
    record = SignalRecord()
    if threading.current_thread() is not threading.main_thread():
        yield record
        return
    handlers = {signal.SIGINT: record.interrupt, signal.SIGTERM: record.terminate}
    before = {signum: signal.signal(signum, handler) for signum, handler in handlers.items()}
    try:
        yield record
    finally:
        for signum, handler in before.items():
            signal.signal(signum, handler)


@contextmanager
def interruptible(announce: Callable[[], object] | None = None) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether Ctrl-C was pressed; if so, the block ends with a KeyboardInterrupt.

    With ``announce``, the first Ctrl-C calls it and lets the block go on to where it stops by itself and keeps what it
    has; the second ends the block at once. Without it, the first one does.

    The flag is needed because CasADi may swallow the KeyboardInterrupt and return normally, or turn it into another
    error. Python delivers signals to the main thread only; in other threads the function always returns False.
    """
    pressed = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield pressed.is_set
        return

    def remember(signum: int, frame: FrameType | None) -> None:
        again = pressed.is_set()
        pressed.set()
        with suppress(KeyboardInterrupt):  # the command notes the signal
            if callable(before):
                before(signum, frame)
        if announce is None or again:
            raise KeyboardInterrupt
        with suppress(RuntimeError):  # the signal came while another line was printed to the same stream
            announce()

    before = signal.signal(signal.SIGINT, remember)
    try:
        yield pressed.is_set
    except Exception as error:
        if pressed.is_set():
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed.is_set():
        raise KeyboardInterrupt
