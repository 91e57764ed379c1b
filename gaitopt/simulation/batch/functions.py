"""Compiled functions of many states at once: one row per state, no Python between them."""

from typing import Any

import numpy as np
from casadi import Function

from gaitopt.arrays import Array
from gaitopt.mechanics.buffered import Buffers

WIDTH = 256
"""Rows of one call: a call costs less than two of them."""


class RowMap:
    """A function of vectors evaluated row by row.

    Parameters
    ----------
    function : CasADi function of vectors.
    """

    def __init__(self, function: Function) -> None:
        self._sizes_in = [function.numel_in(k) for k in range(function.n_in())]
        self._sizes_out = [function.numel_out(k) for k in range(function.n_out())]
        self._mapped = Buffers(function.map(WIDTH))

    def __call__(self, *values: Any) -> list[Array]:
        """Outputs of shape (n, size) from inputs of shape (n, size), or (size,) for the same in all rows."""
        arrays = [np.asarray(value, dtype=float) for value in values]
        n = max(len(array) for array in arrays if array.ndim == 2)
        outputs = [np.empty((n, size)) for size in self._sizes_out]
        inputs = [memory.reshape(WIDTH, size) for memory, size in zip(self._mapped.inputs, self._sizes_in, strict=True)]
        for memory, array in zip(inputs, arrays, strict=True):
            if array.ndim < 2:
                memory[:] = array
        for start in range(0, n, WIDTH):
            count = min(WIDTH, n - start)
            for memory, array in zip(inputs, arrays, strict=True):
                if array.ndim == 2:
                    memory[:count] = array[start : start + count]
                    memory[count:] = array[start]  # what is left over must not raise, and is not read
            self._mapped.evaluate()
            for output, memory in zip(outputs, self._mapped.outputs, strict=True):
                output[start : start + count] = memory.reshape(WIDTH, -1)[:count]
        return outputs
