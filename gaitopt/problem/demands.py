"""Objective and constraints of a design on scalars of the gait, and whether the unknowns suffice."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import TypeAdapter, ValidationError

from gaitopt.mechanics.cycle import Cycle
from gaitopt.mechanics.modes import Mode
from gaitopt.mechanics.units import SMALLEST, Angle, Number
from gaitopt.mechanics.walker import Walker
from gaitopt.problem.control_sections import ControlSpec, CurveReference, NoControlSpec, PDSpec
from gaitopt.problem.faults import Fault, Key, near_miss, read_section, shown
from gaitopt.problem.parts import Free, Range
from gaitopt.problem.scalars import DESIGN_SCALARS, MOTORS, PUSH, SCALARS
from gaitopt.problem.section import is_angle
from gaitopt.problem.sections import AngleRangeSection, RangeSection


@dataclass(frozen=True, slots=True, kw_only=True)
class Scope:
    """What the names in an objective or a constraint may refer to; None where it is open or at fault."""

    walker: type[Walker]
    control: ControlSpec | None
    cycle: Cycle | None
    free: Mapping[str, Free]

    @property
    def names(self) -> tuple[str, ...]:
        """Every name that may be used."""
        return (*DESIGN_SCALARS, *(f"state.{name}" for name in self.walker.state_names()), *self.free)

    def objection(self, name: str) -> str | None:
        """Why ``name`` cannot be used, if so."""
        if name not in self.names:
            return f"is no scalar of a gait and no freed parameter{near_miss(name, self.names)}"
        powers = (() if isinstance(self.control, NoControlSpec) else (MOTORS,)) + (
            (PUSH,) if self.walker.pushes else ()
        )
        if name in SCALARS and SCALARS[name].needs and not {*SCALARS[name].needs} & {*powers}:
            return (
                "is a quantity of the motors, and this walker is passive: give it a control, or choose another scalar"
            )
        if name == "required_friction" and self.cycle and Mode.STICK not in self.cycle.phases:
            return "is defined by sticking phases, and this gait has none"
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
    """Whether the free parameters are neither too few nor too many for objective and constraints."""
    if scope.unknowns and scope.cycle is not None and len(scope.cycle.steps) > 1:
        message = "several steps and unknown parameters do not go together yet: give numbers, or a gait of one step"
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
    """A constraint on a freed parameter has to leave something of the parameter's own bounds."""
    if name not in free or not (span.minimum > free[name].upper or span.maximum < free[name].lower):
        return []
    bounds = f"[{free[name].lower:g}, {free[name].upper:g}]"
    return [Fault(("constraints", name), f"contradicts the bounds {bounds} of {name}: no value satisfies both")]


def _number(value: object, *, angle: bool = False) -> float | None:
    try:
        return TypeAdapter[float](Angle if angle else Number).validate_python(value)
    except ValidationError:
        return None
