"""Functions of many states at once, compiled by heyoka: the lanes of a register instead of one row after the other."""

from copy import copy
from functools import lru_cache
from typing import Any

import heyoka as hy
import numpy as np
from casadi import Function

from gaitopt.arrays import Array
from gaitopt.simulation.heyoka.convert import convert
from gaitopt.simulation.heyoka.integrators import COMPILING
from gaitopt.threads import per_thread

BLOCK = 256
"""Rows of one call. Every call has so many, so that a row is rounded the same wherever it stands: what is left over of
a block that does not fill the registers would go through other instructions."""


class HeyokaRowMap:
    """A function of vectors evaluated row by row.

    Parameters
    ----------
    function : CasADi function of vectors.
    fixed : values of inputs that are the same in all rows and all calls, by their index.
    """

    def __init__(self, function: Function, fixed: dict[int, Array]) -> None:
        self._sizes = [function.numel_out(k) for k in range(function.n_out())]
        free = tuple(k for k in range(function.n_in()) if k not in fixed)
        self._compiled, constants = _row_function(_Key(function), free)
        values = np.asarray(constants(*fixed.values()), dtype=float).ravel() if fixed else np.zeros(0)
        self._pars = np.repeat(values[:, None], BLOCK, axis=1)
        self._inputs = np.zeros((sum(function.numel_in(k) for k in free), BLOCK))
        self._outputs = np.zeros((sum(self._sizes), BLOCK))

    def __call__(self, *values: Array) -> list[Array]:
        """Outputs of shape (n, size) from the inputs that are not fixed, each of shape (n, size)."""
        n = len(values[0])
        results = np.empty((n, sum(self._sizes)))
        rows = np.concatenate(values, axis=1).T
        for start in range(0, n, BLOCK):
            count = min(BLOCK, n - start)
            self._inputs[:, :count] = rows[:, start : start + count]
            self._inputs[:, count:] = rows[:, start : start + 1]  # must be something; is not read
            options = {"pars": self._pars} if self._pars.size else {}
            self._compiled(self._inputs, outputs=self._outputs, **options)
            results[start : start + count] = self._outputs[:, :count].T
        return np.split(results, np.cumsum(self._sizes)[:-1], axis=1)


class _Key:
    """A function that is equal to another if its instructions are."""

    def __init__(self, function: Function) -> None:
        self.function, self._text = function, function.serialize()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self._text == other._text

    def __hash__(self) -> int:
        return hash(self._text)


@per_thread(maxsize=32)
def _row_function(key: _Key, free: tuple[int, ...]) -> tuple[Any, Function]:
    """The function of this thread: its calls use memory of its own."""
    with COMPILING:
        compiled, constants = _compiled(key, free)
        return copy(compiled), constants


@lru_cache(maxsize=32)
def _compiled(key: _Key, free: tuple[int, ...]) -> tuple[Any, Function]:
    function = key.function
    variables = {k: [hy.expression(f"v{k}_{i}") for i in range(function.numel_in(k))] for k in free}
    conversion = convert(function, variables)
    outputs = [entry for output in conversion.outputs for entry in output]
    names = [name for group in variables.values() for name in group]
    return hy.cfunc(outputs, names, compact_mode=True), conversion.constants
