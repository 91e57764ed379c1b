"""The connected interval of a parameter in which the same control has a stable gait, and what ends it."""

from collections.abc import Callable
from dataclasses import dataclass

from gaitopt.branches.continuation import follow_family
from gaitopt.branches.request import Request
from gaitopt.callbacks import Stop, raise_if_stopped
from gaitopt.gait.branch import TERMINAL, BranchPoint, SpecialPoint
from gaitopt.gait.gait import Gait
from gaitopt.uncertainty.limits import LARGEST_FRICTION

NONE = "none"
"""Type of the end of an interval that continues beyond all values examined."""
NEAR_ZERO = 1e-3
"""Distance from zero of the value that is examined if the problem does not allow zero, relative to that of the gait."""
REACH = 2.0
"""A parameter other than friction is followed up to this distance, relative to its size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """The interval of a parameter with a stable gait.

    Attributes
    ----------
    low, high : ends of the interval; None on a side on which it goes on beyond all values that were computed.
    low_end, high_end : type of the special point at each end; ``none`` if there is no end.
    """

    low: float | None
    high: float | None
    low_end: str
    high_end: str


def stable_interval(gait: Gait, key: str, *, should_stop: Stop = None) -> Interval:
    """The stable interval of a parameter around a stable gait, by continuation to both sides.

    Parameters
    ----------
    key : dotted key of a continuous parameter of the gait.
    """
    value = gait.dynamics.parameter(key)
    low, high = (_end(gait, key, _target(gait, key, value, sign), should_stop) for sign in (-1, 1))
    return Interval(low=low[0], high=high[0], low_end=low[1], high_end=high[1])


def _target(gait: Gait, key: str, value: float, sign: int) -> float | None:
    """The value to which the gait is followed on one side; None if the problem allows no value there."""
    objection: Callable[[str, float], str | None] = gait.problem.objection
    if key.startswith("friction"):
        targets: tuple[float, ...] = (0.0, NEAR_ZERO * value) if sign < 0 else (max(LARGEST_FRICTION, REACH * value),)
    else:
        size = abs(value) or 1.0
        targets = tuple(value + sign * fraction * size for fraction in (REACH, 1.0, 1 - NEAR_ZERO, 0.5, 0.1))
    return next((target for target in targets if target != value and not objection(key, target)), None)


def _end(gait: Gait, key: str, target: float | None, should_stop: Stop) -> tuple[float | None, str]:
    """The value at which stable gaits end on the way to a target, and the type of that point."""
    if target is None:
        return None, NONE
    last, passed = gait.dynamics.parameter(key) if key in gait.system.parameters else target, list[SpecialPoint]()
    for record in follow_family(gait, Request(parameter=key, to=(target,), verify_every=0), should_stop=should_stop):
        if isinstance(record, BranchPoint):
            if not record.gait.stable:
                first = passed[0] if passed else None
                return (record.value, "unstable") if first is None else (first.value, first.type)
            last, passed = record.value, []
        elif record.type in TERMINAL:
            return (None, NONE) if record.bound else (record.value, record.type)
        else:
            passed.append(record)
    raise_if_stopped(should_stop)
    return last, "end"
