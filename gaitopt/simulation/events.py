"""Events of a motion: where a margin of its mode falls through zero. The rules hold for every engine.

All quantities are in natural units. Where a margin is at its edge at the start of an arc, its derivatives decide:

    margin + INSTANT rate + INSTANT^2 bend / 2 < 0      the margin has fallen; otherwise it leaves its edge upwards

A dip of no more than EDGE, rate^2 / (2 bend) < EDGE, is not an event. The margin ``painleve`` has fallen at its edge in
any case, because the equations of motion are singular there. A force at its edge that stays there, to within rounding,
holds: a foot that needs exactly the friction that there is sticks, and one without a force remains on the ground.

Events are located by Newton's method on the motion itself. An integrator's interpolant is not used: it loses three
digits against the integration steps.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from gaitopt.arrays import Array
from gaitopt.integration import bracketed_root
from gaitopt.model.transitions import PHASE_MARGINS, kind

PRIORITY = (
    "painleve", "regularity", "normal_force", "upright", "clearance", "touchdown", "gap", "", "slip_velocity",
    "cone_forward", "cone_backward",
)  # fmt: skip
"""Order of simultaneous events. First come those after which the model does not hold (a normal force means nothing
where the slip has no unique solution), then the impact, which cancels any simultaneous change of mode, then stops and
switches (the empty name), then changes of mode."""
EDGE = 1e-12
"""A margin this close to zero is at its edge: rounding of contact forces in units of the weight."""
AT_REST = EDGE
"""A foot that starts with a slip no faster than this, in units of sqrt(g l), is at rest: it would stop within an
instant."""
SIMULTANEOUS = 1e-12
"""Events this close in time are simultaneous: the accuracy to which the worst of them is located."""
INSTANT = 1e-9
"""Time resolution: a margin that is negative for less, or a slip that lasts less, is ignored."""
LINEAR = 1e-11
"""A Newton step this short in time is exact, even within a slip that lasts ten instants."""
NEAR = 1e-9
"""The same from the root of a lifted margin, which lies this far away where the margin falls at a rate of 1e-3: the
bend of a margin other than a slip velocity then changes the root by 1e-15."""
FALLING = frozenset(name for name, known in PHASE_MARGINS.items() if not known.rises)
"""Margins that may fall at the start of an arc. The others rise first: the feet are level at the start of a step, and
stops and switches, which may have any name, have just been released."""
STEEP = 1e-3
"""A rate beyond which the bend of a margin at its edge does not matter: it would have to be a million."""
STEADY, STRAIGHT = 1e-11, 1e-6
"""Rate and bend up to which a force at its edge stays there: rounding, and that of a difference over ``LOOK_AHEAD``. If
it falls nevertheless, it is noticed when it has left its edge."""
LOOK_AHEAD = 1e-7
"""Time over which a difference of rates gives the bend to a relative accuracy of 1e-8."""
MAX_NEWTON_STEP = 1e-3
"""Longest Newton step towards an event that an engine has located to ``EDGE``: the tangent of a margin that barely
falls is useless far away."""
BARELY_MOVING = 1e-18
"""Lift of a slip velocity, below all rounding: the shortest slips that are resolved are no faster than 1e-17."""
MAX_ITERATIONS = 100
"""Enough to bisect any interval down to rounding."""


class Point(NamedTuple):
    """A point of a motion in natural units: time, state (n_z,), its rate (n_z,), margins and their rates."""

    time: float
    state: Array
    flow: Array
    margins: Sequence[float]
    rates: Sequence[float]

    def after(self, duration: float) -> tuple[float, Array]:
        """Time and state after a short time, to first order."""
        return self.time + duration, self.state + duration * self.flow


MotionAt = Callable[[float], Point]


def falls_at_start(name: str, margin: Any, rate: Any, bend: Any = 0.0) -> Any:
    """Whether a margin is violated from the start of an arc; floats, or arrays of one shape."""
    deep = margin < -EDGE
    soon = margin * deep + INSTANT * (rate + INSTANT / 2 * bend) < 0
    moves = (abs(rate) > STEADY) | (abs(bend) > STRAIGHT) | (kind(name) == "slip_velocity")
    lasting = deep | (moves & (rate * rate > 2 * bend * EDGE))
    return (margin <= EDGE) & ((soon & lasting) | (name == "painleve")) & (kind(name) in FALLING)


def bends_decide(margin: Any, rate: Any) -> Any:
    """Whether ``falls_at_start`` needs the bends: margins at their edge with small rates; floats or arrays."""
    return (margin <= EDGE) & (abs(rate) < STEEP)


def event_at_start(
    names: Sequence[str], margins: Sequence[float], rates: Sequence[float], rates_ahead: Callable[[], Sequence[float]]
) -> str | None:
    """The violated margin of highest priority at the start of an arc; None if all margins hold.

    Parameters
    ----------
    rates_ahead : returns the rates after ``LOOK_AHEAD``; called only if they matter.
    """
    near = [k for k, margin in enumerate(margins) if margin <= EDGE and kind(names[k]) in FALLING]
    if not near:
        return None
    ahead = rates_ahead() if any(bends_decide(margins[k], rates[k]) for k in near) else rates
    violated = [
        names[k] for k in near if falls_at_start(names[k], margins[k], rates[k], (ahead[k] - rates[k]) / LOOK_AHEAD)
    ]
    return min(violated, key=priority, default=None)


def priority(name: str) -> int:
    """Rank of a margin among simultaneous events; the smallest counts."""
    return PRIORITY.index(kind(name) if kind(name) in PRIORITY else "")


def is_armed(name: str, margin: Any) -> Any:
    """Whether a margin with this value at the start of an arc may fall: what rises must have been positive."""
    return (margin > EDGE) | (kind(name) in FALLING)


def smallest_lift(name: str) -> float:
    """Lift of a margin that is positive at the start of an arc; see ``lift``."""
    return BARELY_MOVING if kind(name) == "slip_velocity" else EDGE


def lift(name: str, margin: Any, rate: Any) -> Any:
    """Number to be added to a margin of an arc before its roots are sought, from its value and rate at the start.

    A lifted margin never starts at zero, because heyoka would overlook its next root. One that may fall is lifted by
    its edge, and one that starts at its edge by its possible dip as well. ``touchdown`` is lowered until it is armed,
    so that it falls only after it has been positive. Floats, or arrays of one shape.
    """
    armed, dip = is_armed(name, margin), (margin <= EDGE) * (rate < 0) * 2 * EDGE
    return armed * (smallest_lift(name) + dip) - (1 - armed) * EDGE


def rests_at_edge(name: str, margin: float, rate: float) -> bool:
    """Whether a margin that holds at the start of an arc stays at its edge, see ``falls_at_start``."""
    return abs(margin) <= EDGE and abs(rate) <= STEADY and kind(name) != "slip_velocity" and kind(name) in FALLING


def coincides(margin: Any, rate: Any) -> Any:
    """Whether a margin falls through zero at this instant; floats, or arrays of one shape."""
    return (rate < 0) & (abs(margin) <= -rate * SIMULTANEOUS)


def falls_at_limit(name: str, margin: Any, rate: Any) -> Any:
    """Whether a margin falls at the time limit of an arc: one that rises first would not be armed in the next arc.

    Floats, or arrays of one shape.
    """
    return (abs(margin) <= EDGE) & (rate < 0) & (kind(name) not in FALLING)


def refine(k: int, point: Point, flow: Callable[[Point, float], Point]) -> tuple[float, Array]:
    """Time and state of the root of the k-th margin, by Newton's method from a point close to it.

    Parameters
    ----------
    flow : (point, duration) -> the point of the motion after this time, which may be negative.
    """
    for _ in range(MAX_ITERATIONS):
        margin, rate = point.margins[k], point.rates[k]
        step = -margin / rate if rate < 0 else 0.0
        if abs(step) <= NEAR:
            return point.after(step)
        point = flow(point, float(np.clip(step, -MAX_NEWTON_STEP, MAX_NEWTON_STEP)))
    return point.time, point.state


def first_event(
    names: Sequence[str], before: Point, after: Point, armed: Sequence[bool], motion_at: MotionAt
) -> tuple[str, float, Array] | None:
    """Name, time and state of the first event in the integration step from ``before`` to ``after``; None without one.

    Parameters
    ----------
    names : names of the margins.
    armed : whether each margin may fall: it is positive at ``before``, or at its edge at the start of an arc.
    motion_at : the point of the motion at any time within the step.
    """

    def within(t: float) -> Point:
        return before if t <= before.time else after if t >= after.time else motion_at(t)

    events = []
    for k, name in enumerate(names):
        bracket = _bracket(k, before, after, armed[k], within)
        if bracket is not None:
            events.append((name, *_root(k, *bracket, within)))
    if not events:
        return None
    earliest = min(time for _, time, _ in events)
    simultaneous = [event for event in events if event[1] <= earliest + SIMULTANEOUS]
    return min(simultaneous, key=lambda event: priority(event[0]))


def _bracket(k: int, before: Point, after: Point, armed: bool, motion_at: MotionAt) -> tuple[Point, Point] | None:
    """Two points between which the k-th margin falls from a positive value to zero or below."""
    start, end, slope, end_slope = before.margins[k], after.margins[k], before.rates[k], after.rates[k]
    if armed and end <= 0:
        return before, after
    dips, bulges = armed and start > 0 and slope < 0 < end_slope, not armed and end <= 0 and slope > 0 > end_slope
    if not dips and not bulges:
        return None
    # the tangents at both ends meet beyond the extremum of a margin that is convex, or concave, in between
    h = after.time - before.time
    beyond = start + slope * (end - start - end_slope * h) / (slope - end_slope)
    if beyond >= 0 if dips else beyond <= 0:
        return None
    extremum = motion_at(bracketed_root(lambda t: motion_at(t).rates[k], before.time, after.time, SIMULTANEOUS))
    if dips:
        return (before, extremum) if extremum.margins[k] < -EDGE else None
    return (extremum, after) if extremum.margins[k] > EDGE else None


def _root(k: int, before: Point, after: Point, motion_at: MotionAt) -> tuple[float, Array]:
    """Time and state where the k-th margin is zero, by Newton's method safeguarded with bisection.

    It starts at the root of the inverse cubic interpolation, time over margin, or of the chord.
    """
    t0, t1, m0, m1 = before.time, after.time, before.margins[k], after.margins[k]
    if m0 <= 0:
        return before.time, before.state
    s = m0 / (m0 - m1)
    t = t0 + s * (t1 - t0)
    if before.rates[k] < 0 and after.rates[k] < 0:
        slopes = (m1 - m0) / before.rates[k] * (1 - s) - (m1 - m0) / after.rates[k] * s
        cubic = t + s * (1 - s) * (slopes - (t1 - t0) * (1 - 2 * s))
        t = cubic if t0 < cubic < t1 else t
    low, high, point = t0, t1, after
    for _ in range(MAX_ITERATIONS):
        point = motion_at(t)
        margin, rate = point.margins[k], point.rates[k]
        low, high = (t, high) if margin > 0 else (low, t)
        step = -margin / rate if rate < 0 else np.inf
        if abs(step) <= LINEAR:
            return point.after(step)
        t = t + step if low < t + step < high else (low + high) / 2
        if not low < t < high:
            break
    return point.time, point.state
