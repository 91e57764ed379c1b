"""A gait that is known as the first guess of a problem: of a run, of a point of a branch, of a neighbour in a grid."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from gaitopt.model.modes import Mode
from gaitopt.problem.problem import Problem
from gaitopt.problem.schema import CurveReference, PDSpec


def guessed_from(problem: Problem, record: Mapping[str, Any], known: Mapping[str, float]) -> Problem:
    """The problem with a gait as its guess: state, durations where the phases are the same, and what is unknown.

    Of a gait with another kind of impact the slip velocity is not taken.

    Parameters
    ----------
    record : of a gait of the same walker model, as ``Gait.to_record``.
    known : parameters of that gait by dotted key, control points of a curve as ``control.reference.JOINT.K``.
    """
    names = problem.walker.section_names(slipping=problem.cycle.impact.slips)
    alike = record["impact"] == problem.cycle.impact
    changes: dict[str, object] = {
        f"gait.guess.state.{name}": record["state"][name] for name in names if alike or name != "dx"
    }
    if [Mode.from_record(phase) for phase in record["phases"]] == list(problem.cycle.phases):
        changes["gait.guess.durations"] = [phase["duration"] for phase in record["phases"]]
    points = _control_points(problem, known)
    changes |= {"control.reference.curve.points": points} if points else {}
    return problem.replace(changes | free_guesses(problem, known))


def free_guesses(problem: Problem, known: Mapping[str, float]) -> dict[str, object]:
    """Changes of a problem that guess its free numbers by known values, within their ranges."""
    return {
        key: {"free": [free.lower, free.upper], "guess": float(np.clip(known[key], free.lower, free.upper))}
        for key, free in problem.free.items()
        if key in known
    }


def _control_points(problem: Problem, known: Mapping[str, float]) -> dict[str, list[float]]:
    """Control points of a free curve, within its bound, where the gait has as many; empty otherwise."""
    if not isinstance(problem.control, PDSpec) or not isinstance(problem.control.reference, CurveReference):
        return {}
    curve = problem.control.reference.curve
    keys = {name: [f"control.reference.{name}.{k}" for k in range(curve.degree + 1)] for name in problem.walker.tracked}
    if not all(key in known for row in keys.values() for key in row):
        return {}
    return {
        name: [float(np.clip(known[key], -curve.within, curve.within)) for key in row] for name, row in keys.items()
    }
