"""Gaits of other mode sequences next to a known one: its family is followed a little way, and may come back.

Where a mode sequence is about to change, the branch turns or other branches begin, several gaits exist side by side,
of which some attract no walk. Each time that a branch of the family crosses the parameter's own value there is one.
"""

from collections.abc import Iterator

from gaitopt.callbacks import Stop
from gaitopt.errors import ProblemError, SolveError
from gaitopt.families import Request, follow_family
from gaitopt.gait import BranchPoint, Gait
from gaitopt.problem import Problem
from gaitopt.search.candidates import Record, SearchJob, cycle_record
from gaitopt.study.system import solve_sequence

REACH = 0.25
"""Part of a parameter's value by which a family is followed to either side."""
MAX_POINTS = 150
"""Bound on the work for one direction; without folds there are forty."""


def varied(problem: Problem) -> list[str]:
    """Parameters along which families are followed: the coefficients of friction and the slope."""
    keys = [key for key in problem.parameters if key.partition(".")[0] == "friction" or key == "walker.slope"]
    return [key for key in keys if problem.parameters[key]]


def search_family(job: SearchJob, _: None = None, should_stop: Stop = None) -> Record:
    """Candidates on the family of one gait, that of the job's closed problem, along the job's parameter."""
    gait = solve_sequence(job.problem, should_stop=should_stop)
    candidates = list[Record]()
    if gait.converged:
        value, start = job.problem.parameters[job.parameter], f"{job.method} {job.number}, {job.parameter}"
        for side in (-1, 1):
            candidates += [
                cycle_record(gait.system, crossing.steps, start)
                for crossing in _crossings(gait, job, value * (1 + side * REACH), should_stop)
            ]
    if should_stop is not None and should_stop():
        raise KeyboardInterrupt
    return {"method": job.method, "starts": 1, "candidates": candidates}


def _crossings(gait: Gait, job: SearchJob, to: float, should_stop: Stop) -> Iterator[Gait]:
    """Gaits of a family next to which a branch crosses the value at which it begins, on the way to another one."""
    value = job.problem.parameters[job.parameter]
    request = Request(
        parameter=job.parameter,
        to=(to,),
        max_points=MAX_POINTS,
        verify_every=0,
        follow={"branch_points": 1, "mode_changes": 1, "doublings": job.n_steps // (2 * len(gait.steps))},
    )
    before: BranchPoint | None = None
    try:
        for record in follow_family(gait, request, should_stop=should_stop):
            if not isinstance(record, BranchPoint):
                continue
            same = before is not None and before.branch == record.branch
            if before is not None and same and (before.value - value) * (record.value - value) < 0:
                yield min(before, record, key=lambda point: abs(point.value - value)).gait
            before = record
    except (ProblemError, SolveError):  # the family cannot be followed in this parameter at all, or no further
        return
