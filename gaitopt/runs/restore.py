"""Gaits and walks from run folders, with everything that fresh ones have except the solver's own nodes."""

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import accumulate, groupby, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gaitopt.errors import SolveError, StorageError
from gaitopt.gait import Arc, Ending, Gait, Status, Step, Trajectory, measure
from gaitopt.gait.records import GaitRecord, WalkRecord, differing
from gaitopt.mechanics import Dynamics, Mode
from gaitopt.nlp.assembly import impact_record
from gaitopt.search.distinct import closed
from gaitopt.store import GAIT_FILE, WALK_FILE, Table, read_problem
from gaitopt.store.records import damaged, validated
from gaitopt.store.run import WALK_FILES, read_run
from gaitopt.study.simulate import Walk
from gaitopt.study.system import problem_dynamics

SAME_TIME = 1e-14
"""Of the period: the end of one arc and the start of the next may differ by rounding, points inside an arc do not."""


def restore_gait(folder: Path) -> Gait:
    """The gait in a run folder.

    Raises
    ------
    SolveError
        If the run holds a failed attempt.
    """
    (record, table), problem = read_run(folder), read_problem(folder)
    if record.get("status") in [status for status in Status if status is not Status.CONVERGED]:
        raise SolveError(f"{folder} holds no gait: {record.get('status')}, {record.get('message')}")
    path = folder / GAIT_FILE
    validated(GaitRecord, record, path, states=problem.walker.state_names())
    if problem.is_open:
        problem = replace(closed(problem, record), origin=problem)
    try:
        freed = {name: float(value) for name, value in record["parameters"].items()}
        dynamics = problem_dynamics(problem).at(freed)
        periods = [float(step["period"]) for step in record.get("steps", (record,))]
        began = list(accumulate(periods[:-1], initial=0.0))
        steps = _table_steps(dynamics, table, began, problem.cycle.impacts)
        multipliers = np.array([complex(m["re"], m["im"]) for m in record["multipliers"]])
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise StorageError(f"{folder}: gait.json or trajectory.csv does not hold a gait ({error!r})") from error
    gait = Gait(
        problem=problem,
        dynamics=dynamics,
        status=Status.CONVERGED,
        message=str(record.get("message", "")),
        steps=steps,
        multipliers=multipliers,
        measures=measure(dynamics, steps),
        freed=freed,
        solver=dict(record.get("solver", {})),
        verification=record.get("verification"),
    )
    _check_same(path, record, gait.to_record())
    return gait


def restore_walk(folder: Path) -> Walk:
    """The walk that a run folder holds."""
    record, table = read_run(folder, WALK_FILES)
    problem = read_problem(folder)
    try:
        validated(WalkRecord, record, folder / WALK_FILE, states=problem.walker.state_names())
        dynamics = problem_dynamics(problem).at(record["parameters"])
        system = dynamics.system
        section = record["section"]
        began = [float(point["time"]) for point in section]
        impacts = [Mode(point["impact"]) for point in section[1:]]
        start, *_ = (np.array([point["state"][name] for name in system.state_names]) for point in section)
        gait = [[float(state[name]) for name in system.state_names] for state in record["gait_states"]]
        ending, message = Ending(record["status"]), str(record["message"])
        steps = _table_steps(dynamics, table, began, impacts) if table.rows else ()
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise StorageError(f"{folder}: walk.json or walk.csv does not hold a walk ({error!r})") from error
    trajectory = Trajectory(names=system.state_names, start=start, steps=steps, ending=ending, message=message)
    states = np.array(gait).reshape(-1, len(system.state_names))
    walk = Walk(problem=problem, dynamics=dynamics, trajectory=trajectory, gait_states=states)
    _check_same(folder / WALK_FILE, record, walk.to_record())
    return walk


def _check_same(path: Path, record: Mapping[str, Any], restored: Mapping[str, Any]) -> None:
    """Refuse a record that differs from what its table says."""
    key = differing(record, restored)
    if key:
        raise damaged(path, f"{key}: is not what the table beside it gives")


def _table_steps(dynamics: Dynamics, table: Table, began: Sequence[float], impacts: Sequence[Mode]) -> tuple[Step, ...]:
    """The steps of a table, in which time runs on over the impacts; the last one of a walk may have no impact.

    A time that occurs twice separates two arcs.
    """
    system, rows = dynamics.system, list[Any](table.rows)
    splits = np.cumsum([0, *(later[0] - earlier[0] <= SAME_TIME * rows[-1][0] for earlier, later in pairwise(rows))])
    arcs: dict[int, list[Arc]] = {}
    for _, group in groupby(zip(splits, rows, strict=True), key=lambda pair: pair[0]):
        points = [row for _, row in group]
        if len(points) < 2:
            raise ValueError(f"an arc of one point at {points[0][0]}")
        step = bisect_right(began, (points[0][0] + points[-1][0]) / 2) - 1
        times = np.array([row[0] for row in points]) - began[step]
        arc = Arc(
            mode=Mode(points[0][1]),
            segment=bisect_right(system.control.breakpoints, (times[0] + times[-1]) / 2),
            times=times,
            states=np.array([row[2 : 2 + system.n_z] for row in points], dtype=float),
            side=system.walker.side(step),
        )
        arcs.setdefault(step, []).append(arc)
    return tuple(
        Step(
            arcs=tuple(arcs[k]),
            impact=impact_record(dynamics.standing(arcs[k][0].side), impacts[k], arcs[k][-1].states[-1])
            if k < len(impacts)
            else None,
        )
        for k in range(max(len(impacts), 1 + max(arcs)))
    )
