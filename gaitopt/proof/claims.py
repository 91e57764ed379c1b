"""The claims that make a periodic orbit a gait with a given mode sequence, and bounds of the gait's measures.

The claims are numbers 2 to 7 of docs/developer/theorem.md; they hold for all orbits in the proved box. Margins have to
be positive on whole arcs. Each arc is divided in time until its margins have one kind on every interval, written as a
letter:

    p  positive      n  negative      u  rising      d  falling      ?  none of these is shown

A claim on an arc is a pattern of letters: ``p+`` positive throughout; ``p*d+`` positive, then falling to the zero at
the end; ``n*u*p+d+`` a touchdown, the first fall to zero after positive values. If a function starts with a zero of
known order k, its sign just after the start is that of its series divided by t^k.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, groupby
from typing import Any

from casadi import SX, depends_on, is_equal, jtimes, substitute, vertcat, vertsplit
from flint import arb, arb_poly

from gaitopt.building import built_once
from gaitopt.model.contacts import sharing_contacts
from gaitopt.model.cycle import BREAKPOINT, Cycle
from gaitopt.model.friction import Friction, ImpactLaw
from gaitopt.model.modes import CONTACTS, FOOT, OFF, Mode
from gaitopt.model.section import CLOCK, Section
from gaitopt.model.section import TOUCHDOWN as TOUCHDOWN_END
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import CONE, GROUND_FORCES, MARGINS, contact_of, is_held, kind
from gaitopt.proof.arithmetic import BallFunction, NotProved, Refuted, hull
from gaitopt.proof.identities import dependent_contacts, is_possible, modes_of_contacts, vanishes_identically
from gaitopt.proof.law import ExactLaw
from gaitopt.proof.orbit import CycleEnclosure, Orbit, OrbitArc
from gaitopt.proof.taylor import TaylorStep, compose, derivative, evaluate, taylor_coefficients

POSITIVE, ENDS, TOUCHDOWN, FLIGHT = "p+", "p*d+", "n*u*p+d+", "p+d+"
PREDICATES = {
    POSITIVE: "is positive throughout",
    ENDS: "is positive and falls monotonically to its zero at the end",
    TOUCHDOWN: "falls to zero for the first time after positive values at the end of the step",
    FLIGHT: "is positive from take-off until it falls to zero at the end of the step",
}
MOST_HALVINGS = 14
"""A step of the integration is halved at most this many times; an interval that then has no kind fails its claim."""
COMPARISON_DEPTH = 30
"""Depth to which the expression of a margin is compared with that of a condition."""
MOST_REFINEMENTS = 6
"""A step of the integration is replaced by two shorter ones at most this many times in a row, where the remainder of a
function along it is too wide."""
NOW = arb(0)
RELATIVE_WIDTH = 1e-12
"""An interval is not divided further once its upper bound exceeds the known maximum by less than this fraction."""
SLIPS, CONES = (Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD), ("cone_forward", "cone_backward")
APPARENT_MASS, UNIQUE_FORCES, TIME_WINDOW, AT_REST = "apparent mass", "unique forces", "time window", "mode at rest"
IMPACT, SECTION, LANDS = "impact", "section", "touchdown"
REGULARITIES = ("impact_painleve", "impact_regularity")
"""Margins of an impact whose impulses may not be unique."""


@dataclass(frozen=True, slots=True)
class ProofClaim:
    """One statement of the theorem.

    Attributes
    ----------
    name : the name of the claim: which arc or step it concerns, and which margin.
    finding : what is proved, or why the claim is not.
    margin : proved lower bound of the quantity that has to be positive, if there is one.
    refuted : whether the contrary is proved.
    violated : the margin that is proved to be negative, if it is a single one.
    """

    name: str
    proved: bool
    finding: str
    margin: arb | None = None
    refuted: bool = False
    violated: str = ""


@dataclass(frozen=True, slots=True)
class SignInterval:
    """A time interval of an arc on which a function has one kind.

    Attributes
    ----------
    kind : ``p``, ``n``, ``u``, ``d`` or ``?``.
    start, end : time since the start of the arc [s].
    value : enclosure of the function on the interval, divided by t^order.
    order : order of the zero at the start of the interval; 0 if there is none.
    within : whether the whole interval certainly lies before the end of the arc, whose time is only enclosed.
    """

    kind: str
    start: arb
    end: arb
    value: arb
    order: int
    within: bool


def sign_intervals(
    steps: Iterable[tuple[Sequence[arb], arb]], order: int = 0, *, monotone: bool = True, start_of_step: arb = NOW
) -> Iterator[SignInterval]:
    """Divide an arc into intervals on which a function has one kind, in order of time.

    Parameters
    ----------
    steps : the function on every step, and the length of the step [s].
    order : order of the zero with which the function starts; 0 if it starts with another value.
    monotone : whether an interval may be classified as ``u`` or ``d``; if not, it is divided until its sign is known.
    start_of_step : time of the first step since the start of the arc [s].
    """
    for k, (series, h) in enumerate(steps):
        # the length of the step is a ball; the intervals cover it up to its upper bound
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
                times, within = (start_of_step + start, start_of_step + end), bool(end <= h.lower())
                yield SignInterval(kind, *times, value, zero, within)
        start_of_step += h.mid()


def check_pattern(name: str, intervals: Sequence[SignInterval], pattern: str) -> str:
    """The kinds of all intervals as letters with counts (``p7 d2``), if they match a pattern.

    Raises
    ------
    NotProved
        If the intervals do not match the pattern; the message says where, and which values the function may have there.
    Refuted
        If the function is negative where it has to be positive.
    """
    kinds = "".join(interval.kind for interval in intervals)
    if not re.fullmatch(pattern, kinds):
        negative = [] if pattern == TOUCHDOWN else [each for each in intervals if each.kind == "n" and each.within]
        matching = max(k for k in range(len(kinds) + 1) if re.fullmatch(pattern.replace("+", "*"), kinds[:k]))
        first_mismatch = intervals[min(matching, len(intervals) - 1)]
        worst = min(negative, key=lambda interval: interval.value.upper(), default=first_mismatch)
        when = f"between {float(worst.start):.6g} and {float(worst.end):.6g} s of the arc"
        finding = f"{name} is {worst.value.str(6)} {when}: that it {PREDICATES[pattern]} is"
        if negative:
            raise Refuted(f"{finding} false", name)
        raise NotProved(f"{finding} not shown")
    return " ".join(f"{kind}{len(list(group))}" for kind, group in groupby(kinds))


def mode_claim_names(system: HybridSystem, law: ExactLaw, sequence: Cycle, arcs: Sequence[OrbitArc]) -> tuple[str, ...]:
    """The names of all claims that are required for an orbit to be a gait with this mode sequence.

    This list does not rely on ``mode_sequence_claims``. A claim that the latter forgets therefore leaves the theorem
    unproved.
    """
    names, ends, windows = list[str](), list[str](), bool(law.breakpoints) or law.horizon is not None
    alone, section = system.walker.stands_on_one(), _section_margin(system)
    rows = [system.transitions.ending(sequence, arc.phase) if arc.ends_phase else None for arc in arcs]
    landings = [alone and row is not None and row.reset is not None and row.reset.swaps for row in rows]
    for j, (arc, lands) in enumerate(zip(arcs, landings, strict=True)):
        rising = {section, LANDS} if any(landings) else {section}
        of_arc = [name for name in system.transitions.margin_names(arc.mode) if name not in rising]
        of_arc += [APPARENT_MASS] if alone and arc.mode.sticks and not system.walker.massless_feet else []
        of_arc += [UNIQUE_FORCES] if not alone and arc.mode.touching else []
        of_arc += [TIME_WINDOW] if windows else []
        of_arc += [AT_REST] if _starts_at_rest(system, sequence, arcs, j) else []
        struck = system.transitions.struck(sequence, arc.phase) if arc.ends_phase else None
        of_end = [LANDS] if lands else []
        if arc.ends_phase and sequence.after(arc.phase) is None:
            of_end += [section] if section else []
            of_end += [IMPACT] if system.cycle_end == TOUCHDOWN_END else []
            prefix = f"step {sequence.step_of(arc.phase) + 1}, " if len(sequence.steps) > 1 else ""
            ends += [f"{prefix}{name}" for name in of_end]
        else:
            of_end += [IMPACT] if struck is not None and system.transitions.of_impact(struck, arc.mode) else []
            of_arc += of_end
        names += [f"arc {j + 1}, {arc.mode}: {name}" for name in of_arc]
    return (*names, *ends, *([SECTION] if system.section(sequence).solved else []))


def _section_margin(system: HybridSystem) -> str:
    """The margin that ends a cycle when it falls to zero; empty if a landing or the clock does."""
    return "" if system.cycle_end in (TOUCHDOWN_END, CLOCK) else system.cycle_end


def mode_sequence_claims(orbit: Orbit, cycle: CycleEnclosure) -> Iterator[ProofClaim]:
    """Prove or refute the mode sequence: margins on every arc, unique modes, touchdowns, impacts."""
    system, sequence = orbit.system, orbit.sequence
    windows, alone = bool(orbit.law.breakpoints) or orbit.law.horizon is not None, system.walker.stands_on_one()
    section, signs = _section_margin(system), [_margin_signs(orbit, cycle, j) for j in range(len(orbit.arcs))]
    for j, arc in enumerate(orbit.arcs):
        y_end, title = cycle.ends[j], f"arc {j + 1}, {arc.mode}"
        margins_at_end = orbit.field(arc.mode, j).margins(y_end)[0]
        for (name, intervals), at_end in zip(signs[j].items(), margins_at_end, strict=True):
            if name not in _rising(orbit):
                pattern = ENDS if name in arc.zeros else POSITIVE
                yield _claim(f"{title}: {name}", _margin, name, intervals, pattern, at_end)
        if alone and arc.mode.sticks and not system.walker.massless_feet:
            yield _claim(f"{title}: {APPARENT_MASS}", _apparent_mass, orbit, cycle, j)
        if not alone and arc.mode.touching:
            yield _claim(f"{title}: {UNIQUE_FORCES}", _unique_forces, orbit, cycle, j)
        if windows:
            yield _claim(f"{title}: {TIME_WINDOW}", _time_window, orbit, j, y_end)
        if _starts_at_rest(system, sequence, orbit.arcs, j):
            yield _claim(f"{title}: {AT_REST}", _mode_at_rest, orbit, j, cycle.starts[j])
        before_end = f"{title}: "
        if orbit.ends_step(j):
            before_end = f"step {orbit.step(j) + 1}, " if len(sequence.steps) > 1 else ""
        if alone and orbit.swaps(j):
            swing = [i for i in orbit.swing(j) if system.transitions.may_land(orbit.arcs[i].mode)]
            intervals = [*chain(*(signs[i].get(LANDS, []) for i in swing))]
            takes_off = (
                system.walker.flies and intervals[0].order and _vanishes_on_ground(system, orbit.arcs[swing[0]].mode)
            )
            pattern = FLIGHT if takes_off else TOUCHDOWN
            yield _claim(f"{before_end}{LANDS}", _margin, LANDS, intervals, pattern, arb(0))
        if section and orbit.ends_step(j):
            intervals = list[SignInterval]()
            for i in orbit.arcs_of(orbit.step(j)):
                intervals += signs[i][section] if i == j else _before_jump(orbit, cycle, i, section, signs[i][section])
            yield _claim(f"{before_end}{section}", _margin, section, intervals, TOUCHDOWN, arb(0))
        if orbit.struck(j) is not None:
            yield _claim(f"{before_end}{IMPACT}", _impact, orbit, j, y_end)
    if orbit.solved:
        yield _claim(SECTION, _section, orbit, cycle)


def _claim(name: str, prove: Callable[..., tuple[str, arb | None]], *arguments: Any) -> ProofClaim:
    """The claim of this name: proved if ``prove`` succeeds on the arguments, with the reason if it fails."""
    try:
        finding, margin = prove(*arguments)
    except NotProved as failure:
        violated = failure.margin if isinstance(failure, Refuted) else ""
        return ProofClaim(
            name, proved=False, finding=str(failure), refuted=isinstance(failure, Refuted), violated=violated
        )
    return ProofClaim(name, proved=True, finding=finding, margin=margin)


def _rising(orbit: Orbit) -> tuple[str, ...]:
    """The margins that may start below zero, and end a swing or a cycle when they fall to zero after positive values.

    They are the margin that ends the cycle, and that of the swing foot if it lands.
    """
    lands = orbit.system.walker.stands_on_one() and any(orbit.swaps(j) for j in range(len(orbit.arcs)))
    return (_section_margin(orbit.system), LANDS) if lands else (_section_margin(orbit.system),)


def _before_jump(
    orbit: Orbit, cycle: CycleEnclosure, j: int, name: str, intervals: Sequence[SignInterval]
) -> list[SignInterval]:
    """The signs of a margin along an arc, and the sign with which it ends if an impact follows, where it may jump.

    Without that sign, a fall to zero just before the jump and the one at the end of the cycle would look like one fall.
    """
    if not orbit.arcs[j].ends_phase or orbit.sequence.reset_after(orbit.arcs[j].phase) is None:
        return [*intervals]
    margins = orbit.field(orbit.arcs[j].mode, j).margins(cycle.ends[j])[0]
    value = margins[orbit.system.transitions.margin_names(orbit.arcs[j].mode).index(name)]
    sign, monotone = ("p", "d") if value > 0 else ("n", "u") if value < 0 else ("?", "")
    known = [*intervals, replace(intervals[-1], kind=sign, value=value, order=0)]
    # a margin that falls to a positive value, or rises to a negative one, has the sign of this value
    for k in range(len(intervals) - 1, -1, -1):
        if intervals[k].kind != monotone:
            break
        known[k] = known[-1]
    return known


def _starts_phase(arcs: Sequence[OrbitArc], j: int) -> bool:
    """Whether arc ``j`` is the first one of its phase; the others follow a breakpoint."""
    return j == 0 or arcs[j - 1].phase != arcs[j].phase


def _starts_at_rest(system: HybridSystem, sequence: Cycle, arcs: Sequence[OrbitArc], j: int) -> bool:
    """Whether arc ``j`` starts a phase with a foot at rest that stands alone and has a mass.

    Any phase does but one after an impact with slip, and a flight that the fall of the normal force to zero, without a
    drag or a spring that ends, or the impact of a stop explains. With one coefficient, forces of several contacts are
    unique at all times; with two, they are unless a contact at rest begins to slip or leaves the ground.
    """
    mode, impact, before = arcs[j].mode, sequence.impact_before(arcs[j].phase), arcs[j - 1]
    if not system.walker.stands_on_one():
        released = _begun_slips(system, sequence, arcs[j]) | _released(system, sequence, arcs, j)
        return bool(_starts_phase(arcs, j) and system.friction.may_drop and released)
    if not mode.touching:
        touches, struck = before.mode.touching or before.event == LANDS, impact is not None and not impact.swaps
        springs = system.expressions.eom.mechanism.potential_while
        jumps = before.mode.slips and isinstance(system.friction, Friction) and system.friction.viscous is not None
        jumps |= not system.walker.massless_feet and any(before.mode.has(name) != mode.has(name) for name in springs)
        explained = struck or (before.event == "normal_force" and not jumps)
        return bool(_starts_phase(arcs, j) and touches and not explained)
    rests = impact is None or impact.contact is Mode.STICK
    return bool(not system.walker.massless_feet and mode.touching and _starts_phase(arcs, j) and rests)


def _begun_slips(system: HybridSystem, sequence: Cycle, arc: OrbitArc) -> set[str]:
    """The contacts of a phase that begin to slip from rest at its start."""
    slipping = (name for name, direction in arc.mode.directions.items() if direction)
    return {name for name in slipping if sequence.onset_order(arc.phase, name)}


def _released(system: HybridSystem, sequence: Cycle, arcs: Sequence[OrbitArc], j: int) -> set[str]:
    """The contacts at rest that leave the ground at the start of a phase, without an impact."""
    before, struck = arcs[j - 1], system.transitions.struck(sequence, arcs[j - 1].phase)
    if struck is not None and system.transitions.of_impact(struck, before.mode):
        return set()
    return {name for name in before.mode.touching if not before.mode.directions[name]} - {*arcs[j].mode.touching}


def _margin_signs(orbit: Orbit, cycle: CycleEnclosure, j: int) -> dict[str, list[SignInterval]]:
    """The signs of all margins of the mode along arc ``j``, by name."""
    arc, margins = orbit.arcs[j], orbit.field(orbit.arcs[j].mode, j).margins
    names, starts_phase = orbit.system.transitions.margin_names(arc.mode), _starts_phase(orbit.arcs, j)
    orders = list[int]()
    for name, series in zip(names, cycle.steps[j][0].along(margins), strict=True):
        orders.append(_order_of_zero(orbit, j, name, series[0]) if starts_phase else 0)
        if not all(c.contains(0) for c in series[: orders[-1]]) or orders[-1] >= len(series):
            raise NotProved(f"{name} does not start arc {j + 1} with a zero of order {orders[-1]}")
    monotone = [name in _rising(orbit) or name in arc.zeros for name in names]
    return dict(zip(names, _signs(cycle.steps[j], lambda step: step.along(margins), orders, monotone), strict=True))


def _signs(
    steps: Iterable[TaylorStep],
    functions: Callable[[TaylorStep], list[list[arb]]],
    orders: Sequence[int] = (),
    monotone: Sequence[bool] = (),
) -> list[list[SignInterval]]:
    """The signs of functions along an arc. A step is divided where the remainder of a function is too wide.

    Parameters
    ----------
    functions : the functions along a step, as polynomials in time.
    orders, monotone : see ``sign_intervals``, for each function; none starts with a zero, and none may be monotone.
    """
    by_step, start = list[list[list[SignInterval]]](), NOW
    pending = [(step, MOST_REFINEMENTS) for step in [*steps][::-1]]
    while pending:
        (step, depth), of_step = pending.pop(), list[list[SignInterval]]()
        for k, values in enumerate(functions(step)):
            order, either = orders[k] if orders and start.is_zero() else 0, bool(monotone and monotone[k])
            of_step.append([*sign_intervals([(values, hull(step.h))], order, monotone=either, start_of_step=start)])
        if depth and any(each.kind == "?" for intervals in of_step for each in intervals):
            pending += [(half, depth - 1) for half in reversed(step.halves())]
            continue
        by_step.append(of_step)
        start += hull(step.h).mid()
    return [[*chain(*intervals)] for intervals in zip(*by_step, strict=True)]


def _order_of_zero(orbit: Orbit, j: int, name: str, start: arb) -> int:
    """The order of the zero with which a margin starts in arc ``j``; 0 if it has none.

    A slip starts from rest. If it starts at the edge of the cone its acceleration is zero too, because the acceleration
    is minus the cone's margin over the apparent mass, or because the forces with and without slip are the same there.
    The height of a contact that leaves the ground is zero. Its velocity is zero too unless it leaves in an impact, and
    its acceleration if its normal force falls to zero. In both cases forces must not jump: no other contact, stop or
    switch changes, and the contact that leaves loses neither a drag nor a spring. After an impact that ends a step the
    other foot is on the ground, and released stops are still closed. The forces of a massless foot that lands are zero.

    Parameters
    ----------
    start : enclosure of the margin at the start of the arc.
    """
    system, sequence, phase = orbit.system, orbit.sequence, orbit.arcs[j].phase
    before, what, contact = orbit.arcs[j - 1], kind(name), contact_of(name)
    event, mode = (kind(before.event), contact_of(before.event)), orbit.arcs[j].mode
    leaving = 1 if orbit.struck(j - 1) is not None else 3 if event == ("normal_force", contact) else 2
    if leaving == 3 and _jumps_when_leaving(orbit, before.mode, mode, contact):
        leaving = 2
    if what == "slip_velocity":
        drops, (static, kinetic, _) = (
            _friction_of(system, contact).may_drop,
            system.contact_coefficients(orbit.p)[contact],
        )
        if drops and not static > kinetic:
            raise NotProved("static friction is not above kinetic friction: state one coefficient")
        at_edge = event == (CONE[Mode(mode.contacts[contact])], contact)
        is_gentle = at_edge and _changes_alone(before.mode, mode, contact)
        return min(sequence.onset_order(phase, contact, jump=drops), 2 if is_gentle else 1)
    if name in system.transitions.zeros_after(sequence, before.phase):
        return 1
    if name == _section_margin(system):
        return int(phase == 0)
    if what == "gap":
        touched = system.walker.swapped(before.mode) if orbit.swaps(j - 1) else before.mode
        return 0 if start > 0 or contact not in touched.touching else leaving
    if name == "touchdown" and before.mode.touching and not orbit.arcs[j].mode.touching:
        return leaving if start.contains(0) and _vanishes_on_ground(system, orbit.arcs[j].mode) else 0
    after_impact = orbit.swaps(j - 1) and system.walker.stands_on_one()
    if name == "clearance" and after_impact:
        return int(start.contains(0))
    if after_impact and not is_held(name) and orbit.section.stated and not orbit.section.is_explicit:
        return int(_is_condition(system, orbit.section, orbit.arcs[j].mode, name))
    return zeros_after_impact(system, orbit.arcs[j].mode, name) if after_impact and not is_held(name) else 0


def _friction_of(system: HybridSystem, contact: str) -> Friction:
    law = system.friction
    return law if isinstance(law, Friction) else dict(law.laws)[contact]


def _changes_alone(before: Mode, after: Mode, contact: str) -> bool:
    """Whether two modes differ in the state of one contact only."""
    return after.with_states({contact: before.contacts[contact]}) is before


def _jumps_when_leaving(orbit: Orbit, before: Mode, after: Mode, contact: str) -> bool:
    """Whether forces may jump where a contact leaves the ground because its normal force falls to zero."""
    springs = orbit.system.expressions.eom.mechanism.potential_while
    *_, viscous = orbit.system.contact_coefficients(orbit.p)[contact]
    return (
        not _changes_alone(before, after, contact)
        or bool(before.directions[contact] and not arb(viscous).is_zero())
        or any(before.has(name) != after.has(name) for name in springs)
    )


@built_once(maxsize=128)
def zeros_after_impact(system: HybridSystem, mode: Mode, name: str) -> int:
    """How many of a margin and its rate are identically zero just after an impact of the foot that ends a step.

    A function of the coordinates has no rate.
    """
    xi, p, z = SX.sym("xi", system.lift.size1_in(0)), SX.sym("p", len(system.parameters)), SX.sym("z", system.n_z)
    x, after = SX.sym("x"), system.lift(xi, p)
    after[system.n_shape] = x  # a landing within the cycle may be anywhere
    index = system.transitions.margin_names(mode).index(name)
    value, n = system.margins(mode)(0, z, p, SX.zeros(system.n_r))[index], system.n_z // 2

    def vanishes(expression: SX) -> bool:
        return vanishes_identically(substitute(expression, z, after), vertcat(xi, p, x))

    if not vanishes(value):
        return 0
    is_of_rates = depends_on(value, z[n:])
    return 1 if is_of_rates or not vanishes(jtimes(value, z[:n], z[n:])) else 2


@built_once(maxsize=16)
def _is_condition(system: HybridSystem, section: Section, mode: Mode, name: str) -> bool:
    """Whether a margin is, up to its sign, one of the conditions of a section, which are zero after an impact."""
    z, p = SX.sym("z", system.n_z), SX.sym("p", len(system.parameters))
    value = system.margins(mode)(0, z, p, SX.zeros(system.n_r))[system.transitions.margin_names(mode).index(name)]
    conditions = vertsplit(section.conditions(z, p[: len(system.walker.model_fields)]))
    return any(is_equal(own, c, COMPARISON_DEPTH) for c in conditions for own in (value, -value))


@built_once(maxsize=16)
def _vanishes_on_ground(system: HybridSystem, mode: Mode) -> bool:
    """Whether the margin of touchdown is identically zero where the base point is on the ground."""
    z, p = SX.sym("z", system.n_z), SX.sym("p", len(system.parameters))
    index = system.transitions.margin_names(mode).index("touchdown")
    margins = system.margins(mode)(0, z, p, SX.zeros(system.n_r))
    if "y" not in system.state_names:
        return False
    return vanishes_identically(substitute(margins[index], z[system.state_names.index("y")], 0), vertcat(z, p))


def _margin(name: str, intervals: Sequence[SignInterval], pattern: str, at_end: arb) -> tuple[str, arb | None]:
    """Claims 2 and 6: a margin is positive along an arc, falls to the zero that ends it, or shows a touchdown."""
    if pattern == POSITIVE and at_end < 0:
        raise Refuted(f"{name} is {at_end.str(6)} at the end of the arc", name)
    kinds = check_pattern(name, intervals, pattern)
    order = max(interval.order for interval in intervals)
    zero = f", after a zero of order {order} at its start" if order else ""
    bounds = (each.value.lower() for each in intervals if each.kind == "p" and not each.order)
    return f"{name} {PREDICATES[pattern]}{zero} ({kinds})", min(bounds, default=None)


def _apparent_mass(orbit: Orbit, cycle: CycleEnclosure, j: int) -> tuple[str, arb | None]:
    """Claim 3: while the foot sticks, its apparent mass C_tt +- mu C_nt is positive with the static coefficient mu.

    Without the sticking force f the foot would have the normal acceleration -(C_tt f_n - C_nt f_t) / det C. This is
    negative for every f in the static cone, so lift-off is not consistent. The apparent masses with the kinetic
    coefficient lie between those with the static one. A slip from rest accelerates the foot by minus the margin of the
    kinetic cone over the apparent mass, so no slip is consistent inside this cone. Between the kinetic and the static
    cone a slip is consistent too; the model chooses sticking there.

    With one coefficient it is enough that C_tt f_n - C_nt f_t, the mean of both apparent masses times the opposite
    margins of the cone, is positive for the force of the orbit. It is also the normal force of a slip times the
    apparent mass: where this mass is negative, the ground would have to pull a foot that slips.
    """
    system, arc = orbit.system, orbit.arcs[j]
    field, names = orbit.field(arc.mode, j), system.transitions.margin_names(arc.mode)

    def masses(step: TaylorStep) -> list[list[arb]]:
        return step.along(field.apparent_masses)

    def load(step: TaylorStep) -> list[list[arb]]:
        edges = step.along(field.margins)
        products = zip(masses(step), (edges[names.index(cone)] for cone in reversed(CONES)), strict=True)
        return [sum((arb_poly(mass) * arb_poly(edge) for mass, edge in products), arb_poly([0])).coeffs()]

    try:
        return (
            "the apparent mass of the foot is positive throughout, with the static coefficient in either direction",
            _smallest(cycle.steps[j], masses, "painleve"),
        )
    except NotProved:
        if system.friction.may_drop:
            raise
    _smallest(cycle.steps[j], load, "painleve")
    return (
        "a foot that is let go would sink, and where its apparent mass is negative a slip would pull the ground",
        None,
    )


def _smallest(steps: Iterable[TaylorStep], functions: Callable[[TaylorStep], list[list[arb]]], name: str) -> arb:
    """The smallest lower bound of functions on the steps of an arc, which all have to be positive.

    Parameters
    ----------
    functions : the functions along a step, as polynomials in time.
    """
    bounds = list[arb]()
    for intervals in _signs(steps, functions):
        check_pattern(name, intervals, POSITIVE)
        bounds += [interval.value.lower() for interval in intervals]
    return min(bounds)


def _unique_forces(orbit: Orbit, cycle: CycleEnclosure, j: int) -> tuple[str, arb | None]:
    """Claim 3 of several contacts: the forces in every mode of the contacts on the ground are unique, so is the mode.

    Accelerations, friction and normal forces obey a piecewise linear equation, with one piece for each mode. Its pieces
    have determinants of one sign if the regularity of every mode is positive, with any coefficients between zero and
    those of the contacts. The determinant is linear in each coefficient, so that the corners suffice, and these are
    modes too. The degree of the equation is then that of the one without friction, which is one, and every force has
    exactly one solution: no other mode is consistent with the same state.
    """
    field = orbit.field(orbit.arcs[j].mode, j)
    smallest = _smallest(cycle.steps[j], lambda step: step.along(field.regularities), "regularity")
    return "the contact forces are unique in every mode of the contacts on the ground", smallest


def _section(orbit: Orbit, cycle: CycleEnclosure) -> tuple[str, arb | None]:
    """Closed heights: the orbit satisfies the conditions of its section exactly; see ``Orbit.require_section``."""
    orbit.require_section(cycle)
    return "the conditions of the section are exactly zero at the start of the cycle", None


def _time_window(orbit: Orbit, j: int, y: Sequence[arb]) -> tuple[str, arb | None]:
    """Claim 5: an arc ends before the segment of its control law does.

    That it starts after its segment starts needs no claim: the number of its segment is the number of breakpoints at
    which arcs of this step have ended (``statement``), durations are positive, and a breakpoint sets the time exactly.
    """
    arc, law = orbit.arcs[j], orbit.law
    edge, time, segment, continuity = law.edges[arc.segment], y[orbit.system.n_z], arc.segment, ""
    if arc.event == BREAKPOINT and edge is not None:
        return f"the arc ends with the breakpoint at {seconds(edge)}", None
    if arc.event == CLOCK and segment == len(law.breakpoints):
        return f"the arc ends with the period of the control law at {seconds(law.period or time)}", None
    while edge is not None and segment < len(law.breakpoints) and time.overlaps(edge):
        if not all(one == other for one, other in zip(*law.data[segment : segment + 2], strict=True)):
            break
        continuity = f"; the law is the same on both sides of the breakpoint at {seconds(edge)}"
        segment += 1
        edge = law.edges[segment]
    if edge is None:
        return f"the arc follows the last breakpoint{continuity}", None
    left = edge - time
    if left < 0:
        raise Refuted(f"the arc ends {(-left).str(6)} s after its segment of the control law, at {seconds(edge)}")
    if not left > 0:
        raise NotProved(f"the arc may end after its segment of the control law, at {seconds(edge)}")
    return f"the arc ends before its segment of the control law, at {seconds(edge)}{continuity}", left.lower()


def seconds(time: arb) -> str:
    """A time and its unit, printed with the digits of a double."""
    return f"{float(time.mid())!r} s"


def _mode_at_rest(orbit: Orbit, j: int, y: Sequence[arb]) -> tuple[str, arb | None]:
    """Claim 4: of all modes, only that of the arc is consistent for a foot at rest."""
    if not orbit.system.walker.stands_on_one():
        return _most_contacts_stick(orbit, j, y)
    arc, table = orbit.arcs[j], orbit.system.transitions
    if not arc.mode.touching:
        return _let_go(orbit, j, y)
    modes = {contact: arc.mode.with_contact(contact) for contact in CONTACTS}
    margins = {
        contact: dict(zip(table.margin_names(mode), orbit.field(mode, j).margins(y)[0], strict=True))
        for contact, mode in modes.items()
    }
    cones = dict(zip(SLIPS, (margins[Mode.STICK][name] for name in CONES), strict=True))
    # f_n of a slip times its apparent mass is C_tt f_n - C_nt f_t of sticking, which is negative where the foot lifts
    needed = {f"no lift-off in {slip}": margins[slip]["normal_force"] * margins[slip]["painleve"] for slip in SLIPS}
    needed |= {name: cones[slip] for name, slip in zip(CONES, SLIPS, strict=True) if slip is not arc.mode.contact}
    finding = "the foot sticks: its force lies within the cone"
    if arc.mode.slips:
        finding = "the force that would hold the foot leaves the cone here, on the side of this slip alone"
    begins = arc.mode.slips and orbit.sequence.onset_order(arc.phase)
    if begins and orbit.arcs[j - 1].event != CONE[arc.mode.contact]:  # at the edge of the cone this margin is zero
        needed["onset"] = -cones[arc.mode.contact]
        finding = "holding the foot would need a force beyond the cone, on the side of this slip alone"
    return finding, _all_positive(needed)


def _let_go(orbit: Orbit, j: int, y: Sequence[arb]) -> tuple[str, arb | None]:
    """Claim 4 of a flight: a foot that is let go rises, and no mode in which it stays on the ground is consistent.

    With f the force that would hold the foot, it rises if C_tt f_n - C_nt f_t is negative. With positive apparent
    masses f is then outside of the static cone, and the normal force of every slip is negative. A massless foot has no
    inertia: the ground would have to pull it.
    """
    system, mode, before = orbit.system, orbit.arcs[j].mode, orbit.arcs[j - 1]
    if before.event == "normal_force" and not _jumps_when_leaving(orbit, before.mode, mode, FOOT):
        return "the normal force falls to zero, and the forces do not jump", None
    sticking = orbit.field(mode.with_contact(Mode.STICK), j)
    if system.walker.massless_feet:
        index = system.transitions.margin_names(sticking.mode).index("normal_force")
        return "the ground would have to pull the foot", _all_positive({"pull": -sticking.margins(y)[0][index]})
    rises = orbit.field(mode, j).rate(y)[0][system.state_names.index("dy")]
    masses = zip((f"apparent mass against {slip}" for slip in SLIPS), sticking.apparent_masses(y)[0], strict=True)
    finding = "a foot that is let go rises, and no force of the ground is consistent"
    return finding, _all_positive({"the normal acceleration of a foot that is let go": rises, **dict(masses)})


def _most_contacts_stick(orbit: Orbit, j: int, y: Sequence[arb]) -> tuple[str, None]:
    """Claim 4 of several contacts with two coefficients: no other mode in which as many contacts stick is consistent.

    Each of these modes has a force that is impossible, or accelerates a contact against its slip or into the ground.
    Two kinds need not be examined: modes in which the same contacts begin to slip, because the forces are unique; and,
    if the phase before ends at an edge of its cone, modes in which none does, because their forces are those of that
    phase, whose motion would leave the cone.
    """
    arc, before, system = orbit.arcs[j], orbit.arcs[j - 1], orbit.system
    begun, released = _begun_slips(system, orbit.sequence, arc), _released(system, orbit.sequence, orbit.arcs, j)
    stay = {name for name in arc.mode.touching if not arc.mode.directions[name]}
    resting, closed = begun | released | stay, arc.mode.with_states(dict.fromkeys(released, Mode.STICK))
    stuck = {name for name in before.mode.touching if not before.mode.directions[name]}
    at_edge = kind(before.event) in CONES and resting == stuck and before.mode.touching == arc.mode.touching
    for other in modes_of_contacts(system, closed):
        slips = {name for name in resting if name in other.touching and other.directions[name]}
        sticks = [name for name in resting if name in other.touching and not other.directions[name]]
        moves_on = all(
            other.contacts[name] in (arc.mode.contacts[name], OFF) for name in {*arc.mode.touching} - resting
        )
        if slips == begun or len(sticks) < len(stay) or not moves_on or not is_possible(system.walker, other):
            continue
        if not slips and at_edge:
            continue
        field = orbit.field(other, j)
        series = compose(field.margins, taylor_coefficients(field, y, 3))
        impossible = False
        for name, (force, rate, acceleration) in zip(system.transitions.margin_names(other), series, strict=True):
            what, contact = kind(name), contact_of(name)
            starts_wrongly = what == "slip_velocity" and contact in slips and rate < 0
            sinks = what == "gap" and contact in closed.touching and acceleration < 0
            impossible |= bool((what in GROUND_FORCES and force < 0) or starts_wrongly or sinks)
        if not impossible:
            raise NotProved(f"{other.brief}, in which as many contacts stick, is not shown to be inconsistent")
    names = " and ".join(sorted(begun | released))
    return f"no other mode is consistent in which as many contacts stick: {names} cannot", None


def _impact(orbit: Orbit, j: int, y: Sequence[arb]) -> tuple[str, arb | None]:
    """Claim 7: the impact that ends arc ``j`` is consistent, no other one is, and contacts that leave the ground lift.

    An impact without an impulse on a contact that comes down is no other one: the contact would go through the ground.
    """
    system, struck, before = orbit.system, orbit.struck(j), orbit.arcs[j].mode
    assert struck is not None
    walker, row = system.walker, system.transitions.ending(orbit.sequence, orbit.arcs[j].phase)
    landing = [name for name in struck.touching if name not in before.touching]
    needed = _impact_margins(orbit, struck, j, y)
    counts = dict(zip(walker.landing_points(), orbit.impact(struck, j)(y)[2], strict=True))
    smallest_margin = _all_positive({**needed, **{f"the landing of {name}": counts[name] for name in landing}})
    sticks_first = system.law is ImpactLaw.FRICTIONLESS or system.friction.may_drop
    names_after = (walker.swapped(mode.contact) if orbit.swaps(j) else mode for mode in row.candidates)
    for other in names_after:
        falls_through = not {*landing} <= {*other.touching}
        # under the frictionless law an impact that sticks takes precedence over one that slips
        precedes = struck.sticks and system.law is ImpactLaw.FRICTIONLESS and walker.stands_on_one()
        # with two coefficients an impact after which more contacts stick takes precedence
        precedes |= system.friction.may_drop and not walker.stands_on_one() and _sticking(other) < _sticking(struck)
        if other.contact is not struck.contact and not falls_through and not precedes and is_possible(walker, other):
            margins = _impact_margins(orbit, other, j, y)
            # a negative regularity does not show that the impulses of this impact are none
            if not any(margin < 0 for name, margin in margins.items() if kind(name) not in REGULARITIES):
                shown = ", ".join(f"{name} {margin.str(6)}" for name, margin in margins.items())
                raise NotProved(f"an impact with {_after(orbit, other, j)} is not shown to be inconsistent: {shown}")
    first = " where sticking takes precedence" if struck.sticks and sticks_first else ""
    lifts = ", and the former stance foot lifts" if orbit.swaps(j) and walker.stands_on_one() else ""
    return f"{_after(orbit, struck, j)} is the only consistent impact{first}{lifts}", smallest_margin


def _sticking(mode: Mode) -> int:
    return sum(not mode.directions[name] for name in mode.touching)


def _after(orbit: Orbit, struck: Mode, j: int) -> Mode:
    """The contacts just after an impact that ends arc ``j``, with the names that they have then."""
    return orbit.system.walker.swapped(struck.contact) if orbit.swaps(j) else struck


def _impact_margins(orbit: Orbit, struck: Mode, j: int, y: Sequence[arb]) -> dict[str, arb]:
    """The margins that have to be positive for an impact to be consistent.

    Raises
    ------
    NotProved
        If constraints of the impact are left out that are not shown to be dependent.
    """
    walker, before = orbit.system.walker, orbit.arcs[j].mode
    dependent_contacts(walker, walker.held_in_impact(struck, before))
    names = orbit.system.transitions.impact_margin_names(struck, before)
    return dict(zip(names, orbit.impact(struck, j)(y)[0], strict=True))


def _all_positive(needed: Mapping[str, arb]) -> arb:
    """The smallest lower bound of values that all have to be positive.

    Raises
    ------
    NotProved
        If one is not shown to be positive; ``Refuted`` if it is negative.
    """
    for name, value in needed.items():
        if value < 0:
            raise Refuted(f"{name} is {value.str(6)}, not positive", name if kind(name) in MARGINS else "")
        if not value > 0:
            raise NotProved(f"{name} is {value.str(6)}, not shown to be positive")
    return min(value.lower() for value in needed.values())


def measure_bounds(orbit: Orbit, cycle: CycleEnclosure, period: arb) -> dict[str, arb | None]:
    """Bounds of the measures of every gait in the box, by the names of a gait's record."""
    work, length, forces, walker = arb(0), arb(0), list[tuple[list[arb], list[arb], arb, arb]](), orbit.system.walker
    for j, arc in enumerate(orbit.arcs):
        observation = orbit.field(arc.mode, j).observation
        *along, power = zip(*(step.along(observation) for step in cycle.steps[j]), strict=True)
        for series, step in zip(power, cycle.steps[j], strict=True):
            work += evaluate([arb(0), *(c / (k + 1) for k, c in enumerate(series))], hull(step.h))
        at_end = [hull(value) for value in observation(cycle.ends[j])[0]]
        for names in sharing_contacts(walker, arc.mode):
            if arc.mode.directions[names[0]]:  # only contacts that stick require friction
                continue
            columns = [2 * walker.contact_names().index(name) for name in names]
            f_t, f_n = ([_sum(of_step) for of_step in zip(*(along[k + row] for k in columns), strict=True)]
                        for row in (0, 1))  # fmt: skip
            last = tuple(sum((at_end[k + row] for k in columns), arb(0)) for row in (0, 1))
            starts = [(t[0], n[0]) for t, n in zip(f_t, f_n, strict=True)]
            for t, n, step, end in zip(f_t, f_n, cycle.steps[j], [*starts[1:], last], strict=True):
                forces.append((t, n, hull(step.h), abs(end[0] / end[1])))
        struck, y = orbit.struck(j), cycle.ends[j]
        if struck and not {*struck.touching} <= {*arc.mode.touching}:
            work += orbit.impact(struck, j)(y)[3][0]
        if orbit.ends_step(j):
            length += orbit.impact(struck, j)(y)[1][orbit.system.n_shape] if struck else y[orbit.system.n_shape]
    weight = BallFunction(orbit.system.weight, [])(orbit.p)[0][0]
    ratio = largest_force_ratio(forces) if forces else None
    return {
        "period": period,
        "step_length": length,
        "speed": length / period,
        "work": work,
        "cost_of_transport": None if length.contains(0) else work / (weight * length),
        "required_friction": ratio if ratio is not None and ratio.is_finite() else None,
    }


def _sum(polynomials: Iterable[Sequence[arb]]) -> list[arb]:
    return [sum(coefficients, arb(0)) for coefficients in zip(*polynomials, strict=True)]


def largest_force_ratio(steps: Iterable[tuple[Sequence[arb], Sequence[arb], arb, arb]]) -> arb:
    """The maximum of |f_t| / f_n, with f_n > 0, over steps of the integration.

    If the ratio is monotone on an interval within a step, its maximum is at one of the ends. Otherwise the mean value
    theorem bounds it, or the interval is halved.

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
