"""PD tracking of Bezier curves whose control points are parameters, so that they can be set, freed or continued.

    theta_r(t) = sum_k c_k B_k(s),    B_k(s) = C(n, k) s^k (1 - s)^(n - k),    s = t / duration,    t < duration

A Bezier curve stays within the range of its control points and starts and ends at the first and the last one, with
the rate n (c_1 - c_0) / duration there, which is all that its continuation past the end has to know.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import comb

import numpy as np
from casadi import SX, reshape, vertcat

from gaitopt.arrays import Array
from gaitopt.mechanics.control.law import Control
from gaitopt.mechanics.control.reference import BeyondEnd


@dataclass(frozen=True, slots=True, kw_only=True)
class BezierTracking(Control):
    """PD tracking with phase reset of one Bezier curve per joint: u = -kp (theta - theta_r) - kd (dtheta - dtheta_r).

    Attributes
    ----------
    kp, kd : gains [N m/rad], [N m s/rad].
    points : control points of the curve of each tracked joint [rad]; all of the same number.
    duration : of the curves [s]; the step may end earlier or later.
    beyond_end : what holds after ``duration``: ``linear``, ``hold`` or ``off``.
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
        """Whether the curve holds, and whether its continuation does."""
        return np.array([1.0, 0.0] if segment == 0 else [0.0, 1.0])

    def torque(self, t: SX, angles: SX, rates: SX, p: SX, r: SX) -> SX:
        """Feedback on the error of each tracked joint."""
        points = reshape(p[2:], self.degree + 1, len(self.points))
        inside = self._feedback(p, angles, rates, *self._curve(points, t / self.duration))
        if self.beyond_end is BeyondEnd.OFF:
            return r[0] * inside
        return r[0] * inside + r[1] * self._feedback(p, angles, rates, *self._continuation(points, t))

    def _feedback(self, p: SX, angles: SX, rates: SX, target_angles: SX, target_rates: SX) -> SX:
        return -p[0] * (angles - target_angles) - p[1] * (rates - target_rates)

    def _curve(self, points: SX, s: SX) -> tuple[SX, SX]:
        """Angles and rates of the curves at the phase ``s``."""
        slopes = self.degree / self.duration * (points[1:, :] - points[:-1, :])
        return points.T @ _bernstein(self.degree, s), slopes.T @ _bernstein(self.degree - 1, s)

    def _continuation(self, points: SX, t: SX) -> tuple[SX, SX]:
        end, rate = self._curve(points, SX(1))
        if self.beyond_end is BeyondEnd.HOLD:
            return end, SX.zeros(rate.numel())
        return end + rate * (t - self.duration), rate


def control_points(phases: Array, angles: Array, degree: int) -> Array:
    """Control points (n, degree + 1) of the Bezier curves that come closest to ``angles`` (n, m) at ``phases`` (m,)."""
    k = np.arange(degree + 1)
    basis = np.array([comb(degree, j) for j in k]) * phases[:, None] ** k * (1 - phases[:, None]) ** (degree - k)
    return np.asarray(np.linalg.lstsq(basis, angles.T, rcond=None)[0].T, dtype=float)


def _bernstein(degree: int, s: SX) -> SX:
    """B_k(s) for all k; powers by products, because a symbol's power has no derivative at 0."""
    rising, falling = [SX(1)], [SX(1)]
    for _ in range(degree):
        rising.append(rising[-1] * s)
        falling.append(falling[-1] * (1 - s))
    return vertcat(*(comb(degree, k) * rising[k] * falling[degree - k] for k in range(degree + 1)))
