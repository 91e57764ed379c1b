"""Finding the place between two points of a branch at which something watched is zero."""

from collections.abc import Callable
from dataclasses import dataclass

from gaitopt.families.monitors import MonitorKey
from gaitopt.families.segment import Point, Segment
from gaitopt.iteration import bracketed_root

LENGTH_TOLERANCE = 1e-13
"""In arclength; the parameter is then right to more than ten digits of its range."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Location:
    """A place on a step.

    Attributes
    ----------
    length : arclength from the start of the step.
    point : the gait there.
    status : ``converged``, or ``guess`` where Newton's method failed on the way and only the step is known.
    name : the monitor that vanishes, None for a test function.
    """

    length: float
    point: Point
    status: str
    name: MonitorKey | None


class _LostError(Exception):
    """Newton's method did not converge at a trial length."""


def locate(
    segment: Segment,
    before: Point,
    after: Point,
    length: float,
    watched: Callable[[Point], float],
    name: MonitorKey | None = None,
) -> Location:
    """The zero of ``watched`` on the step of the given arclength from ``before`` to ``after``."""
    seen: dict[float, Point] = {0.0: before, length: after}

    def value(at: float) -> float:
        if at not in seen:
            point = segment.step(before, at)
            if point is None:
                raise _LostError
            seen[at] = point
        return watched(seen[at])

    try:
        root = bracketed_root(value, 0.0, length, LENGTH_TOLERANCE)
    except _LostError:
        return Location(length=length, point=after, status="guess", name=name)
    value(root)
    return Location(length=root, point=seen[root], status="converged", name=name)
