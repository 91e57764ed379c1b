"""Candidates of a search for gaits: a mode sequence with a motion, not yet solved nor verified.

Two searches propose them. Walks of the simulator, which chooses its own modes, end near gaits or are led to them by
Newton's method on the return map. A program with complementarity conditions in place of a mode sequence finds motions
of any sequence, also where parameters are free and where no walk leads.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitopt.gait import Status
from gaitopt.mechanics import HybridSystem, Mode
from gaitopt.nlp import free_parameters
from gaitopt.nlp.complementarity import Complementarity, Proposal, shapes_before, swing
from gaitopt.orbit import ReturnMap, damped_fixed_point
from gaitopt.problem import Problem
from gaitopt.simulation import Engine, Simulator, choose_engine, make_stepper
from gaitopt.simulation.batch_functions import Rowwise
from gaitopt.study.batch import step_map
from gaitopt.study.system import build_system

Array = NDArray[np.float64]
Record = dict[str, Any]

ANGLE, RATE, SLIP = 0.4, 0.6, 0.3
"""Half widths of the default box of start states, in rad and natural units."""
SMALLEST_SCALE = 0.3
"""Samples of the default box lie in boxes from this part of it to its whole: walkers make small steps too."""
STANDING = 0.05
"""A period shorter than this in natural units is no step: feet that stay together solve all equations."""
PERIODS = (0.7, 3.0)
"""Range of the guessed periods in natural units."""
TYPICAL_PERIOD = 1.7
WALK = 8
"""Steps of a walk on which a near-return is looked for."""
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
    """A part of a search: ``number`` distinguishes the samples of its parts."""

    problem: Problem
    method: str
    number: int
    seed: int
    within: Mapping[str, tuple[float, float]]


def search_part(job: SearchJob, _: None = None) -> Record:
    """Candidates of one part of a search, and how many starts it has made.

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C was pressed.
    """
    system = build_system(job.problem)
    p = system.values(job.problem.parameters)
    box, rng = start_box(job.problem, system, p, job.within), np.random.default_rng([job.seed, job.number])
    search = _walks if job.method == "simulation" else _guesses
    candidates, starts = search(job, system, p, box, rng)
    return {"method": job.method, "starts": starts, "candidates": candidates}


def start_box(problem: Problem, system: HybridSystem, p: Array, within: Mapping[str, tuple[float, float]]) -> Box:
    """The box of start states: that of the walker, changed by ``within``."""
    scales, n_section = system.scales(p), len(problem.walker.section)
    names = problem.walker.section_names(slipping=True)
    half = np.array([ANGLE] * n_section + [RATE / scales.time] * system.n_shape + [SLIP * scales.speed])
    lower, upper = -half, half.copy()
    for name, span in within.items():
        lower[names.index(name)], upper[names.index(name)] = span
    return Box(lower=lower, upper=upper, given=bool(within))


def _walks(
    job: SearchJob, system: HybridSystem, p: Array, box: Box, rng: np.random.Generator
) -> tuple[list[Record], int]:
    """Fixed points of the return map next to the walks from sampled states."""
    xi, standing = _samples(system, p, box, rng), STANDING * system.scales(p).time
    if job.problem.start is not None and job.number == 0:
        xi[0] = [job.problem.start.state[name] for name in job.problem.walker.section_names(slipping=True)]
    engine = choose_engine(Engine.AUTO, steps=WALKS * WALK)
    best, states = _near_returns(job.problem, engine, xi, box)
    simulator = Simulator(system, p, stepper=make_stepper(system, p, engine))
    maps = {True: ReturnMap(simulator, Mode.SLIP_FORWARD), False: ReturnMap(simulator, Mode.STICK)}
    candidates = []
    for row in np.argsort(best)[: min(TRIES, int(np.isfinite(best).sum()))]:
        slipping = bool(states[row, -1])
        n = states.shape[1] if slipping else states.shape[1] - 1
        point = damped_fixed_point(maps[slipping], states[row, :n], box.sizes[:n])
        if point is not None and point[1].impact is not None and point[1].period > standing:
            impact, phases = point[1].impact, point[1].phases
            candidates.append(_record(system, impact.mode, phases, impact.state, {}, job, int(row)))
    return candidates, len(xi)


def _samples(system: HybridSystem, p: Array, box: Box, rng: np.random.Generator) -> Array:
    """Start states, every other one at rest, in boxes of all sizes unless a box is given; shape (WALKS, n_xi)."""
    xi = rng.uniform(box.lower, box.upper, (WALKS, box.lower.size))
    if not box.given:
        xi *= rng.uniform(SMALLEST_SCALE, 1.0, (WALKS, 1))
        _turn_forward(system, p, xi)
    if box.lower[-1] <= 0 <= box.upper[-1]:
        xi[::2, -1] = 0.0
    return xi


def _turn_forward(system: HybridSystem, p: Array, xi: Array) -> None:
    """Mirror postures (n, n_xi) to which a step backward would lead."""
    n, n_section = system.n_shape, len(system.walker.section)
    (lifted,) = Rowwise(system.lift)(xi, p)
    before = np.zeros_like(lifted)
    before[:, :n] = shapes_before(system, p, lifted[:, :n])
    step_lengths = Rowwise(system.impact(Mode.STICK))(before, p)[0][:, n]
    xi[step_lengths < 0, :n_section] *= -1


def _near_returns(problem: Problem, engine: Engine, xi: Array, box: Box) -> tuple[Array, Array]:
    """Of each walk the least distance between neighbouring states, shape (n,), and the latter of the two."""
    step, going, states = step_map(problem, None, engine), np.arange(len(xi)), xi.copy()
    best, nearest = np.full(len(xi), np.inf), xi.copy()
    for _ in range(WALK):
        walked = step(states[going])
        going, after = going[walked.completed], walked.states[walked.completed]
        distance = np.abs((after - states[going]) / box.sizes).max(axis=1)
        states[going] = after
        closer = distance < best[going]
        best[going[closer]], nearest[going[closer]] = distance[closer], after[closer]
        if not going.size:
            break
    return best, nearest


def _guesses(
    job: SearchJob, system: HybridSystem, p: Array, box: Box, rng: np.random.Generator
) -> tuple[list[Record], int]:
    """Motions of open mode sequence near steps in which all joints move at constant rates."""
    time, n = system.scales(p).time, len(job.problem.walker.section)
    program = Complementarity(system, p, TYPICAL_PERIOD * time, free_parameters(job.problem, system))
    xi = rng.uniform(box.lower, box.upper, (GUESSES, box.lower.size))
    if not box.given:
        _turn_forward(system, p, xi)
    candidates = []
    for number, shape in enumerate(xi[:, :n]):
        period = float(time * np.exp(rng.uniform(*np.log(PERIODS))))
        result = program.solve(*swing(system, p, shape, period), period)
        if result is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if isinstance(result, Proposal):
            phases = tuple(zip(result.sequence.phases, result.durations, strict=True))
            impact = result.sequence.impact
            candidates.append(_record(system, impact, phases, result.state, result.freed, job, number))
    return candidates, GUESSES


def _record(
    system: HybridSystem,
    impact: Mode,
    phases: tuple[tuple[Mode, float], ...],
    state: Array,
    freed: Mapping[str, float],
    job: SearchJob,
    start: int,
) -> Record:
    """A candidate as one JSON object, with the keys of a gait that a guess needs."""
    return {
        "phases": [{"mode": str(mode), "duration": duration} for mode, duration in phases],
        "impact": str(impact),
        "state": dict(zip(system.state_names, map(float, state), strict=True)),
        "parameters": dict(freed),
        "start": f"{job.method} {job.number}.{start}",
    }
