"""A branch that is stored in a run folder, and read back from it."""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from gaitopt.branches.request import Request, motionless_gait
from gaitopt.callbacks import Stop
from gaitopt.errors import StorageError
from gaitopt.gait.branch import Branch, BranchPoint, SpecialPoint, branch_table
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import BranchRecord, CheckedPoint, RequestRecord, SpecialRecord
from gaitopt.problem.problem import Problem
from gaitopt.requests import ContinueRequest, entries
from gaitopt.runs.lines import LinesPlan
from gaitopt.store.branch import resumable, stored_continuations
from gaitopt.store.formats import damaged, validated
from gaitopt.store.gaits import branch_point, closing_error, problem_of_record, special_point
from gaitopt.store.run import Run

BRANCH_FILE, BRANCH_TABLE = "branch.jsonl", "branch.csv"
LARGEST_CLOSING_ERROR = 1e-6
"""Largest difference between the states at the start and the end of a cycle, in natural units."""
AT_BOUND = 1e-9
"""An end is at a bound if their relative distance is below this; a continuation ends at bounds up to rounding."""
OLDER_LIMIT = re.compile(r"\d+ points, as many as were allowed|out of time after \d+ s")
"""Reasons that earlier versions stated for ends at a limit of points or time."""
EFFORT = tuple(name for name, entry in entries(ContinueRequest).items() if entry.about.effort)
"""Entries of a request that limit the work of one call and do not change the branch."""


@dataclass(frozen=True, kw_only=True)
class BranchPlan(LinesPlan[Gait | SpecialPoint, BranchRecord]):
    """A branch to be continued, and the run folder in which it is stored.

    Attributes
    ----------
    request : the request of the continuation.
    start_type : type of the special point from which the branch starts; empty if it starts from a gait.
    """

    noun: ClassVar[str] = "branch"
    file: ClassVar[str] = BRANCH_FILE
    table: ClassVar[str] = BRANCH_TABLE
    effort: ClassVar[tuple[str, ...]] = EFFORT

    request: Request
    start_type: str = ""

    @property
    def head(self) -> dict[str, Any]:
        """The request, and the type of the special point from which the branch starts."""
        return self.request.to_record() | ({"start": self.start_type} if self.start_type else {})

    @property
    def name(self) -> str:
        """Parameter, targets, start and doublings."""
        head = self.head
        targets = "_".join(f"{to:g}" for to in head["to"])
        follow = f"doublings{head['doublings']}" if head.get("doublings") else ""
        names = (head["parameter"], self.start_type, follow)
        parameter, start, follow = (re.sub(r"[^0-9A-Za-z.]+", "-", name) for name in names)
        return "-".join(filter(None, (parameter, targets, start, follow)))

    def read(self) -> tuple[Mapping[str, Any] | None, list[BranchRecord]]:
        """See ``LinesPlan``."""
        return read_branch(self.run, self.problem)

    def resumable(self, records: list[BranchRecord]) -> list[BranchRecord]:
        """See ``LinesPlan``."""
        return resumable(records, self.request.exhausted)

    def follow(
        self, start: Gait | SpecialPoint, done: list[BranchRecord], should_stop: Stop
    ) -> Iterable[BranchPoint | SpecialPoint]:
        """See ``LinesPlan``."""
        from gaitopt.branches.continuation import follow_family  # reading a stored branch needs no continuation

        stored = stored_continuations(self.request.first_gait(start), self.request.parameter, done) if done else []
        return follow_family(start, self.request, done=stored, should_stop=should_stop)

    def rows(self, records: list[BranchRecord]) -> tuple[list[str], list[list[Any]]]:
        """See ``LinesPlan``."""
        return branch_table(records)


def stored_branch(folder: Path) -> tuple[Problem, str, list[BranchRecord]]:
    """Problem, parameter and records of the branch in a run folder, without the request.

    If the branch starts from an optimum over open-loop torques, the problem contains these torques.

    Raises
    ------
    StorageError
        If the folder is not a run, is damaged or newer, or if its branch has no point.
    """
    run = Run(folder)
    problem = run.problem()
    request, records = read_branch(run, problem)
    if request is None or not any(record["record"] == "point" for record in records):
        raise StorageError(f"{folder / BRANCH_FILE} contains no branch yet; `gaitopt continue` writes one")
    first: Any = next(record for record in records if record["record"] == "point")
    return problem_of_record(problem, first), request["parameter"], records


def restore_branch(folder: Path) -> Branch:
    """The branch in a run folder.

    Raises
    ------
    StorageError
        See ``stored_branch``; also if the motion of a point is not periodic.
    """
    problem, parameter, records = stored_branch(folder)
    family, path = motionless_gait(problem, parameter), folder / BRANCH_FILE
    points, specials = list[BranchPoint](), list[SpecialPoint]()
    try:
        for record in records:
            if record["record"] == "special":
                specials.append(special_point(family, parameter, record))
                continue
            point = branch_point(family, parameter, record)
            gait = point.gait
            if not closing_error(gait.steps) < LARGEST_CLOSING_ERROR * max(1.0, gait.spectral_radius or 0.0):
                raise damaged(path, f"point {point.branch}.{point.index}: its motion is not periodic")
            points.append(point)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise StorageError(f"{path} does not contain a branch ({error!r})") from error
    return Branch(parameter=parameter, points=tuple(points), specials=tuple(specials))


def read_branch(run: Run, problem: Problem) -> tuple[RequestRecord | None, list[BranchRecord]]:
    """The request of the branch in a run, and its records; None and no records if there is no branch.

    Ends at a bound of the request get the entry ``bound``, and ends at a limit of points or time the entry ``open``,
    which earlier versions did not write.
    """
    path, lines = run.path(BRANCH_FILE), run.lines(BRANCH_FILE)
    if not lines:
        return None, []
    request = validated(RequestRecord, lines[0], path, 1)
    records = [
        _record(line, problem, request["parameter"], path, number) for number, line in enumerate(lines[1:], start=2)
    ]
    first = next((record["value"] for record in records if record["record"] == "point"), None)
    bounds = list[float]()
    if first is not None:  # the default bounds are as far from the first gait as the farthest target
        span, lower, upper = max(abs(to - first) for to in request["to"]), request.get("lower"), request.get("upper")
        bounds = [*request["to"], first - span if lower is None else lower, first + span if upper is None else upper]
    for record in records:
        if record["record"] == "special" and record["type"] == "end":
            if any(math.isclose(record["value"], bound, rel_tol=AT_BOUND) for bound in bounds):
                record["bound"] = True
            if OLDER_LIMIT.fullmatch(record["reason"]):
                record["open"] = True
    return request, records


def _record(line: Mapping[str, Any], problem: Problem, parameter: str, path: Path, number: int) -> BranchRecord:
    """The record of a line, which must be a point or special point of a problem's gaits."""
    model: Any = SpecialRecord if line.get("record") == "special" else CheckedPoint
    record: BranchRecord = validated(model, line, path, number, states=problem.walker.state_names())
    value = record["value"]
    objection = problem.objection(parameter, value) if parameter in problem.parameters else None
    if objection:
        raise damaged(path, f"value: {objection}", number)
    if record["record"] == "point":
        stated = {**record["parameters"]}
        if parameter == "friction" and isinstance(record["friction"], float):
            stated[parameter] = record["friction"]
        if not math.isclose(stated.get(parameter, value), value, rel_tol=AT_BOUND):
            raise damaged(path, f"{parameter} is {stated[parameter]:g}, but value is {value:g}", number)
    return record
