"""Gaits, walks and special points from their records: the inverse of ``to_record``.

A record holds the state after each impact, modes and durations, multipliers and scalars. The motion between the impacts
comes from the table beside the record. Without a table it is integrated again from the state, z(t) = Phi_mode(t;
z_plus), which gives every digit of the original gait, but at other nodes than those of the solver.
"""

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle, groupby, pairwise
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from gaitopt.gait import curves
from gaitopt.gait.branch import BranchPoint, ContinuationState, SpecialPoint
from gaitopt.gait.gait import Gait, Status
from gaitopt.gait.ranges import DesignRange
from gaitopt.gait.records import (
    GaitRecord,
    PointRecord,
    SpecialRecord,
    StepRecord,
    TracePointRecord,
    TraceSpecialRecord,
    special_gait,
)
from gaitopt.gait.trace import CurveStart, TracePoint, TraceSpecial
from gaitopt.gait.trajectory import Arc, Step, impact_record
from gaitopt.model.cycle import UNTIL, Cycle
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.open_loop import OpenLoop
from gaitopt.problem.floor import Floor
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import MEASURES
from gaitopt.simulation.ground import Ground
from gaitopt.solver.interval import integrate_to
from gaitopt.solver.mesh import nearest
from gaitopt.store.formats import Table

POINTS = 33
"""Number of Chebyshev points of a phase; they resolve a phase of walking."""
LARGEST_CLOSING_ERROR = 1e-9
"""Largest difference between the states at the start and the end of a cycle that rounding can cause, in natural
units."""
SAME_TIME = 1e-14
"""Largest distance, relative to the period, by which rounding separates the end of an arc from the start of the next.
Other points of a motion are farther apart."""
MISSING_SCALARS = {"damping_loss": 0.0, "gravity_cost": None, "torque_cost": None, "apex_height": None}
"""Values of the scalars that records of earlier versions lack."""


def multipliers_of(record: Mapping[str, Any]) -> NDArray[np.complex128]:
    """Floquet multipliers of a gait's record; shape (n,)."""
    return np.array([complex(m["re"], m["im"]) for m in record["multipliers"]], dtype=complex)


def freed_values(record: GaitRecord) -> dict[str, float]:
    """Values of the freed parameters in a gait's record, by dotted key."""
    return {name: float(value) for name, value in record["parameters"].items()}


def gait_from_record(
    problem: Problem,
    dynamics: Dynamics,
    record: GaitRecord,
    steps: tuple[Step, ...],
    measures: Mapping[str, float | None] | None = None,
) -> Gait:
    """The gait of a record with a known motion.

    Parameters
    ----------
    dynamics : dynamics at the parameters of the gait.
    steps : the motion, from ``tabulated_steps`` or ``integrated_steps``.
    measures : the scalars by name; None to take those of the record.
    """
    scalars: Mapping[str, Any] = {**MISSING_SCALARS, **record}
    return Gait(
        problem=problem,
        dynamics=dynamics,
        status=Status(record["status"]),
        message=str(record["message"]),
        steps=steps,
        multipliers=multipliers_of(record),
        measures={name: scalars[name] for name in MEASURES} if measures is None else measures,
        freed=freed_values(record),
        solver=cast(Mapping[str, float | str], record["solver"]),
        verification=record["verification"],
        timed=Cycle.from_record(record).timed,
        over=DesignRange.from_record(record["over"]) if "over" in record else None,
    )


def problem_of_record(problem: Problem, record: GaitRecord) -> Problem:
    """The problem of a gait in the results of a problem.

    Torques of the record replace open-loop ones that are sought. A design over a range is one at the own value.
    """
    law, problem = problem.control, problem.at_own_value()
    if not isinstance(law, OpenLoop) or law.duration is not None or problem.is_open:
        return problem
    durations = [phase["duration"] for phase in record["phases"]]
    duration = record["solver"].get("duration")  # that of the law, which earlier versions did not store
    known = float(duration) if isinstance(duration, int | float) else None
    return problem.with_torques(freed_values(record), record["state"], durations, known)


def branch_gait(family: Gait, values: Mapping[str, float], record: GaitRecord) -> Gait:
    """The gait of a point or special point, from its record; ``family`` is any gait of the family.

    Parameters
    ----------
    values : values of the parameters of the branch by dotted key.
    """
    dynamics, cycle_of_modes = family.dynamics.at({**freed_values(record), **values}), Cycle.from_record(record)
    state, direction = dict(record["state"]), cycle_of_modes.steps[-1].impact.direction
    if direction and state.get("dx", direction) * direction <= 0:  # rounded, where the slip of the impact vanishes
        state["dx"] = direction * float(np.finfo(float).tiny)
    problem = family.problem.replace(dict(values)).with_modes(cycle_of_modes, state)
    return gait_from_record(problem, dynamics, record, integrated_steps(dynamics, record))


def branch_point(family: Gait, parameter: str, record: PointRecord) -> BranchPoint:
    """The point of a branch from its record."""
    state = record.get("walk")
    return BranchPoint(
        branch=record["branch"],
        index=record["index"],
        value=record["value"],
        gait=branch_gait(family, {parameter: record["value"]}, record),
        tangent=np.array(record["tangent"], dtype=float),
        length=float(record["length"]),
        walk=None if state is None else ContinuationState.from_record(state),
    )


def special_point(family: Gait, parameter: str, record: SpecialRecord) -> SpecialPoint:
    """The special point of a branch from its record."""
    tangent, gait = record.get("tangent"), special_gait(record)
    return SpecialPoint(
        branch=record["branch"],
        type=record["type"],
        value=record["value"],
        status=record["status"],
        reason=record["reason"],
        before=Cycle.from_record(record["from"]) if "from" in record else None,
        after=Cycle.from_record(record["to"]) if "to" in record else None,
        contact=record.get("contact", ""),
        next=tuple(record["next"]),
        bound=record.get("bound", False),
        open=record.get("open", False),
        gait=None if gait is None else branch_gait(family, {parameter: record["value"]}, gait),
        tangent=None if tangent is None else np.array(tangent),
        parameter=parameter,
        coefficients=record.get("coefficients", {}),
    )


def trace_point(family: Gait, record: TracePointRecord) -> TracePoint:
    """The point of a curve in two parameters from its record."""
    return TracePoint(
        curve=record["curve"],
        index=record["index"],
        values=record["values"],
        gait=branch_gait(family, record["values"], record),
        condition=record["condition"],
        tangent=np.array(record["tangent"], dtype=float),
        length=float(record["length"]),
        walk=ContinuationState.from_record(record["walk"]),
    )


def trace_special(family: Gait, parameter: str, record: TraceSpecialRecord) -> TraceSpecial:
    """The special point of a curve in two parameters from its record; ``parameter`` is the first one."""
    gait, starts = branch_gait(family, record["values"], record["gait"]), list[CurveStart]()
    for start in record["next"]:
        own = start.get("gait")
        begins = gait if own is None else branch_gait(family, {k: own["parameters"][k] for k in record["values"]}, own)
        starts.append(CurveStart.from_record(start, parameter, begins))
    return TraceSpecial(
        curve=record["curve"],
        type=record["type"],
        values=record["values"],
        codimension=record["codimension"],
        status=record["status"],
        reason=record["reason"],
        coefficients=record["coefficients"],
        next=tuple(starts),
        before=Cycle.from_record(record["from"]) if "from" in record else None,
        after=Cycle.from_record(record["to"]) if "to" in record else None,
        bound=record.get("bound", False),
        open=record.get("open", False),
        gait=gait,
    )


def integrated_steps(dynamics: Dynamics, record: Mapping[str, Any], points: int = POINTS) -> tuple[Step, ...]:
    """The steps of a gait, integrated from its states after the impacts.

    One integration step between two points is accurate enough for most motions. If the cycle does not close, the motion
    is integrated again with shorter steps and more points.

    Parameters
    ----------
    dynamics : dynamics at the parameters of the record.
    record : a record with the keys ``state``, ``phases`` and ``impact``, or ``steps``.
    points : number of Chebyshev points of every phase.
    """
    first = np.array([record["state"][name] for name in dynamics.system.state_names])
    pairs = list(zip(cycle(dynamics.acting(first).steps), record.get("steps", (record,)), strict=False))
    steps = tuple(_integrated(of_step, step, (points,)) for of_step, step in pairs)
    if closing_error(steps) < LARGEST_CLOSING_ERROR:
        return steps
    return tuple(_integrated(of_step, step, curves.COUNTS, accurate=True) for of_step, step in pairs)


def closing_error(steps: Sequence[Step]) -> float:
    """Largest difference between the states at the start and the end of a cycle, in natural units."""
    start = steps[0].arcs[0]
    return float(np.abs((steps[-1].final_impact.state - start.states[0]) / start.dynamics.state_units).max())


def _integrated(
    dynamics: Dynamics, record: GaitRecord | StepRecord, counts: Sequence[int], *, accurate: bool = False
) -> Step:
    """A step whose arcs have the first number of Chebyshev points in ``counts`` that resolves them, or the last one."""
    system, p = dynamics.system, dynamics.p
    breakpoints, units = system.control.breakpoints, dynamics.state_units
    z = np.array([record["state"][name] for name in system.state_names])
    time, arcs = 0.0, list[Arc]()
    for phase in record["phases"]:
        mode = Mode.from_record(phase)
        struck = Mode.from_record(phase["impact"]) if "impact" in phase else None
        if arcs and struck is not None:
            z = dynamics.after_impact(system.transitions.struck_within(struck), z, arcs[-1].mode, ends_step=False)
        elif arcs and mode.locked != arcs[-1].mode.locked:  # a stop has locked
            z = dynamics.after_impact(mode, z, arcs[-1].mode, ends_step=False)
        if mode.fixes_x:
            z[-1] = 0.0
        end = time + phase["duration"]
        if UNTIL in phase:  # end exactly at the breakpoint, beyond which the next phase starts
            end = nearest(breakpoints, end)
        for t0, t1 in pairwise([time, *(b for b in breakpoints if time < b < end), end]):
            segment = bisect_right(breakpoints, (t0 + t1) / 2)
            data = system.control.data(segment)
            for count in counts:
                times = t0 + (t1 - t0) * (curves.points(count) + 1) / 2
                states = integrate_to(system, mode, z, times, p, data, units if accurate else None)
                if curves.tail(states / units) < curves.RESOLVED:
                    break
            arcs.append(Arc(dynamics=dynamics, mode=mode, segment=segment, times=times, states=states, struck=struck))
            z, struck = states[-1].copy(), None
        time = end
    impact = Mode.from_record(record["impact"])
    return Step(arcs=tuple(arcs), impact=impact_record(dynamics, impact, z, arcs[-1].mode))


def tabulated_steps(
    dynamics: Dynamics, table: Table, starts: Sequence[float], impacts: Sequence[Mode], floor: Floor | None = None
) -> tuple[Step, ...]:
    """The steps of a table that ``trajectory_rows`` wrote.

    In such a table, a time that occurs twice separates two arcs.

    Parameters
    ----------
    starts : the time at which each step begins [s].
    impacts : the mode of the impact after each step; the last step of a walk may have none.
    floor : the tiles on which the walker walked, if it was not the nominal floor.

    Raises
    ------
    ValueError
        If an arc has a single point.
    """
    system, rows = dynamics.system, list[Any](table.rows)
    splits = np.cumsum([0, *(later[0] - earlier[0] <= SAME_TIME * rows[-1][0] for earlier, later in pairwise(rows))])
    arcs: dict[int, list[Arc]] = {}
    for _, group in groupby(zip(splits, rows, strict=True), key=lambda pair: pair[0]):
        points = [row for _, row in group]
        if len(points) < 2:
            raise ValueError(f"an arc of one point at {points[0][0]}")
        step = bisect_right(starts, (points[0][0] + points[-1][0]) / 2) - 1
        times = np.array([row[0] for row in points]) - starts[step]
        arc = Arc(
            dynamics=dynamics.steps[step % len(dynamics.steps)],
            mode=Mode(points[0][1]),
            segment=bisect_right(system.control.breakpoints, (times[0] + times[-1]) / 2),
            times=times,
            states=np.array([row[2 : 2 + system.n_z] for row in points], dtype=float),
        )
        arcs.setdefault(step, []).append(arc)
    correction = system.correction
    if correction is not None:  # it has corrected parameters at the beginning of every cycle
        for n in sorted(arcs):
            if n % correction.every == 0:
                acting = dynamics.acting(arcs[n][0].states[0]).steps
            arcs[n] = [replace(arc, dynamics=acting[n % len(acting)]) for arc in arcs[n]]
    if floor is not None:
        ground, tiles = Ground(dynamics, floor), dict[str, int]()
        for n in sorted(arcs):
            tiles = ground.following(n - 1, tiles, impacts[n - 1]) if n else ground.start(arcs[0][0].states[0])
            arcs[n] = ground.of_step(n, tiles, arcs[n])
    return tuple(
        Step(
            arcs=tuple(arcs[k]),
            impact=impact_record(arcs[k][-1].dynamics, impacts[k], arcs[k][-1].states[-1], arcs[k][-1].mode)
            if k < len(impacts)
            else None,
        )
        for k in range(max(len(impacts), 1 + max(arcs)))
    )
