"""When a step fails however short it is: IPOPT looks for a gait a little further on, and the branch goes on from it."""

import numpy as np

from gaitopt.errors import ProblemError
from gaitopt.families.change import NEARBY, with_cycle
from gaitopt.families.segment import Point, Segment, segment_through
from gaitopt.nlp import solve_gait
from gaitopt.nlp.rollout import roll_out

DISTANCES = (1e-4, 1e-3, 1e-2)
"""Distances from the last point at which IPOPT is tried, in scales of the parameter."""


def rescue(segment: Segment, point: Point) -> tuple[Segment, Point] | None:
    """A gait of the same mode sequence past a point at which Newton's method fails, if IPOPT finds one close by."""
    system, ahead = point.gait.system, float(np.sign(point.curve_point.tangent[-1])) or 1.0
    for distance in DISTANCES:
        value = point.value + ahead * distance * segment.metric.span
        try:
            problem = with_cycle(segment.problem, system, segment.cycle, point.gait.state)
            gait = solve_gait(problem.replace({segment.parameter: value}), system)
        except ProblemError:  # beyond what the problem allows
            return None
        if not gait.steps or segment.metric.apart(gait.state, point.gait.state) > NEARBY:
            continue
        durations = [duration for _, duration in gait.phases]
        rolled = roll_out(gait.dynamics, segment.cycle, gait.state, durations)
        further, w = segment_through(segment.problem, gait.dynamics, segment.parameter, segment.metric, rolled)
        forward = np.zeros(w.size)
        forward[-1] = ahead
        rescued = further.start(w, forward)
        if rescued is not None and all(monitor.value > 0 for monitor in rescued.monitors.values()):
            return further, rescued
    return None
