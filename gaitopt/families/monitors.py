"""What a mode sequence assumes along a gait, as numbers that are positive while it holds.

A margin that an event makes zero at an end of its phase is divided by that zero, so that what is left tells whether
the event is still crossed: with s in [-1, 1] over the phase and g the margin,

    monitor = min over s of g(s) / ((1 + s)^a (1 - s)^b)

a = 1 where a slip starts at rest with an acceleration, a = 2 at the onset of slip (a double zero), b = 1 where an
event ends the phase; g is in natural units. A monitor that changes sign along a branch marks the end of the sequence.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev

from gaitopt.arrays import Array
from gaitopt.gait import Arc, Gait, curves
from gaitopt.mechanics import Mode, ending_margin, margin, margin_names, margin_scales, margin_unit

SHORT = 1e-4
"""Phases shorter than this part of the period are judged by their duration alone: the rest is rounding."""
CLEAR = 1e-3
"""Part of its largest clearance above which the swing foot has left the ground: next to a phase of no duration, or of
less, the clearance that it starts from is not exactly zero."""
OPEN = 1.0
"""Value of a monitor that is far from anything."""


@dataclass(frozen=True, slots=True)
class MonitorKey:
    """What is watched.

    Attributes
    ----------
    kind : ``duration``, or one of ``mechanics.margins``, where ``touchdown`` is a second one within the step.
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
    return {**dict(_phase_values(gait)), **dict(_impact_values(gait))}


def _phase_values(gait: Gait) -> Iterator[tuple[MonitorKey, MonitorValue]]:
    modes = gait.problem.cycle.phases
    arcs = _arcs_by_phase(gait)
    period = abs(gait.period)
    for phase, whole in enumerate(arcs):
        duration = sum(arc.duration for arc in whole)
        yield MonitorKey("duration", phase), MonitorValue(duration / period)
        if duration < SHORT * period:
            continue
        group = [arc for arc in whole if arc.duration > SHORT * period]
        margins = [_margins(gait, arc) for arc in group]
        for row, kind in enumerate(margin_names(modes[phase])):
            if kind != "upright" and not margin(kind).rises:
                zeros = _zeros(gait, phase, kind)
                found = [_lowest(m[row], *_own(zeros, arc, whole)) for m, arc in zip(margins, group, strict=True)]
                yield MonitorKey(kind, phase), _combine(found, group, whole)
        if gait.problem.cycle.starts_from_rest(phase) and gait.dynamics.friction_drops:
            yield MonitorKey("onset", phase), MonitorValue(_beyond_cone(gait, whole[0]), 0.0)
    for first, step in zip(gait.problem.cycle.first_phases, gait.steps, strict=True):
        for name in dict.fromkeys(name for arc in step.arcs for name in margin_names(arc.mode) if margin(name).rises):
            within = [name in margin_names(arc.mode) for arc in step.arcs]
            last = max(phase for phase, has in zip(step.arc_phases, within, strict=True) if has)
            own = [arc for arc, has in zip(step.arcs, within, strict=True) if has]
            yield MonitorKey(name, first + last), MonitorValue(_second_fall(gait, name, own))


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
    return start, int(after is not None and kind == ending_margin(cycle.phases[phase], after))


def _own(zeros: tuple[int, int], arc: Arc, whole: list[Arc]) -> tuple[int, int]:
    return (zeros[0] if arc is whole[0] else 0), (zeros[1] if arc is whole[-1] else 0)


def _lowest(values: Array, start: int, end: int) -> tuple[float, float]:
    """Where in [-1, 1] the margin without its zeros is lowest, and its value there."""
    if start or end:
        values = _deflation(values.size, start, end) @ values
    at, lowest = curves.maximum(-values)
    return at, -lowest


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


def _combine(found: list[tuple[float, float]], group: list[Arc], whole: list[Arc]) -> MonitorValue:
    index = int(np.argmin([value for _, value in found]))
    at, value = found[index]
    arc = group[index]
    time = arc.start + arc.duration * (at + 1) / 2
    return MonitorValue(value, (time - whole[0].start) / (whole[-1].end - whole[0].start))


def _second_fall(gait: Gait, name: str, arcs: Sequence[Arc]) -> float:
    """Lowest interior minimum of a margin after it has risen from zero: below zero it falls earlier, as a touchdown."""
    lowest, armed = OPEN, False
    clearances = [_margins(gait, arc)[margin_names(arc.mode).index(name)] for arc in arcs]
    level, period = CLEAR * max(float(values.max()) for values in clearances), abs(arcs[-1].end)
    for arc, values in zip(arcs, clearances, strict=True):
        if arc.duration < SHORT * period:
            continue
        c = curves.coefficients(values)
        minima = [s for s in curves.roots(_slope(c)) if curves.evaluate(_derivative(c, 2), s) > 0]
        for s in minima:
            if armed or (values[curves.points(values.size) < s] > level).any():
                lowest = min(lowest, float(curves.evaluate(c, s)))
        armed = armed or bool((values[:-1] > level).any())
    return lowest


def _beyond_cone(gait: Gait, arc: Arc) -> float:
    """By how much the force that would hold the foot at the start of a slip exceeds static friction [N]."""
    stick = arc.mode.with_contact(Mode.STICK)
    margins = gait.dynamics.standing(arc.side).margins(stick, arc.segment, arc.times[:1], arc.states[:1])[0]
    return -float(margins[margin_names(stick).index(ending_margin(stick, arc.mode))])


def _slope(c: Array) -> Array:
    return np.asarray(curves.evaluate(_derivative(c, 1), curves.points(c.size)))


def _derivative(c: Array, order: int) -> Array:
    return np.asarray(chebyshev.chebder(c, order), dtype=float)


def _margins(gait: Gait, arc: Arc) -> Array:
    values = gait.dynamics.standing(arc.side).margins(arc.mode, arc.segment, arc.times, arc.states)
    return np.asarray(values / margin_scales(arc.mode, gait.dynamics.scales)).T


def _impact_values(gait: Gait) -> Iterator[tuple[MonitorKey, MonitorValue]]:
    cycle, arcs = gait.problem.cycle, _arcs_by_phase(gait)
    for phase, mode in cycle.resets:
        at = {"phase": phase} if mode.locked else {"step": cycle.step_of(phase)}
        for kind, value in _impact_monitors(gait, mode, arcs[phase][-1]):
            yield MonitorKey(kind, **at), MonitorValue(float(value))


def _impact_monitors(gait: Gait, mode: Mode, last: Arc) -> Iterator[tuple[str, float]]:
    """Margins by name of the impact after an arc, in natural units."""
    scales = gait.dynamics.scales
    margins = gait.dynamics.standing(last.side).impact_margins(mode, last.states[-1])
    for name, value in margins.items():
        if name == "touchdown_rate" or (name == "impact_onset" and not gait.dynamics.friction_drops):
            continue  # a grazing touchdown is a second one, too; equal coefficients leave no doubt about an onset
        yield name, value / margin_unit(name, scales)
