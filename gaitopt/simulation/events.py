"""Events of a motion, at which a margin of its mode falls through zero. The rules are the same for every engine.

All quantities are in natural units. If a margin is at its edge at the start of an arc, its derivatives decide:

    margin + INSTANT rate + INSTANT^2 bend / 2 < 0      the margin has fallen; otherwise it leaves its edge upwards

A margin that dips below its edge by less than EDGE, rate^2 / (2 bend) < EDGE, is not an event. The margin ``painleve``
always counts as fallen at its edge, because the equations of motion are singular there. A force that stays at its edge
up to rounding does not end the mode: a foot that needs exactly the available friction sticks, and a foot without a
force remains on the ground.

Events are located by Newton's method on the motion itself. An integrator's interpolant is not used, because it is three
digits less accurate than the integration steps.
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
"""Order of simultaneous events. First come those after which the model is not valid (a normal force has no meaning if
the slip has no unique solution), then the impact, which cancels any simultaneous change of mode, then stops and
switches (the empty name), then changes of mode."""
EDGE = 1e-12
"""A margin is at its edge if it is this close to zero, the rounding error of contact forces in units of the weight."""
AT_REST = EDGE
"""A foot is at rest at the start if it slips more slowly than this, in units of sqrt(g l): it would stop within an
instant."""
SIMULTANEOUS = 1e-12
"""Events are simultaneous if they are this close in time, the accuracy to which the worst of them is located."""
INSTANT = 1e-9
"""Time resolution: a margin that is negative for a shorter time, or a shorter slip, is ignored."""
LINEAR = 1e-11
"""A Newton step that is shorter in time is exact, even within a slip that lasts ten instants."""
NEAR = 1e-9
"""A Newton step from the root of a lifted margin is exact if it is shorter than this. It has this length if the margin
falls at a rate of 1e-3; the bend of a margin other than a slip velocity then changes the root by 1e-15."""
FALLING = frozenset(name for name, known in PHASE_MARGINS.items() if not known.rises)
"""Margins that may fall at the start of an arc. The others rise first: the feet are level at the start of a step, and
stops and switches, which may have any name, have just been released."""
STEEP = 1e-3
"""If the rate of a margin at its edge exceeds this, only a bend of a million would matter."""
STEADY, STRAIGHT = 1e-11, 1e-6
"""A force at its edge stays there if its rate and bend are below these, the rounding errors of a rate and of a
difference over ``LOOK_AHEAD``. If it falls nevertheless, the event is found as soon as it has left its edge."""
LOOK_AHEAD = 1e-7
"""Time over which a difference of rates gives the bend to a relative accuracy of 1e-8."""
MAX_NEWTON_STEP = 1e-3
"""Longest Newton step towards an event that an engine has located up to ``EDGE``. If a margin barely falls, its tangent
is useless far away."""
BARELY_MOVING = 1e-18
"""Number by which the margin of a slip velocity is lifted, see ``lift``. The shortest slips that are resolved reach ten
times this velocity."""
MAX_ITERATIONS = 100
"""Largest number of iterations, enough to bisect any interval down to rounding."""


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
    """Whether ``falls_at_start`` needs the bend of a margin, which is at its edge and has a small rate."""
    return (margin <= EDGE) & (abs(rate) < STEEP)


def event_at_start(
    names: Sequence[str], margins: Sequence[float], rates: Sequence[float], rates_ahead: Callable[[], Sequence[float]]
) -> str | None:
    """The violated margin of highest priority at the start of an arc; None if all margins hold.

    Parameters
    ----------
    rates_ahead : the function that returns the rates after ``LOOK_AHEAD``; called only if they matter.
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
    """Rank of a margin among simultaneous events; the event with the smallest rank happens."""
    return PRIORITY.index(kind(name) if kind(name) in PRIORITY else "")


def is_armed(name: str, margin: Any) -> Any:
    """Whether a margin with this value at the start of an arc may fall; margins that rise must have been positive."""
    return (margin > EDGE) | (kind(name) in FALLING)


def smallest_lift(name: str) -> float:
    """Lift of a margin that is positive at the start of an arc; see ``lift``."""
    return BARELY_MOVING if kind(name) == "slip_velocity" else EDGE


def lift(name: str, margin: Any, rate: Any) -> Any:
    """The number that is added to a margin before its roots are sought, from its value and rate at the start.

    A lifted margin never starts at zero, because heyoka would miss its next root. A margin that may fall is lifted by
    ``EDGE``; if it starts at its edge, it is also lifted by its possible dip. ``touchdown`` is lowered until it is
    armed, so that it only falls after it has been positive. The arguments are floats, or arrays of one shape.
    """
    armed, dip = is_armed(name, margin), (margin <= EDGE) * (rate < 0) * 2 * EDGE
    return armed * (smallest_lift(name) + dip) - (1 - armed) * EDGE


def rests_at_edge(name: str, margin: float, rate: float) -> bool:
    """Whether a margin that holds at the start of an arc stays at its edge, see ``falls_at_start``."""
    return abs(margin) <= EDGE and abs(rate) <= STEADY and kind(name) != "slip_velocity" and kind(name) in FALLING


def coincides(margin: Any, rate: Any) -> Any:
    """Whether a margin falls through zero at this instant; both are floats, or arrays of one shape."""
    return (rate < 0) & (abs(margin) <= -rate * SIMULTANEOUS)


def falls_at_limit(name: str, margin: Any, rate: Any) -> Any:
    """Whether a margin that rises first falls at the time limit of an arc; it would not be armed in the next arc.

    The arguments are floats, or arrays of one shape.
    """
    return (abs(margin) <= EDGE) & (rate < 0) & (kind(name) not in FALLING)


def refine(k: int, point: Point, flow: Callable[[Point, float], Point]) -> tuple[float, Array]:
    """Time and state of the root of the k-th margin, by Newton's method from a point close to it.

    Parameters
    ----------
    flow : function of a point and a duration, which may be negative; returns the point of the motion after it.
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
    """Two points between which the k-th margin falls from a positive value to zero or below; None if it does not."""
    start, end, slope, end_slope = before.margins[k], after.margins[k], before.rates[k], after.rates[k]
    if armed and end <= 0:
        return before, after
    dips, bulges = armed and start > 0 and slope < 0 < end_slope, not armed and end <= 0 and slope > 0 > end_slope
    if not dips and not bulges:
        return None
    # if the margin is convex (or concave) in between, the tangents at both ends meet beyond its extremum
    h = after.time - before.time
    beyond = start + slope * (end - start - end_slope * h) / (slope - end_slope)
    if beyond >= 0 if dips else beyond <= 0:
        return None
    extremum = motion_at(bracketed_root(lambda t: motion_at(t).rates[k], before.time, after.time, SIMULTANEOUS))
    if dips:
        return (before, extremum) if extremum.margins[k] < -EDGE else None
    return (extremum, after) if extremum.margins[k] > EDGE else None


def _root(k: int, before: Point, after: Point, motion_at: MotionAt) -> tuple[float, Array]:
    """Time and state at which the k-th margin is zero, by Newton's method safeguarded with bisection.

    It starts at the root of the inverse cubic interpolation (time as a function of the margin), or of the chord.
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
