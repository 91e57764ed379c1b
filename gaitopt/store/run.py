"""The run folder: a problem, what it resolves to, its gait and its trajectory, under one hash.

The manifest is written first, so that a folder knows its problem, and the gait last, so that a folder with a gait is
complete. A run that was killed in between is simply written again. A writer holds the folder.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gaitopt.errors import GaitoptError, StorageError
from gaitopt.problem import Problem, restore_problem
from gaitopt.problem.record import digest_of
from gaitopt.store.files import parsed
from gaitopt.store.folder import check_folder, writing
from gaitopt.store.lock import wait_for_writer
from gaitopt.store.manifest import (
    MANIFEST_FILE,
    new_manifest,
    read_manifest,
    read_sealed,
    read_together,
    write_files,
    write_manifest,
)
from gaitopt.store.text import Table, csv_text, json_file, parse_csv, parse_object

RESULTS = Path("results")
"""Where runs go unless the user names a folder."""
PROBLEM_FILE = "problem.yaml"
RESOLVED_FILE = "resolved.json"
TRAJECTORY_FILE = "trajectory.csv"
GAIT_FILE = "gait.json"
WALK_FILE = "walk.json"
GAIT_FILES, WALK_FILES = (GAIT_FILE, TRAJECTORY_FILE), (WALK_FILE, "walk.csv")
"""Record and table of a gait and of a simulated walk."""
LONGEST_NAME = 60
"""Characters of a problem's name that go into its folder's: four bytes each still fit every file system."""


def run_folder(problem: Problem, results: Path = RESULTS) -> Path:
    """Folder of a problem's run, ``results/NAME-HASH8``; no name leads out of ``results``."""
    name = re.sub(r"[^\w.-]+", "-", problem.name)[:LONGEST_NAME].strip(".-") or "problem"
    return results / f"{name}-{problem.digest[:8]}"


def begin_run(folder: Path, problem: Problem) -> Path:
    """Make ``folder`` the run folder of ``problem``: its manifest, the problem verbatim, and what it resolves to."""
    with writing(folder, problem):
        files = dict(read_manifest(folder).files) if (folder / MANIFEST_FILE).exists() else {}
        write_manifest(folder, replace(new_manifest(problem.name, problem.digest), files=files))
        write_files(folder, {PROBLEM_FILE: problem.text, RESOLVED_FILE: json_file(problem.resolved())})
    return folder


def write_run(
    folder: Path, *, problem: Problem, record: Mapping[str, Any], table: Table, files: tuple[str, str] = GAIT_FILES
) -> Path:
    """Write the run of a gait, or replace one of the same problem; a simulated walk stands beside it.

    Parameters
    ----------
    record : the JSON object of the gait or walk.
    table : its states and forces over time.
    files : ``GAIT_FILES`` or ``WALK_FILES``.
    """
    with writing(folder, problem):
        begin_run(folder, problem)
        write_files(folder, {files[1]: csv_text(table), files[0]: json_file(record)})
    return folder


def is_complete(folder: Path) -> bool:
    """Whether a folder holds a gait whose writer got to its end."""
    if not (folder / GAIT_FILE).is_file():
        return False
    return {*GAIT_FILES} <= read_manifest(folder).files.keys()


def read_run(folder: Path, files: tuple[str, str] = GAIT_FILES) -> tuple[dict[str, Any], Table]:
    """The record and the table of the gait in a run folder, or of the walk."""
    manifest = read_manifest(folder)
    wait_for_writer(folder, lambda: (folder / files[0]).is_file())
    if files == GAIT_FILES and not (folder / GAIT_FILE).is_file():
        raise StorageError(f"{folder} is unfinished (no {GAIT_FILE}): solve {manifest.problem} again to complete it")
    record, table = read_together(folder, *files)
    return parsed(parse_object, record, folder / files[0]), parsed(parse_csv, table, folder / files[1])


def read_problem(folder: Path) -> Problem:
    """The problem of a run folder.

    Raises
    ------
    StorageError
        If what it resolves to is no problem, or not that of the manifest.
    """
    resolved = read_object(folder, RESOLVED_FILE)
    text = parsed(str, read_sealed(folder, PROBLEM_FILE), folder / PROBLEM_FILE)
    if digest_of(resolved) != read_manifest(folder).hash:
        raise StorageError(f"{folder / RESOLVED_FILE} does not have the hash of the manifest; the run is broken")
    try:
        problem = replace(restore_problem(resolved), text=text)
    except (GaitoptError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise StorageError(f"{folder / RESOLVED_FILE} holds no problem ({error}); the run is broken") from error
    if problem.digest != read_manifest(folder).hash:
        raise StorageError(f"{folder / RESOLVED_FILE} does not have the hash of the manifest; the run is broken")
    return problem


def read_object(folder: Path, name: str) -> dict[str, Any]:
    """Read a finished file of a run folder that is one JSON object."""
    return parsed(parse_object, read_sealed(folder, name), folder / name)


def find_run(problem: Problem, results: Path = RESULTS) -> Path | None:
    """Folder of the finished run of ``problem``, if there is one."""
    folder = run_folder(problem, results)
    check_folder(folder, problem)
    return folder if (folder / GAIT_FILE).is_file() else None
