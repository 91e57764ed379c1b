"""From one mode sequence to the next: each successor that the physics allows is tried until one holds.

Successors are local edits of the mode sequence:

    cone reached while sticking       a slip is inserted there
    slip comes to rest                a stick or the opposite slip is inserted there
    slip starts without acceleration  a stick is put before it, or it is left out
    (or, with two coefficients, at the edge of the static cone)
    phase of no duration              it is left out, equal neighbours merge
    impulse on the edge of its cone   the impact slips, and so does the first phase
    slip after impact fades           the impact sticks, with or without the first slip
    (or its impulse returns to the static cone)

They are proposals, the most plausible first. Each is rolled out from the gait at the event, a short way past it in the
parameter, where its new phase has negligible duration. It is accepted if Newton's method converges next to the event,
all its monitors hold, and the simulator, which does not know the sequence, confirms it. A family may also turn back at
an event, so that both sides of it are tried.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.branches.curve import CurvePoint, Location, curve_through
from gaitopt.branches.monitors import MonitorKey, MonitorValue
from gaitopt.errors import ProblemError
from gaitopt.gait.gait import Gait
from gaitopt.model.cycle import Cycle, ModeSequence
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.transitions import IMPACT_MARGINS, Transition, Transitions, margin
from gaitopt.nlp.rollout import roll_out
from gaitopt.verification.verify import confirm

EDGE = 0.02
"""Part of a phase at its ends within which an event is taken to be at the end."""
DISTANCES = (1e-5, 1e-4, 1e-3, 1e-2)
"""Distances past the event at which a successor is tried, relative to the span of the parameter."""
FIRST_STEPS = 5.0
"""First step on a new branch, in distances from the event: its new phase is short and changes fast."""
ACTIVE = 1e-5
"""Monitors below this, in natural units, vanish together with the one that was located."""
CLOSER, APPROACH = 1 / 16, 1 / 2
"""A successor at this fraction of the distance past the event is at most this fraction as far from the gait there: one
that begins like a square root comes four times closer, one beyond a jump does not come closer."""
SAME = 1e-9
"""Gaits this close are the same: there the parameter does not act on the successor."""
NEARBY = 0.3
"""Largest distance between the gaits before and after: in scaled section coordinates, and of periods relatively."""

Phases = tuple[Mode, ...]
Steps = list[tuple[Phases, Mode]]


def successors(table: Transitions, cycle: Cycle, active: Iterable[tuple[MonitorKey, MonitorValue]]) -> list[Cycle]:
    """Cycles that may follow ``cycle`` where the ``active`` monitors vanish, the most plausible first."""
    candidates: dict[Cycle, None] = {}
    for name, monitor in active:
        for steps in _edits(table, cycle, name, monitor.where):
            try:
                edited = Cycle(tuple(ModeSequence(_merge(phases), impact) for phases, impact in steps))
                table.check(edited)
            except ValueError:  # the edit contradicts itself
                continue
            candidates[edited] = None
    candidates.pop(cycle, None)
    return list(candidates)


def halved_cycle(gait: Gait) -> Cycle | None:
    """The first half of a cycle that consists of the same steps twice; None of any other."""
    half, odd = divmod(len(gait.steps), 2)
    return None if odd or half % gait.repeats_after else Cycle(gait.problem.cycle.steps[:half])


def _edits(table: Transitions, cycle: Cycle, name: MonitorKey, where: float) -> Iterator[Steps]:
    """Phases and impact of every step after an edit where the monitor ``name`` vanishes."""
    steps: Steps = [(step.phases, step.impact) for step in cycle.steps]
    transition = transition_at(table, cycle, name)
    if name.phase is None:
        following = (name.step + 1) % len(steps)
        for phases, impact in _impact_edits(steps[following][0], steps[name.step][1], transition):
            yield _changed(_changed(steps, following, phases=phases), name.step, impact=impact)
        return
    step = cycle.step_of(name.phase)
    own, previous = name.phase - cycle.first_phases[step], step - 1
    for phases in _phase_edits(steps[step][0], own, transition, where):
        yield _changed(steps, step, phases=phases)
    if name.kind == "duration" and own == 0 and steps[previous][1].slips:
        yield _changed(_changed(steps, step, phases=steps[step][0][1:]), previous, impact=Mode.STICK)


def transition_at(table: Transitions, cycle: Cycle, name: MonitorKey) -> Transition | None:
    """What the table says of a monitor that vanishes; None where a phase has no duration left."""
    if name.kind == "duration":
        return None
    if name.phase is None:
        return table.of_impact(cycle.impacts[name.step])[name.kind]
    mode, reset = cycle.phases[name.phase], cycle.reset_after(name.phase)
    if name.kind == "onset":
        return table.onset(mode)
    rows = table.of(mode)
    return rows[name.kind] if name.kind in rows or reset is None else table.of_impact(reset)[name.kind]


def _changed(steps: Steps, index: int, *, phases: Phases | None = None, impact: Mode | None = None) -> Steps:
    """The steps with the phases or the impact of one of them replaced."""
    changed = list(steps)
    changed[index] = (steps[index][0] if phases is None else phases, steps[index][1] if impact is None else impact)
    return changed


def _phase_edits(phases: Phases, own: int, transition: Transition | None, where: float) -> Iterator[Phases]:
    """Phases of a step after an edit of one of them, where a margin of it or of the stop's impact at its end falls."""
    before, mode, after = phases[:own], phases[own], phases[own + 1 :]
    if transition is None:  # the phase has no duration left
        yield (*before, *after)
    elif transition.guard in IMPACT_MARGINS:
        for struck in _strike_edits(after, transition):
            yield (*before, mode, *struck)
    elif transition.reset is None and not transition.margin.rises:
        for inserted in transition.candidates:
            for middle in _ordered(where, first=(inserted, mode), inside=(mode, inserted, mode), last=(mode, inserted)):
                yield (*before, *middle, *after)
        if transition.at_rest:
            yield (*before, *after)


def _strike_edits(phases: Phases, transition: Transition) -> Iterator[Phases]:
    """Phases that follow the impact of a stop."""
    first = phases[0]
    if transition.at_rest:
        if len(phases) > 1 and phases[1].locked == first.locked:
            yield phases[1:]
        yield (first.with_contact(Mode.STICK), *phases[1:])
    else:
        for slip in transition.candidates:
            yield phases if first is slip else (slip, *phases)


def _impact_edits(phases: Phases, impact: Mode, transition: Transition | None) -> Iterator[tuple[Phases, Mode]]:
    """Phases of the step that follows an impact, and the impact."""
    assert transition is not None
    first = phases[0]
    for other in transition.candidates:
        if transition.at_rest:
            yield phases[1:], other
            yield phases, other
            yield (first.with_contact(Mode.slip(-impact.direction)), *phases[1:]), other
        else:
            yield (phases if first.contact is other else (first.with_contact(other), *phases)), other


def _ordered(where: float, *, first: Phases, inside: Phases, last: Phases) -> tuple[Phases, ...]:
    """The three ways to insert a mode into a phase, beginning with the one that fits where the event is."""
    if where < EDGE:
        return first, inside, last
    return (last, inside, first) if where > 1 - EDGE else (inside, first, last)


def _merge(phases: Phases) -> Phases:
    merged: list[Mode] = []
    for mode in phases:
        if not merged or merged[-1] is not mode:
            merged.append(mode)
    return tuple(merged)


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """The successor of a mode sequence, or why there is none.

    Attributes
    ----------
    point : first gait of the successor, None if there is none.
    reason : what ended the mode sequence.
    length : arclength of the first step on the successor.
    at : the gait at the event as located on the successor, None where that on the old branch is as good.
    """

    point: CurvePoint | None
    reason: str
    length: float = 0.0
    at: CurvePoint | None = None


def find_change(event: Location, key: MonitorKey) -> Change:
    """The branch that goes on from the zero of a monitor."""
    point, curve = event.point, event.point.curve
    ahead = np.sign(point.tangent[-1]) or 1.0
    candidates = successors(point.gait.system.transitions, curve.cycle, _active(point, key))
    words = _words(key, curve.cycle)
    for side in (ahead, -ahead):
        for cycle in candidates:
            for distance in DISTANCES:
                offset = side * distance * curve.metric.span
                successor = _attempt(point, cycle, offset)
                if successor is not None and _is_continuous(point, successor, offset):
                    vanished = len(cycle.phases) < len(curve.cycle.phases)
                    at = _seen_from_behind(successor, event) if vanished else None
                    return Change(point=successor, reason=words, length=FIRST_STEPS * distance, at=at)
    if point.gait.dynamics.friction_drops and candidates:
        words = f"{words}, and the return map jumps: static friction is above kinetic friction"
    tried = " or ".join(map(str, candidates)) or "none"
    return Change(point=None, reason=f"{words}; no mode sequence goes on from here (tried {tried})")


def alternatives(point: CurvePoint, known: Sequence[Cycle]) -> Iterator[CurvePoint]:
    """Gaits of all mode sequences but the ``known`` ones that begin at an event, on either side of it.

    They include the cycle of the two known sequences in turn: at a border collision the period may double.
    """
    proposals = successors(point.gait.system.transitions, point.curve.cycle, _active(point))
    candidates = [cycle for cycle in proposals if cycle not in known]
    if len(known) == 2:
        candidates.append(in_turn(*known))
    for cycle in candidates:
        offsets = (side * distance * point.curve.metric.span for distance in DISTANCES for side in (1.0, -1.0))
        attempts = (_attempt(point, cycle, offset) for offset in offsets)
        successor = next((attempt for attempt in attempts if attempt is not None), None)
        if successor is not None and halved_cycle(successor.gait) is None:
            yield successor


def in_turn(first: Cycle, second: Cycle) -> Cycle:
    """Both cycles one after the other; the phases of each still follow the impact that they follow in its own."""
    (*before, last_of_first), (*after, last_of_second) = first.steps, second.steps
    joint = ModeSequence(last_of_first.phases, last_of_second.impact)
    return Cycle((*before, joint, *after, ModeSequence(last_of_second.phases, last_of_first.impact)))


def holds(point: CurvePoint) -> bool:
    """Whether all monitors of a gait hold and the simulator confirms it."""
    return all(monitor.value > 0 for monitor in point.monitors.values()) and confirm(point.gait).passed


def _active(point: CurvePoint, located: MonitorKey | None = None) -> list[tuple[MonitorKey, MonitorValue]]:
    """The located monitor, and those that vanish with it; the impact's first."""
    active = [
        (name, monitor) for name, monitor in point.monitors.items() if name == located or abs(monitor.value) < ACTIVE
    ]
    return sorted(active, key=lambda pair: pair[0].phase is not None)


def _words(key: MonitorKey, cycle: Cycle) -> str:
    if key.phase is None:
        return margin(key.kind).lost
    place = cycle.phase_words(key.phase)
    return f"{place} shrinks to nothing" if key.kind == "duration" else f"{place}: {margin(key.kind).lost}"


@overflow_allowed()
def _attempt(point: CurvePoint, cycle: Cycle, offset: float) -> CurvePoint | None:
    """The gait with other modes at a distance ``offset`` of the parameter past the event, if it holds there."""
    curve, system = point.curve, point.gait.system
    dynamics = Dynamics(system, curve.p).at({curve.parameter: point.value + offset})
    states = _start_states(point, cycle, offset, dynamics)
    try:
        problem = curve.problem.with_modes(cycle, dict(zip(system.state_names, states[0], strict=True)))
    except ProblemError:  # the state contradicts the impact
        return None
    period = float(point.at.w[-1 - curve.equations.n_phases : -1].sum())
    rolled = roll_out(dynamics, cycle, states, longest=(1 + NEARBY) * period)
    period *= len(cycle.steps) / len(curve.cycle.steps)
    if min(rolled.durations) <= 0 or abs(sum(rolled.durations) - period) > NEARBY * period:
        return None
    successor, w = curve_through(problem, curve.parameter, curve.metric, rolled)
    forward = np.zeros(w.size)  # away from the event, in the entries that the two have in common
    forward[: system.n_z] = states[0] - point.gait.state
    forward[-1] = offset
    first = successor.start(w, forward)
    if first is None or curve.metric.distance(first.gait.state, point.gait.state) >= NEARBY or not holds(first):
        return None
    return first


def _start_states(point: CurvePoint, cycle: Cycle, offset: float, dynamics: Dynamics) -> Array:
    """States after the impacts before the steps of the successor: along the old branch, through its own impacts.

    Returns
    -------
    states : ndarray, shape (k, n_z); of a cycle with another number of steps the first one alone.
    """
    curve, slope = point.curve, point.tangent[-1]
    w = point.at.w + point.tangent * (offset / slope if slope else 0.0)
    nodes, ends = curve.equations.unpack(w).nodes, curve.equations.layout.impact_nodes
    count = len(cycle.steps) if len(cycle.steps) == len(curve.cycle.steps) else 1
    states = []
    for step in range(count):
        impact = cycle.impacts[step - 1]
        state = nodes[:, (ends[step - 1] + 1) % nodes.shape[1]]
        if impact is not curve.cycle.impacts[step - 1]:
            state = dynamics.after_impact(impact, nodes[:, ends[step - 1]])
            if impact.sticks:
                state[-1] = 0.0
        states.append(state)
    return np.array(states)


def _is_continuous(point: CurvePoint, successor: CurvePoint, offset: float) -> bool:
    """Whether a successor comes closer to the gait at the event as the parameter does.

    Where friction drops at the onset of slip, the return map may jump at an event. A gait beyond the jump does not
    belong to this family, however near it lies.
    """
    if not point.gait.dynamics.friction_drops:
        return True
    closer = _attempt(point, successor.curve.cycle, offset * CLOSER)
    if closer is None:
        return False
    near, far = (point.curve.metric.distance(other.gait.state, point.gait.state) for other in (closer, successor))
    return bool(near < max(APPROACH * far, SAME))


def _seen_from_behind(point: CurvePoint, event: Location) -> CurvePoint | None:
    """The gait at which the successor begins, located on the successor, where a phase has vanished.

    A slip from rest ends when v / t = 0, which rounding decides in a phase of no duration, so that only half the digits
    of the duration are left there. The margin of the phase that replaces it has all of them.
    """
    slope = point.tangent[-1]
    length = 2 * (event.point.value - point.value) / slope if slope else 0.0
    behind = point.step(length) if length else None
    if behind is None:
        return None
    zeros = [point.locate(behind, length, partial(CurvePoint.monitor, key=key)) for key in behind.lost(point)]
    nearest = min(zeros, key=lambda location: abs(location.length), default=None)
    return nearest.point if nearest is not None and nearest.status == "converged" else None
