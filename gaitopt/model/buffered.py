"""Calls between Python and CasADi: functions of CasADi called through buffers, and functions that Python evaluates.

A call through buffers takes little longer than the arithmetic: 1 us instead of 20. It overwrites its buffers, and
CasADi lets other threads run during a call. Functions that are kept and shared therefore have buffers of their own in
every thread.
"""

import threading
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from casadi import DM, Callback, Function, Sparsity, densify

from gaitopt.arrays import Array
from gaitopt.building import BUILT, building

WIDTH = 256
"""Number of rows that ``RowMap`` evaluates in one call of CasADi."""


class NumericFunction(Callback):
    """A CasADi function of columns that Python evaluates. It must be kept as long as a program of CasADi uses it.

    Parameters
    ----------
    name : name of the function.
    lengths : length of every argument.
    patterns : sparsity of every output.
    evaluate : function of the arguments, each of shape (n,), that returns the outputs.
    derivatives : sparsities and function, as ``patterns`` and ``evaluate``, of the Jacobians of the first output by
        every argument; this function has the first output as a further argument. None if there are no derivatives.
    options : options of CasADi.
    """

    def __init__(
        self,
        name: str,
        lengths: Sequence[int],
        patterns: Sequence[Sparsity],
        evaluate: Callable[..., Sequence[Any]],
        *,
        derivatives: tuple[Sequence[Sparsity], Callable[..., Sequence[Any]]] | None = None,
        options: Any = None,
    ) -> None:
        super().__init__()
        self._lengths, self._patterns, self._evaluate = tuple(lengths), tuple(patterns), evaluate
        self._derivatives, self._jacobians = derivatives, list[Callback]()
        self.construct(name, options or {})

    def get_n_in(self) -> int:
        """Number of arguments."""
        return len(self._lengths)

    def get_n_out(self) -> int:
        """Number of outputs."""
        return len(self._patterns)

    def get_sparsity_in(self, i: int) -> Sparsity:
        """Shape of an argument."""
        return Sparsity.dense(self._lengths[i], 1)

    def get_sparsity_out(self, i: int) -> Sparsity:
        """Sparsity of an output."""
        return self._patterns[i]

    def eval(self, arg: Sequence[DM]) -> list[DM]:
        """The outputs."""
        return [DM(value) for value in self._evaluate(*(column.full().ravel() for column in arg))]

    def has_jacobian(self) -> bool:
        """Whether there are derivatives."""
        return self._derivatives is not None

    def get_jacobian(self, name: str, inames: Sequence[str], onames: Sequence[str], opts: Any) -> Function:
        """The function that evaluates the derivatives."""
        assert self._derivatives is not None
        patterns, evaluate = self._derivatives
        lengths = (*self._lengths, *(pattern.numel() for pattern in self._patterns))
        self._jacobians.append(NumericFunction(name, lengths, patterns, evaluate, options=opts))
        return self._jacobians[-1]


class Buffers:
    """A function of vectors with fixed memory, for one user: a call overwrites the outputs of the previous one.

    A hot loop writes ``inputs``, calls ``evaluate`` and reads ``outputs``; other code calls the object with all
    arguments. For several users there is ``BufferedFunction``.

    Parameters
    ----------
    function : a function with dense inputs.
    nonzeros : whether sparse outputs have their nonzeros only; otherwise they are dense.

    Attributes
    ----------
    inputs, outputs : tuple of ndarray, each of shape (n,) - memory that the function reads and writes.
    evaluate : callable without arguments, which evaluates the function.
    """

    __slots__ = ("_buffer", "evaluate", "inputs", "outputs")

    def __init__(self, function: Function, *, nonzeros: bool = False) -> None:
        function = function if nonzeros else _dense(function)
        self.inputs: tuple[Array, ...] = tuple(np.zeros(function.numel_in(k)) for k in range(function.n_in()))
        self.outputs: tuple[Array, ...] = tuple(np.zeros(function.nnz_out(k)) for k in range(function.n_out()))
        buffer: Any
        buffer, self.evaluate = function.buffer()
        for k, vector in enumerate(self.inputs):
            buffer.set_arg(k, vector.data)
        for k, vector in enumerate(self.outputs):
            buffer.set_res(k, vector.data)
        self._buffer = BUILT.watch(buffer)  # keeps the memory of ``evaluate`` alive

    @property
    def failed(self) -> bool:
        """Whether the last call had no result."""
        return bool(self._buffer.ret())

    def __call__(self, *values: Any) -> tuple[Array, ...]:
        """The outputs, each of shape (n,), at ``values``; valid until the next call."""
        for vector, value in zip(self.inputs, values, strict=True):
            vector[:] = value
        self.evaluate()
        return self.outputs


class BufferedFunction(threading.local):
    """A function of vectors with buffers of their own for every thread.

    Parameters
    ----------
    function, nonzeros : see ``Buffers``.
    """

    def __init__(self, function: Function, *, nonzeros: bool = False) -> None:  # once in every thread
        self._buffers = Buffers(function, nonzeros=nonzeros)

    @property
    def failed(self) -> bool:
        """Whether the last call of this thread had no result."""
        return self._buffers.failed

    def __call__(self, *values: Any) -> tuple[Array, ...]:
        """The outputs, each of shape (n,), at ``values``; valid until the next call of this thread."""
        buffers = self._buffers
        for vector, value in zip(buffers.inputs, values, strict=True):
            vector[:] = value
        buffers.evaluate()
        return buffers.outputs


class BufferedMap(threading.local):
    """A function of vectors, evaluated at a fixed number of points in one call, with buffers for every thread.

    Parameters
    ----------
    function : a function of vectors.
    count : number of points.
    """

    def __init__(self, function: Function, count: int) -> None:  # once in every thread
        self._mapped = Buffers(_map(_dense(function), count))
        self._inputs = [memory.reshape(count, -1) if memory.size else None for memory in self._mapped.inputs]
        self._outputs = tuple(
            memory.reshape(count, *function.size_out(k)[::-1]) for k, memory in enumerate(self._mapped.outputs)
        )

    def __call__(self, *values: Any) -> tuple[Array, ...]:
        """The transposed outputs, of shape (count, columns, rows), or (count, rows) for a vector.

        They are valid until the next call of this thread. ``values`` have the shape (count, size), or (size,) if they
        are the same at all points.
        """
        for memory, value in zip(self._inputs, values, strict=True):
            if memory is not None:
                memory[:] = value
        self._mapped.evaluate()
        return tuple(output[:, 0] if output.shape[1] == 1 else output for output in self._outputs)


class RowMap:
    """A function of vectors evaluated row by row.

    Parameters
    ----------
    function : CasADi function of vectors.
    """

    def __init__(self, function: Function) -> None:
        self._sizes_in = [function.numel_in(k) for k in range(function.n_in())]
        self._sizes_out = [function.numel_out(k) for k in range(function.n_out())]
        self._mapped = Buffers(_map(function, WIDTH))

    def __call__(self, *values: Any) -> list[Array]:
        """Outputs of shape (n, size) from inputs of shape (n, size), or (size,) if they are the same in all rows."""
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
                    memory[count:] = array[start]  # fills the map with valid inputs, whose outputs are not read
            self._mapped.evaluate()
            for output, memory in zip(outputs, self._mapped.outputs, strict=True):
                output[start : start + count] = memory.reshape(WIDTH, -1)[:count]
        return outputs


@lru_cache(maxsize=256)
def buffered(function: Function) -> BufferedFunction:
    """The buffers of a function, created on first use and kept with it."""
    return BufferedFunction(function)


@lru_cache(maxsize=256)
def buffered_map(function: Function, count: int) -> BufferedMap:
    """The map of a function, created on first use and kept with it."""
    return BufferedMap(function, count)


@building
def _map(function: Function, count: int) -> Function:
    """The function at ``count`` points at once."""
    return function.map(count)


@building
def _dense(function: Function) -> Function:
    """The function with dense outputs, because buffers contain nonzeros only."""
    if all(function.nnz_out(k) == function.numel_out(k) for k in range(function.n_out())):
        return function
    inputs = function.sx_in()
    return Function(function.name(), inputs, [densify(output) for output in function.call(inputs)])
