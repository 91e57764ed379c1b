"""A stored branch or trace, read back so that the resumed walk gives the same bits as an uninterrupted one.

The record of a point holds all bits of the unknowns, the tangent and the mesh. The records of earlier versions may lack
them; the gait is then solved again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np

from gaitopt.arrays import Array
from gaitopt.display import counted
from gaitopt.errors import StorageError
from gaitopt.gait.branch import TERMINAL, ContinuationState, SpecialPoint, split_after
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import BranchRecord, ConditionRecord, TraceRecord
from gaitopt.model.cycle import Cycle
from gaitopt.problem.problem import Problem
from gaitopt.solver.arclength import LARGEST_ROUNDING
from gaitopt.solver.mesh import Mesh, MeshArc
from gaitopt.solver.newton import Solution
from gaitopt.solver.rollout import roll_out
from gaitopt.solver.shooting import transcribe
from gaitopt.store.gaits import special_point


@dataclass(frozen=True, kw_only=True)
class StoredPoint:
    """The last point of a continuation.

    Attributes
    ----------
    branch, index : number of its branch, and of the point in it.
    length : arclength of the next step.
    problem : the problem with the value of the parameter, and with the modes and the state of the point.
    solution : the unknowns with their equations, in which the parameter is free.
    direction : ndarray - tangent of the branch in the unknowns. None if an earlier version wrote the record; the
        ``solution`` is then only a guess.
    tangent : ndarray - tangent of the branch in scaled section coordinates, durations and parameter.
    iterations : number of Newton iterations that the point took.
    earlier : unknowns and direction of the point before it, if the next one is extrapolated from both.
    """

    branch: int
    index: int
    length: float
    problem: Problem
    solution: Solution
    direction: Array | None
    tangent: Array
    iterations: int = 0
    earlier: tuple[Array, Array] | None = None


@dataclass(frozen=True, kw_only=True)
class StoredWalk:
    """The stored points of a walk along a curve.

    Attributes
    ----------
    count : number of points.
    last : the last point; None if there is no point, or if the walk is complete.
    metric : ndarray - scales of arclength; None if they are not stored.
    largest : largest number of a branch or curve in it, or of one that begins at its special points.
    is_complete : whether the walk has reached its end.
    """

    count: int
    last: StoredPoint | None
    metric: Array | None
    largest: int
    is_complete: bool


@dataclass(frozen=True, kw_only=True)
class StoredContinuation(StoredWalk):
    """The stored points of one continuation of a family.

    Attributes
    ----------
    number : number of its first branch.
    is_named : whether a special point of another continuation announces this number.
    specials : special points at which further branches begin.
    """

    number: int
    is_named: bool
    specials: tuple[SpecialPoint, ...]


@dataclass(frozen=True, kw_only=True)
class StoredTrace(StoredWalk):
    """The stored points of the walk towards one target in two parameters.

    Attributes
    ----------
    condition : the condition that holds along the curve at the last point.
    """

    metric: Array
    condition: ConditionRecord


def stored_continuations(family: Gait, parameter: str, records: Sequence[BranchRecord]) -> list[StoredContinuation]:
    """The continuations of a family from the records of its branches, in the order in which they began.

    Parameters
    ----------
    family : the gait from which the family begins, with the friction law that has the parameter.

    Raises
    ------
    StorageError
        If a continuation cannot be resumed from its records.
    """
    continuations, named = _by_continuation(records)
    read = list[StoredContinuation]()
    for number, stored in continuations.items():
        points = [record for record in stored if record["record"] == "point"]
        end = {parameter: points[-1]["value"]} if points else {}
        specials = [record for record in stored if record["record"] == "special"]
        # at some special points, branches begin besides the one with which the continuation proceeds
        beginning = [record for record in specials if len(record["next"]) > ("to" in record)]
        is_complete = stored[-1]["record"] == "special" and stored[-1]["type"] in TERMINAL
        metric = next((_metric(point) for point in points if point.get("walk") is not None), None)
        read.append(
            StoredContinuation(
                number=number,
                is_named=number in named,
                count=len(points),
                last=None if is_complete or not points else last_point(family, end, points),
                metric=metric,
                specials=tuple(special_point(family, parameter, record) for record in beginning),
                largest=max([record["branch"] for record in stored] + [n for each in specials for n in each["next"]]),
                is_complete=is_complete,
            )
        )
    return read


def stored_traces(family: Gait, free: tuple[str, str], records: Sequence[TraceRecord]) -> list[StoredTrace]:
    """The walks of a trace, from its records, in the order of their targets.

    Parameters
    ----------
    family : the gait from which it begins, with the friction law that has both parameters.
    free : dotted keys of both.

    Raises
    ------
    StorageError
        If a walk cannot be resumed from its records.
    """
    traces = list[StoredTrace]()
    for walk in _by_target(records):
        points = [record for record in walk if record["record"] == "point"]
        is_complete, last = walk[-1]["record"] == "special", points[-1]
        traces.append(
            StoredTrace(
                count=len(points),
                last=None if is_complete else last_point(family, {key: last["values"][key] for key in free}, points),
                metric=_metric(last),
                largest=last["curve"],
                is_complete=is_complete,
                condition=last["condition"],
            )
        )
    return traces


Exhausted = Callable[[int], str | None]
"""Function of the number of points of a walk that says why the walk pauses there; None if it proceeds."""


def resumable(records: Sequence[BranchRecord], exhausted: Exhausted) -> list[BranchRecord]:
    """The records from which an unfinished family is resumed."""
    walks = _by_continuation(records)[0].values()
    again = {id(record) for stored in walks for record in _located_again(stored, exhausted)}
    return [record for record in records if id(record) not in again]


def resumable_trace(records: Sequence[TraceRecord], exhausted: Exhausted) -> list[TraceRecord]:
    """The records from which an unfinished trace is resumed: up to the walk that continues."""
    kept = list[TraceRecord]()
    for walk in _by_target(records):
        again = _located_again(walk, exhausted)
        kept += walk[: len(walk) - len(again)]
        if again:
            break
    return kept


def _located_again(walk: Sequence[Any], exhausted: Exhausted) -> list[Any]:
    """The special points after the last point of a walk, the last one first, because they are located again.

    There are none if the walk is complete. An end at a limit of points or time is not final if more of them are allowed
    now.
    """
    points = sum(record["record"] == "point" for record in walk)

    def is_reached(record: Any) -> bool:
        if record["record"] == "point":
            return True
        return record["type"] in TERMINAL and not (record.get("open") and exhausted(points) is None)

    return [*takewhile(lambda record: not is_reached(record), reversed(walk))]


def _by_target(records: Sequence[TraceRecord]) -> list[list[TraceRecord]]:
    """The records of each walk of a trace: up to the end of its curve. Walks without a point are left out."""
    walks = split_after(records, lambda record: record["record"] == "special" and record["type"] == "end")
    return [walk for walk in walks if any(record["record"] == "point" for record in walk)]


def _by_continuation(records: Sequence[BranchRecord]) -> tuple[dict[int, list[BranchRecord]], set[int]]:
    """The records of each continuation by the number of its first branch, and the numbers given by special points."""
    first, continuations, given = dict[int, int](), dict[int, list[BranchRecord]](), set[int]()
    for record in records:
        number = first.setdefault(record["branch"], record["branch"])
        continuations.setdefault(number, []).append(record)
        if record["record"] == "special":
            following = list(record["next"])
            if following and "to" in record:  # the first of them belongs to this continuation
                first[following.pop(0)] = number
            given.update(following)
    return continuations, given


def _metric(point: Any) -> Array:
    try:
        return _state(point).metric
    except ValueError as error:
        raise unusable(point, error) from error


def last_point(family: Gait, values: Mapping[str, float], points: Sequence[Any]) -> StoredPoint:
    """The last point of a walk along a branch or a curve in two parameters, from the records of all its points.

    Parameters
    ----------
    family : the gait from which it begins, with the friction law that has the parameters.
    values : the values of the parameters there.

    Raises
    ------
    StorageError
        If the continuation cannot be resumed from the record.
    """
    record, free = points[-1], tuple(values)
    try:
        if not record["length"] > 0:
            raise ValueError(f"length {record['length']} is not positive")
        cycle, steps = Cycle.from_record(record), record.get("steps", (record,))
        problem = family.problem.replace(dict(values)).with_modes(cycle, steps[0]["state"])
        direction, earlier = None, None
        if record.get("walk") is None:
            states = np.array([[step["state"][name] for name in family.system.state_names] for step in steps])
            durations = np.array([phase["duration"] for phase in record["phases"]])
            rolled = roll_out(family.dynamics.at(values), cycle, states, durations)
            solution = rolled.on_mesh(free, record.get("intervals", ()))
        else:
            state = _state(record)
            if state.unknowns[-len(free) :].tolist() != [*values.values()]:
                stated = ", ".join(f"{key} = {value}" for key, value in values.items())
                raise ValueError(f"{stated} is not at the end of walk.unknowns")
            solution, direction = _stored_solution(family, problem, cycle, free, state), state.direction
            if state.earlier:
                before = _state(points[-1 - state.earlier])
                if {before.unknowns.size, before.direction.size} != {state.unknowns.size}:
                    raise ValueError("walk.unknowns do not have the size of those of the point before")
                earlier = before.unknowns, before.direction
        return StoredPoint(
            branch=record.get("branch", record.get("curve")),
            index=record["index"],
            length=record["length"],
            problem=problem,
            solution=solution,
            direction=direction,
            tangent=np.array(record["tangent"]),
            iterations=int(record["solver"]["iterations"] or 0),
            earlier=earlier,
        )
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise unusable(record, error) from error


def _state(point: Any) -> ContinuationState:
    state = point.get("walk")
    if state is None:
        raise ValueError("the point before it has no walk")
    return ContinuationState.from_record(state)


def _stored_solution(
    family: Gait, problem: Problem, cycle: Cycle, free: tuple[str, ...], state: ContinuationState
) -> Solution:
    """The unknowns of a state with their equations, in which some parameters are free.

    Raises
    ------
    ValueError
        If the state does not fit the modes, or is not a solution for them.
    """
    system = family.system
    n_nodes = sum(intervals for *_, intervals in state.arcs) + len(cycle.resets)
    if [*dict.fromkeys(arc[0] for arc in state.arcs)] != list(range(len(cycle.phases))):
        raise ValueError(f"walk.arcs do not cover the {counted(len(cycle.phases), 'phase')} in order")
    if {state.unknowns.size, state.direction.size} != {n_nodes * system.n_z + len(cycle.phases) + len(free)}:
        raise ValueError("walk.unknowns or walk.direction do not have the size that walk.arcs require")
    size = system.n_z + 1 + len(free)
    if state.metric.size != size or state.metric.min() <= 0:
        raise ValueError(f"walk.metric is not {size} positive numbers")
    if len(state.others) != len(free) - 1:
        raise ValueError(f"walk.others are {len(state.others)} values, must be {len(free) - 1}")
    origins = dict(zip(free, (*state.others, state.origin), strict=True))
    for key, origin in origins.items():
        if (objection := problem.objection(key, origin)) is not None:
            raise ValueError(f"walk.origin: {objection}")
    arcs = (
        MeshArc(phase=phase, mode=cycle.phases[phase], segment=segment, start=start, end=end, intervals=intervals)
        for phase, segment, start, end, intervals in state.arcs
    )
    equations = transcribe(system, Mesh(cycle=cycle, arcs=tuple(arcs)), free)
    solution = Solution(equations, state.unknowns, family.dynamics.at(origins).p)
    if not solution.size < LARGEST_ROUNDING:
        raise ValueError("walk.unknowns are not a gait with these phases")
    durations = solution.durations
    if durations.min() > 0 and not equations.mesh.in_order(durations, system.control.breakpoints):
        raise ValueError("walk.arcs do not match the segments of the control")
    return solution


def unusable(record: Any, error: Exception) -> StorageError:
    """The error for a point from which its branch or curve cannot be resumed."""
    fault = f"{error}" if isinstance(error, ValueError) else f"{error!r}"
    line = f"branch {record['branch']}" if "branch" in record else f"curve {record['curve']}"
    return StorageError(f"{line} cannot be resumed from its point {record['index']}: {fault}")
