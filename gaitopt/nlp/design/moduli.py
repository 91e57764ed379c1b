"""All multipliers within a circle, as three inequalities that are polynomials of the return map's derivative.

    det(I - A) >= 0,     det(I + A) >= 0,     det(I - A ^ A) >= 0,          A = DPi / rho

with the second compound A ^ A, whose eigenvalues are the products of two: the boundary of the matrices whose
multipliers lie within rho consists of those with a multiplier at rho, at -rho, or with two whose product is rho^2, a
complex pair on the circle. Jury (1964). They are smooth where multipliers meet and turn complex, while the modulus
there is not even Lipschitz. They hold again where two leave the circle at once, so that they serve near a solution.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gaitopt.arrays import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class CircleRow:
    """One of the inequalities: its value, and derivatives by the matrix, shape (n, n), and by the radius."""

    name: str
    value: float
    by_matrix: Array
    by_radius: float


def circle_rows(M: Array, radius: float) -> list[CircleRow]:
    """The inequalities for a matrix (n, n) and a radius; none of two where there is only one multiplier."""
    n = len(M)
    A = M / radius
    rows = []
    for name, sign in (("real", 1.0), ("negative", -1.0)):
        rows.append(_row(name, np.eye(n) - sign * A, -sign * _adjugate(np.eye(n) - sign * A).T, A, radius))
    if n > 1:
        pairs = list(combinations(range(n), 2))
        inside = np.eye(len(pairs)) - _compound(A, pairs)
        rows.append(_row("pair", inside, _through_compound(A, pairs, -_adjugate(inside).T), A, radius))
    return rows


def modulus_gradient(M: Array) -> tuple[float, Array]:
    """Largest modulus of a matrix's eigenvalues and its gradient, shape (n, n), where that eigenvalue is simple."""
    values, right = np.linalg.eig(M)
    k = int(np.argmax(np.abs(values)))
    left = np.linalg.inv(right)[k]
    slope = np.multiply.outer(left, right[:, k])
    return float(np.abs(values[k])), np.real(np.conj(values[k]) * slope / np.abs(values[k]))


def _row(name: str, inside: Array, by_A: Array, A: Array, radius: float) -> CircleRow:
    by_radius = -float(np.vdot(by_A, A)) / radius
    return CircleRow(name=name, value=float(np.linalg.det(inside)), by_matrix=by_A / radius, by_radius=by_radius)


def _adjugate(A: Array) -> Array:
    """det(A) A^-1, for singular matrices too; shape (n, n)."""
    U, s, Vt = np.linalg.svd(A)
    others = np.array([np.prod(np.delete(s, k)) for k in range(s.size)])
    return np.asarray(np.linalg.det(U) * np.linalg.det(Vt) * (Vt.T * others) @ U.T)


def _compound(A: Array, pairs: list[tuple[int, int]]) -> Array:
    """Minors of order two; shape (n_pairs, n_pairs)."""
    i, j = np.array(pairs).T
    return np.asarray(A[np.ix_(i, i)] * A[np.ix_(j, j)] - A[np.ix_(i, j)] * A[np.ix_(j, i)])


def _through_compound(A: Array, pairs: list[tuple[int, int]], weights: Array) -> Array:
    """Gradient in A of the minors weighted by ``weights``; shape (n, n)."""
    i, j = np.array(pairs).T
    by = np.zeros_like(A)
    np.add.at(by, np.ix_(i, i), weights * A[np.ix_(j, j)])
    np.add.at(by, np.ix_(j, j), weights * A[np.ix_(i, i)])
    np.add.at(by, np.ix_(i, j), -weights * A[np.ix_(j, i)])
    np.add.at(by, np.ix_(j, i), -weights * A[np.ix_(i, j)])
    return by
