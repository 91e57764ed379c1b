"""The other branches through a special point, each represented by its first gait.

period doubling  the cycle walked twice; at a multiplier -1 the halves differ along the second branch through it
branch point     both halves of the second curve of solutions
change of modes  every mode sequence that holds near the event, including the cycle that alternates between both
"""

from collections.abc import Iterator, Sequence

import numpy as np

from gaitopt.arrays import Array
from gaitopt.branches.change import alternatives, holds
from gaitopt.branches.curve import Curve, CurvePoint, Metric, curve_through, first_point
from gaitopt.branches.request import FOLLOWS
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.branch import SpecialPoint
from gaitopt.gait.gait import Gait
from gaitopt.model.cycle import Cycle
from gaitopt.solver.rollout import retraced

DISTANCES = (1e-3, 1e-4, 1e-2)
"""Arclengths from a branch point at which the first gait is sought. They are small enough for Newton's method, and so
large that rounding in the null vector, which grows like the inverse of the distance, does not matter."""
LARGEST_STRAY = 5.0
"""Largest distance of the first gait from the branch point, relative to its distance along the null vector."""


def beginnings(special: SpecialPoint, parameter: str, metric: Metric) -> list[CurvePoint]:
    """The first gaits of the other branches through a special point.

    Raises
    ------
    ProblemError
        If no other branch can begin at a special point of this type.
    SolveError
        If no other branch is found.
    """
    if special.type not in FOLLOWS or special.gait is None:
        raise ProblemError(
            f"no other branch begins at a special point of type {special.type}; other branches begin at the types "
            f"{', '.join(FOLLOWS)}"
        )
    if special.type == "period_doubling":
        points = doubled_beginnings(special.gait, parameter, metric)
    elif special.type == "branch_point":
        points = _crossing(special.gait, special.tangent, parameter, metric)
    else:
        known = [cycle for cycle in (special.before, special.after) if cycle is not None]
        points = alternatives(first_point(special.gait, parameter, metric, 1.0), known)
    first_points = list(points)
    if not first_points:
        raise SolveError(f"no other branch is found at {special.type} {parameter} = {special.value:.10g}")
    return first_points


def doubled_beginnings(
    gait: Gait, parameter: str, metric: Metric, distances: Sequence[float] = DISTANCES
) -> Iterator[CurvePoint]:
    """The family of twice as many steps; its other half consists of the same gaits, started one cycle later."""
    point = first_point(gait, parameter, metric, 1.0)
    tangent, n = point.direction, point.curve.equations.n_phases
    section, durations, slope = tangent[: -n - 1], tangent[-n - 1 : -1], tangent[-1:]
    along = np.concatenate([section, durations, durations, slope])
    state = dict(zip(gait.system.state_names, gait.state, strict=True))
    problem = gait.problem.with_modes(Cycle(gait.problem.cycle.steps * 2), state)
    doubled, w = curve_through(problem, parameter, metric, retraced(gait, 2))
    yield from _halves(doubled, w, along, signs=(1.0,), distances=distances)


def _crossing(gait: Gait, tangent: Array | None, parameter: str, metric: Metric) -> Iterator[CurvePoint]:
    """Both halves of the curve of solutions that crosses the known one, which has this ``tangent``."""
    if tangent is None:
        raise ProblemError("the direction of the known branch is needed to leave it at a branch point")
    curve, w = curve_through(gait.problem, parameter, metric, retraced(gait))
    yield from _halves(curve, w, curve.solutions.scaled(tangent), signs=(1.0, -1.0))


def _halves(
    curve: Curve, w: Array, along: Array, signs: tuple[float, ...], distances: Sequence[float] = DISTANCES
) -> Iterator[CurvePoint]:
    """The halves, one for each sign, of the branch that crosses the direction ``along`` (shape of y) at ``w``."""
    direction = curve.solutions.crossing(w, along)
    if direction is None:
        return
    origin = curve.solutions.coordinates(w)
    for sign in signs:
        for distance in distances:
            try:
                point = curve.branch_off(w, direction, sign * distance)
            except ProblemError:  # Newton's method leaves the range of the parameter
                continue
            if point is None:
                continue
            stray = np.linalg.norm(point.curve.solutions.coordinates(point.at.w) - origin)
            if stray <= LARGEST_STRAY * distance and holds(point):
                yield point
                break
