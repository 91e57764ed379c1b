"""Control laws: joint torques u(t, q, dq), with t the time since the last impact.

    u = -kp (theta - theta_r(t)) - kd (dtheta - dtheta_r(t))              Gamus & Or (2013), section V, gait III

A law is smooth between its breakpoints, which are fixed times since the impact. On each segment between two breakpoints
it reads ``segment data`` r, so that one compiled function serves all segments.

A ``Reference`` theta_r consists of Chebyshev series, one piece per segment. Pieces meet at breakpoints, where the curve
may have a kink or, with ``off``, the control ends. The last piece applies up to ``horizon``.

``BezierTracking`` has Bezier curves whose control points c_k are parameters that can be set, freed or continued,

    theta_r(t) = sum_k c_k B_k(s),    B_k(s) = C(n, k) s^k (1 - s)^(n - k),    s = t / duration,    t < duration

Such a curve stays within the range of its control points. It starts at the first and ends at the last one, and its rate
at the end, n (c_n - c_(n-1)) / duration, determines its continuation.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import comb

import numpy as np
from casadi import SX, horzsplit, reshape, vertcat, vertsplit
from numpy.polynomial import chebyshev

from gaitopt.arrays import Array

BLOCK = 6
"""Terms of a series that are summed directly: about the root of their number, which is 33 for a phase of walking."""


class BeyondEnd(StrEnum):
    """Continuation of a reference after its end."""

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

    def __call__(self, t: float) -> tuple[Array, Array]:
        """Angles [rad] and rates [rad/s] at a time since impact [s], shape (n_u,) each."""
        s = 2 * (t - self.start) / (self.end - self.start) - 1
        angles, rates = (np.asarray(chebyshev.chebval(s, table.T)) for table in (self.angles, self.rates))
        return angles, rates


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """Pieces in order of time; they are defined up to ``horizon``, a time since impact [s]."""

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
        columns = [self.pieces[k](time) for k, time in zip(index, t, strict=True)]
        angles, rates = zip(*columns, strict=True)
        return np.column_stack(angles), np.column_stack(rates)


def evaluate(data: SX, t: SX, n_tracked: int, degree: int, weights: tuple[SX, SX]) -> tuple[SX, SX]:
    """Weighted sum of angle and rate of every joint, and whether the control acts, from ``Reference.data``.

    The series of angle and rate are added before they are evaluated, which halves their number.
    """
    s = 2 * (t - data[0]) / (data[1] - data[0]) - 1
    angles, rates = (reshape(rows, degree + 1, n_tracked) for rows in vertsplit(data[3:], (degree + 1) * n_tracked))
    powers = _chebyshev(s)
    sums = horzsplit(weights[0] * angles + weights[1] * rates)
    return vertcat(*(_sum(vertsplit(c), powers) for c in sums)), data[2]


def continued(pieces: Sequence[Piece], end: float, beyond_end: BeyondEnd) -> Reference:
    """The reference of ``pieces`` up to the time ``end``, then ``linear``, ``hold`` or ``off``.

    ``flow`` needs the equations of motion of the walker that moves so; see ``gaitopt.systems``.
    """
    last = pieces[-1]
    angles, rates = last(end)
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
    T_j(T_m). This takes one product of variables per block instead of one per term, and such products dominate the cost
    of a Taylor series of the motion.
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


class Control(ABC):
    """Base of the control laws."""

    @property
    @abstractmethod
    def parameters(self) -> Mapping[str, float]:
        """Values of the scalars that can be set, freed or continued, by their name in the problem file."""

    @property
    def unknowns(self) -> Mapping[str, tuple[float, float]]:
        """Bounds of the parameters that a design determines rather than the problem file."""
        return {}

    @abstractmethod
    def torque(self, t: SX, angles: SX, rates: SX, p: SX, r: SX) -> SX:
        """Torques u of shape (n_u,) [N m].

        Parameters
        ----------
        t : SX - time since the last impact [s].
        angles, rates : SX, shape (n_u,) - tracked shape coordinates [rad] and rates [rad/s].
        p : SX - the law's scalars, in the order of ``parameters``.
        r : SX - segment data.
        """

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times since impact at which a segment ends and the next begins [s]."""
        return ()

    @property
    def horizon(self) -> float:
        """Time since impact up to which the law is defined [s]."""
        return np.inf

    def data(self, segment: int) -> Array:
        """Segment data r, of the same length in all segments."""
        return np.zeros(0)


@dataclass(frozen=True, slots=True)
class NoControl(Control):
    """A passive walker: all torques are zero."""

    @property
    def parameters(self) -> Mapping[str, float]:
        """No scalars."""
        return {}

    def torque(self, t: SX, angles: SX, rates: SX, p: SX, r: SX) -> SX:
        """Zero."""
        return SX.zeros(angles.numel())


@dataclass(frozen=True, slots=True)
class ConstantTorque(Control):
    """Constant torques by actuator name, in the order of the walker's actuators [N m]."""

    torques: Mapping[str, float]

    @property
    def parameters(self) -> Mapping[str, float]:
        """The torques by actuator name."""
        return self.torques

    def torque(self, t: SX, angles: SX, rates: SX, p: SX, r: SX) -> SX:
        """The parameters."""
        return p


@dataclass(frozen=True, slots=True, kw_only=True)
class ProportionalDerivative(Control):
    """PD tracking of a reference whose clock restarts at every impact."""

    kp: float
    kd: float
    reference: Reference

    @property
    def parameters(self) -> Mapping[str, float]:
        """The gains kp [N m/rad] and kd [N m s/rad]."""
        return {"kp": self.kp, "kd": self.kd}

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which pieces of the reference meet."""
        return self.reference.breakpoints

    @property
    def horizon(self) -> float:
        """End of the reference."""
        return self.reference.horizon

    def data(self, segment: int) -> Array:
        """The numbers of the piece of the reference in this segment."""
        return self.reference.data(segment)

    def torque(self, t: SX, angles: SX, rates: SX, p: SX, r: SX) -> SX:
        """Feedback on the error of each tracked joint."""
        target, active = evaluate(r, t, angles.numel(), self.reference.degree, (p[0], p[1]))
        return -active * (p[0] * angles + p[1] * rates - target)


@dataclass(frozen=True, slots=True, kw_only=True)
class BezierTracking(Control):
    """PD tracking of one Bezier curve per joint, whose clock restarts at every impact.

    Attributes
    ----------
    kp, kd : gains [N m/rad], [N m s/rad].
    points : control points of the curve of each tracked joint [rad], the same number for all joints.
    duration : of the curves [s]; the step may end earlier or later.
    beyond_end : continuation after ``duration``: ``linear``, ``hold`` or ``off``.
    within : bound of the modulus of control points that are unknowns [rad].
    """

    kp: float
    kd: float
    points: Mapping[str, tuple[float, ...]]
    duration: float
    beyond_end: BeyondEnd
    within: float

    @property
    def degree(self) -> int:
        """Degree n of the curves."""
        return len(next(iter(self.points.values()))) - 1

    @property
    def parameters(self) -> Mapping[str, float]:
        """The gains, and the control points as ``reference.JOINT.K``."""
        points = {f"reference.{name}.{k}": c for name, row in self.points.items() for k, c in enumerate(row)}
        return {"kp": self.kp, "kd": self.kd, **points}

    @property
    def unknowns(self) -> Mapping[str, tuple[float, float]]:
        """Bounds of the control points."""
        return {name: (-self.within, self.within) for name in self.parameters if name.startswith("reference.")}

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """The end of the curves."""
        return (self.duration,)

    def data(self, segment: int) -> Array:
        """Weights of the curve and of its continuation: (1, 0), then (0, 1)."""
        return np.array([1.0, 0.0] if segment == 0 else [0.0, 1.0])

    def torque(self, t: SX, angles: SX, rates: SX, p: SX, r: SX) -> SX:
        """Feedback on the error of each tracked joint."""
        points = reshape(p[2:], self.degree + 1, len(self.points))

        def feedback(target_angles: SX, target_rates: SX) -> SX:
            return -p[0] * (angles - target_angles) - p[1] * (rates - target_rates)

        within = r[0] * feedback(*self._curve(points, t / self.duration))
        if self.beyond_end is BeyondEnd.OFF:
            return within
        end, rate = self._curve(points, SX(1))
        if self.beyond_end is BeyondEnd.HOLD:
            return within + r[1] * feedback(end, SX.zeros(rate.numel()))
        return within + r[1] * feedback(end + rate * (t - self.duration), rate)

    def _curve(self, points: SX, s: SX) -> tuple[SX, SX]:
        """Angles and rates of the curves at the phase ``s``."""
        slopes = self.degree / self.duration * (points[1:, :] - points[:-1, :])
        return points.T @ _bernstein(self.degree, s), slopes.T @ _bernstein(self.degree - 1, s)


def control_points(phases: Array, angles: Array, degree: int) -> Array:
    """Control points (n, degree + 1) of the Bezier curves that fit ``angles`` (n, m) at ``phases`` (m,) best."""
    k = np.arange(degree + 1)
    basis = np.array([comb(degree, j) for j in k]) * phases[:, None] ** k * (1 - phases[:, None]) ** (degree - k)
    return np.asarray(np.linalg.lstsq(basis, angles.T, rcond=None)[0].T, dtype=float)


def _bernstein(degree: int, s: SX) -> SX:
    """B_k(s) for all k; powers are products, because the power of a symbol has no derivative at 0."""
    rising, falling = [SX(1)], [SX(1)]
    for _ in range(degree):
        rising.append(rising[-1] * s)
        falling.append(falling[-1] * (1 - s))
    return vertcat(*(comb(degree, k) * rising[k] * falling[degree - k] for k in range(degree + 1)))
