"""Sequential quadratic programming in the freed parameters: the optimum of the exact problem next to a point.

At each point the step d, in the typical sizes of the unknowns, solves a model of the problem,

    min  g' d + d' B d / 2 + a r(d)    s.t.  A d + b + c r(d) >= 0,    |d_i| <= reach

with the remainder r of the absolute work W of each scenario, which no quadratic function describes,

    W(d) = sum of integrals |(u + u' d)(w + w' d)| dt,      r(d) = W(d) - W(0) - W'(0) d

where u and w are the torques and rates of the motors. Designs that save absolute work lie where the power just touches
zero. There the second derivatives of r change within steps that hardly change anything else. An evaluation of r costs a
hundredth of a gait, so that every model is solved by a sequence of quadratic programs. B is the rest of the Hessian of
the Lagrangian: once by differences of its gradient, then by symmetric secant updates (Powell 1970).

The search ends at the first-order conditions of Karush, Kuhn and Tucker,

    min over l >= 0 of | grad f - sum l_i grad c_i |,        c_i the active constraints; l_i of any sign for equalities
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from casadi import Sparsity, conic

from gaitopt.arrays import Array
from gaitopt.building import building
from gaitopt.callbacks import Stop, Valued
from gaitopt.design.exact import Constraint, Evaluation, ExactProblem
from gaitopt.design.sensitivity import ArcCurves
from gaitopt.gait import curves

ACTIVE = 1e-7
"""Change of the unknowns, relative to their sizes, that violates an active constraint."""
SMALLEST_GRADIENT = 1e-6
"""Length of the gradient of a constraint, in its natural unit and the sizes, below which the unknowns do not govern
it."""
ARMIJO = 1e-4
"""Smallest gain of a step, relative to the gain that the slope promises."""
PENALTY = 2.0
"""Weight of violations in the merit functions, as a multiple of the largest multiplier."""

# the model at one point
MAX_PROGRAMS = 60
"""Largest number of quadratic programs of one model."""
LAST_PROGRAM = 1e-3
"""A model is solved when the step of its last program is smaller than this, relative to the sum of all. It does not
describe the problem more precisely."""
SHORTEST_STEP_OF_MODEL = 1e-9
"""The line search of a model gives up at this fraction of a step. Where the power touches zero, r changes like a
root."""
ROUNDING_OF_MODEL = 1e-14
"""Rounding of the merit of a model."""
FLATTEST, STIFFEST = 1e-6, 1e7
"""Smallest and largest curvature of a quadratic program. Near a point at which the power touches zero, the curvature of
r grows like the inverse root of the distance; Newton's step would have no length there."""
TOLERANCES = (1e-11, 1e-9, 1e-6)
"""Violations that DAQP may allow, tried in turn: flat curvatures magnify them, and rounding may exceed the first."""
SMALLEST_PIVOT = 1e-14
"""DAQP regards an active set with a smaller pivot as singular. Flat curvatures have pivots below its default 1e-11."""
SLACK_CURVATURE = 1e4
"""Curvature of the slack of a quadratic program whose constraints contradict each other."""

# the search
MAX_FAST, MAX_CAUTIOUS = 40, 200
"""Largest number of iterations of a search with the exact curvature, and of a cautious one."""
DAMPING = 0.2
"""Part of the previous curvature that an update must keep, Powell (1978)."""
LARGEST_RESIDUAL, LARGEST_VIOLATION = 1e-6, 1e-9
"""Largest KKT residual of a converged design, and largest violation of its constraints in their natural units."""
SMALL_RESIDUAL, SMALL_VIOLATION = 1e-7, 1e-11
"""Below this KKT residual and this violation a search ends when the rounding of a gait stops its fast convergence."""
FAST = 0.1
"""Largest ratio of successive KKT residuals in fast convergence."""
FIRST_REACH = 0.3
"""Longest first step, relative to the sizes of the unknowns; doubled after steps that gain what the model promises."""
SMALLEST_REACH = 1e-3
"""Smallest reach after a step. Shorter steps are left to the line search."""
SHRINKING, HOPELESS_REACH = 0.1, 1e-5
"""If no fraction of a step is better, the reach is multiplied by the first number. At a reach below the second one, the
search gives up."""
EDGE = 0.99
"""Length of a step, relative to the reach, above which the reach limits the step."""
SUFFICIENT_GAIN = 0.7
"""Smallest gain, relative to that of the model, after which the reach is doubled."""
SHORTEST_STEP = 1e-4
"""The line search gives up at this fraction of a step."""
DIFFERENCE = 1e-4
"""Step of the differences of gradients, relative to the sizes: a thousand times the accuracy of a gait."""
ROUNDING = 1e-11
"""Rounding of the merit: that of a gait, times the weight of its constraints."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchResult:
    """The point at which a search ends.

    Attributes
    ----------
    evaluation : the exact problem there.
    kkt : residual of the optimality conditions.
    iterations : number of steps to it.
    interrupted : whether the search was stopped there on request.
    """

    evaluation: Evaluation
    kkt: float
    iterations: int
    interrupted: bool

    @property
    def shortcoming(self) -> str | None:
        """Why the point is not an optimum; None if it is one."""
        if not self.evaluation.violation < LARGEST_VIOLATION:
            worst = max(self.evaluation.constraints, key=lambda constraint: constraint.violation)
            return f"{worst.name} is only satisfied to {worst.violation:.2g}"
        if not self.kkt < LARGEST_RESIDUAL:
            return f"stalled: the optimality conditions are only satisfied to {self.kkt:.2g}"
        return None


def optimise(
    problem: ExactProblem,
    start: Evaluation,
    sizes: Array,
    *,
    cautious: bool = False,
    progress: Valued = None,
    should_stop: Stop = None,
) -> SearchResult:
    """The optimum next to a point, or the point at which the search fails.

    Parameters
    ----------
    sizes : typical sizes of the unknowns, shape (n_u,).
    cautious : whether to start from unit curvature and keep it positive definite. This takes more iterations, but
        avoids folds to which the exact curvature may lead.
    progress : called at every iteration with its number and the largest violation.
    should_stop : polled at every iteration; True ends the search.
    """
    point, penalty, reach = start, 0.0, FIRST_REACH
    B: Array | None = np.eye(sizes.size) if cautious else None
    before, learnt = None, False
    for iteration in range((MAX_CAUTIOUS if cautious else MAX_FAST) + 1):
        kkt, multipliers = kkt_residual(point, sizes)
        if progress is not None:
            progress(iteration, point.violation)
        interrupted = should_stop is not None and should_stop()
        here = SearchResult(evaluation=point, kkt=kkt, iterations=iteration, interrupted=interrupted)
        if interrupted:
            break
        if (
            before is not None
            and before.kkt < SMALL_RESIDUAL
            and kkt >= FAST * before.kkt
            and point.violation < SMALL_VIOLATION
        ):
            return min(before, here, key=lambda end: (end.evaluation.violation >= SMALL_VIOLATION, end.kkt))
        before = here

        model = _Model(point, sizes, reach)
        weights = np.array([multipliers.get(constraint.key, 0.0) for constraint in model.constraints])
        if B is None:
            B, learnt = _hessian_by_differences(problem, model, weights), False
        d, weights = model.solve(B, weights)
        penalty = _raised(penalty, weights)
        after, fraction = _line_search(problem, model, B, d, weights, penalty)
        if after is not None:
            longest = float(np.abs(d).max())
            if cautious:
                reach = FIRST_REACH
            elif fraction < 1.0:
                reach = max(2 * fraction * longest, SMALLEST_REACH)
            elif longest > EDGE * reach:
                promised = model.merit(np.zeros(d.size), B, penalty) - model.merit(d, B, penalty)
                gain = _merit(point, model.scale, penalty) - _merit(after, model.scale, penalty)
                reach *= 2 if gain > SUFFICIENT_GAIN * promised - ROUNDING else 1
            B = (_damped_update if cautious else _symmetric_update)(B, *model.secant(after, weights))
            point, learnt = after, True
        elif (kkt < SMALL_RESIDUAL and point.violation < SMALL_VIOLATION) or reach < HOPELESS_REACH:
            break
        elif learnt:
            B, reach, learnt = np.eye(sizes.size) if cautious else None, FIRST_REACH, False
        else:
            reach *= SHRINKING
    return here


def kkt_residual(point: Evaluation, sizes: Array) -> tuple[float, dict[str, float]]:
    """Residual of the optimality conditions at a point, and the multipliers that minimise it, by constraint key.

    Parameters
    ----------
    sizes : typical sizes of the unknowns, shape (n_u,).
    """
    gradient = point.gradient * sizes / point.objective_size
    scales, normals = [], []
    for constraint in point.constraints:
        normal = constraint.gradient * sizes
        length = float(np.linalg.norm(normal))
        if length > SMALLEST_GRADIENT and (constraint.equality or constraint.value / length <= ACTIVE):
            for sign in (1.0, -1.0) if constraint.equality else (1.0,):
                scales.append((constraint.key, sign / length))
                normals.append(sign * normal / length)
    if not normals:
        return float(np.linalg.norm(gradient)), {}
    # the residual is the projection of the gradient on the cone of all r with normals @ r <= 0; l are its weights
    A = -np.array(normals)
    solution = quadratic_program(np.eye(gradient.size), -gradient, A, np.zeros(len(A)))
    if solution is None:  # there is one, but rounding hides it
        return float(np.linalg.norm(gradient)), {}
    multipliers: dict[str, float] = {}
    for (key, scale), weight in zip(scales, solution[1], strict=True):
        if weight > 0:
            multipliers[key] = multipliers.get(key, 0.0) + scale * float(weight)
    return float(np.linalg.norm(gradient + A.T @ solution[1])), multipliers


def quadratic_program(H: Array, g: Array, A: Array, b: Array) -> tuple[Array, Array] | None:
    """Solution and multipliers of the strictly convex min g'd + d'Hd/2 s.t. A d + b >= 0; None if it is infeasible.

    The dual active-set method of DAQP (Arnström, Bemporad & Axehill 2022), which CasADi includes, finds the active set.
    The equations of the active set are then solved to rounding.
    """
    shapes = {"h": Sparsity.dense(g.size, g.size), "a": Sparsity.dense(b.size, g.size)}
    for tolerance in TOLERANCES:
        options: dict[str, Any] = {
            "error_on_fail": False,
            "daqp": {"primal_tol": tolerance, "zero_tol": SMALLEST_PIVOT},
        }
        solver = building(conic)("quadratic_program", "daqp", shapes, options)
        solution = solver(h=H, g=g, a=A, lba=-b)
        if solver.stats()["success"]:
            break
    else:
        return None
    n, d, weights = g.size, np.asarray(solution["x"]).ravel(), np.maximum(0.0, -np.asarray(solution["lam_a"]).ravel())
    active = weights > 0
    C, m = A[active], int(active.sum())
    system = np.block([[H, -C.T], [C, np.zeros((m, m))]])
    residual = np.concatenate([H @ d + g - C.T @ weights[active], C @ d + b[active]])
    change = -np.linalg.lstsq(system, residual)[0]  # a constraint may be active twice
    refined = weights.copy()
    refined[active] += change[n:]
    return (d + change[:n], refined) if (refined >= 0).all() else (d, weights)


class WorkRemainder:
    """The remainder r of the absolute work next to a gait.

    Parameters
    ----------
    arcs : curves of the arcs of the gait; empty if its work does not count, and r is zero.
    sizes : typical sizes of the unknowns, which are the units of d, shape (n_u,); freed parameters come first.
    """

    def __init__(self, arcs: Sequence[ArcCurves], sizes: Array) -> None:
        self._n_u, self._n = sizes.size, arcs[0].ahead.stretch.size if arcs else 0
        by = sizes[: self._n]
        self._motors = [
            (torque.values, torque.slopes * by, rate.values, rate.slopes * by, torque.duration)
            for arc in arcs
            for torque, rate in zip(arc.torque, arc.rate, strict=True)
        ]
        self._value, self._gradient, _ = self._work(np.zeros(self._n))

    def at(self, d: Array) -> tuple[float, Array, Array]:
        """Value, gradient (n_u,) and second derivatives (n_u, n_u) of r at a step (n_u,)."""
        n, freed = self._n, d[: self._n]
        value, slope, bent = self._work(freed)
        gradient, hessian = np.zeros(self._n_u), np.zeros((self._n_u, self._n_u))
        gradient[:n], hessian[:n, :n] = slope - self._gradient, bent
        return value - self._value - float(self._gradient @ freed), gradient, hessian

    def _work(self, d: Array) -> tuple[float, Array, Array]:
        """W and its derivatives at a step (n_free,)."""
        value, gradient, hessian = 0.0, np.zeros(self._n), np.zeros((self._n, self._n))
        for torque, torque_slopes, rate, rate_slopes, duration in self._motors:
            u, w = torque + torque_slopes @ d, rate + rate_slopes @ d
            weights, changes = curves.signed_weights(u * w)
            weights = weights * duration / 2
            mixed = torque_slopes.T @ (weights[:, None] * rate_slopes)
            bent = mixed + mixed.T
            slopes = u[:, None] * rate_slopes + w[:, None] * torque_slopes
            if changes.size:  # a change of sign of the power P adds 2 P' P' / |dP/dt|
                crossing = curves.evaluate(curves.coefficients(slopes), changes)
                bent += (crossing.T * (duration / np.abs(curves.slopes(u * w, changes)))) @ crossing
            value += float(weights @ (u * w))
            gradient, hessian = gradient + weights @ slopes, hessian + bent
        return value, gradient, hessian


class _Model:
    """The model of the problem at a point.

    Parameters
    ----------
    sizes : typical sizes of the unknowns, shape (n_u,).
    reach : longest step in any unknown, relative to its size.

    Attributes
    ----------
    constraints : the constraints that a step may violate.
    scale : typical size of the objective.
    """

    def __init__(self, point: Evaluation, sizes: Array, reach: float) -> None:
        self.point, self.sizes, self.scale, self._reach = point, sizes, point.objective_size, reach
        self.gradient = point.gradient * sizes / self.scale
        farthest = 2 * reach * np.sqrt(sizes.size)
        self.constraints = list[Constraint]()
        for constraint in point.constraints:
            length = float(np.linalg.norm(constraint.gradient * sizes))
            if length > SMALLEST_GRADIENT and constraint.value < farthest * length:
                self.constraints.append(constraint)
        self._A = np.array([c.gradient * sizes for c in self.constraints]).reshape(-1, sizes.size)
        self._b = np.array([c.value for c in self.constraints])
        self._equality = np.array([c.equality for c in self.constraints], dtype=bool)
        self._a, self._c = point.by_work / self.scale, np.zeros((len(self.constraints), point.by_work.size))
        for row, constraint in zip(self._c, self.constraints, strict=True):
            row[constraint.scenario] = constraint.by_work
        works = (self._a != 0) | self._c.any(axis=0)
        gaits = zip(point.scenarios, works, strict=True)
        self._remainders = [WorkRemainder(gait.arcs if counts else (), sizes) for gait, counts in gaits]

    def solve(self, B: Array, weights: Array, shift: Array | float = 0.0) -> tuple[Array, Array]:
        """Step and multipliers of the constraints; shapes (n_u,) and (n_constraints,).

        Parameters
        ----------
        B : shape (n_u, n_u) - the Hessian without that of r.
        weights : guess of the multipliers.
        shift : numbers that are added to the values of the constraints.
        """
        d, penalty = np.zeros(self.sizes.size), 0.0
        for _ in range(MAX_PROGRAMS):
            r, r_gradients, r_hessians = self._remainder(d)
            curvatures, axes = np.linalg.eigh(B + np.tensordot(self._stiffness(weights), r_hessians, 1))
            H = np.asarray((axes * np.clip(curvatures, FLATTEST, STIFFEST)) @ axes.T)
            gradient = self.gradient + B @ d + self._a @ r_gradients
            A = self._A + self._c @ r_gradients
            values = self._b + self._A @ d + self._c @ r + shift
            step, weights = self._quadratic_step(H, gradient, A, values, d)
            penalty = _raised(penalty, weights)
            slope = min(0.0, float(gradient @ step) - penalty * self._violation(values))
            merit = partial(self.merit, B=B, penalty=penalty, shift=shift)
            now, fraction = merit(d), 1.0
            while not merit(d + fraction * step) <= now + ARMIJO * fraction * slope + ROUNDING_OF_MODEL:
                fraction /= 2
                if fraction < SHORTEST_STEP_OF_MODEL:
                    fraction = 0.0
                    break
            d = d + fraction * step
            if fraction * np.linalg.norm(step) <= LAST_PROGRAM * np.linalg.norm(d):
                break
        return d, weights

    def merit(self, d: Array, B: Array, penalty: float, shift: Array | float = 0.0) -> float:
        """Change of the objective in the model, plus a penalty for violations."""
        r, _, _ = self._remainder(d)
        change = self.gradient @ d + d @ B @ d / 2 + self._a @ r
        return float(change) + penalty * self._violation(self._b + self._A @ d + self._c @ r + shift)

    def predicted(self, d: Array) -> Array:
        """Values of the constraints after a step; shape (n_constraints,)."""
        return self._b + self._A @ d + self._c @ self._remainder(d)[0]

    def secant(self, after: Evaluation, weights: Array) -> tuple[Array, Array]:
        """A step, and the change of the Lagrangian's gradient without that of r; each of shape (n_u,)."""
        gradients = {constraint.key: constraint.gradient for constraint in after.constraints}
        s = (after.u - self.point.u) / self.sizes
        y = after.gradient * self.sizes / self.scale - self.gradient
        for constraint, a, weight in zip(self.constraints, self._A, weights, strict=True):
            if weight != 0.0 and constraint.key in gradients:
                y = y - weight * (gradients[constraint.key] * self.sizes - a)
        return s, y - self._stiffness(weights) @ self._remainder(s)[1]

    def _remainder(self, d: Array) -> tuple[Array, Array, Array]:
        """r of every scenario with its gradient and second derivatives; (n_s,), (n_s, n_u) and (n_s, n_u, n_u)."""
        values, gradients, hessians = zip(*(each.at(d) for each in self._remainders), strict=True)
        return np.array(values), np.array(gradients), np.array(hessians)

    def _stiffness(self, weights: Array) -> Array:
        """Weight of each r in the Lagrangian, shape (n_s,)."""
        return np.asarray(self._a - weights @ self._c)

    def _violation(self, values: Array) -> float:
        return float(np.where(self._equality, np.abs(values), np.maximum(0.0, -values)).sum())

    def _quadratic_step(self, H: Array, gradient: Array, A: Array, b: Array, d: Array) -> tuple[Array, Array]:
        """A further step from d, and multipliers of the constraints. If these contradict each other, all have slack."""
        n, m = d.size, b.size
        A = np.vstack([A, -A[self._equality], np.eye(n), -np.eye(n)])
        c = np.concatenate([b, -b[self._equality], self._reach + d, self._reach - d])
        solution = quadratic_program(H, gradient, A, c)
        if solution is None:
            wide = np.zeros((n + 1, n + 1))
            wide[:n, :n], wide[n, n] = H, SLACK_CURVATURE
            slack = np.maximum(0.0, -c)[:, None]
            solution = quadratic_program(wide, np.append(gradient, 0.0), np.hstack([A, slack]), c)
        if solution is None:  # there is one, but rounding hides it: no step
            return np.zeros(n), np.zeros(m)
        step, every = solution
        weights = every[:m].copy()
        weights[self._equality] -= every[m : m + int(self._equality.sum())]
        return step[:n], weights


def _hessian_by_differences(problem: ExactProblem, model: _Model, weights: Array) -> Array:
    """B by differences, shape (n_u, n_u); a row is zero if there is no gait on either side."""
    hessian = np.zeros((model.sizes.size, model.sizes.size))
    for k, step in enumerate(np.diag(DIFFERENCE * model.sizes)):
        for sign in (1, -1):
            neighbour = problem.evaluate_beside(model.point, sign * step)
            if neighbour is None:
                continue
            s, y = model.secant(neighbour, weights)
            if s[k] != 0.0:  # not at a bound
                hessian[k] = y / s[k]
                break
    return (hessian + hessian.T) / 2


def _line_search(
    problem: ExactProblem, model: _Model, B: Array, d: Array, weights: Array, penalty: float
) -> tuple[Evaluation | None, float]:
    """The first better point along a step and its fraction of the step. A full step that is worse is corrected once."""
    now = _merit(model.point, model.scale, penalty)
    slope = min(0.0, float(model.gradient @ d) - penalty * model.point.total_violation)
    fraction = 1.0
    while fraction >= SHORTEST_STEP and d.any():
        goal = now + ARMIJO * fraction * slope + ROUNDING
        trial = problem.evaluate_beside(model.point, fraction * d * model.sizes)
        if trial is not None and _merit(trial, model.scale, penalty) > goal and fraction == 1.0:
            values, predicted = {c.key: c.value for c in trial.constraints}, model.predicted(d)
            keys = [constraint.key for constraint in model.constraints]
            shift = np.array([values.get(key, q) - q for key, q in zip(keys, predicted, strict=True)])
            trial = problem.evaluate_beside(model.point, model.solve(B, weights, shift)[0] * model.sizes)
        if trial is not None and _merit(trial, model.scale, penalty) <= goal:
            return trial, fraction
        fraction /= 2
    return None, 0.0


def _merit(point: Evaluation, scale: float, penalty: float) -> float:
    return point.objective / scale + penalty * point.total_violation


def _raised(penalty: float, weights: Array) -> float:
    """Weight of the violations in the next merit function."""
    return max(PENALTY * float(np.abs(weights).max(initial=0.0)), penalty / PENALTY)


def _symmetric_update(B: Array, s: Array, y: Array) -> Array:
    """The nearest symmetric matrix that maps s to y."""
    length = float(s @ s)
    if length == 0.0:
        return B
    z = y - B @ s
    both = np.outer(z, s)
    return np.asarray(B + (both + both.T) / length - (z @ s) * np.outer(s, s) / length**2)


def _damped_update(B: Array, s: Array, y: Array) -> Array:
    """Powell's damped BFGS update, which stays positive definite."""
    Bs = B @ s
    curvature = float(s @ Bs)
    if curvature <= 0:
        return B
    if s @ y < DAMPING * curvature:
        theta = (1 - DAMPING) * curvature / (curvature - s @ y)
        y = theta * y + (1 - theta) * Bs
    return np.asarray(B - np.outer(Bs, Bs) / curvature + np.outer(y, y) / (s @ y))
