"""Results in run folders: saved, and loaded again."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gaitopt.errors import GaitoptError
from gaitopt.gait.gait import Gait
from gaitopt.store.run import GAIT_FILES, Run
from gaitopt.verification.walk import Walk, states_after_impacts

if TYPE_CHECKING:
    from gaitopt.runs.results import Result


def save(result: Gait | Walk, path: str | Path | None = None) -> Path:
    """Store a gait or a walk in a run folder, as the command line does.

    Parameters
    ----------
    path : the folder, by default ``results/NAME-HASH``.

    Raises
    ------
    SolveError
        If the gait is a failed solve.
    StorageError
        If the folder belongs to something else or cannot be written.
    """
    from gaitopt.runs.results import write_result

    run = Run.of(result.problem, path)
    try:
        write_result(result, run)
    except GaitoptError as error:
        error.result = result  # it took time to compute, and can still be printed
        raise
    return run.folder


def compared(walk: Walk) -> Walk:
    """The walk of a problem with the gait in the problem's default run folder, if there is one, to compare with."""
    from gaitopt.runs.results import restore_gait

    run = Run.of(walk.problem)
    if len(walk.gait_states) or not run.holds(*GAIT_FILES):
        return walk
    return replace(walk, gait_states=states_after_impacts(restore_gait(run.folder)))


def load_run(path: str | Path) -> "Result":
    """Load the result in a run folder: a branch, gait, walk or front, or the sweep or basin in a folder of its own.

    Raises
    ------
    StorageError
        If the folder is not a run, or is broken, unfinished or newer.
    """
    from gaitopt.runs.results import read_result

    return read_result(Path(path))
