"""Candidates of a search for gaits: mode sequences with a motion, neither solved nor verified yet.

Two searches propose them:

- Simulation: walks of the simulator, which finds the modes itself, end near fixed points of the return map, x = P(x).
  Newton's method converges to them from near-returns, where |P^n(x) - x| is small, and from the starts of the walks. If
  the section depends on the contacts, it starts from the last state of a walk in each mode sequence. If parameters are
  free, each job walks with other values of them.
- Families: the family of a known gait is followed a little way in a parameter. Near mode changes, folds and branch
  points several gaits exist at the same parameters. Each crossing of a branch with the parameter's original value is a
  candidate.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.branches.request import Request
from gaitopt.callbacks import Stop
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.branch import BranchPoint, SpecialPoint
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import CandidateRecord, SearchRecord
from gaitopt.model.modes import Mode
from gaitopt.model.section import Section, has_stated_sections, section_of
from gaitopt.problem.problem import Problem
from gaitopt.requests import Engine, Method
from gaitopt.search.candidate import cycle_record, guessed_values
from gaitopt.search.starts import Within, around_guess, box_samples, start_box
from gaitopt.simulation.engine import choose_engine
from gaitopt.simulation.outcomes import phase_names
from gaitopt.simulation.simulator import Simulator, stepper_class
from gaitopt.systems import solve_sequence
from gaitopt.verification.return_map import ReturnMap
from gaitopt.verification.step_map import StepMap, step_map

STARTS_AROUND_GUESS, STARTS_WITHOUT_GUESS, CYCLES_AROUND_GUESS = 12, 60, 6
"""Number of start states of a simulation job around a guess, and without one, because many of these walkers fall; and
of cycles of each walk, each of which takes a tenth of a second. Walks come close to a stable gait after a few cycles,
and to an unstable one in the first cycle."""
SHORTEST_STEP_PERIOD = 0.05
"""Shortest period of a step in natural units. Two feet that rest side by side solve the equations with period 0."""
WALK_STEPS = 8
"""Number of steps of a walk that is searched for near-returns."""
MOST_NEWTON_STARTS = 40
"""Largest number of starts of Newton's method per job: first from the closest near-returns, then from the starts of the
walks that return, which also lead to unstable gaits."""
WALKS, WALKS_OF_DESIGN = 250, 25
"""Number of start states of a job, and of a job that samples the free parameters."""
VALUE_SPREAD = 0.5
"""Range of the sampled free parameters around their guesses, relative to the guess."""

FAMILY_REACH = 0.25
"""Distance over which a family is followed to either side, relative to the parameter."""
MAX_POINTS = 150
"""Largest number of points in one direction; a family without folds has about forty."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchJob:
    """One job of a search for cycles of up to ``n_steps`` steps.

    ``number`` selects its samples. In the method ``families``, ``parameter`` is the parameter of the family, and
    ``solver`` the method that solves its first gait.
    """

    problem: Problem
    method: str
    number: int
    seed: int
    within: Within
    parameter: str = ""
    n_steps: int = 1
    solver: Method = Method.AUTO


def walks_of(problem: Problem) -> int:
    """Number of start states of a simulation job."""
    return WALKS_OF_DESIGN if problem.free and has_stated_sections(type(problem.walker), problem.cycle_end) else WALKS


def find_candidates(job: SearchJob, _: None = None, should_stop: Stop = None) -> SearchRecord:
    """Candidates of one job of a search, and the number of its starts."""
    if job.method == "simulation":
        job = replace(job, problem=_with_sampled_values(job))
    methods = {"simulation": _from_walks, "families": _from_family}
    candidates, starts = methods[job.method](job, should_stop or (lambda: False))
    return {"method": job.method, "starts": starts, "candidates": candidates}


def _with_sampled_values(job: SearchJob) -> Problem:
    """The problem with sampled guesses of the free parameters; the first job has those of the problem."""
    problem, rng = job.problem, np.random.default_rng([job.seed, job.number, len(job.problem.free)])
    if not problem.free or job.number == 0:
        return problem
    sizes = {key: abs(free.guess) or free.upper - free.lower for key, free in problem.free.items()}
    values = {key: problem.free[key].guess + VALUE_SPREAD * size * rng.uniform(-1, 1) for key, size in sizes.items()}
    try:
        return problem.replace(problem.free_guesses(values))
    except ProblemError:  # the walker cannot have this combination of values
        return problem


def _step_map(job: SearchJob) -> StepMap:
    """The return map of the problem's walker, built once in every process."""
    return step_map(job.problem, None, choose_engine(Engine.AUTO, steps=WALKS * WALK_STEPS))


def _from_walks(job: SearchJob, should_stop: Callable[[], bool]) -> tuple[list[CandidateRecord], int]:
    """Fixed points of the return map and of its powers near walks from sampled states."""
    step, states, sizes, n_walked = _starts(job)
    dynamics, walker, candidates = step.dynamics, step.dynamics.system.walker, list[CandidateRecord]()
    mapped, indices = (step, step.indices) if step.is_stated else (step.walk, np.arange(dynamics.system.n_z))
    history = np.full((n_walked + 1, *states.shape), np.nan)  # NaN after the end of a walk
    ends = np.zeros((2, *history.shape[:2]), dtype=np.int64)  # codes of the phases and of the impact before each state
    history[0], walking = states, np.arange(len(states))
    for k in range(n_walked):
        walked = mapped(history[k, walking])
        walking = walking[walked.completed]
        history[k + 1, walking] = walked.states[walked.completed]
        ends[:, k + 1, walking] = walked.phases[walked.completed], walked.impacts[walked.completed]
        if not walking.size:
            break

    def section_after(z: Array, codes: NDArray[np.int64]) -> Section:
        """The section on which a state lies after a step with these codes."""
        if step.is_stated:
            return dynamics.system.section(Mode.SLIP_FORWARD if z[-1] else Mode.STICK)
        of, impact = codes.tolist()
        return section_of(walker, phase_names(of, modes)[-1], impacts[impact], dynamics.system.cycle_end)

    modes, impacts = walker.modes(), walker.foot_modes()
    simulator = Simulator(dynamics, stepper_class(step.engine))
    shortest, per_cycle = SHORTEST_STEP_PERIOD * dynamics.scales.time, dynamics.steps_per_cycle
    for n_returns in range(1, job.n_steps // per_cycle + 1):
        near, starts = _near_returns(history / sizes, n_returns)
        tries = (
            [*near, *starts][:MOST_NEWTON_STARTS]
            if step.is_stated
            else [*_last_of_sequences(history, ends, n_returns), *starts]
            if job.problem.start is not None
            else [*near, *_last_of_sequences(history, ends, n_returns)][:MOST_NEWTON_STARTS]
        )
        for k, row in tries:
            if should_stop():
                raise KeyboardInterrupt
            z, scale = np.zeros((2, dynamics.system.n_z))
            z[indices], scale[indices] = history[k, row], sizes
            after = (k or n_returns) + 1
            section = section_after(z, ends[:, after - 1, row])
            returns = ReturnMap(simulator, section, n_returns * per_cycle, z)
            steps = returns.damped_fixed_point(z[section.indices], scale[section.indices])
            if steps is not None and steps[0].period > shortest:
                start = f"{job.method} {job.number}.{row}"
                candidates.append(cycle_record(dynamics.system, steps, start, guessed_values(job.problem)))
    return candidates, len(states)


def _near_returns(history: Array, n_returns: int) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """The nearest return of each walk after some cycles as (cycle, walk), and the starts; the closest ones first."""
    distances = np.abs(history[n_returns:] - history[:-n_returns]).max(axis=2)
    distances = np.where(np.isnan(distances), np.inf, distances)
    nearest = np.argmin(distances, axis=0)
    closest, first = distances[nearest, np.arange(nearest.size)], distances[0]
    near = [(int(n_returns + nearest[row]), int(row)) for row in np.argsort(closest) if np.isfinite(closest[row])]
    return near, [(0, int(row)) for row in np.argsort(first) if np.isfinite(first[row])]


def _last_of_sequences(history: Array, ends: NDArray[np.int64], n_returns: int) -> Iterator[tuple[int, int]]:
    """The last state of each walk in every mode sequence of some cycles, as (cycle, walk).

    Walks lead away from unstable gaits, so that they leave other mode sequences early. Their last state in such a
    sequence is a start for Newton's method.
    """
    for row, n_states in enumerate(np.isfinite(history).all(axis=2).sum(axis=0).tolist()):
        met = set[bytes]()
        for k in range(n_states - 1, n_returns - 1, -1):
            sequence = ends[:, k - n_returns + 1 : k + 1, row].tobytes()
            if sequence not in met:
                met.add(sequence)
                yield k, row


def _starts(job: SearchJob) -> tuple[StepMap, Array, Array, int]:
    """The return map, start states of walks with the sizes of their coordinates, and the number of cycles of a walk."""
    problem, rng = job.problem, np.random.default_rng([job.seed, job.number])
    if has_stated_sections(type(problem.walker), problem.cycle_end):
        step = _step_map(job)
        box = start_box(problem, step.dynamics, job.within)
        states = box_samples(step.dynamics, box, walks_of(problem), rng)
        if problem.start is not None and job.number == 0:
            states[0] = [problem.start.state[name] for name in box.names]
        return step, states, box.sizes, WALK_STEPS + job.n_steps - 1
    step = step_map(problem, None, choose_engine(Engine.AUTO, steps=STARTS_AROUND_GUESS * CYCLES_AROUND_GUESS))
    count = STARTS_WITHOUT_GUESS if problem.start is None else STARTS_AROUND_GUESS
    states = around_guess(problem, step.dynamics, count, rng, exact=job.number == 0, within=job.within)
    return step, states, step.dynamics.state_units, CYCLES_AROUND_GUESS * job.n_steps


def _from_family(job: SearchJob, should_stop: Callable[[], bool]) -> tuple[list[CandidateRecord], int]:
    """Crossings of the family of the job's gait with the value of a parameter at which it began."""
    gait, candidates = solve_sequence(job.problem, method=job.solver, should_stop=should_stop), list[CandidateRecord]()
    if gait.converged:
        value, start = job.problem.parameters[job.parameter], f"{job.method} {job.number}, {job.parameter}"
        follow = {"branch_points": 1, "mode_changes": 1, "doublings": job.n_steps // (2 * len(gait.steps))}
        for side in (-1, 1):
            request = Request(
                parameter=job.parameter,
                to=(value * (1 + side * FAMILY_REACH),),
                max_points=MAX_POINTS,
                verify_every=0,
                follow=follow,
            )
            before: BranchPoint | None = None
            for point in family(gait, request, should_stop):
                if not isinstance(point, BranchPoint):
                    continue
                same = before is not None and before.branch == point.branch
                if before is not None and same and (before.value - value) * (point.value - value) < 0:
                    crossing = min(before, point, key=lambda point: abs(point.value - value)).gait
                    candidates.append(cycle_record(gait.system, crossing.steps, start))
                before = point
    if should_stop():
        raise KeyboardInterrupt
    return candidates, 1


def family(gait: Gait, request: Request, should_stop: Stop) -> Iterator[BranchPoint | SpecialPoint]:
    """The points of a family as far as it can be followed; none if it cannot be followed in this parameter."""
    from gaitopt.branches.continuation import follow_family  # imported here, because most problems need no family

    try:
        yield from follow_family(gait, request, should_stop=should_stop)
    except (ProblemError, SolveError):
        return
