"""Ctrl-C and SIGTERM: both end a command in the same way, with everything that is finished on the disk."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED, TERMINATED = 130, 143
"""Exit codes, as a shell reports a program that SIGINT or SIGTERM has ended."""


class SignalRecord:
    """The signals that the command has received."""

    def __init__(self) -> None:
        self._received: list[int] = []

    def interrupt(self, signum: int, frame: FrameType | None) -> None:
        """Handle SIGINT."""
        self._received.append(signum)
        raise KeyboardInterrupt

    def terminate(self, signum: int, frame: FrameType | None) -> None:
        """Handle SIGTERM by the current handler of SIGINT."""
        self._received.append(signum)
        signal.raise_signal(signal.SIGINT)

    def __bool__(self) -> bool:
        return bool(self._received)

    @property
    def exit_code(self) -> int:
        """The exit code for the first signal; an interrupt without a signal counts as Ctrl-C."""
        return TERMINATED if self._received[:1] == [signal.SIGTERM] else INTERRUPTED

    @property
    def words(self) -> str:
        """What the user is told."""
        return "terminated" if self.exit_code == TERMINATED else "interrupted"


@contextmanager
def listening() -> Iterator[SignalRecord]:
    """Turn both signals into a KeyboardInterrupt within the block, if this is the main thread."""
    record = SignalRecord()
    if threading.current_thread() is not threading.main_thread():
        yield record
        return
    handlers = {signal.SIGINT: record.interrupt, signal.SIGTERM: record.terminate}
    before = {signum: signal.signal(signum, handler) for signum, handler in handlers.items()}
    try:
        yield record
    finally:
        for signum, handler in before.items():
            signal.signal(signum, handler)


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Yield a function that tells whether Ctrl-C was pressed; if so, the block ends with a KeyboardInterrupt.

    CasADi swallows the KeyboardInterrupt and returns as if nothing had happened, or turns it into an error of its own;
    hence the flag. Python delivers signals to the main thread only: in other threads the flag stays down.
    """
    pressed = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield pressed.is_set
        return

    def remember(signum: int, frame: FrameType | None) -> None:
        pressed.set()
        if callable(before):
            before(signum, frame)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, remember)
    try:
        yield pressed.is_set
    except Exception as error:
        if pressed.is_set():
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed.is_set():
        raise KeyboardInterrupt
