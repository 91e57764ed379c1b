"""Existence and uniqueness of a zero of F on a box, by Krawczyk's operator, and the derivative of the return map.

    K(s) = -C F(centre + tilt s) + (1 - C F_u(box)) w,        C an approximate inverse of F_u

If K lies in the interior of the box of deviations w for every s, F has exactly one zero in it for every s, and it lies
in K. By the mean value theorem F(centre + tilt s) = F(centre) + (F_u tilt + F_mu half) s with derivatives on the box.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import arb, arb_mat

from gaitopt.proof.graph import NotProved
from gaitopt.proof.orbit import Box, Orbit, Passage, by_columns
from gaitopt.proof.taylor import matrix
from gaitopt.proof.tilted import UNIT, Tilted, at, hull, scattered

HALF_SQUARE = arb(0.25, 0.25)
"""s^2 / 2, the integral of s."""
ROUNDS = 4
"""In which the derivative of the orbit in its start is narrowed."""


@dataclass(frozen=True, slots=True)
class Defect:
    """E = C F_u - 1 by groups of columns, that of the parameter, C F_mu, included; and C by its first columns."""

    C: np.ndarray
    columns: dict[int, Any]

    def inverse(self, first: int, count: int) -> arb_mat:
        """Some columns of C."""
        return exact(self.C[:, first : first + count])

    def times(self, values: Any) -> Any:
        """E times some columns."""
        n, columns = self.C.shape[0], hull(values).ncols()
        entries, total = scattered(values, arb_mat.entries), arb_mat(n, columns)
        for first, block in self.columns.items():
            if first < n:
                rows = entries[first * columns : (first + hull(block).ncols()) * columns]
                total += block * matrix(columns, rows)
        return total


def exact(values: np.ndarray) -> arb_mat:
    """Doubles as a matrix."""
    return arb_mat(*values.shape, values.ravel().tolist())


def column(values: Sequence[arb]) -> arb_mat:
    """A vector as a matrix."""
    return arb_mat(len(values), 1, list(values))


def middle(orbit: Orbit, passage: Passage) -> np.ndarray:
    """dF/du next to the middle of its enclosure, and dF/dmu as the last column; shape (n, n + 1)."""
    matrix = np.eye(orbit.size, orbit.size + 1)
    matrix[orbit.durations, orbit.durations] = 0.0
    for row, first, values in passage.blocks:
        block = np.array([[float(value.mid()) for value in entries] for entries in at(values, arb(0)).tolist()])
        matrix[row : row + block.shape[0], first : first + block.shape[1]] += block
    return matrix


def preconditioned(orbit: Orbit, passage: Passage) -> Defect:
    """E on a box.

    Raises
    ------
    NotProved
        If the derivative is singular.
    """
    try:
        C = np.linalg.inv(middle(orbit, passage)[:, :-1])
    except np.linalg.LinAlgError as failure:
        raise NotProved("the derivative of the equations of the orbit is singular") from failure
    defect, unit = Defect(C, {}), np.eye(orbit.size)
    for first in (entry for nodes in orbit.nodes for entry in nodes):
        defect.columns[first] = defect.inverse(first, orbit.n) - exact(unit[:, first : first + orbit.n])
    for first in orbit.durations:
        defect.columns[first] = -exact(unit[:, first : first + 1])
    defect.columns[orbit.size] = arb_mat(orbit.size, 1)
    for row, first, values in passage.blocks:
        defect.columns[first] += defect.inverse(row, hull(values).nrows()) * values
    return defect


def krawczyk(orbit: Orbit, box: Box, passage: Passage, defect: Defect) -> Box:
    """K as a box about the same centre."""
    start = arb_mat(orbit.size, 1)
    for row, values in passage.residual.items():
        start -= defect.inverse(row, len(values)) * column(values)
    start -= hull(defect.times(column(box.deviation)))
    if not orbit.is_long:
        return Box(box.centre, box.tilt, start.entries())
    drift = column(box.tilt) + defect.times(column(box.tilt)) + defect.columns[orbit.size] * orbit.interval[1]
    start -= drift.slope * HALF_SQUARE
    tilt = [v - d for v, d in zip(box.tilt, drift.value.entries(), strict=True)]
    return Box(box.centre, tilt, start.entries())


def deviations(box: Box, image: Box) -> list[arb]:
    """The image of a box as deviations from the box's own centre and tilt."""
    return [(d - v) * UNIT + w for v, d, w in zip(box.tilt, image.tilt, image.deviation, strict=True)]


def require_contraction(orbit: Orbit, box: Box, image: Box) -> None:
    """Check that K lies in the interior of the box.

    Raises
    ------
    NotProved
        If it does not; the unknown that leaves farthest is named.
    """
    moved = deviations(box, image)
    outside = [k for k, (w, inside) in enumerate(zip(box.deviation, moved, strict=True)) if not w.contains_interior(inside)]
    if outside:
        k = max(outside, key=lambda k: float(moved[k].abs_upper()) / max(float(box.deviation[k].rad()), 1e-300))
        raise NotProved(f"Krawczyk's operator moves {orbit.name(k)} by {moved[k].str(5)}, out of {box.deviation[k].str(3)}")


def return_map(orbit: Orbit, box: Box, passage: Passage, defect: Defect) -> Any:
    """Derivative DP of the return map on the section after the last impact, shape (n_xi, n_xi).

    A kick to the start of the cycle moves the orbit that stays periodic with it by H = (1 - DP)^-1. With Y = C kick,
    X = F_u^-1 kick is Y - E X, and as |E| w < w is proved, |X| <= w max(|Y| / w) / (1 - max(|E| w / w)).
    """
    section = orbit.section(orbit.sequence.impact)
    n_xi, w = len(section), [arb(value.rad()) for value in box.deviation]
    lift = scattered(by_columns(orbit.lift_jacobian(passage.starts[0])[0], orbit.n), arb_mat.entries)
    full = len(lift) // orbit.n
    Y = defect.inverse(0, orbit.n) * matrix(n_xi, [lift[k * full + i] for k in range(orbit.n) for i in range(n_xi)])
    contraction = _largest(hull(defect.times(column([arb(0, r) for r in w]))).entries(), w)
    if not contraction < 1:
        raise NotProved(f"the derivative of the return map cannot be enclosed: {contraction.str(5)} is not below 1")
    rows = hull(Y).tolist()
    sizes = [_largest([row[k] for row in rows], w) / (1 - contraction) for k in range(n_xi)]
    X: Any = arb_mat([[arb(0, (r * size).upper()) for size in sizes] for r in w])
    for _ in range(ROUNDS):
        X = Y - defect.times(X)
    entries = scattered(X, arb_mat.entries)
    H = matrix(n_xi, [entries[k * n_xi + i] for k in section for i in range(n_xi)])
    return exact(np.eye(n_xi)) - H.inv()


def _largest(values: Sequence[arb], w: Sequence[arb]) -> arb:
    """The largest of values relative to half widths."""
    return max(arb((value.abs_upper() / r).upper()) for value, r in zip(values, w, strict=True))
