"""Changes of the mode sequence along a family: the next sequence is proposed from the event, tried and confirmed.

The proposals are local edits of the sequence, the most plausible first:

    stick reaches the friction cone   insert a slip there
    slip comes to rest                insert a stick or the opposite slip there
    slip starts without acceleration  insert a stick before it, or remove it
    (or, with two coefficients, at the edge of the static cone)
    phase of no duration              remove it; equal neighbours merge
    impulse on the edge of its cone   the impact slips, and so does the first phase
    slip after impact fades           the impact sticks, with or without the first slip
    (or its impulse returns to the static cone)
    switch meets a breakpoint         it stays there, because the torques jump

Each proposal is rolled out from the gait at the event, at a parameter a little past it, where the new phase is short.
It is accepted if Newton's method converges near the event, all its monitors are positive, and the simulator, which does
not know the sequence, confirms it. Both sides of the event are tried, because a family may turn back there. If no
proposal holds, a fixed point of the simulator's return map is sought past the event.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from textwrap import shorten
from typing import TypeVar

import numpy as np

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.branches.conditions import MarginZero
from gaitopt.branches.curve import CurvePoint, Location, curve_through
from gaitopt.branches.monitors import MonitorValue
from gaitopt.errors import ProblemError
from gaitopt.gait.gait import Gait
from gaitopt.gait.trace import MonitorKey
from gaitopt.model.cycle import BREAKPOINT, Cycle, ModeSequence
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.section import TOUCHDOWN
from gaitopt.model.transitions import IMPACT_MARGINS, Transition, Transitions, contact_of, kind, margin, named
from gaitopt.model.walker import Walker
from gaitopt.problem.problem import Problem
from gaitopt.problem.rules import natural_unit
from gaitopt.simulation.simulator import Simulator
from gaitopt.solver.rollout import FINE_ERROR, FIRST_ERROR, Rollout, roll_out
from gaitopt.verification.return_map import ReturnMap
from gaitopt.verification.verify import confirm

PHASE_END = 0.02
"""An event counts as at the end of a phase if it is within this fraction of the phase from that end."""
DISTANCES = (1e-5, 1e-4, 1e-3, 1e-2)
"""Distances past the event at which a successor is tried, relative to the size of the parameter."""
SMALLEST_SIZE = 0.01
"""Smallest size of a parameter, in its natural unit: next to zero, a new phase would be too short to simulate."""
SIMULATED_DISTANCES = (1e-4, 1e-2)
"""Distances past the event at which a fixed point of the simulator's return map is sought if no proposal holds."""
FIRST_STEPS = 5.0
"""Length of the first step on a new branch, in distances from the event. The new phase is short and changes fast."""
SHOWN_SEQUENCES, LONGEST_SEQUENCE = 3, 120
"""Number of mode sequences that the reason of an end lists, and largest number of characters of each."""
ACTIVE = 1e-5
"""Monitors below this, in natural units, vanish together with the located one."""
CLOSER_DISTANCE, APPROACH = 1 / 16, 1 / 2
"""At the first fraction of the distance past the event, the distance between successor and gait at the event must have
shrunk at least to the second one. If the successor begins like a square root, it shrinks to a quarter; beyond a jump it
does not."""
SAME_DISTANCE = 1e-9
"""Gaits that are closer than this are the same: the parameter does not act on the successor there."""
NEARBY = 0.3
"""Largest distance between the gaits before and after a change, in scaled section coordinates; also the largest
relative difference of their periods."""

FORCES = {"cone": "normal_force", "impulse_cone": "impulse"}
"""The force or impulse that both edges of a cone bound. If it vanishes, the edges meet."""

T = TypeVar("T")
Phase = tuple[Mode, Mode | None]
"""A mode, and the mode just after the impact of a named contact with which the phase begins."""
Phases = tuple[Phase, ...]


def successors(table: Transitions, cycle: Cycle, active: Iterable[tuple[MonitorKey, MonitorValue]]) -> list[Cycle]:
    """Cycles that may follow ``cycle`` where the ``active`` monitors vanish, the most plausible first."""
    candidates: dict[Cycle, None] = {}
    for key, monitor in active:
        if key.kind == BREAKPOINT:
            assert key.phase is not None
            candidates[cycle.with_timed({*cycle.timed, key.phase})] = None
            continue
        for phases, impacts in _edits(table, cycle, key, monitor.where):
            try:
                edited = Cycle(tuple(map(_merged, phases, impacts)))
                table.check(edited)
            except ValueError:  # the edit is not a valid mode sequence
                continue
            candidates[edited] = None
    candidates.pop(cycle, None)
    return list(candidates)


def transition_at(table: Transitions, cycle: Cycle, key: MonitorKey) -> Transition | None:
    """The transition that a vanishing monitor triggers; None for the duration of a phase."""
    if key.kind == "duration":
        return None
    last = (cycle.first_phases[(key.step + 1) % len(cycle.steps)] - 1) % len(cycle.phases)
    phase = last if key.phase is None else key.phase
    mode, struck = cycle.phases[phase], table.struck(cycle, phase)
    rows = table.of(mode)
    if key.phase is None or (key.kind not in rows and struck is not None and kind(key.kind) in IMPACT_MARGINS):
        assert struck is not None
        return table.of_impact(struck, mode)[key.kind]
    if key.kind == BREAKPOINT:
        return table.at_breakpoint(mode)
    if kind(key.kind) == "onset":
        return table.onset(mode, contact_of(key.kind))
    if kind(key.kind) == "pull":
        return table.pull(cycle.phases[key.phase - 1])
    return rows[key.kind]


def ends_at(point: CurvePoint, key: MonitorKey) -> bool:
    """Whether no mode sequence follows where a monitor vanishes: the motion ends there, or its step ends earlier."""
    transition = transition_at(point.gait.system.transitions, point.curve.cycle, key)
    return transition is not None and bool(transition.ending or transition.ends_step)


def named_contact(cycle: Cycle, key: MonitorKey, walker: type[Walker]) -> str:
    """The label of the contact, or group of contacts, to which a vanishing monitor belongs; empty if it has none.

    For an impact in which the feet swap roles, it is the name after that, like in ``impact``. For a phase that
    vanishes or meets a breakpoint, it is the contact whose state differs from both neighbouring phases.
    """
    if "." in key.kind:
        names, swaps = contact_of(key.kind).split("+"), key.phase is None
        if key.phase is not None and kind(key.kind) in IMPACT_MARGINS:
            landed = cycle.reset_after(key.phase)
            swaps = landed is not None and landed.swaps
        partner = walker.partners() if swaps else {}
        return "+".join(partner.get(name, name) for name in names)
    if key.phase is None or key.kind not in ("duration", BREAKPOINT):
        return ""
    mode, n = cycle.phases[key.phase], len(cycle.phases)
    neighbours = [cycle.phases[(key.phase + k) % n].contacts for k in (-1, 1)]
    differing = {name: sum(m[name] != state for m in neighbours) for name, state in mode.contacts.items()}
    contact = max(differing, key=lambda name: differing[name])
    return walker.label(contact) if differing[contact] else ""


def size_of(point: CurvePoint) -> float:
    """Size of the parameter at a gait, from which distances past an event are taken.

    Which mode sequence follows must not depend on how far the family is to be continued.
    """
    parameter = point.curve.parameter
    return max(abs(point.value), SMALLEST_SIZE * natural_unit(point.problem, parameter))


def vanishing_force(point: CurvePoint, key: MonitorKey) -> MonitorKey:
    """The monitor of a force or impulse, if it vanishes together with the edge of its cone at ``key``; or ``key``.

    If both components of a force vanish at once, it meets both edges of its cone, and rounding decides which of the
    three monitors is located first.
    """
    cone, _, side = kind(key.kind).rpartition("_")
    if cone not in FORCES or side not in ("forward", "backward"):
        return key
    force = key._replace(kind=named(FORCES[cone], key.kind))
    return force if force in point.monitors and abs(point.monitor(force)) < ACTIVE else key


def _edits(
    table: Transitions, cycle: Cycle, key: MonitorKey, where: float
) -> Iterator[tuple[list[Phases], list[Mode]]]:
    """Phases and impacts of all steps after each edit for a monitor that vanishes at ``where`` in its phase.

    Only the contacts of the event change. Simulated walks propose changes of several contacts at once.
    """
    transition = transition_at(table, cycle, key)
    phases = [tuple((mode, dict(step.landings).get(k)) for k, mode in enumerate(step.phases)) for step in cycle.steps]
    if key.phase is None or (transition is not None and kind(transition.guard) in IMPACT_MARGINS):
        assert transition is not None
        yield from _impact_edits(table, cycle, key, transition, phases)
        return
    step, impacts = cycle.step_of(key.phase), [*cycle.impacts]
    index = key.phase - cycle.first_phases[step]
    before, ((mode, landed), *after) = phases[step][:index], phases[step][index:]

    def ended(new: Phases) -> tuple[list[Phases], list[Mode]]:
        """Phases and impacts with ``new`` phases in this step.

        A step that ends without an impact ends with the contacts of its last phase.
        """
        lands = table.cycle_end == TOUCHDOWN
        return _replaced(phases, step, new), impacts if lands else _replaced(impacts, step, new[-1][0].contact)

    if transition is not None and transition.reset is None and not transition.margin.rises:
        contacts = {*contact_of(key.kind).split("+")}
        for candidate in transition.candidates:
            if _changed(candidate, mode).keys() <= contacts:
                yield from (ended((*before, *new, *after)) for new in _inserted((mode, landed), candidate, where))
    if transition is None or transition.at_rest:  # the phase has vanished, or its contact joins a neighbouring phase
        without = (*before, (after[0][0], after[0][1] or landed), *after[1:]) if after else before
        if without:
            yield ended(without)
        struck = impacts[step - 1] if index == 0 else landed
        if after and struck is not None:  # no slip remains after the impact, so the impact sticks
            following = after[0][0].directions
            new = struck.with_states({n: Mode.STICK for n, d in struck.directions.items() if d and following[n] != d})
            if index == 0:
                yield _replaced(phases, step, (*after,)), _replaced(impacts, step - 1, new)
            else:
                yield _replaced(phases, step, (*before, (after[0][0], new), *after[1:])), impacts


def _impact_edits(
    table: Transitions, cycle: Cycle, key: MonitorKey, transition: Transition, phases: list[Phases]
) -> Iterator[tuple[list[Phases], list[Mode]]]:
    """The edits for a margin of an impact: at the end of a step, at a landing within it, or when a stop locks."""
    ends_step, impacts = key.phase is None, [*cycle.impacts]
    step = key.step if key.phase is None else cycle.step_of(key.phase)
    following = (step + 1) % len(phases) if ends_step else step
    index = 0 if key.phase is None else key.phase + 1 - cycle.first_phases[step]
    before, ((first, landed), *rest) = phases[following][:index], phases[following][index:]
    impact = impacts[step] if ends_step else landed or first
    swaps = table.cycle_end == TOUCHDOWN if ends_step else landed is not None and landed.swaps
    for candidate in transition.candidates:
        new = table.walker.swapped(candidate) if swaps else candidate
        struck = None if ends_step or landed is None else new.swapping if swaps else new
        changed = _changed(new, impact)
        mode = first.with_states(changed)
        ways = [((mode, struck), (first, None), *rest), ((mode, struck), *rest), ((first, struck), *rest)]
        if transition.at_rest:  # the slip after the impact fades: it vanishes, starts from rest, or reverses
            turned = {name: str(Mode.slip(-impact.directions[name])) for name in changed}
            ways = [ways[2], ((first.with_states(turned), struck), *rest), ways[1], ways[0]]
            if rest and rest[0][0].locked == first.locked:
                ways.insert(0, ((rest[0][0], struck), *rest[1:]))
        for way in ways:
            edited = _replaced(phases, following, (*before, *way))
            yield edited, _replaced(impacts, step, new) if ends_step else impacts


def _changed(after: Mode, before: Mode) -> dict[str, str]:
    """The contacts whose states differ between two modes, with their states in ``after``."""
    return {name: state for name, state in after.contacts.items() if state != before.contacts[name]}


def _inserted(phase: Phase, mode: Mode, where: float) -> tuple[Phases, ...]:
    """Three ways to insert another mode into a phase; the time of the event decides which one comes first."""
    known, struck = phase
    at_start, inside = ((mode, struck), (known, None)), (phase, (mode, None), (known, None))
    at_end = (phase, (mode, None))
    if where > 1 - PHASE_END:
        return at_end, inside, at_start
    return (at_start, inside, at_end) if where < PHASE_END else (inside, at_start, at_end)


def _merged(phases: Phases, impact: Mode) -> ModeSequence:
    """The step with these phases; equal neighbours are merged, unless an impact lies between them.

    If two impacts follow each other without a phase between them, the second one counts.
    """
    modes, landings = list[Mode](), dict[int, Mode]()
    for mode, struck in phases:
        if not modes or modes[-1] is not mode or struck is not None:
            modes.append(mode)
            landings |= {} if struck is None else {len(modes) - 1: struck}
    return ModeSequence(tuple(modes), impact, landings=tuple(landings.items()))


def walked_cycles(point: CurvePoint, offset: float) -> list[tuple[Cycle, Array]]:
    """Cycles that the simulator walks past an event, in which many contacts may change at once.

    The walk starts from the predicted gait. A change of the impact, or of the contacts that slip across the section,
    appears in its second cycle. Each cycle comes with the states at the starts of its steps, shape (k, n_z).
    """
    dynamics = Dynamics(point.gait.system, point.curve.p).at({point.curve.parameter: point.value + offset})
    state, n = start_states(point, point.curve.cycle, _ahead(point, offset), dynamics)[0], len(point.curve.cycle.steps)
    walk = Simulator(dynamics).run(state, 2 * n)
    steps, cycles = [step for step in walk.steps if step.impact is not None], list[tuple[Cycle, Array]]()
    for walked in (steps[n : 2 * n], steps[:n]):
        if len(walked) < n:
            continue
        try:
            cycle = Cycle(tuple(step.sequence for step in walked))
        except ValueError:  # the modes do not form a cycle, because the walk has left the gait
            continue
        cycles.append((cycle, np.array([step.arcs[0].states[0] for step in walked])))
    return cycles


def _proposals(point: CurvePoint, edited: Sequence[Cycle], size: float) -> Iterator[tuple[Cycle, float, Array | None]]:
    """Cycles past an event, each with a distance in sizes of the parameter, and with states at its steps if known.

    Cycles of walks come first, then the edits. The states of the walks are tried last: if a slip crosses the section,
    only the walk knows its velocity there.
    """
    walked, proposed = list[tuple[Cycle, float, Array | None]](), {point.curve.cycle}
    for distance in DISTANCES[:2]:
        walks = [(cycle, distance, states) for cycle, states in walked_cycles(point, distance * size)]
        walked += [walk for walk in walks if walk[0] != point.curve.cycle]
        for cycle, _, _ in walks:
            if cycle not in proposed:
                proposed.add(cycle)
                yield from ((cycle, each, None) for each in DISTANCES)
    yield from ((cycle, distance, None) for cycle in edited if cycle not in proposed for distance in DISTANCES)
    yield from walked


def _replaced(items: Sequence[T], index: int, new: T) -> list[T]:
    items = list(items)
    items[index] = new
    return items


def find_change(event: Location, key: MonitorKey) -> tuple[CurvePoint | None, str, float]:
    """The first gait of the mode sequence that follows the zero of a monitor.

    Returns
    -------
    successor : the gait; None if no mode sequence follows.
    reason : why the old mode sequence ends.
    length : arclength of the first step on the new branch.
    """
    point, curve = event.point, event.point.curve
    ahead = np.sign(point.tangent[-1]) or 1.0
    size = size_of(point)
    candidates = successors(point.gait.system.transitions, curve.cycle, _active(point, key))
    jumps = key.kind == BREAKPOINT
    if key.phase is None:
        reason = margin(key.kind).lost
    else:
        lost = " vanishes" if key.kind == "duration" else f": {margin(key.kind).lost}"
        reason = f"{curve.cycle.phase_words(key.phase)}{lost}"
    tried = dict.fromkeys(candidates)
    for side in (ahead, -ahead):
        for cycle, distance, states in _proposals(point, candidates, side * size):
            tried[cycle] = None
            successor = attempt(point, cycle, offset := side * distance * size, states)
            if successor is None or successor.curve.cycle == curve.cycle:
                continue
            if _is_continuous(point, successor, offset, jumps=jumps):
                return successor, reason, FIRST_STEPS * distance * (size / curve.metric.span)
    for distance in SIMULATED_DISTANCES:
        offset = ahead * distance * size
        successor = simulated_gait(point, offset)
        if successor is None or successor.curve.cycle == curve.cycle:
            continue
        if _is_continuous(point, successor, offset, jumps=jumps):
            return successor, reason, FIRST_STEPS * distance * (size / curve.metric.span)
    dynamics = point.gait.dynamics
    if dynamics.stick_comes_first and tried:
        jump = "static friction is above kinetic friction"
        jump = jump if dynamics.friction_drops else "a slipping impact has no friction"
        reason = f"{reason}, and the return map jumps: {jump}"
    listed = " or ".join(shorten(str(cycle), LONGEST_SEQUENCE) for cycle in [*tried][:SHOWN_SEQUENCES]) or "none"
    more = f" and {len(tried) - SHOWN_SEQUENCES} others" if len(tried) > SHOWN_SEQUENCES else ""
    trials = f"tried {listed}{more}, and the return map of the simulator"
    return None, f"{reason}; no other mode sequence continues the family ({trials})", 0.0


@overflow_allowed()
def simulated_gait(point: CurvePoint, offset: float) -> CurvePoint | None:
    """The gait near ``point`` at a fixed point of the simulator's return map, with the parameter shifted by ``offset``.

    The simulator finds the modes, even if several change at once. The gait is solved on a mesh as fine as the guess. If
    ``offset`` is zero, it has the modes of ``point`` and the same direction along the family.
    """
    curve, gait = point.curve, point.gait
    try:
        curve.problem.replace({curve.parameter: point.value + offset})
    except ProblemError:  # the parameter is beyond the range that the problem allows
        return None
    dynamics = Dynamics(gait.system, curve.p).at({curve.parameter: point.value + offset})
    state, section = (
        start_states(point, curve.cycle, _ahead(point, offset), dynamics)[0],
        gait.system.section(curve.cycle),
    )
    return_map = ReturnMap(Simulator(dynamics), section, len(curve.cycle.steps), state)
    steps = return_map.damped_fixed_point(state[section.indices], curve.metric.state[section.indices])
    if steps is None:
        return None
    starts = np.array([step.arcs[0].states[0] for step in steps])
    try:
        cycle = Cycle(tuple(step.sequence for step in steps))
    except ValueError:  # its cycle does not close
        return None
    return attempt(point, cycle, offset, starts) if offset or cycle == curve.cycle else None


def located_on_successor(event: Location, successor: CurvePoint) -> tuple[CurvePoint, MonitorKey] | None:
    """The gait at an event, located on the successor, and what vanishes there, if a phase vanishes; None otherwise.

    A slip from rest ends when v / t = 0. In a phase of almost no duration this is dominated by rounding, so that the
    old branch locates the event with half the digits only. The margin of the phase that replaces it has all digits.
    """
    if len(successor.curve.cycle.phases) >= len(event.point.curve.cycle.phases):
        return None
    condition, metric, count = successor.curve.condition, successor.curve.metric, len(successor.values)
    ahead, spans = successor.direction[-count:], np.array([*metric.others, metric.span])
    back = (event.point.at.w[-count:] - successor.at.w[-count:]) / spans @ ahead
    length = 2 * float(back / (ahead @ ahead)) if ahead.any() else 0.0
    try:
        behind = successor.step(length) if length else None
    except ProblemError:  # beyond the range of a parameter
        return None
    if behind is None:
        return None
    own = condition.key if isinstance(condition, MarginZero) else None
    zeros = [
        (successor.locate(behind, length, partial(CurvePoint.monitor, key=key)), key)
        for key in behind.lost(successor)
        if key != own
    ]
    nearest, key = min(zeros, key=lambda zero: abs(zero[0].length), default=(None, None))
    return (nearest.point, key) if nearest is not None and key is not None and nearest.status == "converged" else None


def alternatives(point: CurvePoint, known: Sequence[Cycle]) -> Iterator[CurvePoint]:
    """First gaits of mode sequences other than the ``known`` ones that begin at an event, on either side of it.

    One of the candidates is the cycle that alternates between the two known sequences, because the period may double at
    a border collision.
    """
    size = size_of(point)
    proposals = successors(point.gait.system.transitions, point.curve.cycle, _active(point))
    candidates = [cycle for cycle in proposals if cycle not in known]
    if len(known) == 2:
        candidates.append(in_turn(*known))
    for cycle in candidates:
        offsets = (side * distance * size for distance in DISTANCES for side in (1.0, -1.0))
        attempts = (attempt(point, cycle, offset) for offset in offsets)
        successor = next((attempt for attempt in attempts if attempt is not None), None)
        if successor is not None and halved_cycle(successor.gait) is None:
            yield successor


def halved_cycle(gait: Gait) -> Cycle | None:
    """The first half of a cycle that consists of the same steps twice; None for other cycles."""
    half, odd = divmod(len(gait.steps), 2)
    return None if odd or half % gait.repeats_after else Cycle(gait.cycle.steps[:half])


def exchanged_half(before: Gait, after: Gait) -> Cycle | None:
    """The first half of a cycle whose halves change roles between two gaits of a family; None if they do not.

    Between these gaits the halves are equal at exactly one gait: there the family begins at a period doubling.
    """
    half, odd = divmod(len(before.steps), 2)
    steps = before.cycle.steps
    if odd or steps[:half] != steps[half:] or before.cycle != after.cycle:
        return None
    if halved_cycle(before) is not None and halved_cycle(after) is not None:
        return None
    here, there = (_unlikeness(gait, half) for gait in (before, after))
    return Cycle(steps[:half]) if np.vdot(here, there) < 0 else None


def halves_apart(gait: Gait) -> float:
    """Largest difference of the states of the two halves of a cycle in natural units; inf if their modes differ."""
    half, odd = divmod(len(gait.steps), 2)
    alike = not odd and gait.cycle.steps[:half] == gait.cycle.steps[half:]
    return float(np.abs(_unlikeness(gait, half)).max()) if alike else np.inf


def _unlikeness(gait: Gait, half: int) -> Array:
    """Difference of the states after the impacts of the two halves of a cycle, in natural units; shape (half, n)."""
    states = np.array([step.arcs[0].states[0] for step in gait.steps]) / gait.dynamics.state_units
    return np.asarray(states[half:] - states[:half])


def in_turn(first: Cycle, second: Cycle) -> Cycle:
    """A cycle that consists of both cycles; the first phases of each still follow the impact of its own last step."""
    (*before, last_of_first), (*after, last_of_second) = first.steps, second.steps
    joint, last = (
        replace(one, impact=other.impact)
        for one, other in ((last_of_first, last_of_second), (last_of_second, last_of_first))
    )
    return Cycle((*before, joint, *after, last))


def holds(point: CurvePoint) -> bool:
    """Whether all monitors of a gait are positive and the simulator confirms it."""
    return all(monitor.value > 0 for monitor in point.monitors.values()) and confirm(point.gait).passed


def _active(point: CurvePoint, located: MonitorKey | None = None) -> list[tuple[MonitorKey, MonitorValue]]:
    """The located monitor, and those that vanish with it; monitors of the impact come first."""
    active = [
        (key, monitor) for key, monitor in point.monitors.items() if key == located or abs(monitor.value) < ACTIVE
    ]
    return sorted(active, key=lambda pair: pair[0].phase is not None)


@overflow_allowed()
def attempt(point: CurvePoint, cycle: Cycle, offset: float, known: Array | None = None) -> CurvePoint | None:
    """The gait with other modes at a parameter that is ``offset`` past the event; None if these modes do not hold.

    Parameters
    ----------
    known : states at the starts of its steps, shape (k, n_z); None to predict them along the old branch.
    """
    curve, values = point.curve, {point.curve.parameter: point.value + offset}
    guess = predicted(point, curve.problem, cycle, values, _ahead(point, offset), known)
    if guess is None:
        return None
    problem, rolled, state = guess
    error = FIRST_ERROR if known is None else FINE_ERROR
    successor, w = curve_through(problem, curve.parameter, curve.metric, rolled, error=error)
    forward = np.zeros(w.size)  # away from the event, in the entries that both curves have
    forward[: state.size] = state - point.gait.state
    forward[-1] = offset
    first = successor.start(w, successor.solutions.coordinates(forward) if offset else point.direction)
    try:
        near = first is not None and curve.metric.distance(first.gait.state, point.gait.state) < NEARBY
    except RuntimeError:  # the equations are singular, because slips of no duration have no event
        return None
    return first if near and first is not None and holds(first) else None


def predicted(
    point: CurvePoint, problem: Problem, cycle: Cycle, values: Mapping[str, float], w: Array, known: Array | None = None
) -> tuple[Problem, Rollout, Array] | None:
    """A guess of the gait with other modes past an event; None if it contradicts them or has another period.

    Parameters
    ----------
    values, w : the free parameters, and the unknowns that are predicted along the old curve.
    known : states at the starts of its steps, shape (k, n_z); None to take those of the prediction.

    Returns
    -------
    problem, rolled, state : the problem with these modes, the motion, and its first state.
    """
    curve, system = point.curve, point.gait.system
    dynamics = Dynamics(system, curve.p).at(values)
    states = start_states(point, cycle, w, dynamics) if known is None else known
    try:
        problem = problem.with_modes(cycle, dict(zip(system.state_names, states[0], strict=True)))
    except ProblemError:  # the state contradicts the impact
        return None
    period = float(point.at.durations.sum())
    rolled = roll_out(dynamics, cycle, states, longest=(1 + NEARBY) * period)
    period *= len(cycle.steps) / len(curve.cycle.steps)
    if min(rolled.durations) <= 0 or abs(sum(rolled.durations) - period) > NEARBY * period:
        return None
    return problem, rolled, states[0]


def _ahead(point: CurvePoint, offset: float) -> Array:
    """The unknowns where the parameter is ``offset`` further, predicted along the branch."""
    slope = point.tangent[-1]
    return np.asarray(point.at.w + point.tangent * (offset / slope if slope else 0.0))


def start_states(point: CurvePoint, cycle: Cycle, w: Array, dynamics: Dynamics) -> Array:
    """The state at the start of the successor's steps: from predicted unknowns, through the successor's impacts.

    Returns
    -------
    states : ndarray, shape (k, n_z); only the first one if the cycle has another number of steps.
    """
    curve = point.curve
    nodes, ends = curve.equations.unpack(w).nodes, curve.equations.mesh.impact_nodes
    count = len(cycle.steps) if len(cycle.steps) == len(curve.cycle.steps) else 1
    states = []
    for step in range(count):
        impact = cycle.impacts[step - 1]
        state = nodes[:, (ends[step - 1] + 1) % nodes.shape[1]]
        if impact is not curve.cycle.impacts[step - 1]:
            last = (cycle.first_phases[step] - 1) % len(cycle.phases)
            struck = point.gait.system.transitions.struck(cycle, last)
            assert struck is not None
            state = dynamics.after_impact(struck, nodes[:, ends[step - 1]], cycle.phases[last])
            if impact.fixes_x:
                state[-1] = 0.0
        states.append(state)
    return np.array(states)


def _is_continuous(point: CurvePoint, successor: CurvePoint, offset: float, *, jumps: bool) -> bool:
    """Whether the successor converges to the gait at the event when the parameter approaches the event.

    If friction drops at the onset of slip or in a slipping impact, or a torque ``jumps``, the return map may jump at an
    event. A gait beyond the jump does not belong to this family, however near it is.
    """
    if not (point.gait.dynamics.stick_comes_first or jumps):
        return True
    closer = attempt(point, successor.curve.cycle, offset * CLOSER_DISTANCE)
    if closer is None:
        return False
    near, far = (point.curve.metric.distance(other.gait.state, point.gait.state) for other in (closer, successor))
    return bool(near < max(APPROACH * far, SAME_DISTANCE))
