"""The absolute work of motions next to a gait, their torques and motor rates linear in the unknowns.

    W(d) = sum of integrals |(u + u' d)(w + w' d)| dt,      r(d) = W(d) - W(0) - W'(0) d

Of a design that saves absolute work, r is what no quadratic function describes: optima lie where the power just touches
zero, and there its second derivatives change within steps that hardly move anything else.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.nlp.design.sensitivity import ArcCurves


@dataclass(frozen=True, slots=True, kw_only=True)
class Remainder:
    """A value, its gradient (n_u,) and its second derivatives (n_u, n_u)."""

    value: float
    gradient: Array
    hessian: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class _Motor:
    """Torque and rate at the points of an arc, shape (m,), and their derivatives, shape (m, n_free)."""

    torque: Array
    torque_slopes: Array
    rate: Array
    rate_slopes: Array
    duration: float

    def work(self, d: Array) -> tuple[float, Array, Array]:
        """Absolute work a step (n_free,) away, with its derivatives."""
        u, w = self.torque + self.torque_slopes @ d, self.rate + self.rate_slopes @ d
        weights, changes = curves.signed_weights(u * w)
        weights = weights * self.duration / 2
        mixed = self.torque_slopes.T @ (weights[:, None] * self.rate_slopes)
        bent = mixed + mixed.T
        slopes = u[:, None] * self.rate_slopes + w[:, None] * self.torque_slopes
        if changes.size:  # 2 P' P' / |dP/dt| at each
            moved = curves.evaluate(curves.coefficients(slopes), changes)
            bent += (moved.T * (self.duration / np.abs(curves.slopes(u * w, changes)))) @ moved
        return float(weights @ (u * w)), weights @ slopes, bent


class WorkRemainder:
    """r and its derivatives.

    Parameters
    ----------
    arcs : of the gait.
    sizes : of the unknowns, in which d is counted, shape (n_u,); freed parameters come first.
    """

    def __init__(self, arcs: Sequence[ArcCurves], sizes: Array) -> None:
        self._n_u, self._n = sizes.size, arcs[0].ahead.stretch.size if arcs else 0
        by = sizes[: self._n]
        self._motors = [
            _Motor(
                torque=torque.values,
                torque_slopes=torque.slopes * by,
                rate=rate.values,
                rate_slopes=rate.slopes * by,
                duration=torque.duration,
            )
            for arc in arcs
            for torque, rate in zip(arc.torque, arc.rate, strict=True)
        ]
        self._value, self._gradient, _ = self._work(np.zeros(self._n))

    def at(self, d: Array) -> Remainder:
        """The remainder of a step (n_u,)."""
        n, freed = self._n, d[: self._n]
        value, slope, bent = self._work(freed)
        gradient, hessian = np.zeros(self._n_u), np.zeros((self._n_u, self._n_u))
        gradient[:n], hessian[:n, :n] = slope - self._gradient, bent
        return Remainder(value=value - self._value - float(self._gradient @ freed), gradient=gradient, hessian=hessian)

    def _work(self, d: Array) -> tuple[float, Array, Array]:
        value, gradient, hessian = 0.0, np.zeros(self._n), np.zeros((self._n, self._n))
        for motor in self._motors:
            work, slope, bent = motor.work(d)
            value, gradient, hessian = value + work, gradient + slope, hessian + bent
        return value, gradient, hessian
