"""Points and special points of a branch from the JSON records that hold them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from gaitopt.arrays import Array
from gaitopt.families.change import with_cycle
from gaitopt.families.segment import Metric, Point, Segment, segment_through
from gaitopt.families.switching import first_point
from gaitopt.gait import Gait, SpecialPoint
from gaitopt.mechanics import Cycle, Dynamics
from gaitopt.nlp.rollout import Rollout, roll_out
from gaitopt.problem import Problem

Record = Mapping[str, Any]


def restored_point(gait: Gait, parameter: str, metric: Metric, record: Record) -> tuple[Segment, Point]:
    """The branch and the point that a record holds, on the mesh that it had; ``gait`` is the first of the family."""
    segment, w = _segment(gait, parameter, metric, record, record["value"])
    return segment, first_point(segment, w, segment.curve.direction(np.array(record["tangent"])))


def restored_special(gait: Gait, parameter: str, record: Record) -> SpecialPoint:
    """The special point that a record holds."""
    own, tangent = record["gait"], record.get("tangent")
    restored = None
    if own:
        metric = Metric(state=gait.dynamics.state_units, period=own["period"], span=1.0)
        segment, w = _segment(gait, parameter, metric, own, record["value"])
        restored = replace(segment.assembled(w), verification=own.get("verification"))
    return SpecialPoint(
        branch=record["branch"],
        type=record["type"],
        value=record["value"],
        status=record["status"],
        reason=record["reason"],
        before=Cycle.from_record(record["from"]) if "from" in record else None,
        after=Cycle.from_record(record["to"]) if "to" in record else None,
        next=tuple(record["next"]),
        gait=restored,
        tangent=None if tangent is None else np.array(tangent),
    )


def _segment(gait: Gait, parameter: str, metric: Metric, record: Record, value: float) -> tuple[Segment, Array]:
    dynamics = gait.dynamics.at({parameter: value})
    problem, rolled = _recorded_motion(gait, dynamics, record)
    intervals = record.get("intervals", ())
    return segment_through(problem.replace({parameter: value}), dynamics, parameter, metric, rolled, intervals)


def _recorded_motion(gait: Gait, dynamics: Dynamics, record: Record) -> tuple[Problem, Rollout]:
    """The problem with the modes of a record, and its motion; every step from its own state."""
    durations = np.array([phase["duration"] for phase in record["phases"]])
    starts = [step["state"] for step in record.get("steps", (record,))]
    states = np.array([[state[name] for name in gait.system.state_names] for state in starts])
    problem = with_cycle(gait.problem, gait.system, Cycle.from_record(record), states[0])
    return problem, roll_out(dynamics, problem.cycle, states, durations)
