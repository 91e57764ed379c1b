"""Why there is no gait: one violated condition, in words and in numbers."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """One condition of a gait that does not hold.

    Attributes
    ----------
    what : the quantity: ``friction``, ``normal_force``, ``duration``, ``touchdown``, the name of a constraint, ...
    words : the whole in words.
    phase : index of the phase through all steps; None for an impact, and where no phase is concerned.
    step : index of the step.
    time : since the last impact [s], None where there is no one time.
    needed, available : the quantity as the gait needs it and as it is, in SI; None where there are no two numbers.
    severity : the violation relative to what is usual for the quantity.
    """

    what: str
    words: str
    phase: int | None = None
    step: int = 0
    time: float | None = None
    needed: float | None = None
    available: float | None = None
    severity: float = 0.0

    def to_record(self) -> dict[str, Any]:
        """One JSON object with the keys of the command line; phases are counted from 1."""
        numbers = {"time": self.time, "needed": self.needed, "available": self.available}
        phase = None if self.phase is None else self.phase + 1
        return {"what": self.what, "phase": phase, **numbers, "words": self.words}


def in_words(causes: tuple[Cause, ...] | list[Cause]) -> str:
    """All of them as one line."""
    return "; ".join(cause.words for cause in causes)
