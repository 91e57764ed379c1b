"""A gait as a function of the freed parameters alone: its curves and scalars with exact derivatives.

The equalities F(w, v) = 0 leave nodes and durations w as a function of the freed parameters v,

    dw/dv = -F_w^-1 F_v

and with them every state between the nodes, through the derivative of a partial Runge-Kutta step. Derivatives of a
curve are taken at a fixed fraction of its arc, whose ends move too.

Extrema are located on the curves, also between the nodes. The derivative of an extremum is that of the curve at its
place, because its place has no effect to first order. |power| is integrated between its zeros.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from casadi import MX, SX, Function, cse, jacobian, vertcat

from gaitopt.arrays import Array
from gaitopt.building import built_once
from gaitopt.gait import curves
from gaitopt.gait.trajectory import Arc
from gaitopt.model.buffered import buffered, buffered_map
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.problem.scalars import SCALARS, Instant
from gaitopt.solver.assembly import assemble_steps
from gaitopt.solver.interval import step_derivatives
from gaitopt.solver.newton import Solution
from gaitopt.solver.shooting import MultipleShooting

COUNTS = (17, 25, 33, 65, 129, 257)
"""Numbers of Chebyshev points, tried in turn until an arc is resolved; every point takes an integration step."""
EVENT_MARGINS = ("touchdown", "upright")
"""Margins that are not constraints of a design: the touchdown ends the step, and a gait is always upright."""


class Differentiated(NamedTuple):
    """A number and its gradient in the freed parameters, shape (n_free,), with the operators that formulas need."""

    value: float
    gradient: Array

    def __add__(self, other: tuple[Any, ...]) -> "Differentiated":
        value, gradient = other
        return Differentiated(self.value + value, self.gradient + gradient)

    def __truediv__(self, other: "Differentiated") -> "Differentiated":
        value = self.value / other.value
        return Differentiated(value, (self.gradient - value * other.gradient) / other.value)

    def __mul__(self, other: "Differentiated") -> "Differentiated":  # type: ignore[override]  # no repetition
        gradient = self.gradient * other.value + self.value * other.gradient
        return Differentiated(self.value * other.value, gradient)

    def __abs__(self) -> "Differentiated":
        return Differentiated(abs(self.value), np.sign(self.value) * self.gradient)


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferentiatedCurve:
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

    def integral(self) -> Differentiated:
        """Integral over the arc."""
        value = curves.integral(self.values, self.duration)
        gradient = curves.integrals(self.slopes, self.duration) + value * self.stretch / self.duration
        return Differentiated(value, gradient)

    def absolute_integral(self) -> Differentiated:
        """Integral of the absolute value; where the sign changes the value is zero and adds nothing to the gradient."""
        weights = curves.signed_weights(self.values)[0] * self.duration / 2
        value = float(weights @ self.values)
        return Differentiated(value, weights @ self.slopes + value * self.stretch / self.duration)

    def at(self, s: Array) -> tuple[Array, Array]:
        """Values (k,) and derivatives (k, n_free) at points (k,) in [-1, 1]."""
        both = curves.evaluate(curves.coefficients(np.column_stack([self.values, self.slopes])), s)
        return both[:, 0], both[:, 1:]


@dataclass(frozen=True, slots=True, kw_only=True)
class ArcCurves:
    """All curves of one arc; ``ahead`` is the distance of the swing foot in front of the stance foot."""

    arc: Arc
    force: tuple[DifferentiatedCurve, ...]
    torque: tuple[DifferentiatedCurve, ...]
    rate: tuple[DifferentiatedCurve, ...]
    power: tuple[DifferentiatedCurve, ...]
    height: DifferentiatedCurve
    ahead: DifferentiatedCurve
    margins: dict[str, DifferentiatedCurve]


def _arc_curves(solution: Solution, slopes: Array, index: int, arc: Arc) -> ArcCurves:
    t, n_z = solution.equations, solution.equations.system.n_z
    mesh_arc, system = t.mesh.arcs[index], t.system
    nodes, durations, freed = t.unpack(solution.w)
    p, data = t.dynamics(solution.p, freed).p, system.data(mesh_arc.segment)

    # ends of the arc; the times are affine in the durations
    first = n_z * t.n_nodes
    origin, *units = (t.mesh.arc_times(e)[index] for e in np.vstack([np.zeros(t.n_phases), np.eye(t.n_phases)]))
    by_durations = np.array(units) - np.array(origin)
    starts, ends = by_durations.T @ slopes[first : first + t.n_phases]
    stretch = ends - starts

    # states at the Chebyshev points, each by a partial step from the node before it
    fractions = (curves.points(arc.times.size) + 1) / 2
    dt = starts + np.multiply.outer(fractions, stretch)
    k = np.clip((fractions * mesh_arc.intervals).astype(int), 0, mesh_arc.intervals - 1)
    begin, end = t.mesh.arc_times(durations)[index]
    times = begin + k * (end - begin) / mesh_arc.intervals
    d_times = starts + np.multiply.outer(k / mesh_arc.intervals, stretch)
    node = t.mesh.arc_nodes[index].start + k
    by = step_derivatives(system, mesh_arc.mode, t.free, nodes[:, node], times, arc.times - times, p, data)
    d_nodes = slopes[:first].reshape(t.n_nodes, n_z, -1)[node]
    dz = np.einsum("mij,mjf->mif", by[:, :, :n_z], d_nodes)
    dz += by[:, :, n_z, None] * d_times[:, None, :] + by[:, :, n_z + 1, None] * (dt - d_times)[:, None, :]
    dz += by[:, :, n_z + 2 :]

    # quantities there
    quantities = buffered_map(_quantities(system.shared, arc.mode, t.free), arc.times.size)
    rows, jacobians = quantities(arc.times[:, None], arc.states, p, data)
    values, by = rows.T.copy(), jacobians.transpose(2, 0, 1)
    total = by[:, :, :1] * dt + np.einsum("qmz,mzf->qmf", by[:, :, 1 : 1 + n_z], dz) + by[:, :, 1 + n_z :]
    every = iter(
        [
            DifferentiatedCurve(values=value, slopes=slope, duration=arc.duration, stretch=stretch)
            for value, slope in zip(values, total, strict=True)
        ]
    )
    names, motors = system.transitions.margin_names(arc.mode), range(len(system.walker.actuators))
    return ArcCurves(
        arc=arc,
        force=(next(every), next(every)),
        height=next(every),
        ahead=next(every),
        torque=tuple(next(every) for _ in motors),
        rate=tuple(next(every) for _ in motors),
        power=tuple(next(every) for _ in motors),
        margins=dict(zip(names, every, strict=True)),
    )


@built_once(maxsize=64)
def _quantities(system: HybridSystem, mode: Mode, free: tuple[str, ...]) -> Function:
    """(t, z, p, r) -> force, height and lead of the swing foot, torques, motor rates, powers, margins; Jacobian."""
    t, z = SX.sym("t"), SX.sym("z", system.n_z)
    p, r = SX.sym("p", len(system.parameters)), SX.sym("r", system.n_r)
    force, torque, power, foot, _, rate, *_ = system.observation(mode)(t, z, p, r)
    margins = system.margins(mode)(t, z, p, r)
    values = vertcat(force, foot[1], foot[0] - z[system.n_shape], torque, rate, power, margins)
    by = vertcat(t, z, *(p[system.parameters.index(name)] for name in free))
    return Function(f"quantities_{mode.key}", [t, z, p, r], cse([values, jacobian(values, by)]))


class Candidate(NamedTuple):
    """One of the values whose largest or smallest is an extremum; ``key`` distinguishes it from the others."""

    key: str
    value: float
    gradient: Array


IMPACT_SCALARS = ("step_length", "weight", "incline", "impulse_t", "impulse_n", "push_work")
"""Scalars at the end of the step or of all its time; the impulse is that of a sticking impact."""


class Sensitivity:
    """One gait as a function of the freed parameters: its curves, its scalars and the quantities of their formulas.

    Parameters
    ----------
    solution : of the equalities F = 0.

    Attributes
    ----------
    slopes : ndarray, shape (n_w, n_free) - derivatives of nodes, durations and freed parameters.
    freed : ndarray, shape (n_free,) - the freed parameters.
    dynamics : of the system, with their values.
    arcs : curves of every arc.

    Raises
    ------
    RuntimeError
        If F_w is singular, so that the gait is not a function of the freed parameters.
    """

    def __init__(self, solution: Solution) -> None:
        self.solution, self.equations = solution, solution.equations
        n = solution.residual.size
        response = -solution.scaled.solve(solution.jacobian.dense(n, solution.w.size))
        self.slopes = np.vstack([response, np.eye(response.shape[1])])
        self.freed = self.equations.unpack(solution.w).freed
        self.dynamics = self.equations.dynamics(solution.p, self.freed)
        (step,) = assemble_steps(solution, COUNTS)
        self.arcs = tuple(_arc_curves(solution, self.slopes, k, arc) for k, arc in enumerate(step.arcs))
        values, by = buffered(_at_impact(self.equations))(solution.w, solution.p)
        at_impact = list(map(Differentiated, values.tolist(), by.reshape(-1, values.size).T @ self.slopes))
        n = len(IMPACT_SCALARS)
        self._impact: dict[str, Differentiated] = dict(zip(IMPACT_SCALARS, at_impact[:n], strict=True))
        self._impact_margins = at_impact[n:]
        self._smooth: dict[str, Differentiated] = {}

    def smooth(self, name: str) -> Differentiated:
        """A scalar that is not an extremum: a name of the result, ``state.NAME``, or a dotted key."""
        t = self.equations
        if name in t.system.parameters:
            return Differentiated(self.dynamics.parameter(name), np.array([float(name == other) for other in t.free]))
        if name.startswith("state."):
            return self._unknown(t.system.state_names.index(name.removeprefix("state.")))
        if name not in self._smooth:
            formula = SCALARS[name].formula
            assert formula is not None, f"{name} is an extremum"
            self._smooth[name] = formula(self)
        return self._smooth[name]

    @property
    def duration(self) -> Differentiated:
        """Period [s]."""
        first = self.equations.system.n_z * self.equations.n_nodes
        return self._total(self._unknown(k) for k in range(first, first + self.equations.n_phases))

    @property
    def distance(self) -> Differentiated:
        """Length of the step [m]."""
        return self._impact["step_length"]

    @property
    def weight(self) -> Differentiated:
        """m g [N]."""
        return self._impact["weight"]

    @property
    def transport(self) -> Differentiated:
        """Weight times step length [J]."""
        return self.distance * self.weight

    @property
    def incline(self) -> Differentiated:
        """sin(slope)."""
        return self._impact["incline"]

    @property
    def push_work(self) -> Differentiated:
        """Work of the push before the impact [J]."""
        return self._impact["push_work"]

    @property
    def slip(self) -> Differentiated:
        """Path of the sliding foot [m]."""
        total, mesh, system = self._total(()), self.equations.mesh, self.equations.system
        for arc, nodes in zip(mesh.arcs, mesh.arc_nodes, strict=True):
            start, end = (self._unknown(system.n_z * k + system.n_shape) for k in (nodes[0], nodes[-1]))
            direction = arc.mode.direction
            total += direction * (end.value - start.value), direction * (end.gradient - start.gradient)
        return total

    def integral(self, rate: str) -> Differentiated:
        """Integral over time of ``power`` of all motors, ``absolute_power`` or ``squared_torque``."""
        if rate == "squared_torque":
            return self._total(_squared(curve).integral() for arc in self.arcs for curve in arc.torque)
        power = (curve for arc in self.arcs for curve in arc.power)
        return self._total(c.absolute_integral() if rate == "absolute_power" else c.integral() for c in power)

    def _unknown(self, k: int) -> Differentiated:
        return Differentiated(float(self.solution.w[k]), self.slopes[k])

    def _total(self, terms: Iterable[Differentiated]) -> Differentiated:
        return sum(terms, start=Differentiated(0.0, np.zeros(len(self.equations.free))))

    def by_work(self, name: str) -> float:
        """Derivative of a scalar in the absolute work of the motors [1/J]."""
        return 1 / self.transport.value if name == "absolute_cost_of_transport" else 0.0

    def candidates(self, name: str) -> list[Candidate]:
        """The values whose extremum a scalar is."""
        scalar, found = SCALARS[name], list[Candidate]()
        if scalar.quotient is None:
            raise KeyError(name)
        if name == "impulse_ratio":
            above, below = scalar.quotient(Instant(self._impact["impulse_t"], self._impact["impulse_n"], None, None))
            found.append(Candidate(name, *(above / below)))
        elif name == "foot_clearance":
            for k, arc in enumerate(self.arcs):
                if arc.ahead.values[-1] > 0:  # from where the legs pass each other for the last time
                    passing = curves.roots(arc.ahead.values)
                    after = float(passing[-1]) if passing.size else -1.0
                    found += _extremes(arc.height, f"{name} {k}", [1.0], after=after)
        else:
            for k, arc in enumerate(self.arcs):
                if scalar.sticking and not arc.arc.mode.sticks:
                    continue
                above, below = scalar.quotient(Instant(arc.force[0], arc.force[1], arc.torque, arc.height))
                for j, curve in enumerate(above if isinstance(above, tuple) else (above,)):
                    found += _extremes(curve if below is None else _quotient(curve, below), f"{name} {j} {k}")
        return _both_signs(found) if scalar.both_signs else found

    def margins(self) -> Iterator[tuple[str, float, Candidate]]:
        """Name, natural unit and value of every margin: at its minima along the arcs, and of the impact.

        The margin that ends a timed phase is left out at its end: where it is negative, the switch leaves its
        breakpoint, and the gait goes on with another mesh.
        """
        t, scales = self.equations, self.dynamics.scales
        cycle, table = t.mesh.cycle, t.system.transitions
        for k, arc in enumerate(self.arcs):
            last, mode = t.mesh.arcs[k].intervals, arc.arc.mode
            for (name, curve), unit in zip(arc.margins.items(), self.dynamics.margin_units(mode), strict=True):
                if name in EVENT_MARGINS:
                    continue
                ends = [s for s, node in ((-1.0, 0), (1.0, last)) if not t.is_zero_by_event(k, node, name)]
                phase = t.mesh.arcs[k].phase
                if phase in cycle.timed and t.mesh.arcs[k].end is None:
                    ends = [s for s in ends if s < 0 or name != table.between(mode, cycle.after(phase)).guard]
                for candidate in _extremes(curve, f"{name} {k}", ends):
                    yield name, float(unit), candidate
        for (value, slope), (_, label) in zip(self._impact_margins, t.impact_margins, strict=True):
            yield label.name, label.size(scales), Candidate(f"impact {label.name}", value, slope)


@built_once(maxsize=8)
def _at_impact(t: MultipleShooting) -> Function:
    """(w, p) -> ``IMPACT_SCALARS`` and the margins of the impact; and their Jacobian in w."""
    swapped, last = t.system.walker.swapped, t.mesh.cycle.phases[-1]
    landed = t.system.impact(swapped(t.mesh.cycle.impact), last)(z=t.Z[:, -1], p=t.p)["z_plus"]
    impulse = t.system.impact(swapped(Mode.STICK), last)(z=t.Z[:, -1], p=t.p)["impulse"]
    margins = [expression for expression, _ in t.impact_margins]
    work = t.system.push(t.mesh.cycle.phases[-1])(z=t.Z[:, -1], p=t.p)["work"]
    of_gravity = MX(t.system.weight(t.p)), MX(t.system.incline(t.p))
    values = vertcat(landed[t.system.n_shape], *of_gravity, impulse, work, *margins)
    return Function("at_impact", [t.w, t.parameters], [values, jacobian(values, t.w)])


def _extremes(
    curve: DifferentiatedCurve, key: str, ends: Sequence[float] = (-1.0, 1.0), after: float = -1.0
) -> Iterator[Candidate]:
    """The curve at the given ends of the arc, and at its extrema after a point."""
    inside = [s for s in curves.critical(curve.values) if s > after]
    names = [*(f"{key} end {s:+.0f}" for s in ends), *(f"{key} extremum {k}" for k in range(len(inside)))]
    for name, value, slope in zip(names, *curve.at(np.array([*ends, *inside])), strict=True):
        yield Candidate(name, float(value), slope)


def _both_signs(candidates: Iterable[Candidate]) -> list[Candidate]:
    return [c for key, value, by in candidates for c in (Candidate(key, value, by), Candidate(f"-{key}", -value, -by))]


def _squared(curve: DifferentiatedCurve) -> DifferentiatedCurve:
    return replace(curve, values=curve.values**2, slopes=2 * curve.values[:, None] * curve.slopes)


def _quotient(above: DifferentiatedCurve, below: DifferentiatedCurve) -> DifferentiatedCurve:
    values = above.values / below.values
    slopes = (above.slopes - values[:, None] * below.slopes) / below.values[:, None]
    return replace(above, values=values, slopes=slopes)
