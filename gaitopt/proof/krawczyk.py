"""Existence and uniqueness of a zero of F on a box, by Krawczyk's operator, and the derivative of the return map.

    K(s) = -C(s) F(centre + tilt s) + (1 - C(s) F_u(s)) w,        C an approximate inverse of F_u

If K lies in the interior of the box of deviations w for every s, F has exactly one zero in it for every s, and it lies
in K. With dF/ds = g + g' s, F(centre + tilt s) = F(centre) + g s + g' s^2 / 2 by the mean value theorem.
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

SQUARE = arb(0.5, 0.5)
"""s^2."""
ROUNDS, LITTLE = 50, 0.9
"""In which the derivative of the orbit in its start is narrowed at most, and by how much in a round at least."""


@dataclass(frozen=True, slots=True)
class Defect:
    """E = C F_u - 1 by groups of columns, and C by its first columns: a value, and a slope if a parameter varies."""

    C: np.ndarray
    slope: np.ndarray | None
    columns: dict[int, Any]

    def inverse(self, first: int, count: int) -> Any:
        """Some columns of C."""
        value = exact(self.C[:, first : first + count])
        return value if self.slope is None else Tilted(value, exact(self.slope[:, first : first + count]))

    def times(self, values: Any) -> Any:
        """E times some columns."""
        columns = hull(values).ncols()
        entries, total = scattered(values, arb_mat.entries), arb_mat(self.C.shape[0], columns)
        for first, block in self.columns.items():
            total += block * matrix(columns, entries[first * columns : (first + hull(block).ncols()) * columns])
        return total


def exact(values: np.ndarray) -> arb_mat:
    """Doubles as a matrix."""
    rows, columns = values.shape
    return arb_mat(rows, columns, values.ravel().tolist())


def column(values: Sequence[Any]) -> Any:
    """A vector as a matrix."""
    return matrix(1, values)


def middle(orbit: Orbit, passage: Passage, s: int = 0) -> np.ndarray:
    """dF/du next to the middle of its enclosure at some s, and dF/dmu as the last column; shape (n, n + 1)."""
    result = np.eye(orbit.size, orbit.size + 1)
    result[orbit.durations, orbit.durations] = 0.0
    for row, first, values in passage.blocks:
        block = np.array([[float(value.mid()) for value in entries] for entries in at(values, arb(s)).tolist()])
        result[row : row + block.shape[0], first : first + block.shape[1]] += block
    return result


def preconditioned(orbit: Orbit, passage: Passage) -> Defect:
    """E on a box.

    Raises
    ------
    NotProved
        If the derivative is singular.
    """
    F_u, slope = middle(orbit, passage)[:, :-1], None
    try:
        C = np.linalg.inv(F_u)
    except np.linalg.LinAlgError as failure:
        raise NotProved("the derivative of the equations of the orbit is singular") from failure
    if orbit.is_long:
        slope = -C @ (middle(orbit, passage, 1)[:, :-1] - F_u) @ C
    defect, unit = Defect(C, slope, {}), np.eye(orbit.size)
    for first in (entry for nodes in orbit.nodes for entry in nodes):
        defect.columns[first] = defect.inverse(first, orbit.n) - exact(unit[:, first : first + orbit.n])
    for first in orbit.durations:
        defect.columns[first] = -exact(unit[:, first : first + 1])
    for row, first, values in passage.blocks:
        if first < orbit.size:
            defect.columns[first] += defect.inverse(row, hull(values).nrows()) * values
    return defect


def krawczyk(orbit: Orbit, box: Box, line: Passage, defect: Defect) -> Box:
    """K as a box about the same centre, from the motions along ``centre + tilt s`` at least."""
    start = -defect.times(column(box.deviation))
    for row, values in line.residual.items():
        start -= defect.inverse(row, len(values)) * column(values)
    start = hull(start)
    if not orbit.is_long:
        return Box(box.centre, box.tilt, start.entries())
    drift, change = Tilted(arb_mat(orbit.size, 1), arb_mat(orbit.size, 1)), _change(orbit, box, line)
    for first, block in defect.columns.items():
        g = column(change[first : first + hull(block).ncols()])
        drift += defect.inverse(first, hull(g).nrows()) * (Tilted(g.value, g.slope / 2) if isinstance(g, Tilted) else g)
    tilt = [v - d for v, d in zip(box.tilt, drift.value.entries(), strict=True)]
    return Box(box.centre, tilt, (start - drift.slope * SQUARE).entries())


def _change(orbit: Orbit, box: Box, line: Passage) -> list[Any]:
    """dF/ds = F_u tilt + F_mu half."""
    change: list[Any] = [arb(0) if k in orbit.durations else v for k, v in enumerate(box.tilt)]
    tilt = [*box.tilt, orbit.interval[1]]
    for row, first, values in line.blocks:
        moved = values * column(tilt[first : first + hull(values).ncols()])
        for k, value in enumerate(scattered(moved, arb_mat.entries), start=row):
            change[k] = change[k] + value
    return change


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
    pairs = list(zip(box.deviation, moved, strict=True))
    outside = [k for k, (w, inside) in enumerate(pairs) if not w.contains_interior(inside)]
    if outside:
        k = max(outside, key=lambda k: float(moved[k].abs_upper()) / max(float(box.deviation[k].rad()), 1e-300))
        shown = f"{moved[k].str(5)}, out of {box.deviation[k].str(3)}"
        raise NotProved(f"Krawczyk's operator moves {orbit.name(k)} by {shown}")


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
        before, X = X, Y - defect.times(X)
        if not _width(X) < LITTLE * _width(before):
            break
    entries = scattered(X, arb_mat.entries)
    H = matrix(n_xi, [entries[k * n_xi + i] for k in section for i in range(n_xi)])
    try:
        return exact(np.eye(n_xi)) - H.inv()
    except ZeroDivisionError as failure:
        raise NotProved("the derivative of the return map cannot be enclosed: a multiplier may be one") from failure


def _width(X: Any) -> float:
    return max(float(x.rad()) for x in hull(X).entries())


def _largest(values: Sequence[arb], w: Sequence[arb]) -> arb:
    """The largest of values relative to half widths."""
    return max(arb((value.abs_upper() / r).upper()) for value, r in zip(values, w, strict=True))
