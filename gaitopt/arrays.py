"""Arrays of real numbers, results with read-only arrays, and arithmetic that may overflow."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class ReadOnlyArrays:
    """Base of frozen dataclasses whose arrays are read-only views of the given arrays.

    Copies and pickles contain the fields, but no cached properties.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:  # type: ignore[attr-defined]  # of every subclass
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, name, read_only(value))

    def __reduce__(self) -> tuple[Any, ...]:
        names = self.__dataclass_fields__  # type: ignore[attr-defined]  # of every subclass
        return _of_fields, (type(self), {name: getattr(self, name) for name in names})


def _of_fields(kind: type[Any], values: dict[str, Any]) -> Any:
    return kind(**values)


def read_only(values: NDArray[Any]) -> NDArray[Any]:
    """A view of ``values`` that cannot be written to."""
    view = values.view()
    view.flags.writeable = False
    return view


def overflow_allowed() -> np.errstate:
    """Decorator or context for computations with trial points, which may diverge, without warnings of overflow.

    The caller must reject values that are not finite. Without this, the vector unit of the processor would decide
    whether numpy warns.
    """
    return np.errstate(over="ignore", invalid="ignore")
