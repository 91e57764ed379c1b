"""The run folder: a problem, what it resolves to, its gait and its trajectory, under one hash.

The manifest is written first, so that a folder knows its problem, and the gait last, so that a folder with a gait is
complete. A run that was killed in between is simply written again.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gaitopt.errors import StorageError
from gaitopt.problem import Problem, restore_problem
from gaitopt.store.files import TEMPORARY_SUFFIX, make_folder, read_text, reason, write_whole
from gaitopt.store.manifest import MANIFEST_FILE, Manifest, new_manifest, read_manifest
from gaitopt.store.text import Table, csv_text, json_text, parse_csv

RESULTS = Path("results")
"""Where runs go unless the user names a folder."""
PROBLEM_FILE = "problem.yaml"
RESOLVED_FILE = "resolved.json"
TRAJECTORY_FILE = "trajectory.csv"
GAIT_FILE = "gait.json"
WALK_FILE = "walk.json"
WALK_TRAJECTORY_FILE = "walk.csv"
LONGEST_NAME = 60
"""Characters of a problem's name that go into its folder's: four bytes each still fit every file system."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """A run as read back; the store does not interpret the records."""

    folder: Path
    manifest: Manifest
    problem_text: str
    resolved: Mapping[str, Any]
    gait: Mapping[str, Any]
    trajectory: Table


def run_folder(problem: Problem, results: Path = RESULTS) -> Path:
    """Folder of a problem's run, ``results/NAME-HASH8``; no name leads out of ``results``."""
    name = re.sub(r"[^\w.-]+", "-", problem.name)[:LONGEST_NAME].strip(".-") or "problem"
    return results / f"{name}-{problem.digest[:8]}"


def check_folder(folder: Path, problem: Problem) -> None:
    """Refuse a folder that may not be written for this problem, before anything is computed or written.

    Raises
    ------
    StorageError
        If it holds another problem's run, anything that is not a run, a broken run, or a newer one.
    """
    if not _entries(folder):
        return
    manifest = read_manifest(folder)
    if manifest.hash != problem.digest:
        raise StorageError(
            f"{folder} holds another problem ({manifest.problem}, hash {manifest.hash[:8]}, not {problem.name}, "
            f"hash {problem.digest[:8]}); it was left alone: name another folder with -o, or delete this one"
        )


def begin_run(folder: Path, problem: Problem) -> Path:
    """Make ``folder`` the run folder of ``problem``: its manifest, the problem verbatim, and what it resolves to.

    Raises
    ------
    StorageError
        If the folder belongs to something else or cannot be written.
    """
    check_folder(folder, problem)
    make_folder(folder)
    manifest = new_manifest(problem.name, problem.digest).to_record()
    write_whole(folder / MANIFEST_FILE, json_text(manifest, indent=2) + "\n")
    write_whole(folder / PROBLEM_FILE, problem.text)
    write_whole(folder / RESOLVED_FILE, json_text(problem.resolved(), indent=2) + "\n")
    return folder


def write_run(folder: Path, *, problem: Problem, gait: Mapping[str, Any], trajectory: Table) -> Path:
    """Write the run of a gait, or replace one of the same problem.

    Parameters
    ----------
    gait : the JSON object of the gait.
    trajectory : header and rows of ``trajectory.csv``.

    Raises
    ------
    StorageError
        If the folder belongs to something else or cannot be written; the message says what was kept.
    """
    begin_run(folder, problem)
    write_whole(folder / TRAJECTORY_FILE, csv_text(trajectory))
    write_whole(folder / GAIT_FILE, json_text(gait, indent=2) + "\n")
    return folder


def write_walk(folder: Path, *, problem: Problem, walk: Mapping[str, Any], trajectory: Table) -> Path:
    """Write a simulated walk into the run folder of its problem, beside the gait if there is one.

    Parameters and errors are those of ``write_run``.
    """
    begin_run(folder, problem)
    write_whole(folder / WALK_TRAJECTORY_FILE, csv_text(trajectory))
    write_whole(folder / WALK_FILE, json_text(walk, indent=2) + "\n")
    return folder


def read_run(folder: Path) -> Run:
    """Read a run.

    Raises
    ------
    StorageError
        If the folder is not a run, or the run is unfinished, broken or newer.
    """
    manifest = read_manifest(folder)
    if not (folder / GAIT_FILE).is_file():
        raise StorageError(f"{folder} is unfinished (no {GAIT_FILE}): solve {manifest.problem} again to complete it")
    try:
        trajectory = parse_csv(read_text(folder / TRAJECTORY_FILE))
    except ValueError as error:
        raise StorageError(f"{folder / TRAJECTORY_FILE}: {error}; the run is broken and was left alone") from error
    return Run(
        folder=folder,
        manifest=manifest,
        problem_text=read_text(folder / PROBLEM_FILE),
        resolved=read_object(folder / RESOLVED_FILE),
        gait=read_object(folder / GAIT_FILE),
        trajectory=trajectory,
    )


def read_problem(folder: Path) -> Problem:
    """The problem of a run folder, whatever else it holds.

    Raises
    ------
    StorageError
        If the folder is not a run, broken or newer.
    """
    read_manifest(folder)
    resolved, text = read_object(folder / RESOLVED_FILE), read_text(folder / PROBLEM_FILE)
    return replace(restore_problem(resolved), text=text)


def read_object(path: Path) -> dict[str, Any]:
    """Read a file that is one JSON object.

    Raises
    ------
    StorageError
        If it is missing, unreadable or anything else.
    """
    try:
        record = json.loads(read_text(path))
    except ValueError as error:
        raise StorageError(f"{path} is not JSON ({error}); the run is broken and was left alone") from error
    if not isinstance(record, dict):
        raise StorageError(f"{path} is not a JSON object; the run is broken and was left alone")
    return record


def find_run(problem: Problem, results: Path = RESULTS) -> Path | None:
    """Folder of the finished run of ``problem``, if there is one.

    Raises
    ------
    StorageError
        If its place is taken by something else.
    """
    folder = run_folder(problem, results)
    check_folder(folder, problem)
    return folder if (folder / GAIT_FILE).is_file() else None


def _entries(folder: Path) -> list[str]:
    """Names in a folder that may not exist yet, apart from what a killed writer left behind."""
    try:
        names = [path.name for path in folder.iterdir()]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise StorageError(f"cannot use {folder} as a run folder: {reason(error)}; name another with -o") from error
    return [name for name in names if not (name.startswith(".") and name.endswith(TEMPORARY_SUFFIX))]
