"""Points that an iteration tries: one that diverges ends the attempt as data, in silence, on every processor.

Its values overflow, and are seen by not being finite. Whether numpy would also warn of it depends on the vector unit
that computes them.
"""

from copy import copy

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from gaitopt.arrays import Array


def overflow_allowed() -> np.errstate:
    """Decorator or context of what computes with trial points."""
    return np.errstate(over="ignore", invalid="ignore")


def with_data(pattern: csc_matrix, data: Array) -> csc_matrix:
    """The sparse matrix with other values in the same places; scipy's constructor would check the places again."""
    matrix = copy(pattern)
    matrix.data = data
    return matrix


def factorise(matrix: csc_matrix) -> SuperLU:
    """LU factors of a square matrix.

    Raises
    ------
    RuntimeError
        If it is exactly singular, or not finite, as where a trial diverges.
    """
    if not np.isfinite(matrix.data).all():
        raise RuntimeError("the matrix is not finite")
    return splu(matrix)
