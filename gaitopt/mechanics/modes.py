"""Modes: what the foot, the joint stops and the switches do. On the ground the foot obeys the friction complementarity

    0 <= v_forward  _|_ mu f_n + f_t >= 0        0 <= v_backward  _|_ mu f_n - f_t >= 0

of which a mode says which factor of each pair is zero; in flight there is no force. Gamus & Or (2013), eqs (4), (5).
"""

import re
from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import accumulate, pairwise
from typing import Any, ClassVar

from pydantic_core import PydanticKnownError, core_schema


class Mode(str):
    """What the stance foot, the joint stops and the switches do; for an impact, what they do just after it.

    The text is ``stick``, ``slip_forward``, ``slip_backward`` or ``flight``; of a walker with stops or switches their
    states follow, as in ``stick, knee free`` or ``slip_forward, knee locked``. Equal modes are one object.

    Attributes
    ----------
    contact : what the foot does, as a mode without stops.
    stops : state of every stop and switch by its name, in order; not to be written to.
    free, locked : names of the stops in either state.
    off : names of the switches that are off.
    """

    STICK: ClassVar["Mode"]
    SLIP_FORWARD: ClassVar["Mode"]
    SLIP_BACKWARD: ClassVar["Mode"]
    FLIGHT: ClassVar["Mode"]
    contact: "Mode"
    stops: Mapping[str, str]
    free: tuple[str, ...]
    locked: tuple[str, ...]
    off: tuple[str, ...]

    def __new__(cls, text: str) -> "Mode":
        """The mode with this text.

        Raises
        ------
        ValueError
            If it is not what a foot can do, followed by names of stops that are free or locked.
        """
        if text not in _MODES:
            contact, *stops = text.split(", ")
            states = dict(stop.rpartition(" ")[::2] for stop in stops)
            if contact not in _DIRECTIONS or any(state not in STATES for state in states.values()):
                raise ValueError(f"{text!r} is no mode: a foot can {', '.join(_DIRECTIONS)}")
            mode = super().__new__(cls, text)
            mode.contact = Mode(contact) if stops else mode
            mode.stops = states
            mode.free, mode.locked, mode.off, _ = (
                tuple(name for name in states if states[name] == own) for own in STATES
            )
            _MODES[text] = mode
        return _MODES[text]

    @classmethod
    def of(cls, contact: str, stops: Mapping[str, str]) -> "Mode":
        """What a foot does, with the state of every stop and switch."""
        return cls(", ".join([contact.partition(",")[0], *(f"{name} {state}" for name, state in stops.items())]))

    @staticmethod
    def slip(direction: float) -> "Mode":
        """The slipping mode, without stops, whose slip velocity has the sign of ``direction``."""
        return Mode.SLIP_FORWARD if direction > 0 else Mode.SLIP_BACKWARD

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> core_schema.CoreSchema:
        """In problem files: a word, or ``{mode: stick, knee: free}`` for a walker with stops."""
        return core_schema.no_info_before_validator_function(_read, core_schema.is_instance_schema(cls))

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: Any, handler: Any) -> dict[str, Any]:
        """Both forms."""
        word = {"type": "string", "enum": list(_DIRECTIONS)}
        state = {"type": "string", "enum": list(STATES)}
        stops = {"type": "object", "properties": {"mode": word}, "required": ["mode"], "additionalProperties": state}
        return {"anyOf": [word, stops]}

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "Mode":
        """The mode of a phase in JSON."""
        return cls.of(record["mode"], {name: state for name, state in record.items() if state in STATES})

    @property
    def record(self) -> dict[str, str]:
        """As in JSON: ``mode``, and the state of every stop by its name."""
        return {"mode": str(self.contact), **self.stops}

    @property
    def data(self) -> str | dict[str, str]:
        """As in a problem file: a word, or a mapping where there are stops."""
        return self.record if self.stops else str(self)

    @property
    def key(self) -> str:
        """The text as part of an identifier."""
        return re.sub(r"\W+", "_", self)

    @property
    def direction(self) -> int:
        """Sign of the slip velocity: +1 downhill, -1 uphill, 0 in stick and in flight."""
        return _DIRECTIONS[self.contact]

    @property
    def sticks(self) -> bool:
        """Whether the foot is held by friction."""
        return self.contact is Mode.STICK

    @property
    def flies(self) -> bool:
        """Whether no foot touches the ground."""
        return self.contact is Mode.FLIGHT

    @property
    def slips(self) -> bool:
        """Whether the foot slips."""
        return self.direction != 0

    def with_contact(self, contact: "Mode") -> "Mode":
        """Another contact with the same states of the stops."""
        return Mode.of(contact, self.stops)

    def with_next(self, name: str) -> "Mode":
        """The same contact after a stop has locked, or a switch has been thrown."""
        return Mode.of(self, {**self.stops, name: NEXT_STATE[self.stops[name]]})

    def has(self, state: str) -> bool:
        """Whether ``contact`` (a foot on the ground), or a state such as ``knee free``, is part of it."""
        name, _, value = state.partition(" ")
        return self.stops.get(name) == value if value else not self.flies


def _read(data: object) -> Mode:
    """A mode from a problem file."""
    contact, stops = (
        (data.get("mode"), {k: v for k, v in data.items() if k != "mode"}) if isinstance(data, dict) else (data, {})
    )
    for value, allowed in [(contact, _DIRECTIONS), *((state, STATES) for state in stops.values())]:
        if value not in tuple(allowed):
            raise PydanticKnownError("literal_error", {"expected": " or ".join(map(repr, map(str, allowed)))})
    return Mode.of(str(contact), stops)


STOP_STATES, SWITCH_STATES = ("free", "locked"), ("off", "on")
STATES = (*STOP_STATES, *SWITCH_STATES)
NEXT_STATE = dict((STOP_STATES, SWITCH_STATES))
_DIRECTIONS = {"stick": 0, "slip_forward": 1, "slip_backward": -1, "flight": 0}
_MODES: dict[str, Mode] = {}
Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD, Mode.FLIGHT = map(Mode, _DIRECTIONS)
CONTACTS = (Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD)
"""What a foot on the ground can do."""


class ImpactLaw(StrEnum):
    """Tangential law of a slipping impact: eq. (11), or no tangential impulse at all."""

    COULOMB = "coulomb"
    FRICTIONLESS = "frictionless"


def in_words(phases: Iterable[Mode]) -> str:
    """Modes in order; stops are named where they change: ``stick (knee free), stick (knee locked), slip_backward``."""
    words, stops = list[str](), Mode.STICK.stops
    for mode in phases:
        named = ", ".join(f"{name} {state}" for name, state in mode.stops.items())
        words.append(str(mode.contact) if mode.stops == stops else f"{mode.contact} ({named})")
        stops = mode.stops
    return ", ".join(words)


@dataclass(frozen=True, slots=True)
class ModeSequence:
    """The phases of one step in order, and the impact that ends it.

    Raises
    ------
    ValueError
        If there is no phase, or if two neighbours are equal.
    """

    phases: tuple[Mode, ...]
    impact: Mode

    def __post_init__(self) -> None:
        if not self.phases:
            raise ValueError("a step needs at least one phase: stick, slip_forward, slip_backward or flight")
        for k, (first, second) in enumerate(pairwise(self.phases), start=1):
            if first is second:
                raise ValueError(f"phases {k} and {k + 1} are both {first}: merge them into one")
            if first.flies and not second.flies:
                raise ValueError(f"phase {k} is a flight: it ends with the impact of the step, not with {second}")

    def __str__(self) -> str:
        return f"{in_words(self.phases)}; {self.impact}"


@dataclass(frozen=True, slots=True)
class Cycle:
    """The steps after which a gait repeats itself; phases are counted through all of them.

    Raises
    ------
    ValueError
        If there is no step, or if a slipping impact is not followed by the same slip.
    """

    steps: tuple[ModeSequence, ...]

    def __post_init__(self) -> None:
        if not self.steps:
            raise ValueError("a cycle needs at least one step")
        for phase in self.first_phases:
            impact, first = self.impact_before(phase), self.phases[phase]
            if impact is not None and impact.slips and first.contact is not impact.contact:
                raise ValueError(
                    f"after an impact with {impact} the foot is already slipping: "
                    f"the first phase must be {impact}, not {first}"
                )

    @classmethod
    def of_one_step(cls, phases: tuple[Mode, ...], impact: Mode) -> "Cycle":
        """The cycle of a gait that repeats itself after every step."""
        return cls((ModeSequence(phases, impact),))

    @property
    def phases(self) -> tuple[Mode, ...]:
        """Modes of all phases in order."""
        return tuple(mode for step in self.steps for mode in step.phases)

    @property
    def impacts(self) -> tuple[Mode, ...]:
        """What the colliding foot does just after the impact of each step."""
        return tuple(step.impact for step in self.steps)

    @property
    def impact(self) -> Mode:
        """The impact that ends the cycle."""
        return self.steps[-1].impact

    @property
    def first_phases(self) -> tuple[int, ...]:
        """Index of the first phase of every step."""
        return tuple(accumulate((len(step.phases) for step in self.steps[:-1]), initial=0))

    def step_of(self, phase: int) -> int:
        """Index of the step to which a phase belongs."""
        return bisect_right(self.first_phases, phase) - 1

    def after(self, phase: int) -> Mode | None:
        """Mode of the phase that follows within the step; None where the step ends with its impact."""
        following = phase + 1
        return None if following == len(self.phases) or following in self.first_phases else self.phases[following]

    def reset_after(self, phase: int) -> Mode | None:
        """The impact with which a phase ends: of the foot, or of a stop that locks; None where nothing jumps."""
        after = self.after(phase)
        if after is None:
            return self.steps[self.step_of(phase)].impact
        return after if after.locked != self.phases[phase].locked else None

    def impact_before(self, phase: int) -> Mode | None:
        """The impact with which a phase begins, that of the last step before the first; None where nothing jumps."""
        return self.reset_after((phase - 1) % len(self.phases))

    @property
    def resets(self) -> tuple[tuple[int, Mode], ...]:
        """Every phase that an impact ends, with that impact."""
        pairs = ((phase, self.reset_after(phase)) for phase in range(len(self.phases)))
        return tuple((phase, reset) for phase, reset in pairs if reset is not None)

    def phase_words(self, phase: int) -> str:
        """Which phase this is: its number within its step, its mode, and in a cycle of several steps its step."""
        step = self.step_of(phase)
        words = f"phase {phase - self.first_phases[step] + 1} ({self.phases[phase]})"
        return words if len(self.steps) == 1 else f"step {step + 1}, {words}"

    def onset_order(self, phase: int, *, jump: bool = False) -> int:
        """Order of the zero that the slip velocity has where a slip phase starts.

        0 where the foot slips already, 1 where it leaves rest with an acceleration (just after a sticking impact, or
        in a reversal), 2 at the edge of the friction cone after a stick, where velocity and acceleration are zero;
        1 there as well where friction drops at the onset of slip (``jump``).
        """
        impact = self.impact_before(phase)
        if impact is not None:
            return int(impact.sticks)
        return 2 if self.phases[phase - 1].sticks and not jump else 1

    def starts_from_rest(self, phase: int) -> bool:
        """Whether a slip phase starts from rest at a force beyond the friction cone: after an impact, or reversed."""
        return self.phases[phase].slips and self.onset_order(phase) == 1

    def __str__(self) -> str:
        return " | ".join(map(str, self.steps))
