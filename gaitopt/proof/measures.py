"""Measures of a proved gait as balls: period, step length, speed, work, cost of transport, required friction."""

from collections.abc import Iterable

from casadi import SX, Function
from flint import acb, acb_mat, arb, arb_mat

from gaitopt.proof.graph import Graph, NotProved
from gaitopt.proof.orbit import Orbit, Passage
from gaitopt.proof.parametric import hull
from gaitopt.proof.taylor import Series, evaluate

HALVINGS = 16
"""How often a part of a step on which a maximum may lie is halved; its bound is off by the square of its length."""


def measures(orbit: Orbit, passage: Passage, durations: list[arb]) -> dict[str, arb | None]:
    """The measures of every gait in the box, by the names of a gait's record."""
    period, length = sum(durations, arb(0)), arb(0)
    for step, impact in enumerate(orbit.sequence.impacts):
        after = orbit.impact(impact, passage.ends[orbit.arcs_of(step)[-1]]).z_plus
        length += hull(after[orbit.system.n_shape])
    ratios: list[tuple[Series, arb]] = []
    work = arb(0)
    for arc, expansions in zip(orbit.arcs, passage.expansions, strict=True):
        graph = orbit.field(arc.mode, arc.segment).observation
        for expansion in expansions:
            ratio, power = expansion.along(graph)
            work += _integral(power, hull(expansion.h))
            if arc.mode.sticks:
                ratios.append((ratio, hull(expansion.h)))
    return {
        "period": period,
        "step_length": length,
        "speed": length / period,
        "work": work,
        "cost_of_transport": work / (_weight(orbit) * length),
        "required_friction": largest_modulus(ratios) if ratios else None,
    }


def multipliers(derivative: arb_mat) -> list[acb]:
    """Eigenvalues of the return map's derivative, largest modulus first.

    Raises
    ------
    NotProved
        If the bounds of the derivative are too wide to enclose them.
    """
    matrix = acb_mat(derivative)
    if matrix.nrows() == 1:
        return [matrix[0, 0]]
    try:
        values = matrix.eig(multiple=True, algorithm="rump")
    except ValueError as failure:
        raise NotProved(f"the multipliers cannot be enclosed: {failure}") from failure
    return sorted(values, key=lambda m: (-float(m.abs_upper()), -float(m.real), -float(m.imag)))


def largest_modulus(steps: Iterable[tuple[Series, arb]]) -> arb:
    """The maximum of a function's modulus over steps."""
    parts = []
    for f, h in steps:
        for sign in (1, -1):
            parts.append((Series([sign * c for c in f.value], [sign * c for c in f.rate]), arb(0), h.upper(), HALVINGS))
    lowest, top = arb(0), arb(0)
    while parts:
        bounds = [_bounds(f, a, b) for f, a, b, _ in parts]
        lowest = max(lowest, *(lower for lower, *_ in bounds))
        halves = []
        for (f, a, b, depth), (_, upper, monotone) in zip(parts, bounds, strict=True):
            if monotone or not depth:
                top = max(top, upper)
            elif upper > lowest:
                middle = ((a + b) / 2).mid()
                halves += [(f, a, middle, depth - 1), (f, middle, b, depth - 1)]
        parts = halves
    return lowest.union(max(lowest, top))


def _bounds(f: Series, a: arb, b: arb) -> tuple[arb, arb, bool]:
    """Bounds from below and above of a function's maximum on a part, and whether it is monotone there."""
    ends = [evaluate(f.value, a), evaluate(f.value, b)]
    lower, rate, part = max(end.lower() for end in ends), evaluate(f.rate, a.union(b)), a.union(b)
    if rate > 0 or rate < 0:
        return lower, max(end.upper() for end in ends), True
    middle = part.mid()
    return lower, (evaluate(f.value, middle) + rate * (part - middle)).upper(), False


def _integral(f: Series, h: arb) -> arb:
    return evaluate([c / (k + 1) for k, c in enumerate(f.value)], h) * h


def _weight(orbit: Orbit) -> arb:
    p = SX.sym("p", len(orbit.p))
    return arb(Graph(Function("weight", [p], [orbit.system.weight(p)]), [])([hull(value) for value in orbit.p])[0][0])
