"""Jobs whose results are kept in a file of a run folder, one line each, so that no job is ever done twice.

A result is on the disk before the next one is taken in.

Problems solved and verified, each once: the results are in one file that all sweeps and starts of a problem share.

A job is named by the hash of its resolved problem.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gaitopt.callbacks import Counted, Stop
from gaitopt.errors import SolveError
from gaitopt.gait.gait import Status
from gaitopt.gait.records import JobRecord
from gaitopt.problem.problem import Problem
from gaitopt.search.solve import solve
from gaitopt.store.files import validated
from gaitopt.store.folder import growing, stored_lines
from gaitopt.verification.verify import verify
from gaitopt.workers.jobs import FailedJob, Job, Workers, run_jobs


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultFile:
    """A file of results: its name, the entry of a line that holds the key of its job, and what a line must have."""

    name: str
    key: str
    model: Any


def kept_results(
    task: Callable[..., Any],
    jobs: list[Job],
    workers: Workers,
    folder: Path,
    file: ResultFile,
    *,
    known: Mapping[str, Any] | None = None,
    progress: Counted = None,
    should_stop: Stop = None,
    states: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Results of all jobs by their keys, those that the folder holds included; a ``FailedJob`` is not kept.

    Parameters
    ----------
    folder : of the run, held for writing by the caller.
    known : results of parents that are not among the jobs.
    states : names that every state of a result must have.
    progress : called with the number of jobs done and their total.
    """
    by_key, results = {job.key: job for job in jobs}, dict[str, Any]()
    for number, record in enumerate(stored_lines(folder, file.name), start=1):
        validated(file.model, record, folder / file.name, number, states=states)
        if record[file.key] in by_key:
            results[record[file.key]] = record
    missing = [job for key, job in by_key.items() if key not in results]
    with growing(folder, file.name) as log:
        done = {**(known or {}), **results}
        for key, result in run_jobs(task, missing, workers, done=done, should_stop=should_stop):
            results[key] = result if isinstance(result, FailedJob) else {file.key: key, **result}
            if not isinstance(result, FailedJob):
                log.append(results[key])
            if progress is not None:
                progress(len(results), len(by_key))
    if len(results) < len(by_key):
        raise KeyboardInterrupt
    return results


SET_ASIDE = "set_aside"
"""Status of a job that has no result."""


JOBS = ResultFile(name="jobs.jsonl", key="job", model=JobRecord)


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
    progress: Counted = None,
    should_stop: Stop = None,
) -> dict[str, dict[str, Any]]:
    """Records of the gaits of all jobs by their keys; arguments and errors are those of ``kept_results``.

    Parameters
    ----------
    jobs : with a ``Problem`` as argument; the gait of the parent is the guess that is tried first.
    """
    states = jobs[0].argument.walker.state_names() if jobs else None
    results = kept_results(
        solve_job, jobs, workers, folder, JOBS, known=known, progress=progress, should_stop=should_stop, states=states
    )
    return {
        key: {"status": SET_ASIDE, "message": result.reason} if isinstance(result, FailedJob) else result
        for key, result in results.items()
    }


def solve_job(problem: Problem, neighbour: Mapping[str, Any] | None = None, should_stop: Stop = None) -> dict[str, Any]:
    """The record of a problem's verified gait, from that of a neighbour if there is one; runs in any process."""
    starts = {"cold": problem}
    if neighbour is not None and neighbour["status"] == Status.CONVERGED:
        starts = {"warm": problem.with_guess(neighbour)} | starts
    for start, candidate in starts.items():
        try:
            gait = solve(candidate, should_stop=should_stop)
        except SolveError as error:
            if should_stop is not None and should_stop():  # a reference whose solution was interrupted
                raise KeyboardInterrupt from None
            return {"status": str(Status.NOT_CONVERGED), "message": str(error), "start": start}
        if gait.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if gait.converged:
            gait = gait.verified(verify(gait).to_record())
            break
    return {**gait.to_record(), "start": start}
