"""Candidates of a search for gaits: a mode sequence with a motion, not yet solved nor verified.

Two searches propose them. Walks of the simulator, which chooses its own modes, end near gaits or are led to them by
Newton's method on the return map. A program with complementarity conditions in place of a mode sequence finds motions
of any sequence, also where parameters are free and where no walk leads.

Gaits of other mode sequences next to a known one: its family is followed a little way, and may come back.

Where a mode sequence is about to change, the branch turns or other branches begin, several gaits exist side by side,
of which some attract no walk. Each time that a branch of the family crosses the parameter's own value there is one.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitopt.arrays import Array
from gaitopt.branches.continuation import follow_family
from gaitopt.branches.request import Request
from gaitopt.callbacks import Stop
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.branch import BranchPoint
from gaitopt.gait.gait import Gait, Status
from gaitopt.gait.trajectory import Step
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.nlp.open_modes import Complementarity, Proposal, shapes_before, swing
from gaitopt.nlp.solve import free_parameters
from gaitopt.problem.problem import Problem
from gaitopt.simulation.engine import Engine, choose_engine, make_stepper
from gaitopt.simulation.heyoka_batch import RowMap
from gaitopt.simulation.simulator import Simulator
from gaitopt.systems import solve_sequence
from gaitopt.verification.return_map import ReturnMap, step_map

Record = dict[str, Any]
Phases = tuple[tuple[Mode, float], ...]

ANGLE, RATE, SLIP = 0.4, 0.6, 0.3
"""Half widths of the default box of start states, in rad and natural units."""
RATE_OF_FLIGHT = 2.0
"""The same for walkers that fly: they come down from some height."""
SMALLEST_SCALE = 0.3
"""Samples of the default box lie in boxes from this part of it to its whole: walkers make small steps too."""
STANDING = 0.05
"""A period shorter than this in natural units is no step: feet that stay together solve all equations."""
SAME = 1e-3
"""States whose difference is less than this part of their size are one."""
PERIODS = (0.7, 3.0)
"""Range of the guessed periods in natural units."""
TYPICAL_PERIOD = 1.7
WALK = 8
"""Steps of a walk within which a near-return counts."""
TRIES = 40
"""Walks of one job from which Newton's method starts, those that come closest to themselves first."""
WALKS, GUESSES = 250, 4
"""Start states of one job of walks, and guesses of one job of complementarity."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """Range of the start states by section coordinate; ``given`` where it is not the walker's default."""

    lower: Array
    upper: Array
    given: bool

    @property
    def sizes(self) -> Array:
        """Widths, shape (n_xi,)."""
        return self.upper - self.lower


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchJob:
    """A part of a search for cycles of up to ``n_steps``.

    ``number`` distinguishes the samples of its parts, ``parameter`` is that of a family.
    """

    problem: Problem
    method: str
    number: int
    seed: int
    within: Mapping[str, tuple[float, float]]
    parameter: str = ""
    n_steps: int = 1


def search_part(job: SearchJob, _: None = None, should_stop: Stop = None) -> Record:
    """Candidates of one part of a search, and how many starts it took."""
    stop = should_stop or (lambda: False)
    step = step_map(job.problem, None, choose_engine(Engine.AUTO, steps=WALKS * WALK))  # once in every process
    dynamics = step.dynamics
    box, rng = start_box(job.problem, dynamics, job.within), np.random.default_rng([job.seed, job.number])
    search = _walks if job.method == "simulation" else _guesses
    candidates, starts = search(job, dynamics, box, rng, stop)
    return {"method": job.method, "starts": starts, "candidates": candidates}


def start_box(problem: Problem, dynamics: Dynamics, within: Mapping[str, tuple[float, float]]) -> Box:
    """The box of start states: that of the walker, changed by ``within``."""
    names = problem.walker.section_names(slipping=True)
    units = dict(zip(dynamics.system.state_names, dynamics.state_units, strict=True))
    sizes = {"dx": SLIP} | dict.fromkeys(problem.walker.section, ANGLE)
    rate = RATE_OF_FLIGHT if problem.walker.flies else RATE
    half = np.array([sizes.get(name, rate) * units[name] for name in names])
    lower, upper = -half, half.copy()
    for name, span in within.items():
        lower[names.index(name)], upper[names.index(name)] = span
    return Box(lower=lower, upper=upper, given=bool(within))


def _walks(
    job: SearchJob, dynamics: Dynamics, box: Box, rng: np.random.Generator, should_stop: Callable[[], bool]
) -> tuple[list[Record], int]:
    """Fixed points of the return map and of its powers next to the walks from sampled states."""
    system = dynamics.system
    xi, standing = _samples(dynamics, box, rng), STANDING * dynamics.scales.time
    if job.problem.start is not None and job.number == 0:
        xi[0] = [job.problem.start.state[name] for name in job.problem.walker.section_names(slipping=True)]
    engine = choose_engine(Engine.AUTO, steps=WALKS * WALK)
    history = _walk(job.problem, engine, xi, WALK + job.n_steps - 1)
    simulator = Simulator(dynamics, stepper=make_stepper(dynamics, engine))
    candidates = []
    sides = system.walker.n_sides()
    for n_returns in range(1, job.n_steps // sides + 1):
        maps = {mode: ReturnMap(simulator, mode, n_returns * sides) for mode in (Mode.STICK, Mode.SLIP_FORWARD)}
        for row, state in _near_returns(history, n_returns, box):
            if should_stop():
                raise KeyboardInterrupt
            mode = Mode.SLIP_FORWARD if state[-1] else Mode.STICK
            n = state.size if state[-1] else state.size - 1
            steps = maps[mode].damped_fixed_point(state[:n], box.sizes[:n])
            if steps is not None and steps[0].period > standing:
                candidates.append(cycle_record(system, steps, f"{job.method} {job.number}.{row}"))
    return candidates, len(xi)


def _samples(dynamics: Dynamics, box: Box, rng: np.random.Generator) -> Array:
    """Start states, every other one at rest, in boxes of all sizes unless a box is given; shape (WALKS, n_xi)."""
    walker = dynamics.system.walker
    xi = rng.uniform(box.lower, box.upper, (WALKS, box.lower.size))
    if not box.given:
        xi *= rng.uniform(SMALLEST_SCALE, 1.0, (WALKS, 1))
        if not walker.flies:
            _turn_forward(dynamics, xi)
    if walker.massless_feet:
        xi[:, -1] = 0.0  # they cannot slip
    elif box.lower[-1] <= 0 <= box.upper[-1]:
        xi[::2, -1] = 0.0
    return xi


def _turn_forward(dynamics: Dynamics, xi: Array) -> None:
    """Mirror postures (n, n_xi) to which a step backward would lead."""
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


def _near_returns(history: Array, n_steps: int, box: Box) -> Iterator[tuple[int, Array]]:
    """The walks that come closest to where they were ``n_steps`` before, and the states there, the closest first."""
    distances = np.abs((history[n_steps:] - history[:-n_steps]) / box.sizes).max(axis=2)
    distances = np.where(np.isnan(distances), np.inf, distances)
    nearest = np.argmin(distances, axis=0)
    best = distances[nearest, np.arange(nearest.size)]
    for row in np.argsort(best)[: min(TRIES, int(np.isfinite(best).sum()))]:
        yield int(row), history[n_steps + nearest[row], row]


def _guesses(
    job: SearchJob, dynamics: Dynamics, box: Box, rng: np.random.Generator, should_stop: Callable[[], bool]
) -> tuple[list[Record], int]:
    """Motions of open mode sequence near steps in which all joints move at constant rates."""
    walker = dynamics.system.walker
    if walker.n_sides() > 1 or walker.stops or walker.switches or walker.flies or walker.pushes:
        return [], 0  # the conditions are those of legs that are alike, of which one is always on the ground
    time, n = dynamics.scales.time, len(job.problem.walker.section)
    within = {
        name.removeprefix("state."): (span.minimum, span.maximum)
        for name, span in job.problem.constraints.items()
        if name.startswith("state.")
    }
    free, candidates = free_parameters(job.problem, dynamics.system), list[Record]()
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


def cycle_record(system: HybridSystem, steps: Sequence[Step], start: str) -> Record:
    """The candidate of a simulated cycle."""
    sequences = [(step.phases, step.impact.mode) for step in steps if step.impact is not None]
    return _record(system, sequences, [step.arcs[0].states[0] for step in steps], {}, start)


def _record(
    system: HybridSystem,
    steps: Sequence[tuple[Phases, Mode]],
    states: Sequence[Array],
    freed: Mapping[str, float],
    start: str,
) -> Record:
    """A cycle without repetitions, from the smallest of its states in lexical order."""
    sides = system.walker.n_sides()
    n = next(k for k in range(sides, len(steps) + 1, sides) if len(steps) % k == 0 and _repeats(states, k))
    first = min(range(0, n, sides), key=lambda k: tuple(states[k]))
    return {
        "steps": [
            {"phases": [{**mode.record, "duration": t} for mode, t in phases], "impact": str(impact)}
            for phases, impact in (*steps[first:n], *steps[:first])
        ],
        "state": dict(zip(system.state_names, map(float, states[first]), strict=True)),
        "parameters": dict(freed),
        "start": start,
    }


def _repeats(states: Sequence[Array], n: int) -> bool:
    """Whether a cycle of states is one of ``n`` states several times over."""
    size = np.abs(states[0]).max()
    return all(np.abs(state - states[k % n]).max() < SAME * size for k, state in enumerate(states))


REACH = 0.25
"""Part of a parameter's value by which a family is followed to either side."""
MAX_POINTS = 150
"""Bound on the work for one direction; without folds there are forty."""


def varied(problem: Problem) -> list[str]:
    """Parameters along which families are followed: the coefficients of friction and the slope."""
    keys = [key for key in problem.parameters if key.partition(".")[0] == "friction" or key == "walker.slope"]
    return [key for key in keys if problem.parameters[key]]


def search_family(job: SearchJob, _: None = None, should_stop: Stop = None) -> Record:
    """Candidates on the family of one gait, that of the job's closed problem, along the job's parameter."""
    gait = solve_sequence(job.problem, should_stop=should_stop)
    candidates = list[Record]()
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
    """Gaits of a family next to which a branch crosses the value at which it begins, on the way to another one."""
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
