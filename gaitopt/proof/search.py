"""What a proof is tried with: precise orbits, and steps that can be verified. Nothing here has to be right.

The doubles of a gait are refined by Newton's method in long precision, and the steps of the integration are chosen
such that their remainders stay below ``TOLERANCE``.
"""

from collections.abc import Sequence
from typing import Any

from flint import arb, arb_mat

from gaitopt.gait import Gait
from gaitopt.mechanics import ending_margin
from gaitopt.proof.box import Box
from gaitopt.proof.check import approximate_inverse
from gaitopt.proof.field import Field
from gaitopt.proof.graph import NotProved
from gaitopt.proof.orbit import BREAKPOINT, Arc, Orbit, Passage
from gaitopt.proof.parametric import hull, scattered
from gaitopt.proof.taylor import LOW_ORDER, ORDER, expand

TOLERANCE = 1e-19
"""Remainder of a step in the state; far below the width of the boxes that are proved."""
OBSERVED_TOLERANCE = 1e-10
"""Remainder of margins, force ratio and power, in SI."""
SAFETY, LARGEST_GROWTH, LARGEST_CUT = 0.93, 1.5, 0.4
"""The next step relative to one with the remainder that is allowed, and bounds of its length relative to the last."""
LAST_STEP = (0.4, 1.1)
"""Range of the last step of an arc, relative to the planned one, in which a plan is used for another orbit."""


def arcs_of(gait: Gait) -> list[Arc]:
    """The arcs of a gait, without steps."""
    cycle, arcs, first = gait.problem.cycle, [], 0
    for step in gait.steps:
        lasts = [k + 1 == len(step.arc_phases) or step.arc_phases[k + 1] != p for k, p in enumerate(step.arc_phases)]
        for arc, phase, last in zip(step.arcs, step.arc_phases, lasts, strict=True):
            event = ending_margin(arc.mode, cycle.after(first + phase)) if last else BREAKPOINT
            arcs.append(Arc(arc.mode, int(arc.segment), first + phase, event, ()))
        first += len(step.phases)
    return arcs


def unknowns(orbit: Orbit, gait: Gait) -> list[arb]:
    """u of a gait, in doubles."""
    sections = zip(gait.steps, orbit.sections, strict=True)
    u = [step.arcs[0].states[0][k] for step, section in sections for k in section]
    return [arb(float(value)) for value in (*u, *(arc.duration for arc in gait.arcs))]


def plan(orbit: Orbit, gait: Gait) -> list[list[float]]:
    """Lengths of the steps of every arc of a gait, the last one included."""
    starts = [[*map(arb, map(float, arc.states[0])), arb(arc.start)] for arc in gait.arcs]
    return replan(orbit, starts, [arc.duration for arc in gait.arcs])


def replan(orbit: Orbit, starts: Sequence[Sequence[Any]], durations: Sequence[float]) -> list[list[float]]:
    """The same from the states in which the arcs start."""
    lengths = []
    for arc, start, duration in zip(orbit.arcs, starts, durations, strict=True):
        y = [hull(value).mid() for value in start]
        if arc.mode.sticks:
            y[orbit.system.n_z - 1] = arb(0)
        lengths.append(_steps(orbit.field(arc.mode, arc.segment).hull, y, duration))
    return lengths


def without_last(lengths: Sequence[Sequence[float]]) -> list[list[float]]:
    """The steps of a plan as a certificate states them: the last one ends with its arc."""
    return [list(steps[:-1]) for steps in lengths]


def is_usable(lengths: Sequence[Sequence[float]], durations: Sequence[float]) -> bool:
    """Whether the steps of a plan serve for other durations of the arcs."""
    low, high = LAST_STEP
    last = [(duration - sum(steps[:-1])) / steps[-1] for steps, duration in zip(lengths, durations, strict=True)]
    return all(low < ratio < high for ratio in last)


def refine(orbit: Orbit, centre: Sequence[Any]) -> tuple[list[Any], list[arb], Passage]:
    """A step of Newton's method, in a family for polynomials; what it leaves open, and the motions before it."""
    passage = orbit.traverse(Box(centre, [arb(0)] * len(centre)))
    update = scattered(approximate_inverse(orbit.slope(passage)) * orbit.residual(passage), arb_mat.entries)
    left = [hull(change - change.mid()).abs_upper() for change in update]
    return [(value - change).mid() for value, change in zip(centre, update, strict=True)], left, passage


def _steps(field: Field, y: list[arb], duration: float) -> list[float]:
    left, h = duration, duration
    steps: list[float] = []
    while left > 0:
        h = min(h, left)
        excess, end = _try(field, y, h)
        if excess > 1:
            h *= max(SAFETY / excess, LARGEST_CUT)
            continue
        steps.append(h)
        y, left = end, left - h
        h *= min(SAFETY / max(excess, SAFETY / LARGEST_GROWTH), LARGEST_GROWTH)
        h = left if h > left else min(h, left / 2) if 2 * h > left else h
    return steps


def _try(field: Field, y: list[arb], h: float) -> tuple[float, list[arb]]:
    """How many times too long a step is for its remainders to be small, and where it ends."""
    try:
        expansion = expand(field, y, arb(h))
        observed = [*expansion.along(field.margins), *expansion.along(field.observation)]
    except NotProved:
        return 1 / LARGEST_CUT, y
    ratios = [_excess(c[ORDER], h, ORDER, TOLERANCE) for c in expansion.beyond]
    ratios += [_excess(f.value[-1], h, LOW_ORDER, OBSERVED_TOLERANCE) for f in observed]
    return max(ratios), [value.mid() for value in expansion.end]


def _excess(coefficient: arb, h: float, order: int, tolerance: float) -> float:
    if not coefficient.is_finite():
        return 1 / LARGEST_CUT
    return float((float(coefficient.abs_upper()) / tolerance) ** (1 / order) * h)
