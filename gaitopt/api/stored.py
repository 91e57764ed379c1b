"""Results to run folders and back."""

from pathlib import Path

from gaitopt.gait.gait import Gait
from gaitopt.runs.results import Result, read_result, write_result
from gaitopt.store.run import Run
from gaitopt.verification.walk import Walk


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
    run = Run.of(result.problem, path)
    write_result(result, run)
    return run.folder


def load_run(path: str | Path) -> Result:
    """Read what a run folder holds: a branch, a gait, a walk, a front, or the sweep or basin in a folder of its own.

    Raises
    ------
    StorageError
        If the folder is not a run, or is broken, unfinished or newer.
    """
    return read_result(Path(path))
