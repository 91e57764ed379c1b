"""Following a family of gaits along a parameter, through folds and through changes of the mode sequence.

predict along the tangent, correct by Newton, watch; where something watched changes its sign, find that place,
say what it is, and where the mode sequence ends there, go on with one that the physics allows.
"""

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.families.bifurcations import TestFunction, bifurcations_between, is_bifurcation
from gaitopt.families.change import Change, find_change
from gaitopt.families.locate import Location
from gaitopt.families.position import FIRST_LENGTH, Position
from gaitopt.families.rescue import rescue
from gaitopt.families.segment import Point
from gaitopt.families.successors import halved_cycle
from gaitopt.families.vanishing import FADING, REASON, VANISHED, stride, vanishing_value
from gaitopt.gait import TERMINAL, BranchPoint, Gait, SpecialPoint
from gaitopt.mechanics import MARGINS
from gaitopt.study.claims import Claim
from gaitopt.study.verify import confirm

Record = BranchPoint | SpecialPoint

ASIDE = 1e-3
"""Arclength from a branch point at which tangents are taken: far enough for rounding, near
enough for curvature to be negligible."""
HALVED = "the two halves of the cycle become equal: here begins a gait of half as many steps, whose period doubles"


class Continuer:
    """Walks along a family and yields its points and special points in order.

    Parameters
    ----------
    position : where to start; ``count`` are the points before it, others than zero when a branch is taken up again.
    numbers : of the branches to come.
    should_stop : polled before every point; the walk then ends without a special point.
    """

    def __init__(self, position: Position, numbers: Iterator[int], *, count: int = 0, should_stop: Stop = None) -> None:
        self._state, self._limits, self._numbers, self._should_stop = position, position.limits, numbers, should_stop
        self._count, self._began = count, time.monotonic()

    def records(self, *, with_first: bool = True) -> Iterator[Record]:
        """All points and special points, until the family ends or a limit is reached."""
        if with_first:
            yield from self._emit()
        ended = False
        while not ended and not (self._should_stop is not None and self._should_stop()):
            reached = self._limits.reached(self._state.point.value) if self._state.index else None
            reason = reached or self._limits.exhausted(self._count, time.monotonic() - self._began)
            if reason is not None:
                end = self._special("end", self._state.point, reason=reason)
                yield replace(end, bound=reached is not None, open=reached is None)
                return
            for record in self._advance():
                yield record
                ended = ended or (isinstance(record, SpecialPoint) and record.type in TERMINAL)

    def _advance(self) -> Iterator[Record]:
        """One step along the family, with everything that happens on it."""
        state = self._state
        following = self._state.next()
        if following is None:
            if stride(state.point.gait) < VANISHED:
                yield self._special("vanishing", state.point, "guess", REASON)
                return
            rescued = rescue(state.segment, state.point)
            if rescued is None:
                reason = "neither Newton's method nor IPOPT finds a gait further on"
                yield self._special("end", state.point, "guess", reason)
                return
            self._state = Position(*rescued, state.number, self._limits, index=state.index + 1)
            yield from self._emit()
            return
        length, point, event = following
        if event is not None:
            point, length = event.point, event.length
        bound = self._limits.crossed(state.point.value, point.value)
        if bound is not None:
            reached = state.segment.at_parameter(state.point, bound)
            point, event = (point if reached is None else reached), None
        for special in self._bifurcations(point, length):
            yield special
            if special.type in TERMINAL:
                return
        if event is not None:
            yield from self._change(event)
            return
        self._move(point)
        yield from self._emit()

    def _bifurcations(self, point: Point, length: float) -> Iterator[SpecialPoint]:
        """Folds, losses of stability and the caller's events between the last point and ``point``, in order."""
        kinds = bifurcations_between(self._state.point.tests, point.tests)
        located = [
            (self._state.locate(partial(Point.test, name=name), length, point), kind, name)
            for kind, name in kinds.items()
        ]
        events = self._limits.request.events
        for name, function in events.items():
            if function(self._state.point.gait) * function(point.gait) < 0:
                watched = partial(_value, function)
                located.append((self._state.locate(watched, length, point), name, ""))
        for location, kind, name in sorted(located, key=lambda entry: entry[0].length):
            gait = location.point.gait
            if kind not in events and not (is_bifurcation(kind, gait.multipliers) and stride(gait) > VANISHED):
                continue
            special = self._special(kind, location.point, location.status)
            special = replace(special, gait=gait.verified(confirm(gait).to_record()))
            if kind == "branch_point":
                special = replace(special, tangent=self._tangent_through(location))
            yield self._halved(special) if name == "slope" else special

    def _tangent_through(self, location: Location) -> Array | None:
        """Tangent at a branch point, where that of its gait is undetermined: the mean of those on both sides."""
        segment = self._state.segment
        sides = [segment.step(self._state.point, location.length + side * ASIDE) for side in (-1, 1)]
        tangents = [segment.curve.entries(point.curve_point.tangent) for point in sides if point is not None]
        return np.mean(tangents, axis=0) if len(tangents) == len(sides) else None

    @staticmethod
    def _halved(special: SpecialPoint) -> SpecialPoint:
        """The end of a doubled family at its origin, where it turns round.

        Its second half is the first one, begun one cycle later.
        """
        assert special.gait is not None
        half = halved_cycle(special.gait) if special.type == "branch_point" else None
        if half is None:
            return special
        return replace(special, type="end", reason=HALVED, before=special.gait.problem.cycle, after=half)

    def _change(self, event: Location) -> Iterator[Record]:
        """The end of a mode sequence: a special point, and the branch that goes on from it if there is one."""
        state = self._state
        if stride(event.point.gait) < VANISHED:
            yield self._special("vanishing", event.point, event.status, REASON)
            return
        if event.name is None:
            raise ValueError("only a monitor that vanishes changes the mode sequence")
        margin = MARGINS.get(event.name.kind)
        if margin is not None and (margin.ending or event.name.kind == "touchdown"):
            kind = margin.ending if margin.ending in TERMINAL else "end"
            yield self._special(kind, event.point, event.status, margin.lost)
            return
        change = find_change(state.segment, event)
        if change.segment is None or change.point is None:
            yield self._special("end", event.point, event.status, change.reason)
            return
        number = next(self._numbers)
        yield self._joint(event, change, number)
        length = min(FIRST_LENGTH, change.length)
        self._state = Position(change.segment, change.point, number, self._limits, length=length)
        yield from self._emit()

    def _joint(self, event: Location, change: Change, number: int) -> SpecialPoint:
        assert change.segment is not None
        before, after = self._state.segment.cycle, change.segment.cycle
        kind = "mode_change" if before.impacts == after.impacts else "impact_change"
        special = self._special(kind, event.point, event.status, change.reason)
        if change.at is not None:
            tangent = change.segment.curve.entries(change.at.curve_point.tangent)
            special = replace(special, value=change.at.value, gait=change.at.gait, tangent=tangent)
        return replace(special, before=before, after=after, next=(number,))

    def _move(self, point: Point) -> None:
        state = self._state
        remeshed = state.segment.remeshed(point)
        state.point = point if remeshed is None else remeshed
        state.index += 1

    def _emit(self) -> Iterator[Record]:
        """The present point; confirmed by the simulator when it is its turn."""
        state, gait = self._state, self._state.point.gait
        every = self._limits.request.verify_every
        if every and self._count % every == 0:
            check = confirm(gait)
            gait = gait.verified(check.to_record())
            if not check.passed and (again := state.segment.solved_again(state.point)) is not None:
                state.point = again
                check = confirm(again.gait)
                gait = again.gait.verified(check.to_record())
            if not check.passed:
                yield self._unconfirmed(gait, next(claim for claim in check.claims if not claim.passed))
                return
        self._count += 1
        yield BranchPoint(
            branch=state.number,
            index=state.index,
            value=state.point.value,
            gait=gait,
            tangent=state.segment.coordinates(state.point.curve_point.tangent),
            length=state.length,
            walk=state.segment.walk_state(state.point),
        )

    def _unconfirmed(self, gait: Gait, worst: Claim) -> SpecialPoint:
        """The end of a family at a gait that the simulator refutes, unless the gait vanishes just ahead."""
        state = self._state
        reason = f"the simulator disagrees: {worst.name} {worst.figure:.3g}, {worst.note}"
        end = replace(self._special("end", state.point, "guess", reason), gait=gait)
        before = last = state.point
        while stride(last.gait) < FADING:
            following = self._state.next()
            if following is None:
                break
            _, point, event = following
            if event is not None:
                vanished = stride(event.point.gait) < VANISHED
                return self._special("vanishing", event.point, event.status, REASON) if vanished else end
            if self._limits.crossed(state.point.value, point.value) is not None:
                return end
            before, last = last, point
            self._move(point)
        if stride(last.gait) > VANISHED:
            return end
        return replace(self._special("vanishing", last, "guess", REASON), value=vanishing_value(before, last))

    def _special(self, kind: str, point: Point, status: str = "converged", reason: str = "") -> SpecialPoint:
        return SpecialPoint(
            branch=self._state.number,
            type=kind,
            value=point.value,
            status=status,
            reason=reason,
            gait=point.gait,
            tangent=self._state.segment.curve.entries(point.curve_point.tangent),
        )


def _value(function: TestFunction, point: Point) -> float:
    return float(function(point.gait))
