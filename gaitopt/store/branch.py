"""A branch on disk: JSON lines in a run folder, one durable line per record, and a table for other programs.

The first line is the request. A walk that was killed goes on after its last point; special points found after that are
located again. The branch is then the same as without the kill up to the tolerance of Newton's method, not bit by bit:
the walk goes on from the decimal digits of a gait on a mesh that is set up again.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gaitopt.errors import StorageError
from gaitopt.problem import Problem
from gaitopt.store.folder import check_folder, stored_lines
from gaitopt.store.lines import lines_text
from gaitopt.store.manifest import write_files
from gaitopt.store.run import begin_run, run_folder
from gaitopt.store.text import Table, csv_text

BRANCH_FILE = "branch.jsonl"
BRANCH_TABLE = "branch.csv"
EFFORT = ("max_seconds",)
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
    records = list(stored_lines(folder, BRANCH_FILE))
    if records and _core(records[0]) != _core(request):
        words = ", ".join(f"{key} {value}" for key, value in _core(records[0]).items() if value is not None)
        raise StorageError(
            f"{folder} holds another branch ({words}); it was left alone: delete it, or name another folder"
        ).about("output")
    return records[1:]


def begin_branch(
    folder: Path, problem: Problem, request: Mapping[str, Any], records: Sequence[Mapping[str, Any]]
) -> None:
    """Write the request and the records from which a branch goes on."""
    begin_run(folder, problem)
    write_files(folder, {BRANCH_FILE: lines_text((request, *records))})


def write_branch_table(folder: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write the table of a branch beside it."""
    write_files(folder, {BRANCH_TABLE: csv_text(Table(header=tuple(header), rows=list(rows)))})


def _core(request: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in request.items() if key not in EFFORT}
