"""What is watched along a curve of gaits: functions whose zeros are special points.

*Monitors* are positive while the mode sequence holds. With s in [-1, 1] over a phase and g a margin in natural units,

    monitor = min over s of g(s) / ((1 + s)^a (1 - s)^b)

The denominator removes the zeros that events cause at the ends of the phase, so that the sign of the monitor says
whether the event is still crossed: a = 1 where a slip starts at rest with an acceleration, a = 2 at the onset of slip
(a double zero), b = 1 where an event ends the phase.

*Test functions* of the multipliers lambda_i change their sign where a gait loses or gains stability, or the curve folds
or meets another one,

    slope            d parameter / d arclength
    unit             prod (1 - lambda_i)
    period doubling  prod (lambda_i + 1)
    Neimark-Sacker   prod over i < j of (lambda_i lambda_j - 1), with a complex pair on the unit circle

A multiplier is 1 at folds and at branch points. With r the return map, A its derivative by the state, s the arclength,

    det [[1 - A, -dr/dparameter], [tangent]] = prod (1 - lambda_i) / (d parameter / ds)

vanishes at branch points only. At a fold, slope and unit change their signs together; if only one of them does, another
branch crosses (unit alone: transcritical, or a pitchfork seen from its handle; slope alone: seen from a prong).

The *stride* falls to zero where a gait vanishes: the feet come down ever closer to each other. Durations, the rate of
touchdown and the impulse vanish with it, in different powers, so that any monitor may be the first that is lost.

References
----------
Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory, ch. 10.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.curves import SHORT_ARC, lowest_after_rise
from gaitopt.gait.gait import Gait
from gaitopt.gait.trajectory import Arc
from gaitopt.model.modes import Mode
from gaitopt.model.transitions import CONE, margin_unit

OPEN = 1.0
"""Value of a monitor that is far from anything."""
BIFURCATIONS = ("fold", "branch_point", "period_doubling", "neimark_sacker")
TestFunction = Callable[[Gait], float]
"""A function of the gaits of a family, continuous along it, whose zeros are of interest."""
NEUTRAL = 1e-6
"""Imaginary part below which a pair with product one is real: a neutral saddle, not a Neimark-Sacker point."""


@dataclass(frozen=True, slots=True)
class MonitorKey:
    """What is watched.

    Attributes
    ----------
    kind : ``duration``, or the name of a margin; ``touchdown`` is a second one within the step.
    phase : index of the phase, None for an impact.
    step : index of the step that an impact ends.
    """

    kind: str
    phase: int | None = None
    step: int = 0


@dataclass(frozen=True, slots=True)
class MonitorValue:
    """Value of a monitor, and where in its phase, from 0 (start) to 1 (end), it is taken."""

    value: float
    where: float = 1.0


def monitor_values(gait: Gait) -> dict[MonitorKey, MonitorValue]:
    """All monitors of a solution, whether or not they hold."""
    arcs = _arcs_by_phase(gait)
    return {**dict(_phase_values(gait, arcs)), **dict(_impact_values(gait, arcs))}


def test_functions(multipliers: NDArray[np.complex128], slope: float) -> dict[str, float]:
    """Values by type of special point; ``slope`` is d parameter / d arclength."""
    pairs = [a * b - 1 for a, b in combinations(multipliers, 2)]
    return {
        "slope": slope,
        "unit": float(np.prod(1 - multipliers).real),
        "period_doubling": float(np.prod(multipliers + 1).real),
        "neimark_sacker": float(np.prod(pairs).real) if pairs else 1.0,
    }


def bifurcations_between(before: Mapping[str, float], after: Mapping[str, float]) -> dict[str, str]:
    """Types of the special points between two gaits with these test functions, each with the one that locates it."""
    changed = {name for name, value in after.items() if value * before[name] < 0}
    kinds: dict[str, str] = {kind: kind for kind in ("period_doubling", "neimark_sacker") if kind in changed}
    if {"slope", "unit"} <= changed:
        kinds["fold"] = "slope"
    elif changed & {"slope", "unit"}:
        kinds["branch_point"] = "slope" if "slope" in changed else "unit"
    return kinds


def is_bifurcation(kind: str, multipliers: NDArray[np.complex128]) -> bool:
    """Whether a zero of a test function is the special point that it is named for."""
    if kind != "neimark_sacker":
        return True
    a, b = min(combinations(multipliers, 2), key=lambda pair: abs(pair[0] * pair[1] - 1))
    return bool(abs(a.imag) > NEUTRAL and abs(b.imag) > NEUTRAL)


def stride(gait: Gait) -> float:
    """Largest distance between the feet at a touchdown, in leg lengths, without slip.

    Infinite for a walker that lands out of flight, possibly where it took off.
    """
    x = gait.system.n_shape
    distances = [
        abs(step.final_impact.step_length - step.arcs[-1].states[-1, x])
        for step in gait.steps
        if step.arcs[-1].mode.touching
    ]
    return float(max(distances, default=np.inf)) / gait.dynamics.scales.length


def _phase_values(gait: Gait, arcs: list[list[Arc]]) -> Iterator[tuple[MonitorKey, MonitorValue]]:
    modes, table = gait.problem.cycle.phases, gait.system.transitions
    along = {id(arc): _margins(gait, arc) for whole in arcs for arc in whole}
    period = abs(gait.period)
    for phase, whole in enumerate(arcs):
        duration = sum(arc.duration for arc in whole)
        yield MonitorKey("duration", phase), MonitorValue(duration / period)
        if duration < SHORT_ARC * period:
            continue
        group = [arc for arc in whole if arc.duration > SHORT_ARC * period]
        margins = [along[id(arc)] for arc in group]
        for row, (kind, transition) in enumerate(table.of(modes[phase]).items()):
            if kind != "upright" and not transition.margin.rises:
                values = [own[row] for own in margins]
                yield MonitorKey(kind, phase), _lowest(values, _zeros(gait, phase, kind), group, whole)
        if gait.problem.cycle.starts_from_rest(phase) and gait.dynamics.friction_drops:
            yield MonitorKey("onset", phase), MonitorValue(_beyond_cone(gait, whole[0]), 0.0)
    for first, step in zip(gait.problem.cycle.first_phases, gait.steps, strict=True):
        rows = [row for arc in step.arcs for row in table.of(arc.mode).values()]
        for name in dict.fromkeys(row.guard for row in rows if row.margin.rises):
            within = [name in table.of(arc.mode) for arc in step.arcs]
            last = max(phase for phase, has in zip(step.arc_phases, within, strict=True) if has)
            own = [arc for arc, has in zip(step.arcs, within, strict=True) if has]
            clearances = [along[id(arc)][table.margin_names(arc.mode).index(name)] for arc in own]
            yield MonitorKey(name, first + last), MonitorValue(_early_fall(own, clearances))


def _arcs_by_phase(gait: Gait) -> list[list[Arc]]:
    """Arcs of each phase; breakpoints of the control cut a phase into several."""
    groups: list[list[Arc]] = []
    for step in gait.steps:
        first = len(groups)
        for arc, phase in zip(step.arcs, step.arc_phases, strict=True):
            if first + phase == len(groups):
                groups.append([])
            groups[first + phase].append(arc)
    return groups


def _zeros(gait: Gait, phase: int, kind: str) -> tuple[int, int]:
    """Orders of the zeros that events give a margin at the start and at the end of its phase."""
    cycle, jump = gait.problem.cycle, gait.dynamics.friction_drops
    start = cycle.onset_order(phase, jump=jump) if kind == "slip_velocity" else 0
    after = cycle.after(phase)
    ends = after is not None and kind == gait.system.transitions.between(cycle.phases[phase], after).guard
    return start, int(ends)


def _lowest(values: list[Array], zeros: tuple[int, int], group: list[Arc], whole: list[Arc]) -> MonitorValue:
    """The lowest value of a margin without its zeros, on some of the arcs of a phase, and where in the phase it is."""
    minima = []
    for arc, own in zip(group, values, strict=True):
        start, end = zeros[0] * (arc is whole[0]), zeros[1] * (arc is whole[-1])
        at, height = curves.maximum(-(_deflation(own.size, start, end) @ own if start or end else own))
        time = arc.start + arc.duration * (at + 1) / 2
        minima.append((-height, (time - whole[0].start) / (whole[-1].end - whole[0].start)))
    return MonitorValue(*min(minima))


@lru_cache(maxsize=64)
def _deflation(count: int, start: int, end: int) -> Array:
    """Matrix from values of g to values of g / ((1 + s)^start (1 - s)^end), both at ``points(count)``."""
    factor = chebyshev.chebfromroots([-1.0] * start + [1.0] * end) * (-1) ** end
    n = count - start - end
    product = np.zeros((count, n))
    for k in range(n):
        product[: k + factor.size, k] = chebyshev.chebmul(np.eye(n)[k][: k + 1], factor)
    quotient = np.linalg.pinv(product) @ np.linalg.inv(chebyshev.chebvander(curves.points(count), count - 1))
    return np.asarray(chebyshev.chebvander(curves.points(count), n - 1) @ quotient, dtype=float)


def _early_fall(arcs: Sequence[Arc], margins: Sequence[Array]) -> float:
    return min(OPEN, lowest_after_rise([arc.times for arc in arcs], margins)[0])


def _beyond_cone(gait: Gait, arc: Arc) -> float:
    """By how much the force that would hold the foot at the start of a slip exceeds static friction [N]."""
    stick = arc.mode.with_contact(Mode.STICK)
    margins = arc.dynamics.margins(stick, arc.segment, arc.times[:1], arc.states[:1])[0]
    return -float(margins[gait.system.transitions.margin_names(stick).index(CONE[arc.mode.contact])])


def _margins(gait: Gait, arc: Arc) -> Array:
    values = arc.dynamics.margins(arc.mode, arc.segment, arc.times, arc.states)
    return np.asarray(values / gait.dynamics.margin_units(arc.mode)).T


def _impact_values(gait: Gait, arcs: list[list[Arc]]) -> Iterator[tuple[MonitorKey, MonitorValue]]:
    """Margins of every impact in natural units."""
    cycle, scales = gait.problem.cycle, gait.dynamics.scales
    for phase, mode in cycle.resets:
        at, last = {"phase": phase} if mode.locked else {"step": cycle.step_of(phase)}, arcs[phase][-1]
        for kind, value in last.dynamics.impact_margins(mode, last.states[-1]).items():
            if kind == "touchdown_rate" or (kind == "impact_onset" and not gait.dynamics.friction_drops):
                continue  # a grazing touchdown is a second one, too; equal coefficients leave no doubt about an onset
            yield MonitorKey(kind, **at), MonitorValue(float(value) / margin_unit(kind, scales))
