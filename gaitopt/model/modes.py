"""Modes: the states of the stance foot, the joint stops and the switches.

A foot on the ground obeys the friction complementarity, v_forward - v_backward being its slip velocity,

    0 <= v_forward  _|_ mu f_n + f_t >= 0        0 <= v_backward  _|_ mu f_n - f_t >= 0

A mode states which factor of each pair is zero. In flight there is no force. Gamus & Or (2013), eqs (4), (5).
"""

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, ClassVar

from pydantic_core import PydanticKnownError, core_schema

FOOT = "foot"
"""Name of the one contact of a walker that stands on one foot at a time."""
STOP_STATES, SWITCH_STATES = ("free", "locked"), ("off", "on")
STATES = (*STOP_STATES, *SWITCH_STATES)
NEXT_STATE = dict((STOP_STATES, SWITCH_STATES))
_DIRECTIONS = {"stick": 0, "slip_forward": 1, "slip_backward": -1, "flight": 0}


class Mode(str):
    """The states of the stance foot, the joint stops and the switches; of an impact, those just after it.

    The text is ``stick``, ``slip_forward``, ``slip_backward`` or ``flight``, followed by the states of stops and
    switches if the walker has any: ``stick, knee free`` or ``slip_forward, knee locked``. Equal modes are one object.

    Attributes
    ----------
    contact : the state of the foot, as a mode without stops.
    touching : names of the contacts that touch the ground: ``foot``, or none in flight.
    sticks, slips : whether the foot is held by friction, or slips.
    direction : sign of the slip velocity: +1 downhill, -1 uphill, 0 in stick and in flight.
    stops : state of every stop and switch by name, in order; not to be written to.
    free, locked : names of the stops in either state.
    off : names of the switches that are off.
    key : the text as part of an identifier.
    """

    STICK: ClassVar["Mode"]
    SLIP_FORWARD: ClassVar["Mode"]
    SLIP_BACKWARD: ClassVar["Mode"]
    FLIGHT: ClassVar["Mode"]
    contact: "Mode"
    touching: tuple[str, ...]
    sticks: bool
    slips: bool
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
            If the text is not the state of a foot, followed by names of stops and switches with their states.
        """
        if text not in _MODES:
            contact, *stops = text.split(", ")
            states = dict(stop.rpartition(" ")[::2] for stop in stops)
            if contact not in _DIRECTIONS or any(state not in STATES for state in states.values()):
                raise ValueError(f"{text!r} is no mode: a foot can {', '.join(_DIRECTIONS)}")
            mode = super().__new__(cls, text)
            mode.contact = Mode(contact) if stops else mode
            mode.direction = _DIRECTIONS[contact]
            mode.sticks, mode.slips = contact == "stick", mode.direction != 0
            mode.touching = () if contact == "flight" else (FOOT,)
            mode.stops, mode.key = states, re.sub(r"\W+", "_", text)
            mode.free, mode.locked, mode.off, _ = (
                tuple(name for name in states if states[name] == state) for state in STATES
            )
            _MODES.setdefault(text, mode)  # unless another thread has just made it
        return _MODES[text]

    def __reduce__(self) -> tuple[type["Mode"], tuple[str]]:
        """Copies and pickles are the same object."""
        return Mode, (str(self),)

    @classmethod
    def of(cls, contact: str, stops: Mapping[str, str]) -> "Mode":
        """The mode with a state of the foot, and a state of every stop and switch."""
        return _joined(contact, *stops.items())

    @staticmethod
    def slip(direction: float) -> "Mode":
        """The slipping mode, without stops, whose slip velocity has the sign of ``direction``."""
        return Mode.SLIP_FORWARD if direction > 0 else Mode.SLIP_BACKWARD

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> core_schema.CoreSchema:
        """In problem files: a word, or ``{mode: stick, knee: free}`` for a walker with stops."""

        def read(data: object) -> Mode:
            contact, stops = data, dict[str, Any]()
            if isinstance(data, dict):
                contact, stops = data.get("mode"), {name: state for name, state in data.items() if name != "mode"}
            for value, allowed in [(contact, (*_DIRECTIONS,)), *((state, STATES) for state in stops.values())]:
                if value not in allowed:
                    raise PydanticKnownError("literal_error", {"expected": " or ".join(map(repr, allowed))})
            return Mode.of(str(contact), stops)

        return core_schema.no_info_before_validator_function(read, core_schema.is_instance_schema(cls))

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: Any, handler: Any) -> dict[str, Any]:
        """Both forms."""
        word = {"type": "string", "enum": list(_DIRECTIONS)}
        state = {"type": "string", "enum": list(STATES)}
        stops = {"type": "object", "properties": {"mode": word}, "required": ["mode"], "additionalProperties": state}
        return {"anyOf": [word, stops]}

    @classmethod
    def from_record(cls, record: str | Mapping[str, Any]) -> "Mode":
        """The mode of a phase in JSON, or the mode with this text."""
        if isinstance(record, str):
            return cls(record)
        return cls.of(record["mode"], {name: state for name, state in record.items() if state in STATES})

    @property
    def record(self) -> dict[str, str]:
        """As in JSON: ``mode``, and the state of every stop and switch by name."""
        return {"mode": str(self.contact), **self.stops}

    @property
    def data(self) -> str | dict[str, str]:
        """As in a problem file: a word, or a mapping where there are stops."""
        return self.record if self.stops else str(self)

    def with_contact(self, contact: "Mode") -> "Mode":
        """Another state of the foot, with the same stops and switches."""
        return Mode.of(contact, self.stops)

    def with_next(self, name: str) -> "Mode":
        """The same contact after a stop has locked, or a switch has triggered."""
        return Mode.of(self, {**self.stops, name: NEXT_STATE[self.stops[name]]})

    def has(self, state: str) -> bool:
        """Whether ``contact`` (a foot touches the ground), or a state such as ``knee free``, is part of the mode."""
        name, _, value = state.partition(" ")
        return self.stops.get(name) == value if value else bool(self.touching)


@lru_cache(maxsize=256)  # one simulated step joins a dozen modes
def _joined(contact: str, *stops: tuple[str, str]) -> Mode:
    return Mode(", ".join([contact.partition(",")[0], *(f"{name} {state}" for name, state in stops)]))


_MODES: dict[str, Mode] = {}
Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD, Mode.FLIGHT = map(Mode, _DIRECTIONS)
CONTACTS = (Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD)
"""States of a foot on the ground."""
