"""Events: a margin that falls through zero, at the start of an arc or within an integration step, located to rounding.

All is in natural units. At the start of an arc margins may be at their edge, where only their derivatives tell

    margin + INSTANT rate + INSTANT^2 bend / 2 < 0      the margin has fallen; else it holds, and leaves its edge

except where it only dips, by rate^2 / (2 bend) < EDGE, and except for ``painleve``, at whose edge the equations of
motion are singular: there it has fallen in any case.

Within a step nothing here reads the integrator's interpolant, which is three digits worse than its steps: ``reach(t)``
integrates from the start of the step to any time within it, and Newton's method runs on that.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from gaitopt.arrays import Array
from gaitopt.integration import bracketed_root
from gaitopt.model.transitions import PHASE_MARGINS

PRIORITY = (
    "painleve", "normal_force", "upright", "clearance", "touchdown", "", "slip_velocity", "cone_forward",
    "cone_backward",
)  # fmt: skip
"""Which of several simultaneous events counts: first what the model cannot go on from (and a normal force means
nothing where the slip has no unique solution), then the impact, which makes any change of mode at the same instant
void, then stops (without a name here), then changes of mode."""
EDGE = 1e-12
"""A margin this close to zero is at its edge: rounding of contact forces in units of the weight."""
AT_REST = EDGE
"""A foot that starts with a slip no faster than this, in units of sqrt(g l), is at rest, for all engines: it would stop
within an instant."""
SIMULTANEOUS = 1e-12
"""Events this close in time are one instant: the accuracy to which the worst of them is located."""
INSTANT = 1e-9
"""Shortest time that is told apart: a margin that is negative for less, or a slip that lasts less, is none."""
LINEAR = 1e-11
"""A move along the flow this short in time is linear, even within a slip that lasts ten instants."""
NEAR = 1e-9
"""The same from the root of a lifted margin, which lies this far away where the margin falls at a rate of 1e-3: the
bend of a margin that is no slip then changes the root by 1e-15."""
FALLING = frozenset(name for name, known in PHASE_MARGINS.items() if not known.rises)
"""Margins that may fall at the start of an arc. All others rise at the start of every step: the feet are level, and
stops, under any name, have just been released."""
STEEP = 1e-3
"""A rate beyond which the bend of a margin at its edge makes no difference: one of a million would be needed."""
LOOK = 1e-7
"""Time over which a difference of rates gives the bend, right to 1e-8; meanwhile it changes little."""
CLOSE = 1e-3
"""Longest step of Newton's method towards an event that an engine has located to ``EDGE``: beyond a margin that only
just falls, its tangent points nowhere."""
BARELY_MOVING = 1e-18
"""Lift of a slip velocity, below all rounding: the shortest slips that are told apart are no faster than 1e-17."""
MAX_BISECTIONS = 100
"""More than enough to halve any interval down to rounding."""


class Point(NamedTuple):
    """A point of a motion in natural units: time, state (n_z,), its rate (n_z,), margins and their rates."""

    time: float
    state: Array
    flow: Array
    margins: Sequence[float]
    rates: Sequence[float]

    def shifted(self, duration: float) -> tuple[float, Array]:
        """Time and state a moment later, to first order."""
        return self.time + duration, self.state + duration * self.flow


Reach = Callable[[float], Point]


def falls(name: str, margin: Any, rate: Any, bend: Any = 0.0) -> Any:
    """Whether a margin does not hold at the start of an arc, and is not about to; floats, or arrays of one shape."""
    deep = margin < -EDGE
    soon = margin * deep + INSTANT * (rate + INSTANT / 2 * bend) < 0
    lasting = deep | (rate * rate > 2 * bend * EDGE)
    return (margin <= EDGE) & ((soon & lasting) | (name == "painleve")) & (name in FALLING)


def bends_decide(margin: Any, rate: Any) -> Any:
    """Whether margins are at their edge with rates so small that ``falls`` needs the bends; floats or arrays."""
    return (margin <= EDGE) & (abs(rate) < STEEP)


def fallen(
    names: Sequence[str], margins: Sequence[float], rates: Sequence[float], look: Callable[[], Sequence[float]]
) -> str | None:
    """The first margin by priority that does not hold at the start of an arc, if there is one.

    Parameters
    ----------
    look : gives the rates a time ``LOOK`` later; called only where they matter.
    """
    near = [k for k, margin in enumerate(margins) if margin <= EDGE and names[k] in FALLING]
    if not near:
        return None
    later = look() if any(bends_decide(margins[k], rates[k]) for k in near) else rates
    broken = [names[k] for k in near if falls(names[k], margins[k], rates[k], (later[k] - rates[k]) / LOOK)]
    return min(broken, key=priority, default=None)


def priority(name: str) -> int:
    """Place of a margin among simultaneous events."""
    return PRIORITY.index(name if name in PRIORITY else "")


def smallest_lift(name: str) -> float:
    """By how much a margin that may fall is lifted at least."""
    return BARELY_MOVING if name == "slip_velocity" else EDGE


def is_armed(name: str, margin: Any) -> Any:
    """Whether a margin that starts with this value may fall; what rises must have been positive."""
    return (margin > EDGE) | (name in FALLING)


def lift(name: str, margin: Any, rate: Any) -> Any:
    """What an engine that looks for sign changes must add to a margin of an arc, from its value at the start.

    No lifted margin starts at zero, where a root of its series would hide the next. One that may fall is lifted by
    its edge, and one that starts at its edge by how far it may dip; ``touchdown`` is lowered as long as it is not
    armed, so that it falls only after it has been positive. Floats, or arrays of one shape.
    """
    armed, dip = is_armed(name, margin), (margin <= EDGE) * (rate < 0) * 2 * EDGE
    return armed * (smallest_lift(name) + dip) - (1 - armed) * EDGE


def coincides(margin: Any, rate: Any) -> Any:
    """Whether a margin falls through zero at this very instant; floats, or arrays of one shape."""
    return (rate < 0) & (abs(margin) <= -rate * SIMULTANEOUS)


def is_touchdown(margin: Any, rate: Any) -> Any:
    """Whether ``touchdown`` falls where an arc ends for another reason; the next arc could not see it."""
    return (abs(margin) <= EDGE) & (rate < 0)


def refine(k: int, point: Point, reach: Callable[[Point, float], Point]) -> tuple[float, Array]:
    """Time and state where the k-th margin falls through zero, by Newton's method from a point that is close.

    Parameters
    ----------
    reach : (point, duration) -> the motion so much later, or earlier.
    """
    for _ in range(MAX_BISECTIONS):
        margin, rate = point.margins[k], point.rates[k]
        step = -margin / rate if rate < 0 else 0.0
        if abs(step) <= NEAR:
            return point.shifted(step)
        point = reach(point, float(np.clip(step, -CLOSE, CLOSE)))
    return point.time, point.state


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

    falls = []
    for k, name in enumerate(names):
        bracket = _bracket(k, before, after, armed[k], within)
        if bracket is not None:
            falls.append((name, *_root(k, *bracket, within)))
    if not falls:
        return None
    earliest = min(time for _, time, _ in falls)
    simultaneous = [event for event in falls if event[1] <= earliest + SIMULTANEOUS]
    return min(simultaneous, key=lambda event: priority(event[0]))


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
    return reach(bracketed_root(lambda t: reach(t).rates[k], before.time, after.time, SIMULTANEOUS))


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
