"""Reference motion of the joints over the time since the last impact: a curve with breakpoints.

Each piece is smooth, a Chebyshev series on [start, end]; pieces meet at breakpoints, where the curve may have
a kink or, with ``off``, cease to act. The last piece holds for all later times up to ``horizon``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from casadi import SX, horzsplit, reshape, vertcat, vertsplit
from numpy.polynomial import chebyshev

from gaitopt.arrays import Array

BLOCK = 6
"""Terms of a series that are summed directly; about the root of their number, which is 33 for a phase of walking."""


class BeyondEnd(StrEnum):
    """What a reference does past its own end."""

    FLOW = "flow"
    LINEAR = "linear"
    HOLD = "hold"
    OFF = "off"


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A smooth piece of the curve.

    Attributes
    ----------
    start, end : time since impact [s]; ``end`` scales the series and does not have to be reached.
    angles : ndarray, shape (n_u, degree + 1) - Chebyshev coefficients of the angles [rad].
    rates : ndarray, shape (n_u, degree + 1) - of their rates [rad/s].
    active : False where the control is switched off.
    """

    start: float
    end: float
    angles: Array
    rates: Array
    active: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """Pieces in order of time; ``horizon`` is the time since impact up to which they are valid [s]."""

    pieces: tuple[Piece, ...]
    horizon: float = np.inf

    @property
    def degree(self) -> int:
        """Largest degree of all series."""
        return max(len(table.T) for piece in self.pieces for table in (piece.angles, piece.rates)) - 1

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times since impact at which one piece ends and the next begins [s]."""
        return tuple(piece.start for piece in self.pieces[1:])

    def data(self, segment: int) -> Array:
        """The numbers of one piece in the layout that ``evaluate`` reads."""
        piece, width = self.pieces[segment], self.degree + 1
        series = [np.pad(row, (0, width - row.size)) for table in (piece.angles, piece.rates) for row in table]
        return np.concatenate([[piece.start, piece.end, float(piece.active)], *series])

    def __call__(self, times: Sequence[float] | Array) -> tuple[Array, Array]:
        """Angles [rad] and rates [rad/s] at times since impact [s]; both of shape (n_u, n)."""
        t = np.asarray(times, dtype=float)
        index = np.searchsorted(self.breakpoints, t, side="right")
        columns = [self._at(self.pieces[k], s) for k, s in zip(index, t, strict=True)]
        angles, rates = zip(*columns, strict=True)
        return np.column_stack(angles), np.column_stack(rates)

    @staticmethod
    def _at(piece: Piece, t: float) -> tuple[Array, Array]:
        s = 2 * (t - piece.start) / (piece.end - piece.start) - 1
        angles, rates = (np.asarray(chebyshev.chebval(s, table.T)) for table in (piece.angles, piece.rates))
        return angles, rates


def evaluate(data: SX, t: SX, n_tracked: int, degree: int, weights: tuple[SX, SX]) -> tuple[SX, SX]:
    """Weighted sums of angle and rate of every joint, and the activity, from the layout of ``Reference.data``.

    The series are added before they are evaluated, as half as many remain.
    """
    s = 2 * (t - data[0]) / (data[1] - data[0]) - 1
    angles, rates = (reshape(rows, degree + 1, n_tracked) for rows in vertsplit(data[3:], (degree + 1) * n_tracked))
    powers = _chebyshev(s)
    sums = horzsplit(weights[0] * angles + weights[1] * rates)
    return vertcat(*(_sum(vertsplit(c), powers) for c in sums)), data[2]


def continued(pieces: Sequence[Piece], end: float, beyond_end: BeyondEnd) -> Reference:
    """``pieces`` that end at ``end``, followed by ``linear``, ``hold`` or ``off``.

    ``flow`` needs the equations of motion of the reference's own walker and is not built here.
    """
    last = pieces[-1]
    angles, rates = Reference._at(last, end)
    if beyond_end is not BeyondEnd.LINEAR:
        rates = np.zeros_like(rates)
    # on [end, end + 1] the series variable is s = 2 (t - end) - 1, so that angle = (angle + rate/2) + rate/2 s
    tail = Piece(
        start=end,
        end=end + 1.0,
        angles=np.column_stack([angles + rates / 2, rates / 2]),
        rates=rates[:, None],
        active=beyond_end is not BeyondEnd.OFF,
    )
    return Reference(pieces=(*pieces, tail))


def _chebyshev(s: SX) -> list[SX]:
    """T_0, ..., T_BLOCK at ``s``, by T_2k = 2 T_k^2 - 1 and T_2k+1 = 2 T_k T_k+1 - T_1."""
    values = [SX(1), s]
    for k in range(2, BLOCK + 1):
        values.append(2 * values[k // 2] * values[(k + 1) // 2] - values[k % 2])
    return values


def _sum(c: list[SX], T: list[SX]) -> SX:
    """Chebyshev series sum_k c_k T_k from T_0, ..., T_m: blocks of m terms, and Clenshaw's recurrence over T_jm.

    With T_jm+k = 2 T_jm T_k - T_jm-k the series is sum_j q_j T_jm, where q_j is a sum over T_0, ..., T_m-1 and T_jm is
    T_j(T_m). It takes a product of variables per block instead of one per term: those are what a Taylor series of the
    motion spends its time on.
    """
    m, c = len(T) - 1, list(c)
    for n in reversed(range(m + 1, len(c))):
        if n % m:
            c[n - 2 * (n % m)] -= c[n]
            c[n] = 2 * c[n]
    blocks = [sum(a * b for a, b in zip(c[j : j + m], T, strict=False)) for j in range(0, len(c), m)]
    b1, b2 = SX(0), SX(0)
    for q in reversed(blocks[1:]):
        b1, b2 = q + 2 * T[m] * b1 - b2, b1
    return blocks[0] + T[m] * b1 - b2
