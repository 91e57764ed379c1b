"""The sections ``objective``, ``constraints``, ``over`` and ``at`` of a problem file, which state a design.

Their shapes and numbers are declared in ``gaitopt.problem.schema``. This module reads them for a walker, a control law
and a mode sequence: which scalars exist, which of them are angles, and whether the unknowns suffice.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

from gaitopt.display import counted
from gaitopt.model.control import Control, NoControl
from gaitopt.model.cycle import Cycle
from gaitopt.model.declaration import joint_limits
from gaitopt.model.open_loop import OpenLoop
from gaitopt.model.section import TOUCHDOWN
from gaitopt.model.units import Free
from gaitopt.model.walker import Walker
from gaitopt.problem.faults import Fault, Key, SectionReader, near_miss, read_value, shown
from gaitopt.problem.scalars import ANGLE, CLEARANCE, DESIGN_SCALARS, MOTORS, PUSH, SCALARS
from gaitopt.problem.schema import (
    ANGLE_CONSTRAINT,
    ANGLE_LIMITS,
    ANGLE_VALUE,
    CONSTRAINT,
    CONSTRAINTS,
    LIMITS,
    VALUE,
    WEIGHTS,
    Aggregate,
    is_angle,
)
from gaitopt.problem.statement import OpenSequence, Over, Range


class DesignReader(SectionReader):
    """Reads what a design minimises, which constraints it meets, and over which range of a parameter.

    Parameters
    ----------
    data, faults : see ``SectionReader``.
    model : class of the walker.
    control, modes : control law and mode sequence; None if they have faults.
    cycle_end : what ends a cycle.
    free : the unknown numbers by dotted key.
    """

    def __init__(
        self,
        data: Mapping[str, Any],
        faults: list[Fault],
        model: type[Walker],
        control: Control | None,
        modes: Cycle | OpenSequence | None,
        cycle_end: str,
        free: Mapping[str, Free[float]],
    ) -> None:
        super().__init__(data, faults)
        self._model, self._control, self._modes = model, control, modes
        self._cycle_end, self._free = cycle_end, free
        self._open_loop = control if isinstance(control, OpenLoop) and control.duration is None else None

    def read(self) -> dict[str, Any]:
        """Objective, constraints and range of the design."""
        objective, constraints = self._read_objective(), self._read_constraints()
        if not self._faults:
            self._check_unknowns(objective, constraints)
        equalities = [name for name, span in constraints.items() if span.is_equality and name not in self._free]
        return {
            "objective": objective,
            "constraints": constraints | self._joint_ranges(constraints),
            "over": self._read_over(equalities),
        }

    def _objection(self, name: str, *, constrains: bool = False) -> str | None:
        """The reason why an objective or a constraint cannot use a name; None if it can."""
        model = self._model
        cycle = self._modes if isinstance(self._modes, Cycle) else None
        durations = () if cycle is None else tuple(f"phases.{k}.duration" for k in range(len(cycle.phases)))
        names = (*DESIGN_SCALARS, *(f"state.{state}" for state in model.state_names()), *durations, *self._free)
        along = name == CLEARANCE or name.startswith(ANGLE)
        if self._control is not None and self._control.step_feedback is not None:
            names += tuple(f"control.{key}" for key in self._control.step_feedback.free)
        if self._open_loop is not None:
            if name == "foot_clearance":
                return "is the largest height of the swing foot; with open-loop torques state clearance: {min: height}"
            if name == "spectral_radius" and not constrains:
                return "is no objective of open-loop torques: bound it, constraints: {spectral_radius: {max: 0.9}}"
            names += tuple(f"control.{key}" for key in self._open_loop.unknowns(model))
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
        data, path = self._data.get("objective"), cast(Key, ("objective",))
        if data is None:
            return {}
        if self._aggregate is not Aggregate.AT:
            data, path = data[self._aggregate], (*path, self._aggregate.value)
        elif isinstance(data, Mapping) and {*data} & {Aggregate.WORST, Aggregate.MEAN}:
            rule = "counts the whole objective over a range: give {worst: NAME} or {mean: NAME} alone"
            self._fault(path, f"{' and '.join(map(str, data))}: worst or mean {rule}")
            return {}
        elif isinstance(data, Mapping) and len(data) == 1 and isinstance(next(iter(data.values())), str):
            name = next(iter(data))  # a scalar has a number as its weight
            reason = f"{shown(name)} is no way in which the values over a range count"
            self._fault(path, f"{reason}: give {{worst: NAME}}, {{mean: NAME}}, or NAME: weight")
            return {}
        if isinstance(data, str):
            if why := self._objection(data):
                self._fault(path, f"{data} {why}")
            return {data: 1.0}
        stated = data if isinstance(data, Mapping) else {}
        refused = {name: why for name in stated if (why := self._objection(str(name)))}
        self._faults += [Fault((*path, name), why) for name, why in refused.items()]
        if refused:  # their weights do not matter
            data = {name: weight for name, weight in stated.items() if name not in refused}
        return (self._value(WEIGHTS, data, path) or {}) if data or not refused else {}

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
                message = f"{aggregate} counts the values over a range: give the range, over: {{friction: [lo, hi]}}"
                self._fault(("objective", aggregate.value), message)
            if at is not None:
                self._fault(("at",), "is the value within a range at which the objective counts: give over too")
            return None
        if not isinstance(data, Mapping) or len(data) != 1:
            given = counted(len(data), "parameter") if isinstance(data, Mapping) else shown(data)
            self._fault(("over",), f"is {given}, but a design holds over one parameter: {{friction: [lo, hi]}}")
            return None
        ((key, limits),) = ((str(key), limits) for key, limits in data.items())
        path, angle = ("over", key), self._is_angle(key)
        read = self._value(ANGLE_LIMITS if angle else LIMITS, limits, path)
        if read is None:
            return None
        lower, upper = read
        if not lower < upper:
            self._fault(path, f"[{lower:g}, {upper:g}] is empty: the lower limit comes first")
        for name in equalities:
            reason = "is a single value, which one control does not meet on all of a range: give {min: a, max: b}"
            self._fault(("constraints", name), reason)
        if self._free.get(key) is not None:
            self._fault(path, "is an unknown of the design: a parameter of the range has a number")
        if isinstance(self._modes, OpenSequence):
            self._fault(("over",), "needs a mode sequence at the problem's own value: state gait.phases")
        if not self._free and not (self._control and self._control.unknowns(self._model)):
            remedy = "free a parameter, {free: [lo, hi], guess: x}; continuation follows a gait over a range"
            self._fault(("over",), f"is for designs, and nothing is an unknown: {remedy}")
        if self._open_loop is not None:
            limit = "open-loop torques end with the step of one floor: use constant_torque, pd or virtual_constraints"
            self._fault(("control", "type"), f"a design over a range needs a law that walks on all of it: {limit}")
        return Over(key=key, lower=lower, upper=upper, aggregate=aggregate, at=self._read_at(key, lower, upper))

    def _read_at(self, key: str, lower: float, upper: float) -> float | None:
        """The value at which the objective counts; None if all values count, or the problem's own one does."""
        at = self._data.get("at")
        if at is None:
            return None
        if self._aggregate is not Aggregate.AT:
            conflict = f"contradicts objective: {{{self._aggregate}: ...}}, which counts all values: leave one out"
            self._fault(("at",), conflict)
            return None
        faults, form = list[Fault](), ANGLE_VALUE if self._is_angle(key) else VALUE
        value = read_value(form, at[key], (), faults) if isinstance(at, Mapping) and [*at] == [key] else None
        if value is None:
            self._fault(("at",), f"{shown(at)} is not a value of the parameter in over: give {{{key}: number}}")
        elif not lower <= value <= upper:
            self._fault(("at", key), f"{value:g} lies outside of the range [{lower:g}, {upper:g}]")
        return value

    def _is_angle(self, key: str) -> bool:
        """Whether the parameter with this dotted key is an angle."""
        section, _, name = key.partition(".")
        fields = self._model.model_fields if section == "walker" else {}
        return name in fields and is_angle(fields[name])

    def _read_constraints(self) -> dict[str, Range]:
        """The ranges of the constraints by name; a single value is an equality."""
        ranges, data = dict[str, Range](), self._data.get("constraints")
        stated = {} if data is None else self._value(CONSTRAINTS, data, ("constraints",)) or {}
        for name, value in ((str(key), value) for key, value in stated.items()):
            path: Key = ("constraints", name)
            if why := self._objection(name, constrains=True):
                self._fault(path, why)
                continue
            group, _, key = name.partition(".")
            is_coordinate = group == "state" and key in self._model.shape
            angle = is_coordinate or self._is_angle(name) or name.startswith(ANGLE)
            read = self._value(ANGLE_CONSTRAINT if angle else CONSTRAINT, value, path)
            if read is None:
                continue
            lowest, highest = -math.inf if read.min is None else read.min, math.inf if read.max is None else read.max
            span = ranges[name] = Range(minimum=lowest, maximum=highest)
            if name == CLEARANCE and not 0 <= span.minimum < span.maximum == math.inf:
                self._fault(path, "is a height of the swing foot along the step: give {min: height in m}")
            elif name == "spectral_radius" and self._open_loop is not None and span.minimum > -math.inf:
                self._fault(path, "has a largest value only for open-loop torques: give {max: 0.9}")
            elif name.startswith(ANGLE) and span.is_equality:
                self._fault(path, "is a range along the whole step: give {min: a, max: b}")
            bounds = self._free.get(name)
            if bounds is not None and (span.minimum > bounds.upper or span.maximum < bounds.lower):
                both = f"[{bounds.lower:g}, {bounds.upper:g}] of {name}: no value satisfies both"
                self._fault(path, f"contradicts the bounds {both}")
        return ranges

    def _joint_ranges(self, constraints: Mapping[str, Range]) -> dict[str, Range]:
        """The ranges of the joints of a robot that the problem does not constrain itself.

        They bound a step with open-loop torques.
        """
        limits = {} if self._open_loop is None else joint_limits(self._model)
        spans = {f"{ANGLE}{name}": span for name, (span, _) in limits.items() if span is not None}
        return {
            name: Range(minimum=low, maximum=high) for name, (low, high) in spans.items() if name not in constraints
        }

    def _check_unknowns(self, objective: Mapping[str, float], constraints: Mapping[str, Range]) -> None:
        """Check that the number of unknowns suits the objective and the constraints.

        The coefficients of a free curve are unknowns too.
        """
        unknowns = len(self._free) + (0 if self._control is None else len(self._control.unknowns(self._model)))
        equalities = [name for name, span in constraints.items() if span.is_equality]
        if not unknowns and (objective or constraints):
            path: Key = ("objective",) if objective else ("constraints",)
            remedy = "free a parameter of walker, friction or control: {free: [lo, hi], guess: x}"
            self._fault(path, f"too few unknowns: the gait has no free parameter to choose; {remedy}")
        elif len(equalities) > unknowns:
            given = f"{counted(len(equalities), 'equality', 'equalities')} ({', '.join(equalities)})"
            given += f" for {counted(unknowns, 'free parameter')}"
            self._fault(("constraints",), f"too few unknowns: {given}; free more, or turn a value into a range")
        elif unknowns and not objective and not constraints:
            path = tuple(next(iter(self._free), "control.reference").split("."))
            remedy = "add an objective or constraints, or give numbers"
            self._fault(path, f"too many unknowns: no objective or constraint determines them; {remedy}")
