"""The branch in a run folder, as the continuation wrote it."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gaitopt.problem import Problem


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


def stored_branch(run: str) -> "tuple[Problem, str, list[dict[str, Any]]]":
    """Problem, parameter and records of the branch in a run folder."""
    from gaitopt.runs import restore_branch

    return restore_branch.stored_branch(Path(run))
