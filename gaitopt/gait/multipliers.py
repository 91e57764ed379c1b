"""Floquet multipliers: eigenvalues of the return map's derivative at a periodic gait."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from gaitopt.arrays import Array

TIE_DIGITS = 10
"""Moduli that agree to so many digits count as equal, so that rounding does not decide their order."""


def floquet_multipliers(return_map: Array) -> NDArray[np.complex128]:
    """Eigenvalues of a return map's derivative, largest modulus first; shape (n_xi,)."""
    values = np.linalg.eigvals(return_map).astype(complex)
    return values[np.lexsort((-values.imag, -values.real, -np.round(np.abs(values), TIE_DIGITS)))]


def multiplier_distance(first: NDArray[np.complex128], second: NDArray[np.complex128]) -> float:
    """Largest distance between two sets of multipliers, each paired with its closest partner."""
    distances = np.abs(first[:, None] - second[None, :])
    rows, columns = linear_sum_assignment(distances)
    return float(distances[rows, columns].max(initial=0.0))
