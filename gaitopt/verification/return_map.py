"""The return map of the simulator on the section just after an impact, its derivative and its fixed points.

xi -> Pi(xi),      Newton:  xi <- xi - t (DPi - I)^-1 (Pi(xi) - xi)            Gamus & Or (2013), section II.C

t is 1 next to a fixed point; from afar it is the first of 1, 1/2, ... that reduces the defect. DPi follows from
variational equations and saltation,

    d/dt Z = f_z Z  along every arc,     Z -> S Z  at every switch,     Z -> R_z (I - f grad g' / g_dot) Z  at impact

with the saltation matrix S of ``model.dynamics``. A breakpoint of the control has a fixed time since the impact, the
same for all neighbouring motions, so that it leaves deviations as they are.

``return_map`` applies the map to thousands of states at once: arrays in, arrays and named outcomes out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle
from typing import Any

import numpy as np
from casadi import Function

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.gait.gait import Gait
from gaitopt.gait.trajectory import Arc, Step
from gaitopt.model.buffered import RowMap, buffered
from gaitopt.model.dynamics import Dynamics, projection, saltation
from gaitopt.model.modes import Mode
from gaitopt.model.transitions import Ending, margin_unit
from gaitopt.problem.problem import Problem
from gaitopt.simulation.engine import Engine, choose_engine
from gaitopt.simulation.outcomes import ARRAYS, StepOutcome, StepOutcomes, stack_outcomes
from gaitopt.simulation.simulator import Simulator
from gaitopt.systems import problem_dynamics
from gaitopt.threads import cached_property, per_thread
from gaitopt.workers.jobs import FailedJob, Job, Workers, run_jobs

AT_EVENT = 1e-9
"""A margin this close to zero, in natural units, has fallen. It is not close where a torque jumps."""
ROUNDING = 1e-12
"""Error of a simulated step in natural units, before its amplification by the map."""
NEWTON_STEPS = 12
CLOSE = 1e-9
"""Defect, relative to the sizes of the coordinates, at which a damped search ends; the solver refines the result."""
LONGEST = 0.5
"""Longest step of a damped search, relative to the sizes of the coordinates."""
DAMPING = (1.0, 0.5, 0.25, 0.125, 0.0625)
DAMPED_STEPS = 25
UNDEFINED = StepOutcome(
    step=None, ending=Ending.NUMERICAL, message="the section coordinates belong to no state of the walker"
)
"""Outcome where a coordinate or rate does not follow from the section, as for a runner too fast for its energy."""
CHUNK = 4096
"""Number of states of one job: a tenth of a second of work, a third of a megabyte."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedPoint:
    """Outcome of Newton's method on the return map.

    Attributes
    ----------
    xi : ndarray, shape (n_xi,) - last iterate.
    residual : largest entry of Pi(xi) - xi in natural units; infinite where the map is not defined.
    accuracy : residual that rounding causes; the derivative of the map amplifies that of early events.
    steps : the steps from ``xi``.
    jacobian : ndarray, shape (n_xi, n_xi) - derivative of the map at ``xi``; None where it is not defined.
    message : why there is no derivative.
    """

    xi: Array
    residual: float
    accuracy: float
    steps: tuple[Step, ...]
    jacobian: Array | None
    message: str

    @property
    def converged(self) -> bool:
        """Whether only rounding is left of the residual."""
        return self.residual <= self.accuracy


class ReturnMap:
    """Return map of a simulator, after one or more steps, on the section of one kind of impact."""

    def __init__(self, simulator: Simulator, section_mode: Mode, n_steps: int = 1) -> None:
        self.simulator, self.section_mode, self.n_steps = simulator, section_mode, n_steps
        self._indices = simulator.system.section(section_mode)
        self._units = simulator.dynamics.state_units[self._indices]

    def __call__(self, xi: Array) -> CycleOutcome:
        """Simulate one cycle from section coordinates ``xi``."""
        trajectory = self.simulator.run(self.simulator.dynamics.lift(xi), steps=self.n_steps)
        steps, message, after = trajectory.steps, trajectory.message, None
        impact = steps[-1].impact if len(steps) == self.n_steps else None
        if impact is not None and impact.mode.sticks is self.section_mode.sticks:
            after = impact.state[self._indices]
        elif impact is not None:
            message = f"the impact ends with {impact.mode}, off the section of {self.section_mode}"
        return CycleOutcome(xi=after, steps=steps, message=message)

    @np.errstate(divide="ignore", invalid="ignore")  # at a grazed event the rate is zero
    def jacobian(self, steps: Sequence[Step]) -> Array:
        """Derivative of the map along complete steps from and to the section, shape (n_xi, n_xi).

        It is not finite if a step grazes an event.
        """
        system, p = self.simulator.system, self.simulator.dynamics.p
        start = steps[0].arcs[0].states[0]
        lift = _matrix(system.lift_jacobian, start[system.section(Mode.SLIP_FORWARD)], p)
        deviations = lift[:, : self._indices.size]
        for step, simulator in zip(steps, cycle(self.simulator.per_step), strict=False):
            for arc, after in zip(step.arcs, (*step.arcs[1:], None), strict=True):
                ends = arc.times[[0, -1]]
                deviations = simulator.stepper.propagate_variations(
                    arc.mode, arc.segment, arc.states[0], deviations, ends
                )
                if after is None or after.segment == arc.segment or _ends_at_breakpoint(arc, after):
                    deviations = _event(arc, after) @ deviations
            impact = system.impact_jacobian(step.final_impact.mode)
            deviations = _matrix(impact, step.arcs[-1].states[-1], simulator.dynamics.p) @ deviations
            deviations[system.n_shape] = 0.0  # x is counted from the new stance foot
        return np.asarray(deviations[self._indices])

    def fixed_point(self, xi: Array) -> FixedPoint:
        """Newton's method from ``xi``, until only rounding is left of the residual or it no longer falls."""
        point = self._evaluated(xi)
        for _ in range(NEWTON_STEPS):
            if point.converged or point.jacobian is None:
                break
            defect = (point.steps[-1].final_impact.state[self._indices] - point.xi) / self._units
            newton = np.linalg.lstsq(self._scaled(point.jacobian) - np.eye(xi.size), defect, rcond=None)[0]
            following = self._evaluated(point.xi - newton * self._units)
            if not following.residual < point.residual:
                break
            point = following
        return point

    def damped_fixed_point(self, xi: Array, sizes: Array) -> tuple[Step, ...] | None:
        """The cycle of a fixed point, by damped Newton steps from ``xi``; None if they do not converge.

        Parameters
        ----------
        sizes : ndarray, shape (n_xi,) - typical sizes of the coordinates.
        """

        def size_of(result: CycleOutcome, start: Array) -> float:
            return np.inf if result.xi is None else float(np.abs((result.xi - start) / sizes).max())

        result = self(xi)
        size = size_of(result, xi)
        for _ in range(DAMPED_STEPS):
            if size < CLOSE or result.xi is None:
                break
            slope = self.jacobian(result.steps) - np.eye(xi.size)
            if not np.isfinite(slope).all():
                break
            newton = -np.linalg.lstsq(slope, result.xi - xi, rcond=None)[0]
            newton /= max(1.0, float(np.abs(newton / sizes).max()) / LONGEST)
            for t in DAMPING:
                trial = xi + t * newton
                returned = self(trial)
                if size_of(returned, trial) < (1 - t / 4) * size:
                    break
            else:
                break
            xi, result, size = trial, returned, size_of(returned, trial)
        return result.steps if size < CLOSE else None

    def _evaluated(self, xi: Array) -> FixedPoint:
        """The defect and the derivative of the map at ``xi``."""
        result, residual, jacobian = self(xi), np.inf, None
        accuracy, message = ROUNDING, result.message
        if result.xi is not None:
            residual = float(np.abs((result.xi - xi) / self._units).max())
            jacobian = self.jacobian(result.steps)
            if np.isfinite(jacobian).all():
                accuracy *= max(1.0, float(np.linalg.norm(self._scaled(jacobian), np.inf)))
            else:
                jacobian, message = None, "the walk grazes an event, where the return map has no derivative"
        return FixedPoint(
            xi=xi, residual=residual, accuracy=accuracy, steps=result.steps, jacobian=jacobian, message=message
        )

    def _scaled(self, jacobian: Array) -> Array:
        """The derivative of the map in natural units."""
        return jacobian * self._units / self._units[:, None]


def return_map(
    start: Problem | Gait, states: Array, *, engine: str = Engine.AUTO, workers: int = 1, should_stop: Stop = None
) -> StepOutcomes:
    """Walk one step from each of many states just after an impact; one step with either leg if the legs differ.

    The result of a state depends neither on the other states nor on their number, order or distribution over processes.

    Parameters
    ----------
    start : problem or gait; its walker, control and friction are used.
    states : ndarray, shape (n, k) - section coordinates, with ``dx`` as the last column or without it (at rest).
    engine : ``auto``, ``scipy`` or ``heyoka``.
    workers : number of processes.

    Raises
    ------
    ValueError
        If ``states`` does not have such a shape, or is not finite.
    UnknownNameError
        If the engine is unknown or not installed.
    """
    problem = start.problem if isinstance(start, Gait) else start
    xi = section_coordinates(problem, states)
    chosen = choose_engine(engine, steps=len(xi))
    p = tuple(start.p.tolist()) if isinstance(start, Gait) else None
    chunks = [xi[k : k + CHUNK] for k in range(0, len(xi), CHUNK)] or [xi]
    arguments = [(problem, p, chosen, chunk) for chunk in chunks]
    if workers == 1:
        parts = [map_chunk(argument) for argument in arguments]
    else:
        jobs = [Job(key=f"chunk-{k}-{id(xi)}", argument=argument) for k, argument in enumerate(arguments)]
        results = dict(run_jobs(map_chunk, jobs, Workers(count=workers), should_stop=should_stop))
        for result in results.values():
            if isinstance(result, FailedJob):
                raise RuntimeError(f"a chunk of states was not mapped: {result.reason}")
        parts = [results[job.key] for job in jobs]
    joined: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in ARRAYS}
    return replace(parts[0], **joined)


def section_coordinates(problem: Problem, states: Array) -> Array:
    """The states as floats with all section coordinates, ``dx`` included; shape (n, k).

    Raises
    ------
    ValueError
        If their shape is wrong, or they are not finite.
    """
    names = problem.walker.section_names(slipping=True)
    xi = np.asarray(states, dtype=float)
    if xi.ndim != 2 or xi.shape[1] not in (len(names) - 1, len(names)):
        raise ValueError(f"states of shape {xi.shape}: one row per state is needed, columns {', '.join(names)}")
    if not np.isfinite(xi).all():
        raise ValueError(f"states must be finite; row {np.flatnonzero(~np.isfinite(xi).all(axis=1))[0]} is not")
    return np.hstack([xi, np.zeros((len(xi), len(names) - xi.shape[1]))])


def map_chunk(argument: tuple[Problem, tuple[float, ...] | None, Engine, Array], _: None = None) -> StepOutcomes:
    """One chunk of ``return_map``; runs in any process."""
    problem, p, engine, xi = argument
    return step_map(problem, p, engine)(xi)


class StepMap:
    """The return map of one system at fixed parameters for arrays of section coordinates (n, k)."""

    def __init__(self, dynamics: Dynamics, engine: Engine) -> None:
        self.dynamics, self._engine = dynamics, engine
        system = dynamics.system
        self.names = system.walker.section_names(slipping=True)
        self._indices = system.section(Mode.SLIP_FORWARD)
        self._lift = RowMap(system.lift)

    def __call__(self, xi: Array) -> StepOutcomes:
        """One step from every state; one step with either leg if the legs differ. See ``section_coordinates``."""
        (states,) = self._lift(xi, self.dynamics.p)
        first, *others = self._steps
        walked = first(states)
        for step in others:
            rows = np.flatnonzero(walked.completed)
            if rows.size:
                walked = walked.followed_by(step(walked.states[rows]), rows)
        return replace(walked, names=self.names, states=walked.states[:, self._indices])

    @cached_property
    def _steps(self) -> list[Callable[[Array], StepOutcomes]]:
        """One step from every state, shape (n, n_z), for each of ``dynamics.steps``."""
        if self._engine is Engine.HEYOKA:
            from gaitopt.simulation.heyoka_batch import BatchSimulator  # needs heyoka, which is optional

            return [BatchSimulator(dynamics).step for dynamics in self.dynamics.steps]

        def one_by_one(simulator: Simulator, states: Array) -> StepOutcomes:
            outcomes = [simulator.step(state) if np.isfinite(state).all() else UNDEFINED for state in states]
            return stack_outcomes(outcomes, states, simulator.system)

        return [partial(one_by_one, simulator) for simulator in Simulator(self.dynamics).per_step]


@per_thread(maxsize=8)
def step_map(problem: Problem, p: tuple[float, ...] | None, engine: Engine) -> StepMap:
    """The map of a problem, built once per thread; ``p`` are parameters other than those of the problem."""
    dynamics = problem_dynamics(problem)
    return StepMap(Dynamics(dynamics.system, np.array(p)) if p else dynamics, engine)


def _ends_at_breakpoint(arc: Arc, after: Arc) -> bool:
    """Whether the mode changes at a breakpoint of the control, so that no arc lies between the two events."""
    if after.mode is arc.mode:
        return False
    dynamics = arc.dynamics
    table = dynamics.system.transitions
    name = table.between(arc.mode, after.mode).guard
    margins = dynamics.margins(arc.mode, arc.segment, arc.times[-1:], arc.states[-1:])[0]
    unit = margin_unit(name, dynamics.scales)
    return bool(abs(margins[table.margin_names(arc.mode).index(name)]) <= AT_EVENT * unit)


def _event(arc: Arc, after: Arc | None) -> Array:
    """Matrix by which the event at the end of an arc maps deviations; shape (n_z, n_z)."""
    system, p, z = arc.dynamics.system, arc.dynamics.p, arc.states[-1]
    data = system.data(arc.segment)
    transition = system.transitions.between(arc.mode, None if after is None else after.mode)
    row = system.transitions.margin_names(arc.mode).index(transition.guard)
    flow, gradients, rates = buffered(system.linearized(arc.mode))(arc.end, z, p, data)
    gradient, rate = gradients.reshape(z.size, -1)[:, row], rates[row].item()
    if after is None:
        return projection(flow, gradient, rate)
    (flow_after,) = buffered(system.flow(after.mode))(after.start, after.states[0], p, data)
    return saltation(flow, flow_after, gradient, rate, _reset(arc, after))


def _reset(arc: Arc, after: Arc) -> Array | None:
    """Derivative of the reset from one arc to the next; None where no stop locks."""
    if arc.mode.locked == after.mode.locked:
        return None
    slides = after.states[0][-1] or not after.mode.touching
    struck = after.mode if slides else after.mode.with_contact(Mode.STICK)
    return _matrix(arc.dynamics.system.impact_jacobian(struck), arc.states[-1], arc.dynamics.p).copy()


def _matrix(function: Function, *values: Array | float) -> Array:
    """The one output of a function as a matrix, valid until it is called again."""
    return buffered(function)(*values)[0].reshape(function.size_out(0), order="F")
