"""Gaits and special points of a branch from their JSON records: each is integrated again from its state."""

from collections.abc import Mapping, Sequence
from itertools import count, pairwise
from typing import Any

import numpy as np

from gaitopt.errors import StorageError
from gaitopt.families.change import with_cycle
from gaitopt.families.coefficients import with_friction
from gaitopt.families.segment import Metric, Point, Segment, segment_through
from gaitopt.families.switching import first_point
from gaitopt.gait import MEASURES, Arc, Gait, SpecialPoint, Status, Step, WalkState, curves
from gaitopt.mechanics import Cycle, Dynamics, Mode
from gaitopt.nlp import integrate_to
from gaitopt.nlp.assembly import impact_record
from gaitopt.nlp.rollout import roll_out
from gaitopt.problem import Problem
from gaitopt.study.system import problem_dynamics

Record = Mapping[str, Any]

POINTS = 33
"""Chebyshev points of a phase; they resolve a phase of walking."""
OLDER = {"damping_loss": 0.0}
"""Measures that are not in records from before there were dampers."""


def family_of(problem: Problem, parameter: str) -> Gait:
    """A gait without a motion, with problem and dynamics of the family of ``problem`` along ``parameter``."""
    stated = Gait(problem=problem, dynamics=problem_dynamics(problem), status=Status.CONVERGED, message="")
    return with_friction(stated, parameter)


def recorded_gait(family: Gait, parameter: str, record: Record) -> Gait:
    """The gait of a point, or of a special point that has one; ``family`` is any gait of the family."""
    value, record = record["value"], record.get("gait") or record
    freed = {name: float(number) for name, number in record["parameters"].items()}
    dynamics = family.dynamics.at({**freed, parameter: value})
    state = np.array([record["state"][name] for name in family.system.state_names])
    problem = family.problem.replace({parameter: value})
    return Gait(
        problem=with_cycle(problem, family.system, Cycle.from_record(record), state),
        dynamics=dynamics,
        status=Status(record["status"]),
        message=str(record["message"]),
        steps=recorded_steps(dynamics, record),
        multipliers=np.array([complex(m["re"], m["im"]) for m in record["multipliers"]]),
        measures={name: {**OLDER, **record}[name] for name in MEASURES},
        freed=freed,
        solver=dict(record["solver"]),
        verification=record["verification"],
    )


def recorded_special(family: Gait, parameter: str, record: Record) -> SpecialPoint:
    """The special point that a record holds."""
    tangent = record.get("tangent")
    return SpecialPoint(
        branch=record["branch"],
        type=record["type"],
        value=record["value"],
        status=record["status"],
        reason=record["reason"],
        before=Cycle.from_record(record["from"]) if "from" in record else None,
        after=Cycle.from_record(record["to"]) if "to" in record else None,
        next=tuple(record["next"]),
        bound=record.get("bound", False),
        open=record.get("open", False),
        gait=recorded_gait(family, parameter, record) if record["gait"] else None,
        tangent=None if tangent is None else np.array(tangent),
    )


def resumed_point(gait: Gait, parameter: str, metric: Metric, points: Sequence[Record]) -> tuple[Segment, Point]:
    """The branch and the point that the last of the records of a walk's points holds, as the walk left them.

    A record of an earlier version does not hold what the walk needs: its gait is solved again. ``gait`` is the first of
    the family.

    Raises
    ------
    StorageError
        If the record does not hold a point from which a walk can go on.
    """
    record = points[-1]
    try:
        if not record["length"] > 0:
            raise ValueError(f"length {record['length']} is not positive")
        return _resumed_point(gait, parameter, metric, points)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise _unusable(record, error) from error


def stored_metric(record: Record) -> Metric:
    """What arclength is measured with on the walk of a stored point.

    Raises
    ------
    StorageError
        If the record does not hold a point from which a walk can go on.
    """
    try:
        return Metric.from_array(WalkState.from_record(record["walk"]).metric)
    except ValueError as error:
        raise _unusable(record, error) from error


def _unusable(record: Record, error: Exception) -> StorageError:
    words = f"{error}" if isinstance(error, ValueError) else f"{error!r}"
    return StorageError(f"the walk cannot go on from point {record.get('index')} of branch {record['branch']}: {words}")


def _resumed_point(gait: Gait, parameter: str, metric: Metric, points: Sequence[Record]) -> tuple[Segment, Point]:
    record = points[-1]
    value, steps = record["value"], record.get("steps", (record,))
    dynamics = gait.dynamics.at({parameter: value})
    states = np.array([[step["state"][name] for name in gait.system.state_names] for step in steps])
    problem = with_cycle(gait.problem.replace({parameter: value}), gait.system, Cycle.from_record(record), states[0])
    if record.get("walk"):
        needed = points[-1 - WalkState.from_record(record["walk"]).earlier :]
        known = [WalkState.from_record(point["walk"]) for point in needed if point.get("walk")]
        if known[-1].unknowns[-1] != value:
            raise ValueError(f"value {value} is not the last of walk.unknowns, {known[-1].unknowns[-1]}")
        return Segment.resumed(problem, gait.dynamics, parameter, known, int(record["solver"]["iterations"]))
    durations = np.array([phase["duration"] for phase in record["phases"]])
    rolled = roll_out(dynamics, problem.cycle, states, durations)
    segment, w = segment_through(problem, dynamics, parameter, metric, rolled, record.get("intervals", ()))
    return segment, first_point(segment, w, segment.curve.direction(np.array(record["tangent"])))


def recorded_steps(dynamics: Dynamics, record: Mapping[str, Any], points: int = POINTS) -> tuple[Step, ...]:
    """The steps of a gait, or of a point of a branch.

    Parameters
    ----------
    dynamics : at the parameters for which the record holds.
    record : with the keys ``state``, ``phases`` and ``impact``, or ``steps``.
    points : Chebyshev points of every phase.
    """
    sides = map(dynamics.system.walker.side, count())
    return tuple(
        _integrated(dynamics.standing(side), step, points, side)
        for side, step in zip(sides, record.get("steps", (record,)), strict=False)
    )


def _integrated(dynamics: Dynamics, record: Mapping[str, Any], points: int, side: int) -> Step:
    """One step from the record of its state after impact, its phases and its impact."""
    system, p = dynamics.system, dynamics.p
    z = np.array([record["state"][name] for name in system.state_names])
    time, arcs = 0.0, list[Arc]()
    for phase in record["phases"]:
        mode = Mode.from_record(phase)
        if arcs and mode.locked != arcs[-1].mode.locked:  # a stop has locked
            z = dynamics.after_impact(mode, z)
        if mode.sticks:
            z[-1] = 0.0
        for start, end, segment in _segments(time, time + phase["duration"], system.control.breakpoints):
            times = start + (end - start) * (curves.points(points) + 1) / 2
            states = integrate_to(system, mode, z, times, p, system.control.data(segment))
            arcs.append(Arc(mode=mode, segment=segment, times=times, states=states, side=side))
            z = states[-1].copy()
        time += phase["duration"]
    return Step(arcs=tuple(arcs), impact=impact_record(dynamics, Mode(record["impact"]), z))


def _segments(start: float, end: float, breakpoints: Sequence[float]) -> list[tuple[float, float, int]]:
    """Pieces of [start, end] between the control's breakpoints, each with its segment."""
    cuts = [start, *(b for b in breakpoints if start < b < end), end]
    middles = [(a + b) / 2 for a, b in pairwise(cuts)]
    segments = np.searchsorted(breakpoints, middles, side="right")
    return [(a, b, int(k)) for a, b, k in zip(cuts[:-1], cuts[1:], segments, strict=True)]
