"""Reading the data of a problem file into the fields of a problem statement; all faults are collected.

The model of a section validates a free number, ``{free: [lo, hi], guess: x}``, three times: with its guess, its lower
and its upper bound. The guess of a gait is a state on the section just after the impact. The section determines the
values that the file leaves out (both feet on the ground, x = 0, and dx = 0 unless the impact slips), and values in the
file must agree with it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import numpy as np
from pydantic import BaseModel, TypeAdapter, ValidationError

from gaitopt.errors import ProblemError
from gaitopt.model.checks import before_impact, check_walker, section_posture, stepping_posture, swing_foot
from gaitopt.model.contract import check_hooks, law_faults, law_section
from gaitopt.model.control import OWN_PACKAGE, Control, NoControl, is_parameter
from gaitopt.model.cycle import Cycle, ModeSequence
from gaitopt.model.declaration import is_default, joint_limits, parameter_values
from gaitopt.model.foreign import calling
from gaitopt.model.modes import FEET, IMPACT, LEAVES, NAMED, OFF, STOP_STATES, SWAPPED, SWITCH_STATES, Mode
from gaitopt.model.open_loop import OpenLoop
from gaitopt.model.registry import refused_controls, refused_walkers
from gaitopt.model.section import CLOCK, TOUCHDOWN, has_stated_sections, section_of
from gaitopt.model.transitions import transitions
from gaitopt.model.units import SMALLEST_SIZE, Angle, Number, unknown_faults
from gaitopt.model.walker import Walker
from gaitopt.problem.faults import Fault, Key, near_miss, read_section, shown
from gaitopt.problem.scalars import ANGLE, CLEARANCE, DESIGN_SCALARS, MOTORS, PUSH, SCALARS
from gaitopt.problem.schema import (
    OPEN,
    SECTION_KEYS,
    SIMULATION_KEYS,
    Aggregate,
    AngleRangeSection,
    CycleSection,
    FirstGuessSection,
    FreeSection,
    FrictionCoefficients,
    GaitSection,
    GuessSection,
    HeadSection,
    OpenGaitSection,
    RangeSection,
    RobotSection,
    StepSection,
    UntilSection,
    friction_section,
    is_angle,
    state_section,
)
from gaitopt.problem.statement import Free, Guess, OpenSequence, Over, Range, Until

Model = TypeVar("Model", bound=BaseModel)

UNREAD = Free(lower=math.nan, upper=math.nan, guess=math.nan)
"""Stands for an unknown whose mapping has faults, so that objectives and constraints may still use its name."""
UNEVEN = "{} steps do not return to the first stance leg: where the legs differ, a cycle has 2, 4, ... steps"
GUESSED_SLIP = 0.1
"""Guessed velocity of a foot that slips just after the impact, relative to the speed of the walker."""
STATED_TOLERANCE = 1e-5
"""Relative tolerance within which values in a file must agree with the section; a state that is written with six digits
may be off by half of this."""
SOLVED_TOLERANCE = 1e-12
"""Rounding of coordinates that are solved from the section, relative, or in rad and SI units."""
SELECTING_TOLERANCE = 0.5
"""Largest difference between a coordinate in a file and its value on the section of a walker with several contacts,
relative, or in rad and SI units. The file's value only selects one of the solutions; a solution with exchanged legs, or
with a knee bent to the other side, is farther away."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """Classes of walkers and control laws by the names that problem files use."""

    walkers: Mapping[str, type[Walker]]
    controls: Mapping[str, type[Control]]


def read_statement(data: Mapping[str, Any], known: Known, faults: list[Fault]) -> dict[str, Any]:
    """The fields of a problem statement from its data; they are meaningful only if no fault was added."""
    return _StatementReader(data, known, faults).fields()


class _StatementReader:
    """Reads the sections of one problem, and collects its unknowns and all faults.

    An attribute is None before its section is read, and if the section has faults.
    """

    def __init__(self, data: Mapping[str, Any], known: Known, faults: list[Fault]) -> None:
        self._data, self._known, self._faults = data, known, faults
        self._free: dict[str, Free] = {}
        self._model: type[Walker] | None = None
        self._walker: Walker | None = None
        self._control: Control | None = None
        self._modes: Cycle | OpenSequence | None = None
        self._cycle_end = TOUCHDOWN
        self._laws: dict[str, Any] = {}

    def fields(self) -> dict[str, Any]:
        """The fields of the problem."""
        self._model, self._walker = self._read_walker()
        fields = self._read_head()
        self._control = self._read_control()
        self._modes, guess = self._read_gait()
        if "gait" not in self._data:
            self._modes, guess = OpenSequence(stated=False), self._read_start()
            end = self._data.get("until")
            until = None if end is None else self._section(UntilSection, end, ("until",))
            fields["until"] = None if until is None else Until(**dict(until))
            self._check_swapped(2)
        fields |= {"walker": self._walker, "control": self._control, "modes": self._modes, "start": guess}
        fields["cycle_end"] = self._cycle_end
        if self._control and self._model and not self._control.restarts and self._cycle_end != CLOCK:
            why = "end the cycle with its period, gait: {section: clock}"
            self._fault(("control", "type"), f"the clock of {self._control.type} does not restart at impacts: {why}")
        if self._model:
            objective, constraints = self._read_objective(), self._read_constraints()
            if not self._faults:
                self._check_unknowns(objective, constraints)
            fields |= {"objective": objective, "constraints": constraints | self._joint_ranges(constraints)}
            equalities = [name for name, span in constraints.items() if span.minimum == span.maximum]
            fields["over"] = self._read_over([name for name in equalities if name not in self._free])
        return fields | {"free": self._free}

    @property
    def _name(self) -> str:
        """The name of the walker in messages."""
        return "walker" if self._model is None else self._model.model

    def _fault(self, path: Key, message: str) -> None:
        self._faults.append(Fault(path, message))

    def _section(self, model: type[Model], data: object, path: Key) -> Model | None:
        return read_section(model, data, path, self._faults)

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
        if isinstance(friction, Mapping) and not _is_free(friction):
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
        numbers = {name: laws[name] for name in laws if not isinstance(laws[name], Mapping) or _is_free(laws[name])}
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

    def _check_swapped(self, steps: int) -> None:
        """Check that contacts that swap roles at the end of a step have the same friction, unless they swap back.

        So do two parameters of a control law that take each other's values.

        Parameters
        ----------
        steps : number of steps of the cycle.
        """
        model, within = self._model, self._cycle_end != TOUCHDOWN
        swapping = model.partners().items() if model is not None and model.step_ends() and self._laws else ()
        for name, other in swapping:
            ours, theirs = self._laws[name], self._laws[other]
            if isinstance(ours, float) != isinstance(theirs, float):
                remedy = "give both one number, or both static and kinetic friction"
            elif ours != theirs and (within or steps % 2):
                remedy = "give both the same" + ("" if within else ", or state the phases of 2, 4, ... steps")
            else:
                continue
            difference = f"differs from that of {other}, with which it swaps places after every step"
            self._fault(("friction", name), f"{difference}: {remedy}")
        if self._control is not None and self._control.exchanged and (within or steps % 2):
            key = next(iter(self._control.exchanged.values())).partition(".")[0]
            words = "is not possible, since a cycle does not end with a landing: leave it out"
            words = words if within else "applies in every second step: state the phases of 2, 4, ... steps"
            self._fault(("control", key), words)

    @property
    def _legs_differ(self) -> bool:
        """Whether parameters of walker, friction or control take other values in every second step."""
        partners = {} if self._model is None else self._model.partners()
        of_contacts = any(self._laws[name] != self._laws[other] for name, other in partners.items() if self._laws)
        of_walker = self._model is not None and self._model.steps_per_cycle() > 1
        return of_walker or of_contacts or (self._control is not None and bool(self._control.exchanged))

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
            faults = [Fault(("control", *place), message) for place, message in law_faults(control, model)]
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
            if _is_free(entry):
                freed[key,] = entry
            elif isinstance(entry, Mapping) and is_parameter(model, key):
                freed |= {(key, str(name)): value for name, value in entry.items() if _is_free(value)}
        self._free |= {".".join(map(str, (*path, *keys))): UNREAD for keys in freed}
        sections = {keys: self._section(FreeSection, value, (*path, *keys)) for keys, value in freed.items()}
        unknowns = {keys: unknown for keys, unknown in sections.items() if unknown is not None}
        section_faults: list[Fault] = []
        plain: Mapping[str, Any] = data
        for keys, unknown in unknowns.items():
            plain = _with(plain, keys, unknown.guess)
        section = read_section(model, plain, path, section_faults)
        for fault in section_faults:
            place = fault.path[len(path) :]
            owner = next((keys for keys in freed if place[: len(keys)] == keys), None)
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
        self, section: BaseModel, plain: Mapping[str, Any], unknown: FreeSection, above: Key, keys: tuple[str, ...]
    ) -> Free | None:
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
        lower, upper = bounds
        self._faults += [Fault((*path, key), words) for key, words in unknown_faults(lower, upper, guess)]
        return Free(lower=lower, upper=upper, guess=guess)

    def _read_gait(self) -> tuple[Cycle | OpenSequence | None, Guess | None]:
        """The mode sequence and the guess."""
        if "gait" not in self._data:
            return None, None
        data, landings, n_faults = self._data["gait"], list[tuple[tuple[int, Mode], ...]](), len(self._faults)
        kind: type[OpenGaitSection | CycleSection | GaitSection] = GaitSection
        if isinstance(data, Mapping):
            kind = OpenGaitSection if data.get("phases") == OPEN else CycleSection if "steps" in data else GaitSection
            data, landings = self._with_modes(self._model or Walker, data, is_open=kind is OpenGaitSection)
        has_modes = len(self._faults) == n_faults
        gait = self._section(kind, data, ("gait",))
        if gait is None or not has_modes:
            return None, None
        self._cycle_end = self._read_cycle_end(gait.section)
        if isinstance(gait, OpenGaitSection):
            return self._read_open_gait(gait)
        steps = gait.steps if isinstance(gait, CycleSection) else (gait,)
        cycle = self._read_cycle(steps, ("gait", "steps" if kind is CycleSection else "phases"), landings)
        self._check_swapped(len(steps))
        if {*FirstGuessSection.model_fields} & {*gait.guess}:
            return cycle, self._read_first_guess(gait.guess, steps)
        path, phases = ("gait", "guess"), [mode for step in steps for mode in step.phases]
        guess = self._section(GuessSection, gait.guess, path)
        if guess is None:
            return cycle, None
        if guess.durations is not None and len(guess.durations) != len(phases):
            needed = f"one duration per phase ({', '.join(phases)})"
            message = f"{len(guess.durations)} given, but the gait needs {needed}; or leave durations out"
            self._fault((*path, "durations"), message)
        if self._has_stated_section:
            state = self._read_state(guess.state, steps[-1].impact)
        else:
            state = self._read_nearby_state(guess.state, cycle)
        return cycle, None if state is None else Guess(state=state, durations=guess.durations)

    @property
    def _has_stated_section(self) -> bool:
        """Whether the class of the walker states the section with which the cycle ends."""
        return self._model is None or has_stated_sections(self._model, self._cycle_end)

    def _read_start(self) -> Guess | None:
        """The state from which a simulation starts.

        If the control law has a clock of its own, the clock ends a cycle.
        """
        if self._control is not None and not self._control.restarts and self._control.period:
            self._cycle_end = CLOCK
        model, path = self._model, ("state",)
        if "state" not in self._data or model is None:
            return None
        data = self._data["state"]
        stated_values = self._stated_state(model, data, path)
        if stated_values is None:
            return None
        given, missing = stated_values
        if not missing:
            return Guess(state=given, durations=None, whole=True)
        impact = Mode.slip(given["dx"]) if given.get("dx") else Mode.STICK
        section = model.section_names(slipping=impact.slips) if self._has_stated_section else ()
        if section and {*data} == {*section}:
            lifted = self._read_state(data, impact, path)
            return None if lifted is None else Guess(state=lifted, durations=None)
        choice = f" just after an impact give {', '.join(section)} alone; else" if section else ""
        names = ", ".join(name for name in model.state_names() if name != "x")
        self._fault((*path, missing[0]), f"is missing;{choice} a state needs {names}")
        return None

    def _read_first_guess(self, data: Mapping[str, Any], steps: Sequence[StepSection]) -> Guess | None:
        """A guess that follows from postures, between which the shape changes linearly, or from the step length."""
        path, model, walker = ("gait", "guess"), self._model, self._walker
        section = self._section(FirstGuessSection, data, path)
        if section is None or model is None or walker is None or not all(step.phases for step in steps):
            return None
        n_faults, impact = len(self._faults), steps[-1].impact
        self._faults += [Fault((*path, *keys), message) for keys, message in section.faults(model)]
        if len(self._faults) > n_faults:
            return None
        p = parameter_values(walker)
        try:
            if section.step_length is not None:
                first = stepping_posture(model, section.step_length, p)
                postures = [first, before_impact(model, first, p)]
            else:
                postures = [np.array([posture[name] for name in model.shape]) for posture in section.postures or ()]
        except ProblemError as error:
            self._fault((*path, "step_length"), str(error))
            return None
        lead = swing_foot(model, postures[0], p)[0]
        if lead >= 0:
            crossed = f"have crossed feet: the foot that swings first is {lead:.3g} m in front of the other one"
            self._fault((*path, "postures"), f"{crossed} just after the impact; it must be behind")
            return None
        rates = (postures[1] - postures[0]) * (len(postures) - 1) / section.duration
        values = dict(zip(model.shape, postures[0].tolist(), strict=True))
        values |= {f"d{name}": float(rate) for name, rate in zip(model.shape, rates, strict=True)}
        values["dx"] = GUESSED_SLIP * impact.direction * -lead / section.duration
        names = model.section_names(slipping=impact.slips)
        state = self._read_state({name: values[name] for name in names}, impact)
        durations = tuple(section.duration / len(step.phases) for step in steps for _ in step.phases)
        return None if state is None else Guess(state=state, durations=durations, first=section)

    def _with_modes(
        self, model: type[Walker], data: Mapping[str, Any], *, is_open: bool
    ) -> tuple[dict[str, Any], list[tuple[tuple[int, Mode], ...]]]:
        """The data of a gait with modes in place of their words, and the impacts within every step.

        A phase that begins with the landing of a contact, or the lock of a stop, may state the mode just after that
        impact: ``{mode: stick, impact: stick}``. A landing after which the feet swap roles ends a step. If something
        else ends the cycle, such landings are stated within it, except those after a flight; of named contacts with
        the names that they have then, as in ``impact: {heel: stick, toe: leaves, feet: swapped}``.
        """
        is_step, alone = is_open or "steps" not in data, bool(model.base_contact())
        stated, step_ends = [data] if is_step else data["steps"], {*model.step_ends()}
        ends_in_landing = bool(step_ends) and data.get("section", TOUCHDOWN) == TOUCHDOWN
        steps, landings = list[dict[str, Any]](), list[tuple[tuple[int, Mode], ...]]()
        for number, step in enumerate(stated if isinstance(stated, list | tuple) else ()):
            place: Key = ("gait",) if is_step else ("gait", "steps", number)
            if not isinstance(step, Mapping):
                return dict(data), []  # the section of the gait reports it
            final = step.get("impact")
            if final is not None:
                final = self._mode(model, final, (*place, "impact"), after_impact=is_open or ends_in_landing)
                step = {**step, "impact": final}
            if not isinstance(step.get("phases"), list | tuple):
                return {**data, **step} if is_step else dict(data), []
            modes, struck = list[Mode](), list[tuple[int, Mode]]()
            for k, phase in enumerate(step["phases"]):
                entry, path = dict(phase) if isinstance(phase, Mapping) else phase, (*place, "phases", k)
                impact = entry.pop(IMPACT, None) if isinstance(entry, dict) else None
                modes.append(self._mode(model, entry, path))
                before, after, states_swap = modes[k - 1] if k else modes[k], modes[k], False
                if impact is not None:
                    if isinstance(impact, Mapping) and impact.get(FEET) == SWAPPED:
                        states_swap, impact = True, {name: word for name, word in impact.items() if name != FEET}
                    after = self._mode(model, impact, (*path, IMPACT), after_impact=True)
                locks, on_ground = {*modes[k].locked} - {*before.locked}, {*before.touching}
                landed = {*after.touching} - on_ground
                others = landed - step_ends - {model.base_contact()}
                may_swap = not locks and ({*model.swapped(after).touching} - on_ground) & step_ends
                swaps = states_swap or bool(k and may_swap and (landed or impact is not None) and not others)
                if states_swap and not (k and may_swap):
                    self._fault((*path, IMPACT, FEET), "no foot lands with which they would swap: leave it out")
                elif impact is not None and not (k and (landed or swaps or locks)):
                    reason = "no contact lands and no stop locks" if k else "the step begins there"
                    self._fault((*path, IMPACT), f"{reason}: leave it out")
                elif swaps and ends_in_landing and impact is not None:
                    self._fault((*path, IMPACT), f"the landing of the {self._name} ends its step: leave it out")
                if swaps and not ends_in_landing:
                    struck.append((k, after.swapping))
                elif k and not alone and (landed or locks):
                    struck.append((k, Mode.of(after, modes[k].stops)))
            if not ends_in_landing and modes:
                if final not in (None, modes[-1].contact):
                    self._fault((*place, "impact"), "the cycle ends without an impact: leave it out")
                final = modes[-1].contact
            steps.append({**step, "phases": modes} | ({} if final is None else {"impact": final}))
            landings.append(tuple(struck))
        return ({**data, **steps[0]} if is_step and steps else {**data, "steps": steps}), landings

    def _mode(self, model: type[Walker], entry: Any, path: Key, *, after_impact: bool = False) -> Mode:
        """The mode that an entry states.

        Parameters
        ----------
        entry : a word or a mapping of contacts; with stops or switches, a mapping that has one of these under ``mode``.
        path : path of the entry.
        after_impact : whether it is the mode just after an impact, in which contacts may leave the ground.
        """
        devices, nothing, contacts = dict[str, str](), model.foot_modes()[-1], model.landing_points()
        if isinstance(entry, Mode):
            return entry
        if isinstance(entry, Mapping) and "mode" in entry and "mode" not in contacts:
            devices = {name: state for name, state in entry.items() if name != "mode"}
            choices: Mapping[str, tuple[str, ...]] = dict.fromkeys(model.stops, STOP_STATES) | dict.fromkeys(
                model.switches, SWITCH_STATES
            )
            for name, state in devices.items():
                if state not in choices.get(name, ()):
                    allowed = " or ".join(choices.get(name, ())) or f"no stop or switch of the {self._name}"
                    self._fault((*path, name), f"{shown(state)} is not possible: {allowed}")
                    return nothing
            entry, path = entry["mode"], (*path, "mode")
        if not isinstance(entry, Mapping):
            modes = model.mode_words(after_impact=after_impact)
            if entry in modes:
                return Mode.of(entry, devices)
            remedy = near_miss(entry, modes) if modes else f" a mapping of contacts: {', '.join(contacts)}"
            self._fault(path, f"{shown(entry)} is not{' one of the choices' * bool(modes)}{remedy}")
            return nothing
        states = (*NAMED, LEAVES) if after_impact else (*NAMED,)
        for name, state in entry.items():
            if name not in contacts:
                self._fault((*path, name), f"is not a contact of the {self._name}{near_miss(name, contacts)}")
            elif state not in states:
                self._fault((*path, name), f"{shown(state)} is not what a contact does: {', '.join(states)}")
        known = {name: entry.get(name, OFF) for name in contacts}
        contact = model.contact_mode({n: s if isinstance(s, str) and s in NAMED else OFF for n, s in known.items()})
        return Mode.of(contact, devices)

    def _read_cycle_end(self, section: Any) -> str:
        """What ends a cycle: ``touchdown``, ``clock`` or the name of a margin."""
        model, path = self._model, ("gait", "section")
        end: str = section if isinstance(section, str) else section.margin
        if model is None or end == TOUCHDOWN:
            if model is not None and not model.step_ends():
                remedy = "write section: clock, or section: {margin: NAME}; to simulate it alone, leave gait out"
                self._fault(path, f"the {model.model} has no landing contacts: {remedy}")
            return TOUCHDOWN
        if model.exchanged:
            reason = f"the legs of the {model.model} differ, and would swap their roles within a cycle"
            self._fault(path, f"{shown(end)} is not possible: {reason}; leave it out")
            return TOUCHDOWN
        if end == CLOCK and (self._control is None or not self._control.period):
            self._fault(path, "clock needs a control law with a period of its own, such as oscillating")
        elif end != CLOCK and end not in model.sections:
            known = ", ".join(model.sections) or "none"
            self._fault((*path, "margin"), f"the {model.model} has no section {shown(end)}; there are: {known}")
            return CLOCK
        return end

    def _read_nearby_state(self, data: Mapping[str, Any], cycle: Cycle | None) -> dict[str, float] | None:
        """The state near the values that the file gives, on a section that the class does not state."""
        model, walker, path = self._model, self._walker, ("gait", "guess", "state")
        stated = None if model is None else self._section(state_section(model), data, path)
        if model is None or walker is None or stated is None or cycle is None:
            return None
        if any("phases" in fault.path or "impact" in fault.path for fault in self._faults):
            return None  # the section follows from the modes
        given = stated.model_dump(exclude_none=True)
        try:
            section = section_of(model, cycle.phases[-1], cycle.impact, self._cycle_end)
        except (ProblemError, KeyError) as error:
            self._fault(("gait",), str(error))
            return None
        missing = [name for name in section.names if name not in given]
        for name in missing:
            self._fault(
                (*path, name), f"is missing; at the end of this cycle the section is {', '.join(section.names)}"
            )
        if missing:
            return None
        names = model.state_names()
        near = np.array([given.get(name, model.posture.get(name, 0.0)) for name in names])
        p = parameter_values(walker)
        z = section.lift(near[section.indices], p, near)
        if not np.isfinite(z).all():
            values = {name: given[name] for name in section.names} | walker.model_dump(include={"energy"})
            stated_values = ", ".join(f"{name} = {value:g}" for name, value in values.items())
            others = ", ".join(name for name in names if name not in section.names)
            remedy = f"change these values, or give guesses of the others, {others}"
            self._fault(path, f"no state of the section has {stated_values}; {remedy}")
            return None
        state = dict(zip(names, z.tolist(), strict=True))
        for name, value in given.items():
            if math.isclose(value, state[name], rel_tol=SOLVED_TOLERANCE, abs_tol=SOLVED_TOLERANCE):
                state[name] = value  # so that a problem and its record are the same to the last bit
            is_coordinate = name in model.coordinates()
            if is_coordinate and not math.isclose(
                value, state[name], rel_tol=SELECTING_TOLERANCE, abs_tol=SELECTING_TOLERANCE
            ):
                conflict = f"{value:g} contradicts the section, where it is {state[name]:.9g} next to the given values"
                where = f"a cycle ends with {section.words}, with these contacts on the ground"
                remedy = "to simulate from any state leave gait out, and give state and until"
                self._fault((*path, name), f"{conflict}: {where}; {remedy}")
        return state

    def _read_open_gait(self, gait: OpenGaitSection) -> tuple[OpenSequence | None, Guess | None]:
        """The open mode sequence of a gait, and its guess, in which a slip velocity that is left out is zero."""
        path: Key = ("gait", "guess")
        if gait.impact is not None and self._cycle_end != TOUCHDOWN:
            self._fault(("gait", "impact"), "the cycle ends without an impact: leave it out")
            return None, None
        fewest_steps = 2 if self._legs_differ else 1
        sequence = OpenSequence(impact=gait.impact, steps=max(gait.steps, fewest_steps))
        self._check_swapped(fewest_steps)
        if "steps" in gait.model_fields_set and gait.steps < fewest_steps:
            self._fault(("gait", "steps"), UNEVEN.format(gait.steps))
        if gait.guess is not None and {*FirstGuessSection.model_fields} & {*gait.guess}:
            self._fault(path, "with phases: auto the guess is a state; state the phases, or leave the guess out")
            return sequence, None
        guess = None if gait.guess is None else self._section(GuessSection, gait.guess, path)
        if guess is None or self._model is None:
            return sequence, None
        if not self._has_stated_section:
            stated = self._stated_state(self._model, guess.state, (*path, "state"))
            for name in () if stated is None else stated[1][:1]:
                needed = ", ".join(self._model.state_names())
                words = f"is missing; where the modes are open, the state needs {needed}"
                self._fault((*path, "state", name), words)
            return sequence, None if stated is None or stated[1] else Guess(state=stated[0], durations=None)
        if guess.durations is not None:
            self._fault((*path, "durations"), "the phases are open: leave the durations out")
        slip = guess.state.get("dx", 0.0)
        impact = Mode.slip(slip) if isinstance(slip, int | float) and slip else Mode.STICK
        state = self._read_state(guess.state, impact)
        return sequence, None if state is None else Guess(state=state, durations=None)

    def _stated_state(self, model: type[Walker], data: Any, path: Key) -> tuple[dict[str, float], list[str]] | None:
        """The values of a state in the order of its names, in which x may be left out, and the names that it lacks."""
        state = self._section(state_section(model), data, path)
        if state is None:
            return None
        given, names = {"x": 0.0, **state.model_dump(exclude_none=True)}, model.state_names()
        known = {name: float(given[name]) for name in names if name in given}
        return known, [name for name in names if name not in known]

    def _read_cycle(
        self, steps: Sequence[StepSection], path: Key, landings: Sequence[tuple[tuple[int, Mode], ...]] = ()
    ) -> Cycle | None:
        struck = landings or [()] * len(steps)
        try:
            cycle = Cycle(
                tuple(
                    ModeSequence(phases=step.phases, impact=step.impact, landings=of_step)
                    for step, of_step in zip(steps, struck, strict=True)
                )
            )
            if self._model is not None:
                if self._cycle_end == TOUCHDOWN and len(steps) % self._model.steps_per_cycle():
                    raise ValueError(UNEVEN.format(len(steps)))
                if not any(fault.path[0] == "gait" for fault in self._faults):  # the end of the cycle may be at fault
                    transitions(self._model, cycle_end=self._cycle_end).check(cycle)
            return cycle
        except ValueError as error:
            self._fault(path, str(error))
            return None

    def _read_state(
        self, data: Mapping[str, Any], impact: Mode, path: Key = ("gait", "guess", "state")
    ) -> dict[str, float] | None:
        """The complete state, in the order of the walker's state names."""
        model, walker = self._model, self._walker
        section = None if model is None else self._section(state_section(model), data, path)
        if model is None or section is None:
            return None
        given = section.model_dump(exclude_none=True)
        needed = model.section_names(slipping=impact.slips)
        missing = [name for name in needed if name not in given]
        for name in missing:
            self._fault((*path, name), f"is missing; after this impact the section is {', '.join(needed)}")
        dx = given.get("dx", 0.0)
        if "dx" not in missing and math.copysign(1.0, dx) * (dx != 0) != impact.direction:
            sign = {0: "= 0 (leave it out)", 1: "> 0", -1: "< 0"}[impact.direction]
            self._fault((*path, "dx"), f"{shown(dx)} contradicts the impact: after {impact} it is {sign}")
        if missing or walker is None:
            return None
        p = parameter_values(walker)
        posture = map(float, np.concatenate(section_posture(model, given, p)))
        state = dict.fromkeys(walker.state_names(), 0.0)
        state |= dict(zip((*walker.shape, *(f"d{name}" for name in walker.shape)), posture, strict=True))
        state |= {name: given[name] for name in needed}
        undefined = [name for name, value in state.items() if not math.isfinite(value)]
        if undefined:
            values = ", ".join(f"{name} = {value:g}" for name, value in given.items())
            solved = [name for name in undefined if is_default(model, "after_impact") and name in model.shape]
            if solved:
                others = ", ".join(name for name in model.shape if name not in model.section)
                self._fault(path, f"with {values} the legs do not close: no {others} puts both feet on the ground")
                return None
            self._fault(path, f"with {values} the walker would start with {undefined[0]} = {state[undefined[0]]}")
            return None
        for name, value in given.items():
            if name not in (*needed, "x", "dx") and not math.isclose(value, state[name], rel_tol=STATED_TOLERANCE):
                section_value = f"just after the impact it is {state[name]:.9g}; leave it out"
                self._fault((*path, name), f"{value:g} contradicts the section: {section_value}")
        state |= {name: given[name] for name in ("x", "dx") if name in given}
        return {name: float(state[name]) for name in walker.state_names()}

    def _objection(self, model: type[Walker], name: str, *, constrains: bool = False) -> str | None:
        """The reason why an objective or a constraint cannot use a name; None if it can."""
        cycle = self._modes if isinstance(self._modes, Cycle) else None
        durations = () if cycle is None else tuple(f"phases.{k}.duration" for k in range(len(cycle.phases)))
        names = (*DESIGN_SCALARS, *(f"state.{state}" for state in model.state_names()), *durations, *self._free)
        along = name == CLEARANCE or name.startswith(ANGLE)
        if self._control is not None and self._control.step_feedback is not None:
            names += tuple(f"control.{key}" for key in self._control.step_feedback.unknowns)
        if isinstance(self._control, OpenLoop) and self._control.duration is None:
            if name == "foot_clearance":
                return "is the largest height of the swing foot; with open-loop torques state clearance: {min: height}"
            if name == "spectral_radius" and not constrains:
                return "is no objective of open-loop torques: bound it, constraints: {spectral_radius: {max: 0.9}}"
            names += tuple(f"control.{key}" for key in self._control.unknowns(model))
            angles = dict.fromkeys((*model.shape, *model.actuators, *joint_limits(model)))
            names += (CLEARANCE, *(f"{ANGLE}{angle}" for angle in angles)) if constrains else ()
        elif along and self._control is None:  # the faults of the control law are reported already
            return None
        elif along:
            return "is a constraint along the whole step, which only open-loop torques can have: use type: open_loop"
        if name not in names:
            return f"is not a scalar of a gait and no freed parameter{near_miss(name, names)}"
        if name == "foot_clearance" and (self._cycle_end != TOUCHDOWN or (cycle is not None and cycle.swings[-1] > 0)):
            swings = "is the least of several largest heights where the foot swings more than once"
            return f"{swings}, and is not defined without a swing foot: choose another scalar"
        sources = {PUSH} if model.pushes else set()
        sources |= set() if isinstance(self._control, NoControl) else {MOTORS}
        if name in SCALARS and SCALARS[name].needs and not sources.intersection(SCALARS[name].needs):
            return "depends on the motors, and this walker is passive: give it a control, or choose another scalar"
        sticks = cycle is None or any("stick" in mode.contacts.values() for mode in cycle.phases)
        if name in SCALARS and SCALARS[name].sticking and not sticks:
            return "is defined for sticking phases, and this gait has none"
        return None

    def _read_objective(self) -> dict[str, float]:
        """The weights of the objective by name of the scalar; empty if there is none."""
        data, model, path = self._data.get("objective"), self._model, cast(Key, ("objective",))
        if data is None or model is None:
            return {}
        if self._aggregate is not Aggregate.AT:
            data, path = data[self._aggregate], (*path, self._aggregate.value)
        elif isinstance(data, Mapping) and {*data} & {Aggregate.WORST, Aggregate.MEAN}:
            words = "counts the whole objective over a range: give {worst: NAME} or {mean: NAME} alone"
            self._fault(path, f"{' and '.join(map(str, data))}: worst or mean {words}")
            return {}
        elif isinstance(data, Mapping) and len(data) == 1 and isinstance(next(iter(data.values())), str):
            name = next(iter(data))  # a scalar has a number as its weight
            words = f"{shown(name)} is no way in which the values over a range count"
            self._fault(path, f"{words}: give {{worst: NAME}}, {{mean: NAME}}, or NAME: weight")
            return {}
        if isinstance(data, str):
            if why := self._objection(model, data):
                self._fault(path, f"{data} {why}")
            return {data: 1.0}
        if not isinstance(data, Mapping) or not data:
            self._fault(path, f"{shown(data)} is neither a NAME nor a mapping {{NAME: weight}}")
            return {}
        weights = {}
        for name, value in data.items():
            why, weight = self._objection(model, name), _number(value)
            if why:
                self._fault((*path, name), why)
            elif weight is None or abs(weight) < SMALLEST_SIZE:
                form = f"give a number, negative to maximise, at least {SMALLEST_SIZE:g} in size"
                self._fault((*path, name), f"{shown(value)} is not a weight: {form}")
            else:
                weights[name] = weight
        return weights

    @property
    def _aggregate(self) -> Aggregate:
        """How the values of the objective over a range count, from the key of {worst: ...} or {mean: ...}."""
        data = self._data.get("objective")
        keys = [*data] if isinstance(data, Mapping) else []
        return next((each for each in (Aggregate.WORST, Aggregate.MEAN) if keys == [each.value]), Aggregate.AT)

    def _read_over(self, equalities: Sequence[str]) -> Over | None:
        """The range over which a design holds; None if it has none. It allows no ``equalities`` of scalars."""
        data, at, aggregate = self._data.get("over"), self._data.get("at"), self._aggregate
        if data is None:
            if aggregate is not Aggregate.AT:
                words = f"{aggregate} counts the values over a range: give the range, over: {{friction: [lo, hi]}}"
                self._fault(("objective", aggregate.value), words)
            if at is not None:
                self._fault(("at",), "is the value within a range at which the objective counts: give over too")
            return None
        if not isinstance(data, Mapping) or len(data) != 1:
            given = f"{len(data)} parameters" if isinstance(data, Mapping) else shown(data)
            self._fault(("over",), f"is {given}, but a design holds over one parameter: {{friction: [lo, hi]}}")
            return None
        ((key, limits),) = data.items()
        angle, path = self._is_angle(key), ("over", key)
        pair = limits if isinstance(limits, list | tuple) and len(limits) == 2 else ()
        numbers = [number for number in (_number(limit, angle=angle) for limit in pair) if number is not None]
        if len(numbers) != 2:
            self._fault(path, f"{shown(limits)} is not a range: give two numbers, [lo, hi]")
            return None
        lower, upper = numbers
        if not lower < upper:
            self._fault(path, f"[{lower:g}, {upper:g}] is empty: the lower limit comes first")
        for name in equalities:
            words = "is a single value, which one control does not meet on all of a range: give {min: a, max: b}"
            self._fault(("constraints", name), words)
        if self._free.get(key) is not None:
            self._fault(path, "is an unknown of the design: a parameter of the range has a number")
        if isinstance(self._modes, OpenSequence):
            self._fault(("over",), "needs a mode sequence at the problem's own value: state gait.phases")
        if not self._free and not (self._control and self._model and self._control.unknowns(self._model)):
            remedy = "free a parameter, {free: [lo, hi], guess: x}; continuation follows a gait over a range"
            self._fault(("over",), f"is for designs, and nothing is an unknown: {remedy}")
        if isinstance(self._control, OpenLoop) and self._control.duration is None:
            words = "open-loop torques end with the step of one floor: use constant_torque, pd or virtual_constraints"
            self._fault(("control", "type"), f"a design over a range needs a law that walks on all of it: {words}")
        return Over(key=str(key), lower=lower, upper=upper, aggregate=aggregate, at=self._read_at(key, numbers))

    def _read_at(self, key: str, limits: Sequence[float]) -> float | None:
        """The value at which the objective counts; None if all values count, or the problem's own one does."""
        at = self._data.get("at")
        if at is None:
            return None
        if self._aggregate is not Aggregate.AT:
            words = f"contradicts objective: {{{self._aggregate}: ...}}, which counts all values: leave one out"
            self._fault(("at",), words)
            return None
        value = _number(at[key], angle=self._is_angle(key)) if isinstance(at, Mapping) and [*at] == [key] else None
        if value is None:
            self._fault(("at",), f"{shown(at)} is not a value of the parameter in over: give {{{key}: number}}")
        elif not limits[0] <= value <= limits[1]:
            self._fault(("at", key), f"{value:g} lies outside of the range [{limits[0]:g}, {limits[1]:g}]")
        return value

    def _is_angle(self, key: str) -> bool:
        """Whether the parameter with this dotted key is an angle."""
        section, _, name = key.partition(".")
        fields = {} if self._model is None or section != "walker" else self._model.model_fields
        return name in fields and is_angle(fields[name])

    def _read_constraints(self) -> dict[str, Range]:
        """The ranges of the constraints by name; a single value is an equality."""
        data, path, model = self._data.get("constraints"), ("constraints",), self._model
        if data is None or model is None:
            return {}
        if not isinstance(data, Mapping):
            self._fault(path, f"{shown(data)} is not a mapping {{NAME: value}} or {{NAME: {{min, max}}}}")
            return {}
        ranges = {}
        open_loop = isinstance(self._control, OpenLoop) and self._control.duration is None
        for name, value in data.items():
            group, _, key = name.partition(".")
            angle = (group == "state" and key in model.shape) or self._is_angle(name) or name.startswith(ANGLE)
            if why := self._objection(model, name, constrains=True):
                self._fault((*path, name), why)
            elif span := self._read_range(value, (*path, name), angle=angle):
                ranges[name] = span
                if name == CLEARANCE and not 0 <= span.minimum < span.maximum == math.inf:
                    self._fault((*path, name), "is a height of the swing foot along the step: give {min: height in m}")
                elif name == "spectral_radius" and open_loop and span.minimum > -math.inf:
                    self._fault((*path, name), "has a largest value only for open-loop torques: give {max: 0.9}")
                elif name.startswith(ANGLE) and span.minimum == span.maximum:
                    self._fault((*path, name), "is a range along the whole step: give {min: a, max: b}")
                bounds = self._free.get(name)
                if bounds is not None and (span.minimum > bounds.upper or span.maximum < bounds.lower):
                    both = f"[{bounds.lower:g}, {bounds.upper:g}] of {name}: no value satisfies both"
                    self._fault((*path, name), f"contradicts the bounds {both}")
        return ranges

    def _joint_ranges(self, constraints: Mapping[str, Range]) -> dict[str, Range]:
        """The ranges of the joints of a robot that the problem does not constrain itself.

        They bound a step with open-loop torques.
        """
        model, law = self._model, self._control
        if model is None or not isinstance(law, OpenLoop) or law.duration is not None:
            return {}
        spans = {f"{ANGLE}{name}": span for name, (span, _) in joint_limits(model).items() if span is not None}
        return {
            name: Range(minimum=low, maximum=high) for name, (low, high) in spans.items() if name not in constraints
        }

    def _read_range(self, value: object, path: Key, *, angle: bool) -> Range | None:
        if not isinstance(value, Mapping):
            number = _number(value, angle=angle)
            if number is None:
                form = "a number or {min: a, max: b}, in SI" + (" or with deg" if angle else "")
                self._fault(path, f"{shown(value)} is not a constraint: {form}")
                return None
            return Range(minimum=number, maximum=number)
        span = self._section(AngleRangeSection if angle else RangeSection, value, path)
        if span is None:
            return None
        lowest = -math.inf if span.min is None else span.min
        return Range(minimum=lowest, maximum=math.inf if span.max is None else span.max)

    def _check_unknowns(self, objective: Mapping[str, float], constraints: Mapping[str, Range]) -> None:
        """Check that the number of unknowns suits the objective and the constraints.

        The coefficients of a free curve are unknowns too.
        """
        unknowns = len(self._free)
        if self._control and self._model:
            unknowns += len(self._control.unknowns(self._model))
        equalities = [name for name, span in constraints.items() if span.minimum == span.maximum]
        if not unknowns and (objective or constraints):
            path: Key = ("objective",) if objective else ("constraints",)
            remedy = "free a parameter of walker, friction or control: {free: [lo, hi], guess: x}"
            self._fault(path, f"too few unknowns: the gait has no free parameter to choose; {remedy}")
        elif len(equalities) > unknowns:
            given = f"{len(equalities)} equalities ({', '.join(equalities)}) for {unknowns} free parameters"
            self._fault(("constraints",), f"too few unknowns: {given}; free more, or turn a value into a range")
        elif unknowns and not objective and not constraints:
            path = tuple(next(iter(self._free), "control.reference").split("."))
            remedy = "add an objective or constraints, or give numbers"
            self._fault(path, f"too many unknowns: no objective or constraint determines them; {remedy}")


def _with(data: Mapping[str, Any], keys: tuple[str, ...], value: object) -> dict[str, Any]:
    """A copy of the data in which the entry under these keys has another value."""
    key, *rest = keys
    return {**data, key: _with(data[key], (*rest,), value) if rest else value}


def _at(section: BaseModel, keys: tuple[str, ...]) -> Any:
    """The field of a section with this key, or with two keys, an entry of the mapping in it."""
    value = getattr(section, keys[0])
    return value[keys[1]] if len(keys) > 1 else value


def _is_free(value: object) -> bool:
    return isinstance(value, Mapping) and "free" in value


def _number(value: object, *, angle: bool = False) -> float | None:
    try:
        return TypeAdapter[float](Angle if angle else Number).validate_python(value)
    except ValidationError:
        return None
