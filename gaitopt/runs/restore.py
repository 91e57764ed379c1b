"""Gaits and walks from run folders, with everything that fresh ones have except the solver's own nodes.

What a folder holds, by its files: a branch, a gait, a walk, fronts; or in a folder of its own a sweep or a basin.

A branch from its run folder, every point a gait again.

A branch in its run folder: every record is on the disk before it is used, and an interrupted walk resumes.

A search for gaits whose parts are kept in a run folder, so that the same search resumes where it stopped.

A part is known by all that it depends on. What an earlier version has kept under another key is searched again, and a
line without the entries of ``PartRecord`` is refused with file and line.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from gaitopt.branches.continuation import follow_family, resumable
from gaitopt.branches.request import Request, family_of
from gaitopt.callbacks import Counted, Stop
from gaitopt.errors import SolveError, StorageError
from gaitopt.gait.branch import Branch, BranchPoint, SpecialPoint, branch_header, branch_rows
from gaitopt.gait.gait import Gait, Status
from gaitopt.gait.measures import measure
from gaitopt.gait.records import GaitRecord, PartRecord, WalkRecord, differing
from gaitopt.gait.trajectory import Ending, Trajectory
from gaitopt.model.modes import Mode
from gaitopt.problem.problem import Problem
from gaitopt.runs.basin import BASIN_FILE
from gaitopt.runs.front import front_file
from gaitopt.runs.jobs import ResultFile, kept_results
from gaitopt.runs.sweep import SWEEP_FILE
from gaitopt.search.find import Gaits, Part, SearchPlan, Task, search
from gaitopt.store.files import Table, csv_text, damaged, validated
from gaitopt.store.folder import (
    BRANCH_FILE,
    BRANCH_TABLE,
    GAIT_FILE,
    MANIFEST_FILE,
    WALK_FILE,
    WALK_FILES,
    begin_branch,
    begin_run,
    branch_folder,
    growing,
    read_branch,
    read_manifest,
    read_problem,
    read_run,
    stored_records,
    write_files,
    writing,
)
from gaitopt.store.gaits import branch_point, freed_values, gait_from_record, special_point, tabulated_steps
from gaitopt.systems import problem_dynamics
from gaitopt.verification.walk import Walk
from gaitopt.workers.jobs import Job, Workers

FILES = {
    "branch": BRANCH_FILE,
    "gait": GAIT_FILE,
    "walk": WALK_FILE,
    "front": front_file("*"),
    "sweep": SWEEP_FILE,
    "basin": BASIN_FILE,
}
"""By which a result is known; of several in one folder the first one counts."""


def kind_of(folder: Path) -> str:
    """What a folder holds, a key of ``FILES``; empty where there is no such folder, or nothing of these in it."""
    try:
        return next((kind for kind, name in FILES.items() if any(folder.glob(name))), "")
    except OSError:  # no name of a folder
        return ""


def refuse_other_results(folder: Path) -> None:
    """Name what a run folder holds that never had a gait.

    Raises
    ------
    StorageError
        If it holds something; of basins and sweeps the message says which folder to give.
    """
    if not (folder / MANIFEST_FILE).is_file() or GAIT_FILE in read_manifest(folder).files:
        return
    others = [f"a {kind}" for kind in ("branch", "walk", "front") if any(folder.glob(FILES[kind]))]
    if others:
        raise StorageError(f"{folder} holds {' and '.join(others)}, but no gait")
    places = sorted(str(file.parent) for name in (BASIN_FILE, SWEEP_FILE) for file in folder.glob(f"*/{name}"))
    if places:
        raise StorageError(f"{folder} holds no gait; give the folder of its basin or sweep: {' or '.join(places)}")


def restore_gait(folder: Path) -> Gait:
    """The gait in a run folder.

    Raises
    ------
    SolveError
        If the run holds a failed attempt.
    """
    (record, table), problem = read_run(folder), read_problem(folder)
    if record.get("status") in [status for status in Status if status is not Status.CONVERGED]:
        raise SolveError(f"{folder} holds no gait: {record.get('status')}, {record.get('message')}")
    path = folder / GAIT_FILE
    validated(GaitRecord, record, path, states=problem.walker.state_names())
    if problem.is_open:
        problem = replace(problem.with_gait(record), origin=problem)
    try:
        dynamics = problem_dynamics(problem).at(freed_values(record))
        periods = [float(step["period"]) for step in record.get("steps", (record,))]
        starts = list(accumulate(periods[:-1], initial=0.0))
        steps = tabulated_steps(dynamics, table, starts, problem.cycle.impacts)
        gait = gait_from_record(problem, dynamics, record, steps, measure(dynamics, steps))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise StorageError(f"{folder}: gait.json or trajectory.csv does not hold a gait ({error!r})") from error
    _check_same(path, record, gait.to_record())
    return gait


def restore_walk(folder: Path) -> Walk:
    """The walk that a run folder holds."""
    record, table = read_run(folder, WALK_FILES)
    problem = read_problem(folder)
    try:
        validated(WalkRecord, record, folder / WALK_FILE, states=problem.walker.state_names())
        dynamics = problem_dynamics(problem).at(record["parameters"])
        system = dynamics.system
        section = record["section"]
        began = [float(point["time"]) for point in section]
        impacts = [Mode(point["impact"]) for point in section[1:]]
        start, *_ = (np.array([point["state"][name] for name in system.state_names]) for point in section)
        gait = [[float(state[name]) for name in system.state_names] for state in record["gait_states"]]
        ending, message = Ending(record["status"]), str(record["message"])
        steps = tabulated_steps(dynamics, table, began, impacts) if table.rows else ()
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise StorageError(f"{folder}: walk.json or walk.csv does not hold a walk ({error!r})") from error
    trajectory = Trajectory(names=system.state_names, start=start, steps=steps, ending=ending, message=message)
    states = np.array(gait).reshape(-1, len(system.state_names))
    walk = Walk(problem=problem, dynamics=dynamics, trajectory=trajectory, gait_states=states)
    _check_same(folder / WALK_FILE, record, walk.to_record())
    return walk


def _check_same(path: Path, record: Mapping[str, Any], restored: Mapping[str, Any]) -> None:
    """Refuse a record that differs from what its table says."""
    key = differing(record, restored)
    if key:
        raise damaged(path, f"{key}: is not what the table beside it gives")


CLOSED = 1e-6
"""Largest difference of the states after the last impact and at the start, in natural units."""


def stored_branch(folder: Path) -> tuple[Problem, str, list[dict[str, Any]]]:
    """Problem, parameter and records of the branch in a run folder, without the request.

    Raises
    ------
    StorageError
        If the folder is not a run, is broken or newer, or its branch has no point.
    """
    problem = read_problem(folder)
    request, records = read_branch(folder, problem)
    if "parameter" not in request or not any(record.get("record") == "point" for record in records):
        raise StorageError(f"{folder / BRANCH_FILE} holds no branch yet; `gaitopt continue` writes one")
    return problem, request["parameter"], records


def _check_closes(point: BranchPoint, path: Path) -> None:
    """Refuse a point whose state and durations are no periodic motion."""
    gait = point.gait
    gap = float(np.abs((gait.steps[-1].final_impact.state - gait.state) / gait.dynamics.state_units).max())
    if not gap < CLOSED * max(1.0, gait.spectral_radius or 0.0):
        raise damaged(path, f"point {point.branch}.{point.index}: its motion is not periodic")


def restore_branch(folder: Path) -> Branch:
    """The branch that a run folder holds."""
    problem, parameter, records = stored_branch(folder)
    family = family_of(problem, parameter)
    try:
        points = tuple(branch_point(family, parameter, record) for record in records if record["record"] == "point")
        for point in points:
            _check_closes(point, folder / BRANCH_FILE)
        specials = (special_point(family, parameter, r) for r in records if r["record"] == "special")
        return Branch(parameter=parameter, points=points, specials=tuple(specials))
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise StorageError(f"{folder / BRANCH_FILE} does not hold a branch ({error!r})") from error


Record = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class BranchRun:
    """A family that is kept in a folder.

    Attributes
    ----------
    problem : of the gait from which it starts.
    request : what is continued.
    start_type : type of the special point from which it starts; empty for a gait.
    output : the folder; by default that of problem and request.
    """

    problem: Problem
    request: Request
    start_type: str = ""
    output: Path | None = None

    @property
    def head(self) -> dict[str, Any]:
        """The first line of the file: the request, and the kind of special point from which it starts."""
        return self.request.to_record() | ({"start": self.start_type} if self.start_type else {})

    @cached_property
    def folder(self) -> Path:
        """The run folder."""
        return self.output or branch_folder(self.problem, self.head)

    def stored(self) -> list[dict[str, Any]]:
        """All records that are on the disk, without the request."""
        return stored_records(self.folder, self.problem, self.head)

    def walk(self, start: Gait | SpecialPoint, *, should_stop: Stop = None) -> tuple[list[Record], Iterator[Record]]:
        """The records that are there, and those to come, each on the disk when it is yielded.

        The folder is held for writing by the caller.
        """
        done = resumable(self.stored(), self.request)
        begin_branch(self.folder, self.problem, self.head, done)
        return done, self._new(start, done, should_stop)

    def _new(self, start: Gait | SpecialPoint, done: list[Record], should_stop: Stop) -> Iterator[Record]:
        with growing(self.folder, BRANCH_FILE) as lines:
            for point in self._found(follow_family(start, self.request, done=done, should_stop=should_stop)):
                record = point.to_record()
                lines.append(record)
                yield record
        if should_stop is not None and should_stop():
            raise KeyboardInterrupt
        _, records = read_branch(self.folder, self.problem)
        header = branch_header(records)
        table = Table(header=tuple(header), rows=branch_rows(records, header))
        write_files(self.folder, {BRANCH_TABLE: csv_text(table)})

    def _found(self, records: Iterator[BranchPoint | SpecialPoint]) -> Iterator[BranchPoint | SpecialPoint]:
        """The records of a walk; stored ones from which it cannot go on are an error that names their file."""
        try:
            yield from records
        except StorageError as error:
            raise StorageError(
                f"{self.folder / BRANCH_FILE}: {error}; delete the folder, or name another one"
            ) from error


PARTS = ResultFile(name="find.jsonl", key="part", model=PartRecord)


def find_durably(
    plan: SearchPlan, folder: Path, workers: Workers, *, progress: Counted = None, should_stop: Stop = None
) -> Gaits:
    """The search of a plan, with its parts kept in a run folder of its problem; errors as of ``kept_results``."""
    states = plan.problem.walker.state_names()

    def run(task: Task, jobs: list[Job]) -> list[Part]:
        results = kept_results(
            task, jobs, workers, folder, PARTS, progress=progress, should_stop=should_stop, states=states
        )
        return [results[job.key] for job in jobs]

    with writing(folder, plan.problem):
        begin_run(folder, plan.problem)
        return search(plan, run, should_stop=should_stop)
