"""The branch in a run folder, as the continuation wrote it, and its special points."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gaitopt.gait import SpecialPoint
    from gaitopt.problem import Problem

SPECIAL = "@special."


def holds_branch(run: str) -> bool:
    """Whether ``run`` is a folder with a branch in it."""
    from gaitopt.store import BRANCH_FILE

    try:
        return (Path(run) / BRANCH_FILE).is_file()
    except OSError:  # no name of a folder
        return False


def holds_walk(run: str) -> bool:
    """Whether ``run`` is a folder with a simulated walk, and no gait, in it."""
    from gaitopt.store import GAIT_FILE, WALK_FILE

    try:
        return (Path(run) / WALK_FILE).is_file() and not (Path(run) / GAIT_FILE).is_file()
    except OSError:  # no name of a folder
        return False


def holds_front(run: str) -> bool:
    """Whether ``run`` is a folder with fronts, and no gait, in it."""
    from gaitopt.runs.front import front_file
    from gaitopt.store import GAIT_FILE

    folder = Path(run)
    try:
        return any(folder.glob(front_file("*"))) and not (folder / GAIT_FILE).is_file()
    except OSError:  # no name of a folder
        return False


def stored_branch(run: str) -> "tuple[Problem, str, list[dict[str, Any]]]":
    """Problem, parameter and records of the branch in a run folder."""
    from gaitopt.runs import restore_branch

    return restore_branch.stored_branch(Path(run))


def stored_special(place: str) -> "SpecialPoint":
    """The special point RUN@special.K: the K-th of the branch in a run folder, from 0, in the order of the table.

    Raises
    ------
    StorageError
        If the folder holds no branch, or the branch has no such special point.
    """
    from gaitopt.errors import StorageError
    from gaitopt.runs.restore_special import restore_special

    run, _, index = place.rpartition(SPECIAL)
    if not holds_branch(run):
        raise StorageError(f"{place}: {run} holds no branch; `gaitopt continue` writes one")
    problem, parameter, records = stored_branch(run)
    specials = [record for record in records if record.get("record") == "special"]
    if not index.isdecimal() or int(index) >= len(specials):
        known = f"0 to {len(specials) - 1}" if specials else "none"
        raise StorageError(f"{place}: the special points of this branch are {known}, in the order of the table")
    return restore_special(problem, parameter, specials[int(index)])
