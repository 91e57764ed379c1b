"""The steps along a curve of gaits, the same for a family in one parameter and for a curve in two.

Every step predicts the next gait along the curve, corrects it by Newton's method, and compares both ends: where a
bound is crossed, a test function changes its sign, or a monitor of the mode sequence vanishes, the zero is located.
What the zeros mean depends on the curve, see ``continuation`` and ``trace``.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Generic, TypeAlias, TypeVar

from gaitopt.branches.conditions import Condition
from gaitopt.branches.curve import Curve, CurvePoint, Location, Metric
from gaitopt.branches.request import Request
from gaitopt.callbacks import Stop
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.trace import MonitorKey
from gaitopt.model.cycle import BREAKPOINT
from gaitopt.solver import arclength
from gaitopt.solver.arclength import next_length
from gaitopt.store.branch import StoredPoint

FIRST_LENGTH = 0.005
"""Arclength of the first step; the range of the parameter has length one."""
SMALLEST_LENGTH = 1e-9
"""A step is not halved below this arclength."""
SHORT_SLIP = 1e-4
"""From a slip that is shorter than this fraction of the period, the branch without the slip can be reached."""
SILENT = 1e-8
"""A monitor whose value is below this number vanishes along the whole curve, or at its first point."""
VANISHED_STRIDE = 1e-4
"""A gait with a shorter stride vanishes. If only a mode sequence ends, strides are much longer."""
VANISHING = "the gait vanishes: its steps, or all its motion, become infinitely small"
HALVED = "the two halves of the cycle become equal: this is a period doubling of a gait with half as many steps"
P = TypeVar("P")
S = TypeVar("S")
Zero: TypeAlias = tuple[Location, MonitorKey]
"""The location at which a monitor vanishes, and the key of the monitor."""


@dataclass(kw_only=True, eq=False)
class Steps(ABC, Generic[P, S]):
    """A walk along a curve of gaits: iterating yields its points (P) and special points (S) in order.

    Attributes
    ----------
    request : the request with both bounds.
    metric : scales of arclength.
    numbers : numbers for the branches or curves to come.
    should_stop : polled after every record and before every step; True ends the walk, which can be resumed.
    point : the current point.
    index : number of the current point on its branch or curve.
    length : arclength of the next step.
    count : number of points so far.
    """

    request: Request
    metric: Metric
    numbers: Iterator[int]
    should_stop: Stop = None
    point: CurvePoint = field(init=False)
    index: int = field(init=False, default=0)
    length: float = field(init=False, default=FIRST_LENGTH)
    count: int = field(init=False, default=0)

    def __iter__(self) -> Iterator[P | S]:
        records, began = self._begin(), time.monotonic()
        while True:
            for record in records:
                yield record
                if self._is_end(record) or (self.should_stop is not None and self.should_stop()):
                    return
            if self.should_stop is not None and self.should_stop():
                return
            end = self._end(time.monotonic() - began)
            if end is not None:
                yield end
                return
            records = self._advance()

    def _resume(self, last: StoredPoint, condition: Condition | None = None) -> None:
        """Go on from a stored point, to the last bit.

        Raises
        ------
        SolveError
            If an earlier version wrote the point without its solution, and Newton's method fails at its gait.
        """
        at = last.solution
        curve = Curve(last.problem, self.request.parameter, at.equations, at.p, self.metric, condition)
        if last.direction is None:
            point = curve.start(at.w, last.tangent)
        else:
            stored = curve.solutions.equations.at(at.w)
            point = curve.with_gait(curve.solutions.point(stored, last.direction, last.iterations, last.earlier))
        if point is None:
            raise SolveError(f"branch {last.branch}: Newton's method fails at the gait of its point {last.index}")
        self.point, self.index, self.length = point, last.index, last.length

    def _advance(self) -> Iterator[P | S]:
        """One step along the curve: its special points, and the point at its end."""
        here, step = self.point, self._step()
        if step is None and (finer := here.bisected()) is not None:
            self._move(finer, moved=False)
            self.length = FIRST_LENGTH
            step = self._step()
            if step is None:
                self.point = here
        if step is None:
            if self._rescued():
                yield from self._point_records()
            elif (vanishing := self._short_phase()) is not None:
                yield from self._change(*vanishing)
            else:
                yield self._stuck()
            return
        here = self.point
        length, point, event = step
        if event is not None:
            point, length = event[0].point, event[0].length
        bounded = self._at_bound(here, point, length)
        if bounded is not None:
            (point, length), event = bounded, None
        for special in self._between(here, point, length):
            yield special
            if self._is_end(special):
                return
        if event is not None:
            yield from self._change(*event)
            return
        self._move(point)
        yield from self._point_records()

    def _step(self) -> tuple[float, CurvePoint, Zero | None] | None:
        """Arclength and gait of the next step, and the first zero of a monitor on the way.

        The step is halved until Newton's method converges near the prediction, the curve is nearly straight, and the
        zero can be located. None if no step is short enough.
        """
        here, solutions = self.point, self.point.curve.solutions
        while self.length > SMALLEST_LENGTH:
            length = self.length
            try:
                point = here.step(length)
            except ProblemError:  # the parameter is beyond the range that the problem allows
                bound = self.request.crossed(here.value, here.value + length * float(here.tangent[-1]))
                point = None if bound is None else here.at_parameter(bound)
            if point is not None and not (solutions.is_straight(here.point, point.point, length) and point.is_regular):
                point = None
            lost = [] if point is None else self._lost(here, point)
            every = any(key.kind == BREAKPOINT for key in lost)
            if point is not None and not point.in_order and not every:  # a switch has passed a breakpoint
                reordered = point.reordered()
                if reordered is not None and not self._lost(here, reordered):
                    return length, reordered, None
            elif point is not None:
                zeros, event = list[Zero](), None
                for key in lost:
                    # a monitor that is still positive at the first event has its zero later
                    if event is None or every or event[0].point.monitor(key) <= 0:
                        zeros.append((here.locate(point, length, partial(CurvePoint.monitor, key=key)), key))
                        event = min(zeros, key=lambda zero: zero[0].length)
                vanishing = _vanishing_slip(zeros)
                event = vanishing or event
                if event is None or vanishing is not None or event[0].status == "converged":
                    self.length = min(next_length(length, point.point.iterations), self.request.largest_length)
                    return length, point, event
            self.length /= 2
        return None

    def _short_phase(self) -> Zero | None:
        """The duration of a short phase that falls to zero just ahead of the current point; None if there is none.

        Close to this event Newton's method and the simulator may fail: a slip that begins from rest ends with a slope
        near zero, so that its duration has half the digits.
        """
        here = self.point
        n_free, n_phases = len(here.values), here.at.equations.n_phases
        rates = here.tangent[-n_free - n_phases : -n_free]
        short = [key for key in here.monitors if key.kind == "duration" and here.monitor(key) < SHORT_SLIP]
        falling = [key for key in short if key.phase is not None and rates[key.phase] < 0]
        if not falling:
            return None
        return arclength.Location(length=0.0, point=here, status="guess"), min(falling, key=here.monitor)

    @abstractmethod
    def _begin(self) -> Iterator[P | S]:
        """Go to the first point, or to that from which the walk resumes, and yield the records that it still needs."""

    @abstractmethod
    def _end(self, seconds: float) -> S | None:
        """The end of the walk at the current point; None if it goes on."""

    @abstractmethod
    def _is_end(self, record: P | S) -> bool:
        """Whether nothing follows a record."""

    def _rescued(self) -> bool:
        """Whether a method other than Newton's finds the next point, to which the walk then goes."""
        return False

    @abstractmethod
    def _stuck(self) -> S:
        """The end of the walk where no step succeeds, also on a finer mesh, and no short phase vanishes."""

    @abstractmethod
    def _at_bound(self, here: CurvePoint, point: CurvePoint, length: float) -> tuple[CurvePoint, float] | None:
        """The point at the first bound that a step passes, and the arclength there; None if it passes none."""

    @abstractmethod
    def _between(self, here: CurvePoint, point: CurvePoint, length: float) -> Iterator[S]:
        """Special points of a step of this arclength at which the mode sequence stays, in order."""

    @abstractmethod
    def _lost(self, before: CurvePoint, after: CurvePoint) -> list[MonitorKey]:
        """Monitors that vanish on a step."""

    @abstractmethod
    def _change(self, event: Location, key: MonitorKey) -> Iterator[P | S]:
        """The end of a mode sequence: a special point, and the first point with the next one if there is one."""

    @abstractmethod
    def _move(self, point: CurvePoint, *, moved: bool = True) -> None:
        """Go to a point; unless it has ``moved``, it is the same gait on another mesh."""

    @abstractmethod
    def _point_records(self) -> Iterator[P | S]:
        """The current point, verified by the simulator if it is due; the end of the walk if that refutes it."""


def _vanishing_slip(zeros: Sequence[Zero]) -> Zero | None:
    """The zero of the duration of a slip that begins before a breakpoint and vanishes there; None if there is none.

    The torques jump at the breakpoint. The slip therefore ends after a time that is quadratic in the time by which it
    begins earlier. Newton's method fails close to the event, which is located on the branch without the slip instead.
    """
    met = [key.phase for _, key in zeros if key.kind == BREAKPOINT and key.phase is not None]
    for location, key in zeros:
        near = location.status == "converged" or location.point.monitor(key) < SHORT_SLIP
        if near and key.kind == "duration" and key.phase is not None and key.phase - 1 in met:
            return location, key
    return None
