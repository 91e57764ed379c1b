"""Outcomes of simulated steps: one step as a record, many steps as arrays in which numbers stand for names.

The code of an ending is its index in ``ENDINGS``; ``completed`` is 0. The code of a mode is its index in
``Walker.modes()``. The code of an impact is the index of the contact mode after it in ``Walker.foot_modes()``. A mode
sequence is coded as a number in base 1 + (number of modes), with the digit 1 + (code of the mode) for every phase.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.gait.trajectory import Step
from gaitopt.model.modes import CONTACTS, Mode
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import Ending

Codes = NDArray[np.int64]

ENDINGS = tuple(Ending)
"""Endings by their codes."""
NONE = -1
"""Code of a mode or an impact if there is none."""
BITS = 62
"""Largest number of bits in the code of the phases of a step; a step with more phases has the code 0."""
ARRAYS = ("states", "endings", "times", "step_lengths", "phases", "impacts")
"""The fields of ``StepOutcomes`` with a row per state."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepOutcome:
    """One simulated step.

    Attributes
    ----------
    step : the arcs and the impact; None if the motion ended at once.
    ending : ``completed`` if the step ended with an impact, otherwise why the motion ended.
    message : the ending as a sentence, with time and state.
    events : number of events up to the end of the step.
    """

    step: Step | None
    ending: Ending
    message: str
    events: int = 0


UNDEFINED_STATE = StepOutcome(
    step=None, ending=Ending.NUMERICAL, message="the section coordinates belong to no state of the walker"
)
"""Outcome if a coordinate or rate does not follow from the section, for example if a runner is too fast for its
energy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepOutcomes(ReadOnlyArrays):
    """One step, or consecutive steps, from each of n states.

    Attributes
    ----------
    names : names of the columns of ``states``.
    states : ndarray, shape (n, k) - state after the last impact, with x = 0; if the motion ended early, its last state.
    endings : ndarray, shape (n,) - index of the ending in ``Ending``; 0 is ``completed``.
    times : ndarray, shape (n,) - time of the last impact, or of the ending [s].
    step_lengths : ndarray, shape (n,) - step length [m]; NaN if the motion was not completed.
    phases : ndarray, shape (n,) - the mode sequence as digits, 1 + index in ``modes``, in base ``len(modes) + 1``.
    impacts : ndarray, shape (n,) - index of the contact mode after the last impact in ``Walker.foot_modes()``; -1 if
        the motion ended early.
    modes : all modes of the walker.
    """

    names: tuple[str, ...]
    states: Array
    endings: Codes
    times: Array
    step_lengths: Array
    phases: Codes
    impacts: Codes
    modes: tuple[Mode, ...] = CONTACTS

    @property
    def completed(self) -> NDArray[np.bool_]:
        """Whether each motion ended with its last impact; shape (n,)."""
        return self.endings == 0

    @property
    def outcomes(self) -> NDArray[np.str_]:
        """Names of the endings; shape (n,)."""
        return np.array([str(ending) for ending in ENDINGS])[self.endings]

    def sequence(self, row: int) -> tuple[Mode, ...]:
        """The mode sequence of one state."""
        return phase_names(int(self.phases[row]), self.modes)

    def followed_by(self, steps: "StepOutcomes", rows: NDArray[np.intp]) -> "StepOutcomes":
        """These motions, of which those of ``rows``, all completed, are extended by further ``steps``."""
        joined: dict[str, Any] = {name: getattr(self, name).copy() for name in ARRAYS}
        for name in ("states", "endings", "impacts"):
            joined[name][rows] = getattr(steps, name)
        joined["times"][rows] += steps.times
        joined["step_lengths"][rows] += steps.step_lengths
        joined["phases"][rows] = [
            phase_code((*self.sequence(row), *steps.sequence(k)), self.modes) for k, row in enumerate(rows)
        ]
        return replace(self, **joined)


def max_phases(modes: Sequence[Mode]) -> int:
    """Largest number of phases that a code can represent."""
    return int(BITS / math.log2(len(modes) + 1))


def phase_code(phases: Sequence[Mode], modes: Sequence[Mode]) -> int:
    """The code of the phases of a step, for a walker with these ``modes``."""
    code = 0
    for mode in phases if len(phases) <= max_phases(modes) else ():
        code = code * (len(modes) + 1) + modes.index(mode) + 1
    return code


def phase_names(code: int, modes: Sequence[Mode]) -> tuple[Mode, ...]:
    """The phases with this code, in order."""
    phases = []
    while code > 0:
        code, digit = divmod(code, len(modes) + 1)
        phases.append(modes[digit - 1])
    return tuple(reversed(phases))


def stack_outcomes(outcomes: Sequence[StepOutcome], starts: Array, system: HybridSystem) -> StepOutcomes:
    """The outcomes of steps that were simulated one by one from ``starts``, shape (n, n_z), as arrays."""
    n, modes, contacts = len(starts), system.walker.modes(), system.walker.foot_modes()
    states, times, lengths = starts.copy(), np.zeros(n), np.full(n, np.nan)
    phases, impacts = np.zeros(n, dtype=np.int64), np.full(n, NONE)
    for k, step in enumerate(outcome.step for outcome in outcomes):
        if step is None:
            continue
        times[k], states[k] = step.period, step.arcs[-1].states[-1]
        phases[k] = phase_code([mode for mode, _ in step.phases], modes)
        if step.impact is not None:
            states[k], lengths[k] = step.impact.state, step.impact.step_length
            impacts[k] = contacts.index(step.impact.mode)
    return StepOutcomes(
        names=system.state_names,
        states=states,
        endings=np.array([ENDINGS.index(outcome.ending) for outcome in outcomes], dtype=np.int64),
        times=times,
        step_lengths=lengths,
        phases=phases,
        impacts=impacts,
        modes=modes,
    )
