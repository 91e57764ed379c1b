"""What long work calls on its way: progress, and whether to stop."""

from collections.abc import Callable

Stop = Callable[[], bool] | None
"""Polled; True ends the work, None never does."""
Counted = Callable[[int, int], None] | None
"""Called with the number of finished parts and their total."""
Valued = Callable[[int, float], None] | None
"""Called with a number and a value: iteration and violation of a solution, gaits and parameter of a family."""
