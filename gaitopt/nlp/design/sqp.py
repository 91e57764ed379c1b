"""Sequential quadratic programming in the freed parameters.

    min  g' d + d' H d / 2    s.t.  A d + b >= 0,        H = stiff part + rest

The stiff part of the Lagrangian's Hessian, from the changes of sign of the power, is known; the rest is learnt by
damped BFGS updates (Powell 1978; structured: Dennis, Martinez & Tapia 1989). Unknowns and objective are counted in
their typical sizes throughout.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.nlp.design.optimality import NEGLIGIBLE, kkt_residual, objective_size
from gaitopt.nlp.design.quadratic import least_distance
from gaitopt.nlp.design.reduced import Point, Reduced
from gaitopt.nlp.ipopt import Progress

MAX_ITERATIONS = 200
OPTIMALITY, MET = 1e-6, 1e-9
"""KKT residual, and violation of constraints in their natural units, of a design that is called converged."""
OPTIMAL, FEASIBLE = 1e-7, 1e-11
"""The same where a search ends, as far down as the rounding of a gait allows."""
FARTHEST = 0.3
"""Longest step, relative to the sizes of the unknowns."""
SHORTEST = 1e-4
"""Part of a step after which a line search gives up."""
ARMIJO = 1e-4
"""Part of the gain that the slope promises which a step must reach."""
FLATTEST = 1e-2
"""Least curvature of a quadratic program."""
RELAXED = 1e4
"""Curvature of the slack of a quadratic program whose constraints contradict each other."""
DAMPING = 0.2
"""Part of the curvature so far that an update must leave, Powell (1978)."""
ROUNDING = 1e-11
"""Of the merit: that of a gait, times the weight of its constraints."""
PENALTY = 2.0
"""Weight of violations in the merit function, in multipliers."""


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
    progress: Progress | None = None,
    should_stop: Stop = None,
) -> Optimum:
    """The optimum next to a point.

    Parameters
    ----------
    sizes : typical sizes of the unknowns, shape (n_u,).
    progress : called at every iteration with its number and the largest violation.
    should_stop : polled at every iteration; True ends the search.
    """
    point, rest, penalty = start, np.eye(sizes.size), 0.0
    fresh = True
    for iteration in range(MAX_ITERATIONS + 1):
        kkt, multipliers = kkt_residual(point, sizes)
        if progress is not None:
            progress(iteration, point.violation)
        interrupted = should_stop is not None and should_stop()
        if interrupted or (kkt < OPTIMAL and point.violation < FEASIBLE):
            break
        model = _Model(point, sizes, rest, multipliers)
        d, weights = model.solve()
        penalty = max(PENALTY * float(np.abs(weights).max(initial=0.0)), penalty / PENALTY)
        after = _line_search(problem, model, d, penalty)
        if after is not None:
            rest, point, fresh = _updated(rest, model, weights, after, sizes), after, False
        elif fresh:
            break
        else:
            rest, fresh = np.eye(sizes.size), True
    return Optimum(point=point, kkt=kkt, multipliers=multipliers, iterations=iteration, interrupted=interrupted)


class _Model:
    """The quadratic program at a point, in sizes."""

    def __init__(self, point: Point, sizes: Array, rest: Array, multipliers: Mapping[str, float]) -> None:
        self.point, self.sizes = point, sizes
        self.scale = objective_size(point)
        self.H = _definite(rest + _stiff(point, sizes, multipliers))
        self.gradient = point.gradient * sizes / self.scale
        reach = 2 * FARTHEST * np.sqrt(sizes.size)
        lengths = [float(np.linalg.norm(row.gradient * sizes)) for row in point.rows]
        near = [
            (row, a) for row, a in zip(point.rows, lengths, strict=True) if a > NEGLIGIBLE and row.value < reach * a
        ]
        self.rows = [row for row, _ in near]
        self.A = np.array([row.gradient * sizes for row in self.rows]).reshape(-1, sizes.size)
        self.b = np.array([row.value for row in self.rows])
        self.equality = np.array([row.equality for row in self.rows], dtype=bool)

    def by_key(self, weights: Array) -> dict[str, float]:
        """Multipliers of the rows by their keys."""
        return {row.key: float(w) for row, w in zip(self.rows, weights, strict=True)}

    def solve(self, shift: Array | float = 0.0) -> tuple[Array, Array]:
        """Step and multipliers of the rows; shapes (n_u,) and (n_rows,).

        Parameters
        ----------
        shift : added to the values of the rows.
        """
        n, b = self.sizes.size, self.b + shift
        box = np.vstack([np.eye(n), -np.eye(n)])
        A, c = (
            np.vstack([self.A, -self.A[self.equality], box]),
            np.concatenate([b, -b[self.equality], np.full(2 * n, FARTHEST)]),
        )
        solution = least_distance(self.H, self.gradient, A, c)
        if solution is None:  # the linearised constraints contradict each other: all of them are relaxed alike
            H = np.zeros((n + 1, n + 1))
            H[:n, :n], H[n, n] = self.H, RELAXED
            slack = np.maximum(0.0, -c)[:, None]
            solution = least_distance(H, np.append(self.gradient, 0.0), np.hstack([A, slack]), c)
        if solution is None:
            raise np.linalg.LinAlgError("the relaxed quadratic program, which has a solution, was not solved")
        d, weights = solution
        m = self.b.size
        multipliers = weights[:m].copy()
        multipliers[self.equality] -= weights[m : m + int(self.equality.sum())]
        return d[:n], multipliers


def _line_search(problem: Reduced, model: _Model, d: Array, penalty: float) -> Point | None:
    """The first point along a step that is better; a full step that is not is corrected to second order once."""
    now = _merit(model.point, model.scale, penalty)
    slope = min(0.0, float(model.gradient @ d) - penalty * _violations(model.point))
    part = 1.0
    while part >= SHORTEST:
        goal = now + ARMIJO * part * slope + ROUNDING
        trial = problem.moved(model.point, part * d * model.sizes)
        if trial is not None and _merit(trial, model.scale, penalty) > goal and part == 1.0:
            trial = _corrected(problem, model, trial, d)
        if trial is not None and _merit(trial, model.scale, penalty) <= goal:
            return trial
        part /= 2
    return None


def _corrected(problem: Reduced, model: _Model, trial: Point, d: Array) -> Point | None:
    """A full step with the curvature of the constraints taken into account."""
    values = {row.key: row.value for row in trial.rows}
    predicted = model.b + model.A @ d
    shift = np.array([values.get(row.key, q) - q for row, q in zip(model.rows, predicted, strict=True)])
    return problem.moved(model.point, model.solve(shift)[0] * model.sizes)


def _updated(rest: Array, model: _Model, weights: Array, after: Point, sizes: Array) -> Array:
    """Powell's damped BFGS update of the Lagrangian's Hessian; what it is without its stiff part, (n_u, n_u)."""
    gradients = {row.key: row.gradient for row in after.rows}
    s = (after.u - model.point.u) / sizes
    y = after.gradient * sizes / model.scale - model.gradient
    for row, a, weight in zip(model.rows, model.A, weights, strict=True):
        if weight != 0.0 and row.key in gradients:
            y -= weight * (gradients[row.key] * sizes - a)
    stiff = _stiff(after, sizes, model.by_key(weights))
    H = _definite(rest + stiff)
    Hs = H @ s
    curvature = float(s @ Hs)
    if curvature <= 0:
        return rest
    if s @ y < DAMPING * curvature:
        part = (1 - DAMPING) * curvature / (curvature - s @ y)
        y = part * y + (1 - part) * Hs
    return np.asarray(H - np.outer(Hs, Hs) / curvature + np.outer(y, y) / (s @ y) - stiff)


def _stiff(point: Point, sizes: Array, multipliers: Mapping[str, float]) -> Array:
    """Stiff part of the Hessian of the Lagrangian, in sizes."""
    total = point.curvature / objective_size(point)
    for row in point.rows:
        if row.curvature is not None:
            total = total - multipliers.get(row.key, 0.0) * row.curvature
    return np.asarray(sizes[:, None] * total * sizes)


def _definite(H: Array) -> Array:
    """The nearest matrix that is positive definite enough."""
    values, vectors = np.linalg.eigh(H)
    return np.asarray((vectors * np.maximum(values, FLATTEST)) @ vectors.T)


def _merit(point: Point, scale: float, penalty: float) -> float:
    return point.objective / scale + penalty * _violations(point)


def _violations(point: Point) -> float:
    return sum(row.violation for row in point.rows)
