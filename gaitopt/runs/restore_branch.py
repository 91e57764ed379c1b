"""A branch from its run folder, every point a gait again."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gaitopt.errors import StorageError
from gaitopt.families.change import with_cycle
from gaitopt.families.coefficients import with_friction
from gaitopt.families.records import restored_special
from gaitopt.gait import MEASURES, Branch, BranchPoint, Gait, SpecialPoint, Status
from gaitopt.mechanics import Cycle
from gaitopt.problem import Problem
from gaitopt.runs.recorded import recorded_steps
from gaitopt.store import BRANCH_FILE, read_problem, stored_lines
from gaitopt.study.system import problem_dynamics

Record = Mapping[str, Any]
OLDER = {"damping_loss": 0.0}
"""Measures that are not in records from before there were dampers."""


def stored_branch(folder: Path) -> tuple[Problem, str, list[dict[str, Any]]]:
    """Problem, parameter and records of the branch in a run folder, without the request.

    Raises
    ------
    StorageError
        If the folder is not a run, is broken or newer, or its branch has no point.
    """
    problem = read_problem(folder)
    records = list(stored_lines(folder, BRANCH_FILE))
    parameters = {record["parameter"] for record in records if "parameter" in record}
    if len(parameters) != 1 or not any(record.get("record") == "point" for record in records):
        raise StorageError(f"{folder / BRANCH_FILE} holds no branch yet; `gaitopt continue` writes one")
    return problem, parameters.pop(), [record for record in records if record.get("record") != "continuation"]


def restore_branch(folder: Path) -> Branch:
    """The branch that a run folder holds.

    Raises
    ------
    StorageError
        As ``stored_branch``, or if a record is no gait.
    """
    problem, parameter, records = stored_branch(folder)
    stated = Gait(problem=problem, dynamics=problem_dynamics(problem), status=Status.CONVERGED, message="")
    family = with_friction(stated, parameter)
    try:
        points = [_point(family, parameter, record) for record in records if record["record"] == "point"]
        specials = [_special(family, parameter, record) for record in records if record["record"] == "special"]
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise StorageError(f"{folder / BRANCH_FILE} does not hold a branch ({error!r})") from error
    return Branch(parameter=parameter, points=tuple(points), specials=tuple(specials))


def _point(family: Gait, parameter: str, record: Record) -> BranchPoint:
    return BranchPoint(
        branch=record["branch"],
        index=record["index"],
        value=record["value"],
        gait=_gait(family, parameter, record["value"], record),
        tangent=np.array(record["tangent"], dtype=float),
        length=float(record["length"]),
    )


def _special(family: Gait, parameter: str, record: Record) -> SpecialPoint:
    bare = restored_special(family, parameter, {**record, "gait": {}})
    gait = record["gait"]
    return replace(bare, gait=_gait(family, parameter, record["value"], gait) if gait else None)


def _gait(family: Gait, parameter: str, value: float, record: Record) -> Gait:
    """The gait of a record, integrated again from its state; ``family`` has its system."""
    system, problem = family.system, family.problem
    freed = {name: float(number) for name, number in record["parameters"].items()}
    dynamics = family.dynamics.at({**freed, parameter: value})
    state = np.array([record["state"][name] for name in system.state_names])
    return Gait(
        problem=with_cycle(problem.replace({parameter: value}), system, Cycle.from_record(record), state),
        dynamics=dynamics,
        status=Status(record["status"]),
        message=str(record["message"]),
        steps=recorded_steps(dynamics, record),
        multipliers=np.array([complex(m["re"], m["im"]) for m in record["multipliers"]]),
        measures={name: {**OLDER, **record}[name] for name in MEASURES},
        freed=freed,
        solver=dict(record["solver"]),
        verification=record["verification"],
    )
