"""Who may write into a run folder: one process at a time, for the problem that the folder belongs to.

What a run folder says about itself: format, schema, versions, platform, the hash of its problem, and of every file.

A file is written in three steps: its checksum leaves the manifest, it is replaced, its new checksum enters. A file that
has none there is therefore unfinished.

The run folder: a problem, what it resolves to, its gait and its trajectory, under one hash.

The manifest is written first, so that a folder knows its problem, and the gait last, so that a folder with a gait is
complete. A run that was killed in between is simply written again. A writer holds the folder.

A branch on disk: JSON lines in a run folder, one durable line per record, and a table for other programs.

The first line is the request. A walk that was killed resumes after its last point, from the solution, the tangent, the
mesh and the step length that the line of that point holds, all with every bit; special points found after that are
located again. On the same machine the branch is then the same as without the kill, bit by bit.
"""

import hashlib
import math
import os
import platform
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from gaitopt.errors import GaitoptError, StorageError
from gaitopt.gait.records import ContinuationRecord, PointRecord, SpecialRecord
from gaitopt.problem.problem import Problem, restore_problem
from gaitopt.problem.statement import digest_of
from gaitopt.store.files import (
    LOCK_FILE,
    TEMPORARY_SUFFIX,
    WRITER_FILE,
    FileSum,
    Table,
    check_content,
    clear_leftovers,
    csv_text,
    damaged,
    entries,
    file_sum,
    json_file,
    json_text,
    make_folder,
    only_writer,
    parse_csv,
    parse_object,
    parsed,
    read_bytes,
    reason,
    validated,
    wait_for_writer,
    write_whole,
    written_elsewhere,
)
from gaitopt.store.lines import LineWriter, lines_text, read_lines

MANIFEST_FILE = "manifest.json"
FORMAT = "gaitopt run"
SCHEMA = 2
"""Raised whenever a reader of the previous schema would misread what is written; 2 has checksums."""
CHECKSUM = "checksum"
"""Key of the SHA-256 of the rest of the manifest."""
PACKAGES = ("gaitopt", "casadi", "numpy", "scipy", "pydantic", "ruamel.yaml")
"""Packages on which the numbers of a run depend."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """The contents of ``manifest.json``; ``hash`` is that of the resolved problem with its references.

    ``files`` has the checksums of finished files by their paths within the folder.
    """

    problem: str
    hash: str
    versions: dict[str, str]
    platform: dict[str, str]
    files: dict[str, FileSum] = field(default_factory=dict)
    format: str = FORMAT
    schema: int = SCHEMA

    def to_record(self) -> dict[str, Any]:
        """The manifest as a JSON object, with its own checksum."""
        record = asdict(self)
        return record | {CHECKSUM: _checksum(record)}


def new_manifest(problem: str, digest: str) -> Manifest:
    """State who writes a run of the problem named ``problem`` now; the host is not named."""
    return Manifest(
        problem=problem,
        hash=digest,
        versions=dict(_versions()),
        platform={"system": platform.system(), "machine": platform.machine()},
    )


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write the manifest of a run folder."""
    write_whole(folder / MANIFEST_FILE, json_file(manifest.to_record()))


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a run folder.

    Raises
    ------
    StorageError
        If the folder is not a run, is broken, or was written by a newer gaitopt or by one without checksums.
    """
    path = folder / MANIFEST_FILE
    if not path.is_file():
        raise StorageError(f"{folder} is not a run of gaitopt (it has no {MANIFEST_FILE}); it was left alone")
    record = parsed(parse_object, read_bytes(path), path)
    if record.get("format") != FORMAT:
        raise StorageError(f"{path} is not the manifest of a gaitopt run; the folder was left alone")
    schema = record.get("schema")
    if isinstance(schema, int) and schema > SCHEMA:
        raise StorageError(
            f"{folder} was written by a newer gaitopt (schema {schema}; this one reads up to {SCHEMA}); "
            "it was left alone: update gaitopt to use it"
        )
    if isinstance(schema, int) and schema < SCHEMA:
        raise StorageError(
            f"{folder} was written by an older gaitopt, without checksums (schema {schema}); "
            "it was left alone: delete it, or name another folder"
        ).about("output")
    checksum = record.pop(CHECKSUM, None)
    if checksum != _checksum(record):
        raise StorageError(f"{path}: altered since it was written (SHA-256 differs); the run was left alone")
    return validated(Manifest, record, path)


def write_files(folder: Path, contents: Mapping[str, str]) -> None:
    """Write files of a run folder by their paths within it; they count as unfinished until all of them are written."""
    manifest = read_manifest(folder)
    kept = {name: known for name, known in manifest.files.items() if name not in contents}
    if kept != manifest.files:
        write_manifest(folder, replace(manifest, files=kept))
    for name, content in contents.items():
        write_whole(folder / name, content)
    seal(folder, *contents)


def seal(folder: Path, *names: str) -> None:
    """Enter the checksums of files, as they are now, into the manifest."""
    manifest = read_manifest(folder)
    sums = {name: file_sum(folder / name, read_bytes(folder / name)) for name in names}
    if not sums.items() <= manifest.files.items():
        write_manifest(folder, replace(manifest, files=dict(sorted((manifest.files | sums).items()))))


def read_sealed(folder: Path, name: str) -> bytes:
    """Read a file of a run folder that is as it was written; errors as of ``read_together``."""
    (content,) = read_together(folder, name)
    return content


def read_together(folder: Path, *names: str) -> list[bytes]:
    """Read files of a run folder that are as they were written, all by the same writer.

    Where another process is about to finish one of them, it is waited for.

    Raises
    ------
    StorageError
        If a file is missing, unfinished or altered.
    """
    while True:
        wait_for_writer(folder, lambda: read_manifest(folder).files.keys() >= {*names})
        known = _known(folder, names)
        missing = next((name for name in names if known[name] is None), None)
        if missing is not None and not written_elsewhere(folder):
            there = (folder / missing).exists()
            words = "the run is unfinished: repeat the command that writes it" if there else "missing"
            raise StorageError(f"{folder / missing}: {words}; it was left alone")
        if missing is not None:
            continue
        try:
            contents = [read_bytes(folder / name) for name in names]
            for (name, own), content in zip(known.items(), contents, strict=True):
                check_content(folder / name, content, own)
        except StorageError:
            if known == _known(folder, names):  # no writer has replaced them meanwhile
                raise
        else:
            if known == _known(folder, names):
                return contents


def _known(folder: Path, names: tuple[str, ...]) -> dict[str, Any]:
    """What the manifest says of some files, None where it says nothing."""
    files = read_manifest(folder).files
    return {name: files.get(name) for name in names}


def _checksum(record: dict[str, Any]) -> str:
    return hashlib.sha256(json_text(record).encode()).hexdigest()


@lru_cache(maxsize=1)
def _versions() -> tuple[tuple[str, str], ...]:
    return (("python", platform.python_version()), *((name, version(name)) for name in PACKAGES))


def check_folder(folder: Path, problem: Problem) -> None:
    """Refuse a folder that may not be written for this problem, before anything is computed or written.

    Raises
    ------
    StorageError
        If it holds another problem's run, anything that is not a run, a broken run, or a newer one.
    """
    names = [path.name for path in entries(folder)]
    left = [n for n in names if n.startswith(".") and n.endswith(TEMPORARY_SUFFIX)]  # by a writer that was killed
    if not set(names) - {LOCK_FILE, WRITER_FILE, *left}:
        check_writable(folder)
        return
    manifest = read_manifest(folder)
    if manifest.hash != problem.digest:
        raise StorageError(
            f"{folder} holds another problem ({manifest.problem}, hash {manifest.hash[:8]}, not {problem.name}, "
            f"hash {problem.digest[:8]}); it was left alone: delete it, or name another folder"
        ).about("output")


def check_writable(path: Path) -> None:
    """Refuse a file or folder that cannot be made, before anything is computed for it.

    Raises
    ------
    StorageError
        If the nearest folder above it that exists is none, or may not be written.
    """
    try:
        place = next(place for place in (path.absolute(), *path.absolute().parents) if place.exists())
    except OSError as error:
        raise StorageError(f"cannot write {path}: {reason(error)}; name another place").about("output") from error
    folder = place.parent if place == path.absolute() and place.is_file() else place
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise StorageError(f"cannot write {path}: {folder} is no folder that you may write; name another").about(
            "output"
        )


@contextmanager
def writing(folder: Path, problem: Problem) -> Iterator[None]:
    """Hold the run folder of a problem for writing, made if it is not there; may be nested."""
    check_folder(folder, problem)
    make_folder(folder)
    with only_writer(folder):
        check_folder(folder, problem)  # another process may have been first
        yield


@contextmanager
def growing(folder: Path, name: str) -> Iterator[LineWriter]:
    """Append to a file of records of a run folder; how far it got is entered into the manifest at the end."""
    for _ in stored_lines(folder, name):
        pass  # checks what is there against the manifest
    complete = False
    try:
        with LineWriter(folder / name) as lines:
            yield lines
        complete = True
    except (KeyboardInterrupt, GeneratorExit):
        complete = True
        raise
    finally:
        if complete:
            seal(folder, name)


@contextmanager
def adding(folder: Path, place: Path) -> Iterator[list[Path]]:
    """Add figures or pages to a folder; those in a run folder that are collected in the list have checksums afterwards.

    Parameters
    ----------
    folder : the run folder that they are about.
    place : where they go, made if it is not there: in the run folder, or elsewhere.
    """
    added: list[Path] = []
    if not place.resolve().is_relative_to(folder.resolve()):
        make_folder(place)
        clear_leftovers(place)
        yield added
        return
    with only_writer(folder):
        make_folder(place)
        yield added
        seal(folder, *(path.resolve().relative_to(folder.resolve()).as_posix() for path in added))


def stored_lines(folder: Path, name: str) -> Iterator[dict[str, Any]]:
    """The records of a file of a run folder in order; none if it is not there."""
    known = read_manifest(folder).files.get(name)
    if known is not None or (folder / name).exists():
        yield from read_lines(folder / name, known)


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
