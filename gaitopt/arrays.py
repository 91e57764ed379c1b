"""Arrays of real numbers, and results whose arrays cannot be written to."""

from dataclasses import fields
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class ReadOnlyArrays:
    """Base of frozen dataclasses: their arrays are read-only views of those that they are given."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for name in _arrays(type(self)):  # type: ignore[arg-type]  # a class has a hash
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, name, read_only(value))


@lru_cache(maxsize=64)
def _arrays(cls: type) -> tuple[str, ...]:
    """Names of the fields of a dataclass that are declared as arrays."""
    return tuple(field.name for field in fields(cls) if np.ndarray.__name__ in str(field.type))


def read_only(values: NDArray[Any]) -> NDArray[Any]:
    """A view of ``values`` that cannot be written to."""
    view = values.view()
    view.flags.writeable = False
    return view
