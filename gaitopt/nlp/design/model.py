"""What is known of a design next to a point, and the best step by it.

    min  g' d + d' B d / 2 + a r(d)    s.t.  A d + b + c r(d) >= 0,    |d_i| <= reach

with the remainder r of the absolute work (``absolute_work``), solved by sequential quadratic programming of its own: r
costs a hundredth of a gait. B is the rest of the Lagrangian's Hessian. Unknowns and objective are counted in their
typical sizes throughout.
"""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from gaitopt.arrays import Array
from gaitopt.nlp.design.absolute_work import Remainder, WorkRemainder
from gaitopt.nlp.design.optimality import NEGLIGIBLE, objective_size
from gaitopt.nlp.design.quadratic import least_distance
from gaitopt.nlp.design.reduced import Point

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
