"""Sparse matrices by columns, and square systems that are factored and solved in one compiled call.

    A x = b        by CasADi's QR factors, whose ordering and fill-in are computed once for a pattern

This factors a matrix of shooting intervals in a third of the time of a general LU decomposition; keeping the factors
would gain little. T. A. Davis (2006), Direct Methods for Sparse Linear Systems, chapter 5.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from casadi import MX, Function, Linsol, Sparsity
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.building import BUILT, built_once
from gaitopt.model.buffered import BufferedFunction
from gaitopt.threads import cached_property

SINGULAR = 1e-300
"""A matrix with a smaller entry on the diagonal of R is singular. Entries of 1e-16 still have a meaning where a phase
vanishes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Pattern:
    """Positions of the entries of a sparse matrix.

    Attributes
    ----------
    shape : numbers of rows and columns.
    pointers : index of the first entry of every column, and the number of entries; shape (n_columns + 1,).
    rows : row of every entry, ascending within a column.
    """

    shape: tuple[int, int]
    pointers: NDArray[np.intp]
    rows: NDArray[np.intp]

    @cached_property
    def columns(self) -> NDArray[np.intp]:
        """Column of every entry."""
        return np.repeat(np.arange(self.shape[1]), np.diff(self.pointers))

    def largest(self, entries: Array) -> Array:
        """The largest of ``entries`` in every row, or 1 if it is not finite and positive; shape (n_rows,)."""
        order, starts = self._by_row
        sizes = np.maximum.reduceat(entries[order], starts)
        return np.where((sizes > 0) & (sizes < np.inf), sizes, 1.0)

    @cached_property
    def _by_row(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        order = np.argsort(self.rows, kind="stable")
        return order, np.searchsorted(self.rows[order], np.arange(self.shape[0]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SparseMatrix:
    """A pattern with its values."""

    pattern: Pattern
    data: Array

    def __matmul__(self, vector: Array) -> Array:
        """The product with a vector."""
        pattern = self.pattern
        products = self.data * vector[pattern.columns]
        return np.bincount(pattern.rows, products, pattern.shape[0]).astype(np.float64, copy=False)

    def dense(self, start: int, stop: int) -> Array:
        """The columns from ``start`` to ``stop`` as a dense matrix; shape (n_rows, stop - start)."""
        pattern = self.pattern
        entries = slice(pattern.pointers[start], pattern.pointers[stop])
        matrix = np.zeros((pattern.shape[0], stop - start))
        matrix[pattern.rows[entries], pattern.columns[entries] - start] = self.data[entries]
        return matrix

    def leading(self, count: int) -> "SparseMatrix":
        """The first columns."""
        pattern = _leading(self.pattern, count)
        return SparseMatrix(pattern=pattern, data=self.data[: pattern.rows.size])

    def with_row(self, columns: NDArray[np.intp], values: Array) -> "SparseMatrix":
        """The matrix with one more row, whose entries in the ascending ``columns`` are ``values``."""
        pattern, order = _with_row(self.pattern, columns.tobytes())
        return SparseMatrix(pattern=pattern, data=np.concatenate([self.data, values])[order])


class ScaledMatrix:
    """A square matrix in natural units with rows of size one, so that units and stiff rows do not cost digits.

    A stiff row is for instance the end of a slip that has just appeared, which is divided by its vanishing duration.

    Parameters
    ----------
    matrix : shape (n, n).
    rows, columns : ndarray, shape (n,) - units of the equations and of the unknowns.
    """

    def __init__(self, matrix: SparseMatrix, rows: Array, columns: Array) -> None:
        self._pattern, self._columns = matrix.pattern, columns
        scaled = matrix.data * columns[self._pattern.columns] / rows[self._pattern.rows]
        sizes = self._pattern.largest(np.abs(scaled))
        self._rows, self._data = rows * sizes, scaled / sizes[self._pattern.rows]

    def solve(self, right: Array) -> Array:
        """x of matrix x = right; shape (n,) or (n, m).

        Raises
        ------
        RuntimeError
            If the matrix is singular, or not finite because a trial point has diverged.
        """
        return (self._columns * self._solved(right.T / self._rows, transposed=False)).T

    def solve_transposed(self, right: Array) -> Array:
        """x of matrix' x = right; shape (n,) or (n, m)."""
        return (self._solved(right.T * self._columns, transposed=True) / self._rows).T

    def _solved(self, right: Array, *, transposed: bool) -> Array:
        if not np.isfinite(self._data).all():
            raise RuntimeError("the matrix is not finite")
        solver = _solver(self._pattern, right.size // self._rows.size, transposed)
        (solution,) = solver(self._data, right.ravel())
        if solver.failed:
            raise RuntimeError("the matrix is singular")
        return solution.reshape(right.shape).copy()


@built_once(maxsize=128)
def _solver(pattern: Pattern, count: int, transposed: bool) -> BufferedFunction:
    """(entries, right-hand sides) -> solutions."""
    sparsity = Sparsity(*pattern.shape, pattern.pointers.tolist(), pattern.rows.tolist())
    entries, right = MX.sym("entries", sparsity.nnz()), MX.sym("right", pattern.shape[0], count)
    factors = Linsol("factors", "qr", sparsity, {"eps": SINGULAR})
    solution = factors.solve(MX(sparsity, entries), right, transposed)
    return BufferedFunction(BUILT.watch(Function("solver", [entries, right], [solution])))


@lru_cache(maxsize=64)
def _leading(pattern: Pattern, count: int) -> Pattern:
    pointers = pattern.pointers[: count + 1]
    return Pattern(shape=(pattern.shape[0], count), pointers=pointers, rows=pattern.rows[: pointers[-1]])


@lru_cache(maxsize=64)
def _with_row(pattern: Pattern, at: bytes) -> tuple[Pattern, NDArray[np.intp]]:
    """The pattern with one more row, and the index of each entry among the old entries followed by the new row's."""
    rows, size = pattern.shape
    columns = np.frombuffer(at, dtype=np.intp)
    ends, first = pattern.pointers[columns + 1], pattern.rows.size
    order = np.insert(np.arange(first), ends, first + np.arange(columns.size))
    pointers = pattern.pointers + np.searchsorted(columns, np.arange(size + 1))
    return Pattern(shape=(rows + 1, size), pointers=pointers, rows=np.insert(pattern.rows, ends, rows)), order
