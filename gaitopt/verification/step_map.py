"""The return map of thousands of states at once, from arrays of states to arrays of states and named outcomes."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.errors import ProblemError
from gaitopt.gait.gait import Gait
from gaitopt.model.dynamics import Dynamics
from gaitopt.problem.floor import Floor
from gaitopt.problem.problem import Problem
from gaitopt.requests import Engine
from gaitopt.simulation.engine import choose_engine
from gaitopt.simulation.outcomes import ARRAYS, UNDEFINED_STATE, StepOutcomes, stack_outcomes
from gaitopt.simulation.simulator import Simulator, stepper_class
from gaitopt.systems import problem_dynamics
from gaitopt.threads import cached_property, per_thread
from gaitopt.verification.tiled_walks import Rows, TiledWalks, repeated
from gaitopt.workers.jobs import FailedJob, Job, Workers, run_jobs

RowLift = Callable[[Array, Array, Array | None], Array]
CHUNK = 4096
"""Number of states in one job, which takes a tenth of a second and a third of a megabyte."""


def return_map(
    start: Problem | Gait,
    states: Array,
    *,
    engine: str = Engine.AUTO,
    floor: Floor | None = None,
    workers: int = 1,
    should_stop: Stop = None,
) -> StepOutcomes:
    """Walk one step from each of many states just after an impact.

    It is one step with each leg if the legs differ, and a whole cycle under feedback from step to step.

    The result for a state does not depend on the other states, on their order, or on their distribution over processes.

    Parameters
    ----------
    start : problem or gait; its walker, control and friction are used.
    states : ndarray, shape (n, k) - section coordinates. The last column, ``dx``, may be left out if the foot is at
        rest. For a walker with named contacts, these are the coordinates of its gait's section, see
        ``Problem.map_section``.
    engine : ``auto``, ``scipy`` or ``heyoka``.
    floor : tiles under the feet: the walker stands on tile 0 and lands on tile 1.
    workers : number of processes.

    Raises
    ------
    ProblemError
        If ``start`` is the name of a problem, or the walker cannot walk on the floor.
    ValueError
        If ``states`` has another shape or is not finite.
    UnknownNameError
        If the engine is unknown or not installed.
    """
    if isinstance(start, str | Path):
        raise ProblemError(f"return_map takes a gait or a problem; give load_problem({str(start)!r})")
    problem = start.problem if isinstance(start, Gait) else start
    xi = section_coordinates(problem, states)
    chosen = choose_engine(engine, steps=len(xi))
    p = tuple(start.p.tolist()) if isinstance(start, Gait) else None
    chunks = [xi[k : k + CHUNK] for k in range(0, len(xi), CHUNK)] or [xi]
    arguments = [(problem, p, chosen, floor, chunk) for chunk in chunks]
    if workers == 1:
        outcomes = [map_chunk(argument) for argument in arguments]
    else:
        jobs = [Job(key=f"chunk-{k}-{id(xi)}", argument=argument) for k, argument in enumerate(arguments)]
        results = dict(run_jobs(map_chunk, jobs, Workers(count=workers), should_stop=should_stop))
        for result in results.values():
            if isinstance(result, FailedJob):
                raise RuntimeError(f"a chunk of states was not mapped: {result.reason}")
        outcomes = [results[job.key] for job in jobs]
    joined: dict[str, Any] = {name: np.concatenate([getattr(each, name) for each in outcomes]) for name in ARRAYS}
    return replace(outcomes[0], **joined)


def section_coordinates(problem: Problem, states: Array) -> Array:
    """The states as floats with all section coordinates, including ``dx``; shape (n, k).

    Raises
    ------
    ValueError
        If ``states`` has a wrong shape, or is not finite.
    """
    section, xi = problem.map_section, np.asarray(states, dtype=float)
    names = section.names
    if xi.ndim != 2 or xi.shape[1] not in (len(names) - section.stated, len(names)):
        raise ValueError(f"states of shape {xi.shape}: one row per state is needed, columns {', '.join(names)}")
    if not np.isfinite(xi).all():
        raise ValueError(f"states must be finite; row {np.flatnonzero(~np.isfinite(xi).all(axis=1))[0]} is not")
    return np.hstack([xi, np.zeros((len(xi), len(names) - xi.shape[1]))])


def map_chunk(
    argument: tuple[Problem, tuple[float, ...] | None, Engine, Floor | None, Array], _: None = None
) -> StepOutcomes:
    """The job of one chunk of ``return_map``, in any process."""
    problem, p, engine, floor, xi = argument
    return step_map(problem, p, engine, floor)(xi)


class StepMap:
    """The return map of one system at fixed parameters for arrays of section coordinates (n, k).

    Parameters
    ----------
    floor : the tiles on which every walk begins; None for the nominal floor.

    Attributes
    ----------
    names, indices : names of the section coordinates, and their indices in the state. If the modes are open, there is
        no section, and these are all states.
    is_stated : whether every step leads back to these coordinates, and they determine the state.
    near : the state of the problem's guess, next to which states of the section are sought; None without a guess.
    """

    def __init__(self, dynamics: Dynamics, engine: Engine, problem: Problem, floor: Floor | None = None) -> None:
        self.dynamics, self.engine, self.floor = dynamics, engine, floor
        self.names = names = dynamics.system.state_names
        self.indices, self.is_stated = np.arange(len(names)), False
        self._lift: RowLift = lambda xi, p, near: xi
        if problem.section is not None:
            section = problem.map_section
            self.names, self.indices, self.is_stated = section.names, section.indices, section.stated
            self._lift = section.row_lift()
        self.near = None if problem.start is None else np.array([problem.start.state[name] for name in names])

    def __call__(self, xi: Array, rows: Rows | None = None) -> StepOutcomes:
        """``Dynamics.steps_per_cycle`` steps from every state. See ``section_coordinates``."""
        states = self.lift(xi)
        walked = self.walk(states) if self.floor is None else self._on_floor(states).cycle()
        return replace(walked, names=self.names, states=walked.states[:, self.indices])

    def lift(self, xi: Array) -> Array:
        """The whole states that have these section coordinates, shape (n, n_z)."""
        return self._lift(xi, self.dynamics.p, self.near)

    def closed(self, xi: Array) -> tuple[Callable[..., StepOutcomes], Array]:
        """A map of one step whose results are its arguments for the next step, and the first arguments from ``xi``.

        Walks on the nominal floor whose section is stated are mapped from section coordinates to section coordinates.
        All others may leave the section, because more contacts slip or touch, or because tiles differ in height; they
        are mapped from whole states to whole states.

        Parameters
        ----------
        xi : section coordinates (n, k), or whole states (n, n_z).

        Returns
        -------
        step : function of the arguments, and of their row numbers among the first arguments.
        arguments : section coordinates or whole states.
        """
        if self.is_stated and self.floor is None:
            return self, xi
        states = xi if xi.shape[1] == self.dynamics.system.n_z else self.lift(xi)
        if self.floor is None:
            return self.walk, states
        walks = self._on_floor(states)
        return lambda _, rows: walks.cycle(rows), states

    def _on_floor(self, states: Array) -> TiledWalks:
        assert self.floor is not None
        return TiledWalks(self.dynamics, states, repeated(self.floor, len(states)), self.engine)

    def walk(self, states: Array, rows: Rows | None = None) -> StepOutcomes:
        """Walk a cycle from whole states, shape (n, n_z), to whole states, which may lie off the section."""
        walked = self._steps[0](states, first=states, n=0)
        for n in range(1, self.dynamics.steps_per_cycle):
            rows = np.flatnonzero(walked.completed)
            if rows.size:
                step = self._steps[n % len(self._steps)]
                walked = walked.followed_by(step(walked.states[rows], first=states[rows], n=n), rows)
        return walked

    @cached_property
    def _steps(self) -> list[Callable[..., StepOutcomes]]:
        """Step ``n`` of cycles that began in ``first``, from every state, shape (m, n_z); for each leg that differs."""
        if self.engine is Engine.HEYOKA:
            from gaitopt.simulation.heyoka_batch import BatchSimulator  # imports heyoka, which is optional

            return [BatchSimulator(dynamics).step for dynamics in self.dynamics.steps]

        def one_by_one(simulator: Simulator, states: Array, first: Array, n: int) -> StepOutcomes:
            outcomes = [
                simulator.on(simulator.dynamics.acting(start, n)).step(state) if np.isfinite(state).all()
                else UNDEFINED_STATE
                for state, start in zip(states, first, strict=True)
            ]  # fmt: skip
            return stack_outcomes(outcomes, states, simulator.system)

        return [partial(one_by_one, each) for each in Simulator(self.dynamics, stepper_class(self.engine)).per_step]


@per_thread(maxsize=8)
def step_map(problem: Problem, p: tuple[float, ...] | None, engine: Engine, floor: Floor | None = None) -> StepMap:
    """The map of a problem, built once per thread; ``p`` replaces the parameters of the problem if it is given."""
    dynamics = problem_dynamics(problem)
    return StepMap(Dynamics(dynamics.system, np.array(p)) if p else dynamics, engine, problem, floor)
