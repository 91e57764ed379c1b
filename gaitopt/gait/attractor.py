"""A gait on which walks settle, as the simulator knows it: a state, and the steps after which it comes back."""

from dataclasses import dataclass

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.mechanics import Mode
from gaitopt.problem import Problem


@dataclass(frozen=True, slots=True, kw_only=True)
class Attractor(ReadOnlyArrays):
    """A gait that states settle on.

    Attributes
    ----------
    problem : whose walker walks.
    state : ndarray, shape (k,) - section coordinates.
    period : steps per cycle.
    phases, impact : modes of the step that leads there.
    count : how many states of the grid settle on it.
    """

    problem: Problem
    state: Array
    period: int
    phases: tuple[Mode, ...]
    impact: Mode
    count: int

    def __str__(self) -> str:
        sticks = [mode.sticks for mode in self.phases]
        kind = "sticking" if all(sticks) and self.impact.sticks else "stick-slip" if any(sticks) else "slipping"
        return f"{kind}{'' if self.period == 1 else f', period {self.period}'}"
