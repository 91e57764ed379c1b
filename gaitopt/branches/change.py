"""From one mode sequence to the next: every successor that the physics allows is tried until one holds.

A successor is rolled out from the gait at the event, a little way past it in the parameter, where its new phase has
negligible duration; it is taken when Newton's method converges next to the event, all its monitors hold, and the
simulator, which does not know the sequence, walks it. A family may also turn back at an event: both sides are tried.

Which mode sequences can follow where one ends: local edits that the physics of the event allows.

    cone reached while sticking       a slip is inserted there
    slip comes to rest                a stick or the opposite slip is inserted there
    slip starts without acceleration  a stick is put before it, or it is left out
    (or, with two coefficients, at the edge of the static cone)
    phase of no duration              it is left out, equal neighbours merge
    impulse on the edge of its cone   the impact slips, and so does the first phase
    slip after impact fades           the impact sticks, with or without the first slip
    (or its impulse comes back to the static cone)

They are proposals, the most plausible first; solving and simulating decides.

When a step fails however short it is: IPOPT looks for a gait a little further on, and the branch goes on from it.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gaitopt.arrays import Array
from gaitopt.branches.curve import Location, Point, Segment, locate, segment_through
from gaitopt.branches.monitors import MonitorKey, MonitorValue
from gaitopt.errors import ProblemError
from gaitopt.gait.gait import Gait
from gaitopt.iteration import overflow_allowed
from gaitopt.model.cycle import Cycle, ModeSequence
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.margins import IMPACT_MARGINS, MARGINS
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.nlp.rollout import roll_out
from gaitopt.nlp.solve import solve_gait
from gaitopt.problem.problem import Problem
from gaitopt.problem.statement import cycle_data
from gaitopt.verification.verify import confirm

EDGE = 0.02
"""Part of a phase at its ends within which an event is taken to be at the end."""

Phases = tuple[Mode, ...]
Steps = list[tuple[Phases, Mode]]


def successors(cycle: Cycle, active: Iterable[tuple[MonitorKey, MonitorValue]]) -> list[Cycle]:
    """Cycles that may follow ``cycle`` where the ``active`` monitors vanish, the most plausible first."""
    candidates: dict[Cycle, None] = {}
    for name, monitor in active:
        for steps in _edits(cycle, name, monitor.where):
            try:
                edited = Cycle(tuple(ModeSequence(_merge(phases), impact) for phases, impact in steps))
            except ValueError:  # the edit contradicts itself
                continue
            candidates[edited] = None
    candidates.pop(cycle, None)
    return list(candidates)


def halved_cycle(gait: Gait) -> Cycle | None:
    """The first half of a cycle that consists of the same steps twice; None of any other."""
    half, odd = divmod(len(gait.steps), 2)
    return None if odd or half % gait.repeats_after else Cycle(gait.problem.cycle.steps[:half])


def _edits(cycle: Cycle, name: MonitorKey, where: float) -> Iterator[Steps]:
    """Phases and impact of every step after an edit where the monitor ``name`` vanishes."""
    steps: Steps = [(step.phases, step.impact) for step in cycle.steps]
    if name.phase is None:
        following = (name.step + 1) % len(steps)
        for phases, impact in _impact_edits(steps[following][0], steps[name.step][1], name.kind):
            yield _changed(_changed(steps, following, phases=phases), name.step, impact=impact)
        return
    step = cycle.step_of(name.phase)
    own, previous = name.phase - cycle.first_phases[step], step - 1
    for phases in _phase_edits(steps[step][0], own, name.kind, where):
        yield _changed(steps, step, phases=phases)
    if name.kind == "duration" and own == 0 and steps[previous][1].slips:
        yield _changed(_changed(steps, step, phases=steps[step][0][1:]), previous, impact=Mode.STICK)


def _changed(steps: Steps, index: int, *, phases: Phases | None = None, impact: Mode | None = None) -> Steps:
    """The steps with the phases or the impact of one of them replaced."""
    changed = list(steps)
    changed[index] = (steps[index][0] if phases is None else phases, steps[index][1] if impact is None else impact)
    return changed


def _phase_edits(phases: Phases, own: int, kind: str, where: float) -> Iterator[Phases]:
    before, mode, after = phases[:own], phases[own], phases[own + 1 :]
    if kind == "duration":
        yield (*before, *after)
        return
    if kind in IMPACT_MARGINS:
        for struck in _strike_edits(after, kind):
            yield (*before, mode, *struck)
        return
    onset = MARGINS[kind].onset
    if onset is not None:
        slip = mode.with_contact(onset)
        for middle in _ordered(where, first=(slip, mode), inside=(mode, slip, mode), last=(mode, slip)):
            yield (*before, *middle, *after)
    elif kind in ("slip_velocity", "onset"):
        for rest in map(mode.with_contact, (Mode.STICK, Mode.slip(-mode.direction))):
            for middle in _ordered(where, first=(rest, mode), inside=(mode, rest, mode), last=(mode, rest)):
                yield (*before, *middle, *after)
        yield (*before, *after)


def _strike_edits(phases: Phases, kind: str) -> Iterator[Phases]:
    """Phases that follow the impact of a stop."""
    first, onset = phases[0], MARGINS[kind].onset
    if onset is not None:
        slip = first.with_contact(onset)
        yield phases if first is slip else (slip, *phases)
    elif kind in ("impact_slip_velocity", "impact_onset"):
        if len(phases) > 1 and phases[1].locked == first.locked:
            yield phases[1:]
        yield (first.with_contact(Mode.STICK), *phases[1:])


def _impact_edits(phases: Phases, impact: Mode, kind: str) -> Iterator[tuple[Phases, Mode]]:
    """Phases of the step that follows an impact, and the impact."""
    first, onset = phases[0], MARGINS[kind].onset
    if onset is not None:
        yield (phases if first.contact is onset else (first.with_contact(onset), *phases)), onset
    elif kind in ("impact_slip_velocity", "impact_onset"):
        yield phases[1:], Mode.STICK
        yield phases, Mode.STICK
        yield (first.with_contact(Mode.slip(-impact.direction)), *phases[1:]), Mode.STICK


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


DISTANCES = (1e-5, 1e-4, 1e-3, 1e-2)
"""Distances past the event at which a successor is tried, in scales of the parameter."""
FIRST_STEPS = 5.0
"""First step on a new branch, in distances from the event: its new phase is short and changes fast."""
ACTIVE = 1e-5
"""Monitors below this, in natural units, vanish together with the one that was located."""
CLOSER, APPROACH = 1 / 16, 1 / 2
"""A successor at this part of the distance past the event is at most this part as far from the gait there: a branch
that begins like a square root comes four times closer, one beyond a jump does not come closer."""
SAME = 1e-9
"""Gaits this close are one: there the parameter does not act on the successor."""
NEARBY = 0.3
"""Largest distance between the gaits before and after: in scaled section coordinates, and of periods relatively."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """The successor of a mode sequence, or why there is none.

    ``length`` is a first arclength step on it; ``at`` is the gait at the event as located on the successor.
    """

    segment: Segment | None
    point: Point | None
    reason: str
    length: float = 0.0
    at: Point | None = None


def find_change(segment: Segment, event: Location) -> Change:
    """The branch that goes on from an event."""
    assert event.name is not None
    ahead = np.sign(event.point.curve_point.tangent[-1]) or 1.0
    candidates = successors(segment.cycle, _active(event.point, event.name))
    words = _words(event.name, segment.cycle)
    for side in (ahead, -ahead):
        for cycle in candidates:
            for distance in DISTANCES:
                offset = side * distance * segment.metric.span
                successor = _attempt(segment, event.point, cycle, offset)
                if successor is not None and _is_continuous(segment, event.point, *successor, offset):
                    vanished = len(cycle.phases) < len(segment.cycle.phases)
                    at = _seen_from_behind(*successor, event) if vanished else None
                    length = FIRST_STEPS * distance
                    return Change(segment=successor[0], point=successor[1], reason=words, length=length, at=at)
    if event.point.gait.dynamics.friction_drops and candidates:
        words = f"{words}, and the return map jumps: static friction is above kinetic friction"
    tried = " or ".join(map(str, candidates)) or "none"
    return Change(segment=None, point=None, reason=f"{words}; no mode sequence goes on from here (tried {tried})")


def alternatives(segment: Segment, point: Point, known: Sequence[Cycle]) -> Iterator[tuple[Segment, Point]]:
    """Gaits of all mode sequences but the ``known`` ones that begin at an event, on either side of it.

    Among them are cycles of the known sequences in turn: at a border collision the period may double.
    """
    candidates = [cycle for cycle in successors(segment.cycle, _active(point)) if cycle not in known]
    if len(known) == 2:
        candidates.append(in_turn(*known))
    for cycle in candidates:
        offsets = (side * distance * segment.metric.span for distance in DISTANCES for side in (1.0, -1.0))
        attempts = (_attempt(segment, point, cycle, offset) for offset in offsets)
        successor = next((attempt for attempt in attempts if attempt is not None), None)
        if successor is not None and halved_cycle(successor[1].gait) is None:
            yield successor


def in_turn(first: Cycle, second: Cycle) -> Cycle:
    """Both cycles one after the other; the phases of each still follow the impact that they follow in its own."""
    (*before, last_of_first), (*after, last_of_second) = first.steps, second.steps
    joint = ModeSequence(last_of_first.phases, last_of_second.impact)
    return Cycle((*before, joint, *after, ModeSequence(last_of_second.phases, last_of_first.impact)))


def _is_continuous(segment: Segment, point: Point, successor: Segment, far: Point, offset: float) -> bool:
    """Whether a successor comes closer to the gait at the event as the parameter does.

    Where friction drops at the onset of slip, the return map may jump at an event; a gait beyond the jump is none of
    this family, however near it lies.
    """
    if not point.gait.dynamics.friction_drops:
        return True
    closer = _attempt(segment, point, successor.cycle, offset * CLOSER)
    if closer is None:
        return False
    distances = [segment.metric.apart(other.gait.state, point.gait.state) for other in (closer[1], far)]
    return bool(distances[0] < max(APPROACH * distances[1], SAME))


def _active(point: Point, located: MonitorKey | None = None) -> list[tuple[MonitorKey, MonitorValue]]:
    """The located monitor, and those that vanish with it; the impact's first."""
    active = [
        (name, monitor) for name, monitor in point.monitors.items() if name == located or abs(monitor.value) < ACTIVE
    ]
    return sorted(active, key=lambda pair: pair[0].phase is not None)


@overflow_allowed()
def _attempt(segment: Segment, point: Point, cycle: Cycle, offset: float) -> tuple[Segment, Point] | None:
    """The successor at a distance past the event, if it holds there."""
    value = point.value + offset
    dynamics = Dynamics(point.gait.system, segment.p).at({segment.parameter: value})
    states = _start_states(segment, point, cycle, offset, dynamics)
    try:
        problem = with_cycle(segment.problem, point.gait.system, cycle, states[0])
    except ProblemError:  # the state contradicts the impact
        return None
    period = float(point.curve_point.at.w[-1 - segment.transcription.n_phases : -1].sum())
    rolled = roll_out(dynamics, cycle, states, longest=(1 + NEARBY) * period)
    period *= len(cycle.steps) / len(segment.cycle.steps)
    if min(rolled.durations) <= 0 or abs(sum(rolled.durations) - period) > NEARBY * period:
        return None
    successor, w = segment_through(problem, dynamics, segment.parameter, segment.metric, rolled)
    first = successor.start(w, _forward(point, states[0], offset, w.size))
    if first is None or successor.metric.apart(first.gait.state, point.gait.state) >= NEARBY or not holds(first):
        return None
    return successor, first


def _seen_from_behind(segment: Segment, point: Point, event: Location) -> Point | None:
    """The gait at which the successor begins, where the phase has vanished on the other side.

    A slip from rest is over when v / t = 0, which rounding decides in a phase of no duration: of the duration only half
    the digits are left there. The margin of the phase that takes its place has them all.
    """
    slope = point.curve_point.tangent[-1]
    length = 2 * (event.point.value - point.value) / slope if slope else 0.0
    behind = segment.step(point, length) if length else None
    if behind is None:
        return None
    lost = [name for name in behind.monitors if behind.monitor(name) <= 0 < point.monitor(name)]
    zeros = [locate(segment, point, behind, length, partial(Point.monitor, name=name), name) for name in lost]
    nearest = min(zeros, key=lambda location: abs(location.length), default=None)
    return nearest.point if nearest is not None and nearest.status == "converged" else None


def with_cycle(problem: Problem, system: HybridSystem, cycle: Cycle, state: Array) -> Problem:
    """A problem with other modes, and a state after impact as its guess."""
    names = system.walker.section_names(slipping=cycle.impact.slips)
    guess = {f"gait.guess.state.{name}": float(state[system.state_names.index(name)]) for name in names}
    return problem.replace({**{f"gait.{key}": value for key, value in cycle_data(cycle).items()}, **guess})


def _start_states(segment: Segment, point: Point, cycle: Cycle, offset: float, dynamics: Dynamics) -> Array:
    """States after the impacts before the steps of the successor, (k, n_z): along the old branch, through new impacts.

    Of a cycle with another number of steps it is the first one alone.
    """
    slope = point.curve_point.tangent[-1]
    w = point.curve_point.at.w + point.curve_point.tangent * (offset / slope if slope else 0.0)
    nodes, ends = segment.transcription.unpack(w).nodes, segment.transcription.layout.impact_nodes
    count = len(cycle.steps) if len(cycle.steps) == len(segment.cycle.steps) else 1
    states = []
    for step in range(count):
        impact = cycle.impacts[step - 1]
        state = nodes[:, (ends[step - 1] + 1) % nodes.shape[1]]
        if impact is not segment.cycle.impacts[step - 1]:
            state = dynamics.after_impact(impact, nodes[:, ends[step - 1]])
            if impact.sticks:
                state[-1] = 0.0
        states.append(state)
    return np.array(states)


def _forward(point: Point, state: Array, offset: float, n_w: int) -> Array:
    """From the event towards the successor, as far as the two can be compared: state after impact and parameter."""
    forward = np.zeros(n_w)
    forward[: state.size] = state - point.gait.state
    forward[-1] = offset
    return forward


def holds(point: Point) -> bool:
    """Whether all monitors of a gait hold and the simulator walks it."""
    return all(monitor.value > 0 for monitor in point.monitors.values()) and confirm(point.gait).passed


def _words(name: MonitorKey, cycle: Cycle) -> str:
    if name.phase is None:
        return MARGINS[name.kind].lost
    place = cycle.phase_words(name.phase)
    return f"{place} shrinks to nothing" if name.kind == "duration" else f"{place}: {MARGINS[name.kind].lost}"


DISTANCES_RESCUE = (1e-4, 1e-3, 1e-2)
"""Distances from the last point at which IPOPT is tried, in scales of the parameter."""


def rescue(segment: Segment, point: Point) -> tuple[Segment, Point] | None:
    """A gait of the same mode sequence past a point at which Newton's method fails, if IPOPT finds one close by."""
    system, ahead = point.gait.system, float(np.sign(point.curve_point.tangent[-1])) or 1.0
    for distance in DISTANCES_RESCUE:
        value = point.value + ahead * distance * segment.metric.span
        try:
            problem = with_cycle(segment.problem, system, segment.cycle, point.gait.state)
            gait = solve_gait(problem.replace({segment.parameter: value}), system)
        except ProblemError:  # beyond what the problem allows
            return None
        if not gait.steps or segment.metric.apart(gait.state, point.gait.state) > NEARBY:
            continue
        durations = [duration for _, duration in gait.phases]
        rolled = roll_out(gait.dynamics, segment.cycle, gait.state, durations)
        further, w = segment_through(segment.problem, gait.dynamics, segment.parameter, segment.metric, rolled)
        forward = np.zeros(w.size)
        forward[-1] = ahead
        rescued = further.start(w, forward)
        if rescued is not None and all(monitor.value > 0 for monitor in rescued.monitors.values()):
            return further, rescued
    return None
