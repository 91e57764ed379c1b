"""Many independent jobs on Dask: processes of this machine, or the workers of a cluster.

Every job has a key and is submitted once. A result lies with the scheduler before its job counts as finished, and is
handed over from there, so that the caller can keep each at once. A worker that dies costs the job it was
at and no other; a job that takes three workers with it is set aside.
"""

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from queue import Empty, Queue
from typing import Any

from gaitopt.callbacks import Stop
from gaitopt.errors import ProblemError

MOST_WORKERS = 1024
"""Processes of one machine; each takes some 100 MB."""
AHEAD = 4
"""Jobs submitted per worker beyond the one at hand, so that no worker waits for us."""
PATIENCE = 0.1
"""Time between two looks at whether to stop [s]."""
RECOUNT = 1.0
"""Time after which the workers are counted again [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One job.

    Attributes
    ----------
    key : its name, the same in every run.
    argument : what it works on.
    parent : key of the job whose result it starts from, or None.
    """

    key: str
    argument: Any
    parent: str | None = None


def key_of(identity: Any) -> str:
    """A key out of all that a result depends on, which JSON can hold: its SHA-256."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class FailedJob:
    """In place of a result: why a job has none."""

    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """Where jobs run: ``count`` processes of this machine (1 is this very process), or a Dask scheduler by address.

    Raises
    ------
    ProblemError
        If ``count`` is below 1 or above ``MOST_WORKERS``.
    """

    count: int = field(default_factory=lambda: os.cpu_count() or 1)
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.count <= MOST_WORKERS:
            raise ProblemError(f"workers: {self.count} processes; from 1 to {MOST_WORKERS} are possible")


def make_workers(count: int | None, scheduler: str | None) -> Workers:
    """So many processes of this machine (None: one per core), or those of a scheduler."""
    if scheduler is not None:
        from gaitopt.workers.cluster import check_address

        check_address(scheduler)
    return Workers(scheduler=scheduler) if count is None else Workers(count=count, scheduler=scheduler)


def run_jobs(
    task: Callable[..., Any],
    jobs: list[Job],
    workers: Workers,
    *,
    done: Mapping[str, Any] | None = None,
    should_stop: Stop = None,
) -> Iterator[tuple[str, Any]]:
    """Run ``task(argument, result of the parent)`` for every job; keys and results as they finish.

    Parameters
    ----------
    task : a function of a module that the workers can import; in this very process, where Ctrl-C may be swallowed by
        compiled code, it is given ``should_stop`` as a third argument.
    jobs : in the order in which they are started, parents before their children.
    workers : where.
    done : results of parents that are not among the jobs.
    should_stop : polled; when true, jobs that are not finished are dropped.

    Raises
    ------
    UnknownNameError
        If the scheduler does not answer.
    """
    if workers.scheduler is None and workers.count == 1:
        yield from _run_here(task, jobs, dict(done or {}), should_stop)
    elif jobs:
        from gaitopt.workers.cluster import connected  # asyncio and more, for nothing where there is one process

        with connected(min(workers.count, len(jobs)), workers.scheduler) as client:
            yield from _Run(client, task, jobs, dict(done or {})).results(should_stop)


def _run_here(
    task: Callable[..., Any], jobs: list[Job], results: dict[str, Any], should_stop: Stop
) -> Iterator[tuple[str, Any]]:
    parents = {job.parent for job in jobs}
    for job in jobs:
        if should_stop is not None and should_stop():
            return
        polled = () if should_stop is None else (should_stop,)
        result = task(job.argument, results.get(job.parent or ""), *polled)
        if job.key in parents:  # no other result need be held
            results[job.key] = result
        yield job.key, result


class _Run:
    """Jobs on their way; those that wait for a parent are not submitted before it has finished."""

    def __init__(self, client: Any, task: Callable[..., Any], jobs: list[Job], done: dict[str, Any]) -> None:
        self._client, self._task, self._parents = client, task, done
        keys = {job.key for job in jobs}
        self._ready = [job for job in reversed(jobs) if job.parent not in keys]
        self._children: dict[str, list[Job]] = {}
        for job in reversed(jobs):
            if job.parent in keys:
                self._children.setdefault(job.parent or "", []).append(job)
        self._finished: Queue[tuple[str, Any]] = Queue()
        self._running: dict[str, Any] = {}
        self._threads, self._counted = 0, -RECOUNT

    def results(self, should_stop: Stop) -> Iterator[tuple[str, Any]]:
        """Keys and results as they finish."""
        self._submit()
        while self._running and not (should_stop is not None and should_stop()):
            try:
                key, future = self._finished.get(timeout=PATIENCE)
            except Empty:
                continue
            result = self._result(future)
            del self._running[key]
            children = self._children.pop(key, [])
            if children and not isinstance(result, FailedJob):  # no other result need be held
                self._parents[key] = result
            self._ready += children
            self._submit()
            yield key, result
        self._client.cancel(list(self._running.values()), force=True)

    def _submit(self) -> None:
        while self._ready and len(self._running) < self._room():
            job = self._ready.pop()
            parent = self._parents.get(job.parent) if job.parent else None
            key = f"gaitopt-{job.key}"
            future = self._client.submit(perform, self._task, key, job.argument, parent, key=key, pure=False)
            self._running[job.key] = future
            future.add_done_callback(lambda future, key=job.key: self._finished.put((key, future)))

    def _room(self) -> int:
        """How many jobs may be on their way; workers of a cluster come and go."""
        if time.monotonic() > self._counted + RECOUNT:
            self._threads, self._counted = sum(self._client.nthreads().values()), time.monotonic()
        return max(self._threads * (1 + AHEAD), 1)

    def _result(self, future: Any) -> Any:
        from distributed import KilledWorker
        from distributed.protocol.pickle import loads

        from gaitopt.workers.cluster import ALLOWED_DEATHS

        error = future.exception() if future.status == "error" else None
        if isinstance(error, KilledWorker):
            return FailedJob(reason=f"it took {ALLOWED_DEATHS + 1} workers with it")
        if error is not None:
            return FailedJob(reason=f"{type(error).__name__}: {error}")
        kept = self._client.get_metadata([future.key], default=None)
        return FailedJob(reason="the scheduler dropped it") if kept is None else loads(kept)


def perform(task: Callable[..., Any], key: str, argument: Any, parent: Any) -> None:
    """Do a job in a worker and leave its result with the scheduler, which forgets it together with the job.

    If the worker dies after that, another one may begin the job again, and has nothing to do: either the result is
    there, or it has been taken and the scheduler has just forgotten the job.
    """
    from distributed import get_worker
    from distributed.protocol.pickle import dumps
    from distributed.utils import sync

    loop, scheduler = get_worker().loop, get_worker().scheduler
    # in this order: a job that is neither finished nor pending has been taken
    has_result = sync(loop, scheduler.get_metadata, keys=[key], default=None) is not None
    is_pending = sync(loop, scheduler.get_task_status, keys=[key])[key] is not None
    if is_pending and not has_result:
        sync(loop, scheduler.set_metadata, keys=[key], value=dumps(task(argument, parent)))
