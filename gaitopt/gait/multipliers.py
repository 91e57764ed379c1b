"""Floquet multipliers: eigenvalues of the return map's derivative at a periodic gait."""

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array

TIE_DIGITS = 10
"""Moduli that agree to so many digits count as equal, so that rounding does not decide their order."""


def floquet_multipliers(return_map: Array) -> NDArray[np.complex128]:
    """Eigenvalues of a return map's derivative, largest modulus first; shape (n_xi,)."""
    values = np.linalg.eigvals(return_map).astype(complex)
    return values[np.lexsort((-values.imag, -values.real, -np.round(np.abs(values), TIE_DIGITS)))]


def multiplier_distance(
    first: NDArray[np.complex128], second: NDArray[np.complex128], *, relative: bool = False
) -> float:
    """Largest distance between two sets of multipliers, paired so that the sum of distances is the least.

    Parameters
    ----------
    first, second : complex ndarrays, shape (n,).
    relative : divide each distance by the modulus of the second multiplier where that exceeds one.
    """
    distances = np.abs(first[:, None] - second[None, :])
    distances /= np.maximum(1.0, np.abs(second)) if relative else 1.0
    closest = distances.argmin(axis=1) if distances.size else np.arange(0)
    if len({*closest.tolist()}) == closest.size:  # nobody's closest partner is also another's
        return float(distances.min(axis=1, initial=np.inf).max(initial=0.0))
    from scipy.optimize import linear_sum_assignment  # takes a quarter of a second to import, and is seldom needed

    rows, columns = linear_sum_assignment(distances)
    return float(distances[rows, columns].max(initial=0.0))
