"""A gait as a function of the freed parameters alone: its curves with exact derivatives.

The equalities F(w, v) = 0 leave nodes and durations w as a function of the freed parameters v,

    dw/dv = -F_w^-1 F_v

and every state between the nodes with them, through the derivative of one partial Runge-Kutta step. Derivatives of a
curve are taken at a fixed fraction of its arc, whose ends move too.

The absolute work of motions next to a gait, their torques and motor rates linear in the unknowns.

    W(d) = sum of integrals |(u + u' d)(w + w' d)| dt,      r(d) = W(d) - W(0) - W'(0) d

Of a design that saves absolute work, r is what no quadratic function describes: optima lie where the power just touches
zero, and there its second derivatives change within steps that hardly move anything else.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from casadi import SX, Function, cse, jacobian, vertcat

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.trajectory import Arc, Step
from gaitopt.model.buffered import buffered_map
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.margins import margin_names
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.nlp.assembly import assemble_steps
from gaitopt.nlp.newton import Solution
from gaitopt.nlp.shooting import MultipleShooting, step_derivatives

COUNTS = (17, 25, 33, 65, 129, 257)
"""Chebyshev points tried in turn until an arc is resolved; every point costs a step."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """A quantity along one arc.

    Attributes
    ----------
    values : ndarray, shape (m,) - at the arc's Chebyshev points.
    slopes : ndarray, shape (m, n_free) - derivatives in the freed parameters at fixed fractions of the arc.
    duration, stretch : length of the arc in time [s], and its derivatives; shape (n_free,).
    """

    values: Array
    slopes: Array
    duration: float
    stretch: Array

    def integral(self) -> tuple[float, Array]:
        """Integral over the arc and its derivatives."""
        value = curves.integral(self.values, self.duration)
        return value, curves.integrals(self.slopes, self.duration) + value * self.stretch / self.duration

    def absolute_integral(self) -> tuple[float, Array]:
        """Integral of the absolute value; the changes of sign, where it is zero, add nothing to the derivatives."""
        weights = curves.signed_weights(self.values)[0] * self.duration / 2
        value = float(weights @ self.values)
        return value, weights @ self.slopes + value * self.stretch / self.duration

    def at(self, s: Array) -> tuple[Array, Array]:
        """Values (k,) and derivatives (k, n_free) at points (k,) in [-1, 1]."""
        both = curves.evaluate(curves.coefficients(np.column_stack([self.values, self.slopes])), s)
        return both[:, 0], both[:, 1:]


@dataclass(frozen=True, slots=True, kw_only=True)
class ArcCurves:
    """All curves of one arc; ``ahead`` is the swing foot's lead over the stance foot."""

    arc: Arc
    force: tuple[Curve, ...]
    torque: tuple[Curve, ...]
    rate: tuple[Curve, ...]
    power: tuple[Curve, ...]
    height: Curve
    ahead: Curve
    margins: dict[str, Curve]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensitivity:
    """One gait and its derivatives in the freed parameters.

    Attributes
    ----------
    step : the step.
    slopes : ndarray, shape (n_w, n_free) - of nodes, durations and freed parameters.
    arcs : curves of every arc.
    """

    transcription: MultipleShooting
    at: Solution[MultipleShooting]
    step: Step
    slopes: Array
    arcs: tuple[ArcCurves, ...]

    @property
    def dynamics(self) -> Dynamics:
        """The system at all its parameters, the freed ones put in."""
        return self.transcription.dynamics(self.at.p, self.transcription.unpack(self.at.w).freed)


def sensitivity(transcription: MultipleShooting, at: Solution[MultipleShooting]) -> Sensitivity:
    """Curves and derivatives at a solution of the equalities.

    Raises
    ------
    RuntimeError
        If the equalities are singular there, so that the gait is no function of the freed parameters.
    """
    n = at.residual.size
    answer = -at.scaled.solve(at.jacobian.dense(n, at.w.size))
    slopes = np.vstack([answer, np.eye(answer.shape[1])])
    (step,) = assemble_steps(transcription, at.w, at.p, COUNTS)
    arcs = tuple(_arc_curves(transcription, at, slopes, k, arc) for k, arc in enumerate(step.arcs))
    return Sensitivity(transcription=transcription, at=at, step=step, slopes=slopes, arcs=arcs)


def _arc_curves(t: MultipleShooting, at: Solution[MultipleShooting], slopes: Array, index: int, arc: Arc) -> ArcCurves:
    layout, system = t.layout.arcs[index], t.system
    names = margin_names(arc.mode)
    starts, ends = _ends(t, slopes, index)
    stretch = ends - starts
    dt = starts + np.multiply.outer((curves.points(arc.times.size) + 1) / 2, stretch)
    dz = _state_slopes(t, at, slopes, index, arc, dt)
    data, p = system.data(layout.segment), t.dynamics(at.p, t.unpack(at.w).freed).p
    quantities = buffered_map(_quantities(system, arc.mode, t.free), arc.times.size)
    rows, jacobians = quantities(arc.times[:, None], arc.states, p, data)
    values, by = rows.T.copy(), jacobians.transpose(2, 0, 1)
    n_q = len(values)
    total = by[:, :, :1] * dt + np.einsum("qmz,mzf->qmf", by[:, :, 1 : 1 + system.n_z], dz) + by[:, :, 1 + system.n_z :]
    every = [
        Curve(values=value, slopes=slope, duration=arc.duration, stretch=stretch)
        for value, slope in zip(values, total, strict=True)
    ]
    n_u = (n_q - 4 - len(names)) // 3
    return ArcCurves(
        arc=arc,
        force=tuple(every[:2]),
        height=every[2],
        ahead=every[3],
        torque=tuple(every[4 : 4 + n_u]),
        rate=tuple(every[4 + n_u : 4 + 2 * n_u]),
        power=tuple(every[4 + 2 * n_u : 4 + 3 * n_u]),
        margins=dict(zip(names, every[4 + 3 * n_u :], strict=True)),
    )


@lru_cache(maxsize=64)
def _quantities(system: HybridSystem, mode: Mode, free: tuple[str, ...]) -> Function:
    """(t, z, p, r) -> force, swing foot's height and lead, torques, motor rates, powers, margins; their Jacobian."""
    t, z = SX.sym("t"), SX.sym("z", system.n_z)
    p, r = SX.sym("p", len(system.parameters)), SX.sym("r", system.n_r)
    force, torque, power, foot, _, rate, _ = system.observation(mode)(t, z, p, r)
    margins = system.margins(mode)(t, z, p, r)
    values = vertcat(force, foot[1], foot[0] - z[system.n_shape], torque, rate, power, margins)
    by = vertcat(t, z, *(p[system.parameters.index(name)] for name in free))
    return Function(f"quantities_{mode.key}", [t, z, p, r], cse([values, jacobian(values, by)]))


def _ends(t: MultipleShooting, slopes: Array, index: int) -> tuple[Array, Array]:
    """Derivatives of the times at which an arc starts and ends; each of shape (n_free,)."""
    first = t.system.n_z * t.n_nodes
    durations = slopes[first : first + t.n_phases]
    zero, one = (
        t.layout.arc_times(np.zeros(t.n_phases))[index],
        [t.layout.arc_times(e)[index] for e in np.eye(t.n_phases)],
    )
    by = np.array(one) - np.array(zero)
    return by[:, 0] @ durations, by[:, 1] @ durations


def _state_slopes(
    t: MultipleShooting, at: Solution[MultipleShooting], slopes: Array, index: int, arc: Arc, dt: Array
) -> Array:
    """Derivatives of the states at the arc's Chebyshev points; shape (m, n_z, n_free)."""
    layout, n_z = t.layout.arcs[index], t.system.n_z
    fractions = (curves.points(arc.times.size) + 1) / 2
    k = np.clip((fractions * layout.intervals).astype(int), 0, layout.intervals - 1)
    nodes, durations, freed = t.unpack(at.w)
    begin, end = t.layout.arc_times(durations)[index]
    times = begin + k * (end - begin) / layout.intervals
    starts, ends = _ends(t, slopes, index)
    d_times = starts + np.multiply.outer(k / layout.intervals, ends - starts)
    at_node = t.layout.first_nodes[index] + k
    full = t.dynamics(at.p, freed).p
    by = step_derivatives(
        t.system,
        layout.mode,
        t.free,
        nodes[:, at_node],
        times,
        arc.times - times,
        full,
        t.system.data(layout.segment),
    )
    d_nodes = slopes[: n_z * t.n_nodes].reshape(t.n_nodes, n_z, -1)[at_node]
    moved = np.einsum("mij,mjf->mif", by[:, :, :n_z], d_nodes)
    moved += by[:, :, n_z, None] * d_times[:, None, :] + by[:, :, n_z + 1, None] * (dt - d_times)[:, None, :]
    return moved + by[:, :, n_z + 2 :]


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
