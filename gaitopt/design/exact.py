"""The exact problem of a design in its freed parameters only: the equations of the step are eliminated.

    min f(u)    s.t.    c(u) >= 0 or = 0,          u = (freed parameters, levels)

A design may have several *scenarios*: gaits with the same freed parameters at different values of another parameter,
such as friction. Each scenario has its own motion, mode sequence and constraints. The objective is a weighted sum over
the scenarios, or the largest value of all, which is then the last level.

Nothing is smoothed. An extremum that is minimised has a level: a further unknown that bounds all values over which it
is the extremum. Every value has its own constraint, so that f and c are smooth where another value becomes the
extremum. The spectral radius is bounded by the circle inequalities of ``spectral_radius``.

The gait at given freed parameters is solved by Newton's method from a nearby one. If a switch passes a breakpoint of
the control, the step is cut into arcs again.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitopt.arrays import Array
from gaitopt.design.sensitivity import Sensitivity
from gaitopt.design.spectral_radius import RADIUS, SMALLEST_RADIUS, circle_inequalities, modulus_gradient
from gaitopt.model.transitions import kind
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import SCALARS
from gaitopt.problem.statement import Range
from gaitopt.solver.newton import Solution, polish
from gaitopt.solver.rollout import rolled_again

WORST = "worst"
"""Name of the constraint that a scenario's objective is at most the largest one."""
EXTREMA = {name: scalar.extremum for name, scalar in SCALARS.items() if scalar.extremum and scalar.of_designs}
"""Scalars that are the largest (1) or smallest (-1) of some values: of a curve, or of a number and its negative."""
LARGEST_RESIDUAL = 1e-10
"""Largest residual of the equations of the step at a gait."""
CLEARANCE = 1e-10
"""Distance in natural units between a design and the edge of the friction cone, or of an impact that would stick, where
optima often lie. It exceeds the rounding that would otherwise decide, and is less than anyone could measure."""
OUTSIDE = 1e-3
"""Excess of the spectral radius over the circle above which two multipliers have left it together, although all circle
inequalities hold."""
INACTIVE = 0.3
"""A circle inequality with a larger value is left out: it is a product of numbers of the order of one, and far from
zero."""
UNIT = 1e-3
"""Smallest unit of a constraint on a scalar; a larger bound is itself the unit."""
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
    by_work : derivative by the absolute work of the motors in its scenario.
    scenario : index of its scenario.
    equality : whether the value must be zero.
    """

    name: str
    key: str
    value: float
    gradient: Array
    by_work: float = 0.0
    scenario: int = 0
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
    by_work : ndarray, shape (n_scenarios,) - derivatives of the objective by the absolute work of the motors in each
        scenario.
    constraints : margins, bounds, levels and constraints of the problem.
    scenarios : the gaits as functions of the freed parameters.
    """

    u: Array
    objective: float
    gradient: Array
    by_work: Array
    constraints: tuple[Constraint, ...]
    scenarios: tuple[Sensitivity, ...]

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
    shares : weight of each scenario in the objective.
    worst : whether the objective is the largest value of all scenarios instead.
    """

    def __init__(
        self,
        problem: Problem,
        free: tuple[str, ...],
        bounds: Array,
        shares: Sequence[float] = (1.0,),
        *,
        worst: bool = False,
    ) -> None:
        self._problem, self.free, self.bounds, self._shares, self._worst = problem, free, bounds, shares, worst
        extrema = [n for n, weight in problem.objective.items() if n in EXTREMA and weight * EXTREMA[n] > 0]
        self.levels = tuple((k, name) for k, share in enumerate(shares) if worst or share for name in extrema)
        self._n_levels = len(self.levels) + worst

    def evaluate(self, starts: Sequence[Solution], levels: Array | None = None) -> Evaluation | None:
        """The problem at the gaits next to ``starts``, one per scenario; None if there is no gait.

        All have the same freed parameters.

        Parameters
        ----------
        levels : shape (n_levels,) - values of the levels; by default those of their extrema.
        """
        gaits = list[Sensitivity]()
        for start in starts:
            solution = _gait_near(start)
            if solution is None:
                return None
            try:
                gaits.append(Sensitivity(solution))
            except RuntimeError:  # singular
                return None
        return self._evaluated(gaits, levels)

    def evaluate_beside(self, here: Evaluation, step: Array) -> Evaluation | None:
        """The problem at a step (n_u,) from here; None if Newton's method finds no gait."""
        n, starts = len(self.free), list[Solution]()
        for s in here.scenarios:
            w = s.solution.w + s.slopes @ step[:n]
            w[-n:] = np.clip(w[-n:], *self.bounds)  # the step satisfies the bounds only up to rounding
            starts.append(Solution(s.equations, w, s.solution.p))
        return self.evaluate(starts, here.u[n:] + step[n:])

    def _evaluated(self, gaits: Sequence[Sensitivity], levels: Array | None) -> Evaluation | None:
        problem, freed = self._problem, gaits[0].freed
        measured = [_ExactScalars(gait, self._n_levels) for gait in gaits]
        if levels is None:
            levels = np.array([measured[k].extreme(name) for k, name in self.levels])
            if self._worst:
                weights = problem.objective.items()
                levels = np.append(levels, max(sum(w * each.scalar(n)[0] for n, w in weights) for each in measured))
        u = np.concatenate([freed, levels])
        axes = np.eye(u.size)
        own_levels: list[dict[str, tuple[float, Array]]] = [{} for _ in gaits]
        for (k, name), level, axis in zip(self.levels, levels.tolist(), axes[freed.size :], strict=False):
            own_levels[k][name] = level, axis
        span = problem.constraints.get(RADIUS)

        objective, gradient, by_work = 0.0, np.zeros(u.size), np.zeros(len(gaits))
        if self._worst:
            objective, gradient = float(u[-1]), axes[-1]
        constraints = list[Constraint]()
        for k, (scalars, share) in enumerate(zip(measured, self._shares, strict=True)):
            own = own_levels[k]
            allowed = [] if span is None else [span.maximum]
            allowed += [level for name, (level, _) in own.items() if name == RADIUS]
            if scalars.escaped(min(allowed, default=np.inf)):
                return None
            value, slope, by = 0.0, np.zeros(u.size), 0.0
            if share or self._worst:
                for name, weight in problem.objective.items():
                    term, by_u = own[name] if name in own else scalars.scalar(name)
                    value, slope = value + weight * term, slope + weight * by_u
                    by += weight * scalars.gait.by_work(name)
            objective, gradient, by_work[k] = objective + share * value, gradient + share * slope, share * by
            rows = [*scalars.margins(), *scalars.invariance()]
            if k == 0:
                for name, parameter, axis, (low, high) in zip(self.free, freed, axes, self.bounds.T, strict=False):
                    lower, upper = float(parameter - low), float(high - parameter)
                    rows.append(Constraint(name=name, key=f"{name} lower", value=lower, gradient=axis))
                    rows.append(Constraint(name=name, key=f"{name} upper", value=upper, gradient=-axis))
            for name, (level, axis) in own.items():
                rows += scalars.bounded(name, level, axis, EXTREMA[name])
            for name, bounds in problem.constraints.items():
                rows += scalars.within(name, bounds)
            if self._worst:
                unit = max(abs(objective), SMALL)
                below = (axes[-1] - slope) / unit
                room = (objective - value) / unit
                rows.append(Constraint(name=WORST, key=WORST, value=room, gradient=below, by_work=-by / unit))
            constraints += rows if k == 0 else (replace(row, key=f"{k} {row.key}", scenario=k) for row in rows)
        return Evaluation(
            u=u,
            objective=float(objective),
            gradient=gradient,
            by_work=by_work,
            constraints=tuple(constraints),
            scenarios=tuple(gaits),
        )


def _gait_near(start: Solution) -> Solution | None:
    """The gait next to a motion, with its freed parameters; None if there is none."""
    solution = polish(start)
    if not solution.size < LARGEST_RESIDUAL or not (solution.durations > 0).all():
        return None
    if not solution.in_order:  # a switch has passed a breakpoint: cut the same gait into arcs again
        solution = polish(rolled_again(solution).on_mesh(start.equations.free))
        if not solution.size < LARGEST_RESIDUAL or not solution.in_order:
            return None
    return solution


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
        equality = span.is_equality
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
