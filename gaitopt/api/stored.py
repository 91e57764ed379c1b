"""Results to run folders and back."""

from collections.abc import Callable
from pathlib import Path

from gaitopt.errors import SolveError, StorageError
from gaitopt.gait.branch import Branch
from gaitopt.gait.gait import Gait, trajectory_header, trajectory_rows
from gaitopt.runs.basin import Basin, read_basin
from gaitopt.runs.front import Front, read_fronts
from gaitopt.runs.restore import FILES, kind_of, refuse_other_results, restore_branch, restore_gait, restore_walk
from gaitopt.runs.sweep import Sweep, read_sweep
from gaitopt.store.files import Table, wait_for_writer
from gaitopt.store.folder import GAIT_FILES, WALK_FILES, run_folder, write_run
from gaitopt.verification.walk import Walk

Result = Gait | Branch | Walk | Sweep | Basin | Front


def save(result: Gait | Walk, path: str | Path | None = None) -> Path:
    """Store a gait or a walk in a run folder, as the command line does.

    Parameters
    ----------
    path : the folder, by default ``results/NAME-HASH``.

    Raises
    ------
    SolveError
        If the gait is a failed attempt.
    StorageError
        If the folder belongs to something else or cannot be written.
    """
    folder = run_folder(result.problem) if path is None else Path(path)
    if isinstance(result, Walk):
        steps, files = result.trajectory.steps, WALK_FILES
    else:
        steps, files = result.steps, GAIT_FILES
        if not steps:
            raise SolveError(f"{result.problem.name} is {result.status}: only a gait is stored")
    rows = trajectory_rows(result.dynamics, steps)
    table = Table(header=trajectory_header(result.system), rows=rows)
    return write_run(folder, problem=result.problem, record=result.to_record(), table=table, files=files)


def load_run(path: str | Path) -> Result:
    """Read what a run folder holds: a branch, a gait, a walk, a front, or the sweep or basin in a folder of its own.

    Raises
    ------
    StorageError
        If the folder is not a run, or is broken, unfinished or newer.
    """
    folder = Path(path)
    readers: dict[str, Callable[[Path], Result]] = {
        "branch": restore_branch,
        "gait": restore_gait,
        "walk": restore_walk,
        "front": _only_front,
        "sweep": read_sweep,
        "basin": read_basin,
    }
    wait_for_writer(folder, lambda: bool(kind_of(folder)))
    kind = kind_of(folder)
    if kind:
        return readers[kind](folder)
    refuse_other_results(folder)
    raise StorageError(f"{folder} holds no result of gaitopt (none of {', '.join(FILES.values())})")


def _only_front(folder: Path) -> Front:
    front, *others = read_fronts(folder)
    if others:
        raise StorageError(f"{folder} holds {len(others) + 1} fronts, but no gait; `gaitopt plot` draws them")
    return front
