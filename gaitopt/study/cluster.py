"""The processes that jobs run in: workers of this machine, started and ended here, or those of a Dask scheduler."""

import asyncio
import logging
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker
from typing import Any

from gaitopt.errors import UnknownNameError

ALLOWED_DEATHS = 2
"""A job may take so many workers with it by bad luck; with the next it is set aside."""
FAREWELL = 0.5
"""Time that a worker has to go by itself [s]; one that is still at a job is then killed."""
CONNECT_TIMEOUT = 10
"""A scheduler that has not answered by then [s] is not there."""
SETTINGS = {
    "distributed.scheduler.worker-saturation": 1.0,  # a worker holds the one job that it is at, and loses no other
    "distributed.scheduler.allowed-failures": ALLOWED_DEATHS,
    "distributed.admin.low-level-log-length": 0,
}


@contextmanager
def connected(count: int, scheduler: str | None) -> Iterator[Any]:
    """A Dask client of ``count`` workers of this machine, started now and ended with the block, or of a scheduler.

    Raises
    ------
    UnknownNameError
        If the scheduler does not answer.
    """
    import dask
    from distributed import Client, LocalCluster

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=CONNECT_TIMEOUT)
        except (OSError, TimeoutError, ValueError) as error:
            raise UnknownNameError(
                f"the scheduler {scheduler} does not answer: {error}; "
                "start one with `dask scheduler`, or leave --scheduler out to use this machine"
            ) from error
        with client:
            yield client
        return
    with dask.config.set(SETTINGS), ExitStack() as stack:
        with uninterrupted():
            cluster = stack.enter_context(
                LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    dashboard_address="127.0.0.1:0",  # any free port: None would insist on 8787
                    silence_logs=logging.CRITICAL,
                )
            )
            stack.callback(cluster.sync, _dismiss, cluster)
        yield stack.enter_context(Client(cluster))


async def _dismiss(cluster: Any) -> None:
    await asyncio.gather(*(nanny.close(timeout=FAREWELL) for nanny in cluster.workers.values()))


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ctrl-C waits for the end of the block; no thread or process that is started in it ever hears of one.

    A terminal sends it to all processes, and a worker would answer with a traceback.
    """
    if os.name != "posix" or threading.current_thread() is not threading.main_thread():
        yield
        return
    resource_tracker.ensure_running()  # its start would lift the mask
    pressed = threading.Event()
    handler = signal.signal(signal.SIGINT, lambda *_: pressed.set())
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)
    if pressed.is_set():
        signal.raise_signal(signal.SIGINT)
