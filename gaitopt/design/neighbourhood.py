"""An independent check of a design: no random neighbour that meets the constraints may be better.

    v = v* + d,      v <- v - C^+ c(v)  until c(v) >= 0 or = 0,      f(v) >= f(v*)     for random directions d

The check uses no gradient of the search for the design v*. At each neighbour v the gait is solved again by Newton's
method and measured like any other gait. Violated constraints c are corrected by Gauss-Newton steps, with their Jacobian
C by finite differences. The first step already corrects violations that the linear model predicts.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.design.exact import LARGEST_RESIDUAL, SMALL, freed_sizes
from gaitopt.design.spectral_radius import RADIUS
from gaitopt.errors import SolveError
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait
from gaitopt.gait.measures import angles_of, observe
from gaitopt.gait.trajectory import Arc, Step
from gaitopt.model.open_loop import OpenLoop, Order
from gaitopt.model.transitions import is_held, margin, margin_unit
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import ANGLE, CLEARANCE
from gaitopt.problem.statement import Range
from gaitopt.solver.assembly import assemble_gait
from gaitopt.solver.diagnosis import AIRBORNE
from gaitopt.solver.newton import Solution, polish, refine
from gaitopt.solver.rollout import retraced
from gaitopt.solver.solve import free_parameters

RADII = (1e-2, 1e-3, 1e-4)
"""Distances of neighbours, relative to the sizes of the freed parameters."""
LARGEST_VIOLATION = 1e-9
"""Largest violation of a constraint, in its natural unit, that rounding may cause."""
SMALLEST_GAIN = 1e-7
"""Smallest relative gain that exceeds the effect of rounding in the constraints."""
MAX_CORRECTIONS = 8
"""Largest number of Gauss-Newton steps at a neighbour."""
DIFFERENCE = 1e-6
"""Step of the differences, relative to the sizes of the freed parameters: the root of rounding, and a multiple of the
accuracy of a gait."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Neighbourhood:
    """The result of a search for a better neighbour of a design.

    Attributes
    ----------
    tried, feasible : number of neighbours, and number of those that meet all constraints.
    gain : largest gain of a feasible neighbour, relative to the objective; negative if all are worse.
    freed : ndarray, shape (n_free,) - the freed parameters of that neighbour.
    """

    tried: int
    feasible: int
    gain: float
    freed: Array

    def to_record(self) -> dict[str, float]:
        """A record for JSON."""
        return {"tried": self.tried, "feasible": self.feasible, "gain": self.gain}

    @property
    def summary(self) -> str:
        """A sentence that states how many neighbours are feasible, and whether one of them is better."""
        seen = f"{self.feasible} of {self.tried} neighbours meet all constraints"
        if self.gain > SMALLEST_GAIN:
            return f"{seen}; NOT an optimum, one of them is better by {self.gain:.2g} of the objective"
        return f"{seen}, and none of them is better" if self.feasible else f"{seen}; no conclusion"

    @property
    def optimal(self) -> bool:
        """Whether no neighbour is better."""
        return self.feasible > 0 and self.gain <= SMALLEST_GAIN


def check_design(problem: Problem) -> None:
    """Refuse a problem whose gaits have no neighbours that could be better.

    Raises
    ------
    SolveError
        If the problem is a design over a range, or has no objective.
    """
    if problem.over is not None:
        raise SolveError(
            f"{problem.name}: a design over a range is no optimum at one value; verify it without neighbours"
        )
    if not problem.objective:
        raise _no_optimum(problem)


def _no_optimum(problem: Problem) -> SolveError:
    return SolveError(f"{problem.name} is not an optimum: it needs freed parameters and an objective")


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
    directions : number of random directions.
    radii : distances of the neighbours in each direction.
    seed : random seed.
    progress : called with the number of directions done and their total.

    Raises
    ------
    SolveError
        If the gait is not a design.
    """
    problem = gait.problem.origin or gait.problem
    check_design(problem)
    if not gait.steps or not gait.freed:
        raise _no_optimum(problem)
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
    """The search among the neighbours of one gait. In all rows of constraints the equalities come last."""

    def __init__(self, gait: Gait) -> None:
        self._gait, self._problem = gait, gait.problem.origin or gait.problem
        equalities = sum(span.is_equality for span in self._problem.constraints.values())
        self._n_equalities = equalities + _in_time(gait.problem)
        free = free_parameters(self._problem, gait.system)
        if not free.keys() >= gait.freed.keys():  # open-loop torques, which are fixed in the system of the gait
            unknowns = self._problem.control.unknowns(gait.system.walker)
            free |= {f"control.{name}": span for name, span in unknowns.items()}
        self._bounds = np.array(list(free.values())).T
        self.freed = np.array([gait.freed[name] for name in free])
        self.sizes = freed_sizes(self.freed, self._bounds)
        refined = refine(polish(retraced(gait).on_mesh()))
        self._equations, self._w = refined.equations, refined.w
        self._freed_indices = [gait.system.parameters.index(name) for name in free]
        self._slopes = np.zeros((self._w.size, self.freed.size))
        slopes, by_freed = [], []
        for step in np.diag(DIFFERENCE * self.sizes):
            ahead, behind = self._values(self.freed + step), self._values(self.freed - step)
            if ahead is None or behind is None:
                raise SolveError(f"{gait.problem.name}: no gait is found for slightly changed parameters")
            slopes.append((ahead[0] - behind[0]) / (2 * step.sum()))
            by_freed.append((ahead[2] - behind[2]) / (2 * step.sum()))
        self._slopes, self._by_freed = np.array(slopes).T, np.array(by_freed).T
        self._objective, self._rows = _objective(gait, self._problem), _constraints(gait, self._problem)

    def feasible(self, freed: Array) -> tuple[float, Array] | None:
        """Relative gain and freed parameters of the feasible point next to ``freed``; None if there is none."""
        freed = np.clip(freed, *self._bounds)
        rows = self._rows + self._by_freed @ (freed - self.freed)
        equality = np.arange(rows.size) >= rows.size - self._n_equalities
        wrong, active = np.where(equality, np.abs(rows), -rows) > LARGEST_VIOLATION, equality
        for _ in range(MAX_CORRECTIONS):
            if wrong.any():
                active = active | wrong
                matrix = self._by_freed[active] * self.sizes
                step = self.sizes * np.linalg.lstsq(matrix, rows[active], rcond=1e-8)[0]
                freed = np.clip(freed - step, *self._bounds)
            values = self._values(freed)
            if values is None:
                return None
            _, objective, rows = values
            wrong = np.where(equality, np.abs(rows), -rows) > LARGEST_VIOLATION
            if not wrong.any():
                return (self._objective - objective) / abs(self._objective), freed
        return None

    def _values(self, freed: Array) -> tuple[Array, float, Array] | None:
        """Unknowns, objective and constraints at other freed parameters; None if there is no gait."""
        w, p = self._w + self._slopes @ (freed - self.freed), self._gait.p.copy()
        p[self._freed_indices] = freed
        at = polish(Solution(self._equations, w, p))
        if not at.size < LARGEST_RESIDUAL or not at.in_order:
            return None
        errors = np.zeros(self._equations.n_phases)
        gait = assemble_gait(self._gait.problem, at, errors=errors, message="", solver={})
        return at.w, _objective(gait, self._problem), _constraints(gait, self._problem)


def _objective(gait: Gait, problem: Problem) -> float:
    return sum(weight * gait.scalar(name) for name, weight in problem.objective.items())


def _constraints(gait: Gait, problem: Problem) -> Array:
    """Margins and constraints in natural units: first those that must not be negative, then those that must be zero."""
    cycle, table, scales = gait.cycle, gait.system.transitions, gait.dynamics.scales
    rows, zero, last_arcs = list[float](), list[float](), dict[int, Arc]()
    rising = dict[tuple[int, str], list[tuple[Array, Array]]]()  # times and values by swing and margin
    for arc, phase in gait.arcs_by_phase:
        last_arcs[phase] = arc
        names, units = table.margin_names(arc.mode), gait.dynamics.margin_units(arc.mode)
        margins = arc.dynamics.margins(arc.mode, arc.segment, arc.times, arc.states) / units
        for name, values in zip(names, margins.T, strict=True):
            if margin(name).rises:
                rising.setdefault((cycle.swings[phase], name), []).append((arc.times, values))
            elif is_held(name):
                rows.append(-curves.maximum(-values)[1])
    for arcs in rising.values():
        times, along = zip(*arcs, strict=True)
        rows.append(min(1.0, curves.lowest_after_rise(times, along, AIRBORNE)[0]))
    for phase, _ in cycle.resets:
        struck, arc = table.struck(cycle, phase), last_arcs[phase]
        if struck is not None:
            of_impact = arc.dynamics.impact_margins(struck, arc.states[-1], arc.mode)
            rows += [value / margin_unit(name, scales) for name, value in of_impact.items()]
    for name, span in problem.constraints.items():
        if name == CLEARANCE or name.startswith(ANGLE):
            rows += [room for step in gait.steps for room in _along(step, name, span)]
            continue
        unit = max(abs(bound) for bound in (span.minimum, span.maximum, SMALL) if np.isfinite(bound))
        values = np.abs(gait.multipliers) if name == RADIUS else np.array([gait.scalar(name)])
        if span.is_equality:
            zero.append(span.maximum - values.max())
            continue
        if np.isfinite(span.maximum):
            rows += [(span.maximum - value) / unit for value in values]
        if np.isfinite(span.minimum):
            rows.append((values.max() - span.minimum) / unit)
    if _in_time(gait.problem):
        assert isinstance(gait.problem.control, OpenLoop)
        mean = sum(step.period for step in gait.steps) / len(gait.steps)
        zero.append(mean - (gait.problem.control.duration or 0.0))
    return np.array([*rows, *zero], dtype=float)


def _in_time(problem: Problem) -> bool:
    """Whether the mean duration of a step is fixed, because the intervals of open-loop torques last fixed times."""
    law = problem.control
    return isinstance(law, OpenLoop) and (law.intervals > 1 or law.order is Order.LINEAR)


def _along(step: Step, name: str, span: Range) -> list[float]:
    """Smallest slack of a constraint along every arc of a step, without both ends for the height of the swing foot."""
    rows = list[float]()
    for k, arc in enumerate(step.arcs):
        if name == CLEARANCE:
            room = observe(arc).swing_foot[:, 1] - span.minimum * np.sin(np.pi * arc.times / step.period)
            inside = slice(1 if k == 0 else None, -1 if k == len(step.arcs) - 1 else None)
            rows.append(float(room[inside].min()))
            continue
        system = arc.dynamics.system
        angles = angles_of(arc)[0]
        angle = angles[:, system.angle_names.index(name.removeprefix(ANGLE))].copy()
        rows += [curves.maximum(-angle)[1] * -1.0 - span.minimum] if np.isfinite(span.minimum) else []
        rows += [span.maximum - curves.maximum(angle)[1]] if np.isfinite(span.maximum) else []
    return rows
