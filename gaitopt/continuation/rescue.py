"""When a step fails however short it is: IPOPT looks for a gait a little further on, and the branch goes on from it."""

import numpy as np

from gaitopt.continuation.change import NEARBY, with_cycle
from gaitopt.continuation.segment import Piece, Station, piece_through
from gaitopt.errors import ProblemError
from gaitopt.nlp import solve_gait
from gaitopt.nlp.rollout import roll_out

DISTANCES = (1e-4, 1e-3, 1e-2)
"""Distances from the last point at which a gait is looked for, in scales of the parameter."""


def rescue(piece: Piece, station: Station) -> tuple[Piece, Station] | None:
    """A gait of the same mode sequence past a point at which Newton's method fails, if IPOPT finds one close by."""
    system, ahead = station.gait.system, float(np.sign(station.point.tangent[-1])) or 1.0
    for distance in DISTANCES:
        value = station.value + ahead * distance * piece.metric.span
        try:
            asked = with_cycle(piece.problem, system, piece.cycle, station.gait.state)
            gait = solve_gait(asked.replace({piece.parameter: value}), system)
        except ProblemError:  # beyond what the problem allows
            return None
        if not gait.steps or piece.metric.apart(gait.state, station.gait.state) > NEARBY:
            continue
        durations = [duration for _, duration in gait.phases]
        rolled = roll_out(system, gait.p, piece.cycle, gait.state, durations)
        further, w = piece_through(piece.problem, system, piece.parameter, piece.metric, rolled, gait.p)
        forward = np.zeros(w.size)
        forward[-1] = ahead
        found = further.start(w, forward)
        if found is not None and all(reading.value > 0 for reading in found.monitors.values()):
            return further, found
    return None
