"""Where the walk along a family stops, and what it looks for on the way."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from gaitopt.families.bifurcations import TestFunction

LARGEST_LENGTH = 0.025
"""Arclength is scaled so that the range of the parameter has length one: at least forty points for it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Where to stop, and what to look for.

    Attributes
    ----------
    lower, upper : range of the parameter.
    events : functions of a gait whose zeros are special points of that name.
    max_points : number of points of all branches together.
    max_seconds : wall time, None without a limit.
    verify_every : every so many points, and every special point, is confirmed by the simulator; 0 for never.
    most_steps : number of steps of the longest cycle that is followed from a period doubling.
    largest_length : longest arclength step; the range of the parameter has length one.
    """

    lower: float
    upper: float
    events: Mapping[str, TestFunction] = field(default_factory=dict)
    max_points: int = 2000
    max_seconds: float | None = None
    verify_every: int = 10
    most_steps: int = 1
    largest_length: float = LARGEST_LENGTH
