"""The motion that joints follow, as a problem file states it: five kinds of references, by their first key.

    constant, bezier    control points, which are numbers or unknowns of a design
    table               rows of angles, which are interpolated or fitted
    gait                the angles of another gait
    curve               control points that a design finds

Each reads its keys and returns a ``Curve``, once the gait that it names is known, which ``gaitopt.systems`` solves for.
The argument of the curve is that of the control law, ``OverPhase``, or the reference states it, ``Followed``: the time
since the impact or a phase variable.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, pi
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    TypeAdapter,
    ValidatorFunctionWrapHandler,
    WithJsonSchema,
    WrapValidator,
)

from gaitopt.arrays import Array
from gaitopt.display import counted
from gaitopt.model.curve import BeyondEnd, Curve, bernstein_matrix, bezier_curve, keys
from gaitopt.model.table import LARGEST_POINT, Table, table_curve
from gaitopt.model.units import DURATION, SMALLEST_SIZE, Angle, Duration, Free, Within, number_or_free, parse_angle
from gaitopt.model.walker import WalkerType
from gaitopt.threads import Uncompared, cached_method

Path = tuple[str | int, ...]
"""Keys that lead to a value."""
Fault = tuple[Path, str]
"""Keys of a mistake below those of the reference, and a message."""


OVERSHOOT, CURVE_POINTS = 10, 65
"""Largest size of a control point relative to that of the angle, because a curve does not pass through its control
points; and number of points at which the size of a curve is computed."""
MOST_KNOTS = 60
"""Largest number of rows of a table without a degree, because each knot divides the motion."""
PointValue = Annotated[
    float,
    Field(ge=-LARGEST_POINT, le=LARGEST_POINT, allow_inf_nan=False, strict=True),
    BeforeValidator(parse_angle),
    WithJsonSchema(
        {"anyOf": [{"type": "number", "minimum": -LARGEST_POINT, "maximum": LARGEST_POINT}, {"type": "string"}]}
    ),
]
"""A control point of a curve [rad, or m]; texts such as ``1 deg`` are converted."""


Point = Annotated[
    PointValue | Free[PointValue],
    number_or_free(TypeAdapter[float](PointValue), TypeAdapter(Free[PointValue])),
]
"""A control point: a number or an unknown."""
Points = Mapping[str, Sequence[float | Free[float]]]
"""Control points by joint."""


def _value(point: float | Free[float]) -> float:
    """A number, or the guess of an unknown."""
    return point.guess if isinstance(point, Free) else point


def _by_key(points: Points) -> dict[str, float | Free[float]]:
    """Control points by the keys of their parameters."""
    return {key: point for name, row in points.items() for key, point in zip(keys(name, row), row, strict=True)}


def _free(points: Points) -> dict[str, Free[float]]:
    """Those control points that are unknowns, by key."""
    return {key: point for key, point in _by_key(points).items() if isinstance(point, Free)}


def _free_bounds(points: Points) -> dict[str, tuple[float, float]]:
    """Bounds of those control points that are unknowns, by key."""
    return {key: point.free for key, point in _free(points).items()}


def _extremes(point: float | Free[float]) -> tuple[float, ...]:
    """A number, or the bounds of an unknown."""
    return point.free if isinstance(point, Free) else (point,)


def _largest_angle(name: str, walker: WalkerType) -> float:
    """Largest size of a shape coordinate, or of a motor's angle, which is the difference of two; inf for others."""
    if name in {*walker.shape} - {*walker.lengths}:
        return walker.largest_angle
    return 2 * walker.largest_angle if name in walker.actuators and not walker.lengths else inf


CLOCK = "clock"
"""Name of the time since the impact as the argument of curves, instead of a phase variable."""
Name = Annotated[str, Field(min_length=1, max_length=1000)]
"""Name or path of another problem."""
OF_PHASE = "argument of the curves: clock (time since the impact), a shape coordinate or a phase variable"
OF_SPAN = "values of the phase variable at the start and the end of the curves [rad, or m]"
PHASE_NAME = WithJsonSchema({"type": "string", "minLength": 1, "maxLength": 1000})
GivenPhase = Annotated[Name | None, PHASE_NAME, Field(description=OF_PHASE)]
Phase = Annotated[Name | None, Field(description=f"{OF_PHASE}; by default the clock")]
GivenSpan = Annotated[tuple[PointValue, PointValue] | None, Field(description=OF_SPAN)]
Span = Annotated[tuple[PointValue, PointValue] | None, Field(description=f"{OF_SPAN}; by default those of the gait")]
DEGREE = Field(ge=1, le=20, strict=True)
Invariant = Annotated[
    Literal[True] | None,
    BeforeValidator(lambda value: None if value is False else value),
    WithJsonSchema({"type": "boolean"}),
    Field(
        description="virtual constraints: the impact leads from the curves back to the curves, so that outputs and "
        "their rates are zero just after it; a design finds control points with which this holds"
    ),
]
OF_END = (
    "motion after the end of a reference in time: {}its last rate continues (linear), its last angle is held (hold), "
    "or the motors are off (off)"
)
Continuation = Annotated[
    Literal[BeyondEnd.LINEAR, BeyondEnd.HOLD, BeyondEnd.OFF] | None,
    Field(description=OF_END.format("")),
]
Joints = Annotated[
    dict[str, Name] | None,
    Field(
        min_length=1,
        description="for each joint, the angle of that gait that it follows: a shape coordinate, a motor or a phase "
        "variable; by default each tracked joint or output follows its own angle",
    ),
]
ARGUMENT = ("phase", "duration", "span", "beyond_end")
"""Keys of the argument of a curve, which a reference does not have if its control law states the argument."""


class Reference(BaseModel):
    """The motion that joints follow, as a key of a control law: its statement in the file, and its curve.

    The law collects the parameters, unknowns and faults of its references under the name of the key.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    _known: Curve | None = PrivateAttr(default=None)
    _over_law: bool = PrivateAttr(default=False)  # whether the control law states the argument of the curve
    _stated_at: Uncompared[Path] = PrivateAttr(default=Uncompared(()))  # see ``joints_path``

    def motion(self, phase: str = "", span: tuple[float, float] = (0.0, 1.0)) -> Curve:
        """The curve that the joints follow.

        Parameters
        ----------
        phase, span : the phase variable of the law and its values at both ends, for curves without an argument of
            their own [rad, or m].

        Raises
        ------
        ValueError
            If the curve depends on a gait that is not known yet.
        """
        return self._stated_motion(phase, span) if self._known is None else self._known

    @cached_method  # a law asks for the curve at each of its segments
    def _stated_motion(self, phase: str, span: tuple[float, float]) -> Curve:
        if self._over_law:
            return self._curve(phase, span, None)
        span = getattr(self, "span", None) or (0.0, getattr(self, "duration", None) or 1.0)
        beyond_end = getattr(self, "beyond_end", None)
        return self._curve(self.phase_variable, span, beyond_end and BeyondEnd(beyond_end))

    def with_curve(self, curve: Curve) -> Self:
        """The same reference with a known curve, such as that of the gait in ``source``."""
        known = self.model_copy()
        known._known = curve
        return known

    @property
    def parameters(self) -> Mapping[str, float]:
        """Values of the scalars that can be set, freed or continued, by key; unknowns have their guesses."""
        if self._known is not None:
            return self._known.parameters
        return {key: _value(point) for key, point in _by_key(self.points).items()}

    def unknowns(self, walker: WalkerType) -> Mapping[str, tuple[float, float]]:
        """Bounds of the parameters that a design determines rather than the problem file."""
        return _free_bounds(self.points) if self._known is None else self._known.bounds

    @property
    def structure(self) -> object:
        """A hashable value that is equal for references with equal expressions and any parameters."""
        bounds = (tuple(getattr(point, "free", None) for point in row) for row in self.points.values())
        stated = self.model_dump_json(exclude={"bezier", "constant"})
        known = None if self._known is None else id(self._known)
        return type(self), tuple(zip(self.points, bounds, strict=True)), stated, known

    def guesses(self, values: Mapping[str, float], walker: WalkerType) -> Mapping[str, object]:
        """Keys and values by which known values become the guesses, within their bounds; empty if none is known."""
        points, free = _by_key(self.points), _free(self.points)
        if not {*free} & {*values}:
            return {}
        known = points | {key: point.near(values.get(key, point.guess)).record for key, point in free.items()}
        rows = {name: [known[key] for key in keys(name, row)] for name, row in self.points.items()}
        return {self.kind: {name: row if len(row) > 1 else row[0] for name, row in rows.items()}}

    def followers(self, walker: WalkerType) -> tuple[str, ...]:
        """The joints that follow the motion; the tracked joints if none are stated."""
        return self.names or walker.tracked

    def followed(self, walker: WalkerType) -> Mapping[str, str]:
        """The angle of the gait in ``source`` for each joint: that in ``joints``, or by default its own."""
        stated: Mapping[str, str] | None = getattr(self, "joints", None)
        return stated or {name: name for name in self.followers(walker)}

    @property
    def phase_variable(self) -> str:
        """The phase variable over which the motion runs, if the reference states it; empty for the clock."""
        phase: str | None = vars(self).get("phase")
        return "" if phase in (None, CLOCK) else str(phase)

    @property
    def over_phase(self) -> bool:
        """Whether the argument of the curve is a phase variable."""
        return self._over_law or bool(self.phase_variable)

    @property
    def is_invariant(self) -> bool:
        """Whether a design keeps the curves invariant under the impact."""
        return bool(getattr(self._section[1], "invariant", None))

    @property
    def joints_path(self) -> Path:
        """The keys in the file under which the joints are listed: that of this kind, or of the one that became it."""
        return self._stated_at.value or (self.kind,)

    def faults(self, walker: WalkerType) -> Iterator[Fault]:
        """Mistakes in the reference for a walker: keys with a message for each."""
        yield from self._angle_faults(walker)
        yield from self._argument_faults()
        if not self._over_law:
            yield from self._joint_faults(walker)
        yield from self._kind_faults()

    def _angle_faults(self, walker: WalkerType) -> Iterator[Fault]:
        """Bounds of an unknown that contradict its guess, and angles that the walker never reaches."""
        limit = f"angles of {walker.model} are at most {walker.largest_angle:g} rad in size"
        for name, angles in self._angles.items():
            largest, beyond = _largest_angle(name, walker), list[Fault]()
            for path, point in self._points_of(name):
                if isinstance(point, Free):
                    yield from (((*path, *keys), message) for keys, message in point.faults())
                bound, reason = self.overshoot * largest, limit
                if bound > largest:
                    reason = f"control points are at most {bound:g} in size, because {limit}"
                sizes = [value for value in _extremes(point) if abs(value) > bound]
                beyond += [(path, f"{value:g} is impossible: {reason}") for value in sizes]
            size = float(np.abs(angles).max())
            if not beyond and size > largest:
                beyond = [self._fault_of(name, f"reaches {size:g} rad, which is impossible: {limit}")]
            yield from beyond[:1]

    def _argument_faults(self) -> Iterator[Fault]:
        """Keys that are missing although the argument of the curves needs them, or that belong to another argument."""
        known, (above, section) = type(self).model_fields, self._section
        duration = getattr(section, "duration", None)
        if self.over_phase and duration is not None:
            yield (*above, "duration"), "does not apply: curves of a phase variable have a span: [START, END]"
        if self.over_phase and "degree" in known and vars(self)["degree"] is None:
            remedy = "curves of a phase variable are polynomials: give degree: 6, or another number"
            yield ("degree",), f"is missing: {remedy}"
        if self._over_law or "phase" not in known:
            return
        span, beyond_end = (getattr(self, name, None) for name in ("span", "beyond_end"))
        if self.is_invariant:
            reason = "applies to virtual_constraints; under PD control joints leave their curves: leave it out"
            yield (*above, "invariant"), reason
        if not self.over_phase:
            if beyond_end is None:
                reason = "because a step may last longer than the reference"
                yield ("beyond_end",), f"is missing: give {self.continuations}, {reason}"
            if self._needs_ends and duration is None:
                remedy = "those of a phase variable need phase: NAME and span: [START, END]"
                yield (*above, "duration"), f"is missing: curves of time need their duration: SECONDS; {remedy}"
            if span is not None:
                yield ("span",), "does not apply to curves of time: leave it out, or give phase: NAME"
            return
        if self._needs_ends and span is None:
            yield ("span",), "is missing: curves of a phase variable need span: [START, END]"
        elif span is not None and span[0] == span[1]:
            yield ("span",), f"is empty: both ends are {span[0]:g}; give the phase after and before the impact"
        if beyond_end is not None:
            remedy = "curves of a phase variable continue as polynomials: leave it out"
            yield ("beyond_end",), f"applies only to curves of time; {remedy}"

    def _joint_faults(self, walker: WalkerType) -> Iterator[Fault]:
        """Joints that cannot follow the curves, and an unknown phase variable."""
        phase, angles = self.phase_variable, (*walker.shape, *walker.phases)
        for joint in self.names:
            if joint == phase:
                yield self._fault_of(joint, "is the phase variable and cannot follow a curve that depends on it")
            elif joint not in walker.tracked:
                known = f"the tracked joints are {', '.join(walker.tracked)}" if walker.tracked else "it tracks none"
                yield self._fault_of(joint, f"is not a tracked joint of {walker.model}; {known}")
        if phase and phase not in angles:
            known = f"it has {', '.join(angles)}; clock is the time since the impact"
            yield ("phase",), f"{walker.model} has no phase variable {phase!r}; {known}"
        elif phase in walker.tracked and not self.names and "joints" in type(self).model_fields:
            remedy = f"name the joints that can, joints: {{JOINT: {phase}}}"
            yield ("phase",), f"{phase} cannot follow a curve that depends on it: {remedy}"

    # properties that the kinds of references override

    kind: ClassVar[str] = ""
    overshoot: ClassVar[float] = OVERSHOOT
    continuations: ClassVar[str] = "linear, hold or off"

    @property
    def _section(self) -> tuple[Path, object]:
        """The section that has the keys ``duration`` and ``invariant``, and its path."""
        return (), self

    @property
    def _needs_ends(self) -> bool:
        """Whether the file must state the span or the duration of the curves."""
        return False

    @property
    def names(self) -> tuple[str, ...]:
        """The angles that have a curve, as far as they are stated."""
        return tuple(self.points)

    @property
    def points(self) -> Points:
        """Control points that the file states, by joint."""
        return {}

    @property
    def source(self) -> tuple[str, Path]:
        """Name or path of the problem whose gait is needed, and the key that states it; empty if there is none."""
        return "", ()

    @property
    def _angles(self) -> Mapping[str, Array]:
        """Angles on the stated curves, or an unknown's guess of them, by joint."""
        s = np.linspace(0, 1, CURVE_POINTS)
        rows = {name: [*map(_value, row)] for name, row in self.points.items() if row}
        return {name: bernstein_matrix(len(row) - 1, s) @ row for name, row in rows.items()}

    def _points_of(self, name: str) -> Sequence[tuple[Path, float | Free[float]]]:
        """Paths and values of the control points of a joint."""
        return [((*self.joints_path, name, k), point) for k, point in enumerate(self.points.get(name, ()))]

    def _fault_of(self, joint: str, message: str) -> Fault:
        """A fault of what the reference states about a joint; ``message`` continues the name of its key."""
        return (*self.joints_path, joint), message

    def _kind_faults(self) -> Iterator[Fault]:
        """Mistakes that only this kind of reference can have."""
        yield from ()

    def _curve(self, phase: str, span: tuple[float, float], beyond_end: BeyondEnd | None) -> Curve:
        if self.source[0]:
            raise ValueError(f"the motion follows from {self.source[0]}, which is not known")
        points = {name: tuple(map(_value, row)) for name, row in self.points.items()}
        return bezier_curve(points, span, phase=phase, beyond_end=beyond_end, bounds=_free_bounds(self.points))


class ConstantReference(Reference):
    """Constant angles."""

    kind, overshoot = "constant", 1.0
    constant: Annotated[
        dict[str, Point],
        Field(
            min_length=1,
            description="angle of each tracked joint [rad], a number or an unknown; the motor of a joint that is left "
            "out is off",
        ),
    ]

    @property
    def points(self) -> Points:
        """One control point per joint."""
        return {name: (point,) for name, point in self.constant.items()}

    def _points_of(self, name: str) -> Sequence[tuple[Path, float | Free[float]]]:
        return [((self.kind, name), self.constant[name])]


class BezierReference(Reference):
    """Bezier curves whose control points are given, or unknowns of a design."""

    kind = "bezier"
    bezier: Annotated[
        dict[str, tuple[Point, ...]],
        Field(description="control points of each curve [rad]; each is a number or an unknown"),
    ]
    invariant: Invariant = None
    phase: GivenPhase = CLOCK
    duration: Annotated[
        Duration | None,
        Field(description="duration of curves in time [s]; the step may end earlier or later"),
        Within(unit="time", possible=DURATION.possible, usual=DURATION.usual),
    ] = None
    span: GivenSpan = None
    beyond_end: Continuation = None

    @property
    def points(self) -> Points:
        """The control points."""
        return self.bezier

    @property
    def _needs_ends(self) -> bool:
        return True

    def _kind_faults(self) -> Iterator[Fault]:
        """No curve or too few control points."""
        if not self.bezier:
            yield ("bezier",), "has no curve: give the control points of a joint, {JOINT: [0, 0.1, 0.2]}"
        for name, row in self.bezier.items():
            if len(row) < 2:
                yield ("bezier", name), f"has {counted(len(row), 'control point')}, must have at least 2"
        if self._over_law and self.invariant and len(_free_bounds(self.bezier)) < 2 * len(self.bezier):
            rule = "needs two free control points or more of each joint"
            yield ("invariant",), f"{rule}: outputs and rates after the impact vanish"


class TableReference(Reference):
    """Curves through, or closest to, the rows of a table of angles."""

    kind = "table"
    table: Annotated[
        Table,
        Field(
            description="CSV file, relative to this file, or columns {t: [...], JOINT: [...]}; the first column is "
            "the time since the impact [s] or the phase variable, the others are joint angles [rad]"
        ),
        WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "object"}]}),
    ]
    degree: Annotated[
        int | None,
        DEGREE,
        Field(
            description="degree of the polynomials fitted to the rows; by default a cubic spline in time passes "
            "through all rows"
        ),
    ] = None
    phase: GivenPhase = CLOCK
    beyond_end: Continuation = None

    @property
    def names(self) -> tuple[str, ...]:
        """The angles that have a column."""
        return tuple(self.table.columns)[1:]

    @property
    def _angles(self) -> Mapping[str, Array]:
        """The columns of the joints."""
        return {name: self.table.columns[name] for name in self.names}

    def _fault_of(self, joint: str, message: str) -> Fault:
        return ("table",), f"{self.table.file}: {joint} {message}"

    def _kind_faults(self) -> Iterator[Fault]:
        """A first column that does not suit the argument, and a degree that does not suit the rows."""
        first, argument = next(iter(self.table.columns.items()))
        rows, expected = len(argument), self.phase_variable or "t"
        if not self._over_law and first != expected:
            mismatch = f"its first column is {first}, but must be {expected}, the argument of the curves"
            yield ("table",), f"{self.table.file}: {mismatch}"
        elif not self.over_phase and (argument[0] != 0 or argument[-1] < 0):
            ends = f"t starts at {argument[0]:g} and ends at {argument[-1]:g}"
            yield ("table",), f"{self.table.file}: {ends}, but must rise from 0, the time of the impact"
        if self.degree is None and not self.over_phase and rows > MOST_KNOTS:
            limit = f"a spline through {rows} rows divides the motion at every row; use at most {MOST_KNOTS}"
            yield ("degree",), f"is missing: {limit}; give degree: 8, or another number, for polynomials"
        elif self.degree is not None and self.degree >= rows:
            yield ("degree",), f"{self.degree} is too large: {rows} rows determine at most {rows - 1}"

    def _curve(self, phase: str, span: tuple[float, float], beyond_end: BeyondEnd | None) -> Curve:
        return table_curve(self.table, self.degree, phase, beyond_end)


class GaitReference(Reference):
    """The angles of another gait: its motion in time, or polynomials in a phase variable that are closest to it."""

    kind, continuations = "gait", "flow, linear, hold or off"
    gait: Annotated[
        Name,
        Field(
            description="gait that is tracked: the name of a problem, its path relative to this file, or a run folder"
        ),
    ]
    joints: Joints = None
    degree: Annotated[
        int | None,
        DEGREE,
        Field(description="degree of the polynomials fitted to the gait's angles as functions of a phase variable"),
    ] = None
    phase: Phase = None
    span: Span = None
    beyond_end: Annotated[
        BeyondEnd | None,
        Field(description=OF_END.format("that of the gait without an impact (flow), ")),
    ] = None

    @property
    def names(self) -> tuple[str, ...]:
        """The angles that follow one of the gait, as far as they are stated."""
        return tuple(self.joints or ())

    @property
    def source(self) -> tuple[str, Path]:
        """The tracked gait."""
        return (self.gait, ("gait",)) if self._known is None else ("", ())

    def _fault_of(self, joint: str, message: str) -> Fault:
        return ("joints", joint), message

    def _kind_faults(self) -> Iterator[Fault]:
        """A degree without a phase variable."""
        if not self.over_phase and self.degree is not None:
            yield ("degree",), "does not apply: without a phase variable the motion of the gait itself is followed"


class CurveSpec(BaseModel):
    """A smooth curve per joint whose coefficients are unknowns."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    degree: Annotated[int, DEGREE, Field(description="degree of the curve of each joint")]
    start: Annotated[
        Name | None,
        Field(
            description="name or path of the problem whose gait gives the first guess; not needed if points and a "
            "duration or a span are given"
        ),
    ] = None
    within: Annotated[
        Angle,
        Field(
            ge=SMALLEST_SIZE,
            le=pi,
            description="largest size of the control points, which bounds the angles [rad]",
        ),
        Within(usual=(0.01, pi)),
    ] = 0.6
    duration: Annotated[
        Duration | None,
        Field(description="duration of curves in time [s]; by default the period of the gait of start"),
        Within(unit="time", possible=DURATION.possible, usual=(0.1, DURATION.usual[1])),
    ] = None
    points: Annotated[
        dict[str, tuple[Angle, ...]] | None,
        Field(
            description="first guess of the degree + 1 Bezier control points of each joint [rad]; by default those "
            "closest to the gait of start"
        ),
    ] = None
    invariant: Invariant = None


class CurveReference(Reference):
    """Curves that a design finds."""

    kind = "curve"
    curve: CurveSpec
    joints: Joints = None
    phase: Phase = None
    span: Span = None
    beyond_end: Continuation = None

    @property
    def names(self) -> tuple[str, ...]:
        """The angles that have a curve, as far as they are stated.

        In time, all tracked joints follow a start unless ``joints`` names some.
        """
        by_points = self.over_phase or self.curve.start is None
        return tuple(self.joints or (self.curve.points if by_points else None) or ())

    @property
    def _section(self) -> tuple[Path, object]:
        return ("curve",), self.curve

    @property
    def _needs_ends(self) -> bool:
        return self.curve.start is None and bool(self.curve.points)

    @property
    def source(self) -> tuple[str, Path]:
        """The gait from which the curves start."""
        return (self.curve.start or "", ("curve", "start")) if self._known is None else ("", ())

    def zeros(self, walker: WalkerType) -> dict[str, tuple[float, ...]]:
        """Control points of curves that are zero, by joint."""
        return dict.fromkeys(self.followers(walker), (0.0,) * (self.curve.degree + 1))

    def unknowns(self, walker: WalkerType) -> Mapping[str, tuple[float, float]]:
        """Bounds of the control points, which a design determines."""
        return _free_bounds(self._unknown(self.zeros(walker))) if self._known is None else self._known.bounds

    def guesses(self, values: Mapping[str, float], walker: WalkerType) -> Mapping[str, object]:
        """The control points, within their bound; empty if some are missing."""
        bound, zeros = self.curve.within, self.zeros(walker)
        if not {*_by_key(zeros)} <= {*values}:
            return {}
        rows = {name: [values[key] for key in keys(name, row)] for name, row in zeros.items()}
        return {"curve.points": {name: np.clip(row, -bound, bound).tolist() for name, row in rows.items()}}

    def _fault_of(self, joint: str, message: str) -> Fault:
        return ("joints", joint) if self.joints else ("curve", "points", joint), message

    def _joint_faults(self, walker: WalkerType) -> Iterator[Fault]:
        """Joints that cannot follow the curves, and points of others than those that do."""
        yield from super()._joint_faults(walker)
        points, joints = self.curve.points, self.followers(walker)
        if points is not None and {*points} != {*joints}:
            given, which = ", ".join(points) or "no joint", "the joints" if self.joints else "the tracked joints"
            yield ("curve", "points"), f"are given for {given}; {which} are {', '.join(joints)}"

    def _kind_faults(self) -> Iterator[Fault]:
        """Points that do not suit the degree or the bound, and keys that suit another first guess."""
        points, start, needed = self.curve.points, self.curve.start, self.curve.degree + 1
        for name, values in (points or {}).items():
            if len(values) != needed:
                rule = f"a curve of degree {self.curve.degree} has {needed}"
                yield ("curve", "points", name), f"has {counted(len(values), 'control point')}, but {rule}"
            for k, value in enumerate(values):
                if abs(value) > self.curve.within:
                    yield ("curve", "points", name, k), f"{value:g} is outside of within = {self.curve.within:g}"
        if start is None and self.joints is not None:
            yield ("joints",), "applies only to curves whose first guess is a gait: give curve.start, or leave it out"
        elif start is None and not points:
            remedy = "give a problem whose gait is the first guess, or the control points of the guess, "
            yield ("curve", "start"), f"is missing: {remedy}points: {{JOINT: [0, 0.1, 0.2]}}"

    def with_points(self, points: Mapping[str, tuple[float, ...]], span: tuple[float, float], phase: str) -> Self:
        """The same reference with these control points, which are unknowns, over ``span``: times [s], or a phase."""
        bounds, end = _free_bounds(self._unknown(points)), None if phase else self.beyond_end
        return self.with_curve(bezier_curve(points, span, phase=phase, beyond_end=end, bounds=bounds))

    @property
    def given(self) -> Reference:
        """Bezier curves whose points are unknowns, if no start is needed; otherwise this reference.

        Such curves have points of the right number and size, and either a duration or a span. Others have faults to
        report.
        """
        curve, points, key = self.curve, self.curve.points or {}, "span" if self.phase_variable else "duration"
        end: object = self.span if self.phase_variable else curve.duration
        right = (len(row) == curve.degree + 1 and max(map(abs, row)) <= curve.within for row in points.values())
        unused = (curve.start, self.joints, curve.duration if self.over_phase else self.span)
        if any(unused) or not (points and all(right)) or not (self._over_law or (end and not curve.invariant)):
            return self
        stated: dict[str, object] = {"bezier": self._unknown(points), "invariant": curve.invariant}
        if not self._over_law:
            stated |= {"phase": self.phase or CLOCK, key: end, "beyond_end": self.beyond_end}
        reference = _stated(BezierReference, stated, self._over_law)
        reference._stated_at = Uncompared(("curve", "points"))
        return reference

    def _unknown(self, points: Mapping[str, tuple[float, ...]]) -> Points:
        """Control points as unknowns within their bound, by joint."""
        span = (-self.curve.within, self.curve.within)
        return {name: tuple(Free[float](free=span, guess=value) for value in row) for name, row in points.items()}


# reading


FORMS: Mapping[type[Reference], str] = {
    ConstantReference: "constant: {JOINT: 10 deg}",
    BezierReference: "bezier: {JOINT: [0, 0.1, 0.2]}, duration: 0.8, beyond_end: hold",
    TableReference: "table: file.csv, beyond_end: hold",
    GaitReference: "gait: NAME, beyond_end: flow",
    CurveReference: "curve: {degree: 5, start: NAME}, beyond_end: linear",
}
"""An example of each kind of reference that states its argument."""
PHASE_FORMS: Mapping[type[Reference], str] = {
    BezierReference: "bezier: {ANGLE: [0, 0.1, 0.2]}",
    ConstantReference: "constant: {ANGLE: 10 deg}",
    TableReference: "table: file.csv, degree: 6",
    GaitReference: "gait: NAME, degree: 6",
    CurveReference: "curve: {degree: 5, start: NAME}",
}
"""An example of each kind of reference over the phase variable of a control law."""


def _reader(forms: Mapping[type[Reference], str], *, over_law: bool, optional: bool = False) -> WrapValidator:
    """A validator that reads a reference by its keys; a ``Curve`` becomes a reference with this curve."""

    def read(value: Any, handler: ValidatorFunctionWrapHandler) -> Reference | None:
        if isinstance(value, Reference) or (optional and value is None):
            return value
        if isinstance(value, Curve):
            return Reference().with_curve(value)
        kinds = [kind for kind in forms if isinstance(value, Mapping) and kind.kind in value]
        if len(kinds) != 1:
            both = " and ".join(kind.kind for kind in kinds)
            given = f"has both {both}" if kinds else "does not say what to follow"
            raise ValueError(f"{given}: give one of {' or '.join(f'{{{form}}}' for form in forms.values())}")
        (kind,) = kinds
        known = [key for key in kind.model_fields if not (over_law and key in ARGUMENT)]
        unknown = [str(key) for key in value if key not in known]
        if unknown:
            reason = f"{', '.join(unknown)} {'does' if len(unknown) == 1 else 'do'} not belong to {kind.kind}"
            raise ValueError(f"{reason}, which has the keys {', '.join(known)}: {{{forms[kind]}}}")
        reference = _stated(kind, value, over_law)
        return reference.given if isinstance(reference, CurveReference) else reference

    return WrapValidator(read)


def _stated(kind: type[Reference], value: Mapping[str, object], over_law: bool) -> Reference:
    """A reference with these keys, without a phase variable of its own if the control law states the argument."""
    without = over_law and "phase" in kind.model_fields
    reference = kind.model_validate({**value, "phase": None} if without else value)
    reference._over_law = over_law
    return reference


@dataclass(frozen=True)
class Without:
    """Annotation of a section: keys that its model has, but that do not apply here."""

    keys: tuple[str, ...]


Followed = Annotated[
    GaitReference | CurveReference | ConstantReference | BezierReference | TableReference,
    _reader(FORMS, over_law=False),
]
"""Type of the key ``reference``; besides the forms of a file it accepts a ``Curve``."""
OverPhase = Annotated[
    BezierReference | ConstantReference | TableReference | GaitReference | CurveReference,
    _reader(PHASE_FORMS, over_law=True),
    Without(ARGUMENT),
]
"""Type of the key ``reference`` of curves over the phase variable of a control law."""
OtherOverPhase = Annotated[
    BezierReference | None,
    _reader({BezierReference: PHASE_FORMS[BezierReference]}, over_law=True, optional=True),
    Without(ARGUMENT),
]
"""Type of the key ``other_reference`` of such curves."""


def exchanged_points(reference: Reference, other: BezierReference | None) -> dict[str, str]:
    """Keys of the control points of a reference, with those of the one that applies in every second step, if any."""
    return {f"reference.{key}": f"other_reference.{key}" for key in (() if other is None else reference.parameters)}


def faults_of_other(reference: Reference, other: BezierReference | None) -> Iterator[Fault]:
    """Differences between two references beyond the values of their control points."""
    if other is None:
        return
    if isinstance(reference, BezierReference) and {*reference.parameters} == {*other.parameters}:
        one, two = (each.model_dump(exclude={"bezier"}) for each in (reference, other))
        if one == two:
            return
    mismatch = "differs from the reference in more than its control points: give both joints, degree and argument"
    yield ("other_reference",), f"{mismatch}, {{bezier: ...}}, alike"
