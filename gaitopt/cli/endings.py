"""How a command ends: its exit codes, and what it says of warnings, errors and its own defects."""

import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gaitopt.cli.printable import printable
from gaitopt.errors import GaitoptError, GaitoptWarning, StorageError

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
