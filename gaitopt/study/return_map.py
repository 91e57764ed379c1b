"""The return map of thousands of states at once: arrays in, arrays and named outcomes out."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.callbacks import Stop
from gaitopt.gait import Ending, Gait
from gaitopt.mechanics import CONTACTS, Dynamics, Mode
from gaitopt.problem import Problem
from gaitopt.simulation import Engine, Simulator, StepOutcome, choose_engine
from gaitopt.simulation.batch.functions import RowMap
from gaitopt.simulation.batch.steps import ENDINGS, BatchSteps, followed_by, phase_names, stack_outcomes
from gaitopt.study.system import problem_dynamics
from gaitopt.threads import per_thread
from gaitopt.workers.jobs import FailedJob, Job, Workers, run_jobs

if TYPE_CHECKING:
    from gaitopt.simulation.batch.simulator import BatchSimulator

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
        from gaitopt.simulation.batch.simulator import BatchSimulator  # needs heyoka, which is optional

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
