"""Mode sequences: the phases of a step with its final impact, and the steps after which a gait repeats.

A phase ends when a margin falls to zero, at an unknown time. A *timed* phase ends at a breakpoint of the control law,
at a known time since the impact: the torques jump there, and the foot can no longer stay in its mode.
"""

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import Any, TypeVar

from gaitopt.model.modes import FOOT, IMPACT, OFF, Mode
from gaitopt.threads import cached_property

T = TypeVar("T")
BREAKPOINT = "breakpoint"
"""The event that ends a timed phase."""
UNTIL = "until"
"""Key of a timed phase in JSON: ``{"mode": "stick", "until": "breakpoint"}``."""


def mode_words(phases: Iterable[Mode], timed: Iterable[int] = ()) -> str:
    """A text with the modes in order, and stops that change: ``stick (knee free), stick (knee locked), slip_backward``.

    Phases with the indices ``timed`` are marked: ``stick (until breakpoint), slip_backward``.
    """
    texts, stops, marked = list[str](), Mode.STICK.stops, {*timed}
    for k, mode in enumerate(phases):
        remarks = [f"{name} {state}" for name, state in mode.stops.items()] if mode.stops != stops else []
        remarks += [f"{UNTIL} {BREAKPOINT}"] if k in marked else []
        texts.append(f"{mode.contact.brief} ({', '.join(remarks)})" if remarks else mode.contact.brief)
        stops = mode.stops
    return ", ".join(texts)


def ended_slips(mode: Mode, after: Mode) -> tuple[str, ...]:
    """The contacts that slip in a mode, and rest or slip in the other direction in the mode ``after``."""
    slipping = (name for name, direction in mode.directions.items() if direction and name in after.touching)
    return tuple(name for name in slipping if after.directions[name] != mode.directions[name])


@dataclass(frozen=True, slots=True)
class ModeSequence:
    """The phases of one step in order, and the impact that ends it.

    Attributes
    ----------
    phases : modes of the phases.
    impact : the mode just after the impact; if the step ends without an impact, the contacts of its last phase.
    timed : indices of the timed phases, ascending.
    landings : for every phase that begins with the landing of a contact within the step, its index and the mode just
        after that impact, see ``Mode.swaps``.

    Raises
    ------
    ValueError
        If there is no phase, if two neighbours without a landing between them are equal, or if a flight of a foot does
        not end with an impact.
    """

    phases: tuple[Mode, ...]
    impact: Mode
    timed: tuple[int, ...] = ()
    landings: tuple[tuple[int, Mode], ...] = ()

    def __post_init__(self) -> None:
        if not self.phases:
            raise ValueError("a step needs at least one phase: stick, slip_forward, slip_backward or flight")
        landed = {k for k, _ in self.landings}
        for k, (first, second) in enumerate(pairwise(self.phases), start=1):
            if k in landed:
                continue
            if first is second:
                raise ValueError(f"phases {k} and {k + 1} are both {first}: merge them into one")
            if second.touching and not first.touching:
                raise ValueError(f"phase {k} is a flight: it ends with the impact of the step, not with {second}")

    def __str__(self) -> str:
        swaps = [k for k, landed in self.landings if landed.swaps]
        swings = [self.phases[i:k] for i, k in pairwise([0, *swaps, len(self.phases)])]
        if len(swings) == 1:
            return f"{mode_words(self.phases, self.timed)}; {self.impact.brief}"
        landed = [dict(self.landings)[k].brief for k in swaps]
        texts = [f"{mode_words(swing)} ({impact})" for swing, impact in zip(swings[:-1], landed, strict=True)]
        return f"{', '.join([*texts, mode_words(swings[-1])])}; {self.impact.brief}"


@dataclass(frozen=True)
class Cycle:
    """The steps of one cycle of a gait; phases are numbered through all steps.

    Raises
    ------
    ValueError
        If there is no step, or if a slipping impact is not followed by the same slip.
    """

    steps: tuple[ModeSequence, ...]

    def __post_init__(self) -> None:
        if not self.steps:
            raise ValueError("a cycle needs at least one step")
        for phase, first in enumerate(self.phases):
            impact = self.impact_before(phase)
            if impact is None:
                continue
            for name, word in impact.contacts.items():
                if impact.directions[name] and first.contacts.get(name) not in (word, OFF):
                    who, follows = ("the foot", "first") if name == FOOT else (name, "next")
                    raise ValueError(
                        f"after an impact with {impact} {who} is already slipping: "
                        f"the {follows} phase must be {impact}, not {first}"
                    )

    @classmethod
    def of_one_step(cls, phases: tuple[Mode, ...], impact: Mode) -> "Cycle":
        """The cycle of a gait that repeats after every step."""
        return cls((ModeSequence(phases, impact),))

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "Cycle":
        """The cycle in the record of a gait, or of one side of a mode change; a phase may be a mapping or a text."""
        steps = list[ModeSequence]()
        for step in record.get("steps", (record,)):
            phases = [phase if isinstance(phase, Mapping) else {"mode": phase} for phase in step["phases"]]
            timed = (k for k, phase in enumerate(phases) if UNTIL in phase)
            modes = [Mode.from_record({key: v for key, v in phase.items() if key != IMPACT}) for phase in phases]
            struck = ((k, phase[IMPACT]) for k, phase in enumerate(phases) if IMPACT in phase)
            landings = [(k, modes[k].after_impact(after)) for k, after in struck]
            steps.append(ModeSequence(tuple(modes), Mode.from_record(step["impact"]), tuple(timed), tuple(landings)))
        return cls(tuple(steps))

    @cached_property
    def timed(self) -> tuple[int, ...]:
        """Indices of the timed phases of all steps, ascending."""
        firsts = zip(self.first_phases, self.steps, strict=True)
        return tuple(first + phase for first, step in firsts for phase in step.timed)

    def with_timed(self, timed: Iterable[int]) -> "Cycle":
        """The same modes, with other timed phases."""
        indices = sorted(timed)
        if indices == [*self.timed]:
            return self
        of_step = [[k - self.first_phases[s] for k in indices if self.step_of(k) == s] for s in range(len(self.steps))]
        return Cycle(tuple(replace(step, timed=tuple(t)) for step, t in zip(self.steps, of_step, strict=True)))

    @property
    def untimed(self) -> "Cycle":
        """The same modes without timed phases, as a problem states them."""
        return self.with_timed(())

    @cached_property
    def phases(self) -> tuple[Mode, ...]:
        """Modes of all phases in order."""
        return tuple(mode for step in self.steps for mode in step.phases)

    @property
    def impacts(self) -> tuple[Mode, ...]:
        """The mode just after the impact of each step."""
        return tuple(step.impact for step in self.steps)

    @property
    def impact(self) -> Mode:
        """The impact that ends the cycle."""
        return self.steps[-1].impact

    @cached_property
    def first_phases(self) -> tuple[int, ...]:
        """Index of the first phase of every step."""
        return tuple(accumulate((len(step.phases) for step in self.steps[:-1]), initial=0))

    @cached_property
    def swings(self) -> tuple[int, ...]:
        """For every phase, how often the feet have swapped roles before it, at the end of steps and within them."""
        within = (
            (first, k)
            for first, step in zip(self.first_phases, self.steps, strict=True)
            for k, landed in step.landings
            if landed.swaps
        )
        starts = {*self.first_phases[1:], *(first + k for first, k in within)}
        return tuple(accumulate(phase in starts for phase in range(len(self.phases))))

    def step_of(self, phase: int) -> int:
        """Index of the step of a phase."""
        return bisect_right(self.first_phases, phase) - 1

    def per_phase(self, per_step: Sequence[T]) -> tuple[T, ...]:
        """One entry per phase from one entry per step; entries repeat if the cycle has more steps."""
        return tuple(per_step[self.step_of(phase) % len(per_step)] for phase in range(len(self.phases)))

    def after(self, phase: int) -> Mode | None:
        """Mode of the next phase of the step; None if the step ends with its impact."""
        following = phase + 1
        return None if following == len(self.phases) or following in self.first_phases else self.phases[following]

    def reset_after(self, phase: int) -> Mode | None:
        """The impact that ends a phase, of the foot or of a stop that locks; None if the state is continuous there."""
        return self._resets_after[phase]

    @cached_property
    def _resets_after(self) -> tuple[Mode | None, ...]:
        resets = list[Mode | None]()
        for phase, mode in enumerate(self.phases):
            after, step = self.after(phase), self.step_of(phase)
            landed = dict(self.steps[step].landings).get(phase + 1 - self.first_phases[step])
            if after is None:
                resets.append(self.steps[step].impact)
            else:
                resets.append(after if landed is None and after.locked != mode.locked else landed)
        return tuple(resets)

    def impact_before(self, phase: int) -> Mode | None:
        """The impact before a phase, for the first one that of the last step; None if the state is continuous there."""
        return self.reset_after((phase - 1) % len(self.phases))

    def stop_together(self, phase: int) -> tuple[str, ...]:
        """The contacts whose slips all end at the end of a phase, if there are several and no contact lands there."""
        mode, after = self.phases[phase], self.after(phase)
        if after is None or self.reset_after(phase) is not None:
            return ()
        stopped = ended_slips(mode, after)
        return stopped if len(stopped) > 1 else ()

    @cached_property
    def resets(self) -> tuple[tuple[int, Mode], ...]:
        """The phases after which the state is mapped to another one, each with the mode just after that.

        Either the phase ends with an impact, or several slips end at once.
        """
        pairs = (
            (phase, self.phases[phase + 1] if self.stop_together(phase) else self.reset_after(phase))
            for phase in range(len(self.phases))
        )
        return tuple((phase, reset) for phase, reset in pairs if reset is not None)

    @property
    def landed(self) -> list[Mode]:
        """The modes just after the impacts of named contacts within the steps, in order."""
        return [mode for step in self.steps for _, mode in step.landings]

    def phase_words(self, phase: int) -> str:
        """A text with the number of a phase within its step, its mode and, in a cycle of several steps, its step."""
        step = self.step_of(phase)
        text = f"phase {phase - self.first_phases[step] + 1} ({self.phases[phase].brief})"
        return text if len(self.steps) == 1 else f"step {step + 1}, {text}"

    def onset_order(self, phase: int, contact: str = FOOT, *, jump: bool = False) -> int:
        """Order of the zero of the slip velocity of a contact at the start of a slip phase.

        It is 0 if the contact slips already. It is 1 if the contact leaves rest with an acceleration: just after a
        sticking impact, in a reversal, after a timed stick, or when another contact comes to rest. After any other
        stick the contact starts at the edge of its friction cone with zero velocity and acceleration, so that it is 2;
        but it is 1 if friction drops at the onset of slip (``jump``).
        """
        impact = self.impact_before(phase)
        if impact is not None:
            return int(contact in impact.touching and not impact.directions[contact])
        before, mode = self.phases[phase - 1], self.phases[phase]
        if mode.directions[contact] and before.directions[contact] == mode.directions[contact]:
            return 0
        others = (n for n, s in before.directions.items() if s and n != contact and mode.directions[n] != s)
        gentle = (
            contact in before.touching and not before.directions[contact] and not jump and phase - 1 not in self.timed
        )
        return 2 if gentle and not any(name in mode.touching for name in others) else 1

    def starts_from_rest(self, phase: int) -> tuple[str, ...]:
        """The contacts that begin to slip from rest with a force beyond the cone, as after an impact or a reversal."""
        slipping = (name for name, direction in self.phases[phase].directions.items() if direction)
        return tuple(name for name in slipping if self.onset_order(phase, name) == 1)

    def __str__(self) -> str:
        return " | ".join(map(str, self.steps))
