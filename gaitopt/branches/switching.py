"""Other branches through a special point: the first gaits of a family that begins there.

    period doubling  the cycle twice over; at a multiplier -1 the second branch through it has unlike halves
    branch point     the second curve of solutions; both of its halves
    change of modes  every mode sequence that holds next to the event, cycles of both modes in turn included

At a branch point the Jacobian J of the equations F(w) = 0 has a plane of null vectors. That which is perpendicular to
the known branch leads to the other one,

    F(w) = 0,      n' (y(w) - y_0) = +-distance,      J n = 0,      n' tangent = 0,

next to which Newton's method is regular.

References
----------
H. B. Keller (1977), Numerical solution of bifurcation and nonlinear eigenvalue problems.
"""

from collections.abc import Iterator

import numpy as np

from gaitopt.arrays import Array
from gaitopt.branches.change import alternatives, holds, with_cycle
from gaitopt.branches.curve import Metric, Point, Segment, segment_through
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.branch import SpecialPoint
from gaitopt.gait.gait import Gait
from gaitopt.model.cycle import Cycle
from gaitopt.nlp.rollout import Rollout, roll_out

Beginning = tuple[Segment, Point]

DISTANCES = (1e-3, 1e-4, 1e-2)
"""Of the first gait from a branch point, in arclength: near enough for Newton's method, and far enough that rounding in
the null vector, which grows like the inverse of the distance, does not matter."""
STRAY = 5.0
"""Largest distance of the first gait from the branch point, in distances along the null vector."""
SWITCHES = ("period_doubling", "branch_point", "mode_change", "impact_change")


def beginnings(special: SpecialPoint, parameter: str, metric: Metric) -> list[Beginning]:
    """The first gaits of the other branches through a special point.

    Raises
    ------
    ProblemError
        If no other branch can begin at a special point of this type.
    SolveError
        If none is found, though there should be.
    """
    if special.type not in SWITCHES or special.gait is None:
        raise ProblemError(
            f"no other branch begins at a special point of type {special.type}; those that have some: "
            f"{', '.join(SWITCHES)}"
        )
    begun = list(_BEGINNINGS[special.type](special, special.gait, parameter, metric))
    if not begun:
        raise SolveError(f"no other branch is found at {special.type} {parameter} = {special.value:.10g}")
    return begun


def motion_of(gait: Gait, times: int = 1) -> Rollout:
    """The motion of a gait, ``times`` over; every step from its own state, so that errors do not grow."""
    durations = [duration for _, duration in gait.phases]
    states = np.array([step.arcs[0].states[0] for step in gait.steps])
    rolled = roll_out(gait.dynamics, gait.problem.cycle, states, durations)
    return Rollout(durations=rolled.durations * times, motions=rolled.motions * times)


def started(gait: Gait, parameter: str, metric: Metric, ahead: float) -> Beginning:
    """The branch of a gait, and its first point with the tangent in the direction ``ahead`` of the parameter."""
    intervals = () if gait.shooting is None else gait.shooting.intervals
    segment, w = segment_through(gait.problem, gait.dynamics, parameter, metric, motion_of(gait), intervals)
    forward = np.zeros(w.size)
    forward[-1] = ahead
    return segment, first_point(segment, w, forward)


def first_point(segment: Segment, w: Array, forward: Array) -> Point:
    """The gait next to ``w``.

    Raises
    ------
    SolveError
        If Newton's method fails at it.
    """
    point = segment.start(w, forward)
    if point is None:
        raise SolveError(
            f"{segment.problem.name}: the gait cannot be continued in {segment.parameter}: Newton's method fails at it"
        )
    return point


def _doubled(special: SpecialPoint, gait: Gait, parameter: str, metric: Metric) -> Iterator[Beginning]:
    """The family of twice as many steps; its other half is the same, begun one cycle later."""
    segment, point = started(gait, parameter, metric, 1.0)
    tangent, n = segment.coordinates(point.curve_point.tangent), segment.transcription.n_phases
    section, durations, slope = tangent[: -n - 1], tangent[-n - 1 : -1], tangent[-1:]
    along = np.concatenate([section, durations, durations, slope])
    problem = with_cycle(gait.problem, gait.system, Cycle(gait.problem.cycle.steps * 2), gait.state)
    doubled, w = segment_through(problem, gait.dynamics, parameter, metric, motion_of(gait, 2))
    yield from _halves(doubled, w, along, signs=(1.0,))


def _crossing(special: SpecialPoint, gait: Gait, parameter: str, metric: Metric) -> Iterator[Beginning]:
    """Both halves of the curve of solutions that crosses the known one."""
    segment, w = segment_through(gait.problem, gait.dynamics, parameter, metric, motion_of(gait))
    if special.tangent is None:
        raise ProblemError("the direction of the known branch is needed to leave it at a branch point")
    yield from _halves(segment, w, special.tangent / segment.curve.scales, signs=(1.0, -1.0))


def _halves(segment: Segment, w: Array, along: Array, signs: tuple[float, ...]) -> Iterator[Beginning]:
    """The halves of the branch that crosses the direction ``along`` at ``w``, each with a segment of its own."""
    origin = segment.coordinates(w)
    for sign in signs:
        for distance in DISTANCES:
            own = Segment(segment.problem, segment.parameter, segment.transcription, segment.p, segment.metric)
            try:
                point = own.branch_off(w, along, sign * distance)
            except ProblemError:  # Newton's method has left the range of the parameter
                continue
            if point is None or np.linalg.norm(own.coordinates(point.curve_point.at.w) - origin) > STRAY * distance:
                continue
            if holds(point):
                yield own, point
                break


def _other_modes(special: SpecialPoint, gait: Gait, parameter: str, metric: Metric) -> Iterator[Beginning]:
    """Mode sequences other than the two that the special point joins."""
    segment, point = started(gait, parameter, metric, 1.0)
    known = [cycle for cycle in (special.before, special.after) if cycle is not None]
    yield from alternatives(segment, point, known)


_BEGINNINGS = {
    "period_doubling": _doubled,
    "branch_point": _crossing,
    "mode_change": _other_modes,
    "impact_change": _other_modes,
}
