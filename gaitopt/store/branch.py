"""A branch on disk: JSON lines in a run folder, one durable line per record, and a table for other programs.

The first line is the request. A walk that was killed resumes after its last point, from the solution, the tangent, the
mesh and the step length that the line of that point holds, all with every bit; special points found after that are
located again. On the same machine the branch is then the same as without the kill, bit by bit.
"""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gaitopt.errors import StorageError
from gaitopt.gait.records import ContinuationRecord, PointRecord, SpecialRecord
from gaitopt.problem import Problem
from gaitopt.store.folder import check_folder, stored_lines
from gaitopt.store.lines import lines_text
from gaitopt.store.manifest import read_manifest, write_files
from gaitopt.store.records import damaged, validated
from gaitopt.store.run import begin_run, run_folder

BRANCH_FILE = "branch.jsonl"
BRANCH_TABLE = "branch.csv"
AT_BOUND = 1e-9
"""Relative distance of an end from a bound below which it is at the bound: a walk stops there to rounding."""
OLDER_LIMIT = re.compile(r"\d+ points, as many as were allowed|out of time after \d+ s")
"""Reasons of an earlier version for ends at a limit of points or time."""
EFFORT = ("max_points", "max_seconds")
"""Entries of a request that do not change what is found, only how much at a time."""


def branch_folder(problem: Problem, request: Mapping[str, Any]) -> Path:
    """Default folder of a branch: that of the problem's gait, with parameter, targets, start and what is followed."""
    targets = "_".join(f"{to:g}" for to in request["to"])
    follow = f"doublings{request['doublings']}" if request.get("doublings") else ""
    names = (request["parameter"], request.get("start", ""), follow)
    parameter, start, follow = (re.sub(r"[^0-9A-Za-z.]+", "-", name) for name in names)
    folder = run_folder(problem)
    return folder.with_name("-".join(part for part in (folder.name, parameter, targets, start, follow) if part))


def stored_records(folder: Path, problem: Problem, request: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The records of a branch that is there already, without the request; empty if there is none.

    Raises
    ------
    StorageError
        If the folder holds something else, or a branch with another request.
    """
    check_folder(folder, problem)
    if not (folder / BRANCH_FILE).is_file():
        return []
    known, records = read_branch(folder, problem)
    if known and _core(known) != _core(request):
        words = ", ".join(f"{key} {value}" for key, value in _core(known).items() if value is not None)
        raise StorageError(
            f"{folder} holds another branch ({words}); it was left alone: delete it, or name another folder"
        ).about("output")
    return records


def read_branch(folder: Path, problem: Problem) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The request of the branch of a problem in a folder, and its records; both empty if there is none.

    An end at a bound of the request has ``bound``, one at a limit of points or time ``open``, also where an earlier
    version has written it without.
    """
    request, *records = _lines(folder) or [{}]
    if request:
        validated(ContinuationRecord, request, folder / BRANCH_FILE, 1)
    for line, record in enumerate(records, start=2):
        _check(record, problem, request["parameter"], folder / BRANCH_FILE, line)
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


def _lines(folder: Path) -> list[dict[str, Any]]:
    """All lines of the file; read again where a writer has replaced it in the meantime."""
    while True:
        known = read_manifest(folder).files.get(BRANCH_FILE)
        try:
            return list(stored_lines(folder, BRANCH_FILE))
        except StorageError:
            if known == read_manifest(folder).files.get(BRANCH_FILE):
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


def begin_branch(
    folder: Path, problem: Problem, request: Mapping[str, Any], records: Sequence[Mapping[str, Any]]
) -> None:
    """Write the request and the records from which a branch resumes."""
    begin_run(folder, problem)
    write_files(folder, {BRANCH_FILE: lines_text((request, *records))})


def _core(request: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in request.items() if key not in EFFORT}
