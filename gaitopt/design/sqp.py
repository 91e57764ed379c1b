"""Sequential programming in the freed parameters: the best step of a ``model`` at each point, as far as it is a gain.

The model's Hessian is taken by differences of the Lagrangian's gradient once, and learnt from then on by symmetric
secant updates (Powell 1970), what the changes of sign of the power add to it being known at every point.

A design in its freed parameters alone: the equations of the step eliminated, nothing smoothed.

    min f(u)    s.t.    rows(u) >= 0 or = 0,          u = (freed parameters, levels)

A level stands for an extremum that is minimised: every value whose extremum it is stays on its side.

How far a point is from being optimal: the first-order conditions of Karush, Kuhn and Tucker, nothing smoothed.

    min over l >= 0 of | grad f - sum l_i grad c_i |,        c_i the active constraints; l_i of any sign for equalities

in the freed parameters and levels of ``reduced``, each in its typical size, f relative to itself. A level whose
derivative must vanish as well makes the hull of the gradients of a maximum. Moduli of multipliers that coalesce are
not Lipschitz; the inequalities of ``nlp.moduli`` that stand for them are smooth.

What is known of a design next to a point, and the best step by it.

    min  g' d + d' B d / 2 + a r(d)    s.t.  A d + b + c r(d) >= 0,    |d_i| <= reach

with the remainder r of the absolute work (``absolute_work``), solved by sequential quadratic programming of its own: r
costs a hundredth of a gait. B is the rest of the Lagrangian's Hessian. Unknowns and objective are counted in their
typical sizes throughout.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.design.quadratic import SMALL, least_distance, nonnegative
from gaitopt.design.rows import EXTREMA, RADIUS, Radius, Row, Scalars, Values, margin_rows, span_rows
from gaitopt.design.sensitivity import Remainder, Sensitivity, WorkRemainder, sensitivity
from gaitopt.design.spectral_radius import ResponseSlope
from gaitopt.nlp.ipopt import Progress
from gaitopt.nlp.layout import layout
from gaitopt.nlp.newton import Solution, polish
from gaitopt.nlp.rollout import roll_out
from gaitopt.nlp.shooting import MultipleShooting
from gaitopt.problem.problem import Problem

SOLVED = 1e-10
"""Residual of the equations of the step at a point."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """The reduced problem at one set of freed parameters.

    Attributes
    ----------
    u : ndarray, shape (n_u,) - freed parameters, and levels.
    objective, gradient : of what is minimised, shape (n_u,).
    by_work : derivative of the objective in the absolute work of the motors.
    rows : all constraints.
    sensitivity : the gait.
    """

    u: Array
    objective: float
    gradient: Array
    by_work: float
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
        self._slopes: dict[MultipleShooting, ResponseSlope] = {}

    def first(self, transcription: MultipleShooting, w: Array, p: Array, heights: Array | None = None) -> Point | None:
        """The point at nodes, durations and freed parameters ``w``; None where there is no gait.

        ``heights`` are the levels, at their extrema unless given.
        """
        at = polish(transcription, w, p)
        if not at.size < SOLVED or not (transcription.unpack(at.w).durations > 0).all():
            return None
        if not self._in_order(transcription, at.w):
            return self._recut(transcription, at.w, p, heights)
        return self._point(transcription, at, heights)

    def moved(self, point: Point, step: Array) -> Point | None:
        """The point a step (n_u,) away; None where Newton's method finds no gait from here."""
        s, n = point.sensitivity, len(self.free)
        w = s.at.w + s.slopes @ step[:n]
        w[-n:] = np.clip(w[-n:], *self.bounds)  # to which the step keeps up to rounding
        return self.first(s.transcription, w, s.at.p, point.u[n:] + step[n:])

    def _in_order(self, t: MultipleShooting, w: Array) -> bool:
        return t.layout.in_order(t.unpack(w).durations, t.system.control.breakpoints)

    def _recut(self, t: MultipleShooting, w: Array, p: Array, heights: Array | None) -> Point | None:
        """The same gait on the arcs that it has after a switch has passed a breakpoint of the control."""
        nodes, durations, freed = t.unpack(w)
        rolled = roll_out(t.dynamics(p, freed), t.layout.cycle, nodes[:, 0], list(durations))
        plan = layout(t.layout.cycle, durations, t.system.control.breakpoints)
        cut = MultipleShooting(t.system, plan, t.free)
        at = polish(cut, cut.pack(rolled.nodes(plan), durations, freed), p)
        return self._point(cut, at, heights) if at.size < SOLVED and self._in_order(cut, at.w) else None

    def _point(self, t: MultipleShooting, at: Solution[MultipleShooting], heights: Array | None) -> Point | None:
        try:
            s = sensitivity(t, at)
        except RuntimeError:  # singular
            return None
        freed = s.transcription.unpack(s.at.w).freed
        values = Values(Scalars(s), self._radius(s), self.levels, heights)
        if values.escaped(self._problem):
            return None
        objective, by_work, gradient = 0.0, 0.0, np.zeros(freed.size + len(self.levels))
        for name, weight in self._problem.objective.items():
            value, slope = values.level(name) if name in self.levels else values.single(name)
            objective, gradient = objective + weight * value, gradient + weight * slope
            by_work += weight * values.scalars.by_work(name)
        rows = [*margin_rows(values), *self._within(values, freed)]
        for name in self.levels:
            rows += values.beyond(name, *values.level(name), EXTREMA[name])
        for name, span in self._problem.constraints.items():
            rows += span_rows(values, name, span)
        u = np.concatenate([freed, values.heights])
        return Point(
            u=u, objective=float(objective), gradient=gradient, by_work=by_work, rows=tuple(rows), sensitivity=s
        )

    def _radius(self, s: Sensitivity) -> Radius | None:
        if RADIUS not in self._problem.objective and RADIUS not in self._problem.constraints:
            return None
        if s.transcription not in self._slopes:
            self._slopes[s.transcription] = ResponseSlope(s.transcription)
        return Radius(s, self._slopes[s.transcription])

    def _within(self, values: Values, freed: Array) -> Iterator[Row]:
        """The bounds of the freed parameters."""
        for name, value, slope, (low, high) in zip(self.free, freed, np.eye(freed.size), self.bounds.T, strict=True):
            gradient = values.extended(slope)
            yield Row(about=name, key=f"{name} lower", value=float(value - low), gradient=gradient)
            yield Row(about=name, key=f"{name} upper", value=float(high - value), gradient=-gradient)


ACTIVE = 1e-7
"""A constraint is active where so small a change of the unknowns, relative to their sizes, would violate it."""
NEGLIGIBLE = 1e-6
"""Gradient of a constraint, in its natural unit and sizes, below which the unknowns do not govern it."""


def kkt_residual(point: Point, sizes: Array) -> tuple[float, dict[str, float]]:
    """Residual of the optimality conditions at a point, and the multipliers that make it least.

    Parameters
    ----------
    sizes : typical sizes of the unknowns, shape (n_u,); the objective's is its value.
    """
    gradient = point.gradient * sizes / objective_size(point)
    rows, columns = [], []
    for row in point.rows:
        column = row.gradient * sizes
        length = float(np.linalg.norm(column))
        if length > NEGLIGIBLE and (row.equality or row.value / length <= ACTIVE):
            for sign in (1.0, -1.0) if row.equality else (1.0,):
                rows.append((row, sign / length))
                columns.append(sign * column / length)
    if not columns:
        return float(np.linalg.norm(gradient)), {}
    basis = np.array(columns).T
    weights = nonnegative(basis, gradient)
    residual = np.linalg.norm(basis @ weights - gradient)
    multipliers: dict[str, float] = {}
    for (row, scale), weight in zip(rows, weights, strict=True):
        if weight > 0:
            multipliers[row.key] = multipliers.get(row.key, 0.0) + scale * weight
    return float(residual), multipliers


def objective_size(point: Point) -> float:
    """Typical size of what is minimised."""
    return max(abs(point.objective), SMALL)


MAX_STEPS = 60
"""Of the quadratic programs of one model."""
PRECISE = 1e-3
"""Last step of a model, relative to all of them: models are solved as precisely as they describe."""
SHORTEST = 1e-9
"""Part of a step after which a line search gives up: r may bend by its root next to a touch of zero."""
ARMIJO = 1e-4
"""Part of the gain that the slope promises which a step must reach."""
ROUNDING = 1e-14
"""Of the merit of a model."""
FLATTEST, STIFFEST = 1e-6, 1e7
"""Least and largest curvature of a quadratic program. That of r grows like the inverse root of the distance from where
the power touches zero, and there Newton's step would have no length."""
RELAXED = 1e4
"""Curvature of the slack of a quadratic program whose constraints contradict each other."""
PENALTY = 2.0
"""Weight of violations in the merit function, in multipliers."""


class Model:
    """The model at a point.

    Parameters
    ----------
    sizes : of the unknowns, shape (n_u,).
    reach : longest step in any of them, relative to its size.
    """

    def __init__(self, point: Point, sizes: Array, reach: float) -> None:
        self.point, self.sizes, self.scale, self.reach = point, sizes, objective_size(point), reach
        self.gradient = point.gradient * sizes / self.scale
        farthest = 2 * reach * np.sqrt(sizes.size)
        lengths = [float(np.linalg.norm(row.gradient * sizes)) for row in point.rows]
        near = [a > NEGLIGIBLE and row.value < farthest * a for row, a in zip(point.rows, lengths, strict=True)]
        self.rows = [row for row, counts in zip(point.rows, near, strict=True) if counts]
        self.A = np.array([row.gradient * sizes for row in self.rows]).reshape(-1, sizes.size)
        self.b = np.array([row.value for row in self.rows])
        self._equality = np.array([row.equality for row in self.rows], dtype=bool)
        self._work, self._work_rows = point.by_work / self.scale, np.array([row.by_work for row in self.rows])
        works = self._work != 0 or bool(self._work_rows.any())
        self._remainder = WorkRemainder(point.sensitivity.arcs if works else (), sizes)

    def solve(self, rest: Array, weights: Array, shift: Array | float = 0.0) -> tuple[Array, Array]:
        """Step and multipliers of the rows; shapes (n_u,) and (n_rows,).

        Parameters
        ----------
        rest : B, shape (n_u, n_u).
        weights : guess of the multipliers.
        shift : added to the values of the rows.
        """
        d, penalty = np.zeros(self.sizes.size), 0.0
        for _ in range(MAX_STEPS):
            r = self._remainder.at(d)
            H = _definite(rest + self._stiffness(weights) * r.hessian)
            gradient = self.gradient + rest @ d + self._work * r.gradient
            A = self.A + np.outer(self._work_rows, r.gradient)
            values = self._values(d, r) + shift
            step, weights = self._quadratic(H, gradient, A, values, d)
            penalty = raised(penalty, weights)
            slope = min(0.0, float(gradient @ step) - penalty * self._violation(values))
            merit = partial(self.merit, rest=rest, penalty=penalty, shift=shift)
            part = _better_part(merit, d, step, slope)
            d = d + part * step
            if part * np.linalg.norm(step) <= PRECISE * np.linalg.norm(d):
                break
        return d, weights

    def merit(self, d: Array, rest: Array, penalty: float, shift: Array | float = 0.0) -> float:
        """Gain of the objective by the model, with violations as a penalty."""
        r = self._remainder.at(d)
        change = self.gradient @ d + d @ rest @ d / 2 + self._work * r.value
        return float(change) + penalty * self._violation(self._values(d, r) + shift)

    def predicted(self, d: Array) -> Array:
        """Values of the rows after a step; shape (n_rows,)."""
        return self._values(d, self._remainder.at(d))

    def weights(self, multipliers: Mapping[str, float]) -> Array:
        """Multipliers by their keys as those of the rows; shape (n_rows,)."""
        return np.array([multipliers.get(row.key, 0.0) for row in self.rows])

    def secant(self, after: Point, weights: Array) -> tuple[Array, Array]:
        """A step, and the change of the Lagrangian's gradient that r does not explain; each of shape (n_u,)."""
        gradients = {row.key: row.gradient for row in after.rows}
        s = (after.u - self.point.u) / self.sizes
        y = after.gradient * self.sizes / self.scale - self.gradient
        for row, a, weight in zip(self.rows, self.A, weights, strict=True):
            if weight != 0.0 and row.key in gradients:
                y = y - weight * (gradients[row.key] * self.sizes - a)
        return s, y - self._stiffness(weights) * self._remainder.at(s).gradient

    def _stiffness(self, weights: Array) -> float:
        return self._work - float(weights @ self._work_rows)

    def _values(self, d: Array, r: Remainder) -> Array:
        return self.b + self.A @ d + self._work_rows * r.value

    def _violation(self, values: Array) -> float:
        return float(np.where(self._equality, np.abs(values), np.maximum(0.0, -values)).sum())

    def _quadratic(self, H: Array, gradient: Array, A: Array, b: Array, d: Array) -> tuple[Array, Array]:
        n, m = d.size, b.size
        box = np.vstack([np.eye(n), -np.eye(n)])
        A = np.vstack([A, -A[self._equality], box])
        c = np.concatenate([b, -b[self._equality], self.reach + d, self.reach - d])
        solution = least_distance(H, gradient, A, c)
        if solution is None:  # the linearised constraints contradict each other: all of them are relaxed alike
            wide = np.zeros((n + 1, n + 1))
            wide[:n, :n], wide[n, n] = H, RELAXED
            slack = np.maximum(0.0, -c)[:, None]
            solution = least_distance(wide, np.append(gradient, 0.0), np.hstack([A, slack]), c)
        if solution is None:
            raise np.linalg.LinAlgError("the relaxed quadratic program, which has a solution, was not solved")
        step, every = solution
        weights = every[:m].copy()
        weights[self._equality] -= every[m : m + int(self._equality.sum())]
        return step[:n], weights


def raised(penalty: float, weights: Array) -> float:
    """Weight of violations in the next merit function."""
    return max(PENALTY * float(np.abs(weights).max(initial=0.0)), penalty / PENALTY)


def _better_part(merit: Callable[[Array], float], d: Array, step: Array, slope: float) -> float:
    """The first part of a step that is better; 0 where none is."""
    now, part = merit(d), 1.0
    while part >= SHORTEST:
        if merit(d + part * step) <= now + ARMIJO * part * slope + ROUNDING:
            return part
        part /= 2
    return 0.0


def _definite(H: Array) -> Array:
    """The nearest matrix whose curvatures are neither too flat nor too stiff."""
    values, vectors = np.linalg.eigh(H)
    return np.asarray((vectors * np.clip(values, FLATTEST, STIFFEST)) @ vectors.T)


MAX_SWIFT, MAX_ITERATIONS = 40, 200
"""Of a search with the curvature as it is, and of a cautious one."""
DAMPING = 0.2
"""Part of the curvature so far that an update must leave, Powell (1978)."""
OPTIMALITY, MET = 1e-6, 1e-9
"""KKT residual, and violation of constraints in their natural units, of a design that is called converged."""
OPTIMAL, FEASIBLE = 1e-7, 1e-11
"""The same from where a search ends as soon as it no longer converges fast, by the rounding of a gait."""
FAST = 0.1
"""Ratio of KKT residuals of a search that still does."""
FIRST_REACH = 0.3
"""Longest first step, relative to the sizes of the unknowns; twice as far after one that went as the model promised."""
LEAST_REACH = 1e-3
"""Shorter steps are left to the line search."""
SHRUNK, HOPELESS = 0.1, 1e-5
"""Ratio of reaches after a step of which no part is better, and a reach at which the search is given up."""
EDGE = 0.99
"""Part of the reach from where a step counts as kept by it."""
PROMISED = 0.7
"""Part of the gain by the model that is meant by that."""
SHORTEST_SQP = 1e-4
"""Part of a step after which a line search gives up."""
DIFFERENCE = 1e-4
"""Step of the differences of gradients, relative to the sizes: a thousand times what a gait is solved to."""
ROUNDING_SQP = 1e-11
"""Of the merit: that of a gait, times the weight of its constraints."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """Where a search ended.

    Attributes
    ----------
    point : the point.
    kkt : least norm of the objective's gradient less nonnegative multiples of those of the active constraints.
    multipliers : of the active constraints, by their keys.
    iterations : how many.
    interrupted : whether it was stopped on request.
    """

    point: Point
    kkt: float
    multipliers: dict[str, float]
    iterations: int
    interrupted: bool

    @property
    def shortcoming(self) -> str | None:
        """What it lacks to be an optimum."""
        if not self.point.violation < MET:
            worst = max(self.point.rows, key=lambda row: row.violation)
            return f"{worst.about} is only met to {worst.violation:.2g}"
        if not self.kkt < OPTIMALITY:
            return f"stalled: the optimality conditions are only met to {self.kkt:.2g}"
        return None


def optimise(
    problem: Reduced,
    start: Point,
    sizes: Array,
    *,
    cautious: bool = False,
    progress: Progress | None = None,
    should_stop: Stop = None,
) -> Optimum:
    """The optimum next to a point.

    Parameters
    ----------
    sizes : typical sizes of the unknowns, shape (n_u,).
    cautious : learn the curvature from one on and keep it positive. This takes more iterations, but goes round where
        gaits end, while the curvature as it is leads there.
    progress : called at every iteration with its number and the largest violation.
    should_stop : polled at every iteration; True ends the search.
    """
    point, penalty, reach = start, 0.0, FIRST_REACH
    rest: Array | None = np.eye(sizes.size) if cautious else None
    before, learnt = None, False
    for iteration in range((MAX_ITERATIONS if cautious else MAX_SWIFT) + 1):
        kkt, multipliers = kkt_residual(point, sizes)
        if progress is not None:
            progress(iteration, point.violation)
        interrupted = should_stop is not None and should_stop()
        here = Optimum(point=point, kkt=kkt, multipliers=multipliers, iterations=iteration, interrupted=interrupted)
        if interrupted:
            break
        if before is not None and before.kkt < OPTIMAL and kkt >= FAST * before.kkt and point.violation < FEASIBLE:
            return min(before, here, key=lambda optimum: (optimum.point.violation >= FEASIBLE, optimum.kkt))
        before = here
        model = Model(point, sizes, reach)
        weights = model.weights(multipliers)
        if rest is None:
            rest, learnt = _by_differences(problem, model, weights), False
        d, weights = model.solve(rest, weights)
        penalty = raised(penalty, weights)
        after, part = _line_search(problem, model, rest, d, weights, penalty)
        if after is not None:
            reach = FIRST_REACH if cautious else _reach(model, rest, d, part, penalty, after)
            rest = (_damped if cautious else _updated)(rest, *model.secant(after, weights))
            point, learnt = after, True
        elif (kkt < OPTIMAL and point.violation < FEASIBLE) or reach < HOPELESS:
            break
        elif learnt:
            rest, reach, learnt = np.eye(sizes.size) if cautious else None, FIRST_REACH, False
        else:
            reach *= SHRUNK
    return here


def _by_differences(problem: Reduced, model: Model, weights: Array) -> Array:
    """Hessian of the Lagrangian without what the absolute work adds, (n_u, n_u); zero where no gait is near."""
    hessian = np.zeros((model.sizes.size, model.sizes.size))
    for k, step in enumerate(np.diag(DIFFERENCE * model.sizes)):
        for sign in (1, -1):
            neighbour = problem.moved(model.point, sign * step)
            if neighbour is None:
                continue
            s, y = model.secant(neighbour, weights)
            if s[k] != 0.0:  # not at a bound
                hessian[k] = y / s[k]
                break
    return (hessian + hessian.T) / 2


def _line_search(
    problem: Reduced, model: Model, rest: Array, d: Array, weights: Array, penalty: float
) -> tuple[Point | None, float]:
    """The first point along a step that is better, and at which part of it; a full step is corrected once."""
    now = _merit(model.point, model.scale, penalty)
    slope = min(0.0, float(model.gradient @ d) - penalty * _violations(model.point))
    part = 1.0
    while part >= SHORTEST_SQP and d.any():
        goal = now + ARMIJO * part * slope + ROUNDING_SQP
        trial = problem.moved(model.point, part * d * model.sizes)
        if trial is not None and _merit(trial, model.scale, penalty) > goal and part == 1.0:
            values = {row.key: row.value for row in trial.rows}
            predicted = model.predicted(d)
            shift = np.array([values.get(row.key, q) - q for row, q in zip(model.rows, predicted, strict=True)])
            trial = problem.moved(model.point, model.solve(rest, weights, shift)[0] * model.sizes)
        if trial is not None and _merit(trial, model.scale, penalty) <= goal:
            return trial, part
        part /= 2
    return None, 0.0


def _reach(model: Model, rest: Array, d: Array, part: float, penalty: float, after: Point) -> float:
    """How far the next step may go."""
    longest = float(np.abs(d).max())
    if part < 1.0:
        return max(2 * part * longest, LEAST_REACH)
    promised = model.merit(np.zeros(d.size), rest, penalty) - model.merit(d, rest, penalty)
    gain = _merit(model.point, model.scale, penalty) - _merit(after, model.scale, penalty)
    return model.reach * (2 if longest > EDGE * model.reach and gain > PROMISED * promised - ROUNDING_SQP else 1)


def _updated(rest: Array, s: Array, y: Array) -> Array:
    """The nearest symmetric matrix that maps s to y."""
    length = float(s @ s)
    if length == 0.0:
        return rest
    z = y - rest @ s
    both = np.outer(z, s)
    return np.asarray(rest + (both + both.T) / length - (z @ s) * np.outer(s, s) / length**2)


def _damped(rest: Array, s: Array, y: Array) -> Array:
    """Powell's damped BFGS update, which stays positive definite."""
    Bs = rest @ s
    curvature = float(s @ Bs)
    if curvature <= 0:
        return rest
    if s @ y < DAMPING * curvature:
        part = (1 - DAMPING) * curvature / (curvature - s @ y)
        y = part * y + (1 - part) * Bs
    return np.asarray(rest - np.outer(Bs, Bs) / curvature + np.outer(y, y) / (s @ y))


def _merit(point: Point, scale: float, penalty: float) -> float:
    return point.objective / scale + penalty * _violations(point)


def _violations(point: Point) -> float:
    return sum(row.violation for row in point.rows)
