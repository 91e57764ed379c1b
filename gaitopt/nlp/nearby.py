"""The gait next to a good guess by Newton's method alone, which needs neither Hessians nor a nonlinear program.

    J(w) s = residual(w),    w <- w - s,    |s_0| <= REACH,    |s_k| <= CONTRACTION |s_k-1|

Steps that halve at least keep the solution within twice the first one, so that it is that of the guess and not of
another family: a start from which they do not is left to IPOPT. P. Deuflhard (2004), Newton Methods for Nonlinear
Problems, ch. 2.
"""

from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.iteration import iterate
from gaitopt.nlp.ipopt import Progress
from gaitopt.nlp.newton import linearise
from gaitopt.nlp.transcription import Transcription
from gaitopt.nlp.trial import overflow_allowed

REACH = 0.2
"""Longest first step in natural units: a guess farther off is none."""
CONTRACTION = 0.5
"""Largest ratio of a step to the one before."""
SETTLED = 1e-7
"""Step in natural units whose successor, by quadratic convergence, is at rounding."""
MOST_STEPS = 9
"""Steps that halve from ``REACH`` are near quadratic convergence long before."""
SHORTEST = 0.5
"""Part of the guessed period: feet that stay together solve all equations in no time at all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Nearby:
    """Where Newton's method ended after some steps; only where it ``settled`` is ``w`` a solution, up to rounding."""

    w: Array
    steps: int
    settled: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class _Step:
    """Where a Newton step leads, and its size in natural units."""

    end: Array
    size: float
    number: int


@overflow_allowed()
def solve_nearby(
    transcription: Transcription,
    start: Array,
    p: Array,
    progress: Progress | None = None,
    should_stop: Stop = None,
) -> Nearby:
    """Newton's method from ``start``, shape (n_w,), at parameters ``p``, as long as its steps shrink.

    ``should_stop`` ends it at once. The margins are not checked.
    """
    shortest = SHORTEST * _period(transcription, start)

    def step_from(w: Array, number: int) -> _Step | None:
        at = linearise(transcription, w, p)
        if progress is not None:
            progress(number, at.size)
        if should_stop is not None and should_stop():
            return None
        try:
            step = at.scaled.solve(at.residual)
        except RuntimeError:  # singular
            return None
        end, size = w - step, float(np.abs(step / at.units.unknowns).max())
        return None if _period(transcription, end) < shortest else _Step(end=end, size=size, number=number)

    first = step_from(start, 0)
    if first is None or not first.size <= REACH:
        return Nearby(w=start, steps=0, settled=False)
    last = iterate(
        first,
        lambda step: step_from(step.end, step.number + 1),
        size=lambda step: step.size,
        solved=lambda step: step.size < SETTLED,
        most=MOST_STEPS,
        contraction=CONTRACTION,
    )
    return Nearby(w=last.at.end, steps=last.count, settled=last.solved)


def _period(transcription: Transcription, w: Array) -> float:
    return float(transcription.unpack(w).durations.sum())
