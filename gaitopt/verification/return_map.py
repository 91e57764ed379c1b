"""The return map of the forward simulator on the section just after an impact, and its fixed points.

xi -> Pi(xi),      Newton:  xi - (DPi - I)^-1 (Pi(xi) - xi)                Gamus & Or (2013), section II.C

Derivative of the return map along simulated steps: variational equations and saltation.

    d/dt Z = f_z Z  along every arc,     Z -> S Z  at every switch,     Z -> R_z (I - f grad g' / g_dot) Z  at impact

S is the saltation matrix of ``mechanics.saltation``. A breakpoint of the control lies at a fixed time since the
impact, the same for every neighbouring motion, so that it leaves deviations as they are.

Fixed points of the return map from afar: Newton's method with a line search and a bounded step.

xi -> xi - t (DPi - I)^-1 (Pi(xi) - xi),      t = 1, 1/2, ... until the defect falls

The return map of thousands of states at once: arrays in, arrays and named outcomes out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from casadi import Function
from numpy.typing import NDArray

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.callbacks import Stop
from gaitopt.gait.gait import Gait
from gaitopt.gait.trajectory import Arc, Ending, Step
from gaitopt.iteration import iterate
from gaitopt.model.buffered import buffered
from gaitopt.model.dynamics import Dynamics, projection, saltation
from gaitopt.model.margins import ending_margin, margin_names, margin_unit
from gaitopt.model.modes import CONTACTS, Mode
from gaitopt.problem.problem import Problem
from gaitopt.simulation.batch import ENDINGS, BatchSteps, followed_by, phase_names, stack_outcomes
from gaitopt.simulation.engine import Engine, choose_engine
from gaitopt.simulation.heyoka_batch import RowMap
from gaitopt.simulation.simulator import Simulator, StepOutcome
from gaitopt.simulation.stepper import Stepper
from gaitopt.systems import problem_dynamics
from gaitopt.threads import per_thread
from gaitopt.workers.jobs import FailedJob, Job, Workers, run_jobs

if TYPE_CHECKING:
    from gaitopt.simulation.batch import BatchSimulator


AT_EVENT = 1e-9
"""A margin this close to zero, in natural units, has fallen; where a torque jumps at a breakpoint it is far from it."""


class StepSensitivity:
    """How small deviations on the section pass one step of a system at fixed parameters.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    section_mode : mode of the impact whose section coordinates are used.
    stepper : what integrates the variational equations.

    References
    ----------
    Gamus & Or (2013), section II.C.
    """

    def __init__(self, dynamics: Dynamics, section_mode: Mode, stepper: Stepper) -> None:
        self._system = system = dynamics.system
        self._sides = [(dynamics, stepper)]
        for side in range(1, system.walker.n_sides()):
            own = dynamics.standing(side)
            self._sides.append((own, stepper.at(own)))
        self._indices, self._lifted = system.section(section_mode), system.section(Mode.SLIP_FORWARD)

    @np.errstate(divide="ignore", invalid="ignore")  # an event that is grazed has no rate, and its map no derivative
    def jacobian(self, steps: Sequence[Step]) -> Array:
        """Derivative of the return map along complete steps that start and end on the section, shape (n_xi, n_xi).

        It is not finite if a step grazes an event.
        """
        start = steps[0].arcs[0].states[0]
        lift = _matrix(self._system.lift_jacobian, start[self._lifted], self._sides[0][0].p)
        deviations = lift[:, : self._indices.size]
        for step in steps:
            deviations = self._through(step, deviations)
        return deviations[self._indices]

    def _through(self, step: Step, deviations: Array) -> Array:
        """Deviations just after the impact of a step from those at its start, shape (n_z, n_xi)."""
        system = self._system
        for arc, after in zip(step.arcs, (*step.arcs[1:], None), strict=True):
            data, ends = system.data(arc.segment), arc.times[[0, -1]]
            dynamics, stepper = self._sides[arc.side]
            deviations = stepper.propagate_variations(arc.mode, data, arc.states[0], deviations, ends)
            if after is None or after.segment == arc.segment or _ends_at_breakpoint(dynamics, arc, after):
                deviations = _event(dynamics, arc, after) @ deviations
        reset = _matrix(system.impact_jacobian(step.final_impact.mode), step.arcs[-1].states[-1], dynamics.p)
        after_impact = reset @ deviations
        after_impact[system.n_shape] = 0.0  # x is counted from the new stance foot
        return np.asarray(after_impact)


def _ends_at_breakpoint(dynamics: Dynamics, arc: Arc, after: Arc) -> bool:
    """Whether the event of a mode falls on a breakpoint of the control, so that no arc lies between the two."""
    if after.mode is arc.mode:
        return False
    name = ending_margin(arc.mode, after.mode)
    margins = dynamics.margins(arc.mode, arc.segment, arc.times[-1:], arc.states[-1:])[0]
    unit = margin_unit(name, dynamics.scales)
    return bool(abs(margins[margin_names(arc.mode).index(name)]) <= AT_EVENT * unit)


def _event(dynamics: Dynamics, arc: Arc, after: Arc | None) -> Array:
    """What the event at the end of an arc does to deviations; shape (n_z, n_z)."""
    system, z, p, data = dynamics.system, arc.states[-1], dynamics.p, dynamics.system.data(arc.segment)
    row = margin_names(arc.mode).index(ending_margin(arc.mode, None if after is None else after.mode))
    flow, gradients, rates = buffered(system.linearized(arc.mode))(arc.end, z, p, data)
    gradient, rate = gradients.reshape(z.size, -1)[:, row], rates[row].item()
    if after is None:
        return projection(flow, gradient, rate)
    (flow_after,) = buffered(system.flow(after.mode))(after.start, after.states[0], p, data)
    return saltation(flow, flow_after, gradient, rate, _reset(dynamics, arc, after))


def _reset(dynamics: Dynamics, arc: Arc, after: Arc) -> Array | None:
    """Derivative of the reset from one arc to the next; None where no stop locks."""
    if arc.mode.locked == after.mode.locked:
        return None
    slides = after.states[0][-1] or after.mode.flies
    struck = after.mode if slides else after.mode.with_contact(Mode.STICK)
    return _matrix(dynamics.system.impact_jacobian(struck), arc.states[-1], dynamics.p).copy()


def _matrix(function: Function, *values: Array | float) -> Array:
    """The one output of a function as a matrix, valid until it is called again."""
    return buffered(function)(*values)[0].reshape(function.size_out(0), order="F")


ROUNDING = 1e-12
"""Error of a simulated step in natural units, as far as it is not amplified."""
NEWTON_STEPS = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Return:
    """One application of the return map.

    Attributes
    ----------
    xi : ndarray, shape (n_xi,) - section coordinates after the cycle, or None if it did not return to this section.
    steps : the simulated steps.
    ending, message : ``completed``, or why it did not return.
    """

    xi: Array | None
    steps: tuple[Step, ...]
    ending: Ending
    message: str


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedPoint:
    """Outcome of Newton's method on the return map.

    Attributes
    ----------
    xi : ndarray, shape (n_xi,) - last iterate.
    residual : largest entry of Pi(xi) - xi in natural units; infinite where the map is not defined.
    accuracy : residual below which rounding leaves nothing to improve; what happens early in a step is amplified by
        the derivative of the map.
    steps : the steps from ``xi``.
    jacobian : ndarray, shape (n_xi, n_xi) - derivative of the map at ``xi``, or None.
    message : how it ended.
    """

    xi: Array
    residual: float
    accuracy: float
    steps: tuple[Step, ...]
    jacobian: Array | None
    message: str

    @property
    def converged(self) -> bool:
        """Whether the residual is down at rounding."""
        return self.residual <= self.accuracy


class ReturnMap:
    """Return map of a simulator, after one or more steps, on the section of one kind of impact."""

    def __init__(self, simulator: Simulator, section_mode: Mode, n_steps: int = 1) -> None:
        self.simulator, self.section_mode, self.n_steps = simulator, section_mode, n_steps
        self._indices = simulator.system.section(section_mode)
        self._units = simulator.dynamics.state_units[self._indices]
        self._sensitivity = StepSensitivity(simulator.dynamics, section_mode, simulator.stepper)

    def __call__(self, xi: Array) -> Return:
        """Simulate one cycle from section coordinates ``xi``."""
        trajectory = self.simulator.run(self.simulator.dynamics.lift(xi), steps=self.n_steps)
        steps, ending = trajectory.steps, trajectory.ending
        impact = steps[-1].impact if len(steps) == self.n_steps else None
        if impact is None:
            return Return(xi=None, steps=steps, ending=ending, message=trajectory.message)
        if (impact.mode.sticks) is not (self.section_mode.sticks):
            message = f"the impact ends with {impact.mode}, off the section of {self.section_mode}"
            return Return(xi=None, steps=steps, ending=ending, message=message)
        return Return(xi=impact.state[self._indices], steps=steps, ending=ending, message=trajectory.message)

    def jacobian(self, steps: Sequence[Step]) -> Array:
        """Derivative of the map along one of its cycles; shape (n_xi, n_xi)."""
        return self._sensitivity.jacobian(steps)

    def fixed_point(self, xi: Array) -> FixedPoint:
        """Newton's method from ``xi`` until Pi(xi) = xi up to rounding."""

        def following(point: FixedPoint) -> FixedPoint | None:
            if point.jacobian is None:
                return None
            defect = (point.steps[-1].final_impact.state[self._indices] - point.xi) / self._units
            newton = np.linalg.lstsq(self._scaled(point.jacobian) - np.eye(xi.size), defect, rcond=None)[0]
            return self._evaluate(point.xi - newton * self._units)

        return iterate(
            self._evaluate(xi),
            following,
            size=lambda point: point.residual,
            solved=lambda point: point.converged,
            most=NEWTON_STEPS,
        ).at

    def _evaluate(self, xi: Array) -> FixedPoint:
        result = self(xi)
        if result.xi is None:
            return FixedPoint(
                xi=xi, residual=np.inf, accuracy=ROUNDING, steps=result.steps, jacobian=None, message=result.message
            )
        residual = float(np.abs((result.xi - xi) / self._units).max())
        derivative = self.jacobian(result.steps)
        if not np.isfinite(derivative).all():
            message = "the walk grazes an event, where the return map has no derivative"
            return FixedPoint(
                xi=xi, residual=residual, accuracy=ROUNDING, steps=result.steps, jacobian=None, message=message
            )
        accuracy = ROUNDING * max(1.0, float(np.linalg.norm(self._scaled(derivative), np.inf)))
        return FixedPoint(
            xi=xi,
            residual=residual,
            accuracy=accuracy,
            steps=result.steps,
            jacobian=derivative,
            message=result.message,
        )

    def _scaled(self, jacobian: Array) -> Array:
        """The derivative of the map in natural units."""
        return jacobian * self._units / self._units[:, None]


CLOSE = 1e-9
"""Relative defect of a fixed point that another method polishes."""
LONGEST = 0.5
"""Newton step, relative to the sizes of the coordinates."""
SHORTENED = (1.0, 0.5, 0.25, 0.125, 0.0625)
MAX_STEPS = 25


@dataclass(frozen=True, slots=True, kw_only=True)
class _Defect:
    """Pi(xi) - xi at one point; its size is infinite where the map is not defined."""

    xi: Array
    vector: Array
    size: float
    steps: tuple[Step, ...]


def damped_fixed_point(return_map: ReturnMap, xi: Array, sizes: Array) -> tuple[Step, ...] | None:
    """The steps of a fixed point's cycle, by Newton's method from ``xi``, shape (n_xi,); None where there is none near.

    Parameters
    ----------
    sizes : ndarray, shape (n_xi,) - of the coordinates.
    """

    def following(point: _Defect) -> _Defect | None:
        if not np.isfinite(point.size):
            return None
        slope = return_map.jacobian(point.steps) - np.eye(xi.size)
        if not np.isfinite(slope).all():
            return None
        newton = -np.linalg.lstsq(slope, point.vector, rcond=None)[0]
        newton /= max(1.0, float(np.abs(newton / sizes).max()) / LONGEST)
        candidates = ((t, _defect(return_map, point.xi + t * newton, sizes)) for t in SHORTENED)
        return next((c for t, c in candidates if c.size < (1 - t / 4) * point.size), None)

    first = _defect(return_map, xi, sizes)
    end = iterate(first, following, size=lambda p: p.size, solved=lambda p: p.size < CLOSE, most=MAX_STEPS)
    return end.at.steps if end.solved else None


def _defect(return_map: ReturnMap, xi: Array, sizes: Array) -> _Defect:
    result = return_map(xi)
    if result.xi is None:
        return _Defect(xi=xi, vector=np.zeros_like(xi), size=np.inf, steps=())
    vector = result.xi - xi
    return _Defect(xi=xi, vector=vector, size=float(np.abs(vector / sizes).max()), steps=result.steps)


Codes = NDArray[np.int64]
UNDEFINED = StepOutcome(
    step=None, ending=Ending.NUMERICAL, message="the section coordinates belong to no state of the walker"
)
"""Of section coordinates from which some coordinate or rate does not follow, as too fast for the energy of a runner."""

CHUNK = 4096
"""States of one job: a tenth of a second of work, a third of a megabyte."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Returns(ReadOnlyArrays):
    """One return to the section of each of n states: a step, or where the legs differ one with either of them.

    Attributes
    ----------
    names : section coordinates, the columns of ``states``; ``dx`` is the last.
    states : ndarray, shape (n, k) - section coordinates after the step; where it was not completed, at its end.
    endings : ndarray, shape (n,) - index of the outcome in ``Ending``; 0 is ``completed``.
    times : ndarray, shape (n,) - period, or the time at which the motion ended [s].
    step_lengths : ndarray, shape (n,) - NaN where the step was not completed [m].
    phases : ndarray, shape (n,) - the modes gone through as digits, 1 + index in ``modes``, in base ``len(modes) + 1``.
    impacts : ndarray, shape (n,) - index of the impact's mode in ``modes``; -1 where the step was not completed.
    modes : every mode of the walker.
    """

    names: tuple[str, ...]
    states: Array
    endings: Codes
    times: Array
    step_lengths: Array
    phases: Codes
    impacts: Codes
    modes: tuple[Mode, ...] = CONTACTS

    @property
    def completed(self) -> NDArray[np.bool_]:
        """Which steps were completed; shape (n,)."""
        return self.endings == 0

    @property
    def outcomes(self) -> NDArray[np.str_]:
        """The named outcomes; shape (n,)."""
        return np.array([str(ending) for ending in ENDINGS])[self.endings]

    def sequence(self, row: int) -> tuple[Mode, ...]:
        """The modes gone through by one state."""
        return phase_names(int(self.phases[row]), self.modes)


def return_map(
    start: Problem | Gait, states: Array, *, engine: str = Engine.AUTO, workers: int = 1, should_stop: Stop = None
) -> Returns:
    """Walk one step, or where the legs differ one with either of them, from each of many states just after an impact.

    The result of a state does not depend on the others, nor on their number, order or distribution over processes.

    Parameters
    ----------
    start : problem or gait whose walker, control and friction are used.
    states : ndarray, shape (n, k) - section coordinates, with ``dx`` as the last column or without it (at rest).
    engine : ``auto``, ``scipy`` or ``heyoka``.
    workers : processes.

    Raises
    ------
    ValueError
        If ``states`` is not of such a shape, or not finite.
    UnknownNameError
        If the engine is unknown or not installed.
    """
    problem = start.problem if isinstance(start, Gait) else start
    xi = section_states(problem, states)
    chosen = choose_engine(engine, steps=len(xi))
    p = tuple(start.p.tolist()) if isinstance(start, Gait) else None
    chunks = [xi[k : k + CHUNK] for k in range(0, len(xi), CHUNK)] or [xi]
    arguments = [(problem, p, chosen, chunk) for chunk in chunks]
    if workers == 1:
        return _joined([map_chunk(argument) for argument in arguments])
    jobs = [Job(key=f"chunk-{k}-{id(xi)}", argument=argument) for k, argument in enumerate(arguments)]
    results = dict(run_jobs(map_chunk, jobs, Workers(count=workers), should_stop=should_stop))
    for result in results.values():
        if isinstance(result, FailedJob):
            raise RuntimeError(f"a chunk of states was not mapped: {result.reason}")
    return _joined([results[job.key] for job in jobs])


def section_states(problem: Problem, states: Array) -> Array:
    """The states as a float array with all section coordinates, ``dx`` included; shape (n, k).

    Raises
    ------
    ValueError
        If they are not of a shape that fits, or not finite.
    """
    names = problem.walker.section_names(slipping=True)
    xi = np.asarray(states, dtype=float)
    if xi.ndim != 2 or xi.shape[1] not in (len(names) - 1, len(names)):
        raise ValueError(f"states of shape {xi.shape}: one row per state is needed, columns {', '.join(names)}")
    if not np.isfinite(xi).all():
        raise ValueError(f"states must be finite; row {np.flatnonzero(~np.isfinite(xi).all(axis=1))[0]} is not")
    return np.hstack([xi, np.zeros((len(xi), len(names) - xi.shape[1]))])


def map_chunk(argument: tuple[Problem, tuple[float, ...] | None, Engine, Array], _: None = None) -> Returns:
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

    def __call__(self, xi: Array) -> Returns:
        """One return of every state, a step or, where the legs differ, one with either; see ``section_states``."""
        (states,) = self._lift(xi, self.dynamics.p)
        modes = self.dynamics.system.walker.modes()
        walked = self._step(states, 0)
        for side in range(1, self.dynamics.system.walker.n_sides()):
            going = np.flatnonzero(walked.endings == 0)
            if going.size:
                walked = followed_by(walked, self._step(walked.states[going], side), going, modes)
        fields = {name: getattr(walked, name) for name in ("endings", "times", "step_lengths", "phases", "impacts")}
        return Returns(names=self.names, states=walked.states[:, self._indices], modes=modes, **fields)

    @cached_property
    def _batches(self) -> "list[BatchSimulator]":
        from gaitopt.simulation.batch import BatchSimulator  # needs heyoka, which is optional

        walker = self.dynamics.system.walker
        return [BatchSimulator(self.dynamics.standing(side)) for side in range(walker.n_sides())]

    @cached_property
    def _simulator(self) -> Simulator:
        return Simulator(self.dynamics)

    def _step(self, states: Array, side: int) -> BatchSteps:
        """One step of every state, shape (n, n_z), while the leg of this ``side`` stands."""
        if self._engine is Engine.HEYOKA:
            return self._batches[side].step(states)
        simulator = self._simulator.sides[side]
        outcomes = [simulator.step(state) if np.isfinite(state).all() else UNDEFINED for state in states]
        return stack_outcomes(outcomes, states, self.dynamics.system.walker.modes())


@per_thread(maxsize=8)
def step_map(problem: Problem, p: tuple[float, ...] | None, engine: Engine) -> StepMap:
    """The map of a problem, built once in every thread; ``p`` if the parameters are not those of the problem."""
    dynamics = problem_dynamics(problem)
    return StepMap(Dynamics(dynamics.system, np.array(p)) if p else dynamics, engine)


def _joined(parts: list[Returns]) -> Returns:
    names = ("states", "endings", "times", "step_lengths", "phases", "impacts")
    joined: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return replace(parts[0], **joined)
