"""References: motions that joints follow, over the time t since the last impact.

A ``Reference`` theta_r consists of Chebyshev series, one piece per segment. Pieces meet at breakpoints, where the curve
may have a kink or, with ``off``, the control ends. The last piece applies up to ``horizon``.

A ``BezierCurve`` has control points c_k that are parameters, which can be set, freed or continued,

    theta_r(t) = sum_k c_k B_k(s),    B_k(s) = C(n, k) s^k (1 - s)^(n - k),    s = t / duration,    t < duration

Such a curve stays within the range of its control points. It starts at the first and ends at the last one, and its rate
at the end, n (c_n - c_(n-1)) / duration, determines its continuation.

``GaitReference`` and ``CurveReference`` are what a problem file says; ``gaitopt.systems`` replaces them by a
``Reference`` and a ``BezierCurve`` once the gait that they name is known.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import comb, pi
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from casadi import SX, dot, horzcat, horzsplit, reshape, vertcat, vertsplit
from numpy.polynomial import chebyshev
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    InstanceOf,
    TypeAdapter,
    ValidatorFunctionWrapHandler,
    WithJsonSchema,
    WrapValidator,
)
from pydantic.json_schema import SkipJsonSchema

from gaitopt.arrays import Array
from gaitopt.model.units import DURATION, SMALLEST, Angle, Duration, Within, parse_angle

if TYPE_CHECKING:
    from gaitopt.model.control import Instant
    from gaitopt.model.walker import WalkerType

BLOCK = 6
"""Terms of a series that are summed directly: about the root of their number, which is 33 for a phase of walking."""


Path = tuple[str | int, ...]
"""Keys that lead to a value."""


class BeyondEnd(StrEnum):
    """Continuation of a reference after its end."""

    FLOW = "flow"
    LINEAR = "linear"
    HOLD = "hold"
    OFF = "off"


class Target:
    """A motion that joints follow: the value of a key of a control law.

    The law collects the parameters, unknowns and faults of its targets under the name of the key.
    """

    __slots__ = ()

    @property
    def parameters(self) -> Mapping[str, float]:
        """Values of the scalars that can be set, freed or continued, by name: ``theta1.0``."""
        return {}

    @property
    def structure(self) -> object:
        """A hashable value that is equal for targets with equal expressions, whatever their parameters."""
        return self.model_dump_json() if isinstance(self, BaseModel) else id(self)

    @property
    def source(self) -> tuple[str, Path]:
        """Name or path of the problem whose gait is needed, and the key that gives it; empty if there is none."""
        return "", ()

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times since impact at which a segment ends and the next begins [s]."""
        return ()

    @property
    def horizon(self) -> float:
        """Time since impact up to which the motion is defined [s]."""
        return np.inf

    def data(self, segment: int) -> Array:
        """Segment data, of the same length in all segments."""
        return np.zeros(0)

    def unknowns(self, walker: "WalkerType") -> Mapping[str, tuple[float, float]]:
        """Bounds of the parameters that a design determines rather than the problem file."""
        return {}

    def guesses(self, values: Mapping[str, float], walker: "WalkerType") -> Mapping[str, object]:
        """Keys and values that make known values of the unknowns their first guess; empty if some are missing."""
        return {}

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """What is wrong with the target for a walker, by key."""
        yield from ()

    def joints(self, walker: "WalkerType") -> tuple[str, ...]:
        """The joints that follow the motion."""
        return walker.tracked

    def weighted(
        self, now: "Instant", p: SimpleNamespace, joints: Sequence[str], weights: tuple[SX, SX]
    ) -> tuple[SX, SX]:
        """Weighted sum of angle and rate of every joint, shape (n,), and a factor: 1 while it acts, 0 when it is off.

        Parameters
        ----------
        p : the target's own parameters by name.
        joints : shape coordinates that follow the motion.
        """
        raise NotImplementedError


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A smooth piece of the curve.

    Attributes
    ----------
    start, end : time since impact [s]; ``end`` scales the series and does not have to be reached.
    angles : ndarray, shape (n_u, degree + 1) - Chebyshev coefficients of the angles [rad].
    rates : ndarray, shape (n_u, degree + 1) - of their rates [rad/s].
    active : False where the control is switched off.
    """

    start: float
    end: float
    angles: Array
    rates: Array
    active: bool = True

    def __call__(self, t: float) -> tuple[Array, Array]:
        """Angles [rad] and rates [rad/s] at a time since impact [s], shape (n_u,) each."""
        s = 2 * (t - self.start) / (self.end - self.start) - 1
        angles, rates = (np.asarray(chebyshev.chebval(s, table.T)) for table in (self.angles, self.rates))
        return angles, rates


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference(Target):
    """Pieces in order of time; they are defined up to ``horizon``, a time since impact [s]."""

    pieces: tuple[Piece, ...]
    horizon: float = np.inf

    @property
    def degree(self) -> int:
        """Largest degree of all series."""
        return max(len(table.T) for piece in self.pieces for table in (piece.angles, piece.rates)) - 1

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times since impact at which one piece ends and the next begins [s]."""
        return tuple(piece.start for piece in self.pieces[1:])

    def data(self, segment: int) -> Array:
        """The numbers of one piece in the layout that ``evaluate`` reads."""
        piece, width = self.pieces[segment], self.degree + 1
        series = [np.pad(row, (0, width - row.size)) for table in (piece.angles, piece.rates) for row in table]
        return np.concatenate([[piece.start, piece.end, float(piece.active)], *series])

    def weighted(
        self, now: "Instant", p: SimpleNamespace, joints: Sequence[str], weights: tuple[SX, SX]
    ) -> tuple[SX, SX]:
        """The series of the piece in this segment."""
        return evaluate(now.r, now.t, len(joints), self.degree, weights)

    def __call__(self, times: Sequence[float] | Array) -> tuple[Array, Array]:
        """Angles [rad] and rates [rad/s] at times since impact [s]; both of shape (n_u, n)."""
        t = np.asarray(times, dtype=float)
        index = np.searchsorted(self.breakpoints, t, side="right")
        columns = [self.pieces[k](time) for k, time in zip(index, t, strict=True)]
        angles, rates = zip(*columns, strict=True)
        return np.column_stack(angles), np.column_stack(rates)


def evaluate(data: SX, t: SX, n_tracked: int, degree: int, weights: tuple[SX, SX]) -> tuple[SX, SX]:
    """Weighted sum of angle and rate of every joint, and whether the control acts, from ``Reference.data``.

    The series of angle and rate are added before they are evaluated, which halves their number.
    """
    s = 2 * (t - data[0]) / (data[1] - data[0]) - 1
    angles, rates = (reshape(rows, degree + 1, n_tracked) for rows in vertsplit(data[3:], (degree + 1) * n_tracked))
    powers = _chebyshev(s)
    sums = horzsplit(weights[0] * angles + weights[1] * rates)
    return vertcat(*(_sum(vertsplit(c), powers) for c in sums)), data[2]


def continued(pieces: Sequence[Piece], end: float, beyond_end: BeyondEnd) -> Reference:
    """The reference of ``pieces`` up to the time ``end``, then ``linear``, ``hold`` or ``off``.

    ``flow`` needs the equations of motion of the walker that moves so; see ``gaitopt.systems``.
    """
    last = pieces[-1]
    angles, rates = last(end)
    if beyond_end is not BeyondEnd.LINEAR:
        rates = np.zeros_like(rates)
    # on [end, end + 1] the series variable is s = 2 (t - end) - 1, so that angle = (angle + rate/2) + rate/2 s
    tail = Piece(
        start=end,
        end=end + 1.0,
        angles=np.column_stack([angles + rates / 2, rates / 2]),
        rates=rates[:, None],
        active=beyond_end is not BeyondEnd.OFF,
    )
    return Reference(pieces=(*pieces, tail))


def _chebyshev(s: SX) -> list[SX]:
    """T_0, ..., T_BLOCK at ``s``, by T_2k = 2 T_k^2 - 1 and T_2k+1 = 2 T_k T_k+1 - T_1."""
    values = [SX(1), s]
    for k in range(2, BLOCK + 1):
        values.append(2 * values[k // 2] * values[(k + 1) // 2] - values[k % 2])
    return values


def _sum(c: list[SX], T: list[SX]) -> SX:
    """Chebyshev series sum_k c_k T_k from T_0, ..., T_m: blocks of m terms, and Clenshaw's recurrence over T_jm.

    With T_jm+k = 2 T_jm T_k - T_jm-k the series is sum_j q_j T_jm, where q_j is a sum over T_0, ..., T_m-1 and T_jm is
    T_j(T_m). This takes one product of variables per block instead of one per term, and such products dominate the cost
    of a Taylor series of the motion.
    """
    m, c = len(T) - 1, list(c)
    for n in reversed(range(m + 1, len(c))):
        if n % m:
            c[n - 2 * (n % m)] -= c[n]
            c[n] = 2 * c[n]
    blocks = [sum(a * b for a, b in zip(c[j : j + m], T, strict=False)) for j in range(0, len(c), m)]
    b1, b2 = SX(0), SX(0)
    for q in reversed(blocks[1:]):
        b1, b2 = q + 2 * T[m] * b1 - b2, b1
    return blocks[0] + T[m] * b1 - b2


@dataclass(frozen=True, slots=True, kw_only=True)
class BezierCurve(Target):
    """One Bezier curve per joint, whose clock restarts at every impact.

    Attributes
    ----------
    points : control points of the curve of each joint [rad], the same number for all joints.
    duration : of the curves [s]; the step may end earlier or later.
    beyond_end : continuation after ``duration``: ``linear``, ``hold`` or ``off``.
    within : bound of the modulus of control points that are unknowns [rad].
    """

    points: Mapping[str, tuple[float, ...]]
    duration: float
    beyond_end: BeyondEnd
    within: float

    @property
    def degree(self) -> int:
        """Degree n of the curves."""
        return len(next(iter(self.points.values()))) - 1

    @property
    def parameters(self) -> Mapping[str, float]:
        """The control points as ``JOINT.K``."""
        return {f"{name}.{k}": c for name, row in self.points.items() for k, c in enumerate(row)}

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """The end of the curves."""
        return (self.duration,)

    def data(self, segment: int) -> Array:
        """Weights of the curve and of its continuation: (1, 0), then (0, 1)."""
        return np.array([1.0, 0.0] if segment == 0 else [0.0, 1.0])

    def unknowns(self, walker: "WalkerType") -> Mapping[str, tuple[float, float]]:
        """Bounds of the control points."""
        return dict.fromkeys(self.parameters, (-self.within, self.within))

    def weighted(
        self, now: "Instant", p: SimpleNamespace, joints: Sequence[str], weights: tuple[SX, SX]
    ) -> tuple[SX, SX]:
        """The curves, and then their continuation."""
        points = horzcat(*(getattr(p, joint) for joint in joints))

        def total(angles: SX, rates: SX) -> SX:
            return weights[0] * angles + weights[1] * rates

        curve = total(*self._curve(points, now.t / self.duration))
        if self.beyond_end is BeyondEnd.OFF:
            return curve, now.r[0]
        end, rate = self._curve(points, SX(1))
        hold = self.beyond_end is BeyondEnd.HOLD
        after = total(end, SX.zeros(rate.numel())) if hold else total(end + rate * (now.t - self.duration), rate)
        return now.r[0] * curve + now.r[1] * after, SX(1)

    def _curve(self, points: SX, s: SX) -> tuple[SX, SX]:
        """Angles and rates of the curves at the phase ``s``."""
        slopes = self.degree / self.duration * (points[1:, :] - points[:-1, :])
        return points.T @ _bernstein(self.degree, s), slopes.T @ _bernstein(self.degree - 1, s)


LARGEST_POINT = 1000
PointValue = Annotated[
    float,
    Field(ge=-LARGEST_POINT, le=LARGEST_POINT, allow_inf_nan=False, strict=True),
    BeforeValidator(parse_angle),
    WithJsonSchema(
        {"anyOf": [{"type": "number", "minimum": -LARGEST_POINT, "maximum": LARGEST_POINT}, {"type": "string"}]}
    ),
]
"""A control point of a curve [rad, or m]; texts such as ``1 deg`` are converted."""


class FreePoint(BaseModel):
    """A control point that is an unknown."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    free: Annotated[tuple[PointValue, ...], Field(min_length=2, max_length=2, description="bounds [lo, hi]")]
    guess: Annotated[PointValue, Field(description="first guess, within the bounds")]


def _read_point(value: Any, handler: ValidatorFunctionWrapHandler) -> "float | FreePoint":
    """A control point, by whether it is a mapping."""
    return (_FREE_POINT if isinstance(value, Mapping | FreePoint) else _ANGLE).validate_python(value)


_ANGLE, _FREE_POINT = TypeAdapter[float](PointValue), TypeAdapter(FreePoint)
Point = Annotated[PointValue | FreePoint, WrapValidator(_read_point)]


class BezierReference(BaseModel, Target):
    """Bezier curves whose control points are given, or unknowns of a design."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    bezier: Annotated[
        dict[str, tuple[Point, ...]],
        Field(description="control points of each curve [rad], each a number or {free: [lo, hi], guess: value}"),
    ]

    @property
    def parameters(self) -> Mapping[str, float]:
        """The control points, or their guesses, as ``JOINT.K``."""
        return {key: point.guess if isinstance(point, FreePoint) else point for key, point in self._points()}

    @property
    def structure(self) -> object:
        """Names of the curves with the bounds of each point, None for one that is given."""
        bounds = (tuple(getattr(point, "free", None) for point in row) for row in self.bezier.values())
        return tuple(zip(self.bezier, bounds, strict=True))

    def unknowns(self, walker: "WalkerType") -> Mapping[str, tuple[float, float]]:
        """Bounds of the free control points."""
        free = {key: point.free for key, point in self._points() if isinstance(point, FreePoint)}
        return {key: (lower, upper) for key, (lower, upper) in free.items()}

    def guesses(self, values: Mapping[str, float], walker: "WalkerType") -> Mapping[str, object]:
        """The curves with known values as guesses of the free points, within their bounds."""
        known = {key: point for key, point in self._points() if isinstance(point, FreePoint) and key in values}
        if not known:
            return {}

        def entry(key: str, point: float | FreePoint) -> object:
            if not isinstance(point, FreePoint):
                return point
            guess = float(np.clip(values.get(key, point.guess), point.free[0], point.free[1]))
            return {"free": list(point.free), "guess": guess}

        rows = self.bezier.items()
        return {"bezier": {name: [entry(f"{name}.{k}", c) for k, c in enumerate(row)] for name, row in rows}}

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """Curves with fewer than two points, and free points whose bounds and guess contradict each other."""
        for name, points in self.bezier.items():
            if len(points) < 2:
                yield ("bezier", name), f"has {len(points)} control points, must have at least 2"
            for k, point in enumerate(points):
                if isinstance(point, FreePoint) and not point.free[0] < point.free[1]:
                    lower, upper = point.free
                    words = f"[{lower:g}, {upper:g}] needs lo < hi; for a fixed value, give a number"
                    yield ("bezier", name, k, "free"), f"is empty: {words}"
                elif isinstance(point, FreePoint) and not point.free[0] <= point.guess <= point.free[1]:
                    words = f"[{point.free[0]:g}, {point.free[1]:g}]"
                    yield ("bezier", name, k, "guess"), f"{point.guess:g} is outside of its bounds {words}"

    def curves(self, p: SimpleNamespace, joints: Sequence[str], s: SX) -> SX:
        """The curves of some joints at the phase ``s``, from 0 to 1 along the span; shape (n,)."""
        points = (getattr(p, joint) for joint in joints)
        return vertcat(*(dot(c, _bernstein(c.numel() - 1, s)) for c in points))

    def _points(self) -> Iterator[tuple[str, float | FreePoint]]:
        for name, row in self.bezier.items():
            yield from ((f"{name}.{k}", point) for k, point in enumerate(row))


def control_points(phases: Array, angles: Array, degree: int) -> Array:
    """Control points (n, degree + 1) of the Bezier curves that fit ``angles`` (n, m) at ``phases`` (m,) best."""
    k = np.arange(degree + 1)
    basis = np.array([comb(degree, j) for j in k]) * phases[:, None] ** k * (1 - phases[:, None]) ** (degree - k)
    return np.asarray(np.linalg.lstsq(basis, angles.T, rcond=None)[0].T, dtype=float)


def _bernstein(degree: int, s: SX) -> SX:
    """B_k(s) for all k; powers are products, because the power of a symbol has no derivative at 0."""
    rising, falling = [SX(1)], [SX(1)]
    for _ in range(degree):
        rising.append(rising[-1] * s)
        falling.append(falling[-1] * (1 - s))
    return vertcat(*(comb(degree, k) * rising[k] * falling[degree - k] for k in range(degree + 1)))


Name = Annotated[str, Field(min_length=1, max_length=1000)]
"""Name or path of another problem."""


class GaitReference(BaseModel, Target):
    """The angles of another gait, over the time since the impact."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    gait: Annotated[Name, Field(description="problem whose gait is tracked: a name, or a path relative to this file")]
    beyond_end: Annotated[
        BeyondEnd,
        Field(
            description="after the reference's end: its motion flows on (flow), its last rate is kept (linear), "
            "its last angle is held (hold), or there is no torque (off)"
        ),
    ]

    @property
    def source(self) -> tuple[str, Path]:
        """The tracked gait."""
        return self.gait, ("gait",)


class CurveSpec(BaseModel):
    """A smooth curve per tracked joint whose coefficients are unknowns."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    degree: Annotated[int, Field(ge=1, le=20, strict=True, description="degree of the curve of each joint")]
    start: Annotated[Name, Field(description="problem whose gait gives the first guess: a name, or a path")]
    within: Annotated[
        Angle,
        Field(
            ge=SMALLEST,
            le=pi,
            description="bound of the curves' angles on both sides of zero [rad], kept by construction",
        ),
        Within(usual=(0.01, pi)),
    ] = 0.6
    duration: Annotated[
        Duration | None,
        Field(description="of the curves [s]; the period of the start's gait if left out"),
        Within(unit="time", possible=DURATION.possible, usual=(0.1, DURATION.usual[1])),
    ] = None
    points: Annotated[
        dict[str, tuple[Angle, ...]] | None,
        Field(
            description="first guess of the degree + 1 Bezier control points of each tracked joint [rad]; "
            "those that come closest to the start's angles if left out"
        ),
    ] = None


class CurveReference(BaseModel, Target):
    """A reference curve that a design finds."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    curve: CurveSpec
    beyond_end: Annotated[
        Literal[BeyondEnd.LINEAR, BeyondEnd.HOLD, BeyondEnd.OFF],
        Field(
            description="after the curve's end: its last rate is kept (linear), its last angle is held (hold), "
            "or there is no torque (off); a curve has no motion of its own that could flow on"
        ),
    ]

    @property
    def source(self) -> tuple[str, Path]:
        """The gait from which the curves start."""
        return self.curve.start, ("curve", "start")

    def unknowns(self, walker: "WalkerType") -> Mapping[str, tuple[float, float]]:
        """Bounds of the control points."""
        keys = (f"{name}.{k}" for name in walker.tracked for k in range(self.curve.degree + 1))
        return dict.fromkeys(keys, (-self.curve.within, self.curve.within))

    def guesses(self, values: Mapping[str, float], walker: "WalkerType") -> Mapping[str, object]:
        """The control points, within their bound."""
        bound, count = self.curve.within, self.curve.degree + 1
        rows = {name: [values.get(f"{name}.{k}") for k in range(count)] for name in walker.tracked}
        if any(value is None for row in rows.values() for value in row):
            return {}
        return {
            "curve.points": {
                name: np.clip(np.array(row, dtype=float), -bound, bound).tolist() for name, row in rows.items()
            }
        }

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """Control points that are not those of the tracked joints, degree + 1 for each, within the bound."""
        points, path = self.curve.points, ("curve", "points")
        if points is None:
            return
        if set(points) != set(walker.tracked):
            given = ", ".join(points) or "no joint"
            yield path, f"are given for {given}; the tracked joints are {', '.join(walker.tracked)}"
            return
        for name, values in points.items():
            if len(values) != self.curve.degree + 1:
                number = f"a curve of degree {self.curve.degree} has {self.curve.degree + 1}"
                yield (*path, name), f"{len(values)} control points, but {number}"
            for k, value in enumerate(values):
                if abs(value) > self.curve.within:
                    yield (*path, name, k), f"{value:g} is outside of within = {self.curve.within:g}"


class ConstantReference(BaseModel, Target):
    """Constant angles: set-points."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    constant: Annotated[
        dict[str, Angle],
        Field(
            min_length=1, description="angle of each tracked joint [rad]; the motor of a joint that is left out is off"
        ),
    ]

    @property
    def parameters(self) -> Mapping[str, float]:
        """The angles as ``constant.JOINT``."""
        return {f"constant.{joint}": angle for joint, angle in self.constant.items()}

    @property
    def structure(self) -> object:
        """The joints."""
        return ("constant", *self.constant)

    def joints(self, walker: "WalkerType") -> tuple[str, ...]:
        """Those that have an angle."""
        return tuple(joint for joint in walker.tracked if joint in self.constant)

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """Joints that the walker does not track, and angles that it never reaches."""
        for joint, angle in self.constant.items():
            if joint not in walker.tracked:
                words = f"the tracked joints are {', '.join(walker.tracked)}" if walker.tracked else "it tracks none"
                yield ("constant", joint), f"is no tracked joint of {walker.model}; {words}"
            elif joint not in walker.lengths and abs(angle) > walker.largest_angle:
                words = f"angles of {walker.model} are at most {walker.largest_angle:g} rad in size"
                yield ("constant", joint), f"{angle:g} is impossible: {words}"

    def weighted(
        self, now: "Instant", p: SimpleNamespace, joints: Sequence[str], weights: tuple[SX, SX]
    ) -> tuple[SX, SX]:
        """The angles; their rates are zero."""
        return weights[0] * vertcat(*(getattr(p.constant, joint) for joint in joints)), SX(1)


def _read(value: Any, handler: ValidatorFunctionWrapHandler) -> Target:
    """The target that a file describes, by its keys; a target itself is taken as it is."""
    if isinstance(value, Target):
        return value
    kinds: dict[str, type[Target]] = {"curve": CurveReference, "constant": ConstantReference}
    given = value if isinstance(value, Mapping) else {}
    kind: Any = next((kind for key, kind in kinds.items() if key in given), GaitReference)
    validated: Target = kind.model_validate(value)
    return validated


Followed = Annotated[
    GaitReference
    | CurveReference
    | ConstantReference
    | SkipJsonSchema[InstanceOf[Reference]]
    | SkipJsonSchema[InstanceOf[BezierCurve]],
    WrapValidator(_read),
]
"""Type of the key ``reference``: what a file may say, or a motion that is ready for use."""
