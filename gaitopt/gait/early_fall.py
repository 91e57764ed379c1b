"""Where a margin that has risen falls again before its phase ends: a foot that lands early, a stop that locks early.

The feet are level at the start of every step, so that a margin may only fall once it has been clearly positive.
"""

from collections.abc import Sequence

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait import curves

SHORT = 1e-4
"""Arcs shorter than this part of the step are left out: what happens in them is rounding."""
CLEAR = 1e-3
"""Part of its largest value above which a margin has risen: next to a phase of no duration, or of less, the value that
it starts from is not exactly zero."""


def lowest_after_rise(times: Sequence[Array], values: Sequence[Array]) -> tuple[float, float]:
    """Value and time of the lowest interior minimum of a margin after it has risen; below zero it falls early.

    Parameters
    ----------
    times : of each arc of a step, at its Chebyshev points [s].
    values : of the margin there, in natural units.

    Returns
    -------
    lowest, time : infinity and the end of the step where there is no such minimum.
    """
    lowest, at, risen = np.inf, float(times[-1][-1]), False
    level = CLEAR * max(float(margin.max()) for margin in values)
    for arc, margin in zip(times, values, strict=True):
        if arc[-1] - arc[0] < SHORT * abs(times[-1][-1]):
            continue
        c = curves.coefficients(margin)
        for s in curves.minima(margin):
            value = float(curves.evaluate(c, s))
            if value < lowest and (risen or (margin[curves.points(margin.size) < s] > level).any()):
                lowest, at = value, float(arc[0] + (s + 1) / 2 * (arc[-1] - arc[0]))
        risen = risen or bool((margin[:-1] > level).any())
    return lowest, at
