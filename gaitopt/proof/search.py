"""What a proof is tried with: precise orbits, and steps that can be verified. Nothing here has to be right."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from flint import arb

from gaitopt.gait import Gait
from gaitopt.mechanics import ending_margin
from gaitopt.proof.field import Field
from gaitopt.proof.graph import NotProved
from gaitopt.proof.krawczyk import column, exact, middle
from gaitopt.proof.orbit import BREAKPOINT, Arc, Box, Orbit
from gaitopt.proof.taylor import expand

LEAST = 1e-300
SAFETY, LARGEST_GROWTH, LARGEST_CUT = 0.9, 1.5, 0.6
"""The next step relative to one with a remainder of 10^-order, and bounds of its length relative to the last."""


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


def plan(orbit: Orbit, gait: Gait) -> tuple[list[Arc], list[arb]]:
    """Arcs with the steps of their integration, and the nodes and durations of a gait in doubles."""
    arcs, nodes = [], list[arb]()
    for j, (arc, doubles) in enumerate(zip(orbit.arcs, gait.arcs, strict=True)):
        start = [*map(arb, map(float, doubles.states[0])), arb(float(doubles.start))]
        if arc.mode.sticks:
            start[-2] = arb(0)
        lengths, states = _steps(orbit, orbit.field(arc.mode, j), orbit.middle(start, 0), float(doubles.duration))
        arcs.append(replace(arc, fractions=tuple(h / float(doubles.duration) for h in lengths[:-1])))
        nodes += [value for y in states for value in y[: orbit.n]]
    return arcs, [*nodes, *(arb(float(arc.duration)) for arc in gait.arcs)]


def newton(orbit: Orbit, centre: Sequence[arb]) -> tuple[list[arb], list[arb]]:
    """A step of Newton's method for the orbit in the middle of the interval, and its derivative in the parameter."""
    zero = [arb(0)] * orbit.size
    passage = orbit.traverse(Box(centre, zero, zero))
    matrix = middle(orbit, passage)
    C = np.linalg.inv(matrix[:, :-1])
    residual = [arb(0)] * orbit.size
    for row, values in passage.residual.items():
        residual[row : row + len(values)] = values
    change = exact(C) * column(residual)
    rate = -C @ matrix[:, -1]
    return [(u - d).mid() for u, d in zip(centre, change.entries(), strict=True)], [*map(arb, rate.tolist())]


def _steps(orbit: Orbit, field: Field, y: list[arb], duration: float) -> tuple[list[float], list[list[arb]]]:
    """Lengths of the steps of an arc, and the states between them."""
    left, h, lengths, states = duration, duration, list[float](), [y]
    while left > 0:
        h = left if h > left else min(h, left / 2) if 2 * h > left else h
        try:
            step = expand(field, y, arb(h), orbit.order)
        except NotProved:
            h *= LARGEST_CUT
            continue
        last = max(float(c[-1].abs_upper()) for c in step.beyond)
        ratio = SAFETY * (10.0**-orbit.order / max(last, LEAST)) ** (1 / orbit.order) / h
        if ratio < LARGEST_CUT:
            h *= LARGEST_CUT
            continue
        y, left = [value.mid() for value in step.end], left - h
        lengths.append(h)
        states.append(y)
        h *= min(ratio, LARGEST_GROWTH)
    return lengths, states
