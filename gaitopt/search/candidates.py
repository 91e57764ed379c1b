"""Candidates of a search for gaits: mode sequences with a motion, neither solved nor verified yet.

Two searches propose them:

- Simulation: walks of the simulator, which finds the modes itself, end near fixed points of the return map, x = P(x);
  Newton's method converges to them from near-returns, where |P^n(x) - x| is small.
  Where parameters are free, each job walks with values of its own.
- Families: the family of a known gait is followed a little way in a parameter. Next to mode changes, folds and branch
  points several gaits exist at the same parameters. Each crossing of a branch with the parameter's original value is a
  candidate.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil, floor, log10

import numpy as np

from gaitopt.arrays import Array
from gaitopt.branches.request import Request
from gaitopt.callbacks import Stop
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.branch import BranchPoint, SpecialPoint
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import CandidateRecord, SearchRecord
from gaitopt.model.buffered import RowMap
from gaitopt.model.checks import swing_foot
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.problem.problem import Problem
from gaitopt.requests import Engine, Method
from gaitopt.search.candidate import cycle_record, guessed_values
from gaitopt.search.contact_walks import SMALLEST_SCALE, contact_candidates
from gaitopt.simulation.engine import choose_engine
from gaitopt.simulation.simulator import Simulator, stepper_class
from gaitopt.systems import solve_sequence
from gaitopt.verification.return_map import ReturnMap
from gaitopt.verification.step_map import StepMap, step_map

Within = Mapping[str, tuple[float, float]]

ANGLE, RATE, SLIP = 0.4, 0.6, 0.3
"""Half widths of the default box of start states, in rad and natural units."""
RATE_OF_FLIGHT = 2.0
"""Half width of rates for walkers that fly, which come down from some height."""
FASTEST = 5.0
"""Bound of the rates and slip velocities of a box that grows, in natural units; a running person reaches three."""
MARGIN, SMALLEST_MARGIN = 0.5, 5e-3
"""Distance of a box from the gaits that it surrounds, relative to their largest angle or rate, and at least, in natural
units."""
WALL = 0.1
"""Distance from the wall of a box, relative to its width, below which a state lies near the wall."""
SHORTEST_STEP_PERIOD = 0.05
"""Minimum period of a step in natural units; two feet that rest side by side solve the equations with period 0."""
WALK = 8
"""Steps of a walk that is searched for near-returns."""
TRIES = 40
"""Maximum number of starts of Newton's method per job: from the closest near-returns, then from the starts of the walks
that return, which lead to unstable gaits too."""
WALKS, WALKS_OF_DESIGN = 250, 25
"""Number of start states of a job, and of one with values of its own for the free parameters."""
SPREAD = 0.5
"""Range of these values around their guesses, relative to the guess."""

REACH = 0.25
"""Distance over which a family is followed to either side, relative to the parameter."""
MAX_POINTS = 150
"""Maximum number of points in one direction; a family without folds has about forty."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StartBox:
    """Range of the start states by section coordinate; chosen by the user, or the walker's ``default``."""

    names: tuple[str, ...]
    lower: Array
    upper: Array
    default: bool

    @property
    def sizes(self) -> Array:
        """Widths, shape (n_xi,)."""
        return self.upper - self.lower

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Minimum and maximum by name."""
        return dict(zip(self.names, zip(self.lower.tolist(), self.upper.tolist(), strict=True), strict=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchJob:
    """One job of a search for cycles of up to ``n_steps`` steps.

    ``number`` selects its samples, ``parameter`` is the one in which a family is followed, from a gait that ``solver``
    finds.
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
    """Number of start states of a job that walks."""
    return WALKS_OF_DESIGN if problem.free and not problem.walker.contacts else WALKS


def find_candidates(job: SearchJob, _: None = None, should_stop: Stop = None) -> SearchRecord:
    """Candidates of one job of a search, and the number of its starts."""
    if job.method == "simulation":
        job = replace(job, problem=_with_sampled_values(job))
    if job.problem.walker.contacts:
        stop = should_stop or (lambda: False)
        candidates, starts = contact_candidates(job.problem, job.number, job.seed, job.n_steps, stop)
        return {"method": job.method, "starts": starts, "candidates": candidates}
    methods = {"simulation": _from_walks, "families": _from_family}
    candidates, starts = methods[job.method](job, should_stop or (lambda: False))
    return {"method": job.method, "starts": starts, "candidates": candidates}


def _with_sampled_values(job: SearchJob) -> Problem:
    """The problem with guesses of the job's own for the free parameters; the first job has those of the problem."""
    problem, rng = job.problem, np.random.default_rng([job.seed, job.number, len(job.problem.free)])
    if not problem.free or job.number == 0:
        return problem
    sizes = {key: abs(free.guess) or free.upper - free.lower for key, free in problem.free.items()}
    values = {key: problem.free[key].guess + SPREAD * size * rng.uniform(-1, 1) for key, size in sizes.items()}
    try:
        return problem.replace(problem.free_guesses(values))
    except ProblemError:  # the walker cannot have these values together
        return problem


def start_box(problem: Problem, dynamics: Dynamics, within: Within) -> StartBox:
    """The box of start states: that of the walker, changed by ``within``."""
    names = problem.walker.section_names(slipping=True)
    units = dict(zip(dynamics.system.state_names, dynamics.state_units, strict=True))
    sizes = {"dx": SLIP} | dict.fromkeys(type(problem.walker).section, ANGLE)
    rate = RATE_OF_FLIGHT if problem.walker.flies else RATE
    half = np.array([sizes.get(name, rate) * units[name] for name in names])
    centre = np.array([problem.walker.posture.get(name, 0.0) for name in names])
    lower, upper = centre - half, centre + half
    for name, span in within.items():
        lower[names.index(name)], upper[names.index(name)] = span
    return StartBox(names=names, lower=lower, upper=upper, default=not within)


def box_around(problem: Problem, dynamics: Dynamics, states: Array) -> StartBox:
    """A box that surrounds section states, so that none lies near its wall; numbers have two digits.

    Two digits make the box, and the search in it, independent of the rounding of the states.

    Parameters
    ----------
    states : ndarray, shape (n, n_xi), n > 0.
    """
    walker = problem.walker
    units = dynamics.state_units[dynamics.system.section(Mode.SLIP_FORWARD).indices]
    natural, n = states / units, len(type(walker).section)
    margins = np.repeat(
        [
            MARGIN * max(np.abs(part).max(initial=0.0), SMALLEST_MARGIN / MARGIN)
            for part in np.split(natural, [n], axis=1)
        ],
        [n, units.size - n],
    )
    lower, upper = (natural.min(axis=0) - margins) * units, (natural.max(axis=0) + margins) * units
    for k, width in enumerate(upper - lower):
        digits = 1 - floor(log10(width))
        lower[k] = round(floor(lower[k] * 10.0**digits) / 10.0**digits, digits)
        upper[k] = round(ceil(upper[k] * 10.0**digits) / 10.0**digits, digits)
    names = walker.section_names(slipping=True)
    return StartBox(names=names, lower=lower, upper=upper, default=False)


def natural_limits(problem: Problem, dynamics: Dynamics) -> Array:
    """Largest size of every section coordinate in a box that grows, shape (n_xi,)."""
    units = dynamics.state_units[dynamics.system.section(Mode.SLIP_FORWARD).indices]
    n = len(type(problem.walker).section)
    return units * np.repeat([problem.walker.largest_angle, FASTEST], [n, units.size - n])


def _step_map(job: SearchJob) -> StepMap:
    """The return map of the problem's walker, built once in every process."""
    return step_map(job.problem, None, choose_engine(Engine.AUTO, steps=WALKS * WALK))


def _from_walks(job: SearchJob, should_stop: Callable[[], bool]) -> tuple[list[CandidateRecord], int]:
    """Fixed points of the return map and of its powers next to walks from sampled states."""
    step, rng = _step_map(job), np.random.default_rng([job.seed, job.number])
    dynamics, walker = step.dynamics, step.dynamics.system.walker
    box = start_box(job.problem, dynamics, job.within)
    xi = _samples(dynamics, box, walks_of(job.problem), rng)
    if job.problem.start is not None and job.number == 0:
        xi[0] = [job.problem.start.state[name] for name in walker.section_names(slipping=True)]
    history = np.full((WALK + job.n_steps, *xi.shape), np.nan)  # section states; NaN after the end of a walk
    history[0], walking = xi, np.arange(len(xi))
    for before, after in pairwise(history):
        walked = step(before[walking])
        walking = walking[walked.completed]
        after[walking] = walked.states[walked.completed]
        if not walking.size:
            break
    simulator, candidates = Simulator(dynamics, stepper_class(step.engine)), list[CandidateRecord]()
    shortest, least = SHORTEST_STEP_PERIOD * dynamics.scales.time, walker.steps_per_cycle()
    for n_returns in range(1, job.n_steps // least + 1):
        maps = {mode: ReturnMap(simulator, mode, n_returns * least) for mode in (Mode.STICK, Mode.SLIP_FORWARD)}
        distances = np.abs((history[n_returns:] - history[:-n_returns]) / box.sizes).max(axis=2)
        distances = np.where(np.isnan(distances), np.inf, distances)
        nearest = np.argmin(distances, axis=0)
        closest, first = distances[nearest, np.arange(nearest.size)], distances[0]
        tries = [(n_returns + nearest[row], row) for row in np.argsort(closest) if np.isfinite(closest[row])]
        tries += [(0, row) for row in np.argsort(first) if np.isfinite(first[row])]
        for k, row in tries[:TRIES]:
            if should_stop():
                raise KeyboardInterrupt
            state = history[k, row]
            mode = Mode.SLIP_FORWARD if state[-1] else Mode.STICK
            n = state.size if state[-1] else state.size - 1
            steps = maps[mode].damped_fixed_point(state[:n], box.sizes[:n])
            if steps is not None and steps[0].period > shortest:
                start = f"{job.method} {job.number}.{row}"
                candidates.append(cycle_record(dynamics.system, steps, start, guessed_values(job.problem)))
    return candidates, len(xi)


def _samples(dynamics: Dynamics, box: StartBox, count: int, rng: np.random.Generator) -> Array:
    """Start states, every other one at rest, in boxes of all sizes if the box is the default; shape (count, n_xi)."""
    walker = dynamics.system.walker
    xi = rng.uniform(box.lower, box.upper, (count, box.lower.size))
    if box.default:
        xi *= rng.uniform(SMALLEST_SCALE, 1.0, (count, 1))
        if not walker.flies:
            _turn_forward(dynamics, xi)
    if not any(mode.slips for mode in walker.foot_modes()):
        xi[:, -1] = 0.0
    elif box.lower[-1] <= 0 <= box.upper[-1]:
        xi[::2, -1] = 0.0
    return xi


def _turn_forward(dynamics: Dynamics, xi: Array) -> None:
    """Mirror the postures in ``xi``, shape (n, n_xi), whose step would lead backward."""
    system, walker, p = dynamics.system, dynamics.system.walker, dynamics.p
    (lifted,) = RowMap(system.lift)(xi, p)
    shapes, parameters = lifted[:, : system.n_shape], p[: len(walker.model_fields)]
    feet = np.array([swing_foot(walker, shape, parameters) for shape in shapes])
    xi[feet[:, 0] > 0, : len(walker.section)] *= -1


def _from_family(job: SearchJob, should_stop: Callable[[], bool]) -> tuple[list[CandidateRecord], int]:
    """Crossings of the family of the job's gait with the value of a parameter at which it began."""
    gait, candidates = solve_sequence(job.problem, method=job.solver, should_stop=should_stop), list[CandidateRecord]()
    if gait.converged:
        value, start = job.problem.parameters[job.parameter], f"{job.method} {job.number}, {job.parameter}"
        follow = {"branch_points": 1, "mode_changes": 1, "doublings": job.n_steps // (2 * len(gait.steps))}
        for side in (-1, 1):
            request = Request(
                parameter=job.parameter,
                to=(value * (1 + side * REACH),),
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
    from gaitopt.branches.continuation import follow_family  # most problems are solved without a family

    try:
        yield from follow_family(gait, request, should_stop=should_stop)
    except (ProblemError, SolveError):
        return
