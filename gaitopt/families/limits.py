"""Where the walk along a family stops."""

from dataclasses import dataclass

LARGEST_LENGTH = 0.025
"""Arclength is scaled so that the range of the parameter has length one: at least forty points for it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Where to stop.

    Attributes
    ----------
    lower, upper : range of the parameter.
    max_points : number of points of all branches together.
    max_seconds : wall time, None without a limit.
    verify_every : every so many points, and every special point, is confirmed by the simulator; 0 for never.
    most_steps : number of steps of the longest cycle that is followed from a period doubling.
    largest_length : longest arclength step; the range of the parameter has length one.
    """

    lower: float
    upper: float
    max_points: int = 2000
    max_seconds: float | None = None
    verify_every: int = 10
    most_steps: int = 1
    largest_length: float = LARGEST_LENGTH
