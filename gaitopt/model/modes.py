"""Modes: what the foot, the joint stops and the switches do. On the ground the foot obeys the friction complementarity

    0 <= v_forward  _|_ mu f_n + f_t >= 0        0 <= v_backward  _|_ mu f_n - f_t >= 0

of which a mode says which factor of each pair is zero; in flight there is no force. Gamus & Or (2013), eqs (4), (5).
"""

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, ClassVar

from pydantic_core import PydanticKnownError, core_schema

FOOT = "foot"
"""Name of the one contact of a walker that stands on one foot at a time."""


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
    direction : sign of the slip velocity: +1 downhill, -1 uphill, 0 in stick and in flight.
    sticks, slips : whether the foot is held by friction, or slips.
    touching : names of the contacts that touch the ground: ``foot``, or none in flight.
    key : the text as part of an identifier.
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
    key: str
    direction: int
    sticks: bool
    slips: bool
    touching: tuple[str, ...]

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
            mode.direction = _DIRECTIONS[contact]
            mode.sticks, mode.slips = contact == "stick", mode.direction != 0
            mode.touching = () if contact == "flight" else (FOOT,)
            mode.stops, mode.key = states, re.sub(r"\W+", "_", text)
            mode.free, mode.locked, mode.off, _ = (
                tuple(name for name in states if states[name] == own) for own in STATES
            )
            _MODES.setdefault(text, mode)  # unless another thread has just made it
        return _MODES[text]

    def __reduce__(self) -> tuple[type["Mode"], tuple[str]]:
        """Copies and pickles are the same object."""
        return Mode, (str(self),)

    @classmethod
    def of(cls, contact: str, stops: Mapping[str, str]) -> "Mode":
        """What a foot does, with the state of every stop and switch."""
        return _joined(contact, *stops.items())

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
    def from_record(cls, record: str | Mapping[str, Any]) -> "Mode":
        """The mode of a phase in JSON, or the mode with this text."""
        if isinstance(record, str):
            return cls(record)
        return cls.of(record["mode"], {name: state for name, state in record.items() if state in STATES})

    @property
    def record(self) -> dict[str, str]:
        """As in JSON: ``mode``, and the state of every stop by its name."""
        return {"mode": str(self.contact), **self.stops}

    @property
    def data(self) -> str | dict[str, str]:
        """As in a problem file: a word, or a mapping where there are stops."""
        return self.record if self.stops else str(self)

    def with_contact(self, contact: "Mode") -> "Mode":
        """Another contact with the same states of the stops."""
        return Mode.of(contact, self.stops)

    def with_next(self, name: str) -> "Mode":
        """The same contact after a stop has locked, or a switch has been thrown."""
        return Mode.of(self, {**self.stops, name: NEXT_STATE[self.stops[name]]})

    def has(self, state: str) -> bool:
        """Whether ``contact`` (a foot on the ground), or a state such as ``knee free``, is part of it."""
        name, _, value = state.partition(" ")
        return self.stops.get(name) == value if value else bool(self.touching)


@lru_cache(maxsize=256)
def _joined(contact: str, *stops: tuple[str, str]) -> Mode:
    """The decisions of one simulated step put a dozen modes together."""
    return Mode(", ".join([contact.partition(",")[0], *(f"{name} {state}" for name, state in stops)]))


def _read(data: object) -> Mode:
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
