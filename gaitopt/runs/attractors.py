"""Attractors of walks at many values of a parameter, from known gaits and from random starts.

Continuation follows every branch, stable or not. The attractors show what walks converge to, including chaos. Values
are grouped in blocks; within a block, walks start from the attractors of the previous value. They also start from the
stable gaits on the branch of the problem's gait, because most random walks fall if the basin of a gait is small.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from itertools import islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gaitopt.arrays import Array
from gaitopt.branches.request import Request
from gaitopt.callbacks import Stop, raise_if_stopped
from gaitopt.display import Plotted, counted
from gaitopt.errors import SolveError
from gaitopt.gait.branch import BranchPoint
from gaitopt.gait.frames import data_frame
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import AttractorsRecord, SettledRecord
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import state_unit, unit_of
from gaitopt.requests import AttractorsRequest
from gaitopt.runs.grid import Axis, at_point, check_parameters, check_room
from gaitopt.runs.jobs import Plan, ResultFile, all_results
from gaitopt.search.attractors import settled
from gaitopt.search.candidates import family
from gaitopt.search.solve import solve
from gaitopt.search.starts import around_guess, on_ground, start_box
from gaitopt.simulation.engine import choose_engine
from gaitopt.store.formats import json_file, validated
from gaitopt.store.run import Run
from gaitopt.systems import solve_sequence
from gaitopt.threads import Uncompared, cached_property
from gaitopt.verification.step_map import StepMap, section_coordinates, step_map
from gaitopt.workers.jobs import Job, ResumableJobs, key_of

if TYPE_CHECKING:
    from pandas import DataFrame

ATTRACTORS_FILE = "attractors.json"
SETTLED = ResultFile(name="settled.jsonl", key="job", model=SettledRecord)
BLOCK_LENGTH = 16
"""Number of values in a block, which are computed one after the other."""
START_DISTANCES = (1e-3, 0.03)
"""Relative distances of the starts around a known state."""
STARTS_FROM = "neighbour, branch, guess, random"
"""The kinds of starts. This text enters the key of a value, so that results from other starts are computed again."""
MAX_POINTS = 500
"""Largest number of points of the branch towards either end of the axis."""
CACHED_BRANCHES = 4
"""Number of branches that a process keeps in memory."""
STATE_BYTES = 200
"""Size of one state, in the file and in memory."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Attractors(Plotted):
    """The attractors of walks over a parameter.

    Attributes
    ----------
    problem, axis : the problem, and the values of the parameter.
    records : one per value: ``value``, ``attractors`` (each with ``states``, ``period_steps``, ``lyapunov`` and
        ``starts``) and ``endings`` (number of other walks by ending).
    folder : folder of its files.
    """

    problem: Problem
    axis: Axis
    records: Sequence[Mapping[str, Any]]
    folder: Path | None = None

    def __repr__(self) -> str:
        runs = [run for record in self.records for run in record["attractors"]]
        chaotic = sum(run["period_steps"] is None and (run["lyapunov"] or 0) > 0 for run in runs)
        span = f"{self.axis.key} {self.axis.lower:g} to {self.axis.upper:g}"
        counts = f"{counted(len(runs), 'attractor')} at {counted(len(self.records), 'value')}, {chaotic} chaotic"
        return f"<Attractors {self.problem.name} over {span}: {counts}>"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the section coordinates, the columns of ``states``."""
        return _names(self.problem)

    def to_records(self) -> list[dict[str, Any]]:
        """One JSON object per attractor, and one per value and ending of the other walks; the command prints these."""
        records = list[dict[str, Any]]()
        for record in self.records:
            records += [{"value": record["value"], **run} for run in record["attractors"]]
            others = record["endings"].items()
            records += [{"value": record["value"], "ending": name, "starts": count} for name, count in others]
        return records

    def to_frame(self) -> "DataFrame":
        """One row per state of an attractor: value, number of the attractor, its period and exponent, and the state."""
        header = (self.axis.key, "attractor", "period_steps", "lyapunov", *self.names)
        rows = [
            (r["value"], k, run["period_steps"] or 0, run["lyapunov"], *state)
            for r in self.records
            for k, run in enumerate(r["attractors"])
            for state in run["states"]
        ]
        units = {
            self.axis.key: unit_of(self.axis.key, self.problem),
            **{name: state_unit(name, self.problem) for name in self.names},
        }
        return data_frame(header, rows, {name: units.get(name, "") for name in header}, problem=self.problem.name)


def read_attractors(folder: Path) -> Attractors:
    """The attractors in a subfolder of the run of their problem."""
    run = Run.at(folder)
    stated = run.read_record(ATTRACTORS_FILE, AttractorsRecord)
    problem, axis = run.problem(), validated(Axis, stated["over"], folder / ATTRACTORS_FILE)
    return Attractors(problem=problem, axis=axis, records=SETTLED.finished(run, stated["jobs"]), folder=folder)


@dataclass(frozen=True, kw_only=True)
class AttractorsPlan(Plan[Attractors], AttractorsRequest):
    """Attractors to be computed.

    Attributes
    ----------
    axis : the values of a parameter.
    """

    results = SETTLED
    axis: Axis

    @cached_property
    def run(self) -> Run:
        """The run, with the subfolder of the files."""
        return Run(self.folder, f"attractors-{key_of([str(self.axis), *self.request.identity])[:8]}")

    @cached_property
    def request(self) -> AttractorsRequest:
        """The request, in which the choice of the engine is made for the number of steps."""
        engine = choose_engine(self.engine, steps=self.axis.count * self.starts * (self.transient + self.keep))
        return AttractorsRequest(**{**self.arguments, "engine": engine})

    def check(self) -> None:
        """Refuse an axis that is not over a parameter, an invalid value, or too many states."""
        check_parameters(self.problem, self.axis)
        check_room(self.axis.count * self.keep, self.folder, disk=STATE_BYTES, memory=STATE_BYTES, what="states")
        _ = self.jobs

    def result(self, jobs: ResumableJobs) -> Attractors:
        """The attractors at all values."""
        records = all_results(jobs, settle_job, self.jobs, "value")
        summary = {"over": asdict(self.axis), "jobs": [job.key for job in self.jobs]}
        self.run.write({ATTRACTORS_FILE: json_file(summary)})
        return Attractors(problem=self.problem, axis=self.axis, records=records, folder=self.run.result_folder)

    @cached_property
    def jobs(self) -> list[Job]:
        """One job per value; in a block, all but the first one start from the result of the previous one."""
        jobs = list[Job]()
        for number, value in enumerate(self.axis.numbers(self.problem)):
            problem = at_point(self.problem, {self.axis.key: value})
            *asked, engine = self.request.identity
            parent = jobs[-1].key if number % BLOCK_LENGTH else None
            identity = [problem.digest, self.problem.digest, str(self.axis), STARTS_FROM, *asked, number, value, engine]
            argument = (self.problem, self.axis, problem, self.request, number, value)
            jobs.append(Job(key=key_of([*identity, parent]), argument=argument, parent=parent))
        return jobs


def settle_job(
    argument: tuple[Problem, Axis, Problem, AttractorsRequest, int, float],
    neighbour: Mapping[str, Any] | None = None,
    should_stop: Stop = None,
) -> dict[str, Any]:
    """The job of one value, in any process; returns its record."""
    origin, axis, problem, request, number, value = argument
    mapped = step_map(problem, None, request.engine)
    rng = np.random.default_rng([request.seed, number])
    names = _names(problem)
    known = [np.array(run["states"][-1]) for run in (neighbour or {}).get("attractors", [])]
    for gait in gaits_on_branch(origin, axis, problem, value, should_stop):
        known.append(gait.state[[gait.system.state_names.index(name) for name in names]])
    if problem.start is not None:
        known.append(np.array([problem.start.state[name] for name in names]))
    xi = np.array([*islice(_starts(problem, mapped, known, rng), request.starts)])
    xi = section_coordinates(problem, xi) if mapped.is_stated else xi
    runs, endings = settled(mapped, xi, transient=request.transient, keep=request.keep, should_stop=should_stop)
    found = [
        {
            "states": run.states.tolist(),
            "period_steps": run.period_steps,
            "lyapunov": run.lyapunov if np.isfinite(run.lyapunov) else None,
            "starts": run.starts,
        }
        for run in sorted(runs, key=lambda run: -run.starts)
    ]
    return {"value": value, "attractors": found, "endings": endings}


def gaits_on_branch(
    origin: Problem, axis: Axis, problem: Problem, value: float, should_stop: Stop = None
) -> Iterator[Gait]:
    """The stable gaits at a value on the branch of the gait of ``origin`` along an axis.

    Unstable gaits are left out: they attract nothing, and a walk that starts on one leaves it slowly.

    Parameters
    ----------
    problem : the problem ``origin`` at the value.
    """
    points = _branch(origin, axis, Uncompared(should_stop))
    for before, after in pairwise(points):
        # a value exactly at a point counts once, for the section of the branch that ends there
        passed = (before.value - value) * (after.value - value) < 0 or after.value == value
        if before.branch != after.branch or not passed:
            continue
        near = min(before, after, key=lambda point: abs(point.value - value)).gait
        gait = solve_sequence(problem.with_gait(near.to_record()), should_stop=should_stop)
        if gait.converged and gait.stable:
            yield gait


@lru_cache(maxsize=CACHED_BRANCHES)
def _branch(problem: Problem, axis: Axis, stop: Uncompared[Stop]) -> tuple[BranchPoint, ...]:
    """The points of the branch; empty if the problem has no gait, or if the gait cannot be followed along the axis."""
    key, points, should_stop = axis.key, list[BranchPoint](), stop.value
    value = problem.parameters[key]
    if problem.is_open or problem.is_design or isinstance(value, int):
        return ()
    try:
        gait = solve(problem, should_stop=should_stop)
    except SolveError:  # the reference of its control law has no solution; the walks report it
        return ()
    if gait.converged:
        for end in dict.fromkeys((axis.lower, axis.upper)):
            if end != value:
                request = Request(parameter=key, to=(end,), max_points=MAX_POINTS, verify_every=0)
                records = family(gait, request, should_stop)
                points += [record for record in records if isinstance(record, BranchPoint)]
    raise_if_stopped(should_stop)  # an incomplete branch must not enter the cache
    return tuple(points)


def _starts(problem: Problem, mapped: StepMap, known: Sequence[Array], rng: Any) -> Iterator[Array]:
    """Start states: the ``known`` ones, then in turn states around each of them, and random ones.

    Around a whole state, the same contacts are on the ground.
    """
    dynamics = mapped.dynamics
    box = start_box(problem, dynamics, {}) if mapped.is_stated else None
    yield from known
    while True:
        for state in known:
            for spread in START_DISTANCES:
                if box is not None:
                    yield state * (1 + spread * rng.uniform(-1, 1, state.size))
                    continue
                near = on_ground(dynamics, state, spread * dynamics.state_units * rng.uniform(-1, 1, state.size))
                yield near if np.isfinite(near).all() else state
        if box is not None:
            anywhere = rng.uniform(box.lower, box.upper)
            anywhere[-1] *= not (problem.is_open or problem.cycle.impact.sticks)
            yield anywhere
        else:
            around = around_guess(problem, dynamics, 1, rng, exact=False, within={})
            yield from around[np.isfinite(around).all(axis=1)]


def _names(problem: Problem) -> tuple[str, ...]:
    """Names of the coordinates of the states of attractors: of the section if the class states it, or all."""
    return problem.walker.state_names() if problem.section is None else problem.map_section.defining_names
