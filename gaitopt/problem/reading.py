"""Reading the data of a problem file into the fields of a problem statement; all faults are collected.

This module reads walker, friction and control law, whose numbers may be free, and leaves the gait to
``gaitopt.problem.gait_section`` and the design to ``gaitopt.problem.design_section``. The model of a section validates
a free number, ``{free: [lo, hi], guess: x}``, three times: with its guess, its lower and its upper bound.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel

from gaitopt.errors import ProblemError
from gaitopt.model.checks import check_walker
from gaitopt.model.contract import check_hooks, law_faults, law_section
from gaitopt.model.control import OWN_PACKAGE, Control, NoControl, is_parameter
from gaitopt.model.foreign import calling
from gaitopt.model.registry import refused_controls, refused_walkers
from gaitopt.model.section import CLOCK
from gaitopt.model.units import Free, is_free
from gaitopt.model.walker import Walker
from gaitopt.problem.design_section import DesignReader
from gaitopt.problem.faults import Fault, Key, SectionReader, near_miss, read_section, shown
from gaitopt.problem.gait_section import GaitReader
from gaitopt.problem.schema import (
    SECTION_KEYS,
    SIMULATION_KEYS,
    FrictionCoefficients,
    HeadSection,
    RobotSection,
    UntilSection,
    friction_section,
)
from gaitopt.problem.statement import Until

Model = TypeVar("Model", bound=BaseModel)

UNREAD = Free[float](free=(math.nan, math.nan), guess=math.nan)
"""Stands for an unknown whose mapping has faults, so that objectives and constraints may still use its name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """Classes of walkers and control laws by the names that problem files use."""

    walkers: Mapping[str, type[Walker]]
    controls: Mapping[str, type[Control]]


def read_statement(data: Mapping[str, Any], known: Known, faults: list[Fault]) -> dict[str, Any]:
    """The fields of a problem statement from its data; they are meaningful only if no fault was added."""
    return _StatementReader(data, known, faults).fields()


class _StatementReader(SectionReader):
    """Reads the sections of one problem, and collects its unknowns and all faults.

    An attribute is None before its section is read, and if the section has faults.
    """

    def __init__(self, data: Mapping[str, Any], known: Known, faults: list[Fault]) -> None:
        super().__init__(data, faults)
        self._known = known
        self._free: dict[str, Free[float]] = {}
        self._model: type[Walker] | None = None
        self._laws: dict[str, Any] = {}

    def fields(self) -> dict[str, Any]:
        """The fields of the problem."""
        data, faults = self._data, self._faults
        self._model, walker = self._read_walker()
        fields, control = self._read_head(), self._read_control()
        modes, start, cycle_end = GaitReader(data, faults, self._model, walker, control, self._laws).read()
        fields |= {"walker": walker, "control": control, "modes": modes, "start": start, "cycle_end": cycle_end}
        if "gait" not in data and data.get("until") is not None:
            until = self._section(UntilSection, data["until"], ("until",))
            fields["until"] = None if until is None else Until(**dict(until))
        if control and self._model and not control.restarts and cycle_end != CLOCK:
            why = "end the cycle with its period, gait: {section: clock}"
            self._fault(("control", "type"), f"the clock of {control.type} does not restart at impacts: {why}")
        if self._model:
            fields |= DesignReader(data, faults, self._model, control, modes, cycle_end, self._free).read()
        return fields | {"free": self._free}

    def _read_head(self) -> dict[str, Any]:
        known = (*HeadSection.model_fields, *SECTION_KEYS)
        for key in self._data:
            if key not in known:
                self._fault((key,), f"unknown key{near_miss(key, known)}")
        if "walker" not in self._data:
            self._fault(("walker",), "is missing")
        for key in SIMULATION_KEYS if "gait" in self._data else ():
            if key in self._data:
                self._fault((key,), "is for simulations without a gait: leave it out, or leave gait out")
        head = {key: value for key, value in self._data.items() if key in HeadSection.model_fields}
        friction = head.get("friction")
        coefficients: Any = None
        if isinstance(friction, Mapping) and not is_free(friction):
            head["friction"] = 0.0  # the section of the head needs a number
            section = self._numbers(HeadSection, head, ())
            if (
                self._model is not None
                and self._model.contacts
                and not {*friction} & {*FrictionCoefficients.model_fields}
            ):
                coefficients = self._read_friction(self._model, friction)
            else:
                coefficients = self._numbers(FrictionCoefficients, friction, ("friction",))
        else:
            section = self._numbers(HeadSection, head, ())
        fields = {} if section is None else {key: getattr(section, key) for key in HeadSection.model_fields}
        return fields | ({"friction": coefficients} if coefficients else {})

    def _read_friction(self, model: type[Walker], laws: Mapping[str, Any]) -> dict[str, Any] | None:
        """The friction law of every contact by name."""
        numbers = {name: laws[name] for name in laws if not isinstance(laws[name], Mapping) or is_free(laws[name])}
        missing = [name for name in model.contacts if name not in laws]
        self._faults += [Fault(("friction", name), "is missing: every contact has its friction") for name in missing]
        read: dict[str, Any] = {}
        section = self._numbers(
            friction_section(tuple(name for name in model.contacts if name in numbers)), numbers, ("friction",)
        )
        for name, law in laws.items():
            if name not in numbers:
                foreign = name not in model.contacts
                if foreign:
                    self._fault(
                        ("friction", name), f"is not a contact of the {model.model}{near_miss(name, model.contacts)}"
                    )
                read[name] = self._numbers(FrictionCoefficients, law, ("friction", name))
        if section is None or missing or any(law is None for law in read.values()):
            return None
        self._laws = {name: read[name] if name in read else getattr(section, name) for name in model.contacts}
        return self._laws

    def _read_walker(self) -> tuple[type[Walker] | None, Walker | None]:
        """The class of the walker, and the walker with its parameters."""
        if "walker" not in self._data:
            return None, None
        section, path = self._data["walker"], ("walker", "model")
        if not isinstance(section, Mapping):
            self._fault(("walker",), f"{shown(section)} is not a mapping; keys: model, and the model's parameters")
            return None, None
        if "urdf" in section:
            robot = self._read_robot(section)
            parameters = {key: value for key, value in section.items() if key not in RobotSection.model_fields}
            return self._read_parameters(robot, parameters) if robot else (None, None)
        name = section.get("model")
        model = self._known.walkers.get(name) if isinstance(name, str) else None
        if model is None:
            wrong = f"no walker is called {shown(name)}" if "model" in section else "is missing"
            reason = refused_walkers().get(name) if isinstance(name, str) else None
            self._fault(path, reason or f"{wrong}{near_miss(name, tuple(self._known.walkers))}")
            return None, None
        return self._read_parameters(model, {key: value for key, value in section.items() if key != "model"})

    def _read_robot(self, section: Mapping[str, Any]) -> type[Walker] | None:
        """The class of a robot from the text of its URDF file, which is in the data."""
        if "model" in section:
            self._fault(("walker", "model"), "excludes urdf: keep one of them")
            return None
        stated = {key: section[key] for key in RobotSection.model_fields if key in section}
        robot = self._section(RobotSection, stated, ("walker",))
        if robot is None:
            return None
        from gaitopt.model.urdf import walker_from_text

        try:
            return walker_from_text(robot.urdf.text, (robot.feet[0], robot.feet[1]), robot.urdf.file)
        except ProblemError as error:
            self._fault(("walker", "urdf"), str(error))
            return None

    def _read_parameters(
        self, model: type[Walker], parameters: Mapping[str, Any]
    ) -> tuple[type[Walker], Walker | None]:
        """The class, and a walker of this class with its parameters."""
        try:
            with calling(model, "reading its parameters"):
                walker = self._numbers(model, parameters, ("walker",))
            if walker is not None:
                check_walker(walker)
        except ProblemError as error:
            self._fault(("walker",), str(error))
            return model, None
        return model, walker

    def _read_control(self) -> Control | None:
        data, path, known = self._data.get("control", {"type": "none"}), ("control", "type"), self._known.controls
        if not isinstance(data, Mapping) or "type" not in data:
            self._fault(path, f"is missing; allowed: {', '.join(known)}")
            return None
        kind, model = data["type"], self._model
        law = known.get(kind) if isinstance(kind, str) else None
        if law is None:
            reason = refused_controls().get(kind) if isinstance(kind, str) else None
            self._fault(path, reason or f"no control law is called {shown(kind)}{near_miss(kind, tuple(known))}")
            return None
        if law is not NoControl and model is not None and not model.actuators:
            self._fault(path, f"{model.model} has no actuators, so {kind} cannot act; allowed: none")
            return None
        version = data.get("version", law.version)
        if version != law.version:
            self._fault(("control", "version"), f"{shown(version)} is not the version of {kind} here, {law.version!r}")
        keys = {key: value for key, value in data.items() if key not in ("type", "version")}
        try:
            with calling(law, "reading its keys"):
                section = self._numbers(law if model is None else law_section(law, model), keys, ("control",))
                if section is None or model is None:
                    return None
                control = section if isinstance(section, law) else law(**dict(section))
            faults = [Fault(("control", *path), message) for path, message in law_faults(control, model)]
            self._faults += faults
            if not (faults or control.source[0] or law.__module__.startswith(OWN_PACKAGE)):
                check_hooks(control, model)
                with calling(law, "writing its keys as JSON"):
                    control.model_dump_json()
        except ProblemError as error:
            self._fault(("control",), str(error))
            return None
        return control

    def _numbers(self, model: type[Model], data: Mapping[str, Any], path: Key) -> Model | None:
        """A section in which numbers may be free; a free number has the value of its guess."""
        freed: dict[tuple[str, ...], Any] = {}
        for key, entry in ((key, data.get(key)) for key in model.model_fields):
            if is_free(entry):
                freed[key,] = entry
            elif isinstance(entry, Mapping) and is_parameter(model, key):
                freed |= {(key, str(name)): value for name, value in entry.items() if is_free(value)}
        self._free |= {".".join(map(str, (*path, *keys))): UNREAD for keys in freed}
        sections = {keys: self._section(Free[Any], value, (*path, *keys)) for keys, value in freed.items()}
        unknowns = {keys: unknown for keys, unknown in sections.items() if unknown is not None}
        section_faults: list[Fault] = []
        plain: Mapping[str, Any] = data
        for keys, unknown in unknowns.items():
            plain = _with(plain, keys, unknown.guess)
        section = read_section(model, plain, path, section_faults)
        for fault in section_faults:
            subpath = fault.path[len(path) :]
            owner = next((keys for keys in freed if subpath[: len(keys)] == keys), None)
            if owner in unknowns:
                self._fault((*fault.path, "guess"), fault.message)
            elif owner is None:  # faults of an unknown's mapping are already reported
                self._faults.append(fault)
        if section is None:
            return None
        for keys, unknown in unknowns.items():
            span = self._read_bounds(section, plain, unknown, path, keys)
            if span is not None:
                self._free[".".join(map(str, (*path, *keys)))] = span
        return section

    def _read_bounds(
        self, section: BaseModel, plain: Mapping[str, Any], unknown: Free[Any], above: Key, keys: tuple[str, ...]
    ) -> Free[float] | None:
        path, guess = (*above, *keys), _at(section, keys)
        if not isinstance(guess, float) or not is_parameter(type(section), keys[0]):
            self._fault(path, "cannot be free: only a real number can be an unknown; give a value")
            return None
        bounds = []
        for index, bound in enumerate(unknown.free):
            bound_faults: list[Fault] = []
            other = read_section(type(section), _with(plain, keys, bound), (), bound_faults)
            self._faults += [Fault((*path, "free", index), fault.message) for fault in bound_faults]
            bounds += [] if other is None else [_at(other, keys)]
        if len(bounds) < 2:
            return None
        free = Free[float](free=(bounds[0], bounds[1]), guess=guess)
        self._faults += [Fault((*path, *keys), message) for keys, message in free.faults()]
        return free


def _with(data: Mapping[str, Any], keys: tuple[str, ...], value: object) -> dict[str, Any]:
    """A copy of the data in which the entry under these keys has another value."""
    key, *rest = keys
    return {**data, key: _with(data[key], (*rest,), value) if rest else value}


def _at(section: BaseModel, keys: tuple[str, ...]) -> Any:
    """The field of a section with this key, or with two keys, an entry of the mapping in it."""
    value = getattr(section, keys[0])
    return value[keys[1]] if len(keys) > 1 else value
