"""The claims that make a periodic orbit a gait with a given mode sequence, and bounds of the gait's measures.

The claims are numbers 2 to 7 of docs/proof.md; they hold for all orbits in the proved box. Margins have to be positive
on whole arcs. Their enclosed Taylor series are divided in time until each part has one kind, written as a letter:

    p  positive      n  negative      u  rising      d  falling      ?  none of these is shown

A claim on an arc is a pattern of letters: ``p+`` positive throughout; ``p*d+`` positive, then falling to the zero at
the end; ``n*u*p+d+`` a touchdown, the first fall to zero after positive values. If a function starts with a zero of
known order k, its sign just after the start is that of its series divided by t^k.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from casadi import SX, simplify
from flint import arb

from gaitopt.building import built_once
from gaitopt.model.cycle import Cycle
from gaitopt.model.friction import ImpactLaw
from gaitopt.model.modes import CONTACTS, Mode
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import MARGINS
from gaitopt.proof.arithmetic import BallFunction, NotProved, Refuted, hull
from gaitopt.proof.law import ExactLaw
from gaitopt.proof.orbit import BREAKPOINT, CycleEnclosure, Orbit, OrbitArc
from gaitopt.proof.taylor import derivative, evaluate

POSITIVE, ENDS, TOUCHDOWN = "p+", "p*d+", "n*u*p+d+"
PATTERN_WORDS = {
    POSITIVE: "is positive throughout",
    ENDS: "is positive and falls monotonically to its zero at the end",
    TOUCHDOWN: "falls to zero for the first time after positive values at the end of the step",
}
MOST_HALVINGS = 14
"""A step of the integration is halved at most this many times; a part that then has no kind fails its claim."""
RELATIVE_WIDTH = 1e-12
"""A part is not divided further once its upper bound exceeds the known maximum by less than this part of it."""
SLIPS, CONES = (Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD), ("cone_forward", "cone_backward")
APPARENT_MASS, TIME_WINDOW, AT_REST = "apparent mass", "time window", "mode at rest"


@dataclass(frozen=True, slots=True)
class ProofClaim:
    """One statement of the theorem.

    Attributes
    ----------
    name : the name of the claim: which arc or step it concerns, and which margin.
    words : the statement in words, or why it is not proved.
    margin : proved lower bound of the quantity that has to be positive, if there is one.
    refuted : whether the contrary is proved.
    violated : the margin that is proved to be negative, if it is a single one.
    """

    name: str
    proved: bool
    words: str
    margin: arb | None = None
    refuted: bool = False
    violated: str = ""


@dataclass(frozen=True, slots=True)
class SignPart:
    """A part of an arc on which a function has one kind.

    Attributes
    ----------
    kind : ``p``, ``n``, ``u``, ``d`` or ``?``.
    start, end : time since the start of the arc [s].
    value : enclosure of the function on the part, divided by t^order.
    order : order of the zero at the start of the part; 0 if there is none.
    within : whether the whole part certainly lies before the end of the arc, whose time is only enclosed.
    """

    kind: str
    start: arb
    end: arb
    value: arb
    order: int
    within: bool


def sign_parts(
    steps: Iterable[tuple[Sequence[arb], arb]], order: int = 0, *, monotone: bool = True
) -> Iterator[SignPart]:
    """Divide an arc into parts on which a function has one kind, in order of time.

    Parameters
    ----------
    steps : the function on every step, and the length of the step [s].
    order : order of the zero with which the function starts; 0 if it starts with another value.
    monotone : whether a part may be classified as ``u`` or ``d``; if not, it is divided until its sign is known.
    """
    start_of_step = arb(0)
    for k, (series, h) in enumerate(steps):
        # the length of the step is a ball; the parts cover it up to its upper bound
        pending = [(arb(0), arb(h.upper()), MOST_HALVINGS)]
        while pending:
            start, end, depth = pending.pop()
            t, zero = start.union(end), order if k == 0 and start.is_zero() else 0
            value = evaluate(series[zero:], t)
            kind = "p" if value > 0 else "n" if value < 0 else "?"
            if kind == "?" and monotone:
                rate = evaluate(derivative(series), t)
                kind = "u" if rate > 0 else "d" if rate < 0 else "?"
            if kind == "?" and depth and value.is_finite():
                middle = ((start + end) / 2).mid()
                pending += [(middle, end, depth - 1), (start, middle, depth - 1)]
            else:
                yield SignPart(kind, start_of_step + start, start_of_step + end, value, zero, bool(end <= h.lower()))
        start_of_step += h.mid()


def check_pattern(name: str, parts: Sequence[SignPart], pattern: str) -> str:
    """The kinds of all parts as letters with counts (``p7 d2``), if they match a pattern.

    Raises
    ------
    NotProved
        If the parts do not match the pattern; the message says where, and which values the function may have there.
    Refuted
        If the function is negative where it has to be positive.
    """
    kinds = "".join(part.kind for part in parts)
    if not re.fullmatch(pattern, kinds):
        negative = [] if pattern == TOUCHDOWN else [part for part in parts if part.kind == "n" and part.within]
        matching = max(k for k in range(len(kinds) + 1) if re.fullmatch(pattern.replace("+", "*"), kinds[:k]))
        part = min(negative, key=lambda part: part.value.upper(), default=parts[min(matching, len(parts) - 1)])
        when = f"between {float(part.start):.6g} and {float(part.end):.6g} s of the arc"
        words = f"{name} is {part.value.str(6)} {when}: that it {PATTERN_WORDS[pattern]} is"
        if negative:
            raise Refuted(f"{words} false", name)
        raise NotProved(f"{words} not shown")
    return " ".join(f"{kind}{len(list(group))}" for kind, group in groupby(kinds))


def mode_claim_names(system: HybridSystem, law: ExactLaw, sequence: Cycle, arcs: Sequence[OrbitArc]) -> tuple[str, ...]:
    """The names of all claims that are required for an orbit to be a gait with this mode sequence.

    This list does not rely on ``mode_sequence_claims``. A claim that the latter forgets therefore leaves the theorem
    unproved.
    """
    names, windows = list[str](), bool(law.breakpoints) or law.horizon is not None
    for j, arc in enumerate(arcs):
        of_arc = [name for name in system.transitions.margin_names(arc.mode) if name != "touchdown"]
        of_arc += [APPARENT_MASS] if arc.mode.sticks else []
        of_arc += [TIME_WINDOW] if windows else []
        of_arc += [AT_REST] if _starts_at_rest(sequence, arcs, j) else []
        names += [f"arc {j + 1}, {arc.mode}: {name}" for name in of_arc]
    prefixes = [f"step {k + 1}, " for k in range(len(sequence.steps))] if len(sequence.steps) > 1 else [""]
    return (*names, *(f"{prefix}{name}" for prefix in prefixes for name in ("touchdown", "impact")))


def mode_sequence_claims(orbit: Orbit, cycle: CycleEnclosure) -> Iterator[ProofClaim]:
    """Prove or refute the mode sequence: margins on every arc, modes of a foot at rest, touchdowns, impacts."""
    sequence, windows = orbit.sequence, bool(orbit.law.breakpoints) or orbit.law.horizon is not None
    for step, impact in enumerate(sequence.impacts):
        arcs, touchdown = orbit.arcs_of(step), list[SignPart]()
        for j in arcs:
            arc, y_end = orbit.arcs[j], cycle.ends[j]
            title, signs = f"arc {j + 1}, {arc.mode}", _margin_signs(orbit, cycle, j)
            margins_at_end = orbit.field(arc.mode, j).margins(y_end)[0]
            for (name, parts), at_end in zip(signs.items(), margins_at_end, strict=True):
                if name != "touchdown":
                    pattern = ENDS if name == arc.event else POSITIVE
                    yield _claim(f"{title}: {name}", _margin, name, parts, pattern, at_end)
            touchdown += signs["touchdown"]
            if arc.mode.sticks:
                yield _claim(f"{title}: {APPARENT_MASS}", _apparent_mass, orbit, cycle, j)
            if windows:
                yield _claim(f"{title}: {TIME_WINDOW}", _time_window, orbit, j, y_end)
            if _starts_at_rest(sequence, orbit.arcs, j):
                yield _claim(f"{title}: {AT_REST}", _mode_at_rest, orbit, j, cycle.starts[j])
        prefix = f"step {step + 1}, " if len(sequence.steps) > 1 else ""
        yield _claim(f"{prefix}touchdown", _margin, "touchdown", touchdown, TOUCHDOWN, arb(0))
        yield _claim(f"{prefix}impact", _impact, orbit, impact, arcs[-1], cycle.ends[arcs[-1]])


def _claim(name: str, prove: Callable[..., tuple[str, arb | None]], *arguments: Any) -> ProofClaim:
    """The claim of this name: proved if ``prove`` succeeds on the arguments, with the reason if it fails."""
    try:
        words, margin = prove(*arguments)
    except NotProved as failure:
        violated = failure.margin if isinstance(failure, Refuted) else ""
        return ProofClaim(
            name, proved=False, words=str(failure), refuted=isinstance(failure, Refuted), violated=violated
        )
    return ProofClaim(name, proved=True, words=words, margin=margin)


def _starts_phase(arcs: Sequence[OrbitArc], j: int) -> bool:
    """Whether arc ``j`` is the first one of its phase; the others follow a breakpoint."""
    return j == 0 or arcs[j - 1].phase != arcs[j].phase


def _starts_at_rest(sequence: Cycle, arcs: Sequence[OrbitArc], j: int) -> bool:
    """Whether arc ``j`` starts a phase with the foot at rest, as any phase but one after an impact with slip does."""
    return _starts_phase(arcs, j) and sequence.impact_before(arcs[j].phase) in (None, Mode.STICK)


def _margin_signs(orbit: Orbit, cycle: CycleEnclosure, j: int) -> dict[str, list[SignPart]]:
    """The signs of all margins of the mode along arc ``j``, by name."""
    arc, steps = orbit.arcs[j], cycle.steps[j]
    names, lengths = orbit.system.transitions.margin_names(arc.mode), [hull(step.h) for step in steps]
    series = zip(*(step.along(orbit.field(arc.mode, j).margins) for step in steps), strict=True)
    signs = dict[str, list[SignPart]]()
    for name, values in zip(names, series, strict=True):
        order = _order_of_zero(orbit, arc.phase, name) if _starts_phase(orbit.arcs, j) else 0
        monotone = name in ("touchdown", arc.event)
        signs[name] = list(sign_parts(zip(values, lengths, strict=True), order, monotone=monotone))
    return signs


def _order_of_zero(orbit: Orbit, phase: int, name: str) -> int:
    """The order of the zero with which a margin starts after an impact or a change of mode; 0 if it has none.

    A slip starts from rest. If it starts at the edge of the cone its acceleration is zero too, because the acceleration
    is minus the cone's margin over the apparent mass. After an impact the other foot is on the ground.
    """
    if name == "slip_velocity":
        drops, (static, kinetic, _) = orbit.system.friction.may_drop, orbit.system.friction_coefficients(orbit.p)
        if drops and not static > kinetic:
            raise NotProved("static friction is not above kinetic friction: state one coefficient")
        return orbit.sequence.onset_order(phase, jump=drops)
    after_impact = phase in orbit.sequence.first_phases and name in ("touchdown", "upright")
    return int(after_impact and _vanishes_after_impact(orbit.system, name))


@built_once(maxsize=128)
def _vanishes_after_impact(system: HybridSystem, name: str) -> bool:
    """Whether a margin is identically zero just after an impact: CasADi simplifies its expression to zero.

    The expression is simplified in the parameters and in their inverses, as CasADi cancels only some quotients.
    """
    xi, p = SX.sym("xi", system.lift.size1_in(0)), SX.sym("p", len(system.parameters))
    index = system.transitions.margin_names(Mode.STICK).index(name)
    return any(
        simplify(system.margins(Mode.STICK)(0, system.lift(xi, q), q, SX.zeros(system.n_r))[index]).is_zero()
        for q in (p, 1 / p)
    )


def _margin(name: str, parts: Sequence[SignPart], pattern: str, at_end: arb) -> tuple[str, arb | None]:
    """Claims 2 and 6: a margin is positive along an arc, falls to the zero that ends it, or shows a touchdown."""
    if pattern == POSITIVE and at_end < 0:
        raise Refuted(f"{name} is {at_end.str(6)} at the end of the arc", name)
    kinds = check_pattern(name, parts, pattern)
    order = max(part.order for part in parts)
    zero = f", after a zero of order {order} at its start" if order else ""
    bounds = (part.value.lower() for part in parts if part.kind == "p" and not part.order)
    return f"{name} {PATTERN_WORDS[pattern]}{zero} ({kinds})", min(bounds, default=None)


def _apparent_mass(orbit: Orbit, cycle: CycleEnclosure, j: int) -> tuple[str, arb | None]:
    """Claim 3: while the foot sticks, its apparent mass C_tt +- mu C_nt is positive with the static coefficient mu.

    Without the sticking force f the foot would have the normal acceleration -(C_tt f_n - C_nt f_t) / det C. This is
    negative for every f in the static cone, so lift-off is not consistent. The apparent masses with the kinetic
    coefficient lie between those with the static one. A slip from rest accelerates the foot by minus the margin of the
    kinetic cone over the apparent mass, so no slip is consistent inside this cone. Between the kinetic and the static
    cone a slip is consistent too; the model chooses sticking there.
    """
    masses, lengths = orbit.field(orbit.arcs[j].mode, j).apparent_masses, [hull(step.h) for step in cycle.steps[j]]
    bounds = list[arb]()
    for values in zip(*(step.along(masses) for step in cycle.steps[j]), strict=True):
        parts = list(sign_parts(zip(values, lengths, strict=True), monotone=False))
        check_pattern("painleve", parts, POSITIVE)
        bounds += [part.value.lower() for part in parts]
    words = "the apparent mass of the foot is positive throughout, with the static coefficient in either direction"
    return words, min(bounds)


def _time_window(orbit: Orbit, j: int, y: Sequence[arb]) -> tuple[str, arb | None]:
    """Claim 5: an arc ends before the segment of its control law does.

    That it starts after its segment starts needs no claim: the number of its segment is the number of breakpoints at
    which arcs of this step have ended (``statement``), durations are positive, and a breakpoint sets the time exactly.
    """
    arc, law = orbit.arcs[j], orbit.law
    edge, time, segment, words = law.edges[arc.segment], y[orbit.system.n_z], arc.segment, ""
    if arc.event == BREAKPOINT and edge is not None:
        return f"the arc ends with the breakpoint at {seconds(edge)}", None
    while edge is not None and segment < len(law.breakpoints) and time.overlaps(edge):
        if not all(one == other for one, other in zip(*law.data[segment : segment + 2], strict=True)):
            break
        words = f"; the law is the same on both sides of the breakpoint at {seconds(edge)}"
        segment += 1
        edge = law.edges[segment]
    if edge is None:
        return f"the arc follows the last breakpoint{words}", None
    left = edge - time
    if left < 0:
        raise Refuted(f"the arc ends {(-left).str(6)} s after its segment of the control law, at {seconds(edge)}")
    if not left > 0:
        raise NotProved(f"the arc may end after its segment of the control law, at {seconds(edge)}")
    return f"the arc ends before its segment of the control law, at {seconds(edge)}{words}", left.lower()


def seconds(time: arb) -> str:
    """A time and its unit, printed with the digits of a double."""
    return f"{float(time.mid())!r} s"


def _mode_at_rest(orbit: Orbit, j: int, y: Sequence[arb]) -> tuple[str, arb | None]:
    """Claim 4: of all modes, only that of the arc is consistent for a foot at rest."""
    arc, table = orbit.arcs[j], orbit.system.transitions
    margins = {
        mode: dict(zip(table.margin_names(mode), orbit.field(mode, j).margins(y)[0], strict=True)) for mode in CONTACTS
    }
    cones = dict(zip(SLIPS, (margins[Mode.STICK][name] for name in CONES), strict=True))
    # f_n of a slip times its apparent mass is C_tt f_n - C_nt f_t of sticking, which is negative where the foot lifts
    needed = {f"no lift-off in {slip}": margins[slip]["normal_force"] * margins[slip]["painleve"] for slip in SLIPS}
    needed |= {name: cones[slip] for name, slip in zip(CONES, SLIPS, strict=True) if slip is not arc.mode}
    words = "the foot sticks: its force lies within the cone"
    if arc.mode.slips:
        words = "the force that would hold the foot leaves the cone here, on the side of this slip alone"
    if orbit.sequence.starts_from_rest(arc.phase):  # at the edge of the cone this margin is zero
        needed["onset"] = -cones[arc.mode]
        words = "holding the foot would need a force beyond the cone, on the side of this slip alone"
    return words, _all_positive(needed)


def _impact(orbit: Orbit, mode: Mode, j: int, y: Sequence[arb]) -> tuple[str, arb | None]:
    """Claim 7: the impact is consistent, no other one is, and the former stance foot lifts."""
    smallest_margin = _all_positive(_impact_margins(orbit, mode, j, y))
    for other in CONTACTS:
        # under the frictionless law an impact that sticks takes precedence over one that slips
        if other is not mode and not (mode.sticks and orbit.system.law is ImpactLaw.FRICTIONLESS):
            margins = _impact_margins(orbit, other, j, y)
            if not any(margin < 0 for margin in margins.values()):
                shown = ", ".join(f"{name} {margin.str(6)}" for name, margin in margins.items())
                raise NotProved(f"an impact with {other} is not shown to be inconsistent: {shown}")
    precedes = orbit.system.friction.may_drop or orbit.system.law is ImpactLaw.FRICTIONLESS
    first = " where sticking takes precedence" if mode.sticks and precedes else ""
    return f"{mode} is the only consistent impact{first}, and the former stance foot lifts", smallest_margin


def _impact_margins(orbit: Orbit, mode: Mode, j: int, y: Sequence[arb]) -> dict[str, arb]:
    """The margins that have to be positive for an impact to be consistent."""
    struck, table = orbit.system.walker.swapped(mode), orbit.system.transitions
    names = table.impact_margin_names(struck, orbit.arcs[j].mode)
    return dict(zip(names, orbit.impact(mode, j)(y)[0], strict=True))


def _all_positive(needed: Mapping[str, arb]) -> arb:
    """The smallest lower bound of values that all have to be positive.

    Raises
    ------
    NotProved
        If one is not shown to be positive; ``Refuted`` if it is negative.
    """
    for name, value in needed.items():
        if value < 0:
            raise Refuted(f"{name} is {value.str(6)}, not positive", name if name in MARGINS else "")
        if not value > 0:
            raise NotProved(f"{name} is {value.str(6)}, not shown to be positive")
    return min(value.lower() for value in needed.values())


def measure_bounds(orbit: Orbit, cycle: CycleEnclosure, period: arb) -> dict[str, arb | None]:
    """Bounds of the measures of every gait in the box, by the names of a gait's record."""
    work, forces = arb(0), list[tuple[list[arb], list[arb], arb, arb]]()
    for j, arc in enumerate(orbit.arcs):
        observation = orbit.field(arc.mode, j).observation
        along = [step.along(observation) for step in cycle.steps[j]]
        starts = [(f_t[0], f_n[0]) for f_t, f_n, _ in along]
        ends = [*starts[1:], tuple(map(hull, observation(cycle.ends[j])[0][:2]))]
        for step, (f_t, f_n, power), end in zip(cycle.steps[j], along, ends, strict=True):
            work += evaluate([arb(0), *(c / (k + 1) for k, c in enumerate(power))], hull(step.h))
            if arc.mode.sticks:
                forces.append((f_t, f_n, hull(step.h), abs(end[0] / end[1])))
    length = arb(0)
    for k, impact in enumerate(orbit.sequence.impacts):
        j = orbit.arcs_of(k)[-1]
        length += orbit.impact(impact, j)(cycle.ends[j])[1][orbit.system.n_shape]
    weight = BallFunction(orbit.system.weight, [])(orbit.p)[0][0]
    return {
        "period": period,
        "step_length": length,
        "speed": length / period,
        "work": work,
        "cost_of_transport": work / (weight * length),
        "required_friction": largest_force_ratio(forces) if forces else None,
    }


def largest_force_ratio(steps: Iterable[tuple[Sequence[arb], Sequence[arb], arb, arb]]) -> arb:
    """The maximum of |f_t| / f_n, with f_n > 0, over steps of the integration.

    If the ratio is monotone on a part of a step, its maximum is at one of the ends. Otherwise the mean value theorem
    bounds it, or the part is halved.

    Parameters
    ----------
    steps : f_t and f_n as polynomials in time, the length of the step [s], and the ratio at its end.
    """
    lower, upper = arb(0), arb(0)
    for f_t, f_n, h, at_end in steps:
        lower, pending = max(lower, at_end.lower()), [(arb(0), arb(h.upper()), MOST_HALVINGS)]
        while pending:
            start, end, depth = pending.pop()
            first, last = (abs(evaluate(f_t, t) / evaluate(f_n, t)) if t < h else at_end for t in (start, end))
            lower = max(lower, first.lower() if first.is_finite() else lower)
            t = start.union(end)
            force, normal = evaluate(f_t, t), evaluate(f_n, t)
            slope = (evaluate(derivative(f_t), t) * normal - force * evaluate(derivative(f_n), t)) / normal**2
            bound = max(first.upper(), last.upper())
            if not (slope > 0 or slope < 0):
                bound = (first + abs(slope) * (end - start)).upper()
            if not (normal > 0 and bound.is_finite()):
                bound = arb("inf")
            if bound <= lower:
                continue
            if depth and not bound <= lower * (1 + RELATIVE_WIDTH):
                middle = ((start + end) / 2).mid()
                pending += [(middle, end, depth - 1), (start, middle, depth - 1)]
            else:
                upper = max(upper, bound)
    return lower.union(max(lower, upper))
