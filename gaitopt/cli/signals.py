"""Ctrl-C and SIGTERM: both end a command in the same way, with what is finished on the disk."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED = 130
TERMINATED = 143
"""Exit codes, those that a shell gives a program ended by SIGINT and SIGTERM."""


class Ending:
    """Which signal has ended the command, if one has."""

    def __init__(self) -> None:
        self._received: list[int] = []

    def interrupt(self, signum: int, frame: FrameType | None) -> None:
        """Handle SIGINT."""
        self._received.append(signum)
        raise KeyboardInterrupt

    def terminate(self, signum: int, frame: FrameType | None) -> None:
        """Handle SIGTERM: by the present handler of SIGINT."""
        self._received.append(signum)
        signal.raise_signal(signal.SIGINT)

    def __bool__(self) -> bool:
        return bool(self._received)

    @property
    def exit_code(self) -> int:
        """Of the first signal; an interrupt that no signal has caused counts as Ctrl-C."""
        return TERMINATED if self._received[:1] == [signal.SIGTERM] else INTERRUPTED

    @property
    def words(self) -> str:
        """For the user."""
        return "terminated" if self.exit_code == TERMINATED else "interrupted"


@contextmanager
def listening() -> Iterator[Ending]:
    """Turn both signals into a KeyboardInterrupt within the block; only the main thread can."""
    ending = Ending()
    if threading.current_thread() is not threading.main_thread():
        yield ending
        return
    handlers = {signal.SIGINT: ending.interrupt, signal.SIGTERM: ending.terminate}
    before = {signum: signal.signal(signum, handler) for signum, handler in handlers.items()}
    try:
        yield ending
    finally:
        for signum, handler in before.items():
            signal.signal(signum, handler)


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Remember a Ctrl-C, give a function that says whether there was one, and end the block with it.

    CasADi swallows the KeyboardInterrupt and returns as if nothing had happened, or turns it into an error of its own,
    so a flag is kept beside it. Python delivers signals to the main thread: in any other, the flag stays down.
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
