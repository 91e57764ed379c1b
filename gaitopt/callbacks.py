"""Types of the functions that long computations call: for progress, and to ask whether to stop; and the time limit."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

Stop = Callable[[], bool] | None
"""A function that is polled during a computation: if it returns True, the computation stops. None lets it finish."""
Counted = Callable[[int, int], None] | None
"""A function that is called with the number of finished jobs and their total number."""
Valued = Callable[[int, float], None] | None
"""A function of a number and a value: iteration and violation of a solution, or gaits and parameter of a family."""


def raise_if_stopped(should_stop: Stop) -> None:
    """Raise a KeyboardInterrupt if the caller wants to stop."""
    if should_stop is not None and should_stop():
        raise KeyboardInterrupt


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeLimit:
    """A ``should_stop`` that also returns True when the time is over.

    Attributes
    ----------
    seconds : time limit from now on [s]; None for no limit.
    should_stop : the function of the caller.
    began : time at which the limit starts to count.
    """

    seconds: float | None = None
    should_stop: Stop = None
    began: float = field(default_factory=time.monotonic)

    @property
    def is_over(self) -> bool:
        """Whether the time is over."""
        return self.seconds is not None and time.monotonic() - self.began >= self.seconds

    @property
    def is_interrupted(self) -> bool:
        """Whether the caller wants to stop, whatever the time."""
        return self.should_stop is not None and self.should_stop()

    def __call__(self) -> bool:
        """Whether to stop, because the time is over or the caller wants it."""
        return self.is_over or self.is_interrupted
