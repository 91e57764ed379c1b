"""Measures of a proved gait as balls: period, step length, speed, work, cost of transport, required friction."""

from collections.abc import Iterable

from casadi import SX, Function
from flint import arb

from gaitopt.proof.graph import Graph
from gaitopt.proof.orbit import Orbit, Passage
from gaitopt.proof.signs import FINEST
from gaitopt.proof.taylor import Series, evaluate
from gaitopt.proof.tilted import hull

SHARP = 1e-12
"""Relative excess of an upper bound that is not worth another division."""


def measures(orbit: Orbit, passage: Passage, period: arb) -> dict[str, arb | None]:
    """The measures of every gait in the box, by the names of a gait's record."""
    work, forces = arb(0), list[tuple[Series, Series, arb, arb]]()
    for j, arc in enumerate(orbit.arcs):
        observation = orbit.field(arc.mode, j).observation
        along = [step.along(observation) for step in passage.steps[j]]
        starts = [(f_t.value[0], f_n.value[0]) for f_t, f_n, _ in along]
        ends = [*starts[1:], tuple(map(hull, observation(passage.ends[j])[0][:2]))]
        for step, (f_t, f_n, power), end in zip(passage.steps[j], along, ends, strict=True):
            work += evaluate([arb(0), *(c / (k + 1) for k, c in enumerate(power.value))], hull(step.h))
            if arc.mode.sticks:
                forces.append((f_t, f_n, hull(step.h), abs(end[0] / end[1])))
    length = arb(0)
    for k, impact in enumerate(orbit.sequence.impacts):
        j = orbit.arcs_of(k)[-1]
        length += orbit.impact(impact, j)(passage.ends[j])[1][orbit.system.n_shape]
    p = SX.sym("p", len(orbit.p))
    weight = Graph(Function("weight", [p], [orbit.system.weight(p)]), [])(orbit.p)[0][0]
    return {
        "period": period,
        "step_length": length,
        "speed": length / period,
        "work": work,
        "cost_of_transport": work / (weight * length),
        "required_friction": largest_ratio(forces) if forces else None,
    }


def largest_ratio(steps: Iterable[tuple[Series, Series, arb, arb]]) -> arb:
    """The maximum of |f_t| / f_n over steps of some lengths, given with the ratio at their ends; f_n is positive.

    A part of a step counts by its ends where the ratio is monotone, else by the mean value theorem, or is halved.
    """
    lower, upper = arb(0), arb(0)
    for f_t, f_n, h, at_end in steps:
        lower, pending = max(lower, at_end.lower()), [(arb(0), arb(h.upper()), FINEST)]
        while pending:
            start, end, depth = pending.pop()
            first, last = (
                abs(evaluate(f_t.value, t) / evaluate(f_n.value, t)) if t < h else at_end for t in (start, end)
            )
            lower = max(lower, first.lower() if first.is_finite() else lower)
            bound = _largest_on(f_t, f_n, start, end, (first, last))
            if bound <= lower:
                continue
            if depth and not bound <= lower * (1 + SHARP):
                middle = ((start + end) / 2).mid()
                pending += [(middle, end, depth - 1), (start, middle, depth - 1)]
            else:
                upper = max(upper, bound)
    return lower.union(max(lower, upper))


def _largest_on(f_t: Series, f_n: Series, start: arb, end: arb, at_ends: tuple[arb, arb]) -> arb:
    """An upper bound of |f_t| / f_n between two times."""
    t = start.union(end)
    force, normal = evaluate(f_t.value, t), evaluate(f_n.value, t)
    slope = (evaluate(f_t.rate, t) * normal - force * evaluate(f_n.rate, t)) / normal**2
    bound = max(at_ends[0].upper(), at_ends[1].upper())
    if not (slope > 0 or slope < 0):
        bound = (at_ends[0] + abs(slope) * (end - start)).upper()
    return bound if normal > 0 and bound.is_finite() else arb("inf")
