"""A process for the runs of an engine: if its compiled code crashes, the crash becomes the outcome of the run.

The parent writes one pickle with the job and reads one per time step. Text that the engine prints goes to standard
error, which is not shown. Standard input stays open. When it ends, the parent is gone, even if it was killed.
"""

import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import IO, Any

from gaitopt.callbacks import Stop, raise_if_stopped
from gaitopt.engines.outcome import Outcome, Simulator, run
from gaitopt.engines.plant import Reference
from gaitopt.errors import GaitoptError, ProblemError
from gaitopt.gait.gait import Gait

PROGRAM = "from gaitopt.engines.process import serve; serve()"
POLLING_TIME = 0.2
"""Time between two calls of ``should_stop`` [s]."""
LONGEST_RUN = 900.0
"""Time limit of the run at one time step [s]."""


def outcomes(
    gait: Gait,
    simulator: type[Simulator],
    settings: Mapping[str, Any],
    time_steps: Sequence[float],
    finished: Callable[[Outcome], None],
    should_stop: Stop = None,
) -> tuple[Outcome, ...]:
    """Replay a gait at some time steps; a crash of the engine ends only the run at its own time step.

    Raises
    ------
    ProblemError
        If the engine cannot model the walker.
    KeyboardInterrupt
        If ``should_stop`` returns True.
    """
    results, left = list[Outcome](), [*time_steps]
    while left:
        with subprocess.Popen(
            [sys.executable, "-c", PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        ) as process:
            try:
                for result in _results(process, (gait, simulator, dict(settings), left), should_stop):
                    results.append(result)
                    left = left[1:]
                    finished(result)
            finally:
                process.kill()
        if left:
            code = process.returncode
            reason = signal.Signals(-code).name if code < 0 else f"exit code {code}"
            results.append(Outcome(dt=left.pop(0), ending=f"crashed: {reason}"))
            finished(results[-1])
    return tuple(results)


def _results(process: "subprocess.Popen[bytes]", job: Any, should_stop: Stop) -> Any:
    """The outcomes that a process sends until it ends; an error of gaitopt in it is raised here."""
    arrived: queue.Queue[Any] = queue.Queue()
    incoming, outgoing = process.stdout, process.stdin
    if incoming is None or outgoing is None:  # both are pipes
        return
    threading.Thread(target=_receive, args=(incoming, arrived), daemon=True).start()
    try:
        pickle.dump(sys.path, outgoing)
        pickle.dump(job, outgoing)
        outgoing.flush()
    except BrokenPipeError:
        pass
    waited = 0.0
    while True:
        raise_if_stopped(should_stop)
        try:
            result = arrived.get(timeout=POLLING_TIME)
        except queue.Empty:
            waited += POLLING_TIME
            if waited > LONGEST_RUN:
                process.kill()
            continue
        waited = 0.0
        if result is None:
            process.wait()
            return
        if isinstance(result, GaitoptError):
            raise result
        yield result


def _receive(stream: IO[bytes], arrived: "queue.Queue[Any]") -> None:
    """Put what a process sends into a queue, and None at its end."""
    try:
        while True:
            arrived.put(pickle.load(stream))  # noqa: S301 - from a process of our own
    except (EOFError, pickle.UnpicklingError, OSError, ValueError):
        arrived.put(None)


def serve() -> None:
    """Run the job on standard input; the results replace standard output, where engines print."""
    results = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    sys.path[:] = pickle.load(sys.stdin.buffer)  # noqa: S301 - from a process of our own
    gait, simulator, settings, time_steps = pickle.load(sys.stdin.buffer)  # noqa: S301 - as above
    threading.Thread(target=_end_with_parent, args=(sys.stdin.fileno(),), daemon=True).start()
    try:
        reference = Reference(gait)
        for dt in time_steps:
            pickle.dump(run(reference, simulator, dt, settings), results)
            results.flush()
    except ProblemError as error:
        pickle.dump(error, results)
        results.flush()


def _end_with_parent(descriptor: int) -> None:
    """End this process when the pipe from its parent closes; the pipe's buffered reader would lock Python's exit."""
    while os.read(descriptor, 1):
        pass
    os._exit(1)
