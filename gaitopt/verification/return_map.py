"""The return map of the simulator on the section just after an impact, its derivative and its fixed points.

xi -> Pi(xi),      Newton:  xi <- xi - t (DPi - I)^-1 (Pi(xi) - xi)            Gamus & Or (2013), section II.C

t is 1 next to a fixed point; from afar it is the first of 1, 1/2, ... that reduces the defect. DPi follows from
variational equations and saltation,

    d/dt Z = f_z Z  along every arc,     Z -> S Z  at every switch,     Z -> R_z (I - f grad g' / g_dot) Z  at impact

with the saltation matrix S of ``model.dynamics``. A breakpoint of the control has a fixed time since the impact, the
same for all neighbouring motions, so that it leaves deviations as they are. Independently of that, the derivative along
a direction v follows from walks alone, by differences that are extrapolated to h = 0:

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
from gaitopt.model.transitions import margin_unit
from gaitopt.simulation.simulator import Simulator

AT_EVENT = 1e-9
"""A margin this close to zero, in natural units, has fallen. It is not close where a torque jumps."""
ROUNDING = 1e-12
"""Error of a simulated step in natural units, before its amplification by the map."""
NEWTON_STEPS = 12
CLOSE = 1e-9
"""Defect, relative to the sizes of the coordinates, at which a damped search ends; the solver refines the result."""
LARGEST_NEWTON_STEP = 0.5
"""Longest step of a damped search, relative to the sizes of the coordinates."""
DAMPING = (1.0, 0.5, 0.25, 0.125, 0.0625)
DAMPED_STEPS = 25
LARGEST, SIZES = 2.0**-12, 16
SMALL = LARGEST / 2**12
"""Largest deviation of a difference, in natural units, and number of deviations, each half as large as the one before.
At the smallest, 7e-9, the rounding of a step is 1e-6 to 1e-5 of the deviation."""

Difference = Callable[[float], Array | None]
StepModes: TypeAlias = list[tuple[tuple[Mode, ...], Mode]]


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleOutcome:
    """One simulated cycle.

    Attributes
    ----------
    xi : ndarray, shape (n_xi,) - section coordinates after the cycle; None if it did not return to the section.
    steps : the simulated steps.
    message : why it did not return.
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
    cycle : the cycle from there.
    residual : largest entry of Pi(xi) - xi in natural units; infinite where the map is not defined.
    accuracy : residual that rounding causes; the derivative of the map amplifies that of early events.
    jacobian : ndarray, shape (n_xi, n_xi) - derivative of the map at ``xi``; None where it is not defined.
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
        """Whether only rounding is left of the residual."""
        return self.residual <= self.accuracy


class ReturnMap:
    """Return map of a simulator, after one or more steps, on the section of one kind of event.

    Parameters
    ----------
    section : the section; or of a walker that stands on one foot at a time, the mode just after the impact.
    near : ndarray, shape (n_z,) - a state of the section, next to which the others are; needed for named contacts.

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
            message = f"the impact ends with {impact.mode.brief}, off the section of {self.section.words}"
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
        simulators : of the steps in turn; they differ where the legs do.
        """
        system = self.simulator.system
        for step, simulator in zip(steps, cycle(simulators), strict=False):
            for arc, after in zip(step.arcs, (*step.arcs[1:], None), strict=True):
                ends = arc.times[[0, -1]]
                deviations = simulator.stepper.propagate_variations(
                    arc.mode, arc.segment, arc.states[0], deviations, ends
                )
                if after is None or after.segment == arc.segment or _switches_at_breakpoint(arc, after):
                    deviations = _event_matrix(arc, after, step.final_impact.mode) @ deviations
            last = step.arcs[-1]
            impact = system.reset_jacobian(_swapped(system, step.final_impact.mode), last.mode)
            deviations = _matrix(impact, last.states[-1], simulator.dynamics.p) @ deviations
            deviations[system.n_shape] = 0.0  # x is counted from the new stance foot
        return deviations

    def scaled(self, jacobian: Array) -> Array:
        """A derivative of the map in natural units."""
        return jacobian * self.unit / self.unit[:, None]

    def fixed_point(self, xi: Array) -> FixedPoint:
        """Newton's method from ``xi``, until only rounding is left of the residual or it no longer falls."""
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
        """The next Newton step from a point, in natural units; infinite where the map has no derivative."""
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
            if defect < CLOSE or outcome.xi is None:
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
        return outcome.steps if defect < CLOSE else None

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

    Only walks with the modes of the fixed point's cycle are used. Where the central difference is not accurate enough,
    as where one side has no such walks (a gait at the limit of friction), those of either side follow.

    Parameters
    ----------
    v : ndarray, shape (n_xi,) - direction in natural units.
    goal, enough : estimated errors at which no smaller deviation, and no other difference, is tried.

    Returns
    -------
    derivative : ndarray, shape (n_xi,); None if no perturbed walk has the modes of the gait.
    error : its estimated error.
    reason : why the last perturbed walk without these modes was not used.
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
        wide = [side for side in sides if side(LARGEST) is not None]
        if len(wide) == 2:
            yield central, 2
        yield from ((side, 1) for side in wide)
        if len(wide) < 2:  # where a small deviation to a side has other modes, so do larger ones
            small = [side for side in sides if side(SMALL) is not None] or sides
            if len(small) == 2:
                yield central, 2
            yield from ((side, 1) for side in small if side not in wide)

    best, error = None, np.inf
    for difference, power in attempts():
        derivative, its_error = extrapolated(difference, power=power, goal=goal)
        if its_error < error:
            best, error = derivative, its_error
        if error <= enough:
            break
    return best, error, reason


def extrapolated(difference: Difference, *, power: int, goal: float) -> tuple[Array | None, float]:
    """The limit of a difference quotient at h = 0, from a tableau of halved deviations, and its estimated error.

    Parameters
    ----------
    difference : quotient for the deviation h; None where it is not defined.
    power : difference of the exponents of its error: 2 of central differences, 1 of one-sided ones.
    goal : estimated error at which to stop.

    References
    ----------
    Ridders (1982), Advances in Engineering Software 4, 75-76.
    """
    best, error = None, np.inf
    row: list[Array] = []
    for k in range(SIZES):
        value = difference(LARGEST / 2**k)
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
    """Whether a walk next to a cycle has its modes; contacts that change together there may do so one by one."""
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
    """Whether every contact does in a mode what it does in one of two others."""
    return mode.is_named and all(
        word in (before.contacts[name], after.contacts[name]) for name, word in mode.contacts.items()
    )


def _switches_at_breakpoint(arc: Arc, after: Arc) -> bool:
    """Whether the mode changes at a breakpoint of the control by an event, and not by the jump of a torque."""
    if after.mode is arc.mode:
        return False
    dynamics, table = arc.dynamics, arc.dynamics.system.transitions
    name = table.between(arc.mode, after.mode, _struck(arc.dynamics.system, after)).guard
    margins = dynamics.margins(arc.mode, arc.segment, arc.times[-1:], arc.states[-1:])[0]
    unit = margin_unit(name, dynamics.scales)
    return bool(abs(margins[table.margin_names(arc.mode).index(name)]) <= AT_EVENT * unit)


def _struck(system: HybridSystem, arc: Arc) -> Mode | None:
    """The landing with which an arc begins, with the contacts as they are called before it."""
    return None if arc.struck is None else system.transitions.struck_within(arc.struck)


def _swapped(system: HybridSystem, impact: Mode) -> Mode:
    """The impact at the end of a step, with the contacts as they are called before it."""
    return system.walker.swapped(impact) if system.cycle_end == TOUCHDOWN else impact


def _event_matrix(arc: Arc, after: Arc | None, impact: Mode) -> Array:
    """Matrix by which the event at the end of an arc of a step with a final ``impact`` maps deviations; (n_z, n_z)."""
    system, p, z = arc.dynamics.system, arc.dynamics.p, arc.states[-1]
    data, struck = system.data(arc.segment), _swapped(system, impact) if after is None else _struck(system, after)
    transition = system.transitions.between(arc.mode, None if after is None else after.mode, struck)
    if transition.guard == CLOCK:
        return np.eye(z.size)
    row = system.transitions.margin_names(arc.mode).index(transition.guard)
    flow, gradients, rates = buffered(system.linearized(arc.mode))(arc.end, z, p, data)
    gradient, rate = gradients.reshape(z.size, -1)[:, row], rates[row].item()
    if after is None:
        return projection(flow, gradient, rate)
    (flow_after,) = buffered(system.flow(after.mode))(after.start, after.states[0], p, data)
    reset = None
    if struck is not None:
        reset = _matrix(system.reset_jacobian(struck, arc.mode, ends_step=False), z, p).copy()
    elif system.transitions.stops_in_turn(arc.mode, after.mode):
        reset = _matrix(system.stopped_together_jacobian(arc.mode, after.mode), arc.end, z, p, data).copy()
    elif transition.reset is not None:  # a stop locks
        slides = after.states[0][-1] or not after.mode.touching
        struck = after.mode if slides else after.mode.with_contact(Mode.STICK)
        reset = _matrix(system.reset_jacobian(struck, arc.mode, ends_step=False), z, p).copy()
    return saltation(flow, flow_after, gradient, rate, reset)


def _matrix(function: Function, *values: Array | float) -> Array:
    """The one output of a function as a matrix, valid until it is called again."""
    return buffered(function)(*values)[0].reshape(function.size_out(0), order="F")
