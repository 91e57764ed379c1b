"""A CasADi function called through its buffers: one call costs little more than its arithmetic (1 us, not 20)."""

from typing import Any

import numpy as np
from casadi import Function, densify
from numpy.typing import NDArray

Array = NDArray[np.float64]


class BufferedFunction:
    """A function of vectors with fixed memory: the outputs of one call are overwritten by the next.

    In a hot loop write ``inputs``, call ``evaluate`` and read ``outputs``; elsewhere call it with all its arguments.

    Attributes
    ----------
    inputs, outputs : tuple of ndarray, each of shape (n,) - what the function reads and writes in place.
    evaluate : callable without arguments.
    """

    __slots__ = ("_buffer", "evaluate", "inputs", "outputs")

    def __init__(self, function: Function) -> None:
        function = _dense(function)
        self.inputs: tuple[Array, ...] = tuple(np.zeros(function.numel_in(k)) for k in range(function.n_in()))
        self.outputs: tuple[Array, ...] = tuple(np.zeros(function.numel_out(k)) for k in range(function.n_out()))
        buffer: Any
        buffer, self.evaluate = function.buffer()
        for k, vector in enumerate(self.inputs):
            buffer.set_arg(k, vector.data)
        for k, vector in enumerate(self.outputs):
            buffer.set_res(k, vector.data)
        self._buffer = buffer  # keeps alive what ``evaluate`` works on

    def __call__(self, *values: Any) -> tuple[Array, ...]:
        """The outputs, each of shape (n,), at ``values``; valid until the next call."""
        for vector, value in zip(self.inputs, values, strict=True):
            vector[:] = value
        self.evaluate()
        return self.outputs


def _dense(function: Function) -> Function:
    """The function with structural zeros written out, as buffers hold nonzeros only."""
    if all(function.nnz_out(k) == function.numel_out(k) for k in range(function.n_out())):
        return function
    inputs = function.sx_in()
    return Function(function.name(), inputs, [densify(output) for output in function.call(inputs)])
