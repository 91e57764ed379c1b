"""Following a family of gaits along a parameter, through folds and through changes of the mode sequence.

predict along the tangent, correct by Newton, watch; where something watched changes its sign, find that place,
say what it is, and where the mode sequence ends there, go on with one that the physics allows.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gaitopt.errors import ProblemError
from gaitopt.gait import BranchPoint, SpecialPoint
from gaitopt.study.continuation.bifurcations import is_genuine
from gaitopt.study.continuation.change import Change, find_change
from gaitopt.study.continuation.limits import Limits
from gaitopt.study.continuation.locate import Location, locate
from gaitopt.study.continuation.monitors import Name
from gaitopt.study.continuation.piece import Piece, Station
from gaitopt.study.continuation.rescue import rescue
from gaitopt.study.verify import confirm

Array = NDArray[np.float64]
Record = BranchPoint | SpecialPoint

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

ENDS = {
    "normal_force": ("lift_off", "the stance foot lifts off: its normal force falls to zero"),
    "impulse": ("lift_off", "the normal impulse of the impact falls to zero"),
    "painleve": ("painleve", "the slip has no unique solution any more"),
    "impact_painleve": ("painleve", "the slipping impact has no unique solution any more"),
    "lift_velocity": ("end", "the former stance foot no longer lifts at the impact"),
    "touchdown": ("end", "the swing foot touches the ground earlier in the step"),
}
"""Monitors whose loss no other mode sequence can mend."""
TERMINAL = ("end", "lift_off", "painleve")
"""Special points at which a family ends."""


@dataclass(slots=True)
class _State:
    """Where the walk along the family has got to."""

    piece: Piece
    station: Station
    number: int
    index: int
    length: float


class Follower:
    """Walks along a family and yields its points and special points in order.

    Parameters
    ----------
    piece, station : the branch to start on, and its first gait.
    limits : where to stop.
    number, index, length : of the first point, and ``count`` the points before it; others than zero when a branch is
        taken up again.
    should_stop : polled before every point; the walk then ends without a special point.
    """

    def __init__(
        self,
        piece: Piece,
        station: Station,
        limits: Limits,
        *,
        number: int = 0,
        index: int = 0,
        length: float = FIRST_LENGTH,
        count: int = 0,
        should_stop: Callable[[], bool] | None = None,
    ) -> None:
        self._state = _State(piece, station, number, index, min(length, limits.largest_length))
        self._limits, self._should_stop = limits, should_stop
        self._count, self._began = count, time.monotonic()

    def records(self, *, with_first: bool = True) -> Iterator[Record]:
        """All points and special points, until the family ends or a limit is reached."""
        if with_first:
            yield from self._emit()
        ended = False
        while not ended and not (self._should_stop is not None and self._should_stop()):
            reason = self._limit_reached()
            if reason is not None:
                yield self._special("end", self._state.station, reason=reason)
                return
            for record in self._advance():
                yield record
                ended = ended or (isinstance(record, SpecialPoint) and record.type in TERMINAL)

    def _advance(self) -> Iterator[Record]:
        """One step along the family, with everything that happens on it."""
        state = self._state
        following = self._next()
        if following is None:
            rescued = rescue(state.piece, state.station)
            if rescued is None:
                reason = "neither Newton's method nor IPOPT finds a gait further on"
                yield self._special("end", state.station, "guess", reason)
                return
            self._state = _State(*rescued, state.number, state.index + 1, FIRST_LENGTH)
            yield from self._emit()
            return
        length, station, event = following
        if event is not None:
            station, length = event.station, event.length
        bound = self._bound_crossed(station)
        if bound is not None:
            reached = state.piece.at_parameter(state.station, bound)
            station, event = (station if reached is None else reached), None
        yield from self._bifurcations(station, length)
        if event is not None:
            yield from self._change(event)
            return
        self._move(station)
        yield from self._emit()
        if bound is not None:
            yield self._special("end", station, reason=f"reached {self._state.piece.parameter} = {bound:.12g}")

    def _next(self) -> tuple[float, Station, Location | None] | None:
        """The next gait, its arclength and the first event on the way.

        The step is halved until Newton's method converges near the prediction, the curve is straight, and the event
        can be located.
        """
        state = self._state
        while state.length > SMALLEST_LENGTH:
            station, length = self._try(state.length), state.length
            if station is not None and self._is_straight(station):
                if not state.piece.in_order(station):
                    reordered = self._reordered(station)
                    if reordered is not None:
                        return length, reordered, None
                else:
                    event = self._first_event(station, length)
                    if event is None or event.status == "converged":
                        state.length = self._adapted(station)
                        return length, station, event
            state.length /= 2
        return None

    def _reordered(self, station: Station) -> Station | None:
        """A gait at which a switch has just passed a breakpoint of the control, unless something else happens too."""
        found = self._state.piece.reordered(station)
        if found is None or self._lost(found[1]):
            return None
        self._state.piece = found[0]
        return found[1]

    def _try(self, length: float) -> Station | None:
        try:
            return self._state.piece.step(self._state.station, length)
        except ProblemError:  # the parameter has left the range that the problem allows
            return self._at_bound(length)

    def _at_bound(self, length: float) -> Station | None:
        """The gait at the bound of the parameter, where a step of this length passes it."""
        piece, station = self._state.piece, self._state.station
        ahead = length * station.point.tangent[-1]
        bound = self._limits.upper if ahead > 0 else self._limits.lower
        return piece.at_parameter(station, bound) if abs(bound - station.value) <= abs(ahead) else None

    def _is_straight(self, station: Station) -> bool:
        """Whether the tangent has turned little, and the gait lies where it was predicted."""
        state, coordinates = self._state, self._state.piece.coordinates
        before, after = coordinates(state.station.point.tangent), coordinates(station.point.tangent)
        missed = coordinates(station.point.at.w) - coordinates(state.station.point.at.w) - state.length * before
        return bool(before @ after > STRAIGHT and np.linalg.norm(missed) < ASIDE * state.length)

    def _adapted(self, station: Station) -> float:
        """The next step length, from what Newton's method took."""
        length = self._state.length
        if station.point.iterations > MANY_ITERATIONS:
            return length / 2
        growth = GROWTH if station.point.iterations <= FEW_ITERATIONS else 1.0
        return min(growth * length, self._limits.largest_length)

    def _first_event(self, station: Station, length: float) -> Location | None:
        """The first place on the step at which a monitor falls to zero."""
        found = [
            self._locate(partial(Station.monitor, name=name), length, station, name) for name in self._lost(station)
        ]
        return min(found, key=lambda location: location.length, default=None)

    def _lost(self, station: Station) -> list[Name]:
        """Monitors that were positive at the last point and are no longer."""
        before = self._state.station
        return [name for name in station.monitors if station.monitor(name) <= 0 < before.monitor(name)]

    def _bifurcations(self, station: Station, length: float) -> Iterator[SpecialPoint]:
        """Folds and losses of stability between the last point and ``station``, in order."""
        before = self._state.station.tests
        kinds = [kind for kind, value in station.tests.items() if value * before[kind] < 0]
        found = [(self._locate(partial(Station.test, kind=kind), length, station), kind) for kind in kinds]
        for location, kind in sorted(found, key=lambda pair: pair[0].length):
            gait = location.station.gait
            if is_genuine(kind, gait.multipliers):
                special = self._special(kind, location.station, location.status)
                yield replace(special, gait=gait.verified(confirm(gait).to_record()))

    def _locate(
        self, watched: Callable[[Station], float], length: float, station: Station, name: Name | None = None
    ) -> Location:
        return locate(self._state.piece, self._state.station, station, length, watched, name)

    def _bound_crossed(self, station: Station) -> float | None:
        lower, upper = self._limits.lower, self._limits.upper
        if station.value >= upper > self._state.station.value:
            return upper
        return lower if station.value <= lower < self._state.station.value else None

    def _change(self, event: Location) -> Iterator[Record]:
        """The end of a mode sequence: a special point, and the branch that goes on from it if there is one."""
        state = self._state
        assert event.name is not None, "an event is the end of a monitor"
        if event.name.kind in ENDS:
            kind, reason = ENDS[event.name.kind]
            yield self._special(kind, event.station, event.status, reason)
            return
        change = find_change(state.piece, event)
        if change.piece is None or change.station is None:
            yield self._special("end", event.station, event.status, change.reason)
            return
        yield self._joint(event, change)
        self._state = _State(change.piece, change.station, state.number + 1, 0, min(FIRST_LENGTH, change.length))
        yield from self._emit()

    def _joint(self, event: Location, change: Change) -> SpecialPoint:
        assert change.piece is not None
        before, after = self._state.piece.cycle, change.piece.cycle
        kind = "mode_change" if before.impacts == after.impacts else "impact_change"
        special = self._special(kind, change.at or event.station, event.status, change.reason)
        return replace(special, before=before, after=after, next=(self._state.number + 1,))

    def _move(self, station: Station) -> None:
        state = self._state
        remeshed = state.piece.remeshed(station)
        state.station = station if remeshed is None else remeshed
        state.index += 1

    def _emit(self) -> Iterator[Record]:
        """The present point; confirmed by the simulator when it is its turn."""
        state, gait = self._state, self._state.station.gait
        every = self._limits.verify_every
        if every and self._count % every == 0:
            check = confirm(gait)
            gait = gait.verified(check.to_record())
            if not check.passed:
                worst = next(claim for claim in check.claims if not claim.passed)
                reason = f"the simulator disagrees: {worst.name} {worst.figure:.3g}, {worst.note}"
                yield self._special("end", state.station, "guess", reason)
                return
        self._count += 1
        yield BranchPoint(
            branch=state.number,
            index=state.index,
            value=state.station.value,
            gait=gait,
            tangent=state.piece.coordinates(state.station.point.tangent),
            length=state.length,
        )

    def _special(self, kind: str, station: Station, status: str = "converged", reason: str = "") -> SpecialPoint:
        return SpecialPoint(
            branch=self._state.number,
            type=kind,
            value=station.value,
            status=status,
            reason=reason,
            gait=station.gait,
        )

    def _limit_reached(self) -> str | None:
        if self._count >= self._limits.max_points:
            return f"{self._limits.max_points} points, as many as were asked for"
        elapsed = time.monotonic() - self._began
        if self._limits.max_seconds is not None and elapsed > self._limits.max_seconds:
            return f"out of time after {elapsed:.0f} s"
        return None
