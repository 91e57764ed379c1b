"""Test functions that vanish where a gait loses or gains stability, where the branch folds or another crosses it.

    slope            d parameter / d arclength
    unit             prod (1 - lambda_i)
    period doubling  prod (lambda_i + 1)
    Neimark-Sacker   prod over i < j of (lambda_i lambda_j - 1), with a complex pair on the unit circle

A multiplier is 1 at folds and at branch points. With r the return map, A its derivative by the state, s the arclength,

    det [[1 - A, -dr/dparameter], [tangent]] = prod (1 - lambda_i) / (d parameter / ds)

vanishes at branch points only: at a fold, slope and unit change their signs together; where one of them does alone,
another branch crosses this one (unit alone: transcritical, or a pitchfork seen from its handle; slope alone: seen from
a prong).

References
----------
Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory, ch. 10.
"""

from collections.abc import Callable, Mapping
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gaitopt.gait import Gait

BIFURCATIONS = ("fold", "branch_point", "period_doubling", "neimark_sacker")
TestFunction = Callable[[Gait], float]
"""A function of the gaits of a family, continuous along it, whose zeros are of interest."""
NEUTRAL = 1e-6
"""Imaginary part below which a pair with product one is real: a neutral saddle, not a Neimark-Sacker point."""


def test_functions(multipliers: NDArray[np.complex128], slope: float) -> dict[str, float]:
    """Values by type of special point; ``slope`` is d parameter / d arclength."""
    pairs = [a * b - 1 for a, b in combinations(multipliers, 2)]
    return {
        "slope": slope,
        "unit": float(np.prod(1 - multipliers).real),
        "period_doubling": float(np.prod(multipliers + 1).real),
        "neimark_sacker": float(np.prod(pairs).real) if pairs else 1.0,
    }


def bifurcations_between(before: Mapping[str, float], after: Mapping[str, float]) -> dict[str, str]:
    """Types of the special points between two gaits with these test functions, each with the one that locates it."""
    changed = {name for name, value in after.items() if value * before[name] < 0}
    kinds: dict[str, str] = {kind: kind for kind in ("period_doubling", "neimark_sacker") if kind in changed}
    if {"slope", "unit"} <= changed:
        kinds["fold"] = "slope"
    elif changed & {"slope", "unit"}:
        kinds["branch_point"] = "slope" if "slope" in changed else "unit"
    return kinds


def is_bifurcation(kind: str, multipliers: NDArray[np.complex128]) -> bool:
    """Whether a zero of a test function is the special point that it is named for."""
    if kind != "neimark_sacker":
        return True
    a, b = min(combinations(multipliers, 2), key=lambda pair: abs(pair[0] * pair[1] - 1))
    return bool(abs(a.imag) > NEUTRAL and abs(b.imag) > NEUTRAL)
