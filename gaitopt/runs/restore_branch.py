"""A branch from its run folder, every point a gait again."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gaitopt.errors import StorageError
from gaitopt.families.change import with_cycle
from gaitopt.gait import MEASURES, Branch, BranchPoint, Gait, SpecialPoint, Status
from gaitopt.mechanics import Cycle, HybridSystem, Mode, ModeSequence
from gaitopt.problem import FrictionCoefficients, Problem
from gaitopt.runs.recorded import recorded_steps
from gaitopt.store import BRANCH_FILE, read_problem, stored_lines
from gaitopt.study.system import build_system

Record = Mapping[str, Any]


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
    problem = _with_parameter(problem, parameter)
    system = build_system(problem)
    try:
        points = [_point(problem, system, parameter, record) for record in records if record["record"] == "point"]
        specials = [_special(problem, system, parameter, record) for record in records if record["record"] == "special"]
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise StorageError(f"{folder / BRANCH_FILE} does not hold a branch ({error!r})") from error
    return Branch(parameter=parameter, points=tuple(points), specials=tuple(specials))


def _with_parameter(problem: Problem, parameter: str) -> Problem:
    """The problem under the friction law that has the parameter."""
    if parameter.startswith("friction.") and isinstance(problem.friction, float):
        both = FrictionCoefficients(static=problem.friction, kinetic=problem.friction)
        return replace(problem, friction=both)
    if parameter == "friction" and isinstance(problem.friction, FrictionCoefficients):
        return replace(problem, friction=problem.friction.static)
    return problem


def _point(problem: Problem, system: HybridSystem, parameter: str, record: Record) -> BranchPoint:
    return BranchPoint(
        branch=record["branch"],
        index=record["index"],
        value=record["value"],
        gait=_gait(problem, system, parameter, record["value"], record),
        tangent=np.array(record["tangent"], dtype=float),
        length=float(record["length"]),
    )


def _special(problem: Problem, system: HybridSystem, parameter: str, record: Record) -> SpecialPoint:
    gait = record["gait"]
    return SpecialPoint(
        branch=record["branch"],
        type=record["type"],
        value=record["value"],
        status=record["status"],
        reason=record["reason"],
        before=_cycle(record["from"]) if "from" in record else None,
        after=_cycle(record["to"]) if "to" in record else None,
        next=tuple(record["next"]),
        gait=_gait(problem, system, parameter, record["value"], gait) if gait else None,
    )


def _cycle(record: Record) -> Cycle:
    """The modes of a gait's record, or of one side of a change."""
    sequences = []
    for step in record.get("steps", (record,)):
        modes = [phase["mode"] if isinstance(phase, dict) else phase for phase in step["phases"]]
        sequences.append(ModeSequence(tuple(map(Mode, modes)), Mode(step["impact"])))
    return Cycle(tuple(sequences))


def _gait(problem: Problem, system: HybridSystem, parameter: str, value: float, record: Record) -> Gait:
    freed = {name: float(number) for name, number in record["parameters"].items()}
    p = system.values({**problem.parameters, **freed, parameter: value})
    state = np.array([record["state"][name] for name in system.state_names])
    return Gait(
        problem=with_cycle(problem.replace({parameter: value}), system, _cycle(record), state),
        system=system,
        p=p,
        status=Status(record["status"]),
        message=str(record["message"]),
        steps=recorded_steps(system, p, record),
        multipliers=np.array([complex(m["re"], m["im"]) for m in record["multipliers"]]),
        measures={name: record[name] for name in MEASURES},
        freed=freed,
        solver=dict(record["solver"]),
        verification=record["verification"],
    )
