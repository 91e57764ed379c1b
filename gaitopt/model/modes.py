"""Modes: the states of the contacts, the joint stops and the switches.

A contact on the ground obeys the friction complementarity, where v_forward - v_backward is its slip velocity:

    0 <= v_forward  _|_ mu f_n + f_t >= 0        0 <= v_backward  _|_ mu f_n - f_t >= 0

A mode states which factor of each pair is zero. A contact that is off has no force. Gamus & Or (2013), eqs (4), (5).

A walker that stands on one foot at a time has two contacts, ``foot`` and ``swing_foot``, which swap places when the
swing foot lands. Its modes have a short form: ``stick`` is ``{foot: stick, swing_foot: off}``; in ``flight`` both are
off. All other modes name each contact.
"""

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, ClassVar

from pydantic_core import core_schema

FOOT = "foot"
"""The contact on the ground of a walker that stands on one foot at a time. It is at the base point (x, y)."""
SWING_FOOT = "swing_foot"
"""The contact of such a walker that will land and then become the ``foot``."""
OFF = "off"
"""State of a contact without a force."""
STOP_STATES, SWITCH_STATES = ("free", "locked"), ("off", "on")
STATES = (*STOP_STATES, *SWITCH_STATES)
NEXT_STATE = dict((STOP_STATES, SWITCH_STATES))
_FLIGHT = "flight"
_DIRECTIONS = {"stick": 0, "slip_forward": 1, "slip_backward": -1, _FLIGHT: 0}
NAMED = {"stick": 0, "slip_forward": 1, "slip_backward": -1, OFF: 0}
"""States of a contact."""
LEAVES = "leaves"
"""In problem files, the state of a contact that touches the ground before an impact and is off after it."""
IMPACT = "impact"
"""Key of a phase that begins with an impact: the states of the contacts just after it."""
FEET, SWAPPED = "feet", "swapped"
"""Key and value in the states of named contacts just after an impact within a cycle, if the feet swap roles in it. The
contacts then have the names that they have after it."""
_AFTER_IMPACT = (*(state for state in NAMED if state != OFF), LEAVES)


class Mode(str):
    """The states of the contacts, the joint stops and the switches; of an impact, those just after it.

    The text is ``stick``, ``slip_forward``, ``slip_backward`` or ``flight`` if the walker stands on one foot at a time,
    and such as ``left: stick, right: off`` if it has several contacts. The states of stops and switches follow, if it
    has any: ``stick, knee free`` or ``slip_forward, knee locked``. Equal modes are one object.

    Attributes
    ----------
    contact : the states of the contacts, as a mode without stops.
    contacts : state of every contact by name, in order. Read-only.
    touching : names of the contacts that touch the ground, in order.
    directions : sign of the slip velocity of every contact by name: +1 downhill, -1 uphill, 0 if it does not slip.
        Read-only.
    sticks, slips : whether friction holds all contacts on the ground, and whether one of them slips.
    swaps : for an impact within a cycle, whether the feet swap roles in it; each then has the other's name.
        If the walker stands on one foot at a time, they do so whenever a foot lands.
    fixes_x : whether the foot at the base point sticks, so that dx is zero.
    direction : sign of the slip velocity of the foot at the base point; 0 if the base point is not a foot.
    stops : state of every stop and switch by name, in order. Read-only.
    free, locked : names of the stops in either state.
    off : names of the switches that are off.
    key : the text as part of an identifier.
    """

    STICK: ClassVar["Mode"]
    SLIP_FORWARD: ClassVar["Mode"]
    SLIP_BACKWARD: ClassVar["Mode"]
    FLIGHT: ClassVar["Mode"]
    contact: "Mode"
    contacts: Mapping[str, str]
    touching: tuple[str, ...]
    directions: Mapping[str, int]
    sticks: bool
    slips: bool
    swaps: bool
    fixes_x: bool
    direction: int
    stops: Mapping[str, str]
    free: tuple[str, ...]
    locked: tuple[str, ...]
    off: tuple[str, ...]
    key: str

    def __new__(cls, text: str) -> "Mode":
        """The mode with this text.

        Raises
        ------
        ValueError
            If the text is not the state of a foot or of named contacts, followed by names of stops and switches with
            their states.
        """
        if text not in _MODES:
            first, *others = entries = text.split(", ")
            named = [entry.partition(": ") for entry in entries if ": " in entry]
            stops = entries[len(named) :] if named else others
            contacts = {name: word for name, _, word in named}
            is_unique, swaps = len(contacts) == len(named), contacts.get(FEET) == SWAPPED
            if swaps:
                del contacts[FEET]
            allowed, states = NAMED if named else _DIRECTIONS, dict(stop.rpartition(" ")[::2] for stop in stops)
            strange = any(word not in allowed for word in contacts.values() or [first])
            if strange or any(state not in STATES for state in states.values()) or not is_unique:
                what = f"a contact can {', '.join(allowed)}" if named else f"a foot can {', '.join(allowed)}"
                raise ValueError(f"{text!r} is not a mode: {what}")
            mode = super().__new__(cls, text)
            of_contacts = [entry for entry in entries[: len(entries) - len(stops)] if entry != f"{FEET}: {SWAPPED}"]
            mode.contact = Mode(", ".join(of_contacts)) if len(of_contacts) < len(entries) else mode
            mode.contacts = contacts or {FOOT: OFF if first == _FLIGHT else first, SWING_FOOT: OFF}
            mode.touching = tuple(name for name, word in mode.contacts.items() if word != OFF)
            mode.directions = {name: NAMED[word] for name, word in mode.contacts.items()}
            mode.direction = 0 if named else mode.directions[FOOT]
            mode.slips = any(mode.directions.values())
            mode.sticks = bool(mode.touching) and not mode.slips
            mode.fixes_x = mode.sticks and not named
            mode.stops, mode.key = states, re.sub(r"\W+", "_", text)
            mode.free, mode.locked, mode.off, _ = (
                tuple(name for name in states if states[name] == state) for state in STATES
            )
            mode.swaps = swaps or not (named or mode.locked)
            _MODES.setdefault(text, mode)  # unless another thread has just made it
        return _MODES[text]

    def __reduce__(self) -> tuple[type["Mode"], tuple[str]]:
        """Copies and pickles are the same object."""
        return Mode, (str(self),)

    @classmethod
    def of(cls, contact: str, stops: Mapping[str, str]) -> "Mode":
        """The mode with a state of the foot, and a state of every stop and switch."""
        return _joined(contact, *stops.items())

    @classmethod
    def of_contacts(cls, contacts: Mapping[str, str]) -> "Mode":
        """The mode with a state of every named contact."""
        return cls(", ".join(f"{name}: {word}" for name, word in contacts.items()))

    @classmethod
    def of_feet(cls, contacts: Mapping[str, str]) -> "Mode":
        """The mode with these states of ``foot`` and ``swing_foot``, in the short form if it has one."""
        word = str(contacts[FOOT])
        if contacts[SWING_FOOT] == OFF:
            return cls(_FLIGHT if word == OFF else word)
        return cls.of_contacts({FOOT: word, SWING_FOOT: contacts[SWING_FOOT]})

    @property
    def is_named(self) -> bool:
        """Whether the contacts are named; otherwise the mode has the short form."""
        return ": " in self

    @property
    def swapping(self) -> "Mode":
        """The impact within a cycle in which the feet swap roles, and after which the contacts have these states."""
        return Mode.of_contacts({**self.contacts, FEET: SWAPPED}) if self.is_named else self.contact

    def with_states(self, changed: Mapping[str, str]) -> "Mode":
        """Other states of some contacts, with the same stops and switches."""
        contacts = {**self.contacts, **changed}
        if self.is_named and self.swaps:
            return Mode.of_contacts(contacts).swapping
        return self.with_contact(Mode.of_contacts(contacts) if self.is_named else Mode.of_feet(contacts))

    @staticmethod
    def slip(direction: float) -> "Mode":
        """The slipping mode, without stops, whose slip velocity has the sign of ``direction``."""
        return Mode.SLIP_FORWARD if direction > 0 else Mode.SLIP_BACKWARD

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> core_schema.CoreSchema:
        """The sections of a problem hold modes: ``problem.gait_section``, which knows the walker, has read them."""
        return core_schema.is_instance_schema(cls)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: Any, handler: Any) -> dict[str, Any]:
        """The schema of all forms of a mode in a problem file."""
        word = {"type": "string", "enum": list(_DIRECTIONS)}
        description = "what contacts do just after an impact at the start of the phase, where that differs"
        touching = {
            "type": "object",
            "description": description,
            "properties": {FEET: {"type": "string", "enum": [SWAPPED, *_AFTER_IMPACT]}},
            "additionalProperties": {"type": "string", "enum": [*_AFTER_IMPACT]},
        }
        contacts = {
            "type": "object",
            "description": "what each named contact does; a contact that is left out is off",
            "properties": {IMPACT: touching},
            "additionalProperties": {"type": "string", "enum": list(NAMED)},
            "not": {"required": ["mode"]},
        }
        state = {"type": "string", "enum": list(STATES)}
        foot = {**word, "description": "what the stance foot does"}
        of_mode = {"anyOf": [foot, contacts]}
        landing = {"type": "string", "enum": [*CONTACTS], "description": "what a foot does that lands within the cycle"}
        keys = {"mode": of_mode, IMPACT: {"anyOf": [landing, touching]}}
        stops = {"type": "object", "properties": keys, "required": ["mode"], "additionalProperties": state}
        return {"anyOf": [word, stops, contacts]}

    @classmethod
    def from_record(cls, record: str | Mapping[str, Any]) -> "Mode":
        """The mode of a phase in JSON, of an impact, or with this text."""
        if isinstance(record, str):
            return cls(record)
        contact = record.get("mode", record)
        stops = {name: state for name, state in record.items() if name != "mode" and state in STATES}
        if not isinstance(contact, Mapping):
            return cls.of(contact, stops)
        return cls.of(cls.of_contacts(contact), stops if "mode" in record else {})

    def after_impact(self, record: str | Mapping[str, str]) -> "Mode":
        """The mode just after the impact with which a phase in this mode begins, from its record in JSON."""
        if isinstance(record, str):
            return Mode(record)
        after = self.with_states({name: record.get(name, OFF) for name in self.contacts})
        return after.swapping if record.get(FEET) == SWAPPED else after

    @property
    def held(self) -> "Mode":
        """The mode in which all contacts on the ground stick; a single foot sticks even if it flies in this mode."""
        return self.with_states(dict.fromkeys(self.touching if self.is_named else (FOOT,), Mode.STICK))

    @property
    def brief(self) -> str:
        """The text, without the contacts that are off: ``heel stick + toe slip_forward``."""
        if not self.is_named:
            return str(self)
        return " + ".join(f"{name} {self.contacts[name]}" for name in self.touching) or str(Mode.FLIGHT)

    @property
    def words(self) -> str | dict[str, str]:
        """The contacts in JSON: the state of a foot, or a mapping from named contacts to their states."""
        if not self.is_named:
            return str(self.contact)
        return {**self.contacts, **({FEET: SWAPPED} if self.swaps else {})}

    @property
    def record(self) -> dict[str, Any]:
        """The mode in JSON: ``mode``, and the state of every stop and switch by name."""
        return {"mode": self.words, **self.stops}

    @property
    def data(self) -> str | dict[str, Any]:
        """The mode in a problem file: the state of a foot, or a mapping for named contacts or stops."""
        return self.record if self.stops else self.words

    def begun_by(self, impact: "Mode | None") -> str | dict[str, Any]:
        """A phase in a problem file that begins with an impact, with the states of the contacts just after it."""
        if impact is None:
            return self.data
        if isinstance(impact.words, str):
            return {**self.record, IMPACT: impact.words}
        touching = {name: word for name, word in impact.words.items() if word != OFF}
        return {**(self.record if self.stops else self.contacts), IMPACT: touching}

    def with_contact(self, contact: "Mode") -> "Mode":
        """Another state of the foot, with the same stops and switches."""
        return Mode.of(contact, self.stops)

    def with_next(self, name: str) -> "Mode":
        """The same contact after a stop has locked, or a switch has triggered."""
        return Mode.of(self, {**self.stops, name: NEXT_STATE[self.stops[name]]})

    def has(self, state: str) -> bool:
        """Whether the mode contains a state.

        Parameters
        ----------
        state : ``contact`` (a foot touches the ground), the name of a contact that does, or one like ``knee free``.
        """
        name, _, value = state.partition(" ")
        if value:
            return self.stops.get(name) == value
        return name in self.touching or (name == "contact" and bool(self.touching))


@lru_cache(maxsize=256)  # one simulated step joins a dozen modes
def _joined(contact: str, *stops: tuple[str, str]) -> Mode:
    return Mode(", ".join([Mode(contact).contact, *(f"{name} {state}" for name, state in stops)]))


_MODES: dict[str, Mode] = {}
Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD, Mode.FLIGHT = map(Mode, _DIRECTIONS)
CONTACTS = (Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD)
"""States of a foot on the ground."""
