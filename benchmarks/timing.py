"""What a measurement is: the shortest of many calls, a row of the table, and the memory at its fullest."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from typing import Any

import psutil

LOOK_EVERY = 0.2
"""Time between two looks at the memory [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One line of the table: what was done, how, how long one of it took, and how many times faster than the peer."""

    what: str
    way: str
    seconds: float
    ratio: float | None = None
    note: str = ""

    def to_record(self) -> dict[str, Any]:
        """The row as JSON."""
        return asdict(self)


Way = tuple[Callable[[], Any], str]
"""A function to be measured, and a note."""


def compared(
    what: str, ways: dict[str, Way], *, rounds: int = 5, slice_seconds: float = 0.2, each: int = 1
) -> list[Row]:
    """Rows of different ways to do the same, with their ratios to the first.

    The ways take turns, so that whatever else the machine does disturbs them alike; of each the call counts that took
    the smallest processor time.

    Parameters
    ----------
    rounds : turns of each way.
    slice_seconds : a turn repeats its call for so long.
    each : how many of the things one call does.
    """
    shortest = dict.fromkeys(ways, float("inf"))
    for call, _ in ways.values():
        call()  # compile, fill caches
    for _ in range(rounds):
        for way, (call, _) in ways.items():
            until = time.perf_counter() + slice_seconds
            while True:
                began = time.process_time()
                call()
                shortest[way] = min(shortest[way], (time.process_time() - began) / each)
                if time.perf_counter() > until:
                    break
    first = next(iter(shortest.values()))
    return [
        Row(what=what, way=way, seconds=shortest[way], ratio=first / shortest[way], note=note)
        for way, (_, note) in ways.items()
    ]


@dataclass(slots=True)
class Memory:
    """Largest memory [bytes] that was seen of this process with its workers, and of one of them."""

    together: int = 0
    largest: int = 0
    over: threading.Event = field(default_factory=threading.Event)

    def watch(self) -> None:
        """Look until it is over."""
        this = psutil.Process()
        while not self.over.wait(LOOK_EVERY):
            sizes = []
            for process in (this, *this.children(recursive=True)):
                with suppress(psutil.NoSuchProcess):
                    sizes.append(process.memory_info().rss)
            self.together, self.largest = max(self.together, sum(sizes)), max(self.largest, *sizes)


@contextmanager
def watched_memory() -> Iterator[Memory]:
    """The memory that is in use during the block."""
    memory = Memory()
    watcher = threading.Thread(target=memory.watch, daemon=True)
    watcher.start()
    try:
        yield memory
    finally:
        memory.over.set()
        watcher.join()
