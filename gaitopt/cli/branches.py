"""The branch in a run folder, as the continuation wrote it, and its special points ``RUN@special.K``."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitopt.errors import StorageError

if TYPE_CHECKING:
    from gaitopt.problem import Problem

SPECIAL = "@special."


def holding(run: str) -> str:
    """What ``run`` is a folder of: ``branch``; ``walk`` or ``front`` where it has no gait; else nothing."""
    from gaitopt.runs.front import front_file
    from gaitopt.store import BRANCH_FILE, GAIT_FILE, WALK_FILE
    from gaitopt.store.manifest import MANIFEST_FILE

    folder = Path(run)
    try:
        names = {path.name for path in folder.iterdir()}
    except OSError:  # no folder, or no name of one
        return ""
    if BRANCH_FILE in names:
        return "branch"
    if GAIT_FILE in names:
        return ""
    if WALK_FILE in names:
        return "walk"
    return "front" if MANIFEST_FILE in names and any(folder.glob(front_file("*"))) else ""


def stored_branch(run: str, label: str = "") -> "tuple[Problem, str, list[dict[str, Any]]]":
    """Problem, parameter and records of the branch in a run folder; ``label`` begins the words of an error."""
    from gaitopt.runs import restore_branch

    if holding(run) != "branch":
        raise StorageError(f"{label}{run} holds no branch; `gaitopt continue` writes one")
    return restore_branch.stored_branch(Path(run))


def special_records(run: str, label: str = "") -> "tuple[Problem, str, list[dict[str, Any]]]":
    """Problem and parameter of a branch, and the records of its special points in the order of the table."""
    problem, parameter, records = stored_branch(run, label)
    return problem, parameter, [record for record in records if record.get("record") == "special"]
