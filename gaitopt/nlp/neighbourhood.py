"""Is a design the best of its neighbourhood? Random neighbours, brought back to the constraints, and measured.

It knows nothing of the gradients with which the design was found: at other freed parameters the gait is solved again by
Newton's method and measured like any other; violated constraints are corrected by Gauss-Newton steps with differences.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitopt.errors import SolveError
from gaitopt.gait import Gait, curves
from gaitopt.mechanics import Mode, margin_names, margin_scales
from gaitopt.nlp.assembly import assemble_gait
from gaitopt.nlp.layout import layout
from gaitopt.nlp.newton import polish
from gaitopt.nlp.search import freed_sizes
from gaitopt.nlp.transcription import Transcription

Array = NDArray[np.float64]

RADII = (1e-1, 1e-2, 1e-3, 1e-4)
"""Distances of neighbours, relative to the sizes of the freed parameters."""
FEASIBLE = 1e-9
"""Violation of a constraint, in its natural unit, that rounding may cause."""
BETTER = 1e-7
"""Relative gain that is more than what rounding of the constraints is worth."""
CORRECTIONS = 8
DIFFERENCE = 1e-6
"""Step of the differences: the root of rounding, and a multiple of what a gait is solved to."""
SOLVED = 1e-10


@dataclass(frozen=True, slots=True, kw_only=True)
class Neighbourhood:
    """What a search has seen.

    Attributes
    ----------
    tried, feasible : how many neighbours there were, and how many of them meet all constraints.
    gain : largest gain of a feasible neighbour, relative to the objective; negative where all are worse.
    freed : ndarray, shape (n_free,) - the freed parameters of that neighbour.
    """

    tried: int
    feasible: int
    gain: float
    freed: Array

    @property
    def optimal(self) -> bool:
        """Whether no neighbour is better."""
        return self.feasible > 0 and self.gain <= BETTER


def neighbourhood(
    gait: Gait,
    bounds: Array,
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
    bounds : of the freed parameters; shape (2, n_free).
    directions, radii, seed : random directions, and how far to go in each.
    progress : called with the number of directions done and their total.

    Raises
    ------
    SolveError
        If the gait is no design.
    """
    if gait.step is None or not gait.freed or not gait.problem.objective:
        raise SolveError(f"{gait.problem.name} is no optimum: it needs freed parameters and an objective")
    search, rng = _Search(gait, bounds), np.random.default_rng(seed)
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

    def __init__(self, gait: Gait, bounds: Array) -> None:
        assert gait.step is not None
        assert gait.shooting is not None
        self._gait, self._bounds = gait, bounds
        self.freed = np.array(list(gait.freed.values()))
        self.sizes = freed_sizes(self.freed, bounds)
        durations = np.array([duration for _, duration in gait.step.phases])
        plan = layout(gait.problem.sequence, durations, gait.system.control.breakpoints)
        self._transcription = Transcription(gait.system, plan.refined(gait.shooting.intervals), tuple(gait.freed))
        self._w = self._transcription.pack(gait.shooting.states.T, durations, self.freed)
        self._slopes, self._by_freed = np.zeros((self._w.size, self.freed.size)), np.zeros((0, self.freed.size))
        ahead, behind = ([self._values(self.freed + s * h) for h in np.diag(DIFFERENCE * self.sizes)] for s in (1, -1))
        if any(values is None for values in (*ahead, *behind)):
            raise SolveError(f"{gait.problem.name}: the gait is lost at once when its parameters change")
        pairs = zip(ahead, behind, 2 * DIFFERENCE * self.sizes, strict=True)
        both = [((a.rows - b.rows) / h, (a.w - b.w) / h) for a, b, h in pairs]  # type: ignore[union-attr]
        self._by_freed, self._slopes = (np.array(columns).T for columns in zip(*both, strict=True))
        here = self._values(self.freed)
        assert here is not None, "the gait itself is one"
        self._objective = here.objective

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
        t, gait = self._transcription, self._gait
        w = self._w + self._slopes @ (freed - self.freed)
        w[-freed.size :] = freed
        at = polish(t, w, gait.p).at
        if not at.size < SOLVED or not t.layout.in_order(t.unpack(at.w)[1], t.system.control.breakpoints):
            return None
        solved = assemble_gait(gait.problem, t, at, errors=np.zeros(t.n_phases), message="", solver={})
        return _Values(w=at.w, **_measured(solved))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Values:
    """A gait's nodes and durations, its objective, and its constraints: rows that are not negative, or zero."""

    w: Array
    objective: float
    rows: Array
    equality: NDArray[np.bool_]


def _measured(gait: Gait) -> dict[str, object]:
    known = {
        **gait.measures,
        "spectral_radius": gait.spectral_radius,
        **dict(zip(gait.system.parameters, gait.p, strict=True)),
        **{f"state.{name}": value for name, value in zip(gait.system.state_names, gait.state, strict=True)},
    }
    rows, equality = _margins(gait), list[bool]()
    equality += [False] * len(rows)
    for name, span in gait.problem.constraints.items():
        unit = max(abs(b) for b in (span.minimum, span.maximum, 1e-3) if np.isfinite(b))
        values = np.abs(gait.multipliers) if name == "spectral_radius" else [float(known[name])]
        if span.minimum == span.maximum:
            rows += [(span.maximum - max(values)) / unit]
            equality += [True]
            continue
        if np.isfinite(span.maximum):
            rows += [(span.maximum - value) / unit for value in values]
            equality += [False] * len(values)
        if np.isfinite(span.minimum):
            rows += [(max(values) - span.minimum) / unit]
            equality += [False]
    objective = sum(weight * float(known[name]) for name, weight in gait.problem.objective.items())
    return {"objective": objective, "rows": np.array(rows), "equality": np.array(equality)}


def _margins(gait: Gait) -> list[float]:
    """The least value of every margin along every arc, and those of the impact, in natural units."""
    assert gait.step is not None
    assert gait.step.impact is not None
    system, scales, rows = gait.system, gait.system.scales(gait.p), list[float]()
    for arc in gait.step.arcs:
        values = system.margins(arc.mode)(arc.times[None, :], arc.states.T, gait.p, system.control.data(arc.segment))
        names = margin_names(arc.mode)
        for name, row, unit in zip(names, np.asarray(values), margin_scales(arc.mode, scales), strict=True):
            if name not in ("touchdown", "upright"):
                rows.append(-curves.maximum(-row)[1] / float(unit))
    impact = gait.step.impact
    friction = float(gait.p[system.parameters.index("friction")])
    if impact.mode is Mode.STICK:
        f_t, f_n = impact.stick_impulse / scales.impulse
        return [*rows, f_n, friction * f_n + f_t, friction * f_n - f_t]
    return [*rows, float(impact.impulse[1]) / scales.impulse, impact.mode.direction * float(impact.state[-1]) / scales.speed]
