"""Where the walk along a family stops."""

from collections.abc import Mapping
from dataclasses import dataclass, field

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
    follow : how many times in turn the other branches of special points are still followed, see ``Request``.
    largest_length : longest arclength step; the range of the parameter has length one.
    """

    lower: float
    upper: float
    max_points: int = 2000
    max_seconds: float | None = None
    verify_every: int = 10
    follow: Mapping[str, int] = field(default_factory=dict)
    largest_length: float = LARGEST_LENGTH
