"""Contact modes of the stance foot, the factors of the friction complementarity

    0 <= v_forward  _|_ mu f_n + f_t >= 0        0 <= v_backward  _|_ mu f_n - f_t >= 0

A mode says which factor of each pair is zero. Gamus & Or (2013), eqs (4), (5).
"""

from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise


class Mode(StrEnum):
    """What the stance foot does; for an impact, what the colliding foot does just after it."""

    STICK = "stick"
    SLIP_FORWARD = "slip_forward"
    SLIP_BACKWARD = "slip_backward"

    @property
    def direction(self) -> int:
        """Sign of the slip velocity: +1 downhill, -1 uphill, 0 in stick."""
        return _DIRECTIONS[self]

    @staticmethod
    def slip(direction: float) -> "Mode":
        """The slipping mode whose slip velocity has the sign of ``direction``."""
        return Mode.SLIP_FORWARD if direction > 0 else Mode.SLIP_BACKWARD


class ImpactLaw(StrEnum):
    """Tangential law of a slipping impact: eq. (11), or no tangential impulse at all."""

    COULOMB = "coulomb"
    FRICTIONLESS = "frictionless"


_DIRECTIONS = {Mode.STICK: 0, Mode.SLIP_FORWARD: 1, Mode.SLIP_BACKWARD: -1}


@dataclass(frozen=True, slots=True)
class ModeSequence:
    """The phases of one step in order, and the impact that ends it.

    Raises
    ------
    ValueError
        If the sequence contradicts itself: no phase, two equal neighbours, or a slipping impact that is not
        followed by the same slip.
    """

    phases: tuple[Mode, ...]
    impact: Mode

    def __post_init__(self) -> None:
        if not self.phases:
            raise ValueError("a step needs at least one phase: stick, slip_forward or slip_backward")
        for k, (first, second) in enumerate(pairwise(self.phases), start=1):
            if first is second:
                raise ValueError(f"phases {k} and {k + 1} are both {first}: merge them into one")
        if self.impact is not Mode.STICK and self.phases[0] is not self.impact:
            raise ValueError(
                f"after an impact with {self.impact} the foot is already slipping: "
                f"the first phase must be {self.impact}, not {self.phases[0]}"
            )

    def onset_order(self, phase: int, *, jump: bool = False) -> int:
        """Order of the zero that the slip velocity has where a slip phase starts.

        0 where the foot slips already, 1 where it leaves rest with an acceleration (just after a sticking impact, or
        in a reversal), 2 at the edge of the friction cone after a stick, where velocity and acceleration are zero;
        1 there as well where friction drops at the onset of slip (``jump``).
        """
        if phase == 0:
            return int(self.impact is Mode.STICK)
        return 2 if self.phases[phase - 1] is Mode.STICK and not jump else 1

    def starts_from_rest(self, phase: int) -> bool:
        """Whether a slip phase starts from rest at a force beyond the friction cone: after an impact, or reversed."""
        return self.phases[phase] is not Mode.STICK and self.onset_order(phase, jump=False) == 1

    def __str__(self) -> str:
        return f"{', '.join(self.phases)}; {self.impact}"
