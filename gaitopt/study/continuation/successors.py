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

from gaitopt.mechanics import Mode, ModeSequence
from gaitopt.study.continuation.monitors import Name, Reading

EDGE = 0.02
"""Part of a phase at its ends within which an event is taken to be at the end."""

Phases = tuple[Mode, ...]


def successors(sequence: ModeSequence, active: Iterable[tuple[Name, Reading]]) -> list[ModeSequence]:
    """Sequences that may follow ``sequence`` where the ``active`` monitors vanish, the most plausible first."""
    found: dict[ModeSequence, None] = {}
    for name, reading in active:
        for phases, impact in _edits(sequence, name, reading.where):
            merged = _merge(phases)
            if _consistent(merged, impact):
                found[ModeSequence(merged, impact)] = None
    found.pop(sequence, None)
    return list(found)


def _edits(sequence: ModeSequence, name: Name, where: float) -> Iterator[tuple[Phases, Mode]]:
    phases, impact = sequence.phases, sequence.impact
    if name.phase is None:
        yield from _impact_edits(phases, impact, name.kind)
        return
    before, mode, after = phases[: name.phase], phases[name.phase], phases[name.phase + 1 :]
    if name.kind == "duration":
        yield (*before, *after), impact
        if name.phase == 0 and impact is not Mode.STICK:
            yield after, Mode.STICK
    elif name.kind.startswith("cone_"):
        slip = Mode.SLIP_FORWARD if name.kind == "cone_forward" else Mode.SLIP_BACKWARD
        for middle in _ordered(where, first=(slip, mode), inside=(mode, slip, mode), last=(mode, slip)):
            yield (*before, *middle, *after), impact
    elif name.kind in ("slip_velocity", "onset"):
        for rest in (Mode.STICK, Mode.slip(-mode.direction)):
            for middle in _ordered(where, first=(rest, mode), inside=(mode, rest, mode), last=(mode, rest)):
                yield (*before, *middle, *after), impact
        yield (*before, *after), impact


def _impact_edits(phases: Phases, impact: Mode, kind: str) -> Iterator[tuple[Phases, Mode]]:
    if kind.startswith("impulse_cone_"):
        slip = Mode.SLIP_FORWARD if kind == "impulse_cone_forward" else Mode.SLIP_BACKWARD
        yield (phases if phases[0] is slip else (slip, *phases)), slip
    elif kind in ("impact_slip", "impact_onset"):
        yield phases[1:], Mode.STICK
        yield phases, Mode.STICK
        yield (Mode.slip(-impact.direction), *phases[1:]), Mode.STICK


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


def _consistent(phases: Phases, impact: Mode) -> bool:
    return bool(phases) and (impact is Mode.STICK or phases[0] is impact)
