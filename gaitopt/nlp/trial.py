"""Points that an iteration tries: one that diverges ends the attempt as data, in silence, on every processor.

Its values overflow, and are seen by not being finite. Whether numpy would also warn of it depends on the vector unit
that computes them.
"""

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu


def overflow_allowed() -> np.errstate:
    """Decorator or context of what computes with trial points."""
    return np.errstate(over="ignore", invalid="ignore")


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
