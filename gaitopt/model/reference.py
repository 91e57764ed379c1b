"""References: motions that joints follow, over the time t since the last impact.

A ``Reference`` theta_r consists of Chebyshev series, one piece per segment. Pieces meet at breakpoints, where the curve
may have a kink or, with ``off``, the control ends. The last piece applies up to ``horizon``.

A ``BezierCurve`` has control points c_k that are parameters, which can be set, freed or continued,

    theta_r(t) = sum_k c_k B_k(s),    B_k(s) = C(n, k) s^k (1 - s)^(n - k),    s = t / duration,    t < duration

Such a curve stays within the range of its control points. It starts at the first and ends at the last one, and its rate
at the end, n (c_n - c_(n-1)) / duration, determines its continuation.

A table of time is a cubic spline, whose knots are breakpoints. In a phase variable a knot would be an event of
the motion, so that curves over a phase are single polynomials: Bezier curves, or those closest to the rows of a table.

``GaitReference`` and ``CurveReference`` are what a problem file says; ``gaitopt.systems`` replaces them by a
``Reference`` and a ``BezierCurve`` once the gait that they name is known.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from itertools import pairwise
from math import comb, inf, isfinite, pi, radians
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from casadi import SX, dot, horzcat, horzsplit, reshape, vertcat, vertsplit
from numpy.polynomial import chebyshev
from pydantic import (
    AfterValidator,
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
from gaitopt.model.units import DURATION, SMALLEST, Angle, Duration, Within, parse_angle, parse_number

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
    def phase_variable(self) -> str:
        """The phase variable over which the motion runs; empty if it runs over the time since the impact."""
        return ""

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

    @property
    def fit_errors(self) -> Mapping[str, float]:
        """Largest distance of fitted curves from what they fit, by joint [rad, or m]; empty if nothing is fitted."""
        return {}

    def unknowns(self, walker: "WalkerType") -> Mapping[str, tuple[float, float]]:
        """Bounds of the parameters that a design determines rather than the problem file."""
        return {}

    def guesses(self, values: Mapping[str, float], walker: "WalkerType") -> Mapping[str, object]:
        """Keys and values that make known values of the unknowns their first guess; empty if some are missing."""
        return {}

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """What is wrong with the target for a walker, by key."""
        yield from ()

    @property
    def names(self) -> tuple[str, ...]:
        """The angles that have a curve, as far as they are stated."""
        return ()

    def followers(self, walker: "WalkerType") -> tuple[str, ...]:
        """The joints that follow the motion."""
        return walker.tracked

    def followed(self, walker: "WalkerType") -> Mapping[str, str]:
        """The shape coordinate of ``source`` for each joint; by default its own name."""
        return {name: name for name in walker.tracked}

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
    active : False where the control is switched off.
    """

    start: float
    end: float
    angles: Array
    active: bool = True

    @property
    def rates(self) -> Array:
        """Chebyshev coefficients of the rates [rad/s], the derivative of the angles; shape (n_u, max(degree, 1))."""
        slope = 2 / (self.end - self.start)
        return np.asarray(slope * chebyshev.chebder(self.angles, axis=1))

    def __call__(self, t: float) -> tuple[Array, Array]:
        """Angles [rad] and rates [rad/s] at a time since impact [s], shape (n_u,) each."""
        s = 2 * (t - self.start) / (self.end - self.start) - 1
        angles, rates = (np.asarray(chebyshev.chebval(s, table.T)) for table in (self.angles, self.rates))
        return angles, rates


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference(Target):
    """Pieces in order of time; they are defined up to ``horizon``, a time since impact [s].

    ``names`` are the joints that follow them, in the order of the series; empty for all tracked joints.
    """

    pieces: tuple[Piece, ...]
    horizon: float = np.inf
    names: tuple[str, ...] = ()

    def followers(self, walker: "WalkerType") -> tuple[str, ...]:
        """Those that have a series."""
        return self.names or walker.tracked

    @property
    def degree(self) -> int:
        """Largest degree of all series."""
        return max(piece.angles.shape[1] for piece in self.pieces) - 1

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


def continued(pieces: Sequence[Piece], end: float, beyond_end: BeyondEnd, names: tuple[str, ...] = ()) -> Reference:
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
        active=beyond_end is not BeyondEnd.OFF,
    )
    return Reference(pieces=(*pieces, tail), names=names)


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

    def followers(self, walker: "WalkerType") -> tuple[str, ...]:
        """Those that have a curve."""
        return tuple(self.points)

    @property
    def parameters(self) -> Mapping[str, float]:
        """The control points as ``JOINT.K``."""
        return {f"{name}.{k}": c for name, row in self.points.items() for k, c in enumerate(row)}

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """The end of the curves."""
        return (self.duration,)

    def data(self, segment: int) -> Array:
        """Weights of the curve and of its continuation, (1, 0) and then (0, 1), and the duration."""
        return np.array([*np.eye(2)[segment], self.duration])

    def unknowns(self, walker: "WalkerType") -> Mapping[str, tuple[float, float]]:
        """Bounds of the control points."""
        return dict.fromkeys(self.parameters, (-self.within, self.within))

    def weighted(
        self, now: "Instant", p: SimpleNamespace, joints: Sequence[str], weights: tuple[SX, SX]
    ) -> tuple[SX, SX]:
        """The curves, and then their continuation."""
        points = horzcat(*(getattr(p, joint) for joint in joints))

        def curve(s: SX, rate: SX) -> tuple[SX, SX]:
            slopes = self.degree * rate * (points[1:, :] - points[:-1, :])
            return points.T @ _bernstein(self.degree, s), slopes.T @ _bernstein(self.degree - 1, s)

        return _over_clock(curve, self.beyond_end, now, weights)


def _over_clock(
    curve: Callable[[SX, SX], tuple[SX, SX]], beyond_end: BeyondEnd, now: "Instant", weights: tuple[SX, SX]
) -> tuple[SX, SX]:
    """Weighted sum of angles and rates of curves over ``t / duration`` in segment 0, then of their continuation.

    The segment data start with the weights of both, and the duration.

    Parameters
    ----------
    curve : s, ds/dt -> angles [rad] and rates [rad/s], shape (n,) each.
    """
    duration = now.r[2]

    def total(angles: SX, rates: SX) -> SX:
        return weights[0] * angles + weights[1] * rates

    inside = total(*curve(now.t / duration, 1 / duration))
    if beyond_end is BeyondEnd.OFF:
        return inside, now.r[0]
    end, rate = curve(SX(1), 1 / duration)
    hold = beyond_end is BeyondEnd.HOLD
    after = total(end, SX.zeros(rate.numel())) if hold else total(end + rate * (now.t - duration), rate)
    return now.r[0] * inside + now.r[1] * after, SX(1)


OVERSHOOT, CURVE_POINTS = 10, 65
"""Largest size of a control point, relative to that of the angle, which its curve reaches only in part; and number of
points at which the size of a curve is taken."""
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
    if not isinstance(value, Mapping | FreePoint):
        return _ANGLE.validate_python(value)
    if isinstance(value, Mapping):
        bounds = value.get("free")
        if {*value} != {"free", "guess"} or not isinstance(bounds, list | tuple) or len(bounds) != 2:
            raise ValueError("an unknown is {free: [lo, hi], guess: value}")
    return _FREE_POINT.validate_python(value)


_ANGLE, _FREE_POINT = TypeAdapter[float](PointValue), TypeAdapter(FreePoint)
Point = Annotated[PointValue | FreePoint, WrapValidator(_read_point)]


def _value(point: float | FreePoint) -> float:
    """A number, or the guess of an unknown."""
    return point.guess if isinstance(point, FreePoint) else point


def _free_bounds(points: Iterable[tuple[str, float | FreePoint]]) -> dict[str, tuple[float, float]]:
    """Bounds of those that are unknowns."""
    return {key: (point.free[0], point.free[1]) for key, point in points if isinstance(point, FreePoint)}


def _guessed(point: float | FreePoint, value: float | None) -> object:
    """The data of a point, with a known value as the guess of an unknown, within its bounds."""
    if not isinstance(point, FreePoint):
        return point
    guess = float(np.clip(point.guess if value is None else value, point.free[0], point.free[1]))
    return {"free": list(point.free), "guess": guess}


def _largest_angle(name: str, walker: "WalkerType") -> float:
    """Largest size of a shape coordinate, or of the difference of two, on which a motor acts; of others no limit."""
    if name in {*walker.shape} - {*walker.lengths}:
        return walker.largest_angle
    return 2 * walker.largest_angle if name in walker.actuators and not walker.lengths else inf


def _largest_value(points: Sequence[float]) -> float:
    """Largest size of a Bezier curve, by de Casteljau's algorithm."""
    s, rows = np.linspace(0, 1, CURVE_POINTS), np.tile(np.array(points)[:, None], CURVE_POINTS)
    while len(rows) > 1:
        rows = (1 - s) * rows[:-1] + s * rows[1:]
    return float(np.abs(rows).max())


def point_faults(point: float | FreePoint) -> Iterator[tuple[Path, str]]:
    """Bounds and guess of an unknown that contradict each other."""
    if not isinstance(point, FreePoint):
        return
    words = f"[{point.free[0]:g}, {point.free[1]:g}]"
    if not point.free[0] < point.free[1]:
        yield ("free",), f"is empty: {words} needs lo < hi; for a fixed value, give a number"
    elif not point.free[0] <= point.guess <= point.free[1]:
        yield ("guess",), f"{point.guess:g} is outside of its bounds {words}"


class BezierReference(BaseModel, Target):
    """Bezier curves whose control points are given, or unknowns of a design."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    bezier: Annotated[
        dict[str, tuple[Point, ...]],
        Field(description="control points of each curve [rad]; each is a number or an unknown"),
    ]

    @property
    def parameters(self) -> Mapping[str, float]:
        """The control points, or their guesses, as ``JOINT.K``."""
        return {key: _value(point) for key, point in self._points()}

    @property
    def structure(self) -> object:
        """Names of the curves with the bounds of each point, None for one that is given."""
        bounds = (tuple(getattr(point, "free", None) for point in row) for row in self.bezier.values())
        return tuple(zip(self.bezier, bounds, strict=True))

    def unknowns(self, walker: "WalkerType") -> Mapping[str, tuple[float, float]]:
        """Bounds of the free control points."""
        return _free_bounds(self._points())

    def guesses(self, values: Mapping[str, float], walker: "WalkerType") -> Mapping[str, object]:
        """The curves with known values as guesses of the free points, within their bounds."""
        if not {key for key, point in self._points() if isinstance(point, FreePoint)} & {*values}:
            return {}
        rows = self.bezier.items()
        return {
            "bezier": {name: [_guessed(c, values.get(f"{name}.{k}")) for k, c in enumerate(row)] for name, row in rows}
        }

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """Curves with fewer than two points, angles that no walker reaches, and bounds that contradict a guess."""
        for name, points in self.bezier.items():
            if len(points) < 2:
                yield ("bezier", name), f"has {len(points)} control points, must have at least 2"
                continue
            largest = _largest_angle(name, walker)
            words = f"angles of {walker.model} are at most {walker.largest_angle:g} rad in size"
            for k, point in enumerate(points):
                yield from ((("bezier", name, k, *path), text) for path, text in point_faults(point))
                values = point.free if isinstance(point, FreePoint) else (point,)
                beyond = [value for value in values if abs(value) > OVERSHOOT * largest]
                if beyond:
                    limit = f"control points are at most {OVERSHOOT * largest:g} in size"
                    yield ("bezier", name, k), f"{beyond[0]:g} is impossible: {limit}, because {words}"
                    return
            reached = _largest_value([_value(point) for point in points])
            if reached > largest:
                yield ("bezier", name), f"reaches {reached:g} rad, which is impossible: {words}"

    @property
    def names(self) -> tuple[str, ...]:
        """The angles that have a curve."""
        return tuple(self.bezier)

    def curves(self, p: SimpleNamespace, names: Sequence[str], phase: SX, span: SX, r: SX) -> SX:
        """The curves of some angles at a phase, shape (n,).

        Parameters
        ----------
        span : SX, shape (2,) - the phase at both ends.
        r : SX - the target's segment data.
        """
        s = (phase - span[0]) / (span[1] - span[0])
        return vertcat(*(_bezier(getattr(p, name), s) for name in names))

    def _points(self) -> Iterator[tuple[str, float | FreePoint]]:
        for name, row in self.bezier.items():
            yield from ((f"{name}.{k}", point) for k, point in enumerate(row))


def control_points(phases: Array, angles: Array, degree: int) -> tuple[Array, Array]:
    """Control points (n, degree + 1) of the Bezier curves that fit ``angles`` (n, m) at ``phases`` (m,) best.

    Also their largest errors at these phases, shape (n,).
    """
    k = np.arange(degree + 1)
    basis = np.array([comb(degree, j) for j in k]) * phases[:, None] ** k * (1 - phases[:, None]) ** (degree - k)
    points = np.linalg.lstsq(basis, angles.T, rcond=None)[0]
    return np.asarray(points.T, dtype=float), np.abs(basis @ points - angles.T).max(axis=0)


def _bezier(points: SX, s: SX) -> SX:
    """The curve of some control points at ``s``."""
    return dot(points, _bernstein(points.numel() - 1, s))


def _bernstein(degree: int, s: SX) -> SX:
    """B_k(s) for all k; powers are products, because the power of a symbol has no derivative at 0."""
    rising, falling = [SX(1)], [SX(1)]
    for _ in range(degree):
        rising.append(rising[-1] * s)
        falling.append(falling[-1] * (1 - s))
    return vertcat(*(comb(degree, k) * rising[k] * falling[degree - k] for k in range(degree + 1)))


Name = Annotated[str, Field(min_length=1, max_length=1000)]
"""Name or path of another problem."""


CLOCK = "clock"
"""In place of a phase variable: the time since the impact."""
Continuation = Annotated[
    Literal[BeyondEnd.LINEAR, BeyondEnd.HOLD, BeyondEnd.OFF] | None,
    Field(
        description="motion after the end of a reference in time: its last rate continues (linear), its last angle is "
        "held (hold), or the motors are off (off)"
    ),
]


class GivenCurves(BaseModel, Target):
    """Curves that are given, as functions of the time since the impact or of a phase variable."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    phase: Annotated[
        Name,
        Field(
            description="argument of the curves: clock (time since the impact), a shape coordinate or a phase variable"
        ),
    ] = CLOCK
    beyond_end: Continuation = None

    @property
    def domain(self) -> tuple[float, float]:
        """Phase variable, or time since impact, at the start and the end of the curves."""
        raise NotImplementedError

    def points(self, p: SimpleNamespace, r: SX, joints: Sequence[str]) -> list[SX]:
        """Control points of the Bezier curve of each joint; ``r`` are the segment data after those of the domain."""
        raise NotImplementedError

    @property
    def phase_variable(self) -> str:
        """The phase, unless it is the clock."""
        return "" if self.phase == CLOCK else self.phase

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """The end of curves of time."""
        return () if self.phase_variable else (self.domain[1],)

    def data(self, segment: int) -> Array:
        """Over the clock, weights of the curves and of their continuation, and the duration; else the span."""
        start, end = self.domain
        return np.array([start, end] if self.phase_variable else [*np.eye(2)[segment], end])

    def weighted(
        self, now: "Instant", p: SimpleNamespace, joints: Sequence[str], weights: tuple[SX, SX]
    ) -> tuple[SX, SX]:
        """The curves; curves of time then have their continuation."""
        points = self.points(p, now.r[2 if self.phase_variable else 3 :], joints)

        def curve(s: SX, rate: SX) -> tuple[SX, SX]:
            angles = (_bezier(c, s) for c in points)
            slopes = (
                (c.numel() - 1) * rate * dot(c[1:] - c[:-1], _bernstein(c.numel() - 2, s)) for c in points
            )  # d/dt, by ds/dt
            return vertcat(*angles), vertcat(*slopes)

        if not self.phase_variable:
            assert self.beyond_end is not None  # or there is a fault
            return _over_clock(curve, BeyondEnd(self.beyond_end), now, weights)
        phase, rate = (getattr(names, self.phase) for names in (now.s, now.ds))
        start, length = now.r[0], now.r[1] - now.r[0]
        angles, rates = curve((phase - start) / length, rate / length)
        return weights[0] * angles + weights[1] * rates, SX(1)

    def phase_faults(self, walker: "WalkerType", joints: Sequence[str], key: str) -> Iterator[tuple[Path, str]]:
        """Joints that the walker does not track, an unknown phase, and a continuation that is missing or impossible.

        Parameters
        ----------
        joints : those of the curves, which are below ``key``.
        """
        for joint in joints:
            if joint == self.phase:
                yield (key, joint), f"{joint} is the phase variable and cannot follow a curve that depends on it"
            elif joint not in walker.tracked:
                yield (key, joint), untracked(walker)
        angles = (*walker.shape, *walker.phases)
        if not self.phase_variable and self.beyond_end is None:
            words = "give linear, hold or off, because a step may last longer than the reference"
            yield ("beyond_end",), f"is missing: {words}"
        elif self.phase_variable and self.phase not in angles:
            words = f"it has {', '.join(angles)}; clock is the time since the impact"
            yield ("phase",), f"{walker.model} has no phase variable {self.phase!r}; {words}"
        elif self.phase_variable and self.beyond_end is not None:
            words = "curves of a phase variable continue as polynomials: leave it out"
            yield ("beyond_end",), f"applies only to curves of time; {words}"


def untracked(walker: "WalkerType") -> str:
    """Why a joint cannot follow a reference."""
    words = f"the tracked joints are {', '.join(walker.tracked)}" if walker.tracked else "it tracks none"
    return f"is not a tracked joint of {walker.model}; {words}"


class BezierMotion(BezierReference, GivenCurves):
    """Given Bezier curves, as functions of the time since the impact or of a phase variable."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    duration: Annotated[
        Duration | None,
        Field(description="duration of curves in time [s]; the step may end earlier or later"),
        Within(unit="time", possible=DURATION.possible, usual=DURATION.usual),
    ] = None
    span: Annotated[
        tuple[PointValue, PointValue] | None,
        Field(description="values of the phase variable at the start and the end of the curves [rad, or m]"),
    ] = None

    @property
    def domain(self) -> tuple[float, float]:
        """The span, or from zero to the duration."""
        return self.span or (0.0, self.duration or 1.0)

    @property
    def structure(self) -> object:
        """That of the curves, and what they run over."""
        return (super().structure, self.phase, self.domain, self.beyond_end)

    def followers(self, walker: "WalkerType") -> tuple[str, ...]:
        """Those that have a curve."""
        return tuple(self.bezier)

    def points(self, p: SimpleNamespace, r: SX, joints: Sequence[str]) -> list[SX]:
        """The parameters."""
        return [getattr(p, joint) for joint in joints]

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """Those of curves and phase, and a duration or a span that is missing, empty, or of the other kind."""
        yield from super().faults(walker)
        yield from self.phase_faults(walker, tuple(self.bezier), "bezier")
        if not self.bezier:
            yield ("bezier",), "has no curve: give the control points of a joint, {JOINT: [0, 0.1, 0.2]}"
        if self.phase_variable:
            needed, other, words = "span", "duration", "curves of a phase variable need span: [START, END]"
        else:
            needed, other, words = "duration", "span", "curves of time need their duration: SECONDS"
            words += "; those of a phase variable need phase: NAME and span: [START, END]"
        if getattr(self, needed) is None:
            yield (needed,), f"is missing: {words}"
        if getattr(self, other) is not None:
            yield (other,), f"does not apply: {words}"
        if self.span is not None and self.span[0] == self.span[1]:
            yield ("span",), f"is empty: both ends are {self.span[0]:g}; give the phase after and before the impact"


class FittedMotion(BezierMotion):
    """Bezier curves of a phase variable that are closest to the angles of a gait, by at most some errors."""

    errors: Mapping[str, float]

    @property
    def fit_errors(self) -> Mapping[str, float]:
        """The errors."""
        return self.errors


MOST_KNOTS = 60
"""Rows of a table without a degree; each knot divides the motion."""
MOST_ROWS = 100_000
LEAST_STEP = 1e-6
"""Least step of the first column, relative to its range."""


class Table(BaseModel):
    """The name and the content of a table of angles: a text whose lines are rows of numbers, after one of names."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    file: Annotated[str, Field(min_length=1, max_length=200, description="name of the file, for messages")]
    text: Annotated[str, Field(description="content of the file")]

    @property
    def columns(self) -> Mapping[str, Array]:
        """Numbers by name, shape (rows,) each, in rad and SI units; the first column is that of the phase.

        Raises
        ------
        ValueError
            With file and line of the first mistake.
        """
        return _columns(self)[0]

    @property
    def decimals(self) -> Mapping[str, tuple[str, ...]]:
        """The numbers as the file writes them, with ``deg`` where their column has this unit; raises as ``columns``."""
        return _columns(self)[1]


@lru_cache(maxsize=32)
def _columns(table: Table) -> tuple[dict[str, Array], dict[str, tuple[str, ...]]]:
    """Numbers and decimals of a table by the names of its columns."""
    lines = [(k, line.strip()) for k, line in enumerate(table.text.removeprefix("\ufeff").splitlines(), start=1)]
    lines = [(k, line) for k, line in lines if line and not line.startswith("#")]
    form = "a line of names such as t,theta2 (rad; or theta2 [deg]), and rows of numbers"
    if not lines:
        raise ValueError(f"{table.file} is empty: it must have {form}")
    (first, header), *rows = lines
    heads = [re.fullmatch(r"([A-Za-z]\w*)\s*(?:\[(rad|deg|s|m)\])?", word.strip()) for word in header.split(",")]
    if not all(heads):
        raise ValueError(f"{table.file}:{first}: {header[:60]!r} does not name the columns: it must have {form}")
    names, units = zip(*(head.groups() for head in heads if head), strict=True)
    if len({*names}) < len(names) or len(names) < 2:
        words = "two columns have one name" if len(names) > 1 else "one column is not enough"
        raise ValueError(f"{table.file}:{first}: {words}: it must have {form}")
    if not 2 <= len(rows) <= MOST_ROWS:
        raise ValueError(f"{table.file} has {len(rows)} rows of numbers, must have from 2 to {MOST_ROWS}")
    numbers, decimals = np.empty((len(rows), len(names))), list[list[str]]()
    for n, (k, line) in enumerate(rows):
        cells = line.split(",")
        if len(cells) != len(names):
            raise ValueError(f"{table.file}:{k}: {len(cells)} entries, but there are {len(names)} columns")
        decimals.append(
            [f"{cell.strip()} deg" if unit == "deg" else cell.strip() for cell, unit in zip(cells, units, strict=True)]
        )
        for column, cell in enumerate(cells):
            try:
                numbers[n, column] = parse_number(cell)
            except ValueError:
                raise ValueError(f"{table.file}:{k}: {cell.strip()[:40]!r} is not a number") from None
            if not (isfinite(numbers[n, column]) and abs(numbers[n, column]) <= LARGEST_POINT):
                words = f"is not a finite number of at most {LARGEST_POINT} in size"
                raise ValueError(f"{table.file}:{k}: {names[column]} = {cell.strip()} {words}")
    numbers[:, [unit == "deg" for unit in units]] *= radians(1)
    steps = np.diff(numbers[:, 0]) * np.sign(numbers[-1, 0] - numbers[0, 0])
    wrong = np.flatnonzero(~(steps > LEAST_STEP * abs(numbers[-1, 0] - numbers[0, 0])))
    if wrong.size:
        k = int(wrong[0])
        words = (
            f"{numbers[k + 1, 0]:g} after {numbers[k, 0]:g}; it must increase from row to row, or decrease throughout"
        )
        raise ValueError(f"{table.file}:{rows[k + 1][0]}: {names[0]} = {words}")
    return (
        {name: numbers[:, k] for k, name in enumerate(names)},
        dict(zip(names, map(tuple, zip(*decimals, strict=True)), strict=True)),
    )


def _read_table(value: Any) -> Any:
    """A table of its content, or from columns of numbers by name."""
    if not isinstance(value, Mapping) or {*value} == {"file", "text"}:
        return value
    columns = {str(name): np.asarray(column) for name, column in value.items()}
    for name, column in columns.items():
        if column.ndim != 1 or column.dtype.kind not in "iuf":
            raise ValueError(
                f"the column {name} is not a list of numbers: give {{t: [0, 0.4, 0.8], JOINT: [0, 0.1, 0.2]}}"
            )
    if len({column.size for column in columns.values()}) > 1:
        sizes = ", ".join(f"{name}: {column.size}" for name, column in columns.items())
        raise ValueError(f"the columns differ in length ({sizes})")
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    return {"file": "table", "text": "\n".join(lines) + "\n"}


def _check_table(table: Table) -> Table:
    table.columns  # noqa: B018 - raises if the content is wrong
    return table


class TableCurves(BaseModel, Target):
    """Polynomials in a phase variable that are closest to the rows of a table."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    table: Annotated[
        Table,
        BeforeValidator(_read_table),
        AfterValidator(_check_table),
        Field(
            description="CSV file, relative to this file, or columns {t: [...], JOINT: [...]}; the first column is "
            "the time since the impact [s] or the phase variable, the others are joint angles [rad]"
        ),
        WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "object"}]}),
    ]
    degree: Annotated[
        int | None,
        Field(
            ge=1,
            le=20,
            strict=True,
            description="degree of the polynomials fitted to the rows; by default a cubic spline in time passes "
            "through all rows",
        ),
    ] = None

    @property
    def names(self) -> tuple[str, ...]:
        """The angles that have a column."""
        return tuple(self.table.columns)[1:]

    @property
    def domain(self) -> tuple[float, float]:
        """First and last entry of the first column."""
        first = next(iter(self.table.columns.values()))
        return float(first[0]), float(first[-1])

    @property
    def fit_errors(self) -> Mapping[str, float]:
        """Distance of the curves from the rows."""
        return {} if self.degree is None else dict(zip(self.names, self._fit[1].tolist(), strict=True))

    @property
    def _fit(self) -> tuple[Array, Array]:
        assert self.degree is not None
        start, end = self.domain
        phase, *angles = self.table.columns.values()
        return control_points((phase - start) / (end - start), np.array(angles), self.degree)

    def data(self, segment: int) -> Array:
        """First and last entry of the first column, and the fitted control points of all curves, one after the other.

        They are data and no constants, so that a proof can take their exact values.
        """
        return np.array([*self.domain, *(self._fit[0].ravel() if self.degree else ())])

    def curves(self, p: SimpleNamespace, names: Sequence[str], phase: SX, span: SX, r: SX) -> SX:
        """The polynomials of some angles at a phase, shape (n,); the table has a span of its own."""
        points = self.points(p, r[2:], names)
        return vertcat(*(_bezier(c, (phase - r[0]) / (r[1] - r[0])) for c in points))

    def points(self, p: SimpleNamespace, r: SX, joints: Sequence[str]) -> list[SX]:
        """Those that fit the rows; ``r`` are the segment data after those of the domain."""
        rows = dict(zip(self.names, vertsplit(r, (self.degree or 0) + 1), strict=True))
        return [rows[joint] for joint in joints]

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """A degree that is missing or too large for the rows."""
        rows = len(next(iter(self.table.columns.values())))
        if self.degree is None:
            words = "a spline of a phase variable would have kinks at states: give degree: 6, or another number"
            yield ("degree",), f"is missing: {words}"
        elif self.degree >= rows:
            yield ("degree",), f"{self.degree} is too large: {rows} rows determine at most {rows - 1}"


class TableReference(TableCurves, GivenCurves):
    """A table of angles, in a file or as columns, against the time since the impact or a phase variable."""

    @property
    def spline(self) -> Reference:
        """Cubic splines through the rows of a table of time, and their continuation."""
        return _spline(self.table, BeyondEnd(self.beyond_end or BeyondEnd.HOLD))

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """The knots of a spline, and the end."""
        return super().breakpoints if self.degree else self.spline.breakpoints

    def data(self, segment: int) -> Array:
        """The numbers of a piece of the spline; or those of the domain, and the fitted control points."""
        if not self.degree:
            return self.spline.data(segment)
        return np.concatenate([GivenCurves.data(self, segment), self._fit[0].ravel()])

    def followers(self, walker: "WalkerType") -> tuple[str, ...]:
        """Those that have a column."""
        return self.names

    def weighted(
        self, now: "Instant", p: SimpleNamespace, joints: Sequence[str], weights: tuple[SX, SX]
    ) -> tuple[SX, SX]:
        """The curves; curves of time then have their continuation."""
        return (
            super().weighted(now, p, joints, weights) if self.degree else self.spline.weighted(now, p, joints, weights)
        )

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """Those of the phase, a first column that does not suit it, and a degree that does not suit the rows."""
        (first, argument), *angles = self.table.columns.items()
        yield from (
            (path[:1], f"{path[1]} {words}" if path[0] == "table" else words)
            for path, words in self.phase_faults(walker, [name for name, _ in angles], "table")
        )
        expected = self.phase_variable or "t"
        if first != expected:
            words = f"its first column is {first}, but must be {expected}"
            yield ("table",), f"{self.table.file}: {words}, the argument of the curves"
        elif not self.phase_variable and (argument[0] != 0 or argument[-1] < 0):
            words = f"t starts at {argument[0]:g} and ends at {argument[-1]:g}"
            yield ("table",), f"{self.table.file}: {words}, but must rise from 0, the time of the impact"
        if self.phase_variable or self.degree is not None:
            yield from super().faults(walker)
        elif len(argument) > MOST_KNOTS:
            words = f"a spline through {len(argument)} rows divides the motion at every row; use at most {MOST_KNOTS}"
            yield ("degree",), f"is missing: {words}; give degree: 8, or another number, for polynomials"
        for name, column in angles:
            largest = float(np.abs(column).max())
            if name in {*walker.tracked} & {*walker.shape} - {*walker.lengths} and largest > walker.largest_angle:
                words = f"angles of {walker.model} are at most {walker.largest_angle:g} rad in size"
                yield ("table",), f"{self.table.file}: {name} reaches {largest:g}, which is impossible: {words}"


@lru_cache(maxsize=32)
def _spline(table: Table, beyond_end: BeyondEnd) -> Reference:
    """The cubic splines (not-a-knot) of a table, and their continuation."""
    from scipy.interpolate import CubicSpline  # slow to import, and most problems have no table

    times, *angles = table.columns.values()
    spline = CubicSpline(times, np.array(angles), axis=1)
    pieces = []
    for start, end in pairwise(times.tolist()):
        at = (start + end) / 2 + (end - start) / 2 * chebyshev.chebpts1(4)
        pieces.append(Piece(start=start, end=end, angles=chebyshev.chebfit(chebyshev.chebpts1(4), spline(at).T, 3).T))
    return continued(pieces, float(times[-1]), beyond_end, tuple(table.columns)[1:])


Joints = Annotated[
    dict[str, Name] | None,
    Field(
        min_length=1,
        description="for each joint, the angle of that gait that it follows: a shape coordinate, a motor or a phase "
        "variable; by default each tracked joint or output follows its own angle",
    ),
]
Phase = Annotated[
    Name | None,
    Field(
        description="argument of the curves: clock (time since the impact), a shape coordinate or a phase variable; "
        "by default the clock"
    ),
]
Span = Annotated[
    tuple[PointValue, PointValue] | None,
    Field(
        description="values of the phase variable at the start and the end of the curves [rad, or m]; by default those "
        "of the gait"
    ),
]


class GaitCurves(BaseModel, Target):
    """Polynomials in a phase variable that are closest to the angles of another gait."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    gait: Annotated[
        Name,
        Field(
            description="gait that is tracked: the name of a problem, its path relative to this file, or a run folder"
        ),
    ]
    joints: Joints = None
    degree: Annotated[
        int | None,
        Field(
            ge=1,
            le=20,
            strict=True,
            description="degree of the polynomials fitted to the gait's angles as functions of a phase variable",
        ),
    ] = None

    @property
    def source(self) -> tuple[str, Path]:
        """The tracked gait."""
        return self.gait, ("gait",)

    @property
    def names(self) -> tuple[str, ...]:
        """The angles that follow one of the gait, as far as they are stated."""
        return tuple(self.joints or ())

    def followers(self, walker: "WalkerType") -> tuple[str, ...]:
        """Those that ``joints`` names."""
        return walker.tracked if self.joints is None else tuple(self.joints)

    def followed(self, walker: "WalkerType") -> Mapping[str, str]:
        """As ``joints`` says."""
        return super().followed(walker) if self.joints is None else self.joints

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """A degree that is missing."""
        if self.degree is None:
            yield ("degree",), "is missing: curves of a phase variable are polynomials, for example degree: 8"


class GaitReference(GaitCurves):
    """The angles of another gait, as functions of the time since the impact or of a phase variable."""

    phase: Phase = None
    span: Span = None
    beyond_end: Annotated[
        BeyondEnd | None,
        Field(
            description="motion after the end of a reference in time: that of the gait without an impact (flow), its "
            "last rate continues (linear), its last angle is held (hold), or the motors are off (off)"
        ),
    ] = None

    @property
    def phase_variable(self) -> str:
        """The phase, unless it is the clock."""
        return "" if self.phase in (None, CLOCK) else str(self.phase)

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """Joints that the walker does not track, and keys that do not suit the phase, or the clock."""
        yield from _follower_faults(self, walker)
        if self.phase_variable:
            yield from super().faults(walker)
        elif self.degree is not None:
            yield ("degree",), "does not apply: without a phase variable the motion of the gait itself is followed"


class CurveSpec(BaseModel):
    """A smooth curve per joint whose coefficients are unknowns."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    degree: Annotated[int, Field(ge=1, le=20, strict=True, description="degree of the curve of each joint")]
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
            ge=SMALLEST,
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


class FreeCurves(BaseModel, Target):
    """Curves of a phase variable that a design finds."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    curve: CurveSpec
    joints: Joints = None

    @property
    def source(self) -> tuple[str, Path]:
        """The gait from which the curves start."""
        return self.curve.start or "", ("curve", "start")

    @property
    def names(self) -> tuple[str, ...]:
        """The angles that have a curve, as far as they are stated."""
        return tuple(self.joints or self.curve.points or ())

    def followers(self, walker: "WalkerType") -> tuple[str, ...]:
        """Those that have a curve; the tracked joints if none are stated."""
        return self.names or walker.tracked

    def followed(self, walker: "WalkerType") -> Mapping[str, str]:
        """As ``joints`` says; by default each angle its own."""
        return self.joints or {name: name for name in self.followers(walker)}

    def unknowns(self, walker: "WalkerType") -> Mapping[str, tuple[float, float]]:
        """Bounds of the control points."""
        keys = (f"{name}.{k}" for name in self.followers(walker) for k in range(self.curve.degree + 1))
        return dict.fromkeys(keys, (-self.curve.within, self.curve.within))

    def guesses(self, values: Mapping[str, float], walker: "WalkerType") -> Mapping[str, object]:
        """The control points, within their bound."""
        bound, count = self.curve.within, self.curve.degree + 1
        rows = {name: [values.get(f"{name}.{k}") for k in range(count)] for name in self.followers(walker)}
        if any(value is None for row in rows.values() for value in row):
            return {}
        return {
            "curve.points": {
                name: np.clip(np.array(row, dtype=float), -bound, bound).tolist() for name, row in rows.items()
            }
        }

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """Control points that are not degree + 1 for each joint, within the bound."""
        for name, values in (self.curve.points or {}).items():
            if len(values) != self.curve.degree + 1:
                number = f"a curve of degree {self.curve.degree} has {self.curve.degree + 1}"
                yield ("curve", "points", name), f"{len(values)} control points, but {number}"
            for k, value in enumerate(values):
                if abs(value) > self.curve.within:
                    yield ("curve", "points", name, k), f"{value:g} is outside of within = {self.curve.within:g}"
        if self.curve.start is None and self.joints is not None:
            yield ("joints",), "applies only to curves whose first guess is a gait: give curve.start, or leave it out"
        elif self.curve.start is None and not self.curve.points:
            words = "give a problem whose gait is the first guess, or the control points of the guess, points: {JOINT: "
            yield ("curve", "start"), f"is missing: {words}[0, 0.1, 0.2]}}"

    def unknown(self, points: Mapping[str, tuple[float, ...]]) -> dict[str, tuple[float | FreePoint, ...]]:
        """Control points as unknowns within their bound, by joint."""
        span, rows = (-self.curve.within, self.curve.within), points.items()
        return {name: tuple(FreePoint(free=span, guess=value) for value in row) for name, row in rows}

    @property
    def needs_no_start(self) -> bool:
        """Whether points are given in place of a start, and are right."""
        curve, points = self.curve, self.curve.points or {}
        right = (len(row) == curve.degree + 1 and max(map(abs, row)) <= curve.within for row in points.values())
        return curve.start is None and self.joints is None and bool(points) and all(right)

    @property
    def given(self) -> Target:
        """Bezier curves whose points are the unknowns, where no start is needed; otherwise the same."""
        return BezierReference(bezier=self.unknown(self.curve.points or {})) if self.needs_no_start else self


class CurveReference(FreeCurves):
    """Curves that a design finds, as functions of the time since the impact or of a phase variable."""

    phase: Phase = None
    span: Span = None
    beyond_end: Continuation = None

    @property
    def phase_variable(self) -> str:
        """The phase, unless it is the clock."""
        return "" if self.phase in (None, CLOCK) else str(self.phase)

    @property
    def names(self) -> tuple[str, ...]:
        """Over the clock all tracked joints follow a start, unless ``joints`` names some."""
        by_points = self.phase_variable or self.curve.start is None
        return super().names if by_points else tuple(self.joints or ())

    @property
    def given(self) -> Target:
        """As for curves of the phase variable of a law; a duration or a span is needed too."""
        duration, over_phase = self.curve.duration, bool(self.phase_variable)
        if not self.needs_no_start or (self.span if over_phase else duration) is None:
            return self
        keys = {"phase": self.phase, "span": self.span} if over_phase else {"duration": duration}
        bezier = self.unknown(self.curve.points or {})
        return BezierMotion.model_validate({"bezier": bezier, "beyond_end": self.beyond_end, **keys})

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """Joints that the walker does not track, keys that do not suit the phase, and points of other joints."""
        yield from _follower_faults(self, walker)
        points, joints = self.curve.points, self.followers(walker)
        if points is not None and {*points} != {*joints}:
            given, words = (
                ", ".join(points) or "no joint",
                "the joints are" if self.joints else "the tracked joints are",
            )
            yield ("curve", "points"), f"are given for {given}; {words} {', '.join(joints)}"
        else:
            yield from super().faults(walker)
        words = "curves without curve.start need it"
        if self.phase_variable and self.curve.duration is not None:
            yield ("curve", "duration"), "does not apply: curves of a phase variable have a span: [START, END]"
        elif self.curve.start is None and points and self.phase_variable and self.span is None:
            yield ("span",), f"is missing: {words}, the phase at the start and the end"
        elif self.curve.start is None and points and not self.phase_variable and self.curve.duration is None:
            yield ("curve", "duration"), f"is missing: {words} [s]"


def _follower_faults(target: GaitReference | CurveReference, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
    """Joints that the walker does not track, an unknown phase, and a continuation that is missing or impossible."""
    phase, angles = target.phase_variable, (*walker.shape, *walker.phases)
    for joint in target.joints or ():
        if joint not in walker.tracked:
            yield ("joints", joint), untracked(walker)
    if not phase:
        if target.beyond_end is None:
            kinds = "flow, linear, hold or off" if isinstance(target, GaitReference) else "linear, hold or off"
            yield ("beyond_end",), f"is missing: give {kinds}, because a step may last longer than the reference"
        if target.span is not None:
            yield ("span",), "does not apply to curves of time: leave it out, or give phase: NAME"
        return
    if phase not in angles:
        words = f"it has {', '.join(angles)}; clock is the time since the impact"
        yield ("phase",), f"{walker.model} has no phase variable {phase!r}; {words}"
    elif phase in target.followers(walker):
        words = f"name the joints that can, joints: {{JOINT: {phase}}}"
        yield ("phase",), f"{phase} cannot follow a curve that depends on it: {words}"
    if target.span is not None and target.span[0] == target.span[1]:
        yield ("span",), f"is empty: both ends are {target.span[0]:g}; give the phase after and before the impact"
    if target.beyond_end is not None:
        words = "curves of a phase variable continue as polynomials: leave it out"
        yield ("beyond_end",), f"applies only to references in time; {words}"


class ConstantReference(BaseModel, Target):
    """Constant angles."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    constant: Annotated[
        dict[str, Point],
        Field(
            min_length=1,
            description="angle of each tracked joint [rad], a number or an unknown; the motor of a joint that is left "
            "out is off",
        ),
    ]

    @property
    def parameters(self) -> Mapping[str, float]:
        """The angles, or their guesses, as ``constant.JOINT``."""
        return {key: _value(point) for key, point in self._points()}

    @property
    def structure(self) -> object:
        """The joints, with the bounds of each angle that is an unknown."""
        return ("constant", *self.constant, tuple(_free_bounds(self._points()).items()))

    def unknowns(self, walker: "WalkerType") -> Mapping[str, tuple[float, float]]:
        """Bounds of the free angles."""
        return _free_bounds(self._points())

    def guesses(self, values: Mapping[str, float], walker: "WalkerType") -> Mapping[str, object]:
        """Known values of free angles as their guesses, within their bounds."""
        free = {key: point for key, point in self._points() if isinstance(point, FreePoint)}
        return {key: _guessed(point, values[key]) for key, point in free.items() if key in values}

    def followers(self, walker: "WalkerType") -> tuple[str, ...]:
        """Those that have an angle."""
        return tuple(joint for joint in walker.tracked if joint in self.constant)

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """Joints that the walker does not track, angles that it never reaches, and bounds that contradict the guess."""
        for joint, point in self.constant.items():
            values = point.free if isinstance(point, FreePoint) else (point,)
            yield from ((("constant", joint, *path), words) for path, words in point_faults(point))
            if joint not in walker.tracked:
                yield ("constant", joint), untracked(walker)
                continue
            for value in values:
                if joint in {*walker.shape} - {*walker.lengths} and abs(value) > walker.largest_angle:
                    words = f"angles of {walker.model} are at most {walker.largest_angle:g} rad in size"
                    yield ("constant", joint), f"{value:g} is impossible: {words}"

    @property
    def names(self) -> tuple[str, ...]:
        """The angles that are given."""
        return tuple(self.constant)

    def curves(self, p: SimpleNamespace, names: Sequence[str], phase: SX, span: SX, r: SX) -> SX:
        """The constants of some angles, shape (n,)."""
        return vertcat(*(getattr(p.constant, name) for name in names))

    def _points(self) -> Iterator[tuple[str, float | FreePoint]]:
        yield from ((f"constant.{joint}", point) for joint, point in self.constant.items())

    def weighted(
        self, now: "Instant", p: SimpleNamespace, joints: Sequence[str], weights: tuple[SX, SX]
    ) -> tuple[SX, SX]:
        """The angles; their rates are zero."""
        return weights[0] * vertcat(*(getattr(p.constant, joint) for joint in joints)), SX(1)


FORMS = {
    "constant": (ConstantReference, "constant: {JOINT: 10 deg}"),
    "bezier": (BezierMotion, "bezier: {JOINT: [0, 0.1, 0.2]}, duration: 0.8, beyond_end: hold"),
    "table": (TableReference, "table: file.csv, beyond_end: hold"),
    "gait": (GaitReference, "gait: NAME, beyond_end: flow"),
    "curve": (CurveReference, "curve: {degree: 5, start: NAME}, beyond_end: linear"),
}
"""Kinds of references by their first key, each with an example."""


class ConstantCurves(ConstantReference):
    """Constants for angles that need not be tracked joints."""

    def faults(self, walker: "WalkerType") -> Iterator[tuple[Path, str]]:
        """Bounds of unknowns that contradict their guess."""
        for name, point in self.constant.items():
            yield from ((("constant", name, *path), words) for path, words in point_faults(point))


PHASE_FORMS = {
    "bezier": (BezierReference, "bezier: {ANGLE: [0, 0.1, 0.2]}"),
    "constant": (ConstantCurves, "constant: {ANGLE: 10 deg}"),
    "table": (TableCurves, "table: file.csv, degree: 6"),
    "gait": (GaitCurves, "gait: NAME, degree: 6"),
    "curve": (FreeCurves, "curve: {degree: 5, start: NAME}"),
}
"""Kinds of curves of a phase variable, each with an example."""


def _reader(forms: Mapping[str, tuple[type[BaseModel], str]]) -> WrapValidator:
    """A validator that reads the target that a file describes, by its keys; a target itself is taken as it is."""

    def read(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        if isinstance(value, Target):
            return value
        kinds = [key for key in forms if key in value] if isinstance(value, Mapping) else []
        if len(kinds) != 1:
            given = f"has both {' and '.join(kinds)}" if kinds else "does not say what to follow"
            words = " or ".join(f"{{{form}}}" for _, form in forms.values())
            raise ValueError(f"{given}: give one of {words}")
        kind, form = forms[kinds[0]]
        unknown = [str(key) for key in value if key not in kind.model_fields]
        if unknown:
            words = f"{', '.join(unknown)} {'does' if len(unknown) == 1 else 'do'} not belong to {kinds[0]}"
            raise ValueError(f"{words}, which has the keys {', '.join(kind.model_fields)}: {{{form}}}")
        target = kind.model_validate(value)
        return target.given if isinstance(target, FreeCurves) else target

    return WrapValidator(read)


Followed = Annotated[
    GaitReference
    | CurveReference
    | ConstantReference
    | BezierMotion
    | TableReference
    | SkipJsonSchema[InstanceOf[Reference]]
    | SkipJsonSchema[InstanceOf[BezierCurve]],
    _reader(FORMS),
]
"""Type of the key ``reference``: what a file may say, or a motion that is ready for use."""
OverPhase = Annotated[BezierReference | ConstantCurves | TableCurves | GaitCurves | FreeCurves, _reader(PHASE_FORMS)]
"""Type of the key ``reference`` of curves of a phase variable."""
