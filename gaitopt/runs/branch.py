"""A branch that is kept in a run folder: every record is on the disk before it is used.

The file has one line per point or special point after a first line with the request. A walk that was interrupted
resumes after its last point, from the solution, the tangent, the mesh and the step length that the line of that point
holds with every bit; special points after that point are located again. On the same machine the branch is then the same
bit by bit as without the interruption.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gaitopt.branches.continuation import follow_family, resumable
from gaitopt.branches.request import Request, family_of
from gaitopt.callbacks import Stop
from gaitopt.errors import StorageError
from gaitopt.gait.branch import Branch, BranchPoint, SpecialPoint, branch_header, branch_rows
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import ContinuationRecord, PointRecord, SpecialRecord
from gaitopt.problem.problem import Problem
from gaitopt.store.files import lines_text
from gaitopt.store.formats import Table, csv_text, damaged, validated
from gaitopt.store.gaits import branch_point, special_point
from gaitopt.store.run import Run

Record = Mapping[str, Any]

BRANCH_FILE, BRANCH_TABLE = "branch.jsonl", "branch.csv"
CLOSED = 1e-6
"""Largest difference of the states after the last impact and at the start, in natural units."""
AT_BOUND = 1e-9
"""Relative distance of an end from a bound below which it is at the bound: a walk stops there to rounding."""
OLDER_LIMIT = re.compile(r"\d+ points, as many as were allowed|out of time after \d+ s")
"""Reasons that an earlier version gave for ends at a limit of points or time."""
EFFORT = ("max_points", "max_seconds")
"""Entries of a request that limit the work of one call and do not change the branch."""


@dataclass(frozen=True, kw_only=True)
class BranchPlan:
    """A branch to be continued, and the run folder that keeps it.

    This is no ``Plan`` of jobs: how many points there are, and which branches begin at them, is known only at the end;
    each point starts from the one before; and what resumes is not a set of results but the end of the file, where the
    continuation goes on.

    Attributes
    ----------
    problem : of the gait from which the branch starts.
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
        """The first line of the file: the request, and the type of the special point from which the branch starts."""
        return self.request.to_record() | ({"start": self.start_type} if self.start_type else {})

    @property
    def run(self) -> Run:
        """The run folder; by default named after the gait's, with parameter, targets, start and what is followed."""
        if self.output is not None:
            return Run(self.output)
        head, folder = self.head, Run.of(self.problem).folder
        targets = "_".join(f"{to:g}" for to in head["to"])
        follow = f"doublings{head['doublings']}" if head.get("doublings") else ""
        names = (head["parameter"], self.start_type, follow)
        parameter, start, follow = (re.sub(r"[^0-9A-Za-z.]+", "-", name) for name in names)
        return Run(folder.with_name("-".join(filter(None, (folder.name, parameter, targets, start, follow)))))

    @property
    def folder(self) -> Path:
        """The run folder."""
        return self.run.folder

    def stored(self) -> list[dict[str, Any]]:
        """All records that are on the disk, without the request; empty if there are none.

        Raises
        ------
        StorageError
            If the folder holds something else, or a branch with another request.
        """
        self.run.check(self.problem)
        if not self.run.path(BRANCH_FILE).is_file():
            return []
        known, records = read_branch(self.run, self.problem)
        before, now = ({k: v for k, v in head.items() if k not in EFFORT} for head in (known, self.head))
        if known and before != now:
            words = ", ".join(f"{key} {value}" for key, value in before.items() if value is not None)
            raise StorageError(
                f"{self.folder} holds another branch ({words}); it was left alone: delete it, or name another folder"
            ).concerning("output")
        return records

    def walk(self, start: Gait | SpecialPoint, *, should_stop: Stop = None) -> tuple[list[Record], Iterator[Record]]:
        """The stored records, and the new ones, each of which is on the disk when it is yielded.

        The caller has locked the folder.
        """
        done = resumable(self.stored(), self.request)
        with self.run.begun(self.problem):
            self.run.write({BRANCH_FILE: lines_text((self.head, *done))})
        return done, self._new(start, done, should_stop)

    def _new(self, start: Gait | SpecialPoint, done: list[Record], should_stop: Stop) -> Iterator[Record]:
        with self.run.appending(BRANCH_FILE) as lines:
            points = follow_family(start, self.request, done=done, should_stop=should_stop)
            while True:
                try:
                    point = next(points, None)
                except StorageError as error:  # a stored point from which the walk cannot go on
                    words = f"{self.run.path(BRANCH_FILE)}: {error}; delete the folder, or name another one"
                    raise StorageError(words) from error
                if point is None:
                    break
                record = point.to_record()
                lines.append(record)
                yield record
        if should_stop is not None and should_stop():
            raise KeyboardInterrupt
        _, records = read_branch(self.run, self.problem)
        header = branch_header(records)
        self.run.write({BRANCH_TABLE: csv_text(Table(header=tuple(header), rows=branch_rows(records, header)))})


def stored_branch(folder: Path) -> tuple[Problem, str, list[dict[str, Any]]]:
    """Problem, parameter and records of the branch in a run folder, without the request.

    Raises
    ------
    StorageError
        If the folder is not a run, is broken or newer, or its branch has no point.
    """
    run = Run(folder)
    problem = run.problem()
    request, records = read_branch(run, problem)
    if "parameter" not in request or not any(record.get("record") == "point" for record in records):
        raise StorageError(f"{folder / BRANCH_FILE} holds no branch yet; `gaitopt continue` writes one")
    return problem, request["parameter"], records


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


def _check_closes(point: BranchPoint, path: Path) -> None:
    """Refuse a point whose state and durations are no periodic motion."""
    gait = point.gait
    gap = float(np.abs((gait.steps[-1].final_impact.state - gait.state) / gait.dynamics.state_units).max())
    if not gap < CLOSED * max(1.0, gait.spectral_radius or 0.0):
        raise damaged(path, f"point {point.branch}.{point.index}: its motion is not periodic")


def read_branch(run: Run, problem: Problem) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The request of the branch of a problem in a run, and its records; both empty if there is none.

    An end at a bound of the request has ``bound``, one at a limit of points or time ``open``, also where an earlier
    version has written it without.
    """
    request, *records = _lines(run) or [{}]
    if request:
        validated(ContinuationRecord, request, run.path(BRANCH_FILE), 1)
    for line, record in enumerate(records, start=2):
        _check(record, problem, request["parameter"], run.path(BRANCH_FILE), line)
    bounds = _bounds(request, records)
    for record in records:
        if record.get("type") == "end" and any(math.isclose(record["value"], at, rel_tol=AT_BOUND) for at in bounds):
            record["bound"] = True
        if record.get("type") == "end" and OLDER_LIMIT.fullmatch(record["reason"]):
            record["open"] = True
    return request, records


def _check(record: Mapping[str, Any], problem: Problem, parameter: str, path: Path, line: int) -> None:
    """Refuse a line that is neither a point nor a special point of a problem's gaits."""
    model: Any = SpecialRecord if record.get("record") == "special" else PointRecord
    validated(model, record, path, line, states=problem.walker.state_names())
    objection = problem.objection(parameter, record["value"]) if parameter in problem.parameters else None
    if objection:
        raise damaged(path, f"value: {objection}", line)
    stated = record.get("parameters", {}).get(parameter, record["value"])
    if not math.isclose(stated, record["value"], rel_tol=AT_BOUND):
        raise damaged(path, f"{parameter} is {stated:g}, but value is {record['value']:g}", line)
    friction = record.get("friction") if parameter == "friction" else None
    if isinstance(friction, float) and not math.isclose(friction, record["value"], rel_tol=AT_BOUND):
        raise damaged(path, f"friction is {friction:g}, but value is {record['value']:g}", line)


def _lines(run: Run) -> list[dict[str, Any]]:
    """All lines of the file; read again where a writer has replaced it in the meantime."""
    while True:
        known = run.manifest().files.get(BRANCH_FILE)
        try:
            return list(run.lines(BRANCH_FILE))
        except StorageError:
            if known == run.manifest().files.get(BRANCH_FILE):
                raise


def _bounds(request: Mapping[str, Any], records: Sequence[Mapping[str, Any]]) -> list[float]:
    """Targets and bounds of a request; those that it does not state are as far from the first gait as the targets."""
    first = next((record["value"] for record in records if record.get("record") == "point"), None)
    targets = request.get("to", ())
    if first is None or not targets:
        return []
    span = max(abs(to - first) for to in targets)
    stated = {"lower": first - span, "upper": first + span}
    return [*targets, *(value if request.get(key) is None else request[key] for key, value in stated.items())]
