"""The gait next to a good guess by Newton's method alone, which needs neither Hessians nor a nonlinear program.

    J(w) s = residual(w),    w <- w - s,    |s_0| <= REACH,    |s_k| <= CONTRACTION |s_k-1|

Steps that halve at least keep the solution within twice the first one, so that it is that of the guess and not of
another family: a start from which they do not is left to IPOPT. P. Deuflhard (2004), Newton Methods for Nonlinear
Problems, ch. 2.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
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
MOST_STEPS = 10
"""Steps that halve from ``REACH`` are near quadratic convergence long before."""
SHORTEST = 0.5
"""Part of the guessed period: feet that stay together solve all equations in no time at all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Nearby:
    """Where Newton's method ended after some steps; only where it ``settled`` is ``w`` a solution, up to rounding."""

    w: Array
    steps: int
    settled: bool


@overflow_allowed()
def solve_nearby(
    transcription: Transcription,
    start: Array,
    p: Array,
    progress: Progress | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Nearby:
    """Newton's method from ``start``, shape (n_w,), at parameters ``p``, while a solution is plainly near.

    ``should_stop`` ends it at once. The margins are not looked at.
    """
    w, before = start, REACH / CONTRACTION
    shortest = SHORTEST * _period(transcription, start)
    for count in range(MOST_STEPS):
        at = linearise(transcription, w, p)
        if progress is not None:
            progress(count, at.size)
        if should_stop is not None and should_stop():
            break
        try:
            step = at.factor().solve(at.residual)
        except RuntimeError:  # singular
            break
        size = float(np.abs(step / at.units.unknowns).max())
        if not size <= CONTRACTION * before or _period(transcription, w - step) < shortest:
            break
        w, before = w - step, size
        if size < SETTLED:
            return Nearby(w=w, steps=count, settled=True)
    return Nearby(w=w, steps=count, settled=False)


def _period(transcription: Transcription, w: Array) -> float:
    return float(transcription.unpack(w)[1].sum())
