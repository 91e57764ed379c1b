"""Sequential programming in the freed parameters: the best step of a ``model`` at each point, as far as it is a gain.

The model's Hessian is taken by differences of the Lagrangian's gradient once, and learnt from then on by symmetric
secant updates (Powell 1970), what the changes of sign of the power add to it being known at every point.
"""

from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.nlp.design.model import ARMIJO, Model, raised
from gaitopt.nlp.design.optimality import kkt_residual
from gaitopt.nlp.design.reduced import Point, Reduced
from gaitopt.nlp.ipopt import Progress

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
SHORTEST = 1e-4
"""Part of a step after which a line search gives up."""
DIFFERENCE = 1e-4
"""Step of the differences of gradients, relative to the sizes: a thousand times what a gait is solved to."""
ROUNDING = 1e-11
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
    while part >= SHORTEST and d.any():
        goal = now + ARMIJO * part * slope + ROUNDING
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
    return model.reach * (2 if longest > EDGE * model.reach and gain > PROMISED * promised - ROUNDING else 1)


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
