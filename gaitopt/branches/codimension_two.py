"""Codimension-two points: where a second condition holds on the curve of a special point in two parameters.

Each is a zero of a function along the curve; the function depends on the derivatives of the return map alone:

    on a fold            <p, q>      a second multiplier 1                  resonance 1:1
                         b           the quadratic coefficient              cusp
    on a flip            <p, q>      a second multiplier -1                 resonance 1:2
                         c           the cubic coefficient                  generalised flip
    on Neimark-Sacker    kappa - cos(2 pi / n)                              resonance 1:n, n = 1, 2, 3, 4
                         Re d        the cubic coefficient                  Chenciner
    on any of them       the product over the other multipliers of (1 - lambda), (1 + lambda), and over pairs of them
                         (lambda_i lambda_j - 1): fold-flip, fold-Neimark-Sacker, flip-Neimark-Sacker, double
                         Neimark-Sacker
    on a margin          the same products over all multipliers: a bifurcation on the margin

p and q are not scaled here, so that the coefficients stay finite at the resonances.

References
----------
Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory, ch. 9; A. Colombo, F. Dercole (2010), SIAM J. Appl. Dyn. Syst.
"""

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gaitopt.branches.conditions import eigenvalues, pair_nearest
from gaitopt.branches.monitors import REAL_PAIR
from gaitopt.branches.normal_forms import (
    KINDS,
    RESONANCES,
    LocalMap,
    flip_coefficient,
    fold_coefficient,
    torus_coefficient,
)

SHORT = {"fold": "fold", "period_doubling": "flip", "neimark_sacker": "neimark_sacker"}
"""Short name of each bifurcation; the names of codimension-two points are composed of them."""
CURVES: Mapping[str, tuple[str, ...]] = {
    "resonance_1_1": ("fold", "neimark_sacker"),
    "resonance_1_2": ("period_doubling", "neimark_sacker"),
    "fold_flip": ("fold", "period_doubling"),
    "fold_neimark_sacker": ("fold", "neimark_sacker"),
    "flip_neimark_sacker": ("period_doubling", "neimark_sacker"),
    "double_neimark_sacker": ("neimark_sacker", "neimark_sacker"),
}
"""The bifurcation curves that meet at a codimension-two point."""
DEGENERATE = {"fold": "cusp", "period_doubling": "generalised_flip", "neimark_sacker": "chenciner"}
"""The point at which the coefficient of each bifurcation vanishes."""
POLE = 0.1
"""A change of sign between two points is a zero if the value located there is below this fraction of the larger one."""


def curve_tests(local: LocalMap, kind: str, kappa: float = 0.0) -> dict[str, float]:
    """Values of the test functions of the multipliers on a curve, by the type of the codimension-two point.

    Parameters
    ----------
    kind : ``fold``, ``period_doubling`` or ``neimark_sacker``; any other is a margin.
    kappa : approximate cos theta of the critical pair, which selects it.
    """
    multipliers = eigenvalues(local.A)
    if kind not in KINDS:
        return {f"margin_{name}": value for name, value in _products(multipliers).items()}
    doubles = {_double(kind, name): value for name, value in _products(_others(local, kind, kappa)).items()}
    values = {name: value for name, value in doubles.items() if name}
    if kind == "neimark_sacker":
        half = float(pair_nearest(multipliers, kappa).sum().real) / 2
        return values | {name: half - strong for name, strong in RESONANCES.items()}
    p, q, _ = local.critical(kind)
    return values | {"resonance_1_1" if kind == "fold" else "resonance_1_2": float(p @ q)}


def degeneracy(local: LocalMap, kind: str, kappa: float = 0.0) -> float:
    """The coefficient whose zero is the point ``DEGENERATE[kind]``; NaN where the pair is real.

    The sign of the coefficient of a fold depends on that of the critical eigenvector.
    """
    p, q, multiplier = local.critical(kind, kappa)
    if kind == "fold":
        return fold_coefficient(local, p, q)
    if kind == "period_doubling":
        return flip_coefficient(local, p, q)
    if abs(multiplier.imag) < REAL_PAIR:
        return float("nan")
    return (torus_coefficient(local, p, q, multiplier / abs(multiplier)) / (p.conj() @ q)).real


def is_zero(located: float, before: float, after: float) -> bool:
    """Whether a change of the sign of a test function is a zero, not a pole or a jump."""
    return abs(located) < POLE * max(abs(before), abs(after))


def others_are_complex(local: LocalMap, kind: str, kappa: float) -> bool:
    """Whether the pair with the product one, besides the critical multipliers, lies on the unit circle."""
    return abs(_nearest_pair(_others(local, kind, kappa))[0].imag) > REAL_PAIR


def other_kappa(local: LocalMap, kind: str, kappa: float) -> float:
    """Half the sum of the pair whose product is nearest to one, besides the critical multipliers if two are left."""
    others = _others(local, kind, kappa)
    pair = _nearest_pair(others if others.size > 1 else eigenvalues(local.A))
    return float((pair[0] + pair[1]).real) / 2


def _others(local: LocalMap, kind: str, kappa: float) -> NDArray[np.complex128]:
    """The multipliers without those that are critical along the curve."""
    multipliers = eigenvalues(local.A)
    if kind in KINDS:
        _, _, multiplier = local.critical(kind, kappa)
        for critical in (multiplier, multiplier.conjugate())[: 2 if kind == "neimark_sacker" else 1]:
            multipliers = np.delete(multipliers, int(np.argmin(np.abs(multipliers - critical))))
    return multipliers


def _nearest_pair(multipliers: NDArray[np.complex128]) -> tuple[complex, complex]:
    """The two multipliers whose product is nearest to one."""
    return min(combinations(multipliers, 2), key=lambda pair: abs(pair[0] * pair[1] - 1))


def _double(kind: str, other: str) -> str:
    """Type of the point at which two bifurcations of different multipliers meet; empty for two folds or two flips."""
    if kind == other:
        return "double_neimark_sacker" if kind == "neimark_sacker" else ""
    first, second = sorted((kind, other), key=list(SHORT).index)
    return f"{SHORT[first]}_{SHORT[second]}"


def _products(multipliers: NDArray[np.complex128]) -> dict[str, float]:
    pairs = [a * b - 1 for a, b in combinations(multipliers, 2)]
    return {
        "fold": float(np.prod(1 - multipliers).real),
        "period_doubling": float(np.prod(1 + multipliers).real),
        "neimark_sacker": float(np.prod(pairs).real) if pairs else 1.0,
    }
