"""The next gait of a family: predicted along the tangent, corrected by Newton's method, watched for events.

Following a family of gaits along a parameter, through folds and through changes of the mode sequence.

predict along the tangent, correct by Newton, watch; where something watched changes its sign, find that place,
say what it is, and where the mode sequence ends there, go on with one that the physics allows.

Walks along a family: from a gait towards each target, and along every branch that begins at a special point.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from gaitopt.arrays import Array
from gaitopt.branches.change import Change, find_change, halved_cycle, rescue, with_cycle
from gaitopt.branches.curve import (
    FADING,
    REASON,
    VANISHED,
    Location,
    Metric,
    Point,
    Segment,
    locate,
    segment_through,
    stride,
    vanishing_value,
)
from gaitopt.branches.monitors import MonitorKey, coefficient_bounds, with_friction
from gaitopt.branches.request import (
    FOLLOWS,
    LARGEST_LENGTH,
    Limits,
    Request,
    TestFunction,
    bifurcations_between,
    is_bifurcation,
)
from gaitopt.branches.switching import Beginning, beginnings, first_point, started
from gaitopt.callbacks import Stop
from gaitopt.errors import ProblemError, SolveError, StorageError
from gaitopt.gait.branch import TERMINAL, BranchPoint, SpecialPoint, WalkState
from gaitopt.gait.gait import Gait, Status
from gaitopt.model.cycle import Cycle
from gaitopt.model.margins import MARGINS
from gaitopt.nlp.rollout import roll_out
from gaitopt.problem.problem import Problem
from gaitopt.store.gaits import special_point
from gaitopt.systems import problem_dynamics
from gaitopt.verification.verify import Claim, confirm

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


Record = BranchPoint | SpecialPoint

ASIDE_CONTINUER = 1e-3
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
        sides = [segment.step(self._state.point, location.length + side * ASIDE_CONTINUER) for side in (-1, 1)]
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


RecordsRecord = Mapping[str, Any]


def family_of(problem: Problem, parameter: str) -> Gait:
    """A gait without a motion, with problem and dynamics of the family of ``problem`` along ``parameter``."""
    stated = Gait(problem=problem, dynamics=problem_dynamics(problem), status=Status.CONVERGED, message="")
    return with_friction(stated, parameter)


def resumed_point(gait: Gait, parameter: str, metric: Metric, points: Sequence[RecordsRecord]) -> tuple[Segment, Point]:
    """The branch and the point that the last of the records of a walk's points holds, as the walk left them.

    A record of an earlier version does not hold what the walk needs: its gait is solved again. ``gait`` is the first of
    the family.

    Raises
    ------
    StorageError
        If the record does not hold a point from which a walk can go on.
    """
    record = points[-1]
    try:
        if not record["length"] > 0:
            raise ValueError(f"length {record['length']} is not positive")
        return _resumed_point(gait, parameter, metric, points)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise _unusable(record, error) from error


def stored_metric(record: RecordsRecord) -> Metric:
    """What arclength is measured with on the walk of a stored point.

    Raises
    ------
    StorageError
        If the record does not hold a point from which a walk can go on.
    """
    try:
        return Metric.from_array(WalkState.from_record(record["walk"]).metric)
    except ValueError as error:
        raise _unusable(record, error) from error


def _unusable(record: RecordsRecord, error: Exception) -> StorageError:
    words = f"{error}" if isinstance(error, ValueError) else f"{error!r}"
    return StorageError(f"the walk cannot go on from point {record.get('index')} of branch {record['branch']}: {words}")


def _resumed_point(
    gait: Gait, parameter: str, metric: Metric, points: Sequence[RecordsRecord]
) -> tuple[Segment, Point]:
    record = points[-1]
    value, steps = record["value"], record.get("steps", (record,))
    dynamics = gait.dynamics.at({parameter: value})
    states = np.array([[step["state"][name] for name in gait.system.state_names] for step in steps])
    problem = with_cycle(gait.problem.replace({parameter: value}), gait.system, Cycle.from_record(record), states[0])
    if record.get("walk"):
        needed = points[-1 - WalkState.from_record(record["walk"]).earlier :]
        known = [WalkState.from_record(point["walk"]) for point in needed if point.get("walk")]
        if known[-1].unknowns[-1] != value:
            raise ValueError(f"value {value} is not the last of walk.unknowns, {known[-1].unknowns[-1]}")
        return Segment.resumed(problem, gait.dynamics, parameter, known, int(record["solver"]["iterations"]))
    durations = np.array([phase["duration"] for phase in record["phases"]])
    rolled = roll_out(dynamics, problem.cycle, states, durations)
    segment, w = segment_through(problem, dynamics, parameter, metric, rolled, record.get("intervals", ()))
    return segment, first_point(segment, w, segment.curve.direction(np.array(record["tangent"])))


WalksRecord = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Walk:
    """One walk along a family.

    Attributes
    ----------
    gait : the gait from which everything began; its parameters are those of the family.
    metric, limits : what arclength is measured with, and where to stop.
    begin : finds the first gait.
    number : of its first branch, None if no number is reserved for it.
    """

    gait: Gait
    metric: Metric
    limits: Limits
    begin: Callable[[], Beginning]
    number: int | None = None

    @property
    def parameter(self) -> str:
        """Dotted key of the parameter of the family."""
        return self.limits.request.parameter

    def continuer(self, done: Sequence[WalksRecord], numbers: Iterator[int], should_stop: Stop) -> Continuer:
        """The walk from its first gait, or from the last point that is ``done``."""
        points = [record for record in done if record["record"] == "point"]
        if points:
            last = points[-1]
            segment, point = resumed_point(self.gait, self.parameter, self.metric, points)
            position = Position(segment, point, last["branch"], self.limits, index=last["index"], length=last["length"])
        else:
            segment, point = self.begin()
            position = Position(segment, point, next(numbers) if self.number is None else self.number, self.limits)
        return Continuer(position, numbers, count=len(points), should_stop=should_stop)

    def with_metric_of(self, done: Sequence[WalksRecord]) -> "Walk":
        """The same walk, its arclength measured as in the records that are ``done``."""
        metric = next((stored_metric(record) for record in done if record.get("walk")), None)
        return self if metric is None else replace(self, metric=metric)

    def branches(self, special: SpecialPoint, numbers: Iterator[int]) -> tuple[SpecialPoint, list["Walk"]]:
        """A special point with the numbers of its other branches, if they are to be followed, and the walks on them."""
        if not self.limits.request.follow.get(FOLLOWS.get(special.type, ""), 0):
            return special, []
        try:
            begun = self._beginnings(special.to_record())
        except (ProblemError, SolveError) as error:
            silent = special.next  # at a change of modes there is mostly one branch that goes on
            return (special if silent else replace(special, reason=str(error))), []
        walks = [self._branch(special.type, next(numbers), partial(_given, beginning)) for beginning in begun]
        following = tuple(walk.number for walk in walks if walk.number is not None)
        return replace(special, next=special.next + following), walks

    def restored_branches(self, record: WalksRecord) -> list["Walk"]:
        """The walks along the other branches of a stored special point."""
        kind = record.get("type", "")
        if kind not in FOLLOWS:
            return []
        own = 1 if "to" in record else 0  # of a change, the first number is that of the known family
        return [
            self._branch(kind, number, partial(self._restored_beginning, record, index))
            for index, number in enumerate(record["next"][own:])
        ]

    def _restored_beginning(self, record: WalksRecord, index: int) -> Beginning:
        return self._beginnings(record)[index]

    def _beginnings(self, record: WalksRecord) -> list[Beginning]:
        """The first gaits of the other branches through a special point, as far as they are within the limits.

        They are found from its record, so that a walk taken up again finds the same.
        """
        begun = beginnings(special_point(self.gait, self.parameter, record), self.parameter, self.metric)
        return [(segment, point) for segment, point in begun if self.limits.lower < point.value < self.limits.upper]

    def _branch(self, kind: str, number: int, begin: Callable[[], Beginning]) -> "Walk":
        request, times = self.limits.request, FOLLOWS[kind]
        once_less = replace(request, follow={**request.follow, times: request.follow[times] - 1})
        return replace(self, begin=begin, number=number, limits=replace(self.limits, request=once_less))


def first_walks(start: Gait | SpecialPoint, gait: Gait, request: Request) -> list[Walk]:
    """Towards each target from a gait; along every other branch from a special point, the targets being bounds.

    ``gait`` is that of ``start``, restated for the parameter.
    """
    value = gait.dynamics.parameter(request.parameter)
    if isinstance(start, SpecialPoint):
        metric = Metric.of(gait, max(abs(to - value) for to in request.to))
        limits = _limits(gait, request, request.to)
        begun = beginnings(replace(start, gait=gait), request.parameter, metric)
        return [Walk(gait=gait, metric=metric, limits=limits, begin=partial(_given, own)) for own in begun]
    walks = []
    for to in request.to:
        metric = Metric.of(gait, abs(to - value))
        begin = partial(started, gait, request.parameter, metric, float(np.sign(to - value)))
        walks.append(Walk(gait=gait, metric=metric, limits=_limits(gait, request, (to,)), begin=begin))
    return walks


def _given(beginning: Beginning) -> Beginning:
    return beginning


def _limits(gait: Gait, request: Request, targets: Sequence[float]) -> Limits:
    """Bounds at the targets, and as far on the other side unless the request has bounds of its own."""
    value = gait.dynamics.parameter(request.parameter)
    least, largest = coefficient_bounds(gait, request.parameter)
    span = max(abs(to - value) for to in targets)
    lower = value - span if request.lower is None else request.lower
    upper = value + span if request.upper is None else request.upper
    below, above = ([to for to in targets if side * (to - value) > 0] for side in (-1, 1))
    return Limits(
        request=request,
        lower=max(min(below, default=lower), least),
        upper=min(max(above, default=upper), largest),
    )
