"""What a proof is tried with: a precise orbit, and steps that can be verified. Nothing here has to be right.

The doubles of a gait are refined by Newton's method in long precision, and the steps of the integration are chosen
such that their remainders stay below ``TOLERANCE``.
"""

from collections.abc import Sequence

from flint import arb, arb_mat

from gaitopt.gait import Arc as GaitArc
from gaitopt.gait import Gait
from gaitopt.mechanics import ending_margin
from gaitopt.proof.field import Field
from gaitopt.proof.graph import NotProved
from gaitopt.proof.orbit import BREAKPOINT, Arc, Orbit
from gaitopt.proof.taylor import LOW_ORDER, ORDER, Step, expand

TOLERANCE = 1e-21
"""Remainder of a step in the state; far below the width of the boxes that are proved."""
OBSERVED_TOLERANCE = 1e-11
"""Remainder of margins, force ratio and power, in SI."""
PICARD_ROUNDS = 8
WIDENING = 0.05
"""By which the enclosed speeds are widened, in their own widths and in 1 / s, so that they hold in a box as well."""
NEWTON_STEPS = 2


def plan(gait: Gait, p: Sequence[arb]) -> list[Arc]:
    """The arcs of a gait with steps for each."""
    (step,) = gait.steps
    bare = Orbit(gait.system, p, (), gait.problem.cycle.impact)
    modes = [mode for mode, _ in step.phases]
    arcs = []
    for arc, phase, last in zip(step.arcs, step.arc_phases, _lasts(step.arc_phases), strict=True):
        after = modes[phase + 1] if phase + 1 < len(modes) else None
        event = ending_margin(arc.mode, after) if last else BREAKPOINT
        steps = _steps(bare.field(arc.mode, arc.segment), arc)
        arcs.append(Arc(arc.mode, int(arc.segment), phase, event, steps))
    return arcs


def refine(orbit: Orbit, gait: Gait) -> list[arb]:
    """The centre of the box: the unknowns of the gait after some Newton steps in long precision."""
    x = [arb(float(gait.state[k])) for k in orbit.section]
    x += [arb(float(arc.duration)) for arc in gait.arcs]
    for _ in range(NEWTON_STEPS):
        passage = orbit.traverse(x, [arb(0)] * len(x))
        update = passage.slope.mid().solve(arb_mat(len(x), 1, passage.residual).mid())
        x = [(value - update[i, 0]).mid() for i, value in enumerate(x)]
    return x


def _lasts(phases: Sequence[int]) -> list[bool]:
    """Whether an arc is the last one of its phase."""
    return [k + 1 == len(phases) or phases[k + 1] != phase for k, phase in enumerate(phases)]


def _steps(field: Field, arc: GaitArc) -> tuple[Step, ...]:
    y = [arb(float(value)) for value in arc.states[0]] + [arb(arc.start)]
    if arc.mode.sticks:
        y[-2] = arb(0)
    left, h = arc.duration, arc.duration
    steps: list[Step] = []
    while left > 0:
        h = min(h, left)
        step = _step(field, y, h)
        if step is None:
            h *= 0.75
            continue
        if h == left:
            steps.append(Step(None, step.speeds))
            break
        steps.append(step)
        y = [value.mid() for value in expand(field, y, step, arb(h)).end]
        left -= h
        h = min(1.2 * h, left if 1.2 * h > left else left / 2 if 2.4 * h > left else left)
    return tuple(steps)


def _step(field: Field, y: list[arb], h: float) -> Step | None:
    """A step of length ``h``, if it can be verified with a small remainder."""
    speeds = [arb(rate) for rate in field.rate(y)[0]]
    for _ in range(PICARD_ROUNDS):
        wide = [speed + arb(0, float(speed.rad()) * WIDENING + 1e-7) for speed in speeds]
        box = [value + arb(0).union(arb(h)) * speed for value, speed in zip(y, wide, strict=True)]
        rates = [arb(rate) for rate in field.rate(box)[0]]
        if not all(rate.is_finite() for rate in rates):
            return None
        if all(speed.contains(rate) for speed, rate in zip(wide, rates, strict=True)):
            step = Step(h, tuple((float(v.lower()), float(v.upper())) for v in (_wider(v) for v in wide)))
            return step if _small(field, y, step) else None
        speeds = [speed.union(rate) for speed, rate in zip(wide, rates, strict=True)]
    return None


def _wider(speed: arb) -> arb:
    return speed + arb(0, float(speed.rad()) * WIDENING + 1e-7)


def _small(field: Field, y: list[arb], step: Step) -> bool:
    """Whether the remainders of the state, and of what is observed along the motion, are small."""
    assert step.h is not None
    try:
        expansion = expand(field, y, step, arb(step.h))
    except NotProved:
        return False
    if not all(_below(c[ORDER] * arb(step.h) ** ORDER, TOLERANCE) for c in expansion.beyond):
        return False
    series = [*expansion.along(field.margins), *expansion.along(field.observation)]
    return all(_below(f.value[-1] * arb(step.h) ** LOW_ORDER, OBSERVED_TOLERANCE) for f in series)


def _below(value: arb, bound: float) -> bool:
    return bool(value.abs_upper() < bound)
