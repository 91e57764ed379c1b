"""Jobs whose results a run folder keeps: the one mechanism of sweeps, fronts, basins, many starts and searches.

A job has a key, an argument and perhaps a parent, from whose result it starts. A result is on the disk before the next
one is accepted, so that no job is ever done twice: the same call resumes where it stopped. Jobs are drawn one by one as
workers become free; a later one may depend on the results of earlier ones.

A problem is a job whose key is the hash of what it resolves to. All sweeps, fronts and starts of a problem share the
file of solved problems.
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from gaitopt.callbacks import Counted, Stop
from gaitopt.errors import SolveError
from gaitopt.gait.gait import Status
from gaitopt.gait.records import JobRecord, PartRecord
from gaitopt.problem.problem import Problem
from gaitopt.search.find import Gaits, Part, SearchPlan, Task, search
from gaitopt.search.solve import solve
from gaitopt.store.files import validated
from gaitopt.store.run import Run
from gaitopt.verification.verify import verify
from gaitopt.workers.jobs import FailedJob, Job, Workers, run_jobs

Keep = Callable[[str, Any], Any]
SET_ASIDE = "set_aside"
"""Status of a job that has no result."""


class KeptJobs:
    """Jobs of one kind with their results.

    Parameters
    ----------
    results : those that are on the disk, by key; new ones are added.
    keep : stores a new result by its key, and returns what is to be held of it in memory.
    progress : called with the number of jobs done and their total.
    should_stop : polled before every job.
    """

    def __init__(
        self, results: dict[str, Any], keep: Keep, workers: Workers, progress: Counted = None, should_stop: Stop = None
    ) -> None:
        self.results = results
        self._keep, self._workers, self._progress, self._should_stop = keep, workers, progress, should_stop

    def complete(self, task: Callable[..., Any], jobs: Iterable[Job], total: int) -> list[Any]:
        """Do the jobs that have no result yet.

        Parameters
        ----------
        task : see ``run_jobs``.
        jobs : drawn one by one; where there is one process, a job is drawn after the results of those before it.
        total : their number.

        Returns
        -------
        results : in the order of the jobs; a ``FailedJob`` is not stored, and tried again by the next call.

        Raises
        ------
        KeyboardInterrupt
            If ``should_stop`` returned True; finished jobs are kept.
        """
        keys, drawn, done = list[str](), set[str](), 0

        def missing() -> Iterator[Job]:
            nonlocal done
            for job in jobs:
                if self._should_stop is not None and self._should_stop():
                    return
                keys.append(job.key)
                if job.key in self.results or job.key in drawn:
                    done += 1
                else:
                    drawn.add(job.key)
                    yield job

        for key, result in run_jobs(task, missing(), self._workers, self.results, should_stop=self._should_stop):
            self.results[key] = result if isinstance(result, FailedJob) else self._keep(key, result)
            done += 1
            if self._progress is not None:
                self._progress(done, total)
        if done < total:
            raise KeyboardInterrupt
        return [self.results[key] for key in keys]


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultFile:
    """A file with one result per line: its name, the entry with the key of the job, and the type of a line."""

    name: str
    key: str
    model: Any


SOLVED = ResultFile(name="jobs.jsonl", key="job", model=JobRecord)
SEARCHED = ResultFile(name="find.jsonl", key="part", model=PartRecord)
"""A part that an earlier version has stored under another key is searched again."""


@contextmanager
def jobs_in(
    run: Run,
    file: ResultFile,
    workers: Workers,
    *,
    states: Sequence[str] | None = None,
    progress: Counted = None,
    should_stop: Stop = None,
) -> Iterator[KeptJobs]:
    """The jobs of a file in a run folder that the caller has locked; ``states`` are names that every state must have.

    Raises
    ------
    StorageError
        If a line of the file is not of its type; the message names it.
    """
    with run.appending(file.name) as log:
        results = dict[str, Any]()
        for number, record in enumerate(log.records, start=1):
            validated(file.model, record, run.path(file.name), number, states=states)
            results[record[file.key]] = record

        def keep(key: str, result: Mapping[str, Any]) -> dict[str, Any]:
            record = {file.key: key, **result}
            log.append(record)
            return record

        yield KeptJobs(results, keep, workers, progress, should_stop)


def problem_job(problem: Problem, parent: str | None = None) -> Job:
    """The job of a problem that starts cold, or from the gait of the job ``parent``."""
    key = problem.digest if parent is None else hashlib.sha256((problem.digest + parent).encode()).hexdigest()
    return Job(key=key, argument=problem, parent=parent)


def solve_all(
    run: Run,
    problem: Problem,
    jobs: Callable[[Mapping[str, Any]], Iterable[Job]],
    total: int,
    workers: Workers,
    *,
    progress: Counted = None,
    should_stop: Stop = None,
) -> list[dict[str, Any]]:
    """Solve and verify problems; records of their gaits in the order of the jobs, kept in the run of ``problem``.

    Parameters
    ----------
    jobs : gives the jobs of ``problem_job``, from the results of earlier ones by key.
    total : their number.
    """
    names = problem.walker.state_names()
    with (
        run.begun(problem),
        jobs_in(run, SOLVED, workers, states=names, progress=progress, should_stop=should_stop) as kept,
    ):
        results = kept.complete(solve_job, jobs(kept.results), total)
    return [
        {"status": SET_ASIDE, "message": result.reason} if isinstance(result, FailedJob) else result
        for result in results
    ]


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


def find_durably(
    plan: SearchPlan, run: Run, workers: Workers, *, progress: Counted = None, should_stop: Stop = None
) -> Gaits:
    """The search of a plan, whose parts are kept in a run of its problem."""
    names = plan.problem.walker.state_names()
    with (
        run.begun(plan.problem),
        jobs_in(run, SEARCHED, workers, states=names, progress=progress, should_stop=should_stop) as kept,
    ):

        def complete(task: Task, jobs: list[Job]) -> list[Part]:
            return kept.complete(task, jobs, len(jobs))

        return search(plan, complete, should_stop=should_stop)
