"""A branch that is stored in a run folder, and read back from it."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from gaitopt.branches.request import Request, motionless_gait
from gaitopt.callbacks import Stop
from gaitopt.gait.branch import Branch, BranchPoint, SpecialPoint, branch_table
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import BranchRecord, CheckedPoint, RequestRecord, SpecialRecord
from gaitopt.problem.problem import Problem
from gaitopt.runs.lines import CurveFile, LinesPlan
from gaitopt.store.branch import resumable, stored_continuations
from gaitopt.store.gaits import branch_point, special_point

BRANCH_FILE = "branch.jsonl"
AT_BOUND = 1e-9
"""Relative distance of an end and a bound below which the end is at the bound; continuations end there up to
rounding."""
OLDER_LIMIT = re.compile(r"\d+ points, as many as were allowed|out of time after \d+ s")
"""Reasons that earlier versions stated for ends at a limit of points or time."""


def _fault(problem: Problem, request: RequestRecord, record: BranchRecord) -> str:
    """The fault of a point or special point of a branch, as text; empty if there is none."""
    parameter, value = request["parameter"], record["value"]
    objection = problem.objection(parameter, value) if parameter in problem.parameters else None
    if objection:
        return f"value: {objection}"
    if record["record"] == "point":
        stated = {**record["parameters"]}
        if parameter == "friction" and isinstance(record["friction"], float):
            stated[parameter] = record["friction"]
        if not math.isclose(stated.get(parameter, value), value, rel_tol=AT_BOUND):
            return f"{parameter} is {stated[parameter]:g}, but value is {value:g}"
    return ""


def _completed(request: RequestRecord, records: Sequence[BranchRecord]) -> None:
    """Give ends at a bound the entry ``bound``, and ends at a limit the entry ``open``, which earlier files lack."""
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


BRANCH = CurveFile(
    noun="branch", command="continue", name=BRANCH_FILE, table="branch.csv", number="branch",
    request=RequestRecord, point=CheckedPoint,
    special=SpecialRecord, fault=_fault, rows=branch_table, completed=_completed,
)  # fmt: skip
"""The file of a branch."""


@dataclass(frozen=True, kw_only=True)
class BranchPlan(LinesPlan[Gait | SpecialPoint, BranchRecord]):
    """A branch to be continued, and the run folder in which it is stored.

    Attributes
    ----------
    start_type : type of the special point from which the branch starts; empty if it starts from a gait.
    """

    file: ClassVar[CurveFile] = BRANCH

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


def stored_branch(folder: Path) -> tuple[Problem, str, list[BranchRecord]]:
    """Problem, parameter and records of the branch in a run folder, without the request; see ``CurveFile.stored``."""
    problem, request, records = BRANCH.stored(folder)
    return problem, request["parameter"], records


def restore_branch(folder: Path) -> Branch:
    """The branch in a run folder; raises the errors of ``CurveFile.stored`` and ``CurveFile.restored``."""
    problem, parameter, records = stored_branch(folder)
    family = motionless_gait(problem, parameter)
    makers = (partial(make, family, parameter) for make in (branch_point, special_point))
    points, specials = BRANCH.restored(folder, records, *makers)
    return Branch(parameter=parameter, points=points, specials=specials)
