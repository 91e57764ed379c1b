"""A gait as a function of the freed parameters only: its curves and scalars with exact derivatives.

The equalities F(w, v) = 0 leave nodes and durations w as a function of the freed parameters v,

    dw/dv = -F_w^-1 F_v

and with them every state between the nodes, through the derivative of a partial Runge-Kutta step. Derivatives of a
curve are taken at a fixed fraction of its arc, whose ends move too.

Extrema are located on the curves, also between the nodes. The derivative of an extremum is that of the curve at the
time of the extremum, because a change of this time has no effect to first order. |power| is integrated between its
zeros.

The multipliers are the eigenvalues of M = DPi, and those of M + dM are, with left and right eigenvectors l' r = 1,

    d lambda = l' dM r,      d |lambda| = Re(conj(lambda) d lambda) / |lambda|
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, groupby
from typing import Any, NamedTuple

import numpy as np
from casadi import MX, SX, Function, cse, densify, jacobian, vertcat
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.building import built_once
from gaitopt.design.spectral_radius import eigenvalue_gradients
from gaitopt.gait import curves
from gaitopt.gait.measures import ON_THE_SPOT, WITHOUT_FORCE, swings
from gaitopt.gait.trajectory import Arc
from gaitopt.model.buffered import buffered, buffered_map
from gaitopt.model.contacts import sharing_contacts
from gaitopt.model.modes import Mode
from gaitopt.model.section import TOUCHDOWN
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import is_held, margin, margin_unit
from gaitopt.model.virtual_constraints import VirtualConstraints
from gaitopt.problem.scalars import SCALARS, Instant, phase_of
from gaitopt.solver.assembly import assemble_steps
from gaitopt.solver.diagnosis import AIRBORNE
from gaitopt.solver.interval import step_derivatives
from gaitopt.solver.newton import Solution
from gaitopt.solver.shooting import Label, MultipleShooting

COUNTS = (17, 25, 33, 65, 129, 257)
"""Numbers of Chebyshev points, tried in turn until an arc is resolved; every point takes an integration step."""

TIED = 1e-9
"""Relative difference of two values below which both are the extremum."""
DIFFERENT = 1e-6
"""A larger relative difference of two gradients is not due to rounding."""
SMALLEST_SIZE = 1e-6
"""Smallest divisor of a relative difference."""


class Differentiated(NamedTuple):
    """A number and its gradient by the freed parameters, shape (n_free,), with the operators that formulas need."""

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
    values : ndarray, shape (m,) - values at the arc's Chebyshev points.
    slopes : ndarray, shape (m, n_free) - derivatives by the freed parameters at fixed fractions of the arc.
    duration, stretch : duration of the arc [s], and its derivatives, shape (n_free,).
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
        """Integral of the absolute value. A change of sign adds nothing to the gradient: the value is zero there."""
        weights = curves.signed_weights(self.values)[0] * self.duration / 2
        value = float(weights @ self.values)
        return Differentiated(value, weights @ self.slopes + value * self.stretch / self.duration)

    def at(self, s: Array) -> tuple[Array, Array]:
        """Values (k,) and derivatives (k, n_free) at points (k,) in [-1, 1]."""
        both = curves.evaluate(curves.coefficients(np.column_stack([self.values, self.slopes])), s)
        return both[:, 0], both[:, 1:]


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactCurves:
    """A contact that touches the ground along an arc, or contacts that share their forces.

    Attributes
    ----------
    direction : sign of the slip velocity, 0 if they stick.
    force_t, force_n : sum of their forces [N].
    slip : tangential velocity [m/s].
    """

    direction: int
    force_t: DifferentiatedCurve
    force_n: DifferentiatedCurve
    slip: DifferentiatedCurve


@dataclass(frozen=True, slots=True, kw_only=True)
class ArcCurves:
    """All curves of one arc.

    ``height`` and ``ahead`` are the height of the swing foot over the ground and its distance in front of the stance
    foot, ``centre`` is the height of the centre of mass, ``loss`` the power that the dampers dissipate.
    """

    arc: Arc
    contacts: tuple[ContactCurves, ...]
    torque: tuple[DifferentiatedCurve, ...]
    rate: tuple[DifferentiatedCurve, ...]
    power: tuple[DifferentiatedCurve, ...]
    height: DifferentiatedCurve
    ahead: DifferentiatedCurve
    centre: DifferentiatedCurve
    loss: DifferentiatedCurve
    margins: dict[str, DifferentiatedCurve]


def _arc_curves(solution: Solution, slopes: Array, index: int, arc: Arc) -> ArcCurves:
    t, n_z = solution.equations, solution.equations.system.n_z
    mesh_arc, system = t.mesh.arcs[index], t.system
    nodes, durations, _ = t.unpack(solution.w)
    p, data, varied = arc.dynamics.p, system.data(mesh_arc.segment), t.varied_in_phases[mesh_arc.phase]
    of_free, of_first = t.varied_slopes(solution.w, solution.p)
    d_varied = of_free + of_first @ slopes[:n_z]

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
    by = step_derivatives(system, mesh_arc.mode, varied, nodes[:, node], times, arc.times - times, p, data)
    d_nodes = slopes[:first].reshape(t.n_nodes, n_z, -1)[node]
    dz = np.einsum("mij,mjf->mif", by[:, :, :n_z], d_nodes)
    dz += by[:, :, n_z, None] * d_times[:, None, :] + by[:, :, n_z + 1, None] * (dt - d_times)[:, None, :]
    dz += by[:, :, n_z + 2 :] @ d_varied

    # quantities there
    quantities = buffered_map(_quantities(system.shared, arc.mode, varied), arc.times.size)
    rows, jacobians = quantities(arc.times[:, None], arc.states, p, data)
    values, by = rows.T.copy(), jacobians.transpose(2, 0, 1)
    total = by[:, :, :1] * dt + np.einsum("qmz,mzf->qmf", by[:, :, 1 : 1 + n_z], dz)
    total += by[:, :, 1 + n_z :] @ d_varied
    every = iter(
        [
            DifferentiatedCurve(values=value, slopes=slope, duration=arc.duration, stretch=stretch)
            for value, slope in zip(values, total, strict=True)
        ]
    )
    names, motors = system.transitions.margin_names(arc.mode), range(len(system.walker.actuators))
    return ArcCurves(
        arc=arc,
        contacts=tuple(
            ContactCurves(
                direction=arc.mode.directions[group[0]], force_t=next(every), force_n=next(every), slip=next(every)
            )
            for group in sharing_contacts(system.walker, arc.mode)
        ),
        height=next(every),
        ahead=next(every),
        centre=next(every),
        loss=next(every),
        torque=tuple(next(every) for _ in motors),
        rate=tuple(next(every) for _ in motors),
        power=tuple(next(every) for _ in motors),
        margins=dict(zip(names, every, strict=True)),
    )


@built_once(maxsize=64)
def _quantities(system: HybridSystem, mode: Mode, free: tuple[str, ...]) -> Function:
    """(t, z, p, r) -> the curves of ``ArcCurves``, in the order of its fields, and their Jacobian by (t, z, free)."""
    t, z = SX.sym("t"), SX.sym("z", system.n_z)
    p, r = SX.sym("p", len(system.parameters)), SX.sym("r", system.n_r)
    force, torque, power, foot, _, rate, loss, slip = system.observation(mode)(t, z, p, r)
    index, contacts = {name: k for k, name in enumerate(system.walker.contact_names())}, list[SX]()
    for group in sharing_contacts(system.walker, mode):
        columns = [index[name] for name in group]
        contacts += [sum((force[2 * k + row] for k in columns), SX(0)) for row in (0, 1)] + [slip[columns[0]]]
    ahead, centre = foot[0] - z[system.n_shape], system.centre_height(z, p)
    margins = system.margins(mode)(t, z, p, r)
    values = vertcat(*contacts, foot[1], ahead, centre, loss, torque, rate, power, margins)
    by = vertcat(t, z, *(p[system.parameters.index(name)] for name in free))
    return Function(f"quantities_{mode.key}", [t, z, p, r], cse([densify(values), densify(jacobian(values, by))]))


class Multiplier(NamedTuple):
    """A multiplier and its complex gradient, shape (n_free,), which has no meaning if the multiplier is not simple."""

    value: complex
    gradient: NDArray[np.complex128]


class Candidate(NamedTuple):
    """One of the values over which an extremum is taken; ``key`` is its unique name."""

    key: str
    value: float
    gradient: Array


OF_WALKER, OF_STEP = ("weight", "incline"), ("step_length", "impulse_t", "impulse_n", "push_work")
"""Quantities of the walker, and of the end of each step; the impulse is that of a sticking impact."""


class Sensitivity:
    """One gait as a function of the freed parameters: its curves, its scalars and the quantities of their formulas.

    Parameters
    ----------
    solution : solution of the equalities F = 0.

    Attributes
    ----------
    slopes : ndarray, shape (n_w, n_free) - derivatives of nodes, durations and freed parameters.
    freed : ndarray, shape (n_free,) - the freed parameters.
    dynamics : dynamics of the system with the freed parameters at these values.
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
        self.steps = assemble_steps(solution, COUNTS)
        arcs = (arc for step in self.steps for arc in step.arcs)
        self.arcs = tuple(_arc_curves(solution, self.slopes, k, arc) for k, arc in enumerate(arcs))
        at_impacts = iter(self._evaluated(_at_impacts(self.equations)))
        self._of_walker = {name: next(at_impacts) for name in OF_WALKER}
        self._of_steps = [{name: next(at_impacts) for name in OF_STEP} for _ in self.steps]
        self._of_landings = [*at_impacts]
        self._smooth: dict[str, Differentiated] = {}

    def smooth(self, name: str) -> Differentiated:
        """A scalar that is no extremum: of the result, ``state.NAME``, ``phases.K.duration``, or a dotted key."""
        t = self.equations
        if name in t.system.parameters:
            return Differentiated(self.dynamics.parameter(name), np.array([float(name == other) for other in t.free]))
        if name.startswith("state."):
            return self._unknown(t.system.state_names.index(name.removeprefix("state.")))
        phase = phase_of(name)
        if phase is not None:
            return self._unknown(t.system.n_z * t.n_nodes + phase)
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
        """Length of the cycle [m]."""
        return self._total(step["step_length"] for step in self._of_steps)

    @property
    def weight(self) -> Differentiated:
        """m g [N]."""
        return self._of_walker["weight"]

    @property
    def transport(self) -> Differentiated:
        """Weight times distance [J]; NaN on the spot, where no cost is defined."""
        distance = self.distance
        if abs(distance.value) <= ON_THE_SPOT * self.dynamics.scales.length:
            distance = Differentiated(np.nan, distance.gradient)
        return distance * self.weight

    @property
    def incline(self) -> Differentiated:
        """sin(slope)."""
        return self._of_walker["incline"]

    @property
    def push_work(self) -> Differentiated:
        """Work of the pushes before landings [J]."""
        return self._total([*(step["push_work"] for step in self._of_steps), *self._of_landings])

    @property
    def slip(self) -> Differentiated:
        """Path of the sliding foot [m]."""
        contacts = (contact for arc in self.arcs for contact in arc.contacts if contact.direction)
        return self._total(abs(contact.slip.integral()) for contact in contacts)

    def integral(self, rate: str) -> Differentiated:
        """Integral over time of ``power`` of all motors, ``absolute_power``, ``loss`` or ``squared_torque``."""
        if rate == "loss":
            return self._total(arc.loss.integral() for arc in self.arcs)
        if rate == "squared_torque":
            torques = (curve for arc in self.arcs for curve in arc.torque)
            squared = (replace(c, values=c.values**2, slopes=2 * c.values[:, None] * c.slopes) for c in torques)
            return self._total(curve.integral() for curve in squared)
        power = (curve for arc in self.arcs for curve in arc.power)
        return self._total(c.absolute_integral() if rate == "absolute_power" else c.integral() for c in power)

    def _unknown(self, k: int) -> Differentiated:
        return Differentiated(float(self.solution.w[k]), self.slopes[k])

    def _total(self, terms: Iterable[Differentiated]) -> Differentiated:
        return sum(terms, start=Differentiated(0.0, np.zeros(len(self.equations.free))))

    def by_work(self, name: str) -> float:
        """Derivative of a scalar by the absolute work of the motors [1/J]."""
        return 1 / self.transport.value if name == "absolute_cost_of_transport" else 0.0

    def extremum(self, name: str) -> Candidate | None:
        """The value that is an extremum, None if there is none.

        If several values are the extremum, the gradient is NaN by those parameters that change them differently.
        """
        sense = SCALARS[name].extremum
        if name == "foot_clearance":  # the smallest over all swings of the largest height in the swing
            highest = [_extreme(heights, 1) for heights in self._clearances()]
            return _extreme([each for each in highest if each is not None], -1)
        if name == "apex_height":
            flights = (_extremes(arc.centre, str(k)) for k, arc in enumerate(self.arcs) if not arc.arc.mode.touching)
            return _extreme([*chain.from_iterable(flights)], sense)
        return _extreme(self.candidates(name), sense)

    def _clearances(self) -> Iterator[list[Candidate]]:
        """For every swing, the heights of the foot in flight or in front of the stance foot."""
        numbered = iter(enumerate(self.arcs))
        for swing in swings([[(arc, next(numbered)) for arc in step.arcs] for step in self.steps]):
            heights = list[Candidate]()
            for _, (k, arc) in swing:
                if not arc.arc.mode.touching:
                    heights += _extremes(arc.height, f"foot_clearance {k}")
                elif arc.ahead.values[-1] > 0:  # after the legs pass each other for the last time
                    passing = curves.roots(arc.ahead.values)[-1:]
                    after = float(passing[0]) if passing.size else -1.0
                    heights += _extremes(arc.height, f"foot_clearance {k}", [1.0], after=after)
                    heights.append(Candidate(f"foot_clearance {k} passing", *_at_root(arc.height, arc.ahead, after)))
            yield heights

    def by_return_map(self, weights: Array) -> Array:
        """Gradient of <weights, M>, shape (n_free,), where M is the derivative of the return map."""
        return np.asarray(self.solution.return_map.gradient(weights) @ self.slopes)

    def multipliers(self) -> list[Multiplier]:
        """The multipliers, largest modulus first."""
        values, slopes = eigenvalue_gradients(self.solution.return_map.by_section)
        return [
            Multiplier(complex(value), self.by_return_map(slope.real) + 1j * self.by_return_map(slope.imag))
            for value, slope in zip(values, slopes, strict=True)
        ]

    def candidates(self, name: str) -> list[Candidate]:
        """The values over which a scalar is the extremum."""
        scalar, found = SCALARS[name], list[Candidate]()
        if scalar.quotient is None:
            raise KeyError(name)
        if name == "impulse_ratio":
            for k, step in enumerate(self._of_steps):
                above, below = scalar.quotient(Instant(step["impulse_t"], step["impulse_n"], None, None))
                if below.value:
                    found.append(Candidate(f"{name} {k}", *(above / below)))
        elif name == "foot_clearance":
            found += chain.from_iterable(self._clearances())
        elif name == "peak_torque":
            for k, arc in enumerate(self.arcs):
                for j, curve in enumerate(arc.torque):
                    found += _extremes(curve, f"{name} {j} {k}")
        else:
            for k, arc in enumerate(self.arcs):
                for j, contact in enumerate(arc.contacts):
                    if scalar.sticking and contact.direction:
                        continue
                    above, below = scalar.quotient(Instant(contact.force_t, contact.force_n, None, None))
                    found += _extremes(above if below is None else _quotient(above, below), f"{name} {j} {k}")
        signed = ((sign, *candidate) for candidate in found for sign in scalar.signs)
        return [Candidate(key if sign > 0 else f"-{key}", sign * value, sign * by) for sign, key, value, by in signed]

    def margins(self) -> Iterator[tuple[str, float, Candidate]]:
        """Name, natural unit and value of every margin at its minima along the arcs, and of the margins of the impacts.

        A margin that rises before it falls counts after it has risen.

        The margin that ends a timed phase is left out at its end. If it is negative there, the switch leaves its
        breakpoint, and the gait needs another mesh.
        """
        t, scales = self.equations, self.dynamics.scales
        cycle, table = t.mesh.cycle, t.system.transitions
        for k, arc in enumerate(self.arcs):
            last, mode = t.mesh.arcs[k].intervals, arc.arc.mode
            for (name, curve), unit in zip(arc.margins.items(), self.dynamics.margin_units(mode), strict=True):
                if not is_held(name):
                    continue
                ends = [s for s, node in ((-1.0, 0), (1.0, last)) if not t.is_zero_by_event(k, node, name)]
                phase = t.mesh.arcs[k].phase
                if phase in cycle.timed and t.mesh.arcs[k].end is None:
                    ends = [s for s in ends if s < 0 or name != table.between(mode, cycle.after(phase)).guard]
                for candidate in _extremes(curve, f"{name} {k}", ends):
                    yield name, float(unit), candidate
        yield from self._rising_margins()
        margins = self._evaluated(_impact_margins(t))
        for (value, slope), (_, label) in zip(margins, t.impact_margins, strict=True):
            yield label.name, label.size(scales), Candidate(f"impact {label.name}", value, slope)

    def _rising_margins(self) -> Iterator[tuple[str, float, Candidate]]:
        cycle, phases = self.equations.mesh.cycle, [arc.phase for arc in self.equations.mesh.arcs]
        numbered = zip(range(len(phases)), phases, self.arcs, strict=True)
        for _, group in groupby(numbered, key=lambda each: cycle.swings[each[1]]):
            swing = [(k, arc) for k, _, arc in group]
            for name in dict.fromkeys(name for _, arc in swing for name in arc.margins if margin(name).rises):
                having = [(k, arc) for k, arc in swing if name in arc.margins]
                unit = margin_unit(name, self.dynamics.scales)
                times, values = zip(
                    *((arc.arc.times, arc.margins[name].values / unit) for _, arc in having), strict=True
                )
                for n, (index, s) in enumerate(curves.minima_after_rise(times, values, AIRBORNE)):
                    k, arc = having[index]
                    (value,), (slope,) = arc.margins[name].at(np.array([s]))
                    yield name, unit, Candidate(f"{name} {k} minimum {n}", float(value), slope)

    def invariance(self) -> Iterator[tuple[str, float, Candidate]]:
        """Name, natural unit and value of every quantity that is zero for an invariant curve, see ``invariance``."""
        labels = invariance_labels(self.equations)
        if not labels:
            return
        for (value, slope), label in zip(self._evaluated(_at_start(self.equations)), labels, strict=True):
            unit = 1 / self.dynamics.scales.time if label.name == RATE else 1.0
            step = f" {label.step}" if label.step else ""
            yield label.name, unit, Candidate(f"{label.name} {label.coordinate}{step}", value, slope)

    def _evaluated(self, function: Function) -> list[Differentiated]:
        """The values of a function (w, p) -> values and Jacobian by w."""
        values, by = buffered(function)(self.solution.w, self.solution.p)
        gradients = by.reshape(len(self.slopes), values.size).T @ self.slopes
        return list(map(Differentiated, values.tolist(), gradients))


OUTPUT, RATE = "output after the impact", "rate of the output after the impact"


def invariance_labels(equations: MultipleShooting) -> tuple[Label, ...]:
    """The labels of the rows of ``invariance``; none if the law's curves need not be invariant."""
    law = equations.system.control
    if not isinstance(law, VirtualConstraints) or not law.is_invariant:
        return ()
    kinds = ((OUTPUT, "rad"), (RATE, "rad/s"))
    return tuple(
        Label(name=name, step=step, coordinate=output, unit=unit)
        for step in range(len(equations.mesh.cycle.steps))
        for name, unit in kinds
        for output in law.outputs
    )


def invariance(equations: MultipleShooting) -> MX:
    """Quantities that are zero if virtual constraints are invariant: outputs and rates just after every impact.

    The outputs then stay zero up to the next impact, which leads back to a posture and rates on the curves.
    """
    t, rows = equations, [MX(0, 1)]
    for phase in t.mesh.cycle.first_phases if invariance_labels(t) else ():
        arc, nodes, start, _ = t.arc(next(k for k, arc in enumerate(t.mesh.arcs) if arc.phase == phase))
        known = t.system.quantities(arc.mode)(
            t=start, z=nodes[:, 0], r=MX(t.system.data(arc.segment)), p=t.phase_parameters[phase]
        )
        rows += [known["outputs"], known["rates"]]
    return vertcat(*rows)


@built_once(maxsize=8)
def _at_start(t: MultipleShooting) -> Function:
    """(w, p) -> rows of ``invariance``, and their Jacobian by w."""
    rows = invariance(t)
    return Function("at_start", [t.w, t.parameters], [rows, densify(jacobian(rows, t.w))])


class ImpactQuantities(NamedTuple):
    """Quantities of the walker and of the ends of steps as expressions of the unknowns of a gait.

    Attributes
    ----------
    of_walker : the quantities that ``OF_WALKER`` names.
    of_steps : for every step, the quantities that ``OF_STEP`` names.
    of_landings : work of the pushes at landings within the steps.
    """

    of_walker: list[MX]
    of_steps: list[list[MX]]
    of_landings: list[MX]


def impact_quantities(t: MultipleShooting) -> ImpactQuantities:
    """The quantities at the impacts of a cycle."""
    system, mesh, cycle = t.system, t.mesh, t.mesh.cycle
    walker, lands = system.walker, system.cycle_end == TOUCHDOWN

    def push_work(z: MX, before: Mode, p: MX) -> MX:
        return system.push(before)(z=z, p=p)["work"] if walker.pushes else MX(0)

    of_steps, of_landings = list[list[MX]](), list[MX]()
    for impact, node, following in zip(cycle.impacts, mesh.impact_nodes, (*cycle.first_phases[1:], 0), strict=True):
        z, before, p = t.Z[:, node], cycle.phases[following - 1], t.phase_parameters[following - 1]
        if not lands:
            of_steps.append([z[system.n_shape], *[MX(0)] * 3])
            continue
        struck = walker.swapped(impact)
        sticking = struck.with_states(dict.fromkeys(struck.touching, "stick"))
        landing = [name for name in struck.touching if name not in before.touching]
        impulse = system.impact(sticking, before)(z=z, p=p)["impulse"]
        landing_indices = [*map(walker.struck_contacts(sticking).index, landing)]
        length = system.impact(struck, before)(z=z, p=p)["z_plus"][system.n_shape]
        impulses = [sum((impulse[2 * k + row] for k in landing_indices), MX(0)) for row in (0, 1)]
        of_steps.append([length, *impulses, push_work(z, before, p)])
    for first, step in zip(cycle.first_phases, cycle.steps, strict=True):
        for phase, landed in ((first + k - 1, landed) for k, landed in step.landings if k):
            before = cycle.phases[phase]
            if {*landed.touching} - {*before.touching}:
                of_landings.append(push_work(t.Z[:, mesh.last_nodes[phase]], before, t.phase_parameters[phase]))
    return ImpactQuantities([MX(system.weight(t.p)), MX(system.incline(t.p))], of_steps, of_landings)


@built_once(maxsize=8)
def _at_impacts(t: MultipleShooting) -> Function:
    """(w, p) -> the quantities at the impacts, those of each step in turn; and their Jacobian by w."""
    of_walker, of_steps, of_landings = impact_quantities(t)
    values = vertcat(*of_walker, *chain.from_iterable(of_steps), *of_landings)
    return Function("at_impacts", [t.w, t.parameters], [values, jacobian(values, t.w)])


@built_once(maxsize=8)
def _impact_margins(t: MultipleShooting) -> Function:
    """(w, p) -> the margins of the impacts, and their Jacobian by w."""
    margins = vertcat(MX(0, 1), *(expression for expression, _ in t.impact_margins))
    return Function("impact_margins", [t.w, t.parameters], [margins, jacobian(margins, t.w)])


def _extremes(
    curve: DifferentiatedCurve, key: str, ends: Sequence[float] = (-1.0, 1.0), after: float = -1.0
) -> Iterator[Candidate]:
    """The values of a curve at the given ends of its arc, and at its extrema after a point."""
    inside = [s for s in curves.critical(curve.values) if s > after]
    names = [*(f"{key} end {s:+.0f}" for s in ends), *(f"{key} extremum {k}" for k in range(len(inside)))]
    for name, value, slope in zip(names, *curve.at(np.array([*ends, *inside])), strict=True):
        yield Candidate(name, float(value), slope)


def _at_root(curve: DifferentiatedCurve, of: DifferentiatedCurve, root: float) -> tuple[float, Array]:
    """Value and gradient of a curve at a root of another one, which moves along the arc; or at the start of the arc."""
    (value,), (slope,) = curve.at(np.array([root]))
    if root > -1:
        rates = [float(curves.slopes(each.values, np.array([root]))[0]) for each in (curve, of)]
        slope = slope - of.at(np.array([root]))[1][0] * rates[0] / rates[1]
    return float(value), slope


def _extreme(candidates: Sequence[Candidate], sense: int) -> Candidate | None:
    """The largest candidate, or the smallest if ``sense`` is -1; None without any; see ``Sensitivity.extremum``."""
    if not candidates:
        return None
    best = max(candidates, key=lambda candidate: sense * candidate.value)
    tied = [c.gradient for c in candidates if abs(c.value - best.value) <= TIED * max(abs(best.value), SMALLEST_SIZE)]
    differ = np.ptp(tied, axis=0) > DIFFERENT * np.maximum(np.abs(tied).max(axis=0), SMALLEST_SIZE)
    return best._replace(gradient=np.where(differ, np.nan, best.gradient))


def _quotient(above: DifferentiatedCurve, below: DifferentiatedCurve) -> DifferentiatedCurve:
    """The quotient of two curves, with its limit at an end where both are zero, as a spring's forces at take-off."""
    both = [np.column_stack([curve.values, curve.slopes]) for curve in (above, below)]
    ends = curves.points(above.values.size)[[0, -1]]
    limits = [curves.evaluate(curves.derivative(curves.coefficients(columns)), ends) for columns in both]
    vanishing = np.abs(below.values) <= WITHOUT_FORCE * np.abs(below.values).max()
    for end in (0, -1):
        if vanishing[end]:
            for columns, limit in zip(both, limits, strict=True):
                columns[end] = limit[end]
    top, bottom = both
    values = top[:, 0] / bottom[:, 0]
    slopes = (top[:, 1:] - values[:, None] * bottom[:, 1:]) / bottom[:, :1]
    return replace(above, values=values, slopes=slopes)
