"""Code of other packages: checks of its classes, calls of its methods, and checks of their results.

An exception of a method becomes one sentence. Each expression must have the right shape and depend only on those
arguments on which it may depend. An error names the class and the method.
"""

import difflib
import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import SimpleNamespace, UnionType
from typing import Any
from weakref import WeakSet

import numpy as np
from casadi import DM, SX, Function, depends_on, symvar, vertcat
from pydantic.fields import FieldInfo

from gaitopt.errors import ProblemError

NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*")
"""Names of coordinates, actuators, stops and switches, which occur in keys, columns and compiled functions."""
NAME_WORDS = "a name of ASCII letters and digits, with single underscores between them"
FOOT_COORDINATES = ("x", "y")
KINDS: Any = (SX, DM, int, float, np.number, np.ndarray)
"""Types that a method may return for an expression."""
MODEL = re.compile(r"\w[\w.-]*")
"""The names by which problem files call walkers and control laws."""
_PASSED: WeakSet[type] = WeakSet()
"""Classes that have passed ``check_declared``; every point of a branch builds a problem of the same classes."""


def check_declared(declared: object, base: type, faults: Callable[[Any], Iterator[str]]) -> None:
    """Check a class of walkers or control laws; none of its methods is called.

    Parameters
    ----------
    base : the class of gaitopt from which it must be derived.
    faults : messages about its attributes and fields.

    Raises
    ------
    ProblemError
        With the first fault.
    """
    if not (isinstance(declared, type) and issubclass(declared, base)):
        raise ProblemError(f"{shown(declared)} is not a subclass of gaitopt.{base.__name__}")
    if declared in _PASSED:
        return
    with calling(declared, "reading its attributes"):
        missing = ", ".join(sorted(getattr(declared, "__abstractmethods__", ())))
        reason = f"lacks {missing}" if missing else next(faults(declared), None)
    if reason is not None:
        raise ProblemError(f"{declared.__name__}: {reason}")
    _PASSED.add(declared)


def field_faults(base: type, name: str, field: FieldInfo, attributes: Sequence[str]) -> Iterator[str]:
    """Messages about a field that no class may have; ``attributes`` are the class attributes of ``base``."""
    if hasattr(base, name) or name in attributes:
        yield f"has the name of an attribute or method of {base.__name__}: rename it"
    if not NAME.fullmatch(name):
        yield f"must have {NAME_WORDS}"
    if field.alias is not None or field.validation_alias is not None:
        yield "has an alias, which problem files cannot use: remove it"
    if field.exclude:
        yield "is excluded from records: remove exclude=True"


@contextmanager
def calling(walker: type, what: str) -> Iterator[None]:
    """Turn any exception of a class into one sentence.

    Raises
    ------
    ProblemError
        If the body of the ``with`` raises an exception, SystemExit included; KeyboardInterrupt is not caught.
    """
    try:
        yield
    except ProblemError:
        raise
    except (Exception, SystemExit) as error:  # the code of a class may raise anything
        raise ProblemError(f"{walker.__name__}: {what} raises {raised(error)}") from error


def raised(error: BaseException) -> str:
    """Type and first line of an exception; for a misspelt coordinate or parameter, the names that exist."""
    if isinstance(error, AttributeError) and isinstance(error.obj, SimpleNamespace):
        names = [*vars(error.obj)]
        near = difflib.get_close_matches(str(error.name), names, n=2)
        remedy = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(names) or 'none'}"
        return f"{type(error).__name__}: nothing is called {error.name}; {remedy}"
    try:
        lines = str(error).splitlines()
    except Exception:  # noqa: BLE001 - someone's exception may not even have a text
        lines = []
    return ": ".join([type(error).__name__, *lines[:1]])


class Reader:
    """Reads the results of a class's methods, whose arguments are coordinates ``q`` and parameters ``p`` by name."""

    def __init__(self, walker: type, q: SimpleNamespace, p: SimpleNamespace) -> None:
        self._class = walker
        entries, parameters = dict(vars(q)), dict(vars(p))
        self.symbols = symbols_of([*entries.values(), *parameters.values()])
        foot = {name: entries.pop(name) for name in FOOT_COORDINATES if name in entries}
        self.shape, self.height = symbols_of(entries.values()), symbols_of([foot["y"]] if "y" in foot else [])
        along = symbols_of([foot["x"]] if "x" in foot else [])
        everything = vertcat(self.shape, self.height, along)
        self.along = along
        self._forbidden = {
            "all": ("", SX(0, 1)),
            "height": ("the coordinates and parameters, but not of x", along),
            "motor": (
                "the shape coordinates and parameters; name the actuator in external if it pushes the walker from "
                "outside, along x or y",
                vertcat(self.height, along),
            ),
            "shape": ("the shape coordinates and parameters, but not of x and y", vertcat(self.height, along)),
            "parameters": ("the parameters alone", everything),
        }

    def scalar(self, what: str, value: Any, of: str) -> SX:
        """One expression."""
        return self.vector(what, value, 1, of)

    def vector(self, what: str, value: Any, size: int, of: str) -> SX:
        """A column of expressions, which depend on the arguments ``of``: a key of ``_forbidden``."""
        if size == 1 and is_finite(value):  # a number needs no check of its symbols, which takes long
            return SX(value)
        name = self._class.__name__
        form = "one number or expression" if size == 1 else f"a column of {size}, vertcat(...)"
        expression = self.expression(what, value, form)
        if expression.shape != (size, 1):
            rows, columns = expression.shape
            raise ProblemError(f"{name}: {what} has shape ({rows}, {columns}), but must be {form}")
        allowed, forbidden = self._forbidden[of]
        if forbidden.numel() and depends_on(expression, forbidden):
            raise ProblemError(f"{name}: {what} must be a function of {allowed}")
        return expression

    def expression(self, what: str, value: Any, form: str = "an expression") -> SX:
        """An expression of any shape, of the symbols that were passed to the method."""
        name = self._class.__name__
        strange = isinstance(value, bool) or (isinstance(value, np.ndarray) and value.dtype.kind not in "iuf")
        if strange or not isinstance(value, KINDS):
            raise ProblemError(f"{name}: {what} is {shown(value)}, but must be {form} of CasADi's type SX")
        with calling(self._class, f"reading {what}"):
            expression = SX(value)
        foreign = Function("foreign", [self.symbols], [expression], {"allow_free": True}).free_sx()
        if foreign:
            names = ", ".join(str(symbol) for symbol in foreign)
            raise ProblemError(f"{name}: {what} contains {names}, which is not a symbol that was passed to the method")
        return expression


def is_finite(value: object) -> bool:
    """Whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def is_name(value: object) -> bool:
    """Whether a value is a name of the form of ``NAME``."""
    return isinstance(value, str) and NAME.fullmatch(value) is not None


def is_list(value: object, kind: type | UnionType) -> bool:
    """Whether a value is a tuple or list with entries of one kind."""
    return isinstance(value, tuple | list) and all(isinstance(entry, kind) for entry in value)


def doubles(names: tuple[str, ...]) -> str:
    """A text with the names that occur twice."""
    return ", ".join(sorted({name for name in names if names.count(name) > 1}))


def symbols_of(expressions: Any) -> SX:
    """All symbols in some expressions, as a column."""
    return vertcat(SX(0, 1), *symvar(vertcat(SX(0, 1), *expressions)))


def shown(value: object) -> str:
    """A value in a message: its text if that is short, otherwise its type."""
    try:
        text = repr(value)
    except Exception:  # noqa: BLE001 - the text of someone's object may raise anything
        text = ""
    return text if 0 < len(text) <= 40 and text.isprintable() else f"a value of type {type(value).__name__}"
