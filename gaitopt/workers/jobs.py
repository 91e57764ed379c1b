"""Many independent jobs in this process, in several processes of this machine, or on the workers of a Dask cluster.

Every job has a key and is submitted once. A worker hands its result to the scheduler before the job counts as finished.
The caller gets the result from there and can store it at once, so that no job is done twice. If a worker dies, only its
current job is repeated; a job on which three workers have died is given up.
"""

import hashlib
import json
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from queue import Empty, Queue
from typing import Any

from gaitopt.callbacks import Counted, Stop, TimeLimit
from gaitopt.requests import WorkersRequest

JOBS_AHEAD = 4
"""Number of jobs per worker that are submitted before the worker is free, so that no worker waits for this process."""
POLLING_TIME = 0.1
"""Time between two calls of ``should_stop`` [s]."""
RECOUNT_AFTER = 1.0
"""Time between two counts of the workers, whose number may change on a cluster [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One call of a task.

    Attributes
    ----------
    key : name of the job, the same in every run.
    argument : first argument of the task.
    parent : key of the job whose result is the second argument of the task; None if there is no such job.
    """

    key: str
    argument: Any
    parent: str | None = None


def key_of(identity: Any) -> str:
    """The key of a job: the SHA-256 of the JSON of ``identity``, which contains all that the result depends on."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class FailedJob:
    """The reason why a job failed; it takes the place of a result."""

    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """The processes that run jobs: those of a Dask ``scheduler``, or ``count`` processes; if it is 1, this process.

    Attributes
    ----------
    lasting : a stack that ends the processes, and the client of those that run already; None if every call of
        ``run_jobs`` starts processes of its own.
    """

    count: int = field(default_factory=lambda: os.cpu_count() or 1)
    scheduler: str | None = None
    lasting: tuple[ExitStack, list[Any]] | None = field(default=None, repr=False, compare=False)

    @contextmanager
    def kept(self) -> Iterator["Workers"]:
        """The same workers, whose processes serve all calls of ``run_jobs`` in the block; the first one starts them."""
        with ExitStack() as stack:
            yield replace(self, lasting=(stack, []))

    @contextmanager
    def connected(self, jobs: int) -> Iterator[Any]:
        """A Dask client for this many jobs."""
        from gaitopt.workers.cluster import connected  # slow to import, and not needed for one process

        if self.lasting is None:
            with connected(jobs, self.scheduler) as client:
                yield client
            return
        stack, clients = self.lasting
        if not clients:
            clients.append(stack.enter_context(connected(self.count, self.scheduler)))
        yield clients[0]


def make_workers(count: int | None, scheduler: str | None) -> Workers:
    """``count`` processes of this machine (None: one per core), or the workers of a scheduler."""
    count = WorkersRequest(workers=count, scheduler=scheduler).workers
    if scheduler is not None:
        from gaitopt.workers.cluster import check_address

        check_address(scheduler)
    return Workers(scheduler=scheduler) if count is None else Workers(count=count, scheduler=scheduler)


def run_jobs(
    task: Callable[..., Any],
    jobs: Iterable[Job],
    workers: Workers,
    results: Mapping[str, Any] | None = None,
    *,
    should_stop: Stop = None,
) -> Iterator[tuple[str, Any]]:
    """Run ``task(argument, result of the parent)`` for every job; yields keys and results as jobs finish.

    Parameters
    ----------
    task : a function of a module that the workers can import. If the jobs run in this process, whose compiled code may
        swallow Ctrl-C, the task gets ``should_stop`` as a third argument.
    jobs : the jobs in the order in which they are started, parents before their children. They are drawn from the
        iterable only when workers are ready for them.
    workers : where the jobs run.
    results : results of parents by key, which are looked up when a child starts. If parents are among the jobs, the
        caller must add their results when it receives them.
    should_stop : polled; if it returns True, jobs that are not finished are dropped.

    Raises
    ------
    UnknownNameError
        If the scheduler does not answer.
    """
    known, jobs = {} if results is None else results, iter(jobs)
    if workers.scheduler is None and workers.count == 1:
        for job in jobs:
            if should_stop is not None and should_stop():
                return
            polled = () if should_stop is None else (should_stop,)
            yield job.key, task(job.argument, _result_of(job.parent, known), *polled)
        return
    first = list(islice(jobs, workers.count))
    if first:
        with workers.connected(len(first)) as client:
            yield from _Submissions(client, task, chain(first, jobs), known).results(should_stop)


@dataclass(frozen=True, slots=True, kw_only=True)
class ResumableJobs:
    """Jobs of one kind with their results. A job that has a result is not done again.

    Attributes
    ----------
    workers : where the jobs run.
    results : the results by key; new ones are added.
    store : function of a key and a new result. It stores the result before the next one is accepted, and returns what
        stays in memory of it. None if nothing is stored.
    progress : called with the number of finished jobs and their total.
    should_stop : polled before every job.
    limit : time limit, after which unfinished jobs are left out.
    """

    workers: Workers
    results: dict[str, Any] = field(default_factory=dict)
    store: Callable[[str, Any], Any] | None = None
    progress: Counted = None
    should_stop: Stop = None
    limit: TimeLimit = field(default_factory=TimeLimit)

    @contextmanager
    def kept(self) -> Iterator["ResumableJobs"]:
        """The same jobs with workers whose processes serve all calls of ``complete`` in the block."""
        with self.workers.kept() as workers:
            yield replace(self, workers=workers)

    def complete(self, task: Callable[..., Any], jobs: Iterable[Job], total: int) -> list[Any]:
        """Do the jobs that have no result yet; returns the results of all jobs in their order.

        If the time limit is reached, only the results of the finished jobs are returned. A ``FailedJob`` is not stored,
        so that the next call tries it again.

        Parameters
        ----------
        task : see ``run_jobs``.
        jobs : the jobs; with one process, each one is drawn after the results of those before it.
        total : number of the jobs.

        Raises
        ------
        KeyboardInterrupt
            If ``should_stop`` returned True; the results of finished jobs are stored.
        """
        keys, drawn, done = list[str](), set[str](), 0
        stop = self.should_stop if self.limit.seconds is None else replace(self.limit, should_stop=self.should_stop)

        def missing() -> Iterator[Job]:
            nonlocal done
            for job in jobs:
                if stop is not None and stop():
                    return
                keys.append(job.key)
                if job.key in self.results or job.key in drawn:
                    done += 1
                else:
                    drawn.add(job.key)
                    yield job

        try:
            for key, result in run_jobs(task, missing(), self.workers, self.results, should_stop=stop):
                if self.store is None or isinstance(result, FailedJob):
                    self.results[key] = result
                else:
                    self.results[key] = self.store(key, result)
                done += 1
                if self.progress is not None:
                    self.progress(done, total)
        except KeyboardInterrupt:
            if not self.limit.is_over:
                raise
        if done < total and (not self.limit.is_over or (self.should_stop is not None and self.should_stop())):
            raise KeyboardInterrupt
        return [self.results[key] for key in keys if key in self.results]


def _result_of(parent: str | None, results: Mapping[str, Any]) -> Any:
    """The result of a job's parent; None if there is no parent, or it failed."""
    result = None if parent is None else results.get(parent)
    return None if isinstance(result, FailedJob) else result


class _Submissions:
    """The jobs that are submitted to a Dask client, and those that wait for their parents."""

    def __init__(self, client: Any, task: Callable[..., Any], jobs: Iterator[Job], results: Mapping[str, Any]) -> None:
        self._client, self._task, self._jobs, self._results = client, task, jobs, results
        self._ready = deque[Job]()
        self._children: dict[str, list[Job]] = {}
        self._unfinished = set[str]()
        self._finished: Queue[tuple[str, Any]] = Queue()
        self._running: dict[str, Any] = {}
        self._threads, self._counted = 0, -RECOUNT_AFTER

    def results(self, should_stop: Stop) -> Iterator[tuple[str, Any]]:
        """Keys and results of the jobs as they finish."""
        self._submit()
        while self._running and not (should_stop is not None and should_stop()):
            try:
                key, future = self._finished.get(timeout=POLLING_TIME)
            except Empty:
                continue
            result = self._result(future)
            del self._running[key]
            yield key, result
            self._unfinished.discard(key)
            self._ready += self._children.pop(key, [])
            self._submit()
        self._client.cancel(list(self._running.values()), force=True)

    def _submit(self) -> None:
        """Submit as many jobs as the workers can take; children of unfinished jobs wait."""
        while len(self._running) < self._capacity():
            job = self._ready.popleft() if self._ready else next(self._jobs, None)
            if job is None:
                return
            self._unfinished.add(job.key)
            if job.parent in self._unfinished:
                self._children.setdefault(job.parent or "", []).append(job)
                continue
            key = f"gaitopt-{job.key}"
            parent = _result_of(job.parent, self._results)
            future = self._client.submit(perform, self._task, key, job.argument, parent, key=key, pure=False)
            self._running[job.key] = future
            future.add_done_callback(lambda future, key=job.key: self._finished.put((key, future)))

    def _capacity(self) -> int:
        """Number of jobs that may be submitted at a time; workers are counted anew, because a cluster may change."""
        if time.monotonic() > self._counted + RECOUNT_AFTER:
            self._threads, self._counted = sum(self._client.nthreads().values()), time.monotonic()
        return max(self._threads * (1 + JOBS_AHEAD), 1)

    def _result(self, future: Any) -> Any:
        from distributed import KilledWorker
        from distributed.protocol.pickle import loads

        from gaitopt.workers.cluster import ALLOWED_DEATHS

        error = future.exception() if future.status == "error" else None
        if isinstance(error, KilledWorker):
            return FailedJob(reason=f"{ALLOWED_DEATHS + 1} workers died on it")
        if error is not None:
            return FailedJob(reason=f"{type(error).__name__}: {error}")
        result = self._client.get_metadata([future.key], default=None)
        return FailedJob(reason="the scheduler dropped it") if result is None else loads(result)


def perform(task: Callable[..., Any], key: str, argument: Any, parent: Any) -> None:
    """Do a job in a worker and hand its result to the scheduler, which forgets it together with the job.

    If the worker dies after that, another one may start the job again. It has nothing to do: either the scheduler still
    has the result, or the caller has taken it and the scheduler has just forgotten the job.
    """
    from distributed import get_worker
    from distributed.protocol.pickle import dumps
    from distributed.utils import sync

    loop, scheduler = get_worker().loop, get_worker().scheduler
    # ask in this order: the result of a job that is neither finished nor pending has been taken
    has_result = sync(loop, scheduler.get_metadata, keys=[key], default=None) is not None
    is_pending = sync(loop, scheduler.get_task_status, keys=[key])[key] is not None
    if is_pending and not has_result:
        sync(loop, scheduler.set_metadata, keys=[key], value=dumps(task(argument, parent)))
