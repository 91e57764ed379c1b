"""Long work as jobs with results in a run folder: the mechanism of sweeps, fronts, basins, starts and searches.

A ``Plan`` states the work. Its method ``complete`` does the jobs whose results are not on the disk yet. A result is on
the disk before the next one is accepted, so that the same plan resumes where it stopped. A job may start from the
results of earlier ones.

The key of a job that solves a problem is the hash of the problem's resolved values. All sweeps, fronts and starts of a
problem share the file of solved problems.
"""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Generic, Literal, TypeVar, cast

from gaitopt.callbacks import Counted, Stop, TimeLimit
from gaitopt.errors import SolveError, StorageError
from gaitopt.gait.gait import Status
from gaitopt.gait.records import AttemptRecord, CheckedJob, OutcomeRecord, SearchLineRecord, is_gait
from gaitopt.problem.problem import Problem
from gaitopt.requests import Method, Request
from gaitopt.search.find import Gaits, SearchPlan, search
from gaitopt.search.scan import NO_FIXED_POINT, possible_gaits, scanned
from gaitopt.search.solve import solve
from gaitopt.store.formats import damaged, validated
from gaitopt.store.run import Run
from gaitopt.verification.verify import verify
from gaitopt.verification.walk import simulate
from gaitopt.workers.jobs import FailedJob, Job, ResumableJobs, Workers

R = TypeVar("R", covariant=True)
Stored = tuple[dict[str, Any], Callable[[str, Any], Any]]
"""Results on the disk by the keys of their jobs, and the function that stores a new one."""
SAME_DIGITS = 7
"""Number of decimals to which the states of equal gaits agree; Newton's method leaves errors of 1e-10."""
SET_ASIDE: Literal["set_aside"] = "set_aside"
"""Status of a job that has no result."""


@dataclass(frozen=True, kw_only=True)
class Plan(Request, ABC, Generic[R]):
    """Long work: the request of a verb, with its problem and the run folder in which results are stored.

    Attributes
    ----------
    problem : the problem of the run.
    folder : the run folder.
    """

    problem: Problem
    folder: Path

    results: ClassVar["ResultFile"]
    """The file with the results of the jobs; a plan that stores them in another way overrides ``stored``."""

    @property
    def run(self) -> Run:
        """The run folder, or its subfolder with the files of this work."""
        return Run(self.folder)

    @abstractmethod
    def check(self) -> None:
        """Refuse work that cannot be done or stored, with the errors of the verb."""

    def stored(self) -> AbstractContextManager[Stored]:
        """Open the file of results in the locked run folder."""
        return self.results.opened(self.run, self.problem)

    @abstractmethod
    def result(self, jobs: ResumableJobs) -> R:
        """Complete the jobs, and write their summary if there is one."""

    def complete(
        self,
        workers: Workers | None = None,
        *,
        progress: Counted = None,
        should_stop: Stop = None,
        limit: TimeLimit | None = None,
    ) -> R:
        """Do the jobs that are not on the disk yet, and return the result of all jobs.

        Parameters
        ----------
        workers : where the jobs run, by default in one process per core.
        progress : called with the number of finished jobs and their total.
        should_stop : polled before every job.
        limit : time limit; only work that can do without some of its jobs has one.

        Raises
        ------
        StorageError
            If the folder cannot be used, or a stored result was altered.
        KeyboardInterrupt
            If ``should_stop`` returned True; finished jobs are stored.
        """
        self.check()
        with self.run.begun(self.problem), self.stored() as (results, store):
            return self.result(
                ResumableJobs(
                    workers=workers or Workers(),
                    results=results,
                    store=store,
                    progress=progress,
                    should_stop=should_stop,
                    limit=limit or TimeLimit(),
                )
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultFile:
    """A file with one result per line: its name, the entry with the key of the job, and the type of a line.

    A ``shared`` file is used by all work of a run and lies in the run folder, not in a subfolder. ``is_outdated`` tells
    whether an earlier version wrote a line, which is then refused.
    """

    name: str
    key: str
    model: Any
    shared: bool = False
    is_outdated: Callable[[Mapping[str, Any]], bool] | None = None

    def check(self, record: Mapping[str, Any], path: Path, number: int, **context: Any) -> None:
        """Raise a StorageError if a record does not match the type or lacks its key, or if it is outdated."""
        if self.is_outdated is not None and self.is_outdated(record):
            raise StorageError(f"{path.parent} was written by an earlier version: delete it and repeat the command")
        validated(self.model, record, path, number, **context)
        if self.key not in record:
            raise damaged(path, f"{self.key}: is missing", number)

    @contextmanager
    def opened(self, run: Run, problem: Problem) -> Iterator[Stored]:
        """The checked results in a run folder, and the function that appends one; the caller must hold the lock.

        Raises
        ------
        StorageError
            If a line does not match its type; the message names the line.
        """
        run = Run(run.folder) if self.shared else run
        with run.appending(self.name) as lines:
            results, states = dict[str, Any](), problem.walker.state_names()
            for number, record in enumerate(lines.records, start=1):
                self.check(record, run.path(self.name), number, states=states)
                results[record[self.key]] = record

            def store(key: str, result: Mapping[str, Any]) -> dict[str, Any]:
                record = {self.key: key, **result}
                lines.append(record)
                return record

            yield results, store

    def finished(self, run: Run, keys: Sequence[str]) -> list[Any]:
        """The results of the jobs with these keys, in a run in which all are finished.

        Raises
        ------
        StorageError
            If a result is missing or does not match its type.
        """
        results = dict[str, Any]()
        for number, record in enumerate(run.lines(self.name), start=1):
            self.check(record, run.path(self.name), number)
            results[record[self.key]] = record
        missing = [key for key in keys if key not in results]
        if missing:
            raise StorageError(f"{run.path(self.name)} lacks the result with the key {missing[0]}; it was not changed")
        return [results[key] for key in keys]


SOLVED = ResultFile(name="jobs.jsonl", key="job", model=CheckedJob, shared=True)
SEARCHED = ResultFile(name="find.jsonl", key="part", model=SearchLineRecord)
"""The file of finished jobs of searches. Jobs that an earlier version stored under another key are done again."""


def all_results(jobs: ResumableJobs, task: Callable[..., Any], of: Sequence[Job], noun: str) -> list[Any]:
    """The results of all jobs. If one failed, a StorageError names it by ``noun`` once all other results are stored."""
    results = jobs.complete(task, of, len(of))
    failed = next((result for result in results if isinstance(result, FailedJob)), None)
    if failed is not None:
        raise StorageError(f"one {noun} failed: {failed.reason}; the others are stored")
    return results


def problem_job(problem: Problem, parent: str | None = None, method: Method = Method.AUTO) -> Job:
    """The job that solves a problem from its guess, or from the gait of the job ``parent``."""
    suffix = (parent or "") + ("" if method is Method.AUTO else f" by {method.value}")
    key = hashlib.sha256((problem.digest + suffix).encode()).hexdigest() if suffix else problem.digest
    return Job(key=key, argument=problem, parent=parent)


def solve_all(
    jobs: ResumableJobs, problems: Iterable[Job], total: int, task: Callable[..., OutcomeRecord] | None = None
) -> list[OutcomeRecord]:
    """Solve and verify the problems of ``problem_job`` jobs; returns records of gaits or attempts in the same order.

    Parameters
    ----------
    task : the function that solves one problem, by default ``solve_job``. It must use the method for which the keys of
        the jobs were made.
    """
    return [
        AttemptRecord(status=SET_ASIDE, message=result.reason) if isinstance(result, FailedJob) else result
        for result in jobs.complete(task or solve_job, problems, total)
    ]


def solve_job(
    problem: Problem,
    neighbour: OutcomeRecord | None = None,
    should_stop: Stop = None,
    *,
    method: Method = Method.AUTO,
) -> OutcomeRecord:
    """The job of a problem, in any process: its verified gait, solved from that of a neighbour if there is one."""
    starts = {"cold": problem}
    if neighbour is not None and is_gait(neighbour):
        starts = {"warm": problem.with_guess(neighbour)} | starts
    for start, candidate in starts.items():
        try:
            gait = solve(candidate, method=method, should_stop=should_stop)
        except SolveError as error:
            if should_stop is not None and should_stop():  # the solution of the reference was interrupted
                raise KeyboardInterrupt from None
            return AttemptRecord(status="not_converged", message=str(error), start=start)
        if gait.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if gait.converged:
            gait = gait.verified(verify(gait).to_record())
            break
    return cast(OutcomeRecord, {**gait.to_record(), "start": start})


def sweep_job(
    problem: Problem, _: None = None, should_stop: Stop = None, *, method: Method = Method.AUTO
) -> OutcomeRecord:
    """The job of a problem like ``solve_job``, unless a scan of the return map shows that there is no gait.

    If ``solve`` finds no gait, the result is the most stable gait to which the scan leads. If there are several gaits
    with the problem's phases, the entry ``gaits`` counts them.
    """
    starts = list[dict[str, float]]()
    if scanned(problem):
        possible, starts = possible_gaits(problem)
        if not possible:
            return AttemptRecord(status="infeasible", message=NO_FIXED_POINT, start="scan")
        starts = [] if problem.is_open else starts  # the search for the modes has its own starts
    record = solve_job(problem, None, should_stop, method=method)
    found = {_identity(record): record} if is_gait(record) else {}
    if is_gait(record) and starts:
        state = record["state"]
        starts.remove(min(starts, key=lambda start: max(abs(value - state[name]) for name, value in start.items())))
    for start in starts:
        steps = simulate(problem, start, len(problem.cycle.steps), dense=False).complete_steps
        walked = [phase for step in steps for phase in step.phases]
        is_like = [mode for mode, _ in walked] == [*problem.cycle.phases]
        other = _from_state(problem, start, "scan", method, [length for _, length in walked] if is_like else None)
        if is_gait(other):
            found.setdefault(_identity(other), other)
    if not found:
        return record
    best = record if is_gait(record) else min(found.values(), key=lambda gait: gait["spectral_radius"] or 0.0)
    return cast(OutcomeRecord, {**best, "gaits": len(found)} if len(found) > 1 else best)


def neighbour_job(
    problem: Problem, neighbour: OutcomeRecord, should_stop: Stop = None, *, method: Method = Method.AUTO
) -> OutcomeRecord:
    """The job of a problem that is solved from the gait of a neighbour only, in any process."""
    assert is_gait(neighbour)
    durations = [phase["duration"] for phase in neighbour["phases"]]
    return _from_state(problem, neighbour["state"], "neighbour", method, durations)


def _from_state(
    problem: Problem,
    state: Mapping[str, float],
    start: str,
    method: Method,
    durations: Sequence[float] | None = None,
) -> OutcomeRecord:
    """The record of a verified gait near a state, by Newton's method unless another method is requested."""
    near = Method.NEWTON if method is Method.AUTO else method
    complete = {**dict.fromkeys(problem.map_section.names, 0.0), **state}
    candidate = problem.with_modes(problem.cycle, complete, durations).from_guess()
    gait = replace(solve(candidate, method=near), problem=problem)
    gait = gait.verified(verify(gait).to_record()) if gait.converged else gait
    return cast(OutcomeRecord, {**gait.to_record(), "start": start})


def _identity(gait: OutcomeRecord) -> tuple[float, ...]:
    """The rounded state of a gait, by which equal gaits are recognised."""
    return tuple(round(value, SAME_DIGITS) for value in cast(Mapping[str, float], gait["state"]).values())


@dataclass(frozen=True, kw_only=True)
class FindPlan(SearchPlan, Plan[Gaits]):
    """A search whose finished jobs are stored; ``found`` is called with the gaits known so far, see ``search``."""

    results = SEARCHED
    found: Callable[[Gaits], None] | None = None

    def result(self, jobs: ResumableJobs) -> Gaits:
        """The gaits of all jobs."""
        return search(self, jobs, found=self.found)
