"""Results in run folders: how they are saved, and loaded again as a whole or in part."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from gaitopt.branches.request import motionless_gait
from gaitopt.errors import GaitoptError, ProblemError, StorageError, UnknownNameError
from gaitopt.gait.branch import BranchPoint, SpecialPoint
from gaitopt.gait.gait import Attractor, Gait
from gaitopt.gait.trace import CurveStart
from gaitopt.problem.faults import shown
from gaitopt.problem.problem import Controls, Problem, Walkers, passing
from gaitopt.problem.source import SUFFIXES
from gaitopt.problem.writing import problem_yaml
from gaitopt.store.files import check_file, make_folder, write_whole
from gaitopt.store.formats import json_file
from gaitopt.store.gaits import branch_point, special_point
from gaitopt.store.run import GAIT_FILE, GAIT_FILES, PROBLEM_FILES, Run
from gaitopt.verification.walk import Walk, states_after_impacts

if TYPE_CHECKING:
    from gaitopt.engines.replay import Replay
    from gaitopt.gait.records import BranchRecord
    from gaitopt.runs.results import Result

Element = TypeVar("Element")
SPECIAL, ATTRACTOR = "@special.", "@attractor."
"""Texts between a run folder and the number of a special point of its branch, or of an attractor of its basin."""
BEST_FILE = "best.json"
"""Name of the file with the point where a failed design ended."""
REPLAY = "replay-"
"""Names of files with replays start with this text; the name of the engine follows."""


def save(result: Gait | Walk, path: str | Path | None = None) -> Path:
    """Store a gait or a walk in a run folder, like the command line.

    Parameters
    ----------
    path : the folder, by default ``results/NAME-HASH``.

    Raises
    ------
    SolveError
        If the gait is a failed solve.
    StorageError
        If the folder contains other files or cannot be written.
    """
    from gaitopt.runs.results import write_result

    run = Run.of(result.problem, path)
    try:
        write_result(result, run)
    except GaitoptError as error:
        error.result = result  # the caller can still print it
        raise
    return run.folder


def save_best_point(gait: Gait, folder: Path) -> None:
    """Store the point where a failed design ended in its run folder; ``--start`` continues the design from there."""
    run = Run(folder)
    with run.begun(gait.problem):
        run.write({BEST_FILE: json_file(dict(gait.best or {}))})


def best_point_in(folder: Path) -> dict[str, Any] | None:
    """The point where a failed design ended; None if the run folder has a gait or no such point."""
    run = Run(folder)
    return run.read_object(BEST_FILE) if run.holds(BEST_FILE) and not run.holds(GAIT_FILE) else None


def check_problem_file(path: str | Path) -> Path:
    """The path of a new problem file, checked before anything is computed for it.

    Raises
    ------
    StorageError
        If the path does not end in ``.yaml``, exists already, or cannot be written.
    """
    file = Path(path)
    if file.suffix not in SUFFIXES:
        raise StorageError(f"cannot write {file}: give the name of a .yaml file").concerning("output")
    if file.exists():
        raise StorageError(f"cannot write {file}: it exists; choose another name").concerning("output")
    check_file(file)
    return file


def write_problem_file(problem: Problem, file: Path) -> None:
    """Write a problem as a new file, and the robots and tables that it names into the same folder.

    Raises
    ------
    StorageError
        If a file cannot be written, or if a file with the name of a robot or a table has other content.
    """
    text, files = problem_yaml(problem)
    make_folder(file.parent)
    for name, content in files.items():
        beside = file.parent / name
        if beside.exists() and beside.read_text(encoding="utf-8") != content:
            raise StorageError(f"cannot write {beside}: it exists with other content").concerning("output")
        write_whole(beside, content)
    write_whole(file, text)


def save_replays(replays: "Sequence[Replay]", gait: Gait, folder: Path) -> Path:
    """Store the replays of a gait in one engine in the run folder of its problem; returns the file."""
    run, file = Run.of(gait.problem, folder), replay_file(folder, replays[0].engine)
    with run.begun(gait.problem):
        run.write({file.name: json_file({"replays": [replay.to_record() for replay in replays]})})
    return file


def replay_file(folder: Path, engine: str) -> Path:
    """The file with the replays of one engine in a run folder."""
    return folder / f"{REPLAY}{engine}.json"


def stored_replays(folder: Path) -> list[dict[str, Any]]:
    """The records of all replays in a run folder."""
    files = sorted(folder.glob(f"{REPLAY}*.json"))
    return [record for file in files for record in Run(folder).read_object(file.name)["replays"]]


def stored_gait(problem: Problem, path: str | Path | None = None) -> Gait | None:
    """The gait in the run folder of a problem, None if it has not been solved yet.

    Raises
    ------
    StorageError
        If the folder contains other files or is damaged.
    """
    from gaitopt.runs.results import restore_gait

    run = Run.of(problem, path)
    run.check(problem)
    return restore_gait(run.folder) if run.holds(*GAIT_FILES, *PROBLEM_FILES) else None


def stored_gait_record(problem: Problem) -> dict[str, Any]:
    """The JSON object of the gait in the default run folder of a problem; empty if there is none that can be read.

    Damaged runs raise no error here; functions that need the gait report them.
    """
    run = Run.of(problem)
    try:
        run.check(problem)
        return run.read_object(GAIT_FILE) if run.path(GAIT_FILE).is_file() else {}
    except StorageError:
        return {}


def compared(walk: Walk) -> Walk:
    """A walk with the states of the gait in the default run folder of its problem, if there is one, for comparison."""
    from gaitopt.runs.results import restore_gait

    run = Run.of(walk.problem)
    if len(walk.gait_states) or not run.holds(*GAIT_FILES):
        return walk
    return replace(walk, gait_states=states_after_impacts(restore_gait(run.folder)))


def load_run(
    path: str | Path, *, walkers: Walkers = (), controls: Controls = ()
) -> "Result | BranchPoint | SpecialPoint | Attractor":
    """Load the result in a run folder: a branch, gait, walk or front, or the sweep or basin in its own folder.

    Parameters
    ----------
    path : the folder, or an element of the result in it: ``RUN@BRANCH.INDEX`` is a point of a branch, ``RUN@special.K``
        its K-th special point and ``RUN@attractor.K`` the K-th attractor of a basin, both counted from 0. The rest of
        the branch is not restored then.
    walkers, controls : classes of the run's walker and control law, if they are not registered.

    Raises
    ------
    StorageError
        If the folder is not a run, or is damaged, unfinished, or written by a newer version.
    UnknownNameError
        If the result has no such element.
    ProblemError
        If a class is invalid.
    """
    with passing(walkers, controls):
        return _loaded(path)


def _loaded(path: str | Path) -> "Result | BranchPoint | SpecialPoint | Attractor":
    from gaitopt.runs.results import read_result

    if not is_element(path):
        return read_result(Path(path))
    if SPECIAL in str(path):
        return load_special_point(str(path))[0]
    if ATTRACTOR in str(path):
        return load_attractor(str(path))
    return load_branch_point(str(path))


def is_element(path: str | Path) -> bool:
    """Whether a path is the name of an element of a result, such as ``RUN@special.0``."""
    try:
        return "@" in str(path) and not Path(path).exists()
    except OSError:  # for example, the name is too long
        return True


def problem_of_element(path: str | Path) -> Problem:
    """The problem of the gait at a point or a special point of a branch, or of an attractor of a basin.

    It has the parameters, the mode sequence and the motion of that gait.

    Raises
    ------
    GaitoptError
        If there is no such element, see ``load_run``, or no gait there.
    """
    from gaitopt.search.solve import solve_attractor

    element = _loaded(path)
    gait = solve_attractor(element) if isinstance(element, Attractor) else getattr(element, "gait", None)
    if not isinstance(gait, Gait) or not gait.converged:
        raise UnknownNameError(f"{path}: there is no gait from which to start")
    return gait.problem.with_gait(gait.to_record())


def load_records(path: str | Path) -> list[dict[str, Any]]:
    """Load the result in a run folder as JSON objects, with the keys of the command line, without motions.

    Returns
    -------
    records : for a branch its request (``record: "continuation"``, with ``parameter`` and targets ``to``), then its
        points and special points in order; for other results one object.

    Raises
    ------
    StorageError
        See ``load_run``.
    """
    from gaitopt.runs.branch import BRANCH
    from gaitopt.runs.results import KINDS, kind_of, refuse_other_results
    from gaitopt.runs.trace import TRACE

    folder = Path(path)
    kind = kind_of(folder)
    if kind in ("branch", "trace"):
        file = BRANCH if kind == "branch" else TRACE
        request, records = file.read(Run(folder), Run(folder).problem())
        return [dict(record) for record in (request, *records) if record is not None]
    if not kind:
        refuse_other_results(folder)
        raise StorageError(f"{folder} contains no gaitopt result")
    return [Run.at(folder).read_object(file.name) for file in sorted(folder.glob(KINDS[kind][0]))]


def branch_records(run: str | Path, label: str = "") -> tuple[Problem, str, "list[BranchRecord]"]:
    """Problem, parameter and records of the branch in a run folder; error messages begin with ``label``."""
    from gaitopt.runs.branch import stored_branch
    from gaitopt.runs.results import kind_of

    if kind_of(Path(run)) != "branch":
        raise StorageError(f"{label}{run} contains no branch; `gaitopt continue` writes one")
    return stored_branch(Path(run))


def load_special_point(address: str) -> tuple[SpecialPoint, str]:
    """The special point ``RUN@special.K``, and the parameter of its branch."""
    run, _, index = address.rpartition(SPECIAL)
    problem, parameter, records = branch_records(run, f"{address}: ")
    fault = f"{run} has no special point {shown(index)}: the special points of its branch are"
    special = _element([r for r in records if r["record"] == "special"], index, fault, ", in the order of the table")
    return special_point(motionless_gait(problem, parameter), parameter, special), parameter


def _element(elements: Sequence[Element], index: str, fault: str, suffix: str = "") -> Element:
    """The element with an index, which counts from 0; the error is ``fault``, the known indices and ``suffix``.

    Raises
    ------
    UnknownNameError
        If there is no such element.
    """
    if index not in map(str, range(len(elements))):
        raise UnknownNameError(f"{fault} {f'0 to {len(elements) - 1}' if elements else 'none'}{suffix}")
    return elements[int(index)]


def load_curve_start(address: str) -> SpecialPoint | CurveStart:
    """The start of a trace at ``RUN@special.K``: a special point of a branch, or a curve that begins at one of a trace.

    If several curves begin there, ``RUN@special.K.N`` is the N-th one, from 0; N is 0 by default.

    Raises
    ------
    UnknownNameError
        If there is no such special point, or no such curve.
    ProblemError
        If no other curve begins at a special point of a trace.
    """
    from gaitopt.runs.results import kind_of
    from gaitopt.runs.trace import restore_trace

    run, at, index = address.rpartition(SPECIAL)
    if not at:
        raise UnknownNameError(
            f"{address} is not a special point: write RUN@special.K, from 0 in the order of the table"
        )
    if kind_of(Path(run)) != "trace":
        return load_special_point(address)[0]
    index, dot, number = index.partition(".")
    fault = f"{run} has no special point {shown(index)}: those of its trace are"
    special = _element(restore_trace(Path(run)).specials, index, fault)
    if not special.next:
        raise ProblemError(f"{address}: no other curve begins at a special point of type {special.type}")
    conditions = ", ".join(start.condition for start in special.next)
    fault = f"{run}{at}{index} has no curve {shown(number)}: the curves that begin there are"
    return _element(special.next, number if dot else "0", fault, f" ({conditions})")


def load_branch_point(address: str, label: str = "") -> BranchPoint:
    """The point ``RUN@BRANCH.INDEX`` of a branch; error messages begin with ``label``."""
    run, _, number = address.rpartition("@")
    problem, parameter, records = branch_records(run, f"{label}{address}: ")
    points = {f"{r['branch']}.{r['index']}": r for r in records if r["record"] == "point"}
    if number not in points:
        raise UnknownNameError(
            f"{label}{address}: the branch has no point {number}; its points are {next(iter(points))} to "
            f"{list(points)[-1]}, in columns branch and index of branch.csv"
        )
    return branch_point(motionless_gait(problem, parameter), parameter, points[number])


def load_attractor(address: str) -> Attractor:
    """The attractor ``RUN@attractor.K`` of a basin."""
    from gaitopt.runs.basin import read_basin

    run, _, index = address.rpartition(ATTRACTOR)
    fault = f"{Path(run)}@attractor.{index}: the attractors of this basin are"
    return _element(read_basin(Path(run)).attractors, index, fault)
