"""The curve of a special point in two parameters: its points, its codimension-two points, its ends.

    F(w) = 0,      g(w) = 0,      w = (nodes, durations, both parameters)

g is the condition of the special point, see ``conditions``. Every step along the curve is predicted and corrected as
along a family of gaits. Monitors of the mode sequence and the test functions of ``codimension_two`` are compared at
both ends of a step; where one changes its sign, its zero is located.

Where a monitor vanishes the mode sequence ends. The curve goes on with the next sequence if the condition holds there
too: that of a margin does, that of a bifurcation only if the multipliers are continuous across the change.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count, zip_longest
from typing import Any, cast

import numpy as np

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.branches.change import (
    ACTIVE,
    DISTANCES,
    NEARBY,
    attempt,
    ends_at,
    find_change,
    halved_cycle,
    halves_apart,
    located_on_successor,
    predicted,
    size_of,
    successors,
)
from gaitopt.branches.codimension_two import (
    CURVES,
    DEGENERATE,
    curve_tests,
    is_zero,
    other_kappa,
    others_are_complex,
)
from gaitopt.branches.conditions import Condition, Eigenvalue, MarginZero, Pair
from gaitopt.branches.curve import CurvePoint, Location, Metric, curve_through, first_point
from gaitopt.branches.monitors import monitor_values, stride
from gaitopt.branches.normal_forms import KINDS, LocalMap, coefficients, critical_kappa
from gaitopt.branches.request import Request
from gaitopt.branches.steps import FIRST_LENGTH, HALVED, SILENT, VANISHED_STRIDE, VANISHING, Steps
from gaitopt.branches.switching import doubled_beginnings
from gaitopt.callbacks import Stop
from gaitopt.errors import ProblemError, SolveError, UnknownNameError
from gaitopt.gait.branch import SpecialPoint
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import CycleRecord
from gaitopt.gait.trace import CurveStart, MonitorKey, TracePoint, TraceSpecial
from gaitopt.model.cycle import Cycle
from gaitopt.model.transitions import Ending, margin
from gaitopt.problem.statement import cycle_data
from gaitopt.requests import TraceRequest
from gaitopt.solver import arclength
from gaitopt.solver.mesh import Mesh
from gaitopt.solver.newton import Solution
from gaitopt.solver.rollout import retraced, roll_out
from gaitopt.solver.shooting import transcribe
from gaitopt.store.branch import StoredTrace
from gaitopt.verification.verify import confirm

LARGEST_LENGTH = 0.05
"""Longest step along a curve, relative to the range of the second parameter: a curve has at least twenty points."""
MOST_SPANS = 10.0
"""Default distance of the bounds of the first parameter from its value at the special point, relative to this value."""
BESIDE = 1e-6
"""A codimension-two point within this arclength of the first point is the one at which the curve begins."""
CONSTANT = 1e-9
"""An unknown is constant along the curve if its entry of the unit tangent is below this number."""
STRAY = 10.0
"""Largest distance of the first point with another mode sequence from the point before it, in step lengths."""
DEGRADED = 1e-5
"""Smallest value of a monitor, such as the duration of a vanishing phase, at which rounding does not spoil the cubic
coefficient."""
FALLEN = 1e-6
"""A monitor that was closer to zero than this before a step, and is below minus this after it, vanished before it."""
AT_BOUND = 1e-9
"""A point is at a bound if its relative distance from it is below this number."""
HALVES_APART = (1e-3, 1e-2)
"""Arclengths from a period doubling at which the halves of a doubled gait differ enough for Newton's method."""
NEARLY_HALVED = 1e-4
"""Where the halves of a doubled gait differ by less than this in natural units, a multiplier is 1 down to rounding,
because it approaches 1 like the square of their difference."""
JUMP = 1e-2
"""Least change of the test functions of the multipliers across a margin that is a jump, absolute and relative."""
MARGINS = ("mode_change", "impact_change", str(Ending.LIFT_OFF), str(Ending.PAINLEVE))
"""Types of special points at which a margin vanishes."""


def curve_start(special: SpecialPoint) -> CurveStart:
    """The curve that goes through a special point of a family.

    Raises
    ------
    ProblemError
        If a special point of this type has no curve.
    SolveError
        If there is no gait.
    """
    gait = special.gait
    if gait is None:
        raise SolveError(f"there is no gait at the special point {special!r}")
    if special.type in KINDS:
        return CurveStart(type=special.type, parameter=special.parameter, gait=gait, kappa=critical_kappa(gait))
    if special.type == "branch_point":
        half = halved_cycle(gait)
        if half is not None:  # a period doubling of the shorter cycle, which keeps both halves equal
            return CurveStart(type="period_doubling", parameter=special.parameter, gait=_with_cycle(gait, half))
        raise ProblemError(
            "a branch point has no curve in two parameters: in a second one it falls apart into folds; continue the "
            "gait a little way in the second parameter, and trace the fold that takes its place"
        )
    at_margin = special.type == "end" and not (special.bound or special.open) and special.status == "converged"
    if special.type not in MARGINS and not at_margin:
        known = ", ".join((*KINDS, *MARGINS))
        raise ProblemError(f"a special point of type {special.type} has no curve; trace one of the types {known}")
    fewest = min((c for c in (gait.cycle, special.before, special.after) if c is not None), key=lambda c: len(c.phases))
    if len(fewest.phases) < len(gait.cycle.phases):  # a phase of no duration has half the digits
        gait = _with_cycle(gait, fewest)
    small = {key: abs(m.value) for key, m in monitor_values(gait).items() if abs(m.value) < ACTIVE}
    if not small:
        raise ProblemError("no margin of the mode sequence vanishes at this special point, so that it has no curve")
    smallest = min(small, key=lambda key: (key.kind == "duration", small[key]))
    return CurveStart(type="margin", parameter=special.parameter, gait=gait, margin=smallest)


def condition_along(start: CurveStart) -> Condition:
    """The condition that holds along a curve."""
    if start.margin is not None:
        return MarginZero(start.margin)
    critical = KINDS[start.type]
    return Pair(start.kappa) if critical is None else Eigenvalue(critical)


@overflow_allowed()
def doubled_margin(point: CurvePoint, key: MonitorKey) -> CurveStart | None:
    """The curve on which a margin vanishes in one half of the doubled gait, from a period doubling on this margin.

    Doubled gaits leave the period doublings along the critical eigenvector v. To first order the margin g of their
    first half stays zero in the direction v - (dg v / dg t) t, with t the direction of the period doublings.

    Returns
    -------
    start : None if Newton's method finds no such gait there.
    """
    curve, at, plane = point.curve, point.at, point.point.at.plane
    equations, margin_zero = at.equations, MarginZero(key)
    first, second = Eigenvalue(KINDS["period_doubling"] or -1.0).slopes(at, plane)
    along = second * plane[0] - first * plane[1]
    cycle, n = Cycle(curve.cycle.steps * 2), equations.n_phases
    arcs = [replace(arc, phase=arc.phase + k * n) for k in (0, 1) for arc in equations.mesh.arcs]
    problem = point.problem.with_modes(cycle, point.problem.guess.state)  # rounding decides the sign of a slip of zero
    twice = transcribe(equations.system, Mesh(cycle=cycle, arcs=tuple(arcs)), equations.free)
    doubled = replace(curve, problem=problem, equations=twice, condition=margin_zero)

    def lifted(w: Array) -> Array:
        nodes, durations, freed = equations.unpack(w)
        return twice.pack(np.hstack([nodes, nodes]), np.tile(durations, 2), freed)

    origin = Solution(twice, lifted(at.w), at.p)
    vector = np.random.default_rng(0).standard_normal(origin.residual.size) * origin.units.unknowns[:-2]
    try:
        for _ in range(2):  # inverse iteration
            vector = origin.scaled.solve(origin.scaled.solve_transposed(vector))
            vector /= np.linalg.norm(vector)
    except RuntimeError:  # singular to the last bit
        return None
    apart = np.append(vector, [0.0, 0.0])
    apart /= np.linalg.norm(doubled.solutions.coordinates(apart))
    (by_apart,), (by_along,) = margin_zero.slopes(origin, apart[None]), margin_zero.slopes(at, along[None])
    for distance in (sign * size for size in HALVES_APART for sign in (1.0, -1.0)):
        shift = -distance * by_apart / by_along
        predicted = lifted(at.w + shift * along) + distance * apart
        normal = doubled.solutions.coordinates(predicted - origin.w)
        try:
            found = doubled.with_gait(doubled.solutions.across(predicted, normal / np.linalg.norm(normal)))
        except ProblemError:  # out of range
            continue
        if found is None or halved_cycle(found.gait) is not None:
            continue
        if all(m.value > -SILENT for k, m in found.monitors.items() if k != key):
            return CurveStart(type="margin", parameter=equations.free[0], gait=found.gait, margin=key)
    return None


@overflow_allowed()
def doubled_fold(point: CurvePoint) -> CurveStart | None:
    """The curve of folds of doubled gaits that begins at a generalised flip; None if Newton's method finds no gait.

    With x -> -(1 + a) x + c x^3 + e x^5 the doubled gaits are a = c x^2 + e x^4. They fold where c = -2 e x^2, on a
    curve that is tangent to that of the period doublings, a = 0. A doubled gait is found first, with one parameter;
    then it is moved to the fold, with the same difference x between its halves.
    """
    curve, (first, second) = point.curve, point.at.equations.free
    for distance in HALVES_APART[::-1]:
        try:
            for doubled in doubled_beginnings(point.gait, first, curve.metric.in_first, (distance,)):
                motion = retraced(doubled.gait)
                folds, w = curve_through(
                    doubled.problem, second, curve.metric, motion, others=(first,), condition=Eigenvalue(1.0)
                )
                apart = np.zeros(w.size)
                apart[: point.gait.state.size] = doubled.gait.state - point.gait.state
                normal = folds.solutions.coordinates(apart)
                found = folds.with_gait(folds.solutions.across(w, normal / np.linalg.norm(normal)))
                if found is None or halved_cycle(found.gait) is not None:
                    continue
                if all(monitor.value > 0 for monitor in found.monitors.values()):
                    return CurveStart(type="fold", parameter=first, gait=found.gait)
        except (ProblemError, SolveError, RuntimeError):  # out of range, or singular
            continue
    return None


def _with_cycle(gait: Gait, cycle: Cycle) -> Gait:
    """The same gait without its phases of no duration, or without its second half.

    Raises
    ------
    SolveError
        If Newton's method fails.
    """
    states = np.array([step.arcs[0].states[0] for step in gait.steps[: len(cycle.steps)]])
    for step, (before, after) in enumerate(zip(gait.cycle.steps, cycle.steps, strict=False)):
        if before.phases[0] != after.phases[0] and after.phases[0].fixes_x:
            states[step, -1] = 0.0
    problem = gait.problem.with_modes(cycle, dict(zip(gait.system.state_names, states[0], strict=True)))
    key = next(iter(gait.system.parameters))
    curve, w = curve_through(problem, key, Metric.of(gait, 1.0), roll_out(gait.dynamics, cycle, states))
    point = curve.start(w, curve.solutions.ahead(1.0))
    if point is None:
        raise SolveError(f"{gait.problem.name}: Newton's method fails at the gait with the phases {cycle}")
    return point.gait


def follow_curve(
    start: CurveStart | SpecialPoint,
    request: TraceRequest,
    *,
    done: Sequence[StoredTrace] = (),
    should_stop: Stop = None,
) -> Iterator[TracePoint | TraceSpecial]:
    """The points and special points of a curve, one by one, towards each target in turn; see ``gaitopt.trace``.

    Parameters
    ----------
    start : the special point from which the curve begins, or the start that another curve offers as ``next``.
    done : the stored walk to each target, if an unfinished trace is resumed.

    Raises
    ------
    UnknownNameError, ProblemError, SolveError
        If there is no such curve, parameter or target.
    """
    origin, first, towards = traced_start(start, request), start.parameter, in_second(request)
    gait = origin.gait
    second, other = (gait.dynamics.parameter(key) for key in (request.key, first))
    far = MOST_SPANS * (abs(other) or 1.0)
    lower = other - far if request.lower is None else request.lower
    upper = other + far if request.upper is None else request.upper
    span = abs(other) or 1.0 if None in (request.lower, request.upper) else upper - lower
    numbers = count(1 + max((stored.largest for stored in done), default=-1))
    for to, stored in zip_longest(request.to, done):
        if stored is not None and stored.is_complete:
            continue
        yield from CurveWalk(
            start=origin,
            request=towards.towards((to,), gait),
            first=first,
            bounds=(lower, upper),
            metric=Metric.of(origin.gait, abs(to - second), (span,)),
            sign=float(np.sign(to - second)),
            numbers=numbers,
            stored=stored,
            should_stop=should_stop,
        )
        if should_stop is not None and should_stop():
            return


def traced_start(start: CurveStart | SpecialPoint, request: TraceRequest) -> CurveStart:
    """The start of a trace, whose gait has the friction law with both parameters.

    Raises
    ------
    UnknownNameError, ProblemError, SolveError
        If there is no such curve or parameter, or if it begins outside the bounds of the first parameter.
    """
    begin = curve_start(start) if isinstance(start, SpecialPoint) else start
    gait, first = in_second(request).first_gait(begin.gait), begin.parameter
    if first == request.key:
        raise UnknownNameError(f"{first} is the parameter of the branch: choose another second one").concerning("key")
    if first not in gait.system.parameters:
        raise UnknownNameError(
            f"the friction law of {request.key} lacks {first}, the parameter of the branch"
        ).concerning("key")
    value = gait.dynamics.parameter(first)
    for name, limit, sign in (("lower", request.lower, -1.0), ("upper", request.upper, 1.0)):
        if limit is not None and _beyond(value, limit, sign) > 1:
            rule = f"must be {'at most' if sign < 0 else 'at least'} {first} = {value:.10g}, where the curve begins"
            raise ProblemError(f"{limit:g}: {rule}").concerning(name)
    return replace(begin, gait=gait)


def in_second(request: TraceRequest) -> Request:
    """The targets and limits of a trace as those of a continuation in its second parameter."""
    return Request(
        parameter=request.key,
        to=request.to,
        max_points=request.max_points,
        max_seconds=request.max_seconds,
        verify_every=request.verify_every,
        largest_length=LARGEST_LENGTH,
    )


@dataclass(kw_only=True, eq=False)
class CurveWalk(Steps[TracePoint, TraceSpecial]):
    """One walk along a curve, see ``Steps``; its request has one target, and both bounds of the second parameter.

    Attributes
    ----------
    start : the gait and the condition from which the curve begins.
    first, bounds : the parameter of the branch, and its bounds.
    sign : sign of the first step in the second parameter.
    stored : the stored walk if it was interrupted; None for a new walk.
    number : number of the current curve.
    """

    start: CurveStart
    first: str
    bounds: tuple[float, float]
    sign: float
    stored: StoredTrace | None = None
    number: int = field(init=False)
    _last: tuple[Solution | None, dict[str, float]] = field(init=False, default=(None, {}))
    _decided: tuple[Cycle | None] | None = field(init=False, default=None)

    def _begin(self) -> Iterator[TracePoint | TraceSpecial]:
        """The records of the first point, which is on the curve exactly.

        Raises
        ------
        SolveError
            If Newton's method fails there.
        ProblemError
            If the curve does not depend on the second parameter.
        """
        gait = self.start.gait
        if self.stored is not None and self.stored.last is not None:
            last, condition = self.stored.last, self.stored.condition
            along = CurveStart.from_record(condition, self.first, gait)
            self.metric = Metric.from_array(self.stored.metric, others=1)
            self.number, self.count = last.branch, self.stored.count
            self._resume(last, condition_along(along))
            if "beyond" in condition:
                cycle = condition["beyond"]
                self._decided = (None if cycle is None else Cycle.from_record(cycle),)
            return iter(())
        intervals = () if gait.shooting is None else gait.shooting.intervals
        curve, w = curve_through(
            gait.problem, self.request.parameter, self.metric, retraced(gait), intervals,
            others=(self.first,), condition=condition_along(self.start),
        )  # fmt: skip
        try:
            point = curve.start(w, curve.solutions.ahead(self.sign))
        except ProblemError:  # Newton's method has left the range that the problem allows
            point = None
        name = "margin" if self.start.margin is not None else self.start.type
        if point is None:
            raise SolveError(f"{gait.problem.name}: the {name} cannot be traced: Newton's method fails at its gait")
        if abs(point.direction[-2]) < CONSTANT:
            raise ProblemError(
                f"the {name} lies at {self.first} = {point.values[self.first]:.10g} whatever {self.request.parameter} "
                "is; choose another second parameter"
            ).concerning("key")
        self.number = next(self.numbers)
        self._move(point, moved=False)
        return self._point_records()

    def _is_end(self, record: TracePoint | TraceSpecial) -> bool:
        return isinstance(record, TraceSpecial) and record.type == "end"

    def _end(self, seconds: float) -> TraceSpecial | None:
        if halved_cycle(self.point.gait) is not None and halved_cycle(self.start.gait) is None:
            return self._special("end", self.point, reason=HALVED)
        if stride(self.point.gait) < VANISHED_STRIDE:
            return self._special("end", self.point, reason=VANISHING)
        at_bound = self._bound_reached() if self.index else None
        reason = at_bound or self.request.exhausted(self.count, seconds)
        if reason is None:
            return None
        end = self._special("end", self.point, reason=reason)
        return replace(end, bound=at_bound is not None, open=at_bound is None)

    @property
    def own(self) -> MonitorKey | None:
        """The monitor that vanishes along the curve, if it is that of a margin."""
        return self._condition.key if isinstance(self._condition, MarginZero) else None

    @property
    def kind(self) -> str:
        """The type of the points of the curve: a bifurcation, or ``margin``."""
        return self._condition.kind

    @property
    def _condition(self) -> Condition:
        condition = self.point.curve.condition
        assert condition is not None
        return condition

    def _stuck(self) -> TraceSpecial:
        reason = "Newton's method finds no next gait, also on a finer mesh"
        return replace(self._special("end", self.point, "guess", reason), codimension=1)

    def _lost(self, before: CurvePoint, after: CurvePoint) -> list[MonitorKey]:
        """Monitors that vanish on a step; not those that are zero along the whole curve."""
        near = {key: abs(m.value) for key, m in before.monitors.items() if abs(m.value) < FALLEN and key != self.own}
        lost = [key for key in after.lost(before) if near.get(key, FALLEN) >= SILENT and key != self.own]
        fallen = (key for key in near if key in after.monitors and after.monitor(key) < -FALLEN)
        return [*lost, *(key for key in fallen if key not in lost)]

    def _limits(self) -> Iterator[tuple[str, float, float]]:
        """Key and value of every bound, and the sign of a value's excess over it."""
        for key, limits in ((self.first, self.bounds), (self.request.parameter, self.request.bounds)):
            yield from ((key, limit, sign) for limit, sign in zip(limits, (-1.0, 1.0), strict=True))

    def _at_bound(self, here: CurvePoint, point: CurvePoint, length: float) -> tuple[CurvePoint, float] | None:
        crossings = list[Location]()
        for key, limit, sign in self._limits():
            before, after = (sign * (at.values[key] - limit) for at in (here, point))
            if before < 0 <= after:
                crossings.append(here.locate(point, length, partial(_excess, key=key, limit=limit)))
        nearest = min(crossings, key=lambda location: location.length, default=None)
        return None if nearest is None else (nearest.point, nearest.length)

    def _bound_reached(self) -> str | None:
        """Why the curve ends at the present point; None if that is within all bounds."""
        for key, limit, sign in self._limits():
            if _beyond(self.point.values[key], limit, sign) > -1:
                return f"reached {key} = {limit:.12g}"
        return None

    def _between(self, here: CurvePoint, point: CurvePoint, length: float) -> Iterator[TraceSpecial]:
        """Zeros of the test functions between two points, in order; a curve of pairs ends at kappa = 1 and -1.

        Where the multipliers jump at a margin, the gaits on its other side have test functions of their own.
        """
        tests = list[tuple[str, bool, Callable[[CurvePoint], float], float, float]]()
        for name in (*here.curve_tests, *filter(None, [DEGENERATE.get(self.kind)])):
            own = partial(CurvePoint.curve_test, name=name, reference=here)
            tests.append((name, False, own, own(here), own(point)))
        beyond = self._tests_beyond(here), self._tests_beyond(point)
        for name in beyond[0] if beyond[1] else ():
            tests.append((name, True, partial(self._test_beyond, name=name), beyond[0][name], beyond[1][name]))
        zeros = [(here.locate(point, length, test[2]), *test) for test in tests if test[3] * test[4] < 0]
        for location, name, is_beyond, test, *values in sorted(zeros, key=lambda zero: (zero[0].length, zero[1])):
            at, kappa = location.point, self._condition.kappa
            found = self._beyond(at) if is_beyond else at
            if found is None or not is_zero(test(at), *values):
                continue
            if not self.index and location.length < BESIDE:  # the point that it begins at
                continue
            if name == DEGENERATE.get(self.kind):
                near = at.monitors.items()
                others = (m.value for k, m in near if k.kind == "duration" or abs(here.monitor(k)) > SILENT)
                if min(others, default=1.0) < DEGRADED:
                    continue
            if name.endswith("_neimark_sacker") and not others_are_complex(found.local, self.kind, kappa):
                continue
            if name == "margin_fold" and halves_apart(at.gait) < NEARLY_HALVED:
                yield self._special("end", at, reason=HALVED)
                return
            gait, special = found.gait, self._special(name, at, location.status)
            if is_beyond:
                gait = replace(gait, freed={key: gait.dynamics.parameter(key) for key in at.values})
                before, after = at.curve.cycle, found.curve.cycle
                special = replace(special, reason=f"of the gait {after}", before=before, after=after)
            following = self._beginning(name, gait, found.local, kappa)
            if name == "margin_period_doubling" and self.own is not None and not is_beyond:
                doubled = doubled_margin(at, self.own)
                following += () if doubled is None else (doubled,)
            if name == "generalised_flip":
                folds = doubled_fold(at)
                following += () if folds is None else (folds,)
            yield replace(special, next=following)
            if self.kind == "neimark_sacker" and name in ("resonance_1_1", "resonance_1_2"):
                reason = "the two multipliers meet and become real: beyond lie neutral saddles"
                yield replace(self._special("end", at, reason=reason), codimension=2)
                return

    def _beginning(self, name: str, gait: Gait, local: LocalMap, kappa: float) -> tuple[CurveStart, ...]:
        """The other curves through a codimension-two point."""
        if name.startswith("margin_"):
            meeting = [name.removeprefix("margin_")]
        else:
            meeting = [*CURVES.get(name, ())]
            if self.kind in meeting:
                meeting.remove(self.kind)
        return tuple(
            CurveStart(type=kind, parameter=self.first, gait=gait, kappa=other_kappa(local, self.kind, kappa))
            for kind in meeting
        )

    def _change(self, event: Location, key: MonitorKey) -> Iterator[TracePoint | TraceSpecial]:
        """Another margin vanishes: a special point, and the first point with the next mode sequence, or the end."""
        point, cycle, status = event.point, event.point.curve.cycle, event.status
        lost = margin(key.kind).lost if key.kind != "duration" else "vanishes"
        lost = lost if key.phase is None else f"{cycle.phase_words(key.phase)}: {lost}"
        successor, reason = (None, "") if ends_at(point, key) else self._successor(point, key)
        located = None if successor is None else located_on_successor(event, successor)
        if located is not None:
            (point, key), status = located, "converged"
        other = CurveStart(type="margin", parameter=self.first, gait=point.gait, margin=key)
        doubled = doubled_margin(point, key) if self.kind == "period_doubling" else None
        following = (other,) if doubled is None else (other, doubled)
        name = "margin_crossing" if self.kind == "margin" else f"margin_{self.kind}"
        special = replace(self._special(name, point, status, lost), next=following, before=cycle)
        if successor is None:
            yield special
            yield replace(self._special("end", point, status, f"{lost}; {reason}" if reason else lost), codimension=2)
            return
        yield replace(special, after=successor.curve.cycle)
        self.number, self.index, self._decided = next(self.numbers), 0, None
        self.length = min(FIRST_LENGTH, self.length)
        self._move(successor, moved=False)
        yield from self._point_records()

    def _successor(self, point: CurvePoint, key: MonitorKey) -> tuple[CurvePoint | None, str]:
        """The first point of the curve past a change of the mode sequence; or why there is none."""
        active = [(k, m) for k, m in point.monitors.items() if k == key or (abs(m.value) < ACTIVE and k != self.own)]
        table, spectra = point.gait.system.transitions, list[str]()
        for cycle in successors(table, point.curve.cycle, active):
            for distance in DISTANCES:
                following = self._attempt(point, cycle, distance)
                if following is not None:
                    return following, ""
            plain = self._attempt(point, cycle, DISTANCES[0], conditioned=False)
            if plain is not None:
                spectra.append(f"{_spectrum(point.gait)} before, {_spectrum(plain.gait)} after")
        if spectra:
            return None, f"the multipliers jump there: {spectra[0]}"
        return None, "no other mode sequence continues the curve"

    @overflow_allowed()
    def _attempt(
        self, point: CurvePoint, cycle: Cycle, distance: float, *, conditioned: bool = True
    ) -> CurvePoint | None:
        """The point with other modes at a distance past an event; None if it does not hold, or is not near.

        Parameters
        ----------
        conditioned : whether the condition holds there; else the parameters are those predicted along the old curve.
        """
        curve, w = point.curve, point.at.w + point.tangent * distance
        values = dict(zip(curve.equations.free, w[-2:].tolist(), strict=True))
        try:
            guess = predicted(point, point.problem.replace(values), cycle, values, w)
            if guess is None:
                return None
            problem, rolled, _ = guess
            plain, w = curve_through(problem, curve.parameter, replace(curve.metric, others=()), rolled)
            first = plain.start(w, plain.solutions.ahead(1.0))
            if not conditioned or first is None:
                return first if first is not None and self._is_near(point, first, distance) else None
            condition = self._condition_on(first)
            if condition is None:
                return None
            following, w = curve_through(
                problem, curve.parameter, curve.metric, retraced(first.gait), others=(self.first,), condition=condition
            )
            forward = np.zeros(w.size)  # in the parameters alone: the state may begin like a square root
            forward[-2:] = point.tangent[-2:]
            normal = following.solutions.coordinates(forward)
            found = following.with_gait(following.solutions.across(w, normal / np.linalg.norm(normal)))
            found = None if found is None else found.remeshed()
            near = found is not None and found.is_regular and self._is_near(point, found, distance)
        except (ProblemError, RuntimeError):  # out of range; or singular, as nothing ends a slip of no length
            return None
        return found if near and found is not None and self._holds(found) else None

    def _condition_on(self, first: CurvePoint) -> Condition | None:
        """The condition of the curve on another mode sequence; None if that has none."""
        if self.own is None:
            return self._condition
        alike = {key: abs(m.value) for key, m in first.monitors.items() if key.kind == self.own.kind}
        same = {key: value for key, value in alike.items() if (key.phase is None) == (self.own.phase is None)}
        return MarginZero(min(same, key=lambda key: same[key])) if same else None

    def _is_near(self, point: CurvePoint, found: CurvePoint, distance: float) -> bool:
        """Whether a point past an event is as near to it as the distance demands."""
        changes = [
            abs(found.values.get(key, value) - value) / span
            for (key, value), span in zip(point.values.items(), (*self.metric.others, self.metric.span), strict=True)
        ]
        near = max(changes) < STRAY * distance
        return near and self.metric.distance(found.gait.state, point.gait.state) < max(STRAY * distance, NEARBY / 10)

    def _holds(self, found: CurvePoint) -> bool:
        """Whether all monitors are positive, but for those that vanish along the curve, and the simulator agrees."""
        condition = found.curve.condition
        own = condition.key if isinstance(condition, MarginZero) else None
        others = [m.value for key, m in found.monitors.items() if key != own and abs(m.value) > SILENT]
        return min(others, default=1.0) > 0 and self._simulated(found.gait)[0]

    def _simulated(self, gait: Gait) -> tuple[bool, Any]:
        """Whether the simulator walks the gait, and the record of that.

        On a margin it may walk another sequence, or none: a contact that lands in a phase of no duration has no gap to
        close. If it walks a gait of the same sequence close beside the margin, the gait holds, but its modes are not
        verified: there is no record.
        """
        check = confirm(gait)
        if check.passed or self.own is None:
            return check.passed, check.to_record()
        try:
            origin = self._in_first(gait)
            steps = (origin.step(sign * size) for size in DISTANCES for sign in (1.0, -1.0))
            holds = any(at is not None and at.monitor(self.own) > 0 and confirm(at.gait).passed for at in steps)
        except (ProblemError, SolveError, RuntimeError):  # out of range, or singular
            holds = False
        return holds, None if holds else check.to_record()

    def _in_first(self, gait: Gait) -> CurvePoint:
        """A gait on the family in the first parameter, which crosses a margin."""
        return first_point(replace(gait, shooting=None), self.first, self.metric.in_first, 1.0)

    def _sequence_beyond(self, point: CurvePoint, own: MonitorKey) -> Cycle | None:
        """The mode sequence on the other side of the margin, if the multipliers jump there.

        It is decided once along a curve, and recorded, so that a resumed trace does not decide at another point.
        """
        if self._decided is None:
            event = arclength.Location(length=0.0, point=self._in_first(point.gait), status="converged")
            successor = None if ends_at(point, own) else find_change(event, own)[0]
            sides = [[*curve_tests(at.local, "margin").values()] for at in (point, successor or point)]
            jumps = not np.allclose(sides[0], sides[1], rtol=JUMP, atol=JUMP)
            self._decided = (successor.curve.cycle if jumps and successor is not None else None,)
        return self._decided[0]

    def _beyond(self, point: CurvePoint, distance: float = DISTANCES[0]) -> CurvePoint | None:
        """The gait on the other side of a margin at which the multipliers jump, close to it; None if there is none."""
        try:
            cycle = None if self.own is None else self._sequence_beyond(point, self.own)
            if cycle is None:
                return None
            origin = self._in_first(point.gait)
            attempts = (attempt(origin, cycle, sign * distance * size_of(origin)) for sign in (1.0, -1.0))
            return next((found for found in attempts if found is not None), None)
        except (ProblemError, SolveError, RuntimeError):  # out of range, or singular
            return None

    def _tests_beyond(self, point: CurvePoint) -> dict[str, float]:
        """All test functions of the gait close to the margin; those of the end of the last step are known."""
        if self._last[0] is not point.at:
            beyond = self._beyond(point)
            self._last = point.at, {} if beyond is None else curve_tests(beyond.local, "margin")
        return self._last[1]

    def _test_beyond(self, point: CurvePoint, name: str) -> float:
        """A test function of the gaits on the other side, extrapolated to the margin; 0 if there are none."""
        pair = [self._beyond(point, distance) for distance in (DISTANCES[0], 2 * DISTANCES[0])]
        near, far = (0.0 if at is None else curve_tests(at.local, "margin")[name] for at in pair)
        return 2 * near - far

    def _move(self, point: CurvePoint, *, moved: bool = True) -> None:
        """Go to a point, on a mesh that is fine enough, with the condition as it is followed from there."""
        point = (point.remeshed() or point) if moved else point
        condition = point.curve.condition.followed(point.at) if point.curve.condition is not None else None
        if condition != point.curve.condition:
            curve = replace(point.curve, condition=condition)
            at = curve.solutions.equations.at(point.at.w)
            around = curve.solutions.point(at, point.tangent, point.point.iterations, point.point.earlier)
            point = curve.with_gait(around)
        self.point = point
        self.index += moved

    def _point_records(self) -> Iterator[TracePoint | TraceSpecial]:
        """The present point, verified by the simulator if it is its turn; the end of the curve if that fails."""
        gait, every = self.point.gait, self.request.verify_every
        if every and self.count % every == 0:
            holds, record = self._simulated(gait)
            gait = gait if record is None else gait.verified(record)
            if not holds:
                end = self._special("end", self.point, "guess", "the simulator disagrees with the gait")
                yield replace(end, gait=gait)
                return
        self.count += 1
        kappa = self._condition.kappa
        along = CurveStart(type=self.kind, parameter=self.first, gait=gait, margin=self.own, kappa=kappa)
        condition = along.to_record()
        if self._decided is not None:
            (cycle,) = self._decided
            condition["beyond"] = None if cycle is None else cast(CycleRecord, cycle_data(cycle))
        yield TracePoint(
            curve=self.number,
            index=self.index,
            values=self.point.values,
            gait=gait,
            condition=condition,
            tangent=self.point.direction,
            length=self.length,
            walk=self.point.state,
        )

    def _special(self, kind: str, point: CurvePoint, status: str = "converged", reason: str = "") -> TraceSpecial:
        values = {} if self.kind == "margin" else coefficients(point.local, self.kind, self._condition.kappa)
        return TraceSpecial(
            curve=self.number,
            type=kind,
            values=point.values,
            codimension=1 if kind == "end" else 2,
            status=status,
            reason=reason,
            coefficients=values,
            gait=point.gait,
        )


def _beyond(value: float, limit: float, sign: float) -> float:
    """How far a value lies beyond a bound, in multiples of ``AT_BOUND``; ``sign`` is -1 for a lower bound."""
    return sign * (value - limit) / (AT_BOUND * max(abs(limit), AT_BOUND))


def _excess(point: CurvePoint, key: str, limit: float) -> float:
    return point.values[key] - limit


def _spectrum(gait: Gait) -> str:
    return ", ".join(f"{m.real:.6g}" + (f"{m.imag:+.6g}i" if m.imag else "") for m in gait.multipliers)
