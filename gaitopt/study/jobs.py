"""Many independent jobs on Dask: processes of this machine, or the workers of a cluster.

Every job has a key and is submitted once. Results are handed over one by one as they finish, so that whoever started
the jobs can keep each at once. A worker that dies costs the job it was at (and the one before, if its result was still
on the way); a job that takes three workers with it is set aside.
"""

import logging
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from queue import Empty, Queue
from typing import Any

from gaitopt.errors import UnknownNameError

ALLOWED_DEATHS = 2
"""A job may take so many workers with it by bad luck; with the next it is set aside."""
AHEAD = 4
"""Jobs submitted per worker beyond the one at hand, so that no worker waits for us."""
PATIENCE = 0.1
"""Time between two looks at whether to stop [s]."""
CONNECT_TIMEOUT = 10
"""A scheduler that has not answered by then [s] is not there."""
SETTINGS = {
    "distributed.scheduler.worker-saturation": 1.0,  # a worker holds the one job that it is at, and loses no other
    "distributed.scheduler.allowed-failures": ALLOWED_DEATHS,
    "distributed.admin.low-level-log-length": 0,
}


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


@dataclass(frozen=True, slots=True, kw_only=True)
class SetAside:
    """In place of a result: why a job has none."""

    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """Where jobs run: ``count`` processes of this machine (1 is this very process), or a Dask scheduler by address."""

    count: int = field(default_factory=lambda: os.cpu_count() or 1)
    scheduler: str | None = None


def make_workers(count: int | None, scheduler: str | None) -> Workers:
    """So many processes of this machine (None: one per core), or those of a scheduler."""
    return Workers(scheduler=scheduler) if count is None else Workers(count=count, scheduler=scheduler)


def run_jobs(
    task: Callable[[Any, Any], Any],
    jobs: list[Job],
    workers: Workers,
    *,
    done: Mapping[str, Any] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Iterator[tuple[str, Any]]:
    """Run ``task(argument, result of the parent)`` for every job; keys and results as they finish.

    Parameters
    ----------
    task : a function of a module that the workers can import.
    jobs : in the order in which they are started, parents before their children.
    workers : where.
    done : results of parents that are not among the jobs.
    should_stop : looked at all the time; when true, jobs that are not finished are dropped.

    Raises
    ------
    UnknownNameError
        If the scheduler does not answer.
    """
    if workers.scheduler is None and workers.count == 1:
        yield from _run_here(task, jobs, dict(done or {}), should_stop)
    elif jobs:
        with _client(workers) as client:
            yield from _Run(client, task, jobs, dict(done or {})).results(should_stop)


def _run_here(
    task: Callable[[Any, Any], Any], jobs: list[Job], results: dict[str, Any], should_stop: Callable[[], bool] | None
) -> Iterator[tuple[str, Any]]:
    for job in jobs:
        if should_stop is not None and should_stop():
            return
        results[job.key] = task(job.argument, results.get(job.parent or ""))
        yield job.key, results[job.key]


class _Run:
    """Jobs on their way; those that wait for a parent are not submitted before it has finished."""

    def __init__(self, client: Any, task: Callable[[Any, Any], Any], jobs: list[Job], done: dict[str, Any]) -> None:
        self._client, self._task, self._parents = client, task, done
        keys = {job.key for job in jobs}
        self._ready = [job for job in reversed(jobs) if job.parent not in keys]
        self._children: dict[str, list[Job]] = {}
        for job in reversed(jobs):
            if job.parent in keys:
                self._children.setdefault(job.parent or "", []).append(job)
        self._finished: Queue[tuple[str, Any]] = Queue()
        self._running: dict[str, Any] = {}

    def results(self, should_stop: Callable[[], bool] | None) -> Iterator[tuple[str, Any]]:
        """Keys and results as they finish."""
        self._submit()
        while self._running and not (should_stop is not None and should_stop()):
            try:
                key, future = self._finished.get(timeout=PATIENCE)
            except Empty:
                continue
            result = _result(future)
            del self._running[key]
            self._parents[key] = None if isinstance(result, SetAside) else result
            self._ready += self._children.pop(key, [])
            self._submit()
            yield key, result
        self._client.cancel(list(self._running.values()), force=True)

    def _submit(self) -> None:
        room = sum(self._client.nthreads().values()) * (1 + AHEAD) if self._ready else 0
        while self._ready and len(self._running) < max(room, 1):
            job = self._ready.pop()
            parent = self._parents.get(job.parent) if job.parent else None
            future = self._client.submit(self._task, job.argument, parent, key=f"gaitopt-{job.key}", pure=False)
            self._running[job.key] = future
            future.add_done_callback(lambda future, key=job.key: self._finished.put((key, future)))


def _result(future: Any) -> Any:
    from distributed import KilledWorker

    error = future.exception() if future.status != "cancelled" else None
    if isinstance(error, KilledWorker):
        return SetAside(reason=f"it took {ALLOWED_DEATHS + 1} workers with it")
    if error is not None:
        return SetAside(reason=f"{type(error).__name__}: {error}")
    return future.result()


@contextmanager
def _client(workers: Workers) -> Iterator[Any]:
    import dask
    from distributed import Client, LocalCluster

    if workers.scheduler is not None:
        try:
            client = Client(workers.scheduler, timeout=CONNECT_TIMEOUT)
        except (OSError, TimeoutError, ValueError) as error:
            raise UnknownNameError(
                f"the scheduler {workers.scheduler} does not answer: {error}; "
                "start one with `dask scheduler`, or leave --scheduler out to use this machine"
            ) from error
        with client:
            yield client
        return
    with (
        dask.config.set(SETTINGS),
        LocalCluster(
            n_workers=workers.count,
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",  # any free port: None would insist on 8787
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client
