"""Continuation of a family of gaits in a parameter, through folds and changes of the mode sequence.

Every step predicts the next gait along the curve, corrects it by Newton's method, and compares monitors and test
functions at both ends. If one of them changes sign, its zero is located and becomes a special point. If a mode sequence
ends, the continuation proceeds with the next one that the physics allows. If Newton's method fails for every step
length, even on a finer mesh, IPOPT and then the simulator search for a gait a little further on.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count

import numpy as np

from gaitopt.branches.change import (
    NEARBY,
    exchanged_half,
    find_change,
    located_on_successor,
    named_contact,
    simulated_gait,
    transition_at,
    vanishing_force,
)
from gaitopt.branches.curve import CurvePoint, Location, Metric, curve_through, first_point
from gaitopt.branches.monitors import bifurcations_between, is_bifurcation, stride
from gaitopt.branches.normal_forms import gait_coefficients, stability_loss
from gaitopt.branches.request import FOLLOWS, Request
from gaitopt.branches.steps import FIRST_LENGTH, HALVED, SILENT, VANISHED_STRIDE, VANISHING, Steps
from gaitopt.branches.switching import beginnings
from gaitopt.callbacks import Stop
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.branch import TERMINAL, BranchPoint, SpecialPoint
from gaitopt.gait.gait import Gait
from gaitopt.gait.trace import MonitorKey
from gaitopt.solver.rollout import retraced
from gaitopt.solver.solve import solve_gait
from gaitopt.store.branch import StoredContinuation, StoredPoint
from gaitopt.verification.verify import confirm

TANGENT_DISTANCE = 1e-3
"""Arclength from a branch point at which tangents are taken: large compared with rounding errors, and so small that
curvature is negligible."""
RESCUE_DISTANCES = (1e-4, 1e-3, 1e-2)
"""Distances from the last point at which IPOPT and the simulator are tried, relative to the span of the parameter."""
FADING_STRIDE = 1e-2
"""A gait with a shorter stride that the simulator does not confirm may be about to vanish."""
SENSITIVE_RADIUS = 1e4
"""If the spectral radius exceeds this, the reason of an end states it."""


def follow_family(
    start: Gait | SpecialPoint,
    request: Request,
    *,
    done: Sequence[StoredContinuation] = (),
    should_stop: Stop = None,
) -> Iterator[BranchPoint | SpecialPoint]:
    """The points and special points of a family, one by one; see ``gaitopt.continuation``.

    A gait is continued towards each target. From a special point all its other branches are continued, with the targets
    as bounds; in another parameter than that of its branch, its gait is continued. Branches that begin on the way come
    after these.

    Parameters
    ----------
    done : the stored continuations of an unfinished family.

    Raises
    ------
    UnknownNameError, ProblemError, SolveError
        See ``Request.first_gait`` and ``switching.beginnings``.
    """
    gait, start = request.first_gait(start), request.begin(start)
    value = gait.dynamics.parameter(request.parameter)
    numbers = count(1 + max((stored.largest for stored in done), default=-1))
    new = partial(Continuation, gait=gait, numbers=numbers, should_stop=should_stop)
    continuations = list[Continuation]()
    if isinstance(start, SpecialPoint):
        metric = Metric.of(gait, max(abs(to - value) for to in request.to))
        bounded = request.towards(request.to, gait)
        for point in beginnings(replace(start, gait=gait), request.parameter, metric):
            continuations.append(new(request=bounded, metric=metric, begin=point))
    else:
        for to in request.to:
            metric = Metric.of(gait, abs(to - value))
            begin = partial(first_point, gait, request.parameter, metric, float(np.sign(to - value)))
            continuations.append(new(request=request.towards((to,), gait), metric=metric, begin=begin))
    known = {stored.number: stored for stored in done}
    unnumbered = (stored.number for stored in done if not stored.is_named)
    for continuation in continuations:  # the list grows during the loop
        number = next(unnumbered, -1) if continuation.number is None else continuation.number
        if number in known:
            continuations += continuation.resume(known[number])
            if known[number].is_complete:
                continue
        for record in continuation:
            if isinstance(record, SpecialPoint):
                record, branches = continuation.other_branches(record)
                continuations += branches
            yield record
        if should_stop is not None and should_stop():
            return


@dataclass(kw_only=True, eq=False)
class Continuation(Steps[BranchPoint, SpecialPoint]):
    """One continuation along a family, see ``Steps``.

    Attributes
    ----------
    gait : the gait from which the family began; its parameters are those of the family.
    begin : the first point, or a function that finds it.
    number : number of the first branch, if it is known already.
    last : the stored point from which the continuation resumes; None if it starts afresh.
    branch : number of the current branch.
    """

    gait: Gait
    begin: CurvePoint | Callable[[], CurvePoint]
    number: int | None = None
    last: StoredPoint | None = field(init=False, default=None)
    branch: int = field(init=False)

    def resume(self, stored: StoredContinuation) -> list["Continuation"]:
        """Resume after the stored points of this continuation, as if it had not been interrupted.

        Returns
        -------
        branches : the continuations of the other branches that begin at its special points.
        """
        self.last, self.count = stored.last, stored.count
        if stored.metric is not None:
            self.metric = Metric.from_array(stored.metric)
        branches = list[Continuation]()
        for special in stored.specials:
            kind = FOLLOWS[special.type]
            numbers = special.next if special.after is None else special.next[1:]  # the first is this continuation
            branches += [
                self._branch(kind, number, partial(self._beginning, special, index))
                for index, number in enumerate(numbers)
            ]
        return branches

    def _begin(self) -> Iterator[BranchPoint | SpecialPoint]:
        if self.last is not None:
            self._resume(self.last)
            self.branch = self.last.branch
            return iter(())
        self.point = self.begin if isinstance(self.begin, CurvePoint) else self.begin()
        self.branch = next(self.numbers) if self.number is None else self.number
        return self._point_records()

    def _is_end(self, record: BranchPoint | SpecialPoint) -> bool:
        return isinstance(record, SpecialPoint) and record.type in TERMINAL

    def _end(self, seconds: float) -> SpecialPoint | None:
        at_bound = self.request.bound_reached(self.point.value) if self.count > 1 else None
        reason = at_bound or self.request.exhausted(self.count, seconds)
        if reason is None:
            return None
        end = self._special("end", self.point, reason=reason)
        return replace(end, bound=at_bound is not None, open=at_bound is None)

    def other_branches(self, special: SpecialPoint) -> tuple[SpecialPoint, list["Continuation"]]:
        """A special point with the numbers of the other branches to follow from it, and their continuations."""
        kind = FOLLOWS.get(special.type, "")
        if not self.request.follow.get(kind, 0):
            return special, []
        try:
            points = self._beginnings(special)
        except (ProblemError, SolveError) as error:
            expected = not special.next  # at a change of modes there is usually no branch besides the one that follows
            return (replace(special, reason=str(error)) if expected else special), []
        numbers = tuple(next(self.numbers) for _ in points)
        branches = [self._branch(kind, number, point) for number, point in zip(numbers, points, strict=True)]
        return replace(special, next=special.next + numbers), branches

    def _beginning(self, special: SpecialPoint, index: int) -> CurvePoint:
        return self._beginnings(special)[index]

    def _beginnings(self, special: SpecialPoint) -> list[CurvePoint]:
        """The first gaits of the other branches through a special point that lie within the bounds.

        The mesh of its gait is not used, because it is not stored: a resumed continuation has to find the same gaits.
        """
        parameter, (lower, upper) = self.request.parameter, self.request.bounds
        gait = None if special.gait is None else replace(special.gait, shooting=None)
        points = beginnings(replace(special, gait=gait), parameter, self.metric)
        return [point for point in points if lower < point.value < upper]

    def _branch(self, kind: str, number: int, begin: CurvePoint | Callable[[], CurvePoint]) -> "Continuation":
        follow = {**self.request.follow, kind: self.request.follow[kind] - 1}
        return replace(self, request=replace(self.request, follow=follow), begin=begin, number=number)

    def _rescued(self) -> bool:
        found = _found_otherwise(self.point)
        if found is not None:
            self.point, self.index, self.length = found, self.index + 1, FIRST_LENGTH
        return found is not None

    def _stuck(self) -> SpecialPoint:
        radius = self.point.gait.spectral_radius or 0.0
        reason = "neither Newton's method, also on a finer mesh, nor IPOPT nor the simulator finds the next gait"
        if radius > SENSITIVE_RADIUS:
            reason += f"; a cycle magnifies disturbances, also of rounding, by {radius:.1e}"
        return self._special("end", self.point, "guess", reason)

    def _at_bound(self, here: CurvePoint, point: CurvePoint, length: float) -> tuple[CurvePoint, float] | None:
        bound = self.request.crossed(here.value, point.value)
        at_bound = None if bound is None else here.at_parameter(bound)
        return None if bound is None else (at_bound or point, length)

    def _lost(self, before: CurvePoint, after: CurvePoint) -> list[MonitorKey]:
        """Monitors that vanish on a step, or vanished just before it, where rounding, or another mesh, hid that."""
        hidden = (key for key, monitor in before.monitors.items() if monitor.value <= 0)
        fallen = [k for k in hidden if k in after.monitors and after.monitor(k) < min(before.monitor(k), -SILENT)]
        return [*after.lost(before), *fallen]

    def _between(self, here: CurvePoint, point: CurvePoint, length: float) -> Iterator[SpecialPoint]:
        """Folds, bifurcations and the caller's events between two points, in order."""
        events = self.request.events
        zeros = [
            (here.locate(point, length, partial(CurvePoint.test, name=test)), kind, test)
            for kind, test in bifurcations_between(here.tests, point.tests).items()
        ]
        zeros += [
            (here.locate(point, length, partial(CurvePoint.evaluate, function=function)), name, "")
            for name, function in events.items()
            if function(here.gait) * function(point.gait) < 0
        ]
        for location, kind, test in sorted(zeros, key=lambda zero: zero[0].length):
            gait = location.point.gait
            if kind not in events and not (is_bifurcation(kind, gait.multipliers) and stride(gait) > VANISHED_STRIDE):
                continue
            special = self._special(kind, location.point, location.status)
            form = gait_coefficients(kind, gait)
            loss = stability_loss(form, gait.multipliers)
            special = replace(special, gait=gait.verified(confirm(gait).to_record()), coefficients=form, reason=loss)
            if kind == "branch_point":  # the tangent is undetermined there; take the mean of both sides
                sides = [here.step(location.length + side * TANGENT_DISTANCE) for side in (-1, 1)]
                tangents = [side.curve.solutions.entries(side.tangent) for side in sides if side is not None]
                special = replace(special, tangent=np.mean(tangents, axis=0) if len(tangents) == 2 else None)
            half = exchanged_half(here.gait, point.gait) if kind == "branch_point" and test == "slope" else None
            if half is not None:  # a doubled family turns back at its origin, where its halves change roles
                special = replace(special, type="end", reason=HALVED, before=gait.cycle, after=half)
            yield special

    def _change(self, event: Location, key: MonitorKey) -> Iterator[BranchPoint | SpecialPoint]:
        """The end of a mode sequence: a special point, and the first point of the next branch if there is one."""
        if stride(event.point.gait) < VANISHED_STRIDE:
            yield self._special("vanishing", event.point, event.status, VANISHING)
            return
        key = vanishing_force(event.point, key)
        transition = transition_at(event.point.gait.system.transitions, event.point.curve.cycle, key)
        contact = named_contact(event.point.curve.cycle, key, event.point.gait.system.walker)
        ending = None if transition is None else transition.ending
        if transition is not None and (ending or transition.ends_step):
            kind = ending if ending in TERMINAL else "end"
            special = self._special(kind, event.point, event.status, transition.margin.lost)
            yield replace(special, contact=contact)
            return
        successor, reason, length = find_change(event, key)
        if successor is None:
            yield replace(self._special("end", event.point, event.status, reason), contact=contact)
            return
        number = next(self.numbers)
        before, after = event.point.curve.cycle, successor.curve.cycle
        same = before.impacts == after.impacts and before.landed == after.landed
        kind = "mode_change" if same else "impact_change"
        located = located_on_successor(event, successor)
        there, status = (event.point, event.status) if located is None else (located[0], "converged")
        special = self._special(kind, there, status, reason)
        yield replace(special, before=before, after=after, next=(number,), contact=contact)
        bound = self.request.crossed(there.value, successor.value)
        at_bound = None if bound is None else successor.at_parameter(bound)
        if at_bound is not None and min(monitor.value for monitor in at_bound.monitors.values()) > 0:
            successor = at_bound  # the target is nearer than the distances at which a successor is tried
        self.point, self.branch, self.index = successor, number, 0
        self.length = min(FIRST_LENGTH, length)
        yield from self._point_records()

    def _move(self, point: CurvePoint, *, moved: bool = True) -> None:
        self.point = (point.remeshed() or point) if moved else point
        self.index += moved

    def _point_records(self) -> Iterator[BranchPoint | SpecialPoint]:
        """The current point, verified by the simulator if it is due; the end of the family if that refutes it."""
        gait, every = self.point.gait, self.request.verify_every
        if every and self.count % every == 0:
            check = confirm(gait)
            gait = gait.verified(check.to_record())
            if not check.passed and (finer := self.point.bisected()) is not None:
                self.point = finer
                check = confirm(finer.gait)
                gait = finer.gait.verified(check.to_record())
            if not check.passed and (simulated := simulated_gait(self.point, 0.0)) is not None:
                self.point = simulated  # rounding errors may have moved a sensitive gait
                check = confirm(simulated.gait)
                gait = simulated.gait.verified(check.to_record())
            if not check.passed and (vanishing := self._short_phase()) is not None:
                yield from self._change(*vanishing)
                return
            if not check.passed:
                worst = next(claim for claim in check.claims if not claim.passed)
                reason = f"the simulator disagrees: {worst.summary}"
                end = replace(self._special("end", self.point, "guess", reason), gait=gait)
                yield self._vanishing() or end
                return
        self.count += 1
        yield BranchPoint(
            branch=self.branch,
            index=self.index,
            value=self.point.value,
            gait=gait,
            tangent=self.point.direction,
            length=self.length,
            walk=self.point.state,
        )

    def _vanishing(self) -> SpecialPoint | None:
        """The point where the gait vanishes, if it does so just ahead, where steps are too short to simulate."""
        before = last = self.point
        while stride(last.gait) < FADING_STRIDE:
            step = self._step()
            if step is None:
                break
            _, point, event = step
            if event is not None:
                location, _ = event
                if stride(location.point.gait) >= VANISHED_STRIDE:
                    return None
                return self._special("vanishing", location.point, location.status, VANISHING)
            if self.request.crossed(self.point.value, point.value) is not None:
                return None
            before, last = last, point
            self._move(point)
        first, second = stride(before.gait), stride(last.gait)
        if second > VANISHED_STRIDE:
            return None
        value = last.value
        if second < first:  # extrapolate to a stride of zero
            value += (last.value - before.value) * second / (first - second)
        return replace(self._special("vanishing", last, "guess", VANISHING), value=value)

    def _special(self, kind: str, point: CurvePoint, status: str = "converged", reason: str = "") -> SpecialPoint:
        return SpecialPoint(
            branch=self.branch,
            type=kind,
            value=point.value,
            status=status,
            reason=reason,
            gait=point.gait,
            tangent=point.curve.solutions.entries(point.tangent),
            parameter=self.request.parameter,
        )


def _found_otherwise(point: CurvePoint) -> CurvePoint | None:
    """A gait with the same modes past a point at which Newton's method fails, if IPOPT or the simulator finds one."""
    curve, system = point.curve, point.gait.system
    ahead = float(np.sign(point.tangent[-1])) or 1.0
    for distance in RESCUE_DISTANCES:
        value = point.value + ahead * distance * curve.metric.span
        try:
            state = dict(zip(system.state_names, point.gait.state, strict=True))
            problem = curve.problem.with_modes(curve.cycle, state)
            gait = solve_gait(problem.replace({curve.parameter: value}), system)
        except ProblemError:  # the parameter is beyond the range that the problem allows
            return None
        if not gait.steps or curve.metric.distance(gait.state, point.gait.state) > NEARBY:
            continue
        further, w = curve_through(curve.problem, curve.parameter, curve.metric, retraced(gait))
        rescued = further.start(w, further.solutions.ahead(ahead))
        if rescued is not None and all(monitor.value > 0 for monitor in rescued.monitors.values()):
            return rescued
    simulated = (simulated_gait(point, ahead * distance * curve.metric.span) for distance in RESCUE_DISTANCES)
    return next((found for found in simulated if found is not None and found.curve.cycle == curve.cycle), None)
