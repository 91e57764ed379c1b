"""How far a point is from being optimal: the first-order conditions of Karush, Kuhn and Tucker, nothing smoothed.

    min over l >= 0 of | grad f - sum l_i grad c_i |,        c_i the active constraints; l_i of any sign for equalities

in the freed parameters and levels of ``reduced``, each in its typical size, f relative to itself. A level whose
derivative must vanish as well makes the hull of the gradients of a maximum. Moduli of multipliers that coalesce are
not Lipschitz; the inequalities of ``nlp.moduli`` that stand for them are smooth.
"""

import numpy as np

from gaitopt.arrays import Array
from gaitopt.nlp.design.quadratic import nonnegative
from gaitopt.nlp.design.reduced import Point
from gaitopt.nlp.design.trust_region import SMALL

ACTIVE = 1e-7
"""A constraint is active where so small a change of the unknowns, relative to their sizes, would violate it."""
NEGLIGIBLE = 1e-6
"""Gradient of a constraint, in its natural unit and sizes, below which the unknowns do not govern it."""


def kkt_residual(point: Point, sizes: Array) -> tuple[float, dict[str, float]]:
    """Residual of the optimality conditions at a point, and the multipliers that make it least.

    Parameters
    ----------
    sizes : typical sizes of the unknowns, shape (n_u,); the objective's is its value.
    """
    gradient = point.gradient * sizes / objective_size(point)
    rows, columns = [], []
    for row in point.rows:
        column = row.gradient * sizes
        length = float(np.linalg.norm(column))
        if length > NEGLIGIBLE and (row.equality or row.value / length <= ACTIVE):
            for sign in (1.0, -1.0) if row.equality else (1.0,):
                rows.append((row, sign / length))
                columns.append(sign * column / length)
    if not columns:
        return float(np.linalg.norm(gradient)), {}
    basis = np.array(columns).T
    weights = nonnegative(basis, gradient)
    residual = np.linalg.norm(basis @ weights - gradient)
    multipliers: dict[str, float] = {}
    for (row, scale), weight in zip(rows, weights, strict=True):
        if weight > 0:
            multipliers[row.key] = multipliers.get(row.key, 0.0) + scale * weight
    return float(residual), multipliers


def objective_size(point: Point) -> float:
    """Typical size of what is minimised."""
    return max(abs(point.objective), SMALL)
