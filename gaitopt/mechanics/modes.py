"""Contact modes of the stance foot, the factors of the friction complementarity

    0 <= v_forward  _|_ mu f_n + f_t >= 0        0 <= v_backward  _|_ mu f_n - f_t >= 0

A mode says which factor of each pair is zero. Gamus & Or (2013), eqs (4), (5).
"""

from bisect import bisect_right
from dataclasses import dataclass
from enum import StrEnum
from itertools import accumulate, pairwise


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
        If there is no phase, or if two neighbours are equal.
    """

    phases: tuple[Mode, ...]
    impact: Mode

    def __post_init__(self) -> None:
        if not self.phases:
            raise ValueError("a step needs at least one phase: stick, slip_forward or slip_backward")
        for k, (first, second) in enumerate(pairwise(self.phases), start=1):
            if first is second:
                raise ValueError(f"phases {k} and {k + 1} are both {first}: merge them into one")

    def __str__(self) -> str:
        return f"{', '.join(self.phases)}; {self.impact}"


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
            if impact is not Mode.STICK and first is not impact:
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

    def impact_before(self, phase: int) -> Mode | None:
        """The impact with which a phase begins, that of the last step before the first; None in mid-step."""
        return self.steps[self.step_of(phase) - 1].impact if phase in self.first_phases else None

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
            return int(impact is Mode.STICK)
        return 2 if self.phases[phase - 1] is Mode.STICK and not jump else 1

    def starts_from_rest(self, phase: int) -> bool:
        """Whether a slip phase starts from rest at a force beyond the friction cone: after an impact, or reversed."""
        return self.phases[phase] is not Mode.STICK and self.onset_order(phase) == 1

    def __str__(self) -> str:
        return " | ".join(map(str, self.steps))
