"""What a proof is tried with: precise orbits, and steps that can be verified. Nothing here has to be right.

The doubles of a gait are refined by Newton's method in long precision, and the steps of the integration are chosen
such that their remainders stay below ``TOLERANCE``.
"""

from collections.abc import Sequence

from flint import arb

from gaitopt.gait import Gait
from gaitopt.mechanics import ending_margin
from gaitopt.proof.box import Box, vector
from gaitopt.proof.field import Field
from gaitopt.proof.graph import NotProved
from gaitopt.proof.orbit import BREAKPOINT, Arc, Orbit, Passage, part
from gaitopt.proof.taylor import LOW_ORDER, ORDER, expand

TOLERANCE = 1e-19
"""Remainder of a step in the state; far below the width of the boxes that are proved."""
OBSERVED_TOLERANCE = 1e-10
"""Remainder of margins, force ratio and power, in SI."""
SAFETY, LARGEST_GROWTH, LARGEST_CUT = 0.93, 1.5, 0.4
"""The next step relative to one with the remainder that is allowed, and bounds of its length relative to the last."""
NEWTON_STEPS = 2
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
    u += [arc.duration for arc in gait.arcs]
    return [arb(float(value)) for value in u] + ([] if orbit.varied is None else [orbit.p[orbit.varied].mid()])


def plan(orbit: Orbit, gait: Gait) -> list[list[float]]:
    """Lengths of the steps of every arc of a gait, the last one included."""
    s = [] if orbit.varied is None else [orbit.p[orbit.varied].mid()]
    starts = [[*map(arb, map(float, arc.states[0])), arb(arc.start), *s] for arc in gait.arcs]
    return replan(orbit, starts, [arc.duration for arc in gait.arcs])


def replan(orbit: Orbit, starts: Sequence[Sequence[arb]], durations: Sequence[float]) -> list[list[float]]:
    """The same from the states in which the arcs start."""
    lengths = []
    for arc, start, duration in zip(orbit.arcs, starts, durations, strict=True):
        y = [value.mid() for value in start]
        if arc.mode.sticks:
            y[orbit.system.n_z - 1] = arb(0)
        lengths.append(_steps(orbit.field(arc.mode, arc.segment), y, duration))
    return lengths


def planned(orbit: Orbit, lengths: Sequence[Sequence[float]]) -> list[Arc]:
    """The arcs with the steps of a plan."""
    return [
        Arc(arc.mode, arc.segment, arc.phase, arc.event, tuple(steps[:-1]))
        for arc, steps in zip(orbit.arcs, lengths, strict=True)
    ]


def is_usable(lengths: Sequence[Sequence[float]], durations: Sequence[float]) -> bool:
    """Whether the steps of a plan serve for other durations of the arcs."""
    low, high = LAST_STEP
    last = [(duration - sum(steps[:-1])) / steps[-1] for steps, duration in zip(lengths, durations, strict=True)]
    return all(low < ratio < high for ratio in last)


def refine(orbit: Orbit, u: list[arb], along: int | None, rounds: int = NEWTON_STEPS) -> tuple[Box, Passage]:
    """An orbit in long precision as a box without extent, with the tangent there; u_k keeps its value."""
    n = len(u)
    tangent = [] if along is None else [arb(int(i == along)) for i in range(n)]
    box = Box(list(u), [arb(0)] * n, along, tangent)
    for _ in range(rounds):
        passage = orbit.traverse(box)
        slope, rows = orbit.slope(passage, box).mid(), range(len(box.unknown))
        F_w = part(slope, rows, box.unknown)
        update = F_w.solve(vector(passage.flat_residual).mid()).entries()
        for k, change in zip(box.unknown, update, strict=True):
            box.centre[k] = (box.centre[k] - change).mid()
    if along is not None:
        for k, rate in zip(box.unknown, F_w.solve(-part(slope, rows, [along])).entries(), strict=True):
            tangent[k] = arb(float(rate.mid()))
    return Box(box.centre, box.deviation, along, tangent), passage


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
