"""What a command says: its result on stdout, as tables or JSON; narration and progress on stderr.

Text that a terminal only shows: escape sequences and characters without a code in its encoding are spelled out.

Ctrl-C and SIGTERM: both end a command in the same way, with what is finished on the disk.

How a command ends: its exit codes, and what it says of warnings, errors and its own defects.
"""

import signal
import sys
import threading
import traceback
import unicodedata
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from io import TextIOWrapper
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from gaitopt.errors import GaitoptError, GaitoptWarning, StorageError

if TYPE_CHECKING:
    from rich.console import Console


KEPT = "\n\t"


def printable(text: str) -> str:
    r"""The text with control and format characters shown as escapes, \x1b for instance; line ends and tabs stay."""
    return "".join(char.encode("unicode_escape").decode("ascii") if _is_obeyed(char) else char for char in text)


def allow_any_encoding() -> None:
    r"""From now on, write characters that the encoding of stdout or stderr lacks as escapes, \xe9 for instance."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a caller may have put anything else there
            stream.reconfigure(errors="backslashreplace")


def _is_obeyed(char: str) -> bool:
    """Whether it is of the categories C (control, format, surrogate, ...), Zl or Zp (separators of lines)."""
    category = unicodedata.category(char)
    return char not in KEPT and (category[0] == "C" or category in ("Zl", "Zp"))


INTERRUPTED = 130
TERMINATED = 143
"""Exit codes, those that a shell gives a program ended by SIGINT and SIGTERM."""


class Ending:
    """Which signal has ended the command, if one has."""

    def __init__(self) -> None:
        self._received: list[int] = []

    def interrupt(self, signum: int, frame: FrameType | None) -> None:
        """Handle SIGINT."""
        self._received.append(signum)
        raise KeyboardInterrupt

    def terminate(self, signum: int, frame: FrameType | None) -> None:
        """Handle SIGTERM: by the present handler of SIGINT."""
        self._received.append(signum)
        signal.raise_signal(signal.SIGINT)

    def __bool__(self) -> bool:
        return bool(self._received)

    @property
    def exit_code(self) -> int:
        """Of the first signal; an interrupt that no signal has caused counts as Ctrl-C."""
        return TERMINATED if self._received[:1] == [signal.SIGTERM] else INTERRUPTED

    @property
    def words(self) -> str:
        """For the user."""
        return "terminated" if self.exit_code == TERMINATED else "interrupted"


@contextmanager
def listening() -> Iterator[Ending]:
    """Turn both signals into a KeyboardInterrupt within the block; only the main thread can."""
    ending = Ending()
    if threading.current_thread() is not threading.main_thread():
        yield ending
        return
    handlers = {signal.SIGINT: ending.interrupt, signal.SIGTERM: ending.terminate}
    before = {signum: signal.signal(signum, handler) for signum, handler in handlers.items()}
    try:
        yield ending
    finally:
        for signum, handler in before.items():
            signal.signal(signum, handler)


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Remember a Ctrl-C, give a function that says whether there was one, and end the block with it.

    CasADi swallows the KeyboardInterrupt and returns as if nothing had happened, or turns it into an error of its own,
    so a flag is kept beside it. Python delivers signals to the main thread: in any other, the flag stays down.
    """
    pressed = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield pressed.is_set
        return

    def remember(signum: int, frame: FrameType | None) -> None:
        pressed.set()
        if callable(before):
            before(signum, frame)
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
    if pressed.is_set():
        raise KeyboardInterrupt


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
        from gaitopt.store.files import json_text

        sys.stdout.write(json_text(record) + "\n")

    def print_paths(self, paths: Iterable[Path]) -> None:
        """Print files, one a line."""
        for path in paths:
            self.results.print(str(path), soft_wrap=True)

    @contextmanager
    def working(self, jobs: str) -> Iterator[tuple[Progress, Callable[[], bool]]]:
        """Show the progress of work that consists of ``jobs``; a callback for it, and whether Ctrl-C was pressed."""
        from gaitopt.api.progress import job_progress

        with interruptible() as interrupted, job_progress(self.narration, jobs) as progress:
            yield progress, interrupted

    @contextmanager
    def solving(self, name: str) -> Iterator[tuple[Progress, Callable[[], bool]]]:
        """The same for the solution of one problem."""
        from gaitopt.api.progress import solver_progress

        with interruptible() as interrupted, solver_progress(self.narration, f"solving {name}") as progress:
            yield progress, interrupted


INTERNAL_ERROR, USAGE, NOT_A_GAIT, NOT_VERIFIED, STORAGE = 1, 2, 4, 5, 6
BROKEN_PIPE = 141
"""The reader of our output has gone; the code that a shell gives a program ended by SIGPIPE."""
PREFIXES = {"over": "--over ", "parameter": "--param ", "to": "--to "}
"""Options by the argument of the library's call that an error is about."""
SUFFIXES = {"output": " with -o"}


def check_working_folder() -> None:
    """Refuse to work in a folder that has been deleted."""
    try:
        Path.cwd()
    except FileNotFoundError as error:
        raise StorageError("the working directory has been deleted; change to another one") from error


@contextmanager
def shown_warnings() -> Iterator[None]:
    """Print gaitopt's own warnings on stderr as lines for the user; all others go where they always do."""
    with warnings.catch_warnings():
        elsewhere = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any, **details: Any) -> None:
            if issubclass(category, GaitoptWarning):
                sys.stderr.write(printable(f"gaitopt: warning: {message}\n"))
            else:
                elsewhere(message, category, *place, **details)

        warnings.showwarning = show
        warnings.simplefilter("always", GaitoptWarning)
        yield


def error_words(error: GaitoptError) -> str:
    """What an error says, with the option that is the remedy."""
    prefix, suffix = PREFIXES.get(error.argument, ""), SUFFIXES.get(error.argument, "")
    return "\n".join(prefix + line for line in str(error).splitlines()) + suffix


def internal_error(error: Exception) -> str:
    """A defect in one line: what it is, and where it was raised, as some exceptions have no words of their own."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    words = ": ".join(filter(None, (type(error).__name__, str(error))))
    place = "/".join(Path(frame.filename).parts[-2:])
    return f"internal error: {words} ({place}:{frame.lineno}); rerun with --debug for the traceback"
