"""The exact problem of a design in its freed parameters only: the equations of the step are eliminated.

    min f(u)    s.t.    c(u) >= 0 or = 0,          u = (freed parameters, levels)

Nothing is smoothed. An extremum that is minimised has a level: a further unknown that bounds all values over which it
is the extremum. Every value has its own constraint, so that f and c are smooth where another value becomes the
extremum. The spectral radius is bounded by the circle inequalities of ``spectral_radius``.

The gait at given freed parameters is solved by Newton's method from a nearby one. If a switch passes a breakpoint of
the control, the step is cut into arcs again.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.design.sensitivity import Sensitivity
from gaitopt.design.spectral_radius import SMALLEST_RADIUS, circle_inequalities, modulus_gradient
from gaitopt.model.transitions import kind
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import SCALARS
from gaitopt.problem.statement import Range
from gaitopt.solver.newton import Solution, polish
from gaitopt.solver.rollout import rolled_again

RADIUS = "spectral_radius"
EXTREMA = {name: scalar.extremum for name, scalar in SCALARS.items() if scalar.extremum and scalar.of_designs}
"""Scalars that are the largest (1) or smallest (-1) of some values: of a curve, or of a number and its negative."""
LARGEST_RESIDUAL = 1e-10
"""Largest residual of the equations of the step at a gait."""
CLEARANCE = 1e-10
"""Distance in natural units between a design and the edge of the friction cone, or of an impact that would stick, where
optima often lie. It exceeds the rounding that would otherwise decide, and is less than anyone could measure."""
OUTSIDE = 1e-3
"""If all circle inequalities hold, but the spectral radius exceeds the circle by this, two multipliers left it
together."""
INACTIVE = 0.3
"""A circle inequality with a larger value, which is a product of numbers of the order of one, is not close to zero."""
UNIT = 1e-3
"""Smallest bound that serves as the unit of its scalar."""
SMALL = 1e-3
"""Smallest typical size of an extremum, objective or bound."""
SMALLEST_SIZE = 0.02
"""Smallest typical size of a freed parameter, relative to the range of its bounds."""


def freed_sizes(freed: Array, bounds: Array) -> Array:
    """Typical sizes of the freed parameters, from their values and bounds (2, n_free); shape (n_free,)."""
    span = bounds[1] - bounds[0]
    open_sizes = np.maximum(np.abs(freed), SMALLEST_SIZE * np.abs(freed).max(initial=SMALL))
    span = np.where(np.isfinite(span), span, open_sizes)
    return np.clip(np.abs(freed), SMALLEST_SIZE * span, span)


def clearance(name: str) -> float:
    """Smallest value of a margin, in natural units, in a design: at zero, rounding would decide on the mode."""
    return CLEARANCE if "cone" in name or kind(name) == "impact_onset" else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Constraint:
    """The condition ``value`` >= 0, or = 0 for an equality.

    Attributes
    ----------
    name : name of the bounded scalar, parameter or margin.
    key : name that distinguishes the constraint from others on the same quantity.
    value : value in natural units.
    gradient : ndarray, shape (n_u,) - derivative by the unknowns.
    by_work : derivative by the absolute work of the motors.
    equality : whether the value must be zero.
    """

    name: str
    key: str
    value: float
    gradient: Array
    by_work: float = 0.0
    equality: bool = False

    @property
    def violation(self) -> float:
        """Amount by which the condition is violated; 0 if it is met."""
        return abs(self.value) if self.equality else max(0.0, -self.value)


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """The exact problem at one point.

    Attributes
    ----------
    u : ndarray, shape (n_u,) - freed parameters, and levels.
    objective, gradient : value and gradient of the objective, shape (n_u,).
    by_work : derivative of the objective by the absolute work of the motors.
    constraints : margins, bounds, levels and constraints of the problem.
    sensitivity : the gait as a function of the freed parameters.
    """

    u: Array
    objective: float
    gradient: Array
    by_work: float
    constraints: tuple[Constraint, ...]
    sensitivity: Sensitivity

    @property
    def violation(self) -> float:
        """Largest violation of a constraint."""
        return max((constraint.violation for constraint in self.constraints), default=0.0)

    @property
    def total_violation(self) -> float:
        """Sum of all violations."""
        return sum(constraint.violation for constraint in self.constraints)

    @property
    def objective_size(self) -> float:
        """Typical size of the objective."""
        return max(abs(self.objective), SMALL)


class ExactProblem:
    """The exact problem of one design.

    Parameters
    ----------
    problem : the problem, with its objective and constraints.
    free, bounds : dotted keys of the freed parameters, and their bounds; shape (2, n_free).
    """

    def __init__(self, problem: Problem, free: tuple[str, ...], bounds: Array) -> None:
        self._problem, self.free, self.bounds = problem, free, bounds
        self.levels = tuple(
            name for name, weight in problem.objective.items() if name in EXTREMA and weight * EXTREMA[name] > 0
        )

    def evaluate(self, start: Solution, levels: Array | None = None) -> Evaluation | None:
        """The problem at the gait next to ``start``, with its freed parameters; None if there is no gait.

        Parameters
        ----------
        levels : shape (n_levels,) - values of the levels; by default those of their extrema.
        """
        solution = polish(start)
        if not solution.size < LARGEST_RESIDUAL or not (solution.durations > 0).all():
            return None
        if not solution.in_order:  # a switch has passed a breakpoint: cut the same gait into arcs again
            solution = polish(rolled_again(solution).on_mesh(start.equations.free))
            if not solution.size < LARGEST_RESIDUAL or not solution.in_order:
                return None
        return self._evaluated(solution, levels)

    def evaluate_beside(self, here: Evaluation, step: Array) -> Evaluation | None:
        """The problem at a step (n_u,) from here; None if Newton's method finds no gait."""
        s, n = here.sensitivity, len(self.free)
        w = s.solution.w + s.slopes @ step[:n]
        w[-n:] = np.clip(w[-n:], *self.bounds)  # the step satisfies the bounds only up to rounding
        return self.evaluate(Solution(s.equations, w, s.solution.p), here.u[n:] + step[n:])

    def _evaluated(self, solution: Solution, levels: Array | None) -> Evaluation | None:
        try:
            s = Sensitivity(solution)
        except RuntimeError:  # singular
            return None
        problem, measured = self._problem, _ExactScalars(s, len(self.levels))
        if levels is None:
            levels = np.array([measured.extreme(name) for name in self.levels])
        span = problem.constraints.get(RADIUS)
        allowed = [] if span is None else [span.maximum]
        allowed += [level for name, level in zip(self.levels, levels.tolist(), strict=True) if name == RADIUS]
        if measured.escaped(min(allowed, default=np.inf)):
            return None
        u = np.concatenate([s.freed, levels])
        axes = np.eye(u.size)
        level_axes = dict(zip(self.levels, axes[s.freed.size :], strict=True))
        level_values = dict(zip(self.levels, levels.tolist(), strict=True))

        objective, gradient, by_work = 0.0, np.zeros(u.size), 0.0
        for name, weight in problem.objective.items():
            is_level = name in level_axes
            value, slope = (level_values[name], level_axes[name]) if is_level else measured.scalar(name)
            objective, gradient = objective + weight * value, gradient + weight * slope
            by_work += weight * s.by_work(name)

        constraints = [*measured.margins(), *measured.invariance()]
        for name, value, axis, (low, high) in zip(self.free, s.freed, axes, self.bounds.T, strict=False):
            constraints.append(Constraint(name=name, key=f"{name} lower", value=float(value - low), gradient=axis))
            constraints.append(Constraint(name=name, key=f"{name} upper", value=float(high - value), gradient=-axis))
        for name, axis in level_axes.items():
            constraints += measured.bounded(name, level_values[name], axis, EXTREMA[name])
        for name, span in problem.constraints.items():
            constraints += measured.within(name, span)
        return Evaluation(
            u=u,
            objective=float(objective),
            gradient=gradient,
            by_work=by_work,
            constraints=tuple(constraints),
            sensitivity=s,
        )


class _ExactScalars:
    """Scalars of one gait, and constraints on them, with derivatives by u = (freed parameters, levels)."""

    def __init__(self, sensitivity: Sensitivity, n_levels: int) -> None:
        self.gait = sensitivity
        self._no_levels, self._zero = np.zeros(n_levels), np.zeros(sensitivity.freed.size + n_levels)

    def scalar(self, name: str) -> tuple[float, Array]:
        """A scalar and its derivatives; an extremum has those of the value that is the extremum here."""
        if name == RADIUS:
            value, weights = modulus_gradient(self.gait.solution.return_map.by_section)
            return value, self._by_return_map(weights)
        if name not in EXTREMA:
            value, gradient = self.gait.smooth(name)
        else:
            _, value, gradient = max(self.gait.candidates(name), key=lambda c: EXTREMA[name] * c.value)
        return value, self._in_u(gradient)

    def extreme(self, name: str) -> float:
        """The value of an extremum."""
        if name == RADIUS:
            return max(
                float(np.abs(np.linalg.eigvals(self.gait.solution.return_map.by_section)).max()), SMALLEST_RADIUS
            )
        return self.scalar(name)[0]

    def escaped(self, radius: float) -> bool:
        """Whether two multipliers together have left the circle of this radius."""
        if not np.isfinite(radius) or self.extreme(RADIUS) <= radius + OUTSIDE:
            return False
        return all(row.value > 0 for row in circle_inequalities(self.gait.solution.return_map.by_section, radius))

    def margins(self) -> Iterator[Constraint]:
        """The margins of the modes and of the impact."""
        for name, unit, candidate in self.gait.margins():
            value = candidate.value / unit - clearance(name)
            yield Constraint(name=name, key=candidate.key, value=value, gradient=self._in_u(candidate.gradient) / unit)

    def invariance(self) -> Iterator[Constraint]:
        """The outputs of invariant curves and their rates just after the impact, which must be zero."""
        for name, unit, (key, value, gradient) in self.gait.invariance():
            yield Constraint(
                name=name, key=key, value=value / unit, gradient=self._in_u(gradient) / unit, equality=True
            )

    def bounded(self, name: str, bound: float, slope: Array, sense: int) -> Iterator[Constraint]:
        """Constraints by which all values lie below a bound with derivative ``slope``; above it if ``sense`` is -1."""
        if name == RADIUS:
            for row in circle_inequalities(self.gait.solution.return_map.by_section, bound):
                if row.value <= INACTIVE:
                    gradient = self._by_return_map(row.by_matrix) + row.by_radius * slope
                    yield Constraint(name=name, key=f"{name} {row.name}", value=row.value, gradient=gradient)
            return
        unit = max(abs(bound), UNIT)
        for candidate in self.gait.candidates(name):
            gradient = sense * (slope - self._in_u(candidate.gradient)) / unit
            value = sense * (bound - candidate.value) / unit
            yield Constraint(name=name, key=f"{name} {candidate.key}", value=value, gradient=gradient)

    def within(self, name: str, span: Range) -> Iterator[Constraint]:
        """Constraints by which a scalar is in its range."""
        equality = span.minimum == span.maximum
        for bound, side in ((span.minimum, -1), (span.maximum, 1)):
            if not np.isfinite(bound):
                continue
            if EXTREMA.get(name, 0) == side and not equality:
                yield from self.bounded(name, bound, self._zero, side)
                continue
            value, gradient = self.scalar(name)
            unit = max(abs(bound), UNIT)
            yield Constraint(
                name=name,
                key=f"{name} {side:+d}",
                value=side * (bound - value) / unit,
                gradient=-side * gradient / unit,
                by_work=-side * self.gait.by_work(name) / unit,
                equality=equality,
            )
            if equality:
                return

    def _by_return_map(self, weights: Array) -> Array:
        """Derivatives of <weights, M> by u."""
        return self._in_u(self.gait.by_return_map(weights))

    def _in_u(self, gradient: Array) -> Array:
        return np.append(gradient, self._no_levels)
