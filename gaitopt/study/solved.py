"""Problems solved and verified, each once: what is found is kept in a file of a run folder, line by line.

A job is named by the hash of its resolved problem. Its result is on disk before the next one is taken in, in a file
that all sweeps and starts of a problem share, so that nothing is solved twice, whatever happens in between.
"""

import hashlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from gaitopt.errors import SolveError
from gaitopt.gait import Status
from gaitopt.problem import Problem
from gaitopt.store import LineWriter, read_lines
from gaitopt.store.files import make_folder
from gaitopt.store.lock import only_writer
from gaitopt.study.jobs import Job, SetAside, Workers, run_jobs
from gaitopt.study.solve import solve
from gaitopt.study.verify import verify
from gaitopt.study.warm import guessed_from

JOBS_FILE = "jobs.jsonl"
SET_ASIDE = "set_aside"
"""Status of a job that has no result."""


def problem_job(problem: Problem, parent: str | None = None) -> Job:
    """The job of a problem that starts cold, or from the gait of the job ``parent``."""
    key = problem.digest if parent is None else hashlib.sha256((problem.digest + parent).encode()).hexdigest()
    return Job(key=key, argument=problem, parent=parent)


def solve_all(
    jobs: list[Job],
    folder: Path,
    workers: Workers,
    *,
    known: Mapping[str, Any] | None = None,
    progress: Callable[[int, int], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> dict[str, dict[str, Any]] | None:
    """Records of the gaits of all jobs by their keys, those on disk included; None if it was stopped.

    Parameters
    ----------
    jobs : with a ``Problem`` as argument; the gait of the parent is the guess that is tried first.
    folder : of the run that keeps the results.
    known : records of parents that are not among the jobs.
    progress : called with the number of jobs done and their total.

    Raises
    ------
    StorageError
        If the disk is full, or another process works in this folder; finished jobs are kept.
    """
    make_folder(folder)
    path = folder / JOBS_FILE
    with only_writer(path):
        wanted = {job.key: job for job in jobs}
        records = {r["job"]: r for r in read_lines(path) if r["job"] in wanted} if path.exists() else {}
        missing = [job for key, job in wanted.items() if key not in records]
        with LineWriter(path) as log:
            done = {**(known or {}), **records}
            for key, result in run_jobs(solve_job, missing, workers, done=done, should_stop=should_stop):
                if isinstance(result, SetAside):
                    records[key] = {"status": SET_ASIDE, "message": result.reason}
                else:
                    records[key] = {"job": key, **result}
                    log.append(records[key])
                if progress is not None:
                    progress(len(records), len(wanted))
    return records if len(records) == len(wanted) else None


def solve_job(problem: Problem, neighbour: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The record of a problem's gait with its verification, in whatever process.

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C was pressed here.
    """
    for start, candidate in _starts(problem, neighbour):
        try:
            gait = solve(candidate)
        except SolveError as error:
            return {"status": str(Status.NOT_CONVERGED), "message": str(error), "start": start}
        if gait.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if gait.converged:
            gait = gait.verified(verify(gait).to_record())
            break
    return {**gait.to_record(), "start": start}


def _starts(problem: Problem, neighbour: Mapping[str, Any] | None) -> Iterable[tuple[str, Problem]]:
    """The problem with the neighbour's gait as its guess, if there is one; then as it is."""
    if neighbour is not None and neighbour["status"] == Status.CONVERGED:
        yield "warm", guessed_from(problem, neighbour, neighbour["parameters"])
    yield "cold", problem
