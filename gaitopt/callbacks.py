"""Types of the functions that long computations call: progress, and whether to stop."""

from collections.abc import Callable

Stop = Callable[[], bool] | None
"""Polled during a computation; True stops it, None lets it finish."""
Counted = Callable[[int, int], None] | None
"""Called with the number of finished jobs and the total number."""
Valued = Callable[[int, float], None] | None
"""Called with a number and a value: iteration and violation of a solution, or gaits and parameter of a family."""
