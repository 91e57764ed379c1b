"""Curves that joints follow: piecewise polynomials in the time since the last impact, or in a phase variable.

On the piece from x_0 to x_1, with s = (x - x_0) / (x_1 - x_0), the angle of each joint is one of

    sum_k c_k T_k(2 s - 1)                                 c_k are numbers: coefficients of a Chebyshev series
    sum_k c_k B_k(s),  B_k(s) = C(n, k) s^k (1 - s)^(n - k)        c_k are parameters: control points

Parameters can be set, freed and continued. A curve of control points stays within their range, starts at the first one,
and ends at the last one with the rate n (c_n - c_(n-1)) / (x_1 - x_0). A constant has a single control point.

Pieces of time meet at breakpoints, where the curve may have a kink or, with ``off``, the control ends. In a phase
variable a breakpoint would be an event of the motion, so that curves over a phase have one piece.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import pairwise
from math import comb, inf
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
from casadi import SX, horzsplit, reshape, vertcat, vertsplit

from gaitopt.arrays import Array
from gaitopt.model.instant import Instant

BLOCK = 6
"""Number of terms of a series that are summed directly: about the root of all, which are 33 for a phase of walking."""
Number: TypeAlias = Any
"""A float, an array of floats, a CasADi symbol or a ball of a proof: only + - * / are needed."""
Row: TypeAlias = tuple[Number, ...]
"""Coefficients of one angle on one piece."""


class BeyondEnd(StrEnum):
    """Continuation of a curve in time after its end."""

    FLOW = "flow"
    LINEAR = "linear"
    HOLD = "hold"
    OFF = "off"


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A smooth piece of a curve.

    Attributes
    ----------
    start, end : time since impact [s], or phase; ``end`` scales the polynomials, and a motion may end earlier.
    rows : Chebyshev coefficients of each angle [rad, or m]; empty if the coefficients are parameters.
    active : whether the control acts.
    """

    start: Number
    end: Number
    rows: tuple[Row, ...] = ()
    active: bool = True

    @property
    def slopes(self) -> tuple[Row, ...]:
        """Chebyshev coefficients of the derivative of each angle: c'_(k-1) = c'_(k+1) + 2 k c_k on [-1, 1]."""
        length, rows = self.end - self.start, list[Row]()
        for row in self.rows:
            zero = 0 * row[0]
            slopes = [zero] * (len(row) + 1)
            for k in range(len(row) - 1, 0, -1):
                slopes[k - 1] = slopes[k + 1] + 2 * k * row[k]
            slopes[0] = slopes[0] / 2
            rows.append(tuple(2 * slope / length for slope in slopes[: max(len(row) - 1, 1)]))
        return tuple(rows)

    def fraction(self, x: Number) -> Number:
        """s at a time or phase."""
        return (x - self.start) / (self.end - self.start)


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """One curve per joint.

    Attributes
    ----------
    names : the joints, in the order of the rows of ``pieces``.
    pieces : pieces in order of time, or a single one over a phase.
    horizon : time since impact up to which the pieces are defined [s].
    points : control points of each joint [rad, or m], if they are parameters: those of the first piece. They determine
        a second piece, which continues the first one after its end according to ``beyond_end``.
    bounds : bounds of the parameters that a design determines, by key.
    phase : the phase variable over which the curves run; empty if it is the time since the impact.
    beyond_end : continuation after the end of curves in time; None if they have none.
    fit_errors : largest distance of fitted curves from their data, by joint [rad, or m]; empty if nothing is fitted.
    """

    names: tuple[str, ...]
    pieces: tuple[Piece, ...]
    horizon: float = inf
    points: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    phase: str = ""
    beyond_end: BeyondEnd | None = None
    fit_errors: Mapping[str, float] = field(default_factory=dict)

    @property
    def parameters(self) -> Mapping[str, float]:
        """Values of the scalars that can be set, freed or continued, by key."""
        return {key: c for name, row in self.points.items() for key, c in zip(keys(name, row), row, strict=True)}

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times since impact at which one piece ends and the next begins [s]."""
        return tuple(piece.start for piece in self.pieces[1:])

    @property
    def continues(self) -> bool:
        """Whether the last piece follows from the others by ``beyond_end``."""
        return self.beyond_end not in (None, BeyondEnd.FLOW)

    @property
    def stated(self) -> tuple[Piece, ...]:
        """The pieces up to the end, without the one that continues them."""
        return self.pieces[:-1] if self.continues else self.pieces

    def data(self, segment: int) -> Array:
        """The numbers of a piece that expressions read, shape (n_r,)."""
        return np.array(piece_data(self.pieces, segment), dtype=float)

    def weighted(self, now: Instant, p: SimpleNamespace, weights: tuple[Number, Number]) -> tuple[SX, SX]:
        """Weighted sum of angle and rate of every joint, shape (n,), and a factor: 0 if the control is off, else 1.

        Parameters
        ----------
        now : an instant of a law whose segment data are those of the curve.
        p : the curve's own parameters by name.
        weights : weights of angle and rate.
        """
        x, rate = (getattr(now.s, self.phase), getattr(now.ds, self.phase)) if self.phase else (now.t, 1)
        return self.at(x, rate, now.r, p, weights)

    def at(self, x: SX, rate: Number, r: SX, p: SimpleNamespace, weights: tuple[Number, Number]) -> tuple[SX, SX]:
        """The results of ``weighted`` at a time or phase ``x`` that changes at the rate ``rate``.

        Parameters
        ----------
        r : SX - segment data, see ``data``.
        """
        weights, piece = (weights[0], weights[1] * rate), Piece(start=r[0], end=r[1])
        acts = SX(1) if all(each.active for each in self.pieces) else r[2]
        if not self.points:
            # The series of angle and rate are added before they are evaluated, which halves their number.
            width, n = _width(self.pieces), len(self.names)
            angles, slopes = (reshape(rows, width, n) for rows in vertsplit(r[3:], width * n))
            powers = _chebyshev(2 * piece.fraction(x) - 1)
            sums = horzsplit(weights[0] * angles + weights[1] * slopes)
            return vertcat(*(_sum(vertsplit(c), powers) for c in sums)), acts
        total, s, length = SX.zeros(len(self.names)), piece.fraction(x), r[1] - r[0]
        columns = [getattr(p.constant if len(row) == 1 else p, name) for name, row in self.points.items()]
        for k in range(len(self.pieces)):
            rows = [self._row(k, vertsplit(column)) for column in columns]
            selected = r[3 + k] if len(self.pieces) > 1 else 1
            total += selected * vertcat(*(_weighted_bezier(row, s, length, weights) for row in rows))
        return total, acts

    def __call__(self, x: Sequence[float] | Array) -> tuple[Array, Array]:
        """Angles and their derivatives at times since impact [s], or phases; both of shape (n_joints, n)."""
        x = np.asarray(x, dtype=float)
        index = np.searchsorted(self.breakpoints, x, side="right")
        angles, slopes = np.empty((len(self.names), x.size)), np.empty((len(self.names), x.size))
        for k, piece in enumerate(self.pieces):
            at, s = index == k, piece.fraction(x[index == k])
            if self.points:
                for j, points in enumerate(self.points.values()):
                    row, length = self._row(k, points), piece.end - piece.start
                    angles[j, at] = _weighted_bezier(row, s, length, (1, 0))
                    slopes[j, at] = _weighted_bezier(row, s, length, (0, 1))
            else:
                powers = _chebyshev(2 * s - 1)
                for rows, values in ((piece.rows, angles), (piece.slopes, slopes)):
                    values[:, at] = [_sum(row, powers) for row in rows]
        return angles, slopes

    def _row(self, k: int, points: Sequence[Number]) -> Sequence[Number]:
        """Control points of a piece; after the end they are those of a line, or of a constant."""
        if k == 0 or self.beyond_end is BeyondEnd.OFF:
            return points
        if self.beyond_end is BeyondEnd.HOLD:
            return points[-1:]
        return points[-1], points[-1] + (len(points) - 1) * (points[-1] - points[-2])


def keys(name: str, row: Sequence[object]) -> tuple[str, ...]:
    """Keys of the parameters of a joint: ``JOINT.K`` for control point K, ``constant.JOINT`` for a constant."""
    return (f"constant.{name}",) if len(row) == 1 else tuple(f"{name}.{k}" for k in range(len(row)))


def bezier_curve(
    points: Mapping[str, tuple[float, ...]],
    span: tuple[float, float],
    *,
    phase: str = "",
    beyond_end: BeyondEnd | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    fit_errors: Mapping[str, float] | None = None,
) -> Curve:
    """The curves of control points over the time, or a phase, from ``span[0]`` to ``span[1]``."""
    return Curve(
        names=tuple(points),
        pieces=bezier_pieces(span, beyond_end),
        points=points,
        phase=phase,
        beyond_end=beyond_end,
        bounds=bounds or {},
        fit_errors=fit_errors or {},
    )


def bezier_pieces(span: tuple[Number, Number], beyond_end: BeyondEnd | None) -> tuple[Piece, ...]:
    """The piece of curves of control points; curves in time have another one of the same length after it."""
    (start, end), active = span, beyond_end is not BeyondEnd.OFF
    first = Piece(start=start, end=end)
    return (first,) if beyond_end is None else (first, Piece(start=end, end=end + (end - start), active=active))


def continued(names: tuple[str, ...], pieces: Sequence[Piece], end: float, beyond_end: BeyondEnd) -> Curve:
    """The curves of some pieces up to the time ``end`` [s] with their continuation: ``linear``, ``hold`` or ``off``."""
    tail = continuation(pieces[-1], end, beyond_end)
    return Curve(names=names, pieces=(*pieces, tail), beyond_end=beyond_end)


def continuation(last: Piece, end: Number, beyond_end: BeyondEnd) -> Piece:
    """The piece that continues a series after the time ``end`` [s]: ``linear``, ``hold`` or ``off``.

    The continuation ``flow`` needs the equations of motion of a walker; see ``gaitopt.systems``.
    """
    powers, rows = _chebyshev(2 * last.fraction(end) - 1), list[Row]()
    for row, slopes in zip(last.rows, last.slopes, strict=True):
        angle, rate = _sum(row, powers), _sum(slopes, powers)
        half = (rate if beyond_end is BeyondEnd.LINEAR else 0 * rate) / 2
        rows.append((angle + half, half))  # on [end, end + 1] the series is angle + rate (t - end)
    return Piece(start=end, end=end + 1, rows=tuple(rows), active=beyond_end is not BeyondEnd.OFF)


def piece_data(pieces: Sequence[Piece], segment: int) -> list[Number]:
    """The numbers of a piece that ``Curve.at`` reads; all pieces of a curve have equally many.

    These are its start, its end, and 1 if it is active, otherwise 0. Then follow the rows of its angles and of their
    slopes or, if coefficients are parameters, 1 for this piece and 0 for the others.
    """
    piece = pieces[segment]
    head, rows = [piece.start, piece.end, int(piece.active)], (*piece.rows, *piece.slopes)
    if not rows:
        return [*head, *([int(k == segment) for k in range(len(pieces))] if len(pieces) > 1 else ())]
    width = _width(pieces)
    return [*head, *(c for row in rows for c in (*row, *(0,) * (width - len(row))))]


def control_points(phases: Array, angles: Array, degree: int) -> tuple[Array, Array]:
    """Curves that fit ``angles`` (n, m) at ``phases`` (m,) from 0 to 1 best.

    Returns
    -------
    points : ndarray, shape (n, degree + 1) - control points.
    errors : ndarray, shape (n,) - largest errors at these phases.
    """
    basis = bernstein_matrix(degree, phases)
    points = np.linalg.lstsq(basis, angles.T, rcond=None)[0]
    return np.asarray(points.T, dtype=float), np.abs(basis @ points - angles.T).max(axis=0)


def bernstein_matrix(degree: int, s: Array, order: int = 0) -> Array:
    """Derivatives of the given order of B_0, ..., B_degree at ``s`` (N,); shape (N, degree + 1)."""
    if order == 0:
        return np.column_stack(_bernstein(degree, s))
    differences = degree * (np.eye(degree, degree + 1, 1) - np.eye(degree, degree + 1))
    return bernstein_matrix(degree - 1, s, order - 1) @ differences


def _width(pieces: Sequence[Piece]) -> int:
    """Number of coefficients of the longest series."""
    return max(len(row) for piece in pieces for row in piece.rows)


def _weighted_bezier(c: Sequence[Number], s: Number, length: Number, weights: tuple[Number, Number]) -> Number:
    """Weighted sum of a curve of control points and its derivative, at the fraction s of a piece of this length."""
    n = len(c) - 1
    angle = sum((a * b for a, b in zip(c, _bernstein(n, s), strict=True)), start=0 * s)
    slopes = (n * (b - a) / length for a, b in pairwise(c))
    slope = sum((a * b for a, b in zip(slopes, _bernstein(n - 1, s), strict=True)), start=0 * s)
    return weights[0] * angle + weights[1] * slope


def _bernstein(degree: int, s: Number) -> list[Number]:
    """B_k(s) for all k, with products instead of powers, because the power of a symbol has no derivative at 0."""
    rising, falling = [0 * s + 1], [0 * s + 1]
    for _ in range(degree):
        rising.append(rising[-1] * s)
        falling.append(falling[-1] * (1 - s))
    return [comb(degree, k) * rising[k] * falling[degree - k] for k in range(degree + 1)]


def _chebyshev(s: Number) -> list[Number]:
    """T_0, ..., T_BLOCK at ``s``, by T_2k = 2 T_k^2 - 1 and T_2k+1 = 2 T_k T_k+1 - T_1."""
    values = [0 * s + 1, s]
    for k in range(2, BLOCK + 1):
        values.append(2 * values[k // 2] * values[(k + 1) // 2] - values[k % 2])
    return values


def _sum(c: Sequence[Number], T: Sequence[Number]) -> Number:
    """Chebyshev series sum_k c_k T_k from T_0, ..., T_m: blocks of m terms, and Clenshaw's recurrence over T_jm.

    With T_jm+k = 2 T_jm T_k - T_jm-k the series is sum_j q_j T_jm, where q_j is a sum over T_0, ..., T_m-1 and T_jm is
    T_j(T_m). This takes one product of variables per block instead of one per term. Such products dominate the cost of
    a Taylor series of the motion.
    """
    m, c = len(T) - 1, list(c)
    for n in reversed(range(m + 1, len(c))):
        if n % m:
            c[n - 2 * (n % m)] = c[n - 2 * (n % m)] - c[n]
            c[n] = 2 * c[n]
    blocks = [sum((a * b for a, b in zip(c[j : j + m], T, strict=False)), start=0 * T[0]) for j in range(0, len(c), m)]
    b1, b2 = 0 * T[0], 0 * T[0]
    for q in reversed(blocks[1:]):
        b1, b2 = q + 2 * T[m] * b1 - b2, b1
    return blocks[0] + T[m] * b1 - b2
