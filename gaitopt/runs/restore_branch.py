"""A branch from its run folder, every point a gait again."""

from pathlib import Path
from typing import Any

import numpy as np

from gaitopt.errors import StorageError
from gaitopt.families.records import family_of, recorded_gait, recorded_special
from gaitopt.gait import Branch, BranchPoint, WalkState
from gaitopt.problem import Problem
from gaitopt.store import BRANCH_FILE, read_problem
from gaitopt.store.branch import read_branch
from gaitopt.store.records import damaged

CLOSED = 1e-6
"""Largest difference of the states after the last impact and at the start, in natural units."""


def stored_branch(folder: Path) -> tuple[Problem, str, list[dict[str, Any]]]:
    """Problem, parameter and records of the branch in a run folder, without the request.

    Raises
    ------
    StorageError
        If the folder is not a run, is broken or newer, or its branch has no point.
    """
    problem = read_problem(folder)
    request, records = read_branch(folder, problem)
    if "parameter" not in request or not any(record.get("record") == "point" for record in records):
        raise StorageError(f"{folder / BRANCH_FILE} holds no branch yet; `gaitopt continue` writes one")
    return problem, request["parameter"], records


def _check_closes(point: BranchPoint, path: Path) -> None:
    """Refuse a point whose state and durations are no periodic motion."""
    gait = point.gait
    gap = float(np.abs((gait.steps[-1].final_impact.state - gait.state) / gait.dynamics.state_units).max())
    if not gap < CLOSED * max(1.0, gait.spectral_radius or 0.0):
        raise damaged(path, f"point {point.branch}.{point.index}: its motion is not periodic")


def restore_branch(folder: Path) -> Branch:
    """The branch that a run folder holds."""
    problem, parameter, records = stored_branch(folder)
    family = family_of(problem, parameter)
    try:
        points = tuple(
            BranchPoint(
                branch=record["branch"],
                index=record["index"],
                value=record["value"],
                gait=recorded_gait(family, parameter, record),
                tangent=np.array(record["tangent"], dtype=float),
                length=float(record["length"]),
                walk=WalkState.from_record(record["walk"]) if record.get("walk") else None,
            )
            for record in records
            if record["record"] == "point"
        )
        for point in points:
            _check_closes(point, folder / BRANCH_FILE)
        specials = (recorded_special(family, parameter, r) for r in records if r["record"] == "special")
        return Branch(parameter=parameter, points=points, specials=tuple(specials))
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise StorageError(f"{folder / BRANCH_FILE} does not hold a branch ({error!r})") from error
