"""The report of a branch: a diagram over the continued parameter, and every gait of it behind a click."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from gaitopt.figures.branches import OF_EACH_STEP
from gaitopt.figures.film import film
from gaitopt.figures.labels import parameter_of
from gaitopt.figures.motion import motion_from_record
from gaitopt.figures.style import MODE_WORDS
from gaitopt.gait.branch import ends_by_request
from gaitopt.gait.cascade import cascades
from gaitopt.pages.page import numbers, provenance, render, words
from gaitopt.problem import Problem
from gaitopt.study.system import problem_dynamics

Record = Mapping[str, Any]

FRAMES = 30
"""Frames of one step of one point: 200 of them stay well under a megabyte."""
POINTS = 17
"""Chebyshev points of a phase: right to seven digits, which is more than a page can show."""


def branch_report(problem: Problem, parameter: str, records: Sequence[Record]) -> str:
    """HTML of a branch.

    Parameters
    ----------
    problem : the problem that was continued.
    parameter : dotted key of the parameter that was continued.
    records : points and special points, as the continuation wrote them.
    """
    points = [record for record in records if record["record"] == "point" and record["state"] is not None]
    if not points:
        raise ValueError(f"the branch of {problem.name} has no points yet")
    dynamics, shown = problem_dynamics(problem), parameter_of(problem, parameter)
    moved = [dynamics.at({**point["parameters"], parameter: point["value"]}) for point in points]
    motions = (motion_from_record(*pair, name=problem.name, points=POINTS) for pair in zip(moved, points, strict=True))
    films = [film(motion, FRAMES) for motion in motions]
    common = {key: value for key, value in films[0].items() if all(other[key] == value for other in films)}
    gaits = [
        {
            "film": {key: value for key, value in moving.items() if key not in common},
            "branch": point["branch"],
            "value": point["value"],
            **_of_each_step(point),
            **numbers(_without(parameter, point)),
        }
        for point, moving in zip(shown.shown(points), films, strict=True)
    ]
    specials = [_special(record) for record in shown.shown(records) if record["record"] == "special"]
    return render(
        "branch.html",
        title=f"{problem.name} over {shown.label.words}",
        about=problem.about,
        data={
            "common": common,
            "gaits": gaits,
            "specials": specials,
            "cascades": [str(cascade) for cascade in cascades(shown.shown(records))],
            "parameter": asdict(shown.label),
            **words(films, [_without(parameter, point) for point in points]),
        },
        checks=[],
        origins=[provenance(problem, {})],
    )


def _without(parameter: str, point: Record) -> Record:
    """A point whose freed parameters are those besides the one that is continued."""
    return {**point, "parameters": {key: value for key, value in point["parameters"].items() if key != parameter}}


def _special(record: Record) -> dict[str, Any]:
    gait = record.get("gait") or {}
    known = {key: record.get(key) for key in ("branch", "type", "value", "status", "next")}
    reason = record.get("reason", "")
    for mode, written in MODE_WORDS.items():
        reason = reason.replace(mode, written)
    known |= {"reason": reason, "bound": ends_by_request(record)}
    return {**known, **_of_each_step(gait), "scalars": numbers(gait)["scalars"] if gait else {}}


def _of_each_step(record: Mapping[str, Any]) -> dict[str, Any]:
    """Scalars that every step of a cycle has of its own."""
    if "steps" not in record:
        return {}
    return {"steps": {key: [float(f"{step[key]:.9g}") for step in record["steps"]] for key in OF_EACH_STEP}}
