"""What a problem consists of besides its walker and its control, in SI: unknowns, ranges, open sequences, guesses."""

from collections.abc import Mapping
from dataclasses import dataclass

from gaitopt.mechanics.modes import Mode


@dataclass(frozen=True, slots=True, kw_only=True)
class Free:
    """A parameter that is an unknown, in SI: its bounds and its first guess."""

    lower: float
    upper: float
    guess: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """A constraint on a scalar, in SI: -inf or inf where it is open, both equal for an equality."""

    minimum: float
    maximum: float


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenSequence:
    """A mode sequence that is to be found: its impact if that is known, and the largest number of steps of a cycle."""

    impact: Mode | None = None
    steps: int = 1

    def __str__(self) -> str:
        return f"to be found; {self.impact or 'to be found'}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Guess:
    """First guess of a gait.

    Attributes
    ----------
    state : the whole state just after the impact by name [rad, m, rad/s, m/s].
    durations : of the phases [s]; None where the solver is to find them.
    """

    state: Mapping[str, float]
    durations: tuple[float, ...] | None
