"""The next gait of a family: predicted along the tangent, corrected by Newton's method, watched for events."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from gaitopt.errors import ProblemError
from gaitopt.families.limits import LARGEST_LENGTH, Limits
from gaitopt.families.locate import Location, locate
from gaitopt.families.monitors import MonitorKey
from gaitopt.families.segment import Point, Segment

FIRST_LENGTH = 0.005
"""Arclength of the first step; the range of the parameter has length one."""
SMALLEST_LENGTH = 1e-9
FEW_ITERATIONS, MANY_ITERATIONS = 5, 8
"""Newton iterations at which a step length grows, and shrinks."""
STRAIGHT = 0.98
"""Cosine of the largest angle between the tangents of neighbours."""
ASIDE = 0.2
"""Largest distance of a gait from its prediction, in step lengths."""
GROWTH = 2.0


@dataclass(slots=True)
class Position:
    """Where a walk along a family has got to.

    Attributes
    ----------
    segment, point : the branch, and the gait on it.
    number : of the branch.
    limits : of the parameter.
    index : of the gait on its branch.
    length : arclength of the next step.
    """

    segment: Segment
    point: Point
    number: int
    limits: Limits
    index: int = 0
    length: float = FIRST_LENGTH

    def next(self) -> tuple[float, Point, Location | None] | None:
        """The next gait, its arclength and the first event on the way.

        The step is halved until Newton's method converges near the prediction, the curve is straight, and the event
        can be located.
        """
        while self.length > SMALLEST_LENGTH:
            point, length = self._try(self.length), self.length
            if point is not None and self._is_straight(point):
                if not self.segment.in_order(point):
                    reordered = self._reordered(point)
                    if reordered is not None:
                        return length, reordered, None
                else:
                    event = self._first_event(point, length)
                    if event is None or event.status == "converged":
                        self.length = self._adapted(point)
                        return length, point, event
            self.length /= 2
        return None

    def _reordered(self, point: Point) -> Point | None:
        """A gait at which a switch has just passed a breakpoint of the control, unless something else happens too."""
        other = self.segment.reordered(point)
        if other is None or self._lost(other[1]):
            return None
        self.segment = other[0]
        return other[1]

    def _try(self, length: float) -> Point | None:
        try:
            return self.segment.step(self.point, length)
        except ProblemError:  # the parameter has left the range that the problem allows
            return self._at_bound(length)

    def _at_bound(self, length: float) -> Point | None:
        """The gait at the bound of the parameter, where a step of this length passes it."""
        ahead = length * self.point.curve_point.tangent[-1]
        bound = self.limits.upper if ahead > 0 else self.limits.lower
        return self.segment.at_parameter(self.point, bound) if abs(bound - self.point.value) <= abs(ahead) else None

    def _is_straight(self, point: Point) -> bool:
        """Whether the tangent has turned little, and the gait lies where it was predicted."""
        coordinates = self.segment.coordinates
        before, after = coordinates(self.point.curve_point.tangent), coordinates(point.curve_point.tangent)
        missed = coordinates(point.curve_point.at.w) - coordinates(self.point.curve_point.at.w) - self.length * before
        return bool(before @ after > STRAIGHT and np.linalg.norm(missed) < ASIDE * self.length)

    def _adapted(self, point: Point) -> float:
        """The next step length, from what Newton's method took."""
        length = self.length
        if point.curve_point.iterations > MANY_ITERATIONS:
            return length / 2
        growth = GROWTH if point.curve_point.iterations <= FEW_ITERATIONS else 1.0
        return min(growth * length, LARGEST_LENGTH)

    def _first_event(self, point: Point, length: float) -> Location | None:
        """The first place on the step at which a monitor falls to zero."""
        locations = [self.locate(partial(Point.monitor, name=name), length, point, name) for name in self._lost(point)]
        return min(locations, key=lambda location: location.length, default=None)

    def _lost(self, point: Point) -> list[MonitorKey]:
        """Monitors that were positive at the last point and are no longer."""
        before = self.point
        return [name for name in point.monitors if point.monitor(name) <= 0 < before.monitor(name)]

    def locate(
        self, watched: Callable[[Point], float], length: float, point: Point, name: MonitorKey | None = None
    ) -> Location:
        """The zero of ``watched`` on the step of the given arclength to ``point``."""
        return locate(self.segment, self.point, point, length, watched, name)
