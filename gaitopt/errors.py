"""The errors that gaitopt raises on purpose; each carries the exit code of the command line.

A numerical failure is not an error: it is a status on the result.
"""

from typing import Any, Self


class GaitoptError(Exception):
    """Base of every error meant for the user: its message names place, value, allowed range and remedy."""

    exit_code = 1
    argument = ""
    """The argument of the call that it is about, where another value of it is the remedy; a caller may say how to."""
    result: Any = None
    """The gait or walk that was computed before the error, so that it can still be printed."""

    def about(self, argument: str) -> Self:
        """The same error, about an argument."""
        self.argument = argument
        return self


class GaitoptWarning(UserWarning):
    """Something that the user should know, but that hinders nothing."""


class UnknownNameError(GaitoptError):
    """An unknown problem, run, walker, state, parameter or engine."""

    exit_code = 2


class ProblemError(GaitoptError, ValueError):
    """A problem that is wrong, in its file or through an override."""

    exit_code = 3


class SolveError(GaitoptError):
    """A computation that needs a gait was given something that is not one."""

    exit_code = 4


class StorageError(GaitoptError):
    """A run folder that cannot be written, or is broken, foreign or newer."""

    exit_code = 6
