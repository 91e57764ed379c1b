"""Candidates of a search for gaits: mode sequences with a motion, not yet solved nor verified.

Three searches propose them:

- walks of the simulator, which finds the modes itself, end near fixed points of the return map, x = P(x); Newton's
  method converges to those next to near-returns |P^n(x) - x|;
- a program with complementarity conditions in place of a mode sequence finds motions of any sequence, also where
  parameters are free and where no walk leads;
- the family of a known gait is followed a little way in a parameter. Next to mode changes, folds and branch points
  several gaits exist at the same parameters, some of which attract no walk. Each crossing of a branch with the
  parameter's original value is a candidate.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.branches.continuation import follow_family
from gaitopt.branches.request import Request
from gaitopt.callbacks import Stop
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.branch import BranchPoint
from gaitopt.gait.gait import Gait, Status
from gaitopt.gait.records import CandidateRecord, SearchRecord, phase_record
from gaitopt.gait.trajectory import Step
from gaitopt.model.buffered import RowMap
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import CONTACTS, Mode
from gaitopt.model.system import HybridSystem
from gaitopt.nlp.open_modes import Complementarity, Proposal, shapes_before, swing
from gaitopt.nlp.solve import free_parameters
from gaitopt.problem.problem import Problem
from gaitopt.simulation.engine import Engine, choose_engine
from gaitopt.simulation.simulator import Simulator, stepper_class
from gaitopt.systems import solve_sequence
from gaitopt.verification.return_map import ReturnMap
from gaitopt.verification.step_map import step_map

Phases = tuple[tuple[Mode, float], ...]

ANGLE, RATE, SLIP = 0.4, 0.6, 0.3
"""Half widths of the default box of start states, in rad and natural units."""
RATE_OF_FLIGHT = 2.0
"""Half width of rates for walkers that fly, which come down from some height."""
SMALLEST_SCALE = 0.3
"""Smallest size of the sampled boxes relative to the default box: walkers make small steps too."""
SHORTEST_STEP = 0.05
"""Minimum period of a step in natural units; two feet that rest side by side solve the equations with period 0."""
SAME = 1e-3
"""Relative difference below which two states are the same."""
PERIODS = (0.7, 3.0)
"""Range of the guessed periods in natural units."""
TYPICAL_PERIOD = 1.7
WALK = 8
"""Steps of a walk that is searched for near-returns."""
TRIES = 40
"""Maximum number of starts of Newton's method per job, from the closest near-returns."""
WALKS, GUESSES = 250, 4
"""Number of start states of a simulation job, and of guesses of a complementarity job."""

REACH = 0.25
"""How far a family is followed to either side, relative to the parameter."""
MAX_POINTS = 150
"""Maximum number of points in one direction; a family without folds has about forty."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StartBox:
    """Range of the start states by section coordinate; ``given`` by the user, or the walker's default."""

    lower: Array
    upper: Array
    given: bool

    @property
    def sizes(self) -> Array:
        """Widths, shape (n_xi,)."""
        return self.upper - self.lower


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchJob:
    """One job of a search for cycles of up to ``n_steps`` steps.

    ``number`` selects its samples, ``parameter`` is the one in which a family is followed.
    """

    problem: Problem
    method: str
    number: int
    seed: int
    within: Mapping[str, tuple[float, float]]
    parameter: str = ""
    n_steps: int = 1


def search_part(job: SearchJob, _: None = None, should_stop: Stop = None) -> SearchRecord:
    """Candidates of one job of a search, and the number of its starts."""
    stop = should_stop or (lambda: False)
    step = step_map(job.problem, None, choose_engine(Engine.AUTO, steps=WALKS * WALK))  # once in every process
    dynamics = step.dynamics
    box, rng = start_box(job.problem, dynamics, job.within), np.random.default_rng([job.seed, job.number])
    search = _walks if job.method == "simulation" else _guesses
    candidates, starts = search(job, dynamics, box, rng, stop)
    return {"method": job.method, "starts": starts, "candidates": candidates}


def start_box(problem: Problem, dynamics: Dynamics, within: Mapping[str, tuple[float, float]]) -> StartBox:
    """The box of start states: that of the walker, changed by ``within``."""
    names = problem.walker.section_names(slipping=True)
    units = dict(zip(dynamics.system.state_names, dynamics.state_units, strict=True))
    sizes = {"dx": SLIP} | dict.fromkeys(problem.walker.section, ANGLE)
    rate = RATE_OF_FLIGHT if problem.walker.flies else RATE
    half = np.array([sizes.get(name, rate) * units[name] for name in names])
    lower, upper = -half, half.copy()
    for name, span in within.items():
        lower[names.index(name)], upper[names.index(name)] = span
    return StartBox(lower=lower, upper=upper, given=bool(within))


def _walks(
    job: SearchJob, dynamics: Dynamics, box: StartBox, rng: np.random.Generator, should_stop: Callable[[], bool]
) -> tuple[list[CandidateRecord], int]:
    """Fixed points of the return map and of its powers next to the walks from sampled states."""
    system = dynamics.system
    xi, shortest = _samples(dynamics, box, rng), SHORTEST_STEP * dynamics.scales.time
    if job.problem.start is not None and job.number == 0:
        xi[0] = [job.problem.start.state[name] for name in job.problem.walker.section_names(slipping=True)]
    engine = choose_engine(Engine.AUTO, steps=WALKS * WALK)
    history = _walk(job.problem, engine, xi, WALK + job.n_steps - 1)
    simulator = Simulator(dynamics, stepper_class(engine))
    candidates = list[CandidateRecord]()
    least = system.walker.steps_per_cycle()
    for n_returns in range(1, job.n_steps // least + 1):
        maps = {mode: ReturnMap(simulator, mode, n_returns * least) for mode in (Mode.STICK, Mode.SLIP_FORWARD)}
        for row, state in _near_returns(history, n_returns, box):
            if should_stop():
                raise KeyboardInterrupt
            mode = Mode.SLIP_FORWARD if state[-1] else Mode.STICK
            n = state.size if state[-1] else state.size - 1
            steps = maps[mode].damped_fixed_point(state[:n], box.sizes[:n])
            if steps is not None and steps[0].period > shortest:
                candidates.append(cycle_record(system, steps, f"{job.method} {job.number}.{row}"))
    return candidates, len(xi)


def _samples(dynamics: Dynamics, box: StartBox, rng: np.random.Generator) -> Array:
    """Start states, every other one at rest, in boxes of all sizes unless a box is given; shape (WALKS, n_xi)."""
    walker = dynamics.system.walker
    xi = rng.uniform(box.lower, box.upper, (WALKS, box.lower.size))
    if not box.given:
        xi *= rng.uniform(SMALLEST_SCALE, 1.0, (WALKS, 1))
        if not walker.flies:
            _turn_forward(dynamics, xi)
    if not any(mode.slips for mode in walker.contacts()):
        xi[:, -1] = 0.0
    elif box.lower[-1] <= 0 <= box.upper[-1]:
        xi[::2, -1] = 0.0
    return xi


def _turn_forward(dynamics: Dynamics, xi: Array) -> None:
    """Mirror the postures in ``xi``, shape (n, n_xi), whose step would lead backward."""
    system, p = dynamics.system, dynamics.p
    n, n_section = system.n_shape, len(system.walker.section)
    (lifted,) = RowMap(system.lift)(xi, p)
    before = np.zeros_like(lifted)
    before[:, :n] = shapes_before(dynamics, lifted[:, :n])
    step_lengths = RowMap(system.impact(Mode.STICK))(before, p)[0][:, n]
    xi[step_lengths < 0, :n_section] *= -1


def _walk(problem: Problem, engine: Engine, xi: Array, steps: int) -> Array:
    """Section states of walks from ``xi``, shape (steps + 1, n, n_xi); NaN where a walk has ended."""
    history = np.full((steps + 1, *xi.shape), np.nan)
    history[0], going, step = xi, np.arange(len(xi)), step_map(problem, None, engine)
    for k in range(steps):
        walked = step(history[k, going])
        going = going[walked.completed]
        history[k + 1, going] = walked.states[walked.completed]
        if not going.size:
            break
    return history


def _near_returns(history: Array, n_steps: int, box: StartBox) -> Iterator[tuple[int, Array]]:
    """Rows of ``history`` with the closest near-returns after ``n_steps``, and the states there; the closest first."""
    distances = np.abs((history[n_steps:] - history[:-n_steps]) / box.sizes).max(axis=2)
    distances = np.where(np.isnan(distances), np.inf, distances)
    nearest = np.argmin(distances, axis=0)
    best = distances[nearest, np.arange(nearest.size)]
    for row in np.argsort(best)[: min(TRIES, int(np.isfinite(best).sum()))]:
        yield int(row), history[n_steps + nearest[row], row]


def _guesses(
    job: SearchJob, dynamics: Dynamics, box: StartBox, rng: np.random.Generator, should_stop: Callable[[], bool]
) -> tuple[list[CandidateRecord], int]:
    """Motions of open mode sequence near steps in which all joints move at constant rates."""
    walker = dynamics.system.walker
    if walker.steps_per_cycle() > 1 or walker.modes() != CONTACTS or walker.pushes:
        return [], 0  # the conditions assume equal legs, one of which is always on the ground
    time, n = dynamics.scales.time, len(job.problem.walker.section)
    within = {
        name.removeprefix("state."): (span.minimum, span.maximum)
        for name, span in job.problem.constraints.items()
        if name.startswith("state.")
    }
    free, candidates = free_parameters(job.problem, dynamics.system), list[CandidateRecord]()
    for n_steps in range(1, job.n_steps + 1):
        program = Complementarity(
            dynamics, TYPICAL_PERIOD * time, free, within, n_steps=n_steps, should_stop=should_stop
        )
        xi = rng.uniform(box.lower, box.upper, (GUESSES * n_steps, box.lower.size))
        if not box.given:
            _turn_forward(dynamics, xi)
        for number, shapes in enumerate(np.split(xi[:, :n], GUESSES)):
            period = float(time * np.exp(rng.uniform(*np.log(PERIODS))))
            result = program.solve(*swing(dynamics, shapes, period), period)
            if result is Status.INTERRUPTED:
                raise KeyboardInterrupt
            if isinstance(result, Proposal):
                sequences = [
                    (tuple(zip(step.phases, durations, strict=True)), step.impact)
                    for step, durations in zip(result.cycle.steps, result.durations, strict=True)
                ]
                start = f"{job.method} {job.number}.{number}"
                candidates.append(_record(dynamics.system, sequences, list(result.states), result.freed, start))
    return candidates, GUESSES * job.n_steps


def cycle_record(system: HybridSystem, steps: Sequence[Step], start: str) -> CandidateRecord:
    """The candidate of a simulated cycle."""
    sequences = [(step.phases, step.impact.mode) for step in steps if step.impact is not None]
    return _record(system, sequences, [step.arcs[0].states[0] for step in steps], {}, start)


def _record(
    system: HybridSystem,
    steps: Sequence[tuple[Phases, Mode]],
    states: Sequence[Array],
    freed: Mapping[str, float],
    start: str,
) -> CandidateRecord:
    """The candidate of a cycle without repetitions, starting at its smallest state in lexical order."""
    least = system.walker.steps_per_cycle()
    n = next(k for k in range(least, len(steps) + 1, least) if len(steps) % k == 0 and _repeats(states, k))
    first = min(range(0, n, least), key=lambda k: tuple(states[k]))
    return {
        "steps": [
            {"phases": [phase_record(mode, t) for mode, t in phases], "impact": str(impact)}
            for phases, impact in (*steps[first:n], *steps[:first])
        ],
        "state": dict(zip(system.state_names, map(float, states[first]), strict=True)),
        "parameters": dict(freed),
        "start": start,
    }


def _repeats(states: Sequence[Array], n: int) -> bool:
    """Whether the states repeat after ``n`` steps."""
    size = np.abs(states[0]).max()
    return all(np.abs(state - states[k % n]).max() < SAME * size for k, state in enumerate(states))


def varied(problem: Problem) -> list[str]:
    """Parameters along which families are followed: the coefficients of friction and the slope."""
    keys = [key for key in problem.parameters if key.partition(".")[0] == "friction" or key == "walker.slope"]
    return [key for key in keys if problem.parameters[key]]


def search_family(job: SearchJob, _: None = None, should_stop: Stop = None) -> SearchRecord:
    """Candidates on the family of the gait of the job's problem, followed in the job's parameter."""
    gait = solve_sequence(job.problem, should_stop=should_stop)
    candidates = list[CandidateRecord]()
    if gait.converged:
        value, start = job.problem.parameters[job.parameter], f"{job.method} {job.number}, {job.parameter}"
        for side in (-1, 1):
            candidates += [
                cycle_record(gait.system, crossing.steps, start)
                for crossing in _crossings(gait, job, value * (1 + side * REACH), should_stop)
            ]
    if should_stop is not None and should_stop():
        raise KeyboardInterrupt
    return {"method": job.method, "starts": 1, "candidates": candidates}


def _crossings(gait: Gait, job: SearchJob, to: float, should_stop: Stop) -> Iterator[Gait]:
    """Gaits of a family, on the way to a value, next to which a branch crosses the value at which it began."""
    value = job.problem.parameters[job.parameter]
    request = Request(
        parameter=job.parameter,
        to=(to,),
        max_points=MAX_POINTS,
        verify_every=0,
        follow={"branch_points": 1, "mode_changes": 1, "doublings": job.n_steps // (2 * len(gait.steps))},
    )
    before: BranchPoint | None = None
    try:
        for record in follow_family(gait, request, should_stop=should_stop):
            if not isinstance(record, BranchPoint):
                continue
            same = before is not None and before.branch == record.branch
            if before is not None and same and (before.value - value) * (record.value - value) < 0:
                yield min(before, record, key=lambda point: abs(point.value - value)).gait
            before = record
    except (ProblemError, SolveError):  # the family cannot be followed in this parameter at all, or no further
        return
