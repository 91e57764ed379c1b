"""A problem as data in the layout of its file, in SI: the inverse of reading it."""

import hashlib
import json
import math
from collections.abc import Mapping
from typing import Any

from gaitopt.mechanics.cycle import Cycle
from gaitopt.problem.control_sections import ConstantTorqueSpec
from gaitopt.problem.initial import OPEN
from gaitopt.problem.parts import OpenSequence
from gaitopt.problem.statement import ProblemStatement


def problem_data(problem: ProblemStatement) -> dict[str, Any]:
    """JSON-able data that would be read as the same problem; a reference stands there by its name.

    Of the guessed state only the section coordinates are given, so that what follows from them does when they change.
    """
    data: dict[str, Any] = {
        "name": problem.name,
        "about": problem.about,
        "walker": {"model": problem.walker.model, **problem.walker.model_dump(mode="json")},
        "friction": problem.friction_data,
        "impact_law": str(problem.impact_law),
        "control": problem.control.model_dump(mode="json", exclude_none=True),
        "gait": _gait_data(problem),
    }
    if isinstance(problem.control, ConstantTorqueSpec):
        data["control"] = {"type": problem.control.type, **problem.control.torques}
    for key, free in problem.free.items():
        group, _, name = key.rpartition(".")
        (data[group] if group else data)[name] = {"free": [free.lower, free.upper], "guess": free.guess}
    if problem.objective:
        data["objective"] = dict(problem.objective)
    if problem.constraints:
        ends = {name: {"min": span.minimum, "max": span.maximum} for name, span in problem.constraints.items()}
        data["constraints"] = {n: {k: v for k, v in own.items() if math.isfinite(v)} for n, own in ends.items()}
    return data


def changed_values(before: Mapping[str, Any], after: Mapping[str, Any], above: str = "") -> list[str]:
    """Dotted keys of what differs between the data of two problems; their names and texts ``about`` do not count."""
    changed = []
    for key in dict.fromkeys([*before, *after]):
        one, other = before.get(key), after.get(key)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            changed += changed_values(one, other, f"{above}{key}.")
        elif one != other and (above or key not in ("name", "about")):
            changed.append(f"{above}{key}")
    return changed


def digest_of(resolved: Mapping[str, Any]) -> str:
    """SHA-256 of resolved data without the texts ``about``."""
    canonical = json.dumps(_without_about(resolved), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def _without_about(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {key: _without_about(value) for key, value in data.items() if key != "about"}
    return data


def _gait_data(problem: ProblemStatement) -> dict[str, Any]:
    if isinstance(problem.modes, OpenSequence):
        data: dict[str, Any] = {"phases": OPEN}
        data |= {} if problem.modes.impact is None else {"impact": str(problem.modes.impact)}
        data |= {} if problem.modes.steps == 1 else {"steps": problem.modes.steps}
        slipping = problem.start is not None and problem.start.state["dx"] != 0
    else:
        data, slipping = cycle_data(problem.modes), problem.modes.impact.slips
    if problem.start is not None:
        names = (*problem.walker.section_names(slipping=slipping), "x")
        data["guess"] = {"state": {name: problem.start.state[name] for name in names}}
        if problem.start.durations is not None:
            data["guess"]["durations"] = list(problem.start.durations)
    return data


def cycle_data(cycle: Cycle) -> dict[str, Any]:
    """Phases and impact of one step, or those of several under ``steps``."""
    steps = [{"phases": [mode.data for mode in step.phases], "impact": str(step.impact)} for step in cycle.steps]
    return steps[0] if len(steps) == 1 else {"steps": steps}
