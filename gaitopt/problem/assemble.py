"""From the data of a file, or of a file with overrides, to the fields of a problem; all faults are collected.

Numbers that are unknowns, ``{free: [lo, hi], guess: x}``, are validated three times by the very model of their
section: guess, lower and upper bound in the place of the number.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel

from gaitopt.errors import ProblemError
from gaitopt.mechanics.consistency import check_walker
from gaitopt.mechanics.control.reference import BeyondEnd
from gaitopt.mechanics.cycle import Cycle
from gaitopt.mechanics.registry import refused_walkers
from gaitopt.mechanics.walker import Walker
from gaitopt.problem.control_sections import (
    ConstantTorqueSpec,
    ControlSpec,
    Curve,
    CurveReference,
    GaitReference,
    NoControlSpec,
    PDSpec,
    torques_section,
)
from gaitopt.problem.demands import Scope, check_unknowns, read_constraints, read_objective
from gaitopt.problem.faults import Fault, Key, near_miss, read_section, shown
from gaitopt.problem.initial import read_gait
from gaitopt.problem.parts import Free
from gaitopt.problem.sections import SECTION_KEYS, FreeSection, FrictionCoefficients, HeadSection

Model = TypeVar("Model", bound=BaseModel)

CONTROLS = ("none", "constant_torque", "pd")
UNREAD = Free(lower=math.nan, upper=math.nan, guess=math.nan)
"""Stands for an unknown that has faults of its own, so that its name stays known."""


def assemble(data: Mapping[str, Any], walkers: Mapping[str, type[Walker]], faults: list[Fault]) -> dict[str, Any]:
    """The fields of a problem that its own data determine; they are meaningful only if no fault was added."""
    free: dict[str, Free] = {}
    model = _find_model(data, walkers, faults)
    walker = None if model is None else _read_walker(model, data["walker"], free, faults)
    head = _read_head(data, free, faults)
    several = _has_coefficients(data)
    friction = (
        _read_parameters(FrictionCoefficients, data["friction"], ("friction",), free, faults) if several else None
    )
    control = _read_control(data.get("control", {"type": "none"}), model, free, faults)
    modes, guess = read_gait(data, model, walker, faults)
    fields: dict[str, Any] = {"walker": walker, "control": control, "modes": modes, "start": guess, "free": free}
    if head:
        fields |= {key: getattr(head, key) for key in HeadSection.model_fields}
    if friction:
        fields["friction"] = friction
    if model:
        cycle = modes if isinstance(modes, Cycle) else None
        scope = Scope(walker=model, control=control, cycle=cycle, free=free)
        objective = read_objective(data.get("objective"), scope, faults)
        constraints = read_constraints(data.get("constraints"), scope, faults)
        if not faults:
            check_unknowns(scope, objective, constraints, faults)
        fields |= {"objective": objective, "constraints": constraints}
    return fields


def _read_head(data: Mapping[str, Any], free: dict[str, Free], faults: list[Fault]) -> HeadSection | None:
    known = (*HeadSection.model_fields, *SECTION_KEYS)
    for key in data:
        if key not in known:
            faults.append(Fault((key,), f"unknown key{near_miss(key, known)}"))
    faults += [Fault((key,), "is missing") for key in ("walker", "gait") if key not in data]
    own = {key: value for key, value in data.items() if key in HeadSection.model_fields}
    if _has_coefficients(data):
        own["friction"] = 0.0  # read by itself
    return _read_parameters(HeadSection, own, (), free, faults)


def _has_coefficients(data: Mapping[str, Any]) -> bool:
    """Whether friction is given by several coefficients, not by a number or an unknown."""
    return isinstance(data.get("friction"), Mapping) and not _is_free(data["friction"])


def _find_model(
    data: Mapping[str, Any], walkers: Mapping[str, type[Walker]], faults: list[Fault]
) -> type[Walker] | None:
    if "walker" not in data:
        return None
    section = data["walker"]
    if not isinstance(section, Mapping):
        message = f"{shown(section)} stands where a mapping belongs: model, and the model's parameters"
        faults.append(Fault(("walker",), message))
        return None
    name = section.get("model")
    if isinstance(name, str) and name in walkers:
        return walkers[name]
    if isinstance(name, str) and name in refused_walkers():
        faults.append(Fault(("walker", "model"), refused_walkers()[name]))
        return None
    wrong = f"no walker is called {shown(name)}" if "model" in section else "is missing"
    faults.append(Fault(("walker", "model"), f"{wrong}{near_miss(name, tuple(walkers))}"))
    return None


def _read_walker(
    model: type[Walker], section: Mapping[str, Any], free: dict[str, Free], faults: list[Fault]
) -> Walker | None:
    parameters = {key: value for key, value in section.items() if key != "model"}
    walker = _read_parameters(model, parameters, ("walker",), free, faults)
    if walker is None:
        return None
    try:
        check_walker(walker)
    except ProblemError as error:
        faults.append(Fault(("walker",), str(error)))
        return None
    return walker


def _read_control(
    data: object, walker: type[Walker] | None, free: dict[str, Free], faults: list[Fault]
) -> ControlSpec | None:
    path: Key = ("control",)
    if not isinstance(data, Mapping) or "type" not in data:
        faults.append(Fault((*path, "type"), f"is missing; allowed: {', '.join(CONTROLS)}"))
        return None
    kind = data["type"]
    if kind not in CONTROLS:
        faults.append(Fault((*path, "type"), f"no control law is called {shown(kind)}{near_miss(kind, CONTROLS)}"))
        return None
    if kind == "none":
        return read_section(NoControlSpec, data, path, faults)
    if walker is not None and not walker.actuators:
        message = f"{walker.model} has no actuators, so that {kind} has nothing to act on; allowed: none"
        faults.append(Fault((*path, "type"), message))
        return None
    if kind == "pd":
        law = _read_parameters(PDSpec, _with_reference(data, faults), path, free, faults)
        if walker is not None and law is not None and isinstance(law.reference, CurveReference):
            faults += _point_faults(law.reference.curve, walker)
        return law
    if walker is None:
        return None
    torques = _read_parameters(torques_section(walker), data, path, free, faults)
    return None if torques is None else ConstantTorqueSpec(torques=torques.model_dump(exclude={"type"}))


def _with_reference(data: Mapping[str, Any], faults: list[Fault]) -> dict[str, Any]:
    """The data of a PD law with its reference read; where that failed another one stands in, to check the rest."""
    reference = data.get("reference")
    path: Key = ("control", "reference")
    if "reference" not in data:
        return dict(data)
    read: GaitReference | CurveReference | None
    if isinstance(reference, Mapping) and "curve" in reference:
        curve = read_section(Curve, reference["curve"], (*path, "curve"), faults)
        stand_in = curve or Curve.model_construct(degree=1, start="")
        read = read_section(CurveReference, {**reference, "curve": stand_in}, path, faults)
    else:
        read = read_section(GaitReference, reference, path, faults)
    return {**data, "reference": read or GaitReference.model_construct(gait="", beyond_end=BeyondEnd.HOLD)}


def _point_faults(curve: Curve, walker: type[Walker]) -> Iterator[Fault]:
    """Whether the control points are those of the walker's tracked joints, as many as the degree takes, in bounds."""
    if curve.points is None:
        return
    path: Key = ("control", "reference", "curve", "points")
    if set(curve.points) != set(walker.tracked):
        tracked = ", ".join(walker.tracked)
        yield Fault(path, f"are given for {', '.join(curve.points) or 'no joint'}; the tracked joints are {tracked}")
        return
    for name, points in curve.points.items():
        if len(points) != curve.degree + 1:
            message = f"{len(points)} control points, but a curve of degree {curve.degree} has {curve.degree + 1}"
            yield Fault((*path, name), message)
        yield from (
            Fault((*path, name, k), f"{point:g} is outside of within = {curve.within:g}")
            for k, point in enumerate(points)
            if abs(point) > curve.within
        )


def _read_parameters(
    model: type[Model], data: Mapping[str, Any], path: Key, free: dict[str, Free], faults: list[Fault]
) -> Model | None:
    """A section in which numbers may be free; a freed number has its guess."""
    freed = {key: data[key] for key in model.model_fields if _is_free(data.get(key))}
    free |= {_dotted_key(path, key): UNREAD for key in freed}
    parts = {key: read_section(FreeSection, value, (*path, key), faults) for key, value in freed.items()}
    unknowns = {key: part for key, part in parts.items() if part is not None}
    own: list[Fault] = []
    plain = {**data, **{key: part.guess for key, part in unknowns.items()}}
    section = read_section(model, plain, path, own)
    for fault in own:
        key = fault.path[len(path)] if len(fault.path) > len(path) else None
        if key in unknowns:
            faults.append(Fault((*fault.path, "guess"), fault.message))
        elif key not in freed:  # what is wrong with the mapping of an unknown has been said
            faults.append(fault)
    if section is None:
        return None
    for name, part in unknowns.items():
        span = _read_bounds(model, section, plain, part, (*path, name), faults)
        if span is not None:
            free[_dotted_key(path, name)] = span
    return section


def _is_free(value: object) -> bool:
    return isinstance(value, Mapping) and "free" in value


def _read_bounds(
    model: type[BaseModel],
    section: BaseModel,
    plain: Mapping[str, Any],
    part: FreeSection,
    path: Key,
    faults: list[Fault],
) -> Free | None:
    key, guess = str(path[-1]), getattr(section, str(path[-1]))
    if not isinstance(guess, float):
        faults.append(Fault(path, "cannot be free: only a real number can be an unknown; give a value"))
        return None
    bounds = []
    for index, bound in enumerate(part.free):
        own: list[Fault] = []
        other = read_section(model, {**plain, key: bound}, (), own)
        faults += [Fault((*path, "free", index), fault.message) for fault in own]
        bounds += [] if other is None else [getattr(other, key)]
    if len(bounds) < 2:
        return None
    lower, upper = bounds
    if lower >= upper:
        faults.append(
            Fault((*path, "free"), f"is empty: [{lower:g}, {upper:g}] needs lo < hi; for a fixed value, give a number")
        )
    elif not lower <= guess <= upper:
        faults.append(Fault((*path, "guess"), f"{guess:g} is outside of its bounds [{lower:g}, {upper:g}]"))
    return Free(lower=lower, upper=upper, guess=guess)


def _dotted_key(path: Key, key: str) -> str:
    return ".".join(map(str, (*path, key)))
