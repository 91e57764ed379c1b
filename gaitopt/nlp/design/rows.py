"""Objective and constraints of a design as numbers with exact derivatives in the freed parameters.

Each constraint is a row that is not negative, or zero. An extremum is bounded by one row for each of the values whose
extremum it is; the radius of the multipliers by the inequalities of ``nlp.moduli``.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.nlp.design.moduli import circle_rows, modulus_gradient
from gaitopt.nlp.design.outcome import EXTREMA, RADIUS
from gaitopt.nlp.design.scalars import Piece, Scalars, Valued
from gaitopt.nlp.design.sensitivity import Sensitivity
from gaitopt.nlp.design.spectral_radius import ResponseSlope
from gaitopt.nlp.newton import section_sensitivity
from gaitopt.problem import Problem, Range

CLEARANCE = 1e-10
"""Force or impulse, in natural units, that a design keeps from the edge of the friction cone, where optima like to lie:
more than the rounding that would decide there, and less than anyone could measure."""
SMALLEST_RADIUS = 1e-3
"""Multipliers below it are as good as zero: deviations vanish in a step."""
LEFT = 1e-3
"""Multipliers so far outside of a circle whose inequalities all hold have left it two at a time."""
FAR = 0.3
"""An inequality of the circle, a product of numbers of the order of one, that is not about to become zero."""
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
    by_work : derivative in the absolute work of the motors.
    """

    about: str
    key: str
    value: float
    gradient: Array
    by_work: float = 0.0
    equality: bool = False

    @property
    def violation(self) -> float:
        """How far it is from being met."""
        return abs(self.value) if self.equality else max(0.0, -self.value)


class Radius:
    """The multipliers of a gait, and how they answer to the freed parameters."""

    def __init__(self, s: Sensitivity, slope: ResponseSlope) -> None:
        self._s, self._slope = s, slope
        self._V, self.M, self._adjoint = section_sensitivity(s.at)
        self.value = max(float(np.abs(np.linalg.eigvals(self.M)).max()), SMALLEST_RADIUS)

    def by_freed(self, weights: Array) -> Array:
        """Derivatives of the return map's derivative, weighted by a matrix; shape (n_free,)."""
        at = self._s.at
        return self._slope(at.w, at.p, self._V, self._adjoint(weights), weights) @ self._s.slopes


class Values:
    """Scalars with derivatives in u = (freed parameters, levels).

    Parameters
    ----------
    levels : names of the extrema that have a level.
    heights : the levels, shape (n_levels,); at their extrema unless given.
    """

    def __init__(
        self, scalars: Scalars, radius: Radius | None, levels: tuple[str, ...], heights: Array | None = None
    ) -> None:
        self.scalars, self._radius, self._levels = scalars, radius, levels
        self.heights = np.array([self._height(name) for name in levels]) if heights is None else heights

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

    def level(self, name: str) -> Valued:
        """A level, and its derivative as an unknown."""
        k = self._levels.index(name)
        return float(self.heights[k]), self.extended(np.zeros(self.scalars.n_free), np.eye(len(self._levels))[k])

    def beyond(self, name: str, bound: float, slope: Array, sense: int) -> Iterator[Row]:
        """No value of an extremum exceeds a bound, which is a level or a number; undercuts it where ``sense`` is -1."""
        if self._radius is not None and name == RADIUS:
            for row in circle_rows(self._radius.M, bound):
                if row.value > FAR:
                    continue
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
        if RADIUS in self._levels:
            bound = min(bound, self.level(RADIUS)[0])
        if self._radius is None or self._radius.value <= bound + LEFT:
            return False
        return all(row.value > 0 for row in circle_rows(self._radius.M, bound))

    def _height(self, name: str) -> float:
        return self._radius.value if self._radius is not None and name == RADIUS else self._extreme(name).value

    def _extreme(self, name: str) -> Piece:
        return max(self.scalars.pieces(name), key=lambda piece: EXTREMA[name] * piece.value)


def margin_rows(values: Values) -> Iterator[Row]:
    """The margins of the modes and of the impact."""
    for name, unit, piece in values.scalars.margins():
        least = CLEARANCE if "cone" in name else 0.0
        gradient = values.extended(piece.gradient) / unit
        yield Row(about=name, key=piece.key, value=piece.value / unit - least, gradient=gradient)


def span_rows(values: Values, name: str, span: Range) -> Iterator[Row]:
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
            by_work=-side * values.scalars.by_work(name) / unit,
            equality=equality,
        )
        yield row
        if equality:
            return
