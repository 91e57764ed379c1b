"""Which mode sequences can follow where one ends: local edits that the physics of the event allows.

    cone reached while sticking       a slip is inserted there
    slip comes to rest                a stick or the opposite slip is inserted there
    slip starts without acceleration  a stick is put before it, or it is left out
    (or, with two coefficients, at the edge of the static cone)
    phase of no duration              it is left out, equal neighbours merge
    impulse on the edge of its cone   the impact slips, and so does the first phase
    slip after impact fades           the impact sticks, with or without the first slip
    (or its impulse comes back to the static cone)

They are proposals, the most plausible first; solving and simulating decides.
"""

from collections.abc import Iterable, Iterator

from gaitopt.families.monitors import MonitorKey, MonitorValue
from gaitopt.gait import Gait
from gaitopt.mechanics import MARGINS, Cycle, Mode, ModeSequence
from gaitopt.mechanics.margins import IMPACT_MARGINS

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
