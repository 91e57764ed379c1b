"""The Dask client that runs jobs in worker processes of this machine, or on a scheduler with a known address.

Anyone who connects to a Dask scheduler can run code as its owner. The scheduler on this machine therefore uses TLS. Its
key is made for the run, stays in memory, and is required on both sides of every connection.
"""

import asyncio
import logging
import os
import re
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing import resource_tracker
from tempfile import TemporaryDirectory
from typing import Any

from gaitopt.errors import UnknownNameError

ALLOWED_DEATHS = 2
"""Number of times that a job is repeated after the death of its worker; after the next death it is given up."""
GRACE = 0.5
"""Time after which a worker that has not ended by itself is killed [s]."""
CONNECT_TIMEOUT = 10
"""Time limit for the answer of a scheduler [s]."""
CLOSE_TIMEOUT = 10
"""Time limit for closing a client or cluster [s]; connections that are still open then end with this process."""
SETTINGS = {
    "distributed.scheduler.worker-saturation": 1.0,  # a worker has one job at a time, so its death costs only that job
    "distributed.scheduler.allowed-failures": ALLOWED_DEATHS,
    "distributed.admin.low-level-log-length": 0,
    "distributed.worker.profile.enabled": False,  # it would interrupt the jobs a hundred times a second
    "distributed.scheduler.http.routes": [],  # otherwise every user of the machine could read pages about the run
    "distributed.worker.http.routes": [],
}
METHOD = "distributed.worker.multiprocessing-method"
_CLUSTER = threading.RLock()
"""Locked while workers of this machine run: Dask's settings and ``__main__`` are shared by the whole process."""
ADDRESS = re.compile(r"(?:(?P<scheme>tcp|tls)://)?(?:\[[0-9A-Fa-f:]+\]|[\w.-]+):(?P<port>\d{1,5})")


def check_address(scheduler: str) -> None:
    """Refuse an invalid address of a scheduler, and a TLS address if Dask has no certificates.

    Raises
    ------
    UnknownNameError
        If the address is not of the form tcp://HOST:PORT or tls://HOST:PORT, or if there are no usable certificates.
    """
    matched = ADDRESS.fullmatch(scheduler)
    if matched is None or not 0 < int(matched["port"]) < 2**16:
        raise UnknownNameError(f"--scheduler {scheduler}: write tcp://HOST:PORT or tls://HOST:PORT")
    if matched["scheme"] != "tls":
        return
    from distributed.security import Security

    remedy = "set distributed.comm.tls.ca-file, client.cert and client.key in the configuration of Dask"
    try:
        context = Security().get_connection_args("client")["ssl_context"]
    except (OSError, TypeError) as error:
        raise UnknownNameError(f"--scheduler {scheduler}: bad certificates of TLS ({error}); {remedy}") from error
    if context is None:
        raise UnknownNameError(f"--scheduler {scheduler}: TLS needs certificates; {remedy}")


@contextmanager
def connected(count: int, scheduler: str | None) -> Iterator[Any]:
    """A Dask client with ``count`` workers of this machine, which end with the block, or with those of a scheduler.

    Only one thread at a time can use workers of this machine; others wait.

    Raises
    ------
    UnknownNameError
        If the scheduler does not answer.
    """
    import dask
    from distributed import Client, LocalCluster
    from distributed.security import Security

    if scheduler is not None:
        check_address(scheduler)
        try:
            client = Client(scheduler, timeout=CONNECT_TIMEOUT)
        except (OSError, TimeoutError, ValueError) as error:
            raise UnknownNameError(
                f"the scheduler {scheduler} does not answer: {str(error) or type(error).__name__}; "
                "start one with `dask scheduler`, or leave --scheduler out to use this machine"
            ) from error
        with _closed_at_last(client):
            yield client
        return
    with ExitStack() as stack:
        stack.enter_context(_CLUSTER)
        scratch = stack.enter_context(TemporaryDirectory(prefix="gaitopt-", ignore_cleanup_errors=True))
        method = dask.config.get(METHOD, "spawn")
        method = "spawn" if method == "fork" else method  # a forked process would inherit locks that threads hold
        stack.enter_context(dask.config.set({**SETTINGS, METHOD: method, "temporary-directory": scratch}))
        stack.enter_context(script_not_repeated())
        with uninterrupted():
            cluster = LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                protocol="tls://",
                security=Security.temporary(),
                dashboard_address="127.0.0.1:0",  # any free port: None would insist on 8787
                silence_logs=logging.CRITICAL,
            )
            stack.enter_context(_closed_at_last(cluster))
            stack.callback(_end_workers, cluster)
        yield stack.enter_context(_closed_at_last(Client(cluster)))


@contextmanager
def _closed_at_last(connection: Any) -> Iterator[Any]:
    """Close a client or a cluster after the block. Errors are only logged: all results have arrived by then."""
    try:
        yield connection
    finally:
        try:
            connection.close(timeout=CLOSE_TIMEOUT)
        except (TimeoutError, OSError, AssertionError) as error:  # Dask asserts that every worker has ended
            logging.getLogger(__name__).info("closing %s: %r", type(connection).__name__, error)


def _end_workers(cluster: Any) -> None:
    """End the workers; those that do not end by themselves are killed."""
    processes = [nanny.process.process for nanny in cluster.workers.values() if nanny.process is not None]

    async def close() -> None:
        closings = (nanny.close(timeout=GRACE) for nanny in cluster.workers.values())
        await asyncio.gather(*closings, return_exceptions=True)

    try:
        cluster.sync(close, callback_timeout=CLOSE_TIMEOUT)
    except TimeoutError as error:
        logging.getLogger(__name__).info("workers did not confirm their end: %r", error)
    for process in processes:
        with suppress(ProcessLookupError, ValueError):  # the process has just ended or been closed
            if process.is_alive():
                os.kill(process.pid, getattr(signal, "SIGKILL", signal.SIGTERM))


@contextmanager
def script_not_repeated() -> Iterator[None]:
    """Keep processes that are spawned in the block from importing the caller's script.

    A script that calls the library at its top level would otherwise start itself again in every worker. Workers do not
    need the script, because its functions are pickled by value.
    """
    main = sys.modules["__main__"]
    file, spec = main.__dict__.pop("__file__", None), main.__spec__
    main.__spec__ = None
    try:
        yield
    finally:
        main.__spec__ = spec
        if file is not None:
            main.__file__ = file


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Delay Ctrl-C to the end of the block; threads and processes that start in the block do not receive it.

    A terminal sends Ctrl-C to all processes, and every worker would print a traceback.
    """
    if os.name != "posix" or threading.current_thread() is not threading.main_thread():
        yield
        return
    resource_tracker.ensure_running()  # if it started inside the block, it would lift the mask
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
