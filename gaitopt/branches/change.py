"""Changes of the mode sequence along a family: the next sequence is proposed from the event, tried and confirmed.

The proposals are local edits of the sequence, the most plausible first:

    cone reached while sticking       insert a slip there
    slip comes to rest                insert a stick or the opposite slip there
    slip starts without acceleration  insert a stick before it, or remove it
    (or, with two coefficients, at the edge of the static cone)
    phase of no duration              remove it; equal neighbours merge
    impulse on the edge of its cone   the impact slips, and so does the first phase
    slip after impact fades           the impact sticks, with or without the first slip
    (or its impulse returns to the static cone)
    switch meets a breakpoint         it stays there, because the torques jump

Each proposal is rolled out from the gait at the event, a short way past it in the parameter, where its new phase is
short. It is accepted if Newton's method converges next to the event, all its monitors are positive, and the simulator,
which does not know the sequence, confirms it. A family may also turn back at an event, so that both sides are tried.
"""

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from itertools import groupby
from typing import TypeVar

import numpy as np

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.branches.curve import CurvePoint, Location, curve_through
from gaitopt.branches.monitors import MonitorKey, MonitorValue
from gaitopt.errors import ProblemError
from gaitopt.gait.gait import Gait
from gaitopt.model.cycle import BREAKPOINT, Cycle, ModeSequence
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.transitions import IMPACT_MARGINS, Transition, Transitions, margin
from gaitopt.solver.rollout import roll_out
from gaitopt.verification.verify import confirm

EDGE = 0.02
"""An event within this part of a phase from one of its ends counts as at that end."""
DISTANCES = (1e-5, 1e-4, 1e-3, 1e-2)
"""Distances past the event at which a successor is tried, relative to the span of the parameter."""
FIRST_STEPS = 5.0
"""First step on a new branch, in distances from the event: its new phase is short and changes fast."""
ACTIVE = 1e-5
"""Monitors below this, in natural units, vanish with the located one."""
CLOSER, APPROACH = 1 / 16, 1 / 2
"""At a sixteenth of the distance past the event, a successor must be at most half as far from the gait there. One that
begins like a square root is four times closer; one beyond a jump is not closer."""
SAME = 1e-9
"""Gaits this close are the same: the parameter does not act on the successor there."""
NEARBY = 0.3
"""Largest distance between the gaits before and after a change: of scaled section coordinates, and of periods relative
to the period."""

T = TypeVar("T")
Phases = tuple[Mode, ...]


def successors(table: Transitions, cycle: Cycle, active: Iterable[tuple[MonitorKey, MonitorValue]]) -> list[Cycle]:
    """Cycles that may follow ``cycle`` where the ``active`` monitors vanish, the most plausible first."""
    candidates: dict[Cycle, None] = {}
    for key, monitor in active:
        if key.kind == BREAKPOINT:
            assert key.phase is not None
            candidates[cycle.with_timed({*cycle.timed, key.phase})] = None
            continue
        for phases, impacts in _edits(table, cycle, key, monitor.where):
            merged = (tuple(mode for mode, _ in groupby(step)) for step in phases)
            try:
                edited = Cycle(tuple(map(ModeSequence, merged, impacts)))
                table.check(edited)
            except ValueError:  # the edit contradicts itself
                continue
            candidates[edited] = None
    candidates.pop(cycle, None)
    return list(candidates)


def transition_at(table: Transitions, cycle: Cycle, key: MonitorKey) -> Transition | None:
    """The transition that a vanishing monitor triggers; None where a phase has no duration left."""
    if key.kind == "duration":
        return None
    if key.phase is None:
        return table.of_impact(cycle.impacts[key.step])[key.kind]
    mode, reset = cycle.phases[key.phase], cycle.reset_after(key.phase)
    if key.kind == BREAKPOINT:
        return table.at_breakpoint(mode)
    if key.kind == "onset":
        return table.onset(mode)
    if key.kind == "pull":
        return table.pull(cycle.phases[key.phase - 1])
    rows = table.of(mode)
    return rows[key.kind] if key.kind in rows or reset is None else table.of_impact(reset)[key.kind]


def _edits(
    table: Transitions, cycle: Cycle, key: MonitorKey, where: float
) -> Iterator[tuple[list[Phases], list[Mode]]]:
    """Phases and impacts of all steps after each edit for a monitor that vanishes at ``where`` in its phase."""
    transition, phases, impacts = transition_at(table, cycle, key), [s.phases for s in cycle.steps], [*cycle.impacts]
    if key.phase is None:
        assert transition is not None
        following = (key.step + 1) % len(phases)
        first, *rest = old = phases[following]
        for impact in transition.candidates:
            if transition.at_rest:  # the slip after the impact fades: it is gone, goes on from rest, or turns round
                opposite = Mode.slip(-impacts[key.step].direction)
                edited = [(*rest,), old, (first.with_contact(opposite), *rest)]
            else:
                edited = [old if first.contact is impact else (first.with_contact(impact), *old)]
            for new in edited:
                yield _replaced(phases, following, new), _replaced(impacts, key.step, impact)
        return
    step = cycle.step_of(key.phase)
    place = key.phase - cycle.first_phases[step]
    before, mode, after = phases[step][:place], phases[step][place], phases[step][place + 1 :]
    edited = []
    if transition is None:  # the phase has no duration left
        edited = [(*before, *after)]
    elif transition.guard in IMPACT_MARGINS:  # of the stop's impact that ends the phase
        if transition.at_rest:
            remaining = [after[1:]] if len(after) > 1 and after[1].locked == after[0].locked else []
            remaining.append((after[0].with_contact(Mode.STICK), *after[1:]))
        else:
            remaining = [after if after[0] is slip else (slip, *after) for slip in transition.candidates]
        edited = [(*before, mode, *new) for new in remaining]
    elif transition.reset is None and not transition.margin.rises:
        for inserted in transition.candidates:  # the place of the event makes one of three ways the most plausible
            at_start, inside, at_end = (inserted, mode), (mode, inserted, mode), (mode, inserted)
            middles = (at_start, inside, at_end) if where < EDGE else (inside, at_start, at_end)
            if where > 1 - EDGE:
                middles = (at_end, inside, at_start)
            edited += [(*before, *middle, *after) for middle in middles]
        if transition.at_rest:  # the foot may also stay in the mode of its neighbours
            edited.append((*before, *after))
    for new in edited:
        yield _replaced(phases, step, new), impacts
    if transition is None and place == 0 and impacts[step - 1].slips:  # no slip is left after the impact: it sticks
        yield _replaced(phases, step, after), _replaced(impacts, step - 1, Mode.STICK)


def _replaced(items: Sequence[T], index: int, new: T) -> list[T]:
    items = list(items)
    items[index] = new
    return items


def find_change(event: Location, key: MonitorKey) -> tuple[CurvePoint | None, str, float]:
    """The first gait of the mode sequence that follows the zero of a monitor.

    Returns
    -------
    successor : None if no mode sequence follows.
    reason : what ended the old mode sequence.
    length : arclength of the first step on the successor.
    """
    point, curve = event.point, event.point.curve
    ahead = np.sign(point.tangent[-1]) or 1.0
    candidates = successors(point.gait.system.transitions, curve.cycle, _active(point, key))
    if key.phase is None:
        reason = margin(key.kind).lost
    else:
        lost = " shrinks to nothing" if key.kind == "duration" else f": {margin(key.kind).lost}"
        reason = f"{curve.cycle.phase_words(key.phase)}{lost}"
    for side in (ahead, -ahead):
        for cycle in candidates:
            for distance in DISTANCES:
                offset = side * distance * curve.metric.span
                successor = _attempt(point, cycle, offset)
                if successor is None or successor.curve.cycle == curve.cycle:
                    continue
                if _is_continuous(point, successor, offset, jumps=key.kind == BREAKPOINT):
                    return successor, reason, FIRST_STEPS * distance
    dynamics = point.gait.dynamics
    if dynamics.stick_comes_first and candidates:
        jump = "static friction is above kinetic friction"
        jump = jump if dynamics.friction_drops else "a slipping impact has no friction"
        reason = f"{reason}, and the return map jumps: {jump}"
    tried = " or ".join(map(str, candidates)) or "none"
    return None, f"{reason}; no mode sequence goes on from here (tried {tried})", 0.0


def located_on_successor(event: Location, successor: CurvePoint) -> CurvePoint | None:
    """The gait at an event as the successor meets it, where a phase vanishes there; None where it does not.

    A slip from rest ends when v / t = 0. Rounding decides this in a phase of no duration, so that only half the digits
    of the duration are left on the old branch. The margin of the phase that replaces it has all of them.
    """
    if len(successor.curve.cycle.phases) >= len(event.point.curve.cycle.phases):
        return None
    slope = successor.tangent[-1]
    length = 2 * (event.point.value - successor.value) / slope if slope else 0.0
    behind = successor.step(length) if length else None
    if behind is None:
        return None
    zeros = [successor.locate(behind, length, partial(CurvePoint.monitor, key=lost)) for lost in behind.lost(successor)]
    nearest = min(zeros, key=lambda location: abs(location.length), default=None)
    return nearest.point if nearest is not None and nearest.status == "converged" else None


def alternatives(point: CurvePoint, known: Sequence[Cycle]) -> Iterator[CurvePoint]:
    """First gaits of the mode sequences, other than the ``known`` ones, that begin at an event on either side of it.

    The cycle of the two known sequences in turn is one of them: at a border collision the period may double.
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


def halved_cycle(gait: Gait) -> Cycle | None:
    """The first half of a cycle that consists of the same steps twice; None of any other."""
    half, odd = divmod(len(gait.steps), 2)
    return None if odd or half % gait.repeats_after else Cycle(gait.cycle.steps[:half])


def in_turn(first: Cycle, second: Cycle) -> Cycle:
    """Both cycles one after the other; the first phases of each still follow the impact that they follow alone."""
    (*before, last_of_first), (*after, last_of_second) = first.steps, second.steps
    joint = ModeSequence(last_of_first.phases, last_of_second.impact)
    return Cycle((*before, joint, *after, ModeSequence(last_of_second.phases, last_of_first.impact)))


def holds(point: CurvePoint) -> bool:
    """Whether all monitors of a gait are positive and the simulator confirms it."""
    return all(monitor.value > 0 for monitor in point.monitors.values()) and confirm(point.gait).passed


def _active(point: CurvePoint, located: MonitorKey | None = None) -> list[tuple[MonitorKey, MonitorValue]]:
    """The located monitor, and those that vanish with it; the impact's first."""
    active = [
        (key, monitor) for key, monitor in point.monitors.items() if key == located or abs(monitor.value) < ACTIVE
    ]
    return sorted(active, key=lambda pair: pair[0].phase is not None)


@overflow_allowed()
def _attempt(point: CurvePoint, cycle: Cycle, offset: float) -> CurvePoint | None:
    """The gait with other modes where the parameter is ``offset`` past the event; None if it does not hold there."""
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
    forward = np.zeros(w.size)  # away from the event, in the entries that both curves have
    forward[: system.n_z] = states[0] - point.gait.state
    forward[-1] = offset
    first = successor.start(w, successor.coordinates(forward))
    if first is None or curve.metric.distance(first.gait.state, point.gait.state) >= NEARBY or not holds(first):
        return None
    return first


def _start_states(point: CurvePoint, cycle: Cycle, offset: float, dynamics: Dynamics) -> Array:
    """States at the starts of the successor's steps: predicted along the old branch, through the successor's impacts.

    Returns
    -------
    states : ndarray, shape (k, n_z); only the first one if the cycle has another number of steps.
    """
    curve, slope = point.curve, point.tangent[-1]
    w = point.at.w + point.tangent * (offset / slope if slope else 0.0)
    nodes, ends = curve.equations.unpack(w).nodes, curve.equations.mesh.impact_nodes
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


def _is_continuous(point: CurvePoint, successor: CurvePoint, offset: float, *, jumps: bool) -> bool:
    """Whether the successor tends to the gait at the event as the parameter does.

    Where friction drops at the onset of slip or in a slipping impact, or a torque ``jumps``, the return map may jump at
    an event. A gait beyond the jump does not belong to this family, however near it lies.
    """
    if not (point.gait.dynamics.stick_comes_first or jumps):
        return True
    closer = _attempt(point, successor.curve.cycle, offset * CLOSER)
    if closer is None:
        return False
    near, far = (point.curve.metric.distance(other.gait.state, point.gait.state) for other in (closer, successor))
    return bool(near < max(APPROACH * far, SAME))
