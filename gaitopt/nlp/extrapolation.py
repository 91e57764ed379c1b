"""The next solution from the last ones on its way: the polynomial through their values, and through their slopes.

w(s) = sum_k a_k(s) w(s_k) + sum_k b_k(s) w'(s_k)
"""

from collections.abc import Sequence

import numpy as np

from gaitopt.arrays import Array

LARGEST_WEIGHTS = 100.0
"""Sum of the weights of the values; with larger ones the place lies too far beyond what is known."""


def extrapolation(places: Sequence[float], place: float, *, slopes: bool = False) -> Array | None:
    """Weights of the values at some places, and with ``slopes`` after them of the derivatives, in the value at another.

    Returns
    -------
    weights : ndarray, shape (n,) or (2 n,); None where the other place is too far away to say.
    """
    unit = max(abs(s) for s in (*places, place)) or 1.0
    x, powers = np.array(places) / unit, np.arange(len(places) * (2 if slopes else 1))
    rows = x[:, None] ** powers
    if slopes:
        rows = np.vstack([rows, powers * x[:, None] ** np.maximum(powers - 1, 0) / unit])
    try:
        weights = np.linalg.solve(rows.T, (place / unit) ** powers)
    except np.linalg.LinAlgError:  # two of the places are one
        return None
    return weights if np.abs(weights[: x.size]).sum() < LARGEST_WEIGHTS else None
