"""A gait from its run folder, with everything that a fresh solution has except the solver's own nodes."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import accumulate, groupby, pairwise
from typing import Any

import numpy as np

from gaitopt.errors import SolveError, StorageError
from gaitopt.gait import Arc, Gait, Status, Step, measure
from gaitopt.mechanics import Cycle, Dynamics, HybridSystem, Mode
from gaitopt.nlp.assembly import impact_record
from gaitopt.search.distinct import closed
from gaitopt.store import Run, Table
from gaitopt.store.run import restored_problem
from gaitopt.study.system import problem_dynamics

SAME_TIME = 1e-14
"""Of the period: the end of one arc and the start of the next may differ by rounding, points inside an arc do not."""


def restore_gait(run: Run) -> Gait:
    """The gait that a run holds.

    Raises
    ------
    SolveError
        If the run holds a failed attempt.
    """
    problem = restored_problem(run.folder, run.resolved, run.problem_text)
    if run.gait.get("status") != Status.CONVERGED:
        raise SolveError(f"{run.folder} holds no gait: {run.gait.get('status')}, {run.gait.get('message')}")
    if problem.is_open:
        problem = replace(closed(problem, run.gait), origin=problem)
    try:
        freed = {name: float(value) for name, value in run.gait["parameters"].items()}
        dynamics = problem_dynamics(problem).at(freed)
        periods = [float(step["period"]) for step in run.gait.get("steps", (run.gait,))]
        steps = tuple(_steps(dynamics, problem.cycle, run.trajectory, periods))
        multipliers = np.array([complex(m["re"], m["im"]) for m in run.gait["multipliers"]])
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise StorageError(f"{run.folder}: gait.json or trajectory.csv does not hold a gait ({error!r})") from error
    return Gait(
        problem=problem,
        dynamics=dynamics,
        status=Status.CONVERGED,
        message=str(run.gait.get("message", "")),
        steps=steps,
        multipliers=multipliers,
        measures=measure(dynamics, steps),
        freed=freed,
        solver=dict(run.gait.get("solver", {})),
        verification=run.gait.get("verification"),
    )


def _steps(dynamics: Dynamics, cycle: Cycle, table: Table, periods: Sequence[float]) -> Iterator[Step]:
    """The steps of a table, in which time runs on over the impacts."""
    began = list(accumulate(periods[:-1], initial=0.0))
    arcs = list(table_arcs(dynamics.system, table, began))
    for step, impact in enumerate(cycle.impacts):
        own = tuple(arc for index, arc in arcs if index == step)
        standing = dynamics.standing(dynamics.system.walker.side(step))
        yield Step(arcs=own, impact=impact_record(standing, impact, own[-1].states[-1]))


def table_arcs(system: HybridSystem, table: Table, began: Sequence[float]) -> Iterator[tuple[int, Arc]]:
    """Every arc of a table and the index of its step; a time that occurs twice separates two arcs."""
    rows: list[Any] = list(table.rows)
    same = SAME_TIME * rows[-1][0]
    splits = np.cumsum([0, *(later[0] - earlier[0] <= same for earlier, later in pairwise(rows))])
    for _, group in groupby(zip(splits, rows, strict=True), key=lambda pair: pair[0]):
        points = [row for _, row in group]
        if len(points) < 2:
            raise ValueError(f"an arc of one point at {points[0][0]}")
        step = bisect_right(began, (points[0][0] + points[-1][0]) / 2) - 1
        times = np.array([row[0] for row in points]) - began[step]
        yield (
            step,
            Arc(
                mode=Mode(points[0][1]),
                segment=bisect_right(system.control.breakpoints, (times[0] + times[-1]) / 2),
                times=times,
                states=np.array([row[2 : 2 + system.n_z] for row in points], dtype=float),
                side=system.walker.side(step),
            ),
        )
