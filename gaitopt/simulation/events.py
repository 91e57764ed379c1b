"""Events within one accepted integration step: a margin that falls through zero, located to rounding.

Nothing here reads the integrator's interpolant, which is three digits worse than its steps: ``reach(t)`` integrates
anew from the start of the step to any time within it, and Newton's method runs on that.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

Array = NDArray[np.float64]

PRIORITY = ("painleve", "normal_force", "upright", "touchdown", "slip_velocity", "cone_forward", "cone_backward")
"""Which of several simultaneous events counts: first what the model cannot go on from (and a normal force means
nothing where the slip has no unique solution), then the impact, which makes any change of mode at the same instant
void, then changes of mode."""
EDGE = 1e-12
"""A margin this close to zero is at its edge, in the margin's own unit: rounding of contact forces up to 1e4 N."""
SIMULTANEOUS = 1e-12
"""Events this close in time [s] are one instant: the accuracy to which the worst of them is located."""
INSTANT = 1e-9
"""Shortest time [s] that is told apart: a margin that is negative for less, or a slip that lasts less, is none."""
LINEAR = 1e-9
"""A move along the flow this short in time [s] is linear: its square is below rounding."""
MAX_BISECTIONS = 100
"""More than enough to halve any interval down to rounding."""


@dataclass(frozen=True, slots=True)
class Point:
    """A point of a motion: time, state (n_z,), its rate (n_z,), margins and their rates."""

    time: float
    state: Array
    flow: Array
    margins: Sequence[float]
    rates: Sequence[float]

    def shifted(self, duration: float) -> tuple[float, Array]:
        """Time and state a moment later, to first order."""
        return self.time + duration, self.state + duration * self.flow


Reach = Callable[[float], Point]


def lasts(margin: float, rate: float) -> bool:
    """Whether a margin below its edge stays negative for longer than an instant."""
    return margin < -EDGE and margin + INSTANT * rate < 0


def violated(names: Sequence[str], point: Point, armed: Sequence[bool]) -> str | None:
    """The first armed margin by priority that does not hold at ``point``, if there is one."""
    state = zip(names, point.margins, point.rates, armed, strict=True)
    fallen = [name for name, margin, rate, live in state if live and lasts(margin, rate)]
    return min(fallen, key=PRIORITY.index, default=None)


def first_event(
    names: Sequence[str], before: Point, after: Point, armed: Sequence[bool], reach: Reach
) -> tuple[str, float, Array] | None:
    """Name, time and state of the earliest event in the step from ``before`` to ``after``, if there is one.

    Parameters
    ----------
    names : names of the margins.
    armed : whether each margin may fire: it is positive at ``before``, or at its edge at the start of an arc.
    reach : the motion at any time within the step.
    """

    def within(t: float) -> Point:
        return before if t <= before.time else after if t >= after.time else reach(t)

    found = []
    for k, name in enumerate(names):
        bracket = _bracket(k, before, after, armed[k], within)
        if bracket is not None:
            found.append((name, *_root(k, *bracket, within)))
    if not found:
        return None
    earliest = min(time for _, time, _ in found)
    simultaneous = [event for event in found if event[1] <= earliest + SIMULTANEOUS]
    return min(simultaneous, key=lambda event: PRIORITY.index(event[0]))


def _bracket(k: int, before: Point, after: Point, armed: bool, reach: Reach) -> tuple[Point, Point] | None:
    """Two points between which the k-th margin falls from positive to zero or below."""
    start, end = before.margins[k], after.margins[k]
    if armed and end <= 0:
        return before, after
    if armed and start > 0 and before.rates[k] < 0 < after.rates[k] and _between_tangents(k, before, after) < 0:
        lowest = _extremum(k, before, after, reach)
        return (before, lowest) if lowest.margins[k] < -EDGE else None
    if not armed and end <= 0 and before.rates[k] > 0 > after.rates[k] and _between_tangents(k, before, after) > 0:
        highest = _extremum(k, before, after, reach)
        return (highest, after) if highest.margins[k] > EDGE else None
    return None


def _between_tangents(k: int, before: Point, after: Point) -> float:
    """Where the tangents at both ends meet: beyond the extremum of a margin that is convex (or concave) in between."""
    h = after.time - before.time
    start, slope, end_slope = before.margins[k], before.rates[k], after.rates[k]
    return start + slope * (after.margins[k] - start - end_slope * h) / (slope - end_slope)


def _extremum(k: int, before: Point, after: Point, reach: Reach) -> Point:
    return reach(float(brentq(lambda t: reach(t).rates[k], before.time, after.time, xtol=SIMULTANEOUS)))


def _root(k: int, before: Point, after: Point, reach: Reach) -> tuple[float, Array]:
    """Time and state where the k-th margin is zero, by Newton's method safeguarded with bisection."""
    if before.margins[k] <= 0:
        return before.time, before.state
    low, high = before.time, after.time
    t = _guess(k, before, after)
    point = after
    for _ in range(MAX_BISECTIONS):
        point = reach(t)
        margin, rate = point.margins[k], point.rates[k]
        low, high = (t, high) if margin > 0 else (low, t)
        step = -margin / rate if rate < 0 else np.inf
        if abs(step) <= LINEAR:
            return point.shifted(step)
        t = t + step if low < t + step < high else (low + high) / 2
        if not low < t < high:
            break
    return point.time, point.state


def _guess(k: int, before: Point, after: Point) -> float:
    """The root by inverse cubic interpolation of time over the margin, or by its chord."""
    t0, t1, m0, m1 = before.time, after.time, before.margins[k], after.margins[k]
    s = m0 / (m0 - m1)
    chord = t0 + s * (t1 - t0)
    if before.rates[k] >= 0 or after.rates[k] >= 0:
        return chord
    slopes = (m1 - m0) / before.rates[k] * (1 - s) - (m1 - m0) / after.rates[k] * s
    guess = chord + s * (1 - s) * (slopes - (t1 - t0) * (1 - 2 * s))
    return guess if t0 < guess < t1 else chord
