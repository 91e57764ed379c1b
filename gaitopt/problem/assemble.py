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
from gaitopt.mechanics.declaration import calling
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
    return _Reader(data, walkers, faults).fields()


class _Reader:
    """Reads the sections of one problem, and collects its unknowns ``free`` and all faults on the way."""

    def __init__(self, data: Mapping[str, Any], walkers: Mapping[str, type[Walker]], faults: list[Fault]) -> None:
        self._data, self._walkers, self._faults = data, walkers, faults
        self._free: dict[str, Free] = {}
        friction = data.get("friction")
        self._coefficients = friction if isinstance(friction, Mapping) and not _is_free(friction) else None

    def fields(self) -> dict[str, Any]:
        """The fields of the problem."""
        data, faults = self._data, self._faults
        model = self._model()
        walker = None if model is None else self._walker(model)
        head = self._head()
        several = self._coefficients
        friction = None if several is None else self._parameters(FrictionCoefficients, several, ("friction",))
        control = self._control(model)
        modes, guess = read_gait(data, model, walker, faults)
        fields: dict[str, Any] = {"walker": walker, "control": control, "modes": modes, "start": guess}
        if head:
            fields |= {key: getattr(head, key) for key in HeadSection.model_fields}
        if friction:
            fields["friction"] = friction
        if model:
            cycle = modes if isinstance(modes, Cycle) else None
            scope = Scope(walker=model, control=control, cycle=cycle, free=self._free)
            objective = read_objective(data.get("objective"), scope, faults)
            constraints = read_constraints(data.get("constraints"), scope, faults)
            if not faults:
                check_unknowns(scope, objective, constraints, faults)
            fields |= {"objective": objective, "constraints": constraints}
        return fields | {"free": self._free}

    def _fault(self, path: Key, message: str) -> None:
        self._faults.append(Fault(path, message))

    def _head(self) -> HeadSection | None:
        known = (*HeadSection.model_fields, *SECTION_KEYS)
        for key in self._data:
            if key not in known:
                self._fault((key,), f"unknown key{near_miss(key, known)}")
        self._faults += [Fault((key,), "is missing") for key in ("walker", "gait") if key not in self._data]
        own = {key: value for key, value in self._data.items() if key in HeadSection.model_fields}
        if self._coefficients is not None:
            own["friction"] = 0.0  # read by itself
        return self._parameters(HeadSection, own, ())

    def _model(self) -> type[Walker] | None:
        if "walker" not in self._data:
            return None
        section = self._data["walker"]
        if not isinstance(section, Mapping):
            words = "stands where a mapping belongs: model, and the model's parameters"
            self._fault(("walker",), f"{shown(section)} {words}")
            return None
        name = section.get("model")
        if isinstance(name, str) and name in self._walkers:
            return self._walkers[name]
        if isinstance(name, str) and name in refused_walkers():
            self._fault(("walker", "model"), refused_walkers()[name])
            return None
        wrong = f"no walker is called {shown(name)}" if "model" in section else "is missing"
        self._fault(("walker", "model"), f"{wrong}{near_miss(name, tuple(self._walkers))}")
        return None

    def _walker(self, model: type[Walker]) -> Walker | None:
        parameters = {key: value for key, value in self._data["walker"].items() if key != "model"}
        try:
            with calling(model, "reading its parameters"):
                walker = self._parameters(model, parameters, ("walker",))
            if walker is None:
                return None
            check_walker(walker)
        except ProblemError as error:
            self._fault(("walker",), str(error))
            return None
        return walker

    def _control(self, walker: type[Walker] | None) -> ControlSpec | None:
        data, path = self._data.get("control", {"type": "none"}), ("control", "type")
        if not isinstance(data, Mapping) or "type" not in data:
            self._fault(path, f"is missing; allowed: {', '.join(CONTROLS)}")
            return None
        kind = data["type"]
        if kind not in CONTROLS:
            self._fault(path, f"no control law is called {shown(kind)}{near_miss(kind, CONTROLS)}")
            return None
        if kind == "none":
            return read_section(NoControlSpec, data, ("control",), self._faults)
        if walker is not None and not walker.actuators:
            words = f"so that {kind} has nothing to act on; allowed: none"
            self._fault(path, f"{walker.model} has no actuators, {words}")
            return None
        if kind == "pd":
            law = self._parameters(PDSpec, self._with_reference(data), ("control",))
            if walker is not None and law is not None and isinstance(law.reference, CurveReference):
                self._faults += _point_faults(law.reference.curve, walker)
            return law
        if walker is None:
            return None
        torques = self._parameters(torques_section(walker), data, ("control",))
        return None if torques is None else ConstantTorqueSpec(torques=torques.model_dump(exclude={"type"}))

    def _with_reference(self, data: Mapping[str, Any]) -> dict[str, Any]:
        """The data of a PD law with its reference read; where that failed another one stands in, to check the rest."""
        if "reference" not in data:
            return dict(data)
        reference, path = data["reference"], ("control", "reference")
        read: GaitReference | CurveReference | None
        if isinstance(reference, Mapping) and "curve" in reference:
            curve = read_section(Curve, reference["curve"], (*path, "curve"), self._faults)
            stand_in = curve or Curve.model_construct(degree=1, start="")
            read = read_section(CurveReference, {**reference, "curve": stand_in}, path, self._faults)
        else:
            read = read_section(GaitReference, reference, path, self._faults)
        return {**data, "reference": read or GaitReference.model_construct(gait="", beyond_end=BeyondEnd.HOLD)}

    def _parameters(self, model: type[Model], data: Mapping[str, Any], path: Key) -> Model | None:
        """A section in which numbers may be free; a freed number has its guess."""
        freed = {key: data[key] for key in model.model_fields if _is_free(data.get(key))}
        self._free |= {_dotted_key(path, key): UNREAD for key in freed}
        parts = {key: read_section(FreeSection, value, (*path, key), self._faults) for key, value in freed.items()}
        unknowns = {key: part for key, part in parts.items() if part is not None}
        own: list[Fault] = []
        plain = {**data, **{key: part.guess for key, part in unknowns.items()}}
        section = read_section(model, plain, path, own)
        for fault in own:
            key = fault.path[len(path)] if len(fault.path) > len(path) else None
            if key in unknowns:
                self._fault((*fault.path, "guess"), fault.message)
            elif key not in freed:  # what is wrong with the mapping of an unknown has been said
                self._faults.append(fault)
        if section is None:
            return None
        for name, part in unknowns.items():
            span = self._bounds(section, plain, part, (*path, name))
            if span is not None:
                self._free[_dotted_key(path, name)] = span
        return section

    def _bounds(self, section: BaseModel, plain: Mapping[str, Any], part: FreeSection, path: Key) -> Free | None:
        key, guess = str(path[-1]), getattr(section, str(path[-1]))
        if not isinstance(guess, float):
            self._fault(path, "cannot be free: only a real number can be an unknown; give a value")
            return None
        bounds = []
        for index, bound in enumerate(part.free):
            own: list[Fault] = []
            other = read_section(type(section), {**plain, key: bound}, (), own)
            self._faults += [Fault((*path, "free", index), fault.message) for fault in own]
            bounds += [] if other is None else [getattr(other, key)]
        if len(bounds) < 2:
            return None
        lower, upper = bounds
        if lower >= upper:
            words = f"[{lower:g}, {upper:g}] needs lo < hi; for a fixed value, give a number"
            self._fault((*path, "free"), f"is empty: {words}")
        elif not lower <= guess <= upper:
            self._fault((*path, "guess"), f"{guess:g} is outside of its bounds [{lower:g}, {upper:g}]")
        return Free(lower=lower, upper=upper, guess=guess)


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


def _is_free(value: object) -> bool:
    return isinstance(value, Mapping) and "free" in value


def _dotted_key(path: Key, key: str) -> str:
    return ".".join(map(str, (*path, key)))
