"""Many steps as arrays, with numbers in place of names: modes, endings and the phases of a step have codes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.gait import Ending
from gaitopt.mechanics import CONTACTS, Mode
from gaitopt.simulation.simulator import StepOutcome

Codes = NDArray[np.int64]

ENDINGS = tuple(Ending)
"""The code of an ending is its index here; ``completed`` is 0. That of a mode is its index in ``Walker.modes()``, which
counts contacts first: that of the contact is its remainder modulo three. An impact has the code of its contact."""
NONE = -1
"""Code of the mode of a foot or an impact that is not there."""
BITS = 62
"""Of the code of the phases of a step, in which each is a digit, 1 + code of the mode; a longer step has code 0."""


def base(modes: Sequence[Mode]) -> int:
    """Base of the codes of phases."""
    return len(modes) + 1


def max_phases(modes: Sequence[Mode]) -> int:
    """Phases that a code holds."""
    return int(BITS / math.log2(base(modes)))


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchSteps:
    """One step of each of n states.

    Attributes
    ----------
    states : ndarray, shape (n, n_z) - state after the impact, x = 0; where the motion ended before, the state there.
    endings : ndarray, shape (n,) - index in ``ENDINGS``; 0 is ``completed``.
    times : ndarray, shape (n,) - time of the impact, or of the ending [s].
    step_lengths : ndarray, shape (n,) - NaN where there was no impact [m].
    phases : ndarray, shape (n,) - code of the modes gone through, see ``phase_names``.
    impacts : ndarray, shape (n,) - index in ``CONTACTS`` of the impact's mode, -1 where there was none.
    """

    states: Array
    endings: Codes
    times: Array
    step_lengths: Array
    phases: Codes
    impacts: Codes


def phase_code(phases: Sequence[Mode], modes: Sequence[Mode]) -> int:
    """The code of the modes gone through in a step, of a walker with these ``modes``."""
    code = 0
    for mode in phases if len(phases) <= max_phases(modes) else ():
        code = code * base(modes) + modes.index(mode) + 1
    return code


def phase_names(code: int, modes: Sequence[Mode]) -> tuple[Mode, ...]:
    """The modes behind a code, in order."""
    phases = []
    while code > 0:
        code, digit = divmod(code, base(modes))
        phases.append(modes[digit - 1])
    return tuple(reversed(phases))


def stack_outcomes(outcomes: Sequence[StepOutcome], starts: Array, modes: Sequence[Mode]) -> BatchSteps:
    """Steps that were simulated one by one from ``starts``, shape (n, n_z), as arrays."""
    states, times = starts.copy(), np.zeros(len(starts))
    lengths, phases = np.full(len(starts), np.nan), np.zeros(len(starts), dtype=np.int64)
    impacts = np.full(len(starts), NONE)
    for k, step in enumerate(outcome.step for outcome in outcomes):
        if step is None:
            continue
        times[k], states[k] = step.period, step.arcs[-1].states[-1]
        phases[k] = phase_code([mode for mode, _ in step.phases], modes)
        if step.impact is not None:
            states[k], lengths[k] = step.impact.state, step.impact.step_length
            impacts[k] = CONTACTS.index(step.impact.mode)
    endings = np.array([ENDINGS.index(outcome.ending) for outcome in outcomes], dtype=np.int64)
    return BatchSteps(states=states, endings=endings, times=times, step_lengths=lengths, phases=phases, impacts=impacts)


def followed_by(first: BatchSteps, second: BatchSteps, rows: NDArray[np.intp], modes: Sequence[Mode]) -> BatchSteps:
    """Two steps as one: ``first`` and, of those of its ``rows`` that were completed, the steps that followed."""
    codes = [
        (*phase_names(int(a), modes), *phase_names(int(b), modes))
        for a, b in zip(first.phases[rows], second.phases, strict=True)
    ]
    phases = [phase_code(names, modes) for names in codes]
    both = {
        name: getattr(first, name).copy()
        for name in ("states", "endings", "times", "step_lengths", "phases", "impacts")
    }
    both["states"][rows], both["endings"][rows], both["impacts"][rows] = second.states, second.endings, second.impacts
    both["times"][rows] += second.times
    both["step_lengths"][rows] += second.step_lengths
    both["phases"][rows] = phases
    return BatchSteps(**both)
