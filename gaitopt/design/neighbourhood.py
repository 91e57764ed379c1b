"""An independent check of a design: random neighbours that meet the constraints, none of which may be better.

It uses no gradient of the design's own search: at other freed parameters the gait is solved again by Newton's method
and measured like any other; violated constraints are corrected by Gauss-Newton steps with finite differences.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.design.exact import RADIUS, SMALL, freed_sizes
from gaitopt.design.sensitivity import EVENT_MARGINS
from gaitopt.errors import SolveError
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait
from gaitopt.nlp.assembly import assemble_gait
from gaitopt.nlp.newton import Solution, polish, refine
from gaitopt.nlp.rollout import roll_out
from gaitopt.nlp.solve import free_parameters

RADII = (1e-2, 1e-3, 1e-4)
"""Distances of neighbours, relative to the sizes of the freed parameters."""
FEASIBLE = 1e-9
"""Violation of a constraint, in its natural unit, that rounding may cause."""
BETTER = 1e-7
"""Relative gain that exceeds the effect of rounding in the constraints."""
CORRECTIONS = 8
DIFFERENCE = 1e-6
"""Step of the differences: the root of rounding, and a multiple of what a gait is solved to."""
SOLVED = 1e-10


@dataclass(frozen=True, slots=True, kw_only=True)
class Neighbourhood:
    """The result of a search among neighbours.

    Attributes
    ----------
    tried, feasible : number of neighbours, and of those that meet all constraints.
    gain : largest gain of a feasible neighbour, relative to the objective; negative if all are worse.
    freed : ndarray, shape (n_free,) - the freed parameters of that neighbour.
    """

    tried: int
    feasible: int
    gain: float
    freed: Array

    def to_record(self) -> dict[str, float]:
        """JSON-able record."""
        return {"tried": self.tried, "feasible": self.feasible, "gain": self.gain}

    @property
    def words(self) -> str:
        """The result in a sentence."""
        seen = f"{self.feasible} of {self.tried} neighbours meet all constraints"
        if self.gain > BETTER:
            return f"{seen}; NOT an optimum, one of them is better by {self.gain:.2g} of the objective"
        return f"{seen}, and none of them is better" if self.feasible else f"{seen}: nothing can be said"

    @property
    def optimal(self) -> bool:
        """Whether no neighbour is better."""
        return self.feasible > 0 and self.gain <= BETTER


def neighbourhood(
    gait: Gait,
    *,
    directions: int = 200,
    radii: tuple[float, ...] = RADII,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Neighbourhood:
    """Search the feasible neighbourhood of a design for something better.

    Parameters
    ----------
    gait : a converged design with an objective.
    directions, radii, seed : number of random directions, distances along each, and random seed.
    progress : called with the number of directions done and their total.

    Raises
    ------
    SolveError
        If the gait is no design.
    """
    if not gait.steps or not gait.freed or not gait.problem.objective:
        raise SolveError(f"{gait.problem.name} is no optimum: it needs freed parameters and an objective")
    search, rng = _Search(gait), np.random.default_rng(seed)
    feasible, best, freed = 0, -np.inf, search.freed
    for number in range(directions):
        direction = rng.normal(size=search.freed.size)
        direction *= search.sizes / np.linalg.norm(direction)
        for radius in radii:
            neighbour = search.feasible(search.freed + radius * direction)
            if neighbour is not None:
                feasible += 1
                if neighbour[0] > best:
                    best, freed = neighbour
        if progress is not None:
            progress(number + 1, directions)
    return Neighbourhood(tried=directions * len(radii), feasible=feasible, gain=best, freed=freed)


class _Search:
    """Neighbours of one gait."""

    def __init__(self, gait: Gait) -> None:
        self._gait = gait
        free = free_parameters(gait.problem, gait.system)
        self._bounds = np.array(list(free.values())).T
        self.freed = np.array([gait.freed[name] for name in free])
        self.sizes = freed_sizes(self.freed, self._bounds)
        durations = [duration for _, duration in gait.phases]
        rolled = roll_out(gait.dynamics, gait.problem.cycle, gait.state, durations)
        refined = refine(polish(rolled.on_mesh(tuple(free))))
        self._equations, self._w = refined.equations, refined.w
        self._slopes = np.zeros((self._w.size, self.freed.size))
        slopes, by_freed = [], []
        for step in np.diag(DIFFERENCE * self.sizes):
            ahead, behind = self._values(self.freed + step), self._values(self.freed - step)
            if ahead is None or behind is None:
                raise SolveError(f"{gait.problem.name}: the gait is lost at once when its parameters change")
            by_freed.append((ahead.rows - behind.rows) / (2 * step.sum()))
            slopes.append((ahead.w - behind.w) / (2 * step.sum()))
        self._by_freed, self._slopes = np.array(by_freed).T, np.array(slopes).T
        self._objective = sum(weight * gait.scalar(name) for name, weight in gait.problem.objective.items())

    def feasible(self, freed: Array) -> tuple[float, Array] | None:
        """Relative gain and place of the feasible point next to ``freed``; None where there is none."""
        for _ in range(CORRECTIONS):
            freed = np.clip(freed, *self._bounds)
            values = self._values(freed)
            if values is None:
                return None
            wrong = np.where(values.equality, np.abs(values.rows), -values.rows) > FEASIBLE
            if not wrong.any():
                return (self._objective - values.objective) / abs(self._objective), freed
            wrong |= values.equality
            matrix = self._by_freed[wrong] * self.sizes
            freed = freed - self.sizes * np.linalg.lstsq(matrix, values.rows[wrong], rcond=1e-8)[0]
        return None

    def _values(self, freed: Array) -> "_Values | None":
        """The gait at other freed parameters, measured."""
        t, gait = self._equations, self._gait
        w = self._w + self._slopes @ (freed - self.freed)
        w[-freed.size :] = freed
        at = polish(Solution(t, w, gait.p))
        if not at.size < SOLVED or not at.in_order:
            return None
        solved = assemble_gait(gait.problem, at, errors=np.zeros(t.n_phases), message="", solver={})
        return _measured(solved, at.w)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Values:
    """A gait's nodes and durations, its objective, and its constraints: rows that are not negative, or zero."""

    w: Array
    objective: float
    rows: Array
    equality: NDArray[np.bool_]


def _measured(gait: Gait, w: Array) -> _Values:
    rows = [(value, False) for value in _margins(gait)]
    for name, span in gait.problem.constraints.items():
        unit = max(abs(bound) for bound in (span.minimum, span.maximum, SMALL) if np.isfinite(bound))
        values = np.abs(gait.multipliers) if name == RADIUS else np.array([gait.scalar(name)])
        if span.minimum == span.maximum:
            rows.append((span.maximum - values.max(), True))
            continue
        if np.isfinite(span.maximum):
            rows += [((span.maximum - value) / unit, False) for value in values]
        if np.isfinite(span.minimum):
            rows.append(((values.max() - span.minimum) / unit, False))
    objective = sum(weight * gait.scalar(name) for name, weight in gait.problem.objective.items())
    values, equality = (np.array(column) for column in zip(*rows, strict=True))
    return _Values(w=w, objective=objective, rows=values, equality=equality)


def _margins(gait: Gait) -> list[float]:
    """The least value of every margin along every arc, and those of the impact, in natural units."""
    (step,) = gait.steps
    system, scales, rows = gait.system, gait.dynamics.scales, list[float]()
    for arc in step.arcs:
        values = system.margins(arc.mode)(arc.times[None, :], arc.states.T, gait.p, system.control.data(arc.segment))
        names = system.transitions.margin_names(arc.mode)
        for name, row, unit in zip(names, np.asarray(values), gait.dynamics.margin_units(arc.mode), strict=True):
            if name not in EVENT_MARGINS:
                rows.append(-curves.maximum(-row)[1] / float(unit))
    impact, friction = step.final_impact, gait.dynamics.static_friction
    if impact.mode.sticks:
        f_t, f_n = impact.stick_impulse / scales.impulse
        return [*rows, f_n, friction * f_n + f_t, friction * f_n - f_t]
    return [
        *rows,
        float(impact.impulse[1]) / scales.impulse,
        impact.mode.direction * float(impact.state[-1]) / scales.speed,
    ]
