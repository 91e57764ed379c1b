"""The branch in a run folder, as the continuation wrote it, and its special points ``RUN@special.K``."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitopt.errors import StorageError

if TYPE_CHECKING:
    from gaitopt.problem import Problem

SPECIAL = "@special."


def stored_branch(run: str, label: str = "") -> "tuple[Problem, str, list[dict[str, Any]]]":
    """Problem, parameter and records of the branch in a run folder; ``label`` begins the words of an error."""
    from gaitopt.runs import restore_branch
    from gaitopt.runs.within import kind_of

    if kind_of(Path(run)) != "branch":
        raise StorageError(f"{label}{run} holds no branch; `gaitopt continue` writes one")
    return restore_branch.stored_branch(Path(run))


def special_records(run: str, label: str = "") -> "tuple[Problem, str, list[dict[str, Any]]]":
    """Problem and parameter of a branch, and the records of its special points in the order of the table."""
    problem, parameter, records = stored_branch(run, label)
    return problem, parameter, [record for record in records if record.get("record") == "special"]
