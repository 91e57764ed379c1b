"""The errors that gaitopt raises on purpose, each with the exit code of the command line, and texts safe to print.

A numerical failure is not an error, but a status of the result.
"""

import unicodedata
from typing import Any, Self

LAYOUT = "\n\t"
"""Control characters that a text of several lines may contain."""


class GaitoptError(Exception):
    """Base of every error meant for the user: its message names location, value, allowed range and remedy.

    Attributes
    ----------
    exit_code : exit code of the command line.
    argument : name of the argument whose value is wrong, so that a caller can say how to change it; may be empty.
    result : the gait or walk that was computed before the error and can still be printed; None if there is none.
    """

    exit_code = 1
    argument = ""
    result: Any = None

    def concerning(self, argument: str) -> Self:
        """The same error, with the name of the argument whose value is wrong."""
        self.argument = argument
        return self


class GaitoptWarning(UserWarning):
    """A remark that the user should read; the computation continues."""


class UnknownNameError(GaitoptError):
    """An unknown problem, run, walker, state, parameter or engine."""

    exit_code = 2


class ProblemError(GaitoptError, ValueError):
    """A problem that is wrong, in its file or through an override."""

    exit_code = 3


class ArgumentError(ProblemError):
    """An argument of a verb, or an option of a command, whose value is wrong; the message begins with its name."""

    exit_code = 2

    def __init__(self, argument: str, fault: str) -> None:
        super().__init__(argument, fault)
        self.argument, self.fault = argument, fault

    def __str__(self) -> str:
        return f"{self.argument} {self.fault}"


class SolveError(GaitoptError):
    """A failed solve was given where a gait is needed."""

    exit_code = 4


class StorageError(GaitoptError):
    """A run folder that cannot be written, is damaged, contains other files, or was written by a newer version."""

    exit_code = 6


def printable(text: str, keep: str = LAYOUT) -> str:
    r"""The text with control and format characters other than ``keep`` written as escapes such as \x1b."""
    return "".join(
        char.encode("unicode_escape").decode("ascii") if char not in keep and _is_control(char) else char
        for char in text
    )


def _is_control(char: str) -> bool:
    """Whether the Unicode category is C (control, format, surrogate, ...), Zl or Zp (line or paragraph separator)."""
    category = unicodedata.category(char)
    return category[0] == "C" or category in ("Zl", "Zp")
