"""What makes a periodic orbit a gait with the stated mode sequence: margins, modes at rest, and the impact.

Every claim holds for all orbits in the proved box. One that cannot be shown raises ``NotProved`` with where and by how
much.

The sign of a function of time on a whole arc, from its enclosed Taylor series.

Every step is divided until each part is of one kind, written as a letter

    p  positive      n  negative      u  rising      d  falling      ?  none of it could be shown

so that a claim on an arc is a pattern: ``p+`` positive throughout, ``p*d+`` positive until it falls to the zero at its
end, ``n*u*p+d+`` a touchdown, the first fall to zero after having been positive. Where a function is known to start
with a zero of order k, its sign just after it is that of its series divided by t^k.

Measures of a proved gait as balls: period, step length, speed, work, cost of transport, required friction.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import groupby
from math import isfinite

from casadi import SX, Function, simplify
from flint import arb

from gaitopt.model.control import Control
from gaitopt.model.cycle import Cycle
from gaitopt.model.margins import MARGINS, margin_names
from gaitopt.model.modes import CONTACTS, ImpactLaw, Mode
from gaitopt.model.system import HybridSystem
from gaitopt.proof.graph import Graph, NotProved, Refuted, hull
from gaitopt.proof.orbit import BREAKPOINT, Arc, Orbit, Passage
from gaitopt.proof.taylor import Series, evaluate

POSITIVE = "p+"
ENDS = "p*d+"
TOUCHDOWN = "n*u*p+d+"
FINEST = 14
"""How often a step is halved at most."""


@dataclass(frozen=True, slots=True)
class Part:
    """A part of an arc on which a function is of one kind.

    Attributes
    ----------
    start, end : time since the start of the arc [s].
    value : the function there; divided by t^order next to a zero.
    order : of the zero with which the part starts.
    within : whether all of it is before the end of the arc, which is only enclosed.
    """

    kind: str
    start: arb
    end: arb
    value: arb
    order: int
    within: bool


def parts(steps: Iterable[tuple[Series, arb]], order: int = 0, *, monotone: bool = True) -> Iterator[Part]:
    """Parts of an arc in order of time.

    Parameters
    ----------
    steps : the function on every step, and the step's length.
    order : of the zero with which it starts.
    monotone : whether it is enough to know that a part rises or falls.
    """
    began = arb(0)
    for k, (series, h) in enumerate(steps):
        pending = [(arb(0), arb(h.upper()), FINEST)]
        while pending:
            start, end, depth = pending.pop()
            t, zero = start.union(end), order if k == 0 and start.is_zero() else 0
            value = evaluate(series.value[zero:], t)
            kind = "p" if value > 0 else "n" if value < 0 else "?"
            if kind == "?" and monotone:
                rate = evaluate(series.rate, t)
                kind = "u" if rate > 0 else "d" if rate < 0 else "?"
            if kind == "?" and depth and value.is_finite():
                middle = ((start + end) / 2).mid()
                pending += [(middle, end, depth - 1), (start, middle, depth - 1)]
            else:
                yield Part(kind, began + start, began + end, value, zero, bool(end <= h.lower()))
        began += h.mid()


def check_pattern(name: str, along: Sequence[Part], pattern: str) -> str:
    """The kinds of all parts, repeated ones counted, if they match a pattern.

    Raises
    ------
    NotProved
        If they do not; the message says when, and which values the function may have there. ``Refuted`` if it is
        negative there.
    """
    kinds = "".join(part.kind for part in along)
    if not re.fullmatch(pattern, kinds):
        negative = [] if pattern == TOUCHDOWN else [part for part in along if part.kind == "n" and part.within]
        fitting = max(k for k in range(len(kinds) + 1) if re.fullmatch(pattern.replace("+", "*"), kinds[:k]))
        part = min(negative, key=lambda part: part.value.upper(), default=along[min(fitting, len(along) - 1)])
        when = f"between {float(part.start):.6g} and {float(part.end):.6g} s of the arc"
        words = f"{name} is {part.value.str(6)} {when}: {_SHAPES[pattern]} is"
        if negative:
            raise Refuted(f"{words} false", name)
        raise NotProved(f"{words} not shown")
    return " ".join(f"{kind}{len(list(group))}" for kind, group in groupby(kinds))


def smallest(along: Sequence[Part]) -> arb | None:
    """A lower bound of the function over the parts where it is positive and not divided by a power of time."""
    return min((part.value.lower() for part in along if part.kind == "p" and not part.order), default=None)


_SHAPES = {
    POSITIVE: "that it is positive throughout",
    ENDS: "that it is positive and falls to zero only at the end",
    TOUCHDOWN: "that it falls to zero for the first time after having been positive at the end",
}


SLIPS, CONES = (Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD), ("cone_forward", "cone_backward")
WORDS = {
    POSITIVE: "is positive throughout",
    ENDS: "is positive and falls monotonically to its zero at the end",
    TOUCHDOWN: "falls to zero for the first time after having been positive at the end of the step",
}


@dataclass(frozen=True, slots=True)
class Claim:
    """A statement of the theorem.

    Attributes
    ----------
    name : what it is about.
    words : the statement, or why it is not proved.
    margin : a proved bound of the quantity that has to be positive, if there is one.
    refuted : whether the contrary is proved.
    violated : the margin that is proved to be negative, where it is a single one.
    """

    name: str
    proved: bool
    words: str
    margin: arb | None = None
    refuted: bool = False
    violated: str = ""


APPARENT_MASS, TIME_WINDOW, AT_REST = "apparent mass", "time window", "mode at rest"
Check = tuple[str, Callable[[], tuple[str, arb | None]]]


def mode_claim_names(system: HybridSystem, sequence: Cycle, arcs: Sequence[Arc]) -> tuple[str, ...]:
    """The names of all claims that make an orbit a gait of a mode sequence."""
    names = list[str]()
    for j, arc in enumerate(arcs):
        begins = j == 0 or arcs[j - 1].phase != arc.phase
        of_arc = [name for name in margin_names(arc.mode) if name != "touchdown"]
        of_arc += [APPARENT_MASS] if arc.mode.sticks else []
        of_arc += [TIME_WINDOW] if has_windows(system.control) else []
        of_arc += [AT_REST] if begins and sequence.impact_before(arc.phase) in (None, Mode.STICK) else []
        names += [f"{_title(arc, j)}: {name}" for name in of_arc]
    prefixes = [f"step {k + 1}, " for k in range(len(sequence.steps))] if len(sequence.steps) > 1 else [""]
    return (*names, *(f"{prefix}{name}" for prefix in prefixes for name in ("touchdown", "impact")))


def has_windows(control: Control) -> bool:
    """Whether a control law changes at some time, or ends."""
    return bool(control.breakpoints) or isfinite(control.horizon)


def _title(arc: Arc, j: int) -> str:
    return f"arc {j + 1}, {arc.mode}"


def mode_sequence_claims(orbit: Orbit, passage: Passage) -> Iterator[Claim]:
    """The mode sequence: margins of every arc, modes of a foot at rest, touchdowns, impacts."""
    for step, mode in enumerate(orbit.sequence.impacts):
        arcs = orbit.arcs_of(step)
        prefix = f"step {step + 1}, " if len(orbit.sequence.steps) > 1 else ""
        along = {j: _margins_along(orbit, passage, j) for j in arcs}
        touchdown = [part for j in arcs for part in along[j]["touchdown"]]
        checks = [check for j in arcs for check in _arc_checks(orbit, passage, j, along[j])]
        checks.append((f"{prefix}touchdown", partial(_margin, "touchdown", touchdown, TOUCHDOWN, arb(0))))
        checks.append((f"{prefix}impact", partial(_impact, orbit, mode, arcs[-1], passage.ends[arcs[-1]])))
        yield from (claim_of(name, check) for name, check in checks)


def claim_of(name: str, check: Callable[[], tuple[str, arb | None]]) -> Claim:
    """The claim that a check shows, or does not show."""
    try:
        words, margin = check()
    except NotProved as failure:
        violated = failure.margin if isinstance(failure, Refuted) else ""
        return Claim(name, proved=False, words=str(failure), refuted=isinstance(failure, Refuted), violated=violated)
    return Claim(name, proved=True, words=words, margin=margin)


def _arc_checks(orbit: Orbit, passage: Passage, j: int, along: Mapping[str, Sequence[Part]]) -> Iterator[Check]:
    """That every margin of an arc is positive, and that the mode of a foot at rest is the only one."""
    arc, title = orbit.arcs[j], _title(orbit.arcs[j], j)
    for name, at_end in zip(margin_names(arc.mode), orbit.field(arc.mode, j).margins(passage.ends[j])[0], strict=True):
        if name != "touchdown":
            pattern = ENDS if name == arc.event else POSITIVE
            yield f"{title}: {name}", partial(_margin, name, along[name], pattern, at_end)
    if arc.mode.sticks:
        yield f"{title}: {APPARENT_MASS}", partial(_apparent_mass, orbit, passage, j)
    if has_windows(orbit.system.control):
        yield f"{title}: {TIME_WINDOW}", partial(_time_window, orbit, j, passage.ends[j])
    if _begins(orbit, j) and orbit.sequence.impact_before(arc.phase) in (None, Mode.STICK):
        yield f"{title}: {AT_REST}", partial(_rest, orbit, j, passage.starts[j])


def _begins(orbit: Orbit, j: int) -> bool:
    """Whether an arc is the first one of its phase."""
    return j == 0 or orbit.arcs[j - 1].phase != orbit.arcs[j].phase


def _margins_along(orbit: Orbit, passage: Passage, j: int) -> dict[str, list[Part]]:
    """Every margin of an arc's mode along the arc."""
    arc, begins = orbit.arcs[j], _begins(orbit, j)
    graph, lengths = orbit.field(arc.mode, j).margins, [hull(step.h) for step in passage.steps[j]]
    series = zip(*(step.along(graph) for step in passage.steps[j]), strict=True)
    return {
        name: list(
            parts(
                zip(values, lengths, strict=True),
                _order_of_zero(orbit, arc.phase, name) if begins else 0,
                monotone=name in ("touchdown", arc.event),
            )
        )
        for name, values in zip(margin_names(arc.mode), series, strict=True)
    }


def _order_of_zero(orbit: Orbit, phase: int, name: str) -> int:
    """Order of the zero with which a margin starts because of what happened just before.

    A slip starts from rest; where it starts at the edge of the cone its acceleration is zero as well, because that
    is minus the cone's margin over the apparent mass. The landing foot is on the ground.
    """
    if name == "slip_velocity":
        return orbit.sequence.onset_order(phase, jump=_friction_drops(orbit))
    after_impact = phase in orbit.sequence.first_phases and name in ("touchdown", "upright")
    return int(after_impact and _vanishes_after_impact(orbit.system, name))


@lru_cache
def _vanishes_after_impact(system: HybridSystem, name: str) -> bool:
    """Whether a margin is identically zero just after an impact, as an expression in parameters or their inverses."""
    xi, p = SX.sym("xi", system.lift.size1_in(0)), SX.sym("p", len(system.parameters))
    index = margin_names(Mode.STICK).index(name)
    return any(
        simplify(system.margins(Mode.STICK)(0, system.lift(xi, q), q, SX.zeros(system.n_r))[index]).is_zero()
        for q in (p, 1 / p)
    )


def _friction_drops(orbit: Orbit) -> bool:
    if not orbit.system.friction.two_coefficients:
        return False
    if orbit.system.static_friction(orbit.p) > orbit.system.kinetic_friction(orbit.p):
        return True
    raise NotProved("static friction is not above kinetic friction: state one coefficient")


def _margin(name: str, along: Sequence[Part], pattern: str, at_end: arb) -> tuple[str, arb | None]:
    if pattern == POSITIVE and at_end < 0:
        raise Refuted(f"{name} is {at_end.str(6)} at the end of the arc", name)
    kinds = check_pattern(name, along, pattern)
    order = max(part.order for part in along)
    zero = f", after a zero of order {order} at its start" if order else ""
    return f"{name} {WORDS[pattern]}{zero} ({kinds})", smallest(along)


def _apparent_mass(orbit: Orbit, passage: Passage, j: int) -> tuple[str, arb | None]:
    """While the foot sticks, its apparent mass is positive for a slip in either direction.

    A slip from rest accelerates the foot by minus the margin of its cone over that mass. Inside the cone it would
    therefore move against its own direction: sticking is the only motion.
    """
    graph, lengths = orbit.field(orbit.arcs[j].mode, j).apparent_masses, [hull(step.h) for step in passage.steps[j]]
    both = [
        list(parts(zip(values, lengths, strict=True), monotone=False))
        for values in zip(*(step.along(graph) for step in passage.steps[j]), strict=True)
    ]
    for along in both:
        check_pattern("painleve", along, POSITIVE)
    bounds = [bound for bound in map(smallest, both) if bound is not None]
    return "the apparent mass of the foot is positive throughout, for a slip in either direction", min(bounds)


def _time_window(orbit: Orbit, j: int, y: Sequence[arb]) -> tuple[str, arb | None]:
    """An arc ends before the law of its segment does.

    It begins after that law does: its segment is the number of breakpoints at which arcs of this step have ended
    (``statement``), time goes on by positive durations, and a breakpoint sets it exactly.
    """
    arc, control = orbit.arcs[j], orbit.system.control
    edges = (*control.breakpoints, control.horizon)
    if arc.event == BREAKPOINT:
        return f"it ends with the breakpoint at {edges[arc.segment]!r} s", None
    time, segment, words = y[orbit.system.n_z], arc.segment, ""
    if not isfinite(edges[segment]):
        return "it follows the last breakpoint", None
    while segment + 1 < len(edges) and time.overlaps(arb(edges[segment])) and _same_law(orbit, segment):
        words = f", and that on both sides of the breakpoint at {edges[segment]!r} s is the same"
        segment += 1
    left = arb(edges[segment]) - time
    if left < 0:
        raise Refuted(
            f"it ends {(-left).str(6)} s after the law of its segment, which holds until {edges[segment]!r} s"
        )
    if not left > 0:
        raise NotProved(f"it may end after the law of its segment does, at {edges[segment]!r} s")
    return f"it ends before the law of its segment does, at {edges[segment]!r} s{words}", left.lower()


def _same_law(orbit: Orbit, segment: int) -> bool:
    """Whether the control law of a segment is, number by number, that of the next one."""
    return bool((orbit.system.data(segment) == orbit.system.data(segment + 1)).all())


def _rest(orbit: Orbit, j: int, y: Sequence[arb]) -> tuple[str, arb | None]:
    """A foot at rest can only do what the arc says: stick, or slip because sticking would need too much friction."""
    arc = orbit.arcs[j]
    margins = {
        mode: dict(zip(margin_names(mode), orbit.field(mode, j).margins(y)[0], strict=True)) for mode in CONTACTS
    }
    cones = dict(zip(SLIPS, (margins[Mode.STICK][name] for name in CONES), strict=True))
    needed = {f"no lift-off in {slip}": margins[slip]["normal_force"] * margins[slip]["painleve"] for slip in SLIPS}
    needed |= {name: cones[slip] for name, slip in zip(CONES, SLIPS, strict=True) if slip is not arc.mode}
    words = "the foot sticks: its force lies within the cone"
    if arc.mode.slips:
        words = "the force that would hold the foot leaves the cone here, on the side of this slip alone"
    if orbit.sequence.starts_from_rest(arc.phase):
        needed["onset"] = -cones[arc.mode]
        words = "holding the foot would need a force beyond the cone, on the side of this slip alone"
    return words, _all_positive(needed)


def _impact(orbit: Orbit, mode: Mode, j: int, y: Sequence[arb]) -> tuple[str, arb | None]:
    """The impact is consistent, no other one is, and the former stance foot lifts."""
    smallest_margin = _all_positive(_impact_margins(orbit, mode, j, y))
    for other in CONTACTS:
        if other is not mode and not (mode.sticks and orbit.system.law is ImpactLaw.FRICTIONLESS):
            margins = _impact_margins(orbit, other, j, y)
            if not any(margin < 0 for margin in margins.values()):
                shown = ", ".join(f"{name} {margin.str(6)}" for name, margin in margins.items())
                raise NotProved(f"an impact with {other} is not shown to be inconsistent: {shown}")
    return f"{mode} is the only consistent impact, and the former stance foot lifts", smallest_margin


def _impact_margins(orbit: Orbit, mode: Mode, j: int, y: Sequence[arb]) -> dict[str, arb]:
    """What has to be positive for an impact to be consistent."""
    return dict(zip(orbit.system.impact_margin_names(mode), orbit.impact(mode, j)(y)[0], strict=True))


def _all_positive(needed: Mapping[str, arb]) -> arb:
    """The smallest lower bound.

    Raises
    ------
    NotProved
        If one is not shown to be above zero; ``Refuted`` if it is below.
    """
    for name, value in needed.items():
        if value < 0:
            raise Refuted(f"{name} is {value.str(6)}, not positive", name if name in MARGINS else "")
        if not value > 0:
            raise NotProved(f"{name} is {value.str(6)}, not shown to be positive")
    return min(value.lower() for value in needed.values())


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
