"""Measures of a proved gait as balls: period, step length, speed, work, cost of transport, required friction."""

from collections.abc import Iterable

from casadi import SX, Function
from flint import arb

from gaitopt.proof.graph import Graph
from gaitopt.proof.orbit import Orbit, Passage
from gaitopt.proof.signs import parts
from gaitopt.proof.taylor import Series, evaluate
from gaitopt.proof.tilted import hull


def measures(orbit: Orbit, passage: Passage, period: arb) -> dict[str, arb | None]:
    """The measures of every gait in the box, by the names of a gait's record."""
    work, ratios = arb(0), list[tuple[Series, arb]]()
    for j, arc in enumerate(orbit.arcs):
        for step in passage.steps[j]:
            ratio, power = step.along(orbit.field(arc.mode, j).observation)
            work += evaluate([arb(0), *(c / (k + 1) for k, c in enumerate(power.value))], hull(step.h))
            if arc.mode.sticks:
                ratios.append((ratio, hull(step.h)))
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
        "required_friction": largest_modulus(ratios) if ratios else None,
    }


def largest_modulus(steps: Iterable[tuple[Series, arb]]) -> arb:
    """The maximum of a function's modulus over steps: at the ends of parts on which it is monotone, or next to them."""
    lower, upper = arb(0), arb(0)
    for f, h in steps:
        for part in parts([(Series(f.rate), h)], monotone=False):
            first, last = (abs(evaluate(f.value, t)) for t in (part.start, part.end))
            bound = first + abs(part.value) * (part.end - part.start) if part.kind == "?" else last
            upper = max(upper, first.upper(), bound.upper())
            if part.within:
                lower = max(lower, first.lower(), last.lower())
    return lower.union(upper)
