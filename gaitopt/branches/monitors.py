"""Functions along a curve of gaits whose zeros are special points: monitors and test functions.

*Monitors* are positive while the mode sequence holds. With s in [-1, 1] over a phase and g a margin in natural units,

    monitor = min over s of g(s) / ((1 + s)^a (1 - s)^b)

The denominator removes the zeros that events cause at the ends of the phase, so that the sign of the monitor shows
whether the event still occurs: a = 1 if a slip starts at rest with an acceleration, a = 2 at the onset of slip (a
double zero), b = 1 if an event ends the phase.

The torques may jump at a breakpoint of the control. A switch that its margin triggers meets the breakpoint when the
time between them becomes zero. A switch at the breakpoint leaves it when the margin of the old mode becomes zero on one
side.

*Test functions* of the multipliers lambda_i change sign where a gait loses or gains stability, and where the curve
folds or meets another one,

    slope            d parameter / d arclength
    unit             prod (1 - lambda_i)
    period doubling  prod (lambda_i + 1)
    Neimark-Sacker   prod over i < j of (lambda_i lambda_j - 1), with a complex pair on the unit circle

A multiplier is 1 at folds and at branch points. With r the return map, A its derivative by the state, s the arclength,

    det [[1 - A, -dr/dparameter], [tangent]] = prod (1 - lambda_i) / (d parameter / ds)

vanishes at branch points only. At a fold both slope and unit change sign. If only one of them does, another branch
crosses (only unit: transcritical, or the handle of a pitchfork; only slope: a prong of a pitchfork).

The *stride* decreases to zero where a gait vanishes: the feet land closer and closer to each other. Durations, the rate
of touchdown and the impulse vanish with different powers of the stride, so that any monitor may become negative first.

References
----------
Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory, ch. 10.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, groupby

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.curves import SHORT_ARC, lowest_after_rise
from gaitopt.gait.gait import Gait
from gaitopt.gait.trace import MonitorKey
from gaitopt.gait.trajectory import Arc
from gaitopt.model.cycle import BREAKPOINT, Cycle
from gaitopt.model.modes import Mode
from gaitopt.model.section import TOUCHDOWN
from gaitopt.model.transitions import Transitions, contact_of, is_held, kind, margin_unit, named
from gaitopt.solver.rollout import SMALLEST_JUMP

LARGEST_TOUCHDOWN_MONITOR = 1.0
"""Largest value of a monitor of a touchdown; a foot that is farther from the ground does not matter."""
BIFURCATIONS = ("fold", "branch_point", "period_doubling", "neimark_sacker")
TestFunction = Callable[[Gait], float]
"""A function of a gait, continuous along a family, whose zeros are to be located."""
REAL_PAIR = 1e-6
"""A pair with product one is real if its imaginary parts are below this: a neutral saddle, not a Neimark-Sacker
point."""
POLE_DISTANCE = 0.5
"""If all multipliers are farther than this from the critical value, a test function changes its sign at a pole."""


@dataclass(frozen=True, slots=True)
class MonitorValue:
    """Value of a monitor, and where in the phase its minimum lies, from 0 (start) to 1 (end)."""

    value: float
    where: float = 1.0


def monitor_values(gait: Gait) -> dict[MonitorKey, MonitorValue]:
    """All monitors of a solution, positive or not."""
    cycle, table, drops = gait.cycle, gait.system.transitions, gait.dynamics.friction_drops
    period, scales = abs(gait.scalar("period")), gait.dynamics.scales
    phases: list[list[Arc]] = [[] for _ in cycle.phases]  # breakpoints of the control cut a phase into several arcs
    for arc, phase in gait.arcs_by_phase:
        phases[phase].append(arc)
    margins = {id(arc): _margins(gait, arc) for arcs in phases for arc in arcs}
    values: dict[MonitorKey, MonitorValue] = {}

    for phase, arcs in enumerate(phases):
        duration = sum(arc.duration for arc in arcs)
        values[MonitorKey("duration", phase)] = MonitorValue(duration / period)
        long = [arc for arc in arcs if arc.duration > SHORT_ARC * period]
        if not long:  # the phase is short, or a breakpoint divides it into short arcs
            continue
        after = cycle.after(phase)
        for row, name in enumerate(table.margin_names(cycle.phases[phase])):
            if is_held(name):
                along, orders = (
                    [margins[id(arc)][row] for arc in long],
                    zero_orders(table, cycle, phase, name, drops=drops),
                )
                values[MonitorKey(name, phase)] = _lowest(along, orders, long, arcs)
        if phase - 1 in cycle.timed:
            before = phases[phase - 1][-1]
            guard = table.between(before.mode, cycle.phases[phase]).guard
            name = named("onset" if kind(guard).startswith("cone") else "pull", guard)
            values[MonitorKey(name, phase)] = MonitorValue(-_guard_after(before, arcs[0]), 0.0)
        elif drops:
            for contact in cycle.starts_from_rest(phase):
                name = table.onset(cycle.phases[phase], contact).guard
                values[MonitorKey(name, phase)] = MonitorValue(_force_beyond_cone(arcs[0], contact), 0.0)
        jumps = phase not in cycle.timed and cycle.reset_after(phase) is None
        time = _time_to_jump(arcs[-1], after) if jumps and after is not None else np.inf
        if time < np.inf:
            values[MonitorKey(BREAKPOINT, phase)] = MonitorValue(time / period)

    values |= dict(_rising_margins(gait, margins))
    for phase, _ in cycle.resets:
        within, last_arc = cycle.after(phase) is not None, phases[phase][-1]
        location = {"phase": phase} if within else {"step": cycle.step_of(phase)}
        struck = table.struck(cycle, phase)
        if struck is None:  # slips that end together
            continue
        for name, value in last_arc.dynamics.impact_margins(struck, last_arc.states[-1], last_arc.mode).items():
            # the monitor of a second touchdown covers a grazing one; without a jump the slip velocity decides an onset
            if kind(name) != "touchdown_rate" and (gait.dynamics.stick_comes_first or kind(name) != "impact_onset"):
                values[MonitorKey(name, **location)] = MonitorValue(float(value) / margin_unit(name, scales))
    return values


def _rising_margins(gait: Gait, margins: Mapping[int, Array]) -> Iterator[tuple[MonitorKey, MonitorValue]]:
    """Monitors of margins that rise before they fall, such as that of a touchdown, over each swing.

    Parameters
    ----------
    margins : margins of every arc in natural units, by the identity of the arc.
    """
    cycle, table = gait.cycle, gait.system.transitions
    for _, group in groupby(gait.arcs_by_phase, key=lambda pair: cycle.swings[pair[1]]):
        swing = list(group)
        rows = [row for arc, _ in swing for row in table.of(arc.mode).values()]
        for name in dict.fromkeys(row.guard for row in rows if row.margin.rises):
            having = [(arc, phase) for arc, phase in swing if name in table.of(arc.mode)]
            times = [arc.times for arc, _ in having]
            along = [margins[id(arc)][table.margin_names(arc.mode).index(name)] for arc, _ in having]
            last = max(phase for _, phase in having)
            yield (
                MonitorKey(name, last),
                MonitorValue(min(LARGEST_TOUCHDOWN_MONITOR, lowest_after_rise(times, along)[0])),
            )


def test_functions(multipliers: NDArray[np.complex128], slope: float) -> dict[str, float]:
    """Values of the test functions by name; ``slope`` is d parameter / d arclength."""
    pairs = [a * b - 1 for a, b in combinations(multipliers, 2)]
    return {
        "slope": slope,
        "unit": float(np.prod(1 - multipliers).real),
        "period_doubling": float(np.prod(multipliers + 1).real),
        "neimark_sacker": float(np.prod(pairs).real) if pairs else 1.0,
    }


def bifurcations_between(before: Mapping[str, float], after: Mapping[str, float]) -> dict[str, str]:
    """Types of the special points between two gaits with these test functions, and the function that locates each."""
    changed = {name for name, value in after.items() if value * before[name] < 0}
    kinds: dict[str, str] = {kind: kind for kind in ("period_doubling", "neimark_sacker") if kind in changed}
    if {"slope", "unit"} <= changed:
        kinds["fold"] = "slope"
    elif changed & {"slope", "unit"}:
        kinds["branch_point"] = "slope" if "slope" in changed else "unit"
    return kinds


def is_bifurcation(kind: str, multipliers: NDArray[np.complex128]) -> bool:
    """Whether a change of sign of a test function is a special point of this type.

    It is not if a multiplier passes through infinity, which happens when the flight of a runner shrinks to nothing.
    """
    if kind != "neimark_sacker":
        critical = -1.0 if kind == "period_doubling" else 1.0
        return bool(np.abs(multipliers - critical).min() < POLE_DISTANCE)
    a, b = min(combinations(multipliers, 2), key=lambda pair: abs(pair[0] * pair[1] - 1))
    return bool(abs(a.imag) > REAL_PAIR and abs(b.imag) > REAL_PAIR)


def stride(gait: Gait) -> float:
    """Largest distance between the feet where they swap roles on the ground, without slip, in natural units.

    If they never do so, because no feet at the base point swap or they land after a flight, it is the largest range of
    a coordinate.
    """
    x, table, distances = gait.system.n_shape, gait.system.transitions, list[float]()
    for step in gait.steps:
        landings = [*(float(arc.states[0, x]) for arc in step.arcs[1:]), step.final_impact.step_length]
        ends = [*(arc.struck is not None and arc.struck.swaps for arc in step.arcs[1:]), table.cycle_end == TOUCHDOWN]
        for arc, landing, swaps in zip(step.arcs, landings, ends, strict=True):
            if swaps and gait.system.walker.base_contact() in arc.mode.touching:
                distances.append(abs(landing - arc.states[-1, x]))
    if distances:
        return float(max(distances)) / gait.dynamics.scales.length
    n = gait.system.n_z // 2
    q = np.concatenate([arc.states[:, :n] for step in gait.steps for arc in step.arcs])
    return float((np.ptp(q, axis=0) / gait.dynamics.state_units[:n]).max())


def _margins(gait: Gait, arc: Arc) -> Array:
    """Margins of the mode along an arc in natural units; shape (n_margins, m)."""
    values = arc.dynamics.margins(arc.mode, arc.segment, arc.times, arc.states)
    return np.asarray(values / gait.dynamics.margin_units(arc.mode)).T


def _lowest(along: list[Array], zeros: tuple[int, int], long: list[Arc], arcs: list[Arc]) -> MonitorValue:
    """The lowest value of a margin without its zeros at the ends of the phase, and where in the phase it lies.

    Parameters
    ----------
    along : the margin on each of the ``long`` arcs.
    zeros : orders of the zeros at the start and at the end of the phase.
    arcs : all arcs of the phase.
    """
    minima = []
    for arc, margin in zip(long, along, strict=True):
        start, end = zeros[0] * (arc is arcs[0]), zeros[1] * (arc is arcs[-1])
        at, height = curves.maximum(-deflated(margin, start, end))
        time = arc.start + arc.duration * (at + 1) / 2
        minima.append((-height, (time - arcs[0].start) / (arcs[-1].end - arcs[0].start)))
    return MonitorValue(*min(minima))


def zero_orders(table: Transitions, cycle: Cycle, phase: int, name: str, *, drops: bool) -> tuple[int, int]:
    """Orders of the zeros that events cause in a margin at the start and at the end of a phase.

    Parameters
    ----------
    drops : whether friction drops where a slip begins.
    """
    if kind(name) == "slip_velocity":
        start = cycle.onset_order(phase, contact_of(name), jump=drops)
    else:
        start = int(name in table.zeros_after(cycle, (phase - 1) % len(cycle.phases)))
    return start, int(cycle.after(phase) is not None and name in table.ending(cycle, phase).zeros)


def deflated(values: Array, start: int, end: int) -> Array:
    """Values of g / ((1 + s)^start (1 - s)^end) at Chebyshev points, from those of g along the last axis."""
    return values @ _deflation(values.shape[-1], start, end).T if start or end else values


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


def _guard_after(arc: Arc, following: Arc) -> float:
    """The margin that ends a phase, in natural units, at the start of the next phase, after a jump of the torques."""
    table = arc.dynamics.system.transitions
    row = table.margin_names(arc.mode).index(table.between(arc.mode, following.mode).guard)
    values = arc.dynamics.margins(arc.mode, following.segment, following.times[:1], following.states[:1])[0]
    return float(values[row] / arc.dynamics.margin_units(arc.mode)[row])


def _time_to_jump(arc: Arc, after: Mode) -> float:
    """Time [s] between the end of a phase and a breakpoint at which its margin jumps; inf if there is no breakpoint.

    It is negative if the phase ends on the other side of the breakpoint.
    """
    table, breakpoints = arc.dynamics.system.transitions, arc.dynamics.system.control.breakpoints
    if after not in table.at_breakpoint(arc.mode).candidates:
        return np.inf
    row = table.margin_names(arc.mode).index(table.between(arc.mode, after).guard)
    unit, times = arc.dynamics.margin_units(arc.mode)[row], list[float]()

    def guard(segment: int, time: float) -> float:
        return float(arc.dynamics.margins(arc.mode, segment, np.array([time]), arc.states[-1:])[0, row] / unit)

    for neighbour, k, sign in ((arc.segment - 1, arc.segment - 1, -1), (arc.segment + 1, arc.segment, 1)):
        if 0 <= k < len(breakpoints):
            b = breakpoints[k]  # compare at the breakpoint: elsewhere, torques with only a kink there differ as well
            if not abs(guard(neighbour, b) - guard(arc.segment, b)) <= SMALLEST_JUMP:
                times.append(sign * (b - arc.end))
    return min(times, default=np.inf)


def _force_beyond_cone(arc: Arc, contact: str) -> float:
    """Excess of the force that would hold a contact at the start of a slip over static friction [N]."""
    table = arc.dynamics.system.transitions
    stick, cone = table.sticking(arc.mode, contact)
    margins = arc.dynamics.margins(stick, arc.segment, arc.times[:1], arc.states[:1])[0]
    return -float(margins[table.margin_names(stick).index(cone)])
