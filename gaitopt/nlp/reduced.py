"""A design in its freed parameters alone: the equations of the step eliminated, nothing smoothed.

    min f(u)    s.t.    rows(u) >= 0 or = 0,          u = (freed parameters, levels)

A level stands for an extremum that is minimised: every value whose extremum it is stays on its side. The radius of the
multipliers is bounded by the inequalities of ``nlp.moduli``.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitopt.nlp.layout import layout
from gaitopt.nlp.moduli import circle_rows, modulus_gradient
from gaitopt.nlp.newton import polish, section_response
from gaitopt.nlp.outcome import EXTREMA, RADIUS
from gaitopt.nlp.rollout import roll_out
from gaitopt.nlp.scalars import Piece, Scalars, Valued
from gaitopt.nlp.sensitivity import Sensitivity, sensitivity
from gaitopt.nlp.stability import ResponseSlope
from gaitopt.nlp.transcription import Transcription
from gaitopt.problem import Problem, Range

Array = NDArray[np.float64]

CLEARANCE = 1e-8
"""Force [N] or impulse [N s] that a design keeps from the edge of the friction cone, where optima like to lie: more
than the rounding that would decide there, and less than anyone could measure."""
SOLVED = 1e-10
"""Residual of the equations of the step at a point."""
SMALLEST_RADIUS = 1e-3
"""Multipliers below it are as good as zero: deviations vanish in a step."""
LEFT = 1e-3
"""Multipliers so far outside of a circle whose inequalities all hold have left it two at a time."""
UNIT = 1e-3
"""A bound closer to zero than this is no unit of its scalar."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A constraint: ``value`` >= 0, or = 0.

    Attributes
    ----------
    about : the scalar, parameter or margin that it bounds; ``key`` tells it from the others.
    value : in its natural unit.
    gradient : ndarray, shape (n_u,).
    curvature : ndarray, shape (n_u, n_u) - stiff part of the second derivatives, where there is one.
    """

    about: str
    key: str
    value: float
    gradient: Array
    curvature: Array | None = None
    equality: bool = False

    @property
    def violation(self) -> float:
        """How far it is from being met."""
        return abs(self.value) if self.equality else max(0.0, -self.value)


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """The reduced problem at one set of freed parameters.

    Attributes
    ----------
    u : ndarray, shape (n_u,) - freed parameters, and levels at the extrema that they stand for.
    objective, gradient : of what is minimised, shape (n_u,).
    curvature : ndarray, shape (n_u, n_u) - stiff part of its second derivatives.
    rows : all constraints.
    sensitivity : the gait.
    """

    u: Array
    objective: float
    gradient: Array
    curvature: Array
    rows: tuple[Row, ...]
    sensitivity: Sensitivity

    @property
    def violation(self) -> float:
        """Largest violation of a constraint."""
        return max((row.violation for row in self.rows), default=0.0)


class Reduced:
    """The reduced problem.

    Parameters
    ----------
    problem : objective and constraints.
    free, bounds : the freed parameters by dotted key, and their bounds; shape (2, n_free).
    """

    def __init__(self, problem: Problem, free: tuple[str, ...], bounds: Array) -> None:
        self._problem, self.free, self.bounds = problem, free, bounds
        self.levels = tuple(
            name for name, weight in problem.objective.items() if name in EXTREMA and weight * EXTREMA[name] > 0
        )
        self._slopes: dict[Transcription, ResponseSlope] = {}

    def first(self, transcription: Transcription, w: Array, p: Array) -> Point | None:
        """The point at nodes, durations and freed parameters ``w``; None where there is no gait."""
        at = polish(transcription, w, p).at
        if not at.size < SOLVED or not (transcription.unpack(at.w)[1] > 0).all():
            return None
        if not self._in_order(transcription, at.w):
            return self._recut(transcription, at.w, p)
        return self._point(sensitivity(transcription, at))

    def moved(self, point: Point, step: Array) -> Point | None:
        """The point a step (n_u,) away; None where Newton's method finds no gait from here."""
        s, n = point.sensitivity, len(self.free)
        return self.first(s.transcription, s.at.w + s.slopes @ step[:n], s.at.p)

    def _in_order(self, t: Transcription, w: Array) -> bool:
        return t.layout.in_order(t.unpack(w)[1], t.system.control.breakpoints)

    def _recut(self, t: Transcription, w: Array, p: Array) -> Point | None:
        """The same gait on the arcs that it has after a switch has passed a breakpoint of the control."""
        nodes, durations, freed = t.unpack(w)
        rolled = roll_out(t.system, t.full_parameters(p, freed), t.layout.sequence, nodes[:, 0], list(durations))
        plan = layout(t.layout.sequence, durations, t.system.control.breakpoints)
        cut = Transcription(t.system, plan, t.free)
        at = polish(cut, cut.pack(rolled.nodes(plan), durations, freed), p).at
        return self._point(sensitivity(cut, at)) if at.size < SOLVED and self._in_order(cut, at.w) else None

    def _point(self, s: Sensitivity) -> Point | None:
        freed = s.transcription.unpack(s.at.w)[2]
        values = _Values(Scalars(s), self._radius(s), self.levels)
        if values.escaped(self._problem):
            return None
        objective, gradient = 0.0, np.zeros(freed.size + len(self.levels))
        curvature = np.zeros((gradient.size, gradient.size))
        for name, weight in self._problem.objective.items():
            value, slope = values.level(name) if name in self.levels else values.single(name)
            objective, gradient = objective + weight * value, gradient + weight * slope
            curvature += weight * values.curvature(name)
        rows = [*_margins(values), *self._within(values, freed)]
        for name in self.levels:
            rows += values.beyond(name, *values.level(name), EXTREMA[name])
        for name, span in self._problem.constraints.items():
            rows += _spanned(values, name, span)
        levels = np.array([values.level(name)[0] for name in self.levels])
        u = np.concatenate([freed, levels])
        return Point(
            u=u, objective=objective, gradient=gradient, curvature=curvature, rows=tuple(rows), sensitivity=s
        )

    def _radius(self, s: Sensitivity) -> "_Radius | None":
        if RADIUS not in self._problem.objective and RADIUS not in self._problem.constraints:
            return None
        if s.transcription not in self._slopes:
            self._slopes[s.transcription] = ResponseSlope(s.transcription)
        return _Radius(s, self._slopes[s.transcription])

    def _within(self, values: "_Values", freed: Array) -> Iterator[Row]:
        """The bounds of the freed parameters."""
        for name, value, slope, (low, high) in zip(self.free, freed, np.eye(freed.size), self.bounds.T, strict=True):
            gradient = values.extended(slope)
            yield Row(about=name, key=f"{name} lower", value=float(value - low), gradient=gradient)
            yield Row(about=name, key=f"{name} upper", value=float(high - value), gradient=-gradient)


class _Radius:
    """The multipliers of a gait, and how they answer to the freed parameters."""

    def __init__(self, s: Sensitivity, slope: ResponseSlope) -> None:
        self._s, self._slope = s, slope
        self._V, self.M, self._adjoint = section_response(s.transcription, s.at)
        self.value = max(float(np.abs(np.linalg.eigvals(self.M)).max()), SMALLEST_RADIUS)

    def by_freed(self, weights: Array) -> Array:
        """Derivatives of the return map's derivative, weighted by a matrix; shape (n_free,)."""
        at = self._s.at
        return self._slope(at.w, at.p, self._V, self._adjoint(weights), weights) @ self._s.slopes


class _Values:
    """Scalars with derivatives in u = (freed parameters, levels)."""

    def __init__(self, scalars: Scalars, radius: _Radius | None, levels: tuple[str, ...]) -> None:
        self.scalars, self._radius, self._levels = scalars, radius, levels

    def extended(self, gradient: Array, level: Array | float = 0.0) -> Array:
        """A derivative in the freed parameters with that in the levels; shape (n_u,)."""
        return np.append(gradient, np.zeros(len(self._levels)) + level)

    def single(self, name: str) -> Valued:
        """A scalar; of an extremum the one value that is it now."""
        if self._radius is not None and name == RADIUS:
            value, weights = modulus_gradient(self._radius.M)
            return value, self.extended(self._radius.by_freed(weights))
        if name not in EXTREMA:
            value, gradient = self.scalars.smooth(name)
            return value, self.extended(gradient)
        piece = self._extreme(name)
        return piece.value, self.extended(piece.gradient)

    def curvature(self, name: str) -> Array:
        """Stiff part of the second derivatives of a scalar; shape (n_u, n_u)."""
        n, whole = self.scalars.n_free, np.zeros((self.scalars.n_free + len(self._levels),) * 2)
        bent = self.scalars.curvature(name)
        if bent is not None:
            whole[:n, :n] = bent
        return whole

    def level(self, name: str) -> Valued:
        """A level at its extremum, and its derivative as an unknown."""
        value = self._radius.value if self._radius is not None and name == RADIUS else self._extreme(name).value
        n_free = self.scalars.n_free
        return value, np.append(np.zeros(n_free), [float(name == other) for other in self._levels])

    def beyond(self, name: str, bound: float, slope: Array, sense: int) -> Iterator[Row]:
        """No value of an extremum exceeds a bound, which is a level or a number; undercuts it where ``sense`` is -1."""
        if self._radius is not None and name == RADIUS:
            for row in circle_rows(self._radius.M, bound):
                gradient = self.extended(self._radius.by_freed(row.by_matrix)) + row.by_radius * slope
                yield Row(about=name, key=f"{name} {row.name}", value=row.value, gradient=gradient)
            return
        unit = max(abs(bound), UNIT)
        for piece in self.scalars.pieces(name):
            gradient = sense * (slope - self.extended(piece.gradient)) / unit
            value = sense * (bound - piece.value) / unit
            yield Row(about=name, key=f"{name} {piece.key}", value=value, gradient=gradient)

    def escaped(self, problem: Problem) -> bool:
        """Whether multipliers have left the circle of a bound two at a time."""
        bound = problem.constraints.get(RADIUS, Range(minimum=-np.inf, maximum=np.inf)).maximum
        if self._radius is None or self._radius.value <= bound + LEFT:
            return False
        return all(row.value > 0 for row in circle_rows(self._radius.M, bound))

    def _extreme(self, name: str) -> Piece:
        return max(self.scalars.pieces(name), key=lambda piece: EXTREMA[name] * piece.value)


def _margins(values: _Values) -> Iterator[Row]:
    for name, unit, piece in values.scalars.margins():
        least = CLEARANCE if "cone" in name else 0.0
        gradient = values.extended(piece.gradient) / unit
        yield Row(about=name, key=piece.key, value=(piece.value - least) / unit, gradient=gradient)


def _spanned(values: _Values, name: str, span: Range) -> Iterator[Row]:
    """The range of one scalar."""
    fixed = values.extended(np.zeros(values.scalars.n_free))
    sense = EXTREMA.get(name, 0)
    for bound, side in ((span.minimum, -1), (span.maximum, 1)):
        if not np.isfinite(bound):
            continue
        if sense == side and span.minimum < span.maximum:
            yield from values.beyond(name, bound, fixed, sense)
            continue
        value, gradient = values.single(name)
        unit = max(abs(bound), UNIT)
        equality = span.minimum == span.maximum
        row = Row(
            about=name,
            key=f"{name} {side:+d}",
            value=side * (bound - value) / unit,
            gradient=-side * gradient / unit,
            curvature=-side * values.curvature(name) / unit,
            equality=equality,
        )
        yield row
        if equality:
            return
