"""What a measurement is: the best of several calls, and a row of the table."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any


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
"""What is called, and a note."""


def compared(
    what: str, ways: dict[str, Way], *, rounds: int = 5, slice_seconds: float = 0.2, each: int = 1
) -> list[Row]:
    """Rows of several ways to do the same, with their ratios to the first.

    The ways take turns, so that whatever else the machine does disturbs them alike; the shortest call of each counts.

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
                began = time.perf_counter()
                call()
                ended = time.perf_counter()
                shortest[way] = min(shortest[way], (ended - began) / each)
                if ended > until:
                    break
    first = next(iter(shortest.values()))
    return [
        Row(what=what, way=way, seconds=shortest[way], ratio=first / shortest[way], note=note)
        for way, (_, note) in ways.items()
    ]
