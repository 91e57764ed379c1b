"""The return map of the simulator on the section just after an impact, its derivative and its fixed points.

xi -> Pi(xi),      Newton:  xi <- xi - t (DPi - I)^-1 (Pi(xi) - xi)            Gamus & Or (2013), section II.C

Next to a fixed point t is 1; far from it t is the first of 1, 1/2, ... that reduces the defect. DPi follows from
variational equations and saltation,

    d/dt Z = f_z Z  along every arc,     Z -> S Z  at every switch,     Z -> R_z (I - f grad g' / g_dot) Z  at impact

with the saltation matrix S of ``model.dynamics``. A breakpoint of the control does not change deviations, because its
time since the impact is the same for all neighbouring motions. As an independent check, the derivative along a
direction v also follows from walks alone, by differences that are extrapolated to h = 0:

    (Pi(xi + h v) - Pi(xi - h v)) / 2h = DPi v + c_2 h^2 + c_4 h^4 + ...    Ridders (1982), Adv. Eng. Software 4, 75-76
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle, zip_longest
from typing import TypeAlias

import numpy as np
from casadi import Function

from gaitopt.arrays import Array
from gaitopt.gait.trajectory import Arc, Step
from gaitopt.model.buffered import buffered
from gaitopt.model.dynamics import projection, saltation
from gaitopt.model.modes import Mode
from gaitopt.model.section import CLOCK, TOUCHDOWN, Section
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import Transition, margin_unit
from gaitopt.simulation.simulator import Simulator

AT_EVENT = 1e-9
"""A margin that is this close to zero, in natural units, has caused the event. If the jump of a torque caused it, the
margin is larger."""
ROUNDING = 1e-12
"""Error of a simulated step in natural units, before its amplification by the map."""
NEWTON_STEPS = 12
"""Largest number of undamped Newton steps."""
DAMPED_DEFECT = 1e-9
"""Defect, relative to the sizes of the coordinates, at which a damped search ends; the solver refines the result."""
LARGEST_NEWTON_STEP = 0.5
"""Longest step of a damped search, relative to the sizes of the coordinates."""
DAMPING = (1.0, 0.5, 0.25, 0.125, 0.0625)
"""Values of t that a damped search tries for every step."""
DAMPED_STEPS = 25
"""Largest number of damped Newton steps."""
LARGEST_DEVIATION, DEVIATIONS = 2.0**-12, 16
"""Largest deviation h of a difference, in natural units, and number of deviations, each half as large as the one
before. At the smallest, 7e-9, rounding of a step is 1e-6 to 1e-5 of the deviation."""
SMALL_DEVIATION = LARGEST_DEVIATION / 2**12
"""Deviation that shows whether walks close to the gait have its modes, if those with the largest deviation have not."""

Difference = Callable[[float], Array | None]
StepModes: TypeAlias = list[tuple[tuple[Mode, ...], Mode]]


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleOutcome:
    """One simulated cycle.

    Attributes
    ----------
    xi : ndarray, shape (n_xi,) - section coordinates after the cycle; None if the walk did not return to the section.
    steps : the simulated steps.
    message : why the walk did not return.
    """

    xi: Array | None
    steps: tuple[Step, ...]
    message: str

    @property
    def sequence(self) -> StepModes:
        """Phases and impact of every step of a cycle that returned."""
        return [(tuple(mode for mode, _ in step.phases), step.final_impact.mode) for step in self.steps]


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedPoint:
    """Result of Newton's method on the return map.

    Attributes
    ----------
    xi : ndarray, shape (n_xi,) - last iterate.
    cycle : the simulated cycle that starts at ``xi``.
    residual : largest entry of Pi(xi) - xi in natural units; infinite if the map is not defined there.
    accuracy : residual that rounding causes. The derivative of the map amplifies the rounding errors of early events.
    jacobian : ndarray, shape (n_xi, n_xi) - derivative of the map at ``xi``; None if it is not defined there.
    message : why there is no derivative.
    """

    xi: Array
    cycle: CycleOutcome
    residual: float
    accuracy: float
    jacobian: Array | None
    message: str

    @property
    def converged(self) -> bool:
        """Whether the residual is no larger than rounding makes it."""
        return self.residual <= self.accuracy


class ReturnMap:
    """Return map of a simulator, after one or more steps, on the section of one kind of event.

    Parameters
    ----------
    section : the section. For a walker that stands on one foot at a time, the mode just after the impact suffices.
    near : ndarray, shape (n_z,) - a state on the section. Named contacts need it, because more than one state can have
        the same section coordinates; the map takes the one near this state.

    Attributes
    ----------
    unit : ndarray, shape (n_xi,) - natural units of the section coordinates.
    """

    def __init__(
        self, simulator: Simulator, section: Section | Mode, n_steps: int = 1, near: Array | None = None
    ) -> None:
        self.simulator, self.n_steps = simulator, n_steps
        self.section = simulator.system.section(section) if isinstance(section, Mode) else section
        self._near = np.zeros(simulator.system.n_z) if near is None else near
        self._indices = self.section.indices
        self.unit = simulator.dynamics.state_units[self._indices]

    def __call__(self, xi: Array) -> CycleOutcome:
        """Simulate one cycle from section coordinates ``xi``."""
        start = self.section.lift(xi, self.simulator.dynamics.p, self._near)
        if not np.isfinite(start).all():
            return CycleOutcome(xi=None, steps=(), message="the section coordinates belong to no state of the walker")
        trajectory = self.simulator.run(start, steps=self.n_steps)
        steps, message, after = trajectory.steps, trajectory.message, None
        impact = steps[-1].impact if len(steps) == self.n_steps else None
        if impact is not None and self.section.holds(steps[-1].arcs[-1].mode, impact.mode):
            after = impact.state[self._indices]
        elif impact is not None:
            message = f"the impact ends with {impact.mode.brief}, off the section of {self.section.contacts_after}"
        return CycleOutcome(xi=after, steps=steps, message=message)

    @np.errstate(divide="ignore", invalid="ignore")  # at a grazed event the rate is zero
    def jacobian(self, steps: Sequence[Step]) -> Array:
        """Derivative of the map along complete steps from and to the section, shape (n_xi, n_xi).

        It is not finite if a step grazes an event.
        """
        deviations = self.section.tangent(steps[0].arcs[0].states[0], self.simulator.dynamics.p)
        return np.asarray(self.propagated(steps, deviations, self.simulator.per_step)[self._indices])

    def propagated(self, steps: Sequence[Step], deviations: Array, simulators: Sequence[Simulator]) -> Array:
        """Deviations (n_z, m) just after the impact that ends complete steps, from those at their start.

        Parameters
        ----------
        simulators : simulators of consecutive steps, repeated in turn; they differ if the legs differ.
        """
        correction, corrected, changes = self.simulator.system.correction, np.zeros((0, 0)), None
        for n, (step, nominal) in enumerate(zip(steps, cycle(simulators), strict=False)):
            if correction is not None and n % correction.every == 0:
                corrected = correction.slopes(self.simulator.dynamics.p, step.arcs[0].states[0])[0] @ deviations
            if correction is not None:
                changes = correction.by_entry(corrected, n)
            for arc, after in zip(step.arcs, (*step.arcs[1:], None), strict=True):
                system, ends = arc.dynamics.system, arc.times[[0, -1]]
                is_nominal = system is nominal.system and correction is None
                simulator = nominal if is_nominal else nominal.on(arc.dynamics)
                deviations = simulator.stepper.propagate_variations(
                    arc.mode, arc.segment, arc.states[0], deviations, ends, changes
                )
                if after is None or after.segment == arc.segment or _switches_at_breakpoint(arc, after):
                    across, later = _event_matrices(arc, after, step.final_impact.mode)
                    deviations = across @ deviations
                    if changes is not None:
                        deviations += later @ changes
            last = step.arcs[-1]
            impact = system.reset_jacobian(_swapped(system, step.final_impact.mode), last.mode)
            deviations = _matrix(impact, last.states[-1], simulator.dynamics.p) @ deviations
            deviations[system.n_shape] = 0.0  # x is counted from the new stance foot
        return deviations

    def scaled(self, jacobian: Array) -> Array:
        """A derivative of the map, converted to natural units."""
        return jacobian * self.unit / self.unit[:, None]

    def fixed_point(self, xi: Array) -> FixedPoint:
        """Newton's method from ``xi``, until the residual is down to rounding or does not decrease any more."""
        point = self._evaluated(xi)
        for _ in range(NEWTON_STEPS):
            if point.converged or point.jacobian is None:
                break
            following = self._evaluated(point.xi - self.correction(point) * self.unit)
            if not following.residual < point.residual:
                break
            point = following
        return point

    def correction(self, point: FixedPoint) -> Array:
        """The next Newton step from a point, in natural units; infinite if the map has no derivative there."""
        if point.jacobian is None or point.cycle.xi is None:
            return np.full(point.xi.size, np.inf)
        defect = (point.cycle.xi - point.xi) / self.unit
        return np.asarray(np.linalg.lstsq(self.scaled(point.jacobian) - np.eye(point.xi.size), defect, rcond=None)[0])

    def damped_fixed_point(self, xi: Array, sizes: Array) -> tuple[Step, ...] | None:
        """The cycle of a fixed point, by damped Newton steps from ``xi``; None if they do not converge.

        Parameters
        ----------
        sizes : ndarray, shape (n_xi,) - typical sizes of the coordinates.
        """

        def defect_of(outcome: CycleOutcome, start: Array) -> float:
            return np.inf if outcome.xi is None else float(np.abs((outcome.xi - start) / sizes).max())

        outcome = self(xi)
        defect = defect_of(outcome, xi)
        for _ in range(DAMPED_STEPS):
            if defect < DAMPED_DEFECT or outcome.xi is None:
                break
            slope = self.jacobian(outcome.steps) - np.eye(xi.size)
            if not np.isfinite(slope).all():
                break
            newton = -np.linalg.lstsq(slope, outcome.xi - xi, rcond=None)[0]
            newton /= max(1.0, float(np.abs(newton / sizes).max()) / LARGEST_NEWTON_STEP)
            for t in DAMPING:
                trial = xi + t * newton
                returned = self(trial)
                if defect_of(returned, trial) < (1 - t / 4) * defect:
                    break
            else:
                break
            xi, outcome, defect = trial, returned, defect_of(returned, trial)
        return outcome.steps if defect < DAMPED_DEFECT else None

    def _evaluated(self, xi: Array) -> FixedPoint:
        """The defect and the derivative of the map at ``xi``."""
        outcome, residual, jacobian = self(xi), np.inf, None
        accuracy, message = ROUNDING, outcome.message
        if outcome.xi is not None:
            residual = float(np.abs((outcome.xi - xi) / self.unit).max())
            jacobian = self.jacobian(outcome.steps)
            if np.isfinite(jacobian).all():
                accuracy *= max(1.0, float(np.linalg.norm(self.scaled(jacobian), np.inf)))
            else:
                jacobian, message = None, "the walk grazes an event, where the return map has no derivative"
        return FixedPoint(
            xi=xi, cycle=outcome, residual=residual, accuracy=accuracy, jacobian=jacobian, message=message
        )


def directional_derivative(
    return_map: ReturnMap, point: FixedPoint, v: Array, *, goal: float, enough: float
) -> tuple[Array | None, float, str]:
    """Derivative of a map at its fixed point along ``v`` by differences of walks, in natural units.

    Only walks with the modes of the fixed point's cycle are used. If the central difference is not accurate enough, the
    one-sided differences are tried. At the limit of friction, for example, one side has no walks with these modes.

    Parameters
    ----------
    v : ndarray, shape (n_xi,) - direction in natural units.
    goal, enough : estimated errors. Smaller deviations are tried until the error is below ``goal``, other differences
        until it is below ``enough``.

    Returns
    -------
    derivative : ndarray, shape (n_xi,); None if no perturbed walk has the modes of the gait.
    error : estimated error of the derivative.
    reason : why the last rejected walk was not used; empty if none was rejected.
    """
    if point.cycle.xi is None:
        return None, np.inf, point.message
    image, reason = point.cycle.xi, ""
    returns: dict[float, Array | None] = {}

    def ahead(h: float) -> Array | None:
        """(P(xi + h v) - P(xi)) / h."""
        nonlocal reason
        if h not in returns:
            outcome = return_map(point.xi + h * v * return_map.unit)
            returns[h] = None
            if outcome.xi is None:
                reason = outcome.message
            elif not _has_modes_of(point.cycle.sequence, outcome.sequence):
                reason = "a perturbed walk goes through other modes"
            else:
                returns[h] = (outcome.xi - image) / return_map.unit
        difference = returns[h]
        return None if difference is None else difference / h

    def behind(h: float) -> Array | None:
        return ahead(-h)

    def central(h: float) -> Array | None:
        one = ahead(h)
        other = None if one is None else ahead(-h)
        return None if one is None or other is None else (one + other) / 2

    def attempts() -> Iterator[tuple[Difference, int]]:
        """Differences in turn, with the first power of h in their errors."""
        sides = (ahead, behind)
        wide = [side for side in sides if side(LARGEST_DEVIATION) is not None]
        if len(wide) == 2:
            yield central, 2
        yield from ((side, 1) for side in wide)
        if len(wide) < 2:  # if a small deviation to one side leads to other modes, so do larger ones
            small = [side for side in sides if side(SMALL_DEVIATION) is not None] or sides
            if len(small) == 2:
                yield central, 2
            yield from ((side, 1) for side in small if side not in wide)

    best, error = None, np.inf
    for difference, power in attempts():
        derivative, estimate = extrapolated(difference, power=power, goal=goal)
        if estimate < error:
            best, error = derivative, estimate
        if error <= enough:
            break
    return best, error, reason


def extrapolated(difference: Difference, *, power: int, goal: float) -> tuple[Array | None, float]:
    """The limit of a difference quotient at h = 0, from a tableau of halved deviations, and its estimated error.

    Parameters
    ----------
    difference : the quotient as a function of the deviation h; None if it is not defined.
    power : step of the exponents of h in its error: 2 for central differences, 1 for one-sided ones.
    goal : estimated error at which to stop.

    References
    ----------
    Ridders (1982), Advances in Engineering Software 4, 75-76.
    """
    best, error = None, np.inf
    row: list[Array] = []
    for k in range(DEVIATIONS):
        value = difference(LARGEST_DEVIATION / 2**k)
        if value is None:
            row = []
            continue
        previous, row = row, [value]
        for j, above in enumerate(previous, start=1):
            row.append(row[-1] + (row[-1] - above) / (2 ** (power * j) - 1))
            estimate = max(float(np.abs(row[j] - row[j - 1]).max()), float(np.abs(row[j] - above).max()))
            if estimate < error:
                best, error = row[j], estimate
        if error <= goal:
            break
    return best, error


def _has_modes_of(cycle: StepModes, walked: StepModes) -> bool:
    """Whether a walk next to a cycle has its modes; contacts that change together in the cycle may do so one by one."""
    if [impact for _, impact in walked] != [impact for _, impact in cycle]:
        return False
    for (phases, _), (passed, _) in zip(cycle, walked, strict=True):
        rest = [*passed]
        for mode, after in zip_longest(phases, phases[1:]):
            if not rest or rest.pop(0) is not mode:
                return False
            while after is not None and rest and rest[0] is not after and _lies_between(rest[0], mode, after):
                del rest[0]
        if rest:
            return False
    return True


def _lies_between(mode: Mode, before: Mode, after: Mode) -> bool:
    """Whether the state of each contact in ``mode`` is that in ``before`` or ``after``, and ``mode`` is neither."""
    return mode.contacts not in (before.contacts, after.contacts) and all(
        state in (before.contacts[name], after.contacts[name]) for name, state in mode.contacts.items()
    )


def _switches_at_breakpoint(arc: Arc, after: Arc) -> bool:
    """Whether an event changes the mode at a breakpoint of the control, and not the jump of a torque."""
    if after.mode is arc.mode:
        return False
    dynamics, table = arc.dynamics, arc.dynamics.system.transitions
    name = table.between(arc.mode, after.mode, _struck(arc.dynamics.system, after)).guard
    margins = dynamics.margins(arc.mode, arc.segment, arc.times[-1:], arc.states[-1:])[0]
    unit = margin_unit(name, dynamics.scales)
    return bool(abs(margins[table.margin_names(arc.mode).index(name)]) <= AT_EVENT * unit)


def _struck(system: HybridSystem, arc: Arc) -> Mode | None:
    """The landing with which an arc begins, with the names of the contacts before it."""
    return None if arc.struck is None else system.transitions.struck_within(arc.struck)


def _swapped(system: HybridSystem, impact: Mode) -> Mode:
    """The impact at the end of a step, with the names of the contacts before it."""
    return system.walker.swapped(impact) if system.cycle_end == TOUCHDOWN else impact


def event_at_end(arc: Arc, after: Arc | None, impact: Mode) -> tuple[Transition, Mode | None]:
    """The row of the event at the end of an arc, and the mode just after its impact; None if the state is continuous.

    Parameters
    ----------
    after : the next arc of the step; None if the step ends with ``impact``.

    Returns
    -------
    row : the row of the table.
    struck : the mode just after the impact, with the names that the contacts have before it.
    """
    system = arc.dynamics.system
    struck = _swapped(system, impact) if after is None else _struck(system, after)
    row = system.transitions.between(arc.mode, None if after is None else after.mode, struck)
    if after is not None and struck is None and row.reset is not None:  # a stop locks
        slides = after.states[0][-1] or not after.mode.touching
        struck = after.mode if slides else after.mode.with_contact(Mode.STICK)
    return row, struck


def _event_matrices(arc: Arc, after: Arc | None, impact: Mode) -> tuple[Array, Array]:
    """Matrices by which the event at the end of an arc maps deviations; the step ends with ``impact``.

    The first one, (n_z, n_z), maps deviations of the state. The second one, (n_z, n_u), maps those of the parameters
    that feedback from step to step corrects: they shift the event.
    """
    system, p, z = arc.dynamics.system, arc.dynamics.p, arc.states[-1]
    n_u = 0 if system.correction is None else len(system.correction.entries)
    data, (transition, struck) = system.data(arc.segment), event_at_end(arc, after, impact)
    if transition.guard == CLOCK:
        return np.eye(z.size), np.zeros((z.size, n_u))
    row = system.transitions.margin_names(arc.mode).index(transition.guard)
    flow, gradients, rates = buffered(system.linearized(arc.mode))(arc.end, z, p, data)
    gradient, rate = gradients.reshape(z.size, -1)[:, row], rates[row].item()
    by_changes = np.zeros((1, n_u))  # how much later the event comes, per change of a corrected parameter
    if n_u:
        (margins,) = buffered(system.margins_by_corrected(arc.mode))(arc.end, z, p, data)
        by_changes = margins.reshape(n_u, -1)[:, row][None] / rate
    if after is None:
        return projection(flow, gradient, rate), -flow.reshape(-1, 1) @ by_changes
    (flow_after,) = buffered(system.flow(after.mode))(after.start, after.states[0], p, data)
    reset = None
    if struck is not None:
        reset = _matrix(system.reset_jacobian(struck, arc.mode, ends_step=False), z, p).copy()
    elif system.transitions.stops_in_turn(arc.mode, after.mode):
        reset = _matrix(system.stopped_together_jacobian(arc.mode, after.mode), arc.end, z, p, data).copy()
    jump = flow_after - (flow if reset is None else reset @ flow)
    return saltation(flow, flow_after, gradient, rate, reset), jump.reshape(-1, 1) @ by_changes


def _matrix(function: Function, *values: Array | float) -> Array:
    """The first output of a function as a matrix, valid until the function is called again."""
    return buffered(function)(*values)[0].reshape(function.size_out(0), order="F")
