"""The branch in a run folder, as the continuation wrote it, and its special points ``RUN@special.K``."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitopt.errors import StorageError

if TYPE_CHECKING:
    from gaitopt.problem import Problem

SPECIAL = "@special."


def holds(run: str, name: str) -> bool:
    """Whether ``run`` is a folder with a file of this name in it."""
    try:
        return (Path(run) / name).is_file()
    except OSError:  # no name of a folder
        return False


def holds_branch(run: str) -> bool:
    """Whether ``run`` is a folder with a branch in it."""
    from gaitopt.store import BRANCH_FILE

    return holds(run, BRANCH_FILE)


def holds_walk(run: str) -> bool:
    """Whether ``run`` is a folder with a simulated walk, and no gait, in it."""
    from gaitopt.store import GAIT_FILE, WALK_FILE

    return holds(run, WALK_FILE) and not holds(run, GAIT_FILE)


def holds_front(run: str) -> bool:
    """Whether ``run`` is a folder with fronts, and no gait, in it."""
    from gaitopt.runs.front import front_file
    from gaitopt.store import GAIT_FILE
    from gaitopt.store.manifest import MANIFEST_FILE

    return holds(run, MANIFEST_FILE) and any(Path(run).glob(front_file("*"))) and not holds(run, GAIT_FILE)


def stored_branch(run: str, label: str = "") -> "tuple[Problem, str, list[dict[str, Any]]]":
    """Problem, parameter and records of the branch in a run folder; ``label`` begins the words of an error."""
    from gaitopt.runs import restore_branch

    if not holds_branch(run):
        raise StorageError(f"{label}{run} holds no branch; `gaitopt continue` writes one")
    return restore_branch.stored_branch(Path(run))


def special_records(run: str, label: str = "") -> "tuple[Problem, str, list[dict[str, Any]]]":
    """Problem and parameter of a branch, and the records of its special points in the order of the table."""
    problem, parameter, records = stored_branch(run, label)
    return problem, parameter, [record for record in records if record.get("record") == "special"]
