"""Test functions that vanish where a gait loses or gains stability or the branch folds.

    fold             d parameter / d arclength
    period doubling  prod (lambda_i + 1)
    Neimark-Sacker   prod over i < j of (lambda_i lambda_j - 1), with a complex pair on the unit circle

References
----------
Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory, ch. 10.
"""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

NEUTRAL = 1e-6
"""Imaginary part below which a pair with product one is real: a neutral saddle, not a Neimark-Sacker point."""


def test_functions(multipliers: NDArray[np.complex128], slope: float) -> dict[str, float]:
    """Values by type of special point; ``slope`` is d parameter / d arclength."""
    pairs = [a * b - 1 for a, b in combinations(multipliers, 2)]
    return {
        "fold": slope,
        "period_doubling": float(np.prod(multipliers + 1).real),
        "neimark_sacker": float(np.prod(pairs).real) if pairs else 1.0,
    }


def is_bifurcation(kind: str, multipliers: NDArray[np.complex128]) -> bool:
    """Whether a zero of a test function is the special point that it is named for."""
    if kind != "neimark_sacker":
        return True
    a, b = min(combinations(multipliers, 2), key=lambda pair: abs(pair[0] * pair[1] - 1))
    return bool(abs(a.imag) > NEUTRAL and abs(b.imag) > NEUTRAL)
