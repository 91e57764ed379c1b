"""From the data of a problem file to the fields of a problem statement; all faults are collected.

A free number, ``{free: [lo, hi], guess: x}``, is validated three times by the model of its section: guess, lower and
upper bound in the place of the number. The guess of a gait is a state on the section just after the impact: what the
section determines is filled in (both feet on the ground, x = 0, and dx = 0 unless the impact slips), and other values
in the file must agree with it.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, TypeAdapter, ValidationError

from gaitopt.errors import ProblemError
from gaitopt.model.checks import check_walker, section_posture
from gaitopt.model.control import BeyondEnd
from gaitopt.model.cycle import Cycle, ModeSequence
from gaitopt.model.declaration import calling
from gaitopt.model.modes import Mode
from gaitopt.model.registry import refused_walkers
from gaitopt.model.transitions import transitions
from gaitopt.model.units import SMALLEST, Angle, Number
from gaitopt.model.walker import Walker
from gaitopt.problem.faults import Fault, Key, near_miss, read_section, shown
from gaitopt.problem.scalars import DESIGN_SCALARS, MOTORS, PUSH, SCALARS
from gaitopt.problem.schema import (
    OPEN,
    SECTION_KEYS,
    AngleRangeSection,
    ConstantTorqueSpec,
    ControlSpec,
    CurveReference,
    CurveSpec,
    CycleSection,
    FreeSection,
    FrictionCoefficients,
    GaitReference,
    GaitSection,
    GuessSection,
    HeadSection,
    NoControlSpec,
    OpenGaitSection,
    PDSpec,
    RangeSection,
    StepSection,
    is_angle,
    state_section,
    torques_section,
)
from gaitopt.problem.statement import Free, Guess, OpenSequence, Range

Model = TypeVar("Model", bound=BaseModel)

CONTROLS = ("none", "constant_torque", "pd")
UNREAD = Free(lower=math.nan, upper=math.nan, guess=math.nan)
"""In place of an unknown whose own mapping has faults; its name may still be used."""


UNEVEN = "{} steps do not return to the first stance leg: where the legs differ, a cycle has 2, 4, ... steps"
SAME_STATE = 1e-5
"""Relative; a state written with six digits may be off by half of this."""


def assemble(data: Mapping[str, Any], walkers: Mapping[str, type[Walker]], faults: list[Fault]) -> dict[str, Any]:
    """The fields of a problem statement from its data; they are meaningful only if no fault was added."""
    return _StatementReader(data, walkers, faults).fields()


class _StatementReader:
    """Reads the sections of one problem, and collects its unknowns and all faults."""

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
            words = "is not a mapping; keys: model, and the model's parameters"
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
            words = f"so {kind} cannot act; allowed: none"
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
        """The data of a PD law with its reference read; a placeholder where that failed, to check the other keys."""
        if "reference" not in data:
            return dict(data)
        reference, path = data["reference"], ("control", "reference")
        read: GaitReference | CurveReference | None
        if isinstance(reference, Mapping) and "curve" in reference:
            curve = read_section(CurveSpec, reference["curve"], (*path, "curve"), self._faults)
            placeholder = curve or CurveSpec.model_construct(degree=1, start="")
            read = read_section(CurveReference, {**reference, "curve": placeholder}, path, self._faults)
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
            elif key not in freed:  # faults of an unknown's mapping are already reported
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


def _point_faults(curve: CurveSpec, walker: type[Walker]) -> Iterator[Fault]:
    """Control points must be those of the tracked joints, degree + 1 for each, within the bound."""
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


def read_gait(
    data: Mapping[str, Any], model: type[Walker] | None, walker: Walker | None, faults: list[Fault]
) -> tuple[Cycle | OpenSequence | None, Guess | None]:
    """The cycle and the guess; None where they have faults."""
    if "gait" not in data:
        return None, None
    if isinstance(data["gait"], Mapping) and data["gait"].get("phases") == OPEN:
        return _read_open(data["gait"], model, walker, faults)
    several = isinstance(data["gait"], Mapping) and "steps" in data["gait"]
    model_: type[CycleSection] | type[GaitSection] = CycleSection if several else GaitSection
    gait = read_section(model_, data["gait"], ("gait",), faults)
    if gait is None:
        return None, None
    steps = gait.steps if isinstance(gait, CycleSection) else (gait,)
    cycle = _read_cycle(steps, model, ("gait", "steps" if several else "phases"), faults)
    guess = read_section(GuessSection, gait.guess, ("gait", "guess"), faults)
    if guess is None:
        return cycle, None
    phases = [mode for step in steps for mode in step.phases]
    if guess.durations is not None and len(guess.durations) != len(phases):
        needed = f"one duration per phase ({', '.join(phases)})"
        message = f"{len(guess.durations)} given, but the gait needs {needed}; or leave durations out"
        faults.append(Fault(("gait", "guess", "durations"), message))
    state = None if model is None else _read_state(guess.state, model, walker, steps[-1].impact, faults)
    return cycle, None if state is None else Guess(state=state, durations=guess.durations)


def _read_open(
    data: Mapping[str, Any], model: type[Walker] | None, walker: Walker | None, faults: list[Fault]
) -> tuple[OpenSequence | None, Guess | None]:
    """A gait with an open mode sequence; a slip velocity that is left out of the guess is 0."""
    gait = read_section(OpenGaitSection, data, ("gait",), faults)
    if gait is None:
        return None, None
    least = 1 if model is None else model.steps_per_cycle()
    sequence = OpenSequence(impact=gait.impact, steps=max(gait.steps, least))
    if "steps" in gait.model_fields_set and gait.steps < least:
        faults.append(Fault(("gait", "steps"), UNEVEN.format(gait.steps)))
    guess = None if gait.guess is None else read_section(GuessSection, gait.guess, ("gait", "guess"), faults)
    if guess is None or model is None:
        return sequence, None
    if guess.durations is not None:
        faults.append(Fault(("gait", "guess", "durations"), "the phases are open: leave the durations out"))
    slip = guess.state.get("dx", 0.0)
    impact = Mode.slip(slip) if isinstance(slip, int | float) and slip else Mode.STICK
    state = _read_state(guess.state, model, walker, impact, faults)
    return sequence, None if state is None else Guess(state=state, durations=None)


def _read_cycle(
    steps: Sequence[StepSection], model: type[Walker] | None, path: Key, faults: list[Fault]
) -> Cycle | None:
    try:
        cycle = Cycle(tuple(ModeSequence(phases=step.phases, impact=step.impact) for step in steps))
        if model is not None:
            if len(steps) % model.steps_per_cycle():
                raise ValueError(UNEVEN.format(len(steps)))
            transitions(model).check(cycle)
        return cycle
    except ValueError as error:
        faults.append(Fault(path, str(error)))
        return None


def _read_state(
    data: Mapping[str, Any], model: type[Walker], walker: Walker | None, impact: Mode, faults: list[Fault]
) -> dict[str, float] | None:
    """The complete state, in the order of the walker's state names."""
    path: Key = ("gait", "guess", "state")
    section = read_section(state_section(model), data, path, faults)
    if section is None:
        return None
    given = section.model_dump(exclude_none=True)
    needed = model.section_names(slipping=impact.slips)
    missing = [name for name in needed if name not in given]
    faults += [
        Fault((*path, name), f"is missing; after this impact the section is {', '.join(needed)}") for name in missing
    ]
    faults += _slip_faults(given.get("dx", 0.0), impact, (*path, "dx")) if "dx" not in missing else []
    if missing or walker is None:
        return None
    state = (
        dict.fromkeys(walker.state_names(), 0.0)
        | _after_impact(given, walker)
        | {k: given[k] for k in needed if k in given}
    )
    undefined = [name for name, value in state.items() if not math.isfinite(value)]
    if undefined:
        words = ", ".join(f"{name} = {value:g}" for name, value in given.items())
        faults.append(Fault(path, f"with {words} the walker would start with {undefined[0]} = {state[undefined[0]]}"))
        return None
    for name, value in given.items():
        if name not in (*needed, "x", "dx") and not math.isclose(value, state[name], rel_tol=SAME_STATE):
            message = f"{value:g} contradicts the section: just after the impact it is {state[name]:.9g}; leave it out"
            faults.append(Fault((*path, name), message))
    state |= {name: given[name] for name in ("x", "dx") if name in given}
    return {name: float(state[name]) for name in walker.state_names()}


def _after_impact(given: Mapping[str, float], walker: Walker) -> dict[str, float]:
    """Shape coordinates and rates from those of the section."""
    model = type(walker)
    p = np.array([float(getattr(walker, name)) for name in model.model_fields])
    shape, rates = section_posture(model, given, p)
    names = (*walker.shape, *(f"d{name}" for name in walker.shape))
    return dict(zip(names, map(float, (*shape, *rates)), strict=True))


def _slip_faults(dx: float, impact: Mode, path: Key) -> list[Fault]:
    """A fault where the slip velocity does not have the sign of the impact."""
    if math.copysign(1.0, dx) * (dx != 0) == impact.direction:
        return []
    sign = {0: "= 0 (leave it out)", 1: "> 0", -1: "< 0"}[impact.direction]
    return [Fault(path, f"{shown(dx)} contradicts the impact: after {impact} it is {sign}")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scope:
    """The names that an objective or a constraint may use; None for parts that are open or have faults."""

    walker: type[Walker]
    control: ControlSpec | None
    cycle: Cycle | None
    free: Mapping[str, Free]

    @property
    def names(self) -> tuple[str, ...]:
        """Every name that may be used."""
        return (*DESIGN_SCALARS, *(f"state.{name}" for name in self.walker.state_names()), *self.free)

    def objection(self, name: str) -> str | None:
        """Why ``name`` cannot be used; None if it can."""
        if name not in self.names:
            return f"is no scalar of a gait and no freed parameter{near_miss(name, self.names)}"
        powers = (() if isinstance(self.control, NoControlSpec) else (MOTORS,)) + (
            (PUSH,) if self.walker.pushes else ()
        )
        if name in SCALARS and SCALARS[name].needs and not {*SCALARS[name].needs} & {*powers}:
            return "depends on the motors, and this walker is passive: give it a control, or choose another scalar"
        if name == "required_friction" and self.cycle and Mode.STICK not in self.cycle.phases:
            return "is defined for sticking phases, and this gait has none"
        return None

    def is_angle(self, name: str) -> bool:
        """Whether values of ``name`` may carry a unit of angle."""
        group, _, key = name.partition(".")
        fields = self.walker.model_fields
        return (group == "state" and key in self.walker.shape) or (
            group == "walker" and key in fields and is_angle(fields[key])
        )

    @property
    def unknowns(self) -> int:
        """Number of free parameters, coefficients of a free curve included."""
        count = len(self.free)
        if isinstance(self.control, PDSpec) and isinstance(self.control.reference, CurveReference):
            count += (self.control.reference.curve.degree + 1) * len(self.walker.tracked)
        return count


def read_objective(data: object, scope: Scope, faults: list[Fault]) -> dict[str, float]:
    """Weights by name, of a single name or a mapping; empty if there is no objective."""
    path: Key = ("objective",)
    if data is None:
        return {}
    if isinstance(data, str):
        faults += [Fault(path, f"{data} {why}") for why in [scope.objection(data)] if why]
        return {data: 1.0}
    if not isinstance(data, Mapping) or not data:
        faults.append(Fault(path, f"{shown(data)} is neither a NAME nor a mapping {{NAME: weight}}"))
        return {}
    weights = {}
    for name, value in data.items():
        why, weight = scope.objection(name), _number(value)
        if why:
            faults.append(Fault((*path, name), why))
        elif weight is None or abs(weight) < SMALLEST:
            message = (
                f"{shown(value)} is not a weight: give a number, negative to maximise, at least {SMALLEST:g} in size"
            )
            faults.append(Fault((*path, name), message))
        else:
            weights[name] = weight
    return weights


def read_constraints(data: object, scope: Scope, faults: list[Fault]) -> dict[str, Range]:
    """Ranges by name; a single value is an equality."""
    if data is None:
        return {}
    if not isinstance(data, Mapping):
        faults.append(
            Fault(("constraints",), f"{shown(data)} is not a mapping {{NAME: value}} or {{NAME: {{min, max}}}}")
        )
        return {}
    ranges = {}
    for name, value in data.items():
        why = scope.objection(name)
        if why:
            faults.append(Fault(("constraints", name), why))
        elif interval := _read_range(value, scope.is_angle(name), ("constraints", name), faults):
            ranges[name] = interval
            faults += _contradiction(name, interval, scope.free)
    return ranges


def check_unknowns(
    scope: Scope, objective: Mapping[str, float], constraints: Mapping[str, Range], faults: list[Fault]
) -> None:
    """Check that there are neither too few nor too many free parameters for the objective and constraints."""
    if scope.unknowns and scope.cycle is not None and len(scope.cycle.steps) > 1:
        message = "a design cannot have several steps: give numbers in place of free parameters, or a gait of one step"
        faults.append(Fault(("gait", "steps"), message))
    equalities = [name for name, span in constraints.items() if span.minimum == span.maximum]
    if not scope.unknowns and (objective or constraints):
        path: Key = ("objective",) if objective else ("constraints",)
        remedy = "free a parameter of walker, friction or control: {free: [lo, hi], guess: x}"
        faults.append(Fault(path, f"too few unknowns: the gait has no free parameter to choose; {remedy}"))
    elif len(equalities) > scope.unknowns:
        given = f"{len(equalities)} equalities ({', '.join(equalities)}) for {scope.unknowns} free parameters"
        faults.append(Fault(("constraints",), f"too few unknowns: {given}; free more, or turn a value into a range"))
    elif scope.unknowns and not objective and not constraints:
        key = next(iter(scope.free), "control.reference")
        remedy = "add an objective or constraints, or give numbers"
        faults.append(
            Fault(tuple(key.split(".")), f"too many unknowns: no objective or constraint determines them; {remedy}")
        )


def _read_range(value: object, angle: bool, path: Key, faults: list[Fault]) -> Range | None:
    if not isinstance(value, Mapping):
        number = _number(value, angle=angle)
        if number is None:
            form = "a number or {min: a, max: b}, in SI" + (" or with deg" if angle else "")
            faults.append(Fault(path, f"{shown(value)} is not a constraint: {form}"))
            return None
        return Range(minimum=number, maximum=number)
    span = read_section(AngleRangeSection if angle else RangeSection, value, path, faults)
    if span is None:
        return None
    if span.min is None and span.max is None:
        faults.append(Fault(path, "has neither min nor max: give one or both"))
        return None
    interval = Range(
        minimum=-math.inf if span.min is None else span.min, maximum=math.inf if span.max is None else span.max
    )
    if interval.minimum > interval.maximum:
        faults.append(Fault(path, f"is empty: min = {interval.minimum:g} is above max = {interval.maximum:g}"))
    return interval


def _contradiction(name: str, span: Range, free: Mapping[str, Free]) -> list[Fault]:
    """A fault where a constraint on a freed parameter excludes all values within the parameter's bounds."""
    if name not in free or not (span.minimum > free[name].upper or span.maximum < free[name].lower):
        return []
    bounds = f"[{free[name].lower:g}, {free[name].upper:g}]"
    return [Fault(("constraints", name), f"contradicts the bounds {bounds} of {name}: no value satisfies both")]


def _number(value: object, *, angle: bool = False) -> float | None:
    try:
        return TypeAdapter[float](Angle if angle else Number).validate_python(value)
    except ValidationError:
        return None
