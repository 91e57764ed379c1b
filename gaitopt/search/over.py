"""A design over a range of a parameter: one control with a stable gait at every value.

    min over v of  max_s f(v, s)  or  mean_s f(v, s)  or  f(v, s_0)      s.t.  c(v, s) >= 0  for all s in [lo, hi]

v are the freed parameters, s is the parameter of the range, and c are the constraints of the problem and of each gait.
This semi-infinite program is solved by exchange (Blankenship & Falk 1976): the design for some values of s, the
*scenarios*, is followed over the whole range by continuation, which also changes the mode sequence. Where a constraint
is violated most, or the family ends, a scenario is added, until nothing is violated.

Each scenario has the mode sequence that the continuation has found at its value. If an optimum lies at a margin of such
a sequence, and would improve beyond it, the sequence changes there and the design is repeated. If no control is found
for the whole range, the range grows from the problem's own value on both sides in proportion, as far as possible.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import inf

import numpy as np

from gaitopt.arrays import Array
from gaitopt.branches.continuation import follow_family
from gaitopt.branches.curve import CurvePoint, Metric, first_point
from gaitopt.branches.request import Request
from gaitopt.callbacks import Stop, Valued
from gaitopt.design.design import Edge, ScenarioOptimum, design_scenarios
from gaitopt.design.exact import SMALL
from gaitopt.design.spectral_radius import RADIUS
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.branch import TERMINAL, BranchPoint
from gaitopt.gait.gait import Cause, Gait, Status, best_point
from gaitopt.gait.ranges import DesignRange, RangePoint
from gaitopt.problem.problem import Problem
from gaitopt.problem.schema import Aggregate
from gaitopt.problem.statement import Over, Range
from gaitopt.requests import DEFAULT_LIMITS, Method, SearchLimits
from gaitopt.systems import solve_sequence

LARGEST_RADIUS = 0.999
"""Bound of the spectral radius where the problem has none, or a larger one: the gaits of a range are stable."""
OBJECTIVE = "objective"
"""Name of the condition that no value of the objective exceeds that of the scenarios."""
NODES = 9
"""Number of equally spaced values of which the mean of an objective is taken, by the trapezoidal rule."""
LARGEST_VIOLATION = 1e-6
"""Largest violation of a constraint between the scenarios, relative to its bound."""
MAX_ROUNDS = 20
"""Largest number of times that scenarios are added to one range."""
MAX_SEQUENCES = 12
"""Largest number of combinations of mode sequences that one design tries."""
SMALLEST_GROWTH = 1 / 64
"""A range is the widest one if no control is found after it has grown by this fraction of the whole growth."""
BEFORE_END = 0.05
"""Distance of a scenario from the end of a family, as a fraction of the distance of the end from the own value."""
ACROSS = (1e-3, 1e-2, 1e-1)
"""Fractions of its typical size by which a freed parameter crosses the margin of a mode sequence, tried in turn."""
SAME_VALUE = 1e-9
"""Values of the parameter are the same if their distance is below this fraction of the width of the range."""


def design_over(
    problem: Problem,
    *,
    start: Gait | None = None,
    method: Method = Method.AUTO,
    limits: SearchLimits = DEFAULT_LIMITS,
    progress: Valued = None,
    should_stop: Stop = None,
) -> Gait:
    """The gait at the problem's own value of the best control over the range ``problem.over``; see ``search.solve``.

    ``gait.over`` describes the gaits along the range. If there is no control for so wide a range, the status is
    ``infeasible``, and ``gait.over.widest`` is the widest range for which there is one.
    """
    over, began = problem.over, time.perf_counter()
    assert over is not None
    design = problem.at_own_value()
    bound = design.constraints.get(RADIUS, Range(minimum=-inf, maximum=inf))
    stable = replace(bound, maximum=min(bound.maximum, LARGEST_RADIUS))
    design = replace(design, constraints={**design.constraints, RADIUS: stable})
    single = solve_sequence(
        design, start=start, method=method, limits=limits, progress=progress, should_stop=should_stop
    )
    if not single.converged:
        own = problem.parameters[over.key]
        return replace(single, message=f"at {over.key} = {own:g} alone: {single.message}", over=_described(over, own))
    gait = _Search(design, over, single, progress, should_stop).run()
    solver = {**gait.solver, "method": single.solver["method"], "seconds": time.perf_counter() - began}
    return replace(gait, solver=solver)


def _described(over: Over, own: float) -> DesignRange:
    """The description of the range, without a design; ``own`` is the problem's own value of the parameter."""
    at = own if over.at is None else over.at
    return DesignRange(key=over.key, lower=over.lower, upper=over.upper, aggregate=over.aggregate.value, at=at)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Family:
    """The gaits of one control along a range.

    Attributes
    ----------
    gaits : the gaits by value of the parameter, in ascending order.
    ends : for each side on which the family does not cover the range, its last value and the reason of its end.
    """

    gaits: dict[float, Gait]
    ends: tuple[tuple[float, str], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Control:
    """A control, and what its design has found.

    Attributes
    ----------
    own : the gait of the control at the own value.
    values : values of the scenarios, the own value first.
    optimum : the design over these values; None if only the own value was designed for.
    complete : whether the objective counted over the whole range, and not at the own value only.
    """

    own: Gait
    values: tuple[float, ...]
    optimum: ScenarioOptimum | None = None
    complete: bool = False


class _Search:
    """The search for one design over a range.

    Parameters
    ----------
    design : the problem at its own value, with the objective and all constraints.
    single : the gait of the design at this value alone.
    """

    def __init__(self, design: Problem, over: Over, single: Gait, progress: Valued, should_stop: Stop) -> None:
        self._design, self._over, self._single = design, over, single
        self._progress, self._should_stop = progress, should_stop
        self._own, self._width = single.dynamics.parameter(over.key), over.upper - over.lower

    def run(self) -> Gait:
        """The design over the whole range, or a failed attempt that says how far the range could grow."""
        known, share, growth = _Control(own=self._single, values=(self._own,)), 0.0, 1.0
        family: _Family | None = None
        reason = ""
        while share < 1:
            wider = min(share + growth, 1.0)
            found = self._designed(known, wider)
            if self._interrupted:
                return self._failed(known, Status.INTERRUPTED, "interrupted")
            if isinstance(found, str):
                reason, growth = found, growth / 2
                if growth < SMALLEST_GROWTH:
                    return self._too_wide(known, share, reason)
                continue
            (known, family), share = found, wider
        assert family is not None
        optimum = known.optimum
        if optimum is not None and optimum.shortcoming:
            return self._failed(known, Status.NOT_CONVERGED, optimum.shortcoming)
        shown = self._shown(known, family)
        count = f"{len(known.values)} scenario{'s' if len(known.values) > 1 else ''}"
        message = f"solved for {self._over.key} from {self._over.lower:g} to {self._over.upper:g} with {count}"
        return replace(known.own, problem=self._design_as_stated, message=message, over=shown)

    @property
    def _design_as_stated(self) -> Problem:
        origin = self._design.origin
        return self._design if origin is None else origin.at_own_value()

    @property
    def _interrupted(self) -> bool:
        return self._should_stop is not None and self._should_stop()

    def _target(self, share: float) -> tuple[float, float]:
        """The range that has grown from the own value by this fraction of the whole growth."""
        low, high = (self._own + share * (end - self._own) for end in (self._over.lower, self._over.upper))
        return (self._over.lower, self._over.upper) if share >= 1 else (low, high)

    def _designed(self, known: _Control, share: float) -> tuple[_Control, _Family] | str:
        """The control for a narrower range and its gaits there, or the sentence that says why none is found."""
        target = self._target(share)
        control = _Control(own=known.own, values=(self._own,))
        for _ in range(MAX_ROUNDS):
            family = self._followed(control.own, target)
            complete = not family.ends
            added = self._added(control, family, target)
            if self._interrupted or (complete and control.complete and not added):
                return control, family
            if not complete and not added:
                return "; ".join(f"the gaits end at {self._over.key} = {at:g}: {end}" for at, end in family.ends)
            values = (*control.values, *added)
            optimum = self._optimum(family, values, target)
            if optimum is None or not optimum.feasible:
                where = ", ".join(f"{value:g}" for value in sorted(values))
                shortcoming = "a gait is lost" if optimum is None else str(optimum.shortcoming)
                if optimum is not None and any(edge.scenario == 0 for edge in optimum.edges):
                    shortcoming += f", at the end of the mode sequence that is stated for {self._own:g}"
                return f"no control meets all constraints at {self._over.key} = {where}: {shortcoming}"
            control = _Control(own=optimum.own, values=values, optimum=optimum, complete=complete)
        return f"scenarios were added {MAX_ROUNDS} times, and constraints between them are still violated"

    def _optimum(self, family: _Family, values: Sequence[float], target: tuple[float, float]) -> ScenarioOptimum | None:
        """The design for some scenarios, whose mode sequences change where that improves it.

        While the family does not cover the range, only the objective at the own value counts.
        """
        aggregate = Aggregate.AT if family.ends else self._over.aggregate
        worst, shares = aggregate is Aggregate.WORST, self._shares(values, target, aggregate)

        def designed(family: _Family) -> ScenarioOptimum | None:
            gaits = [self._member(family, value) for value in values]
            known = [gait for gait in gaits if gait is not None]
            sequences = tuple(str(gait.cycle) for gait in known)
            if len(known) < len(gaits) or sequences in tried:
                return None
            tried.add(sequences)
            return design_scenarios(
                self._design, known, shares, worst=worst, progress=self._progress, should_stop=self._should_stop
            )

        tried = set[tuple[str, ...]]()
        best = designed(family)
        improved = best is not None
        while best is not None and improved and len(tried) < MAX_SEQUENCES and not self._interrupted:
            improved = False
            for edge, fraction in product((edge for edge in best.edges if edge.scenario), ACROSS):
                beyond = self._beyond(best.own, edge, fraction)
                other = None if beyond is None else designed(self._followed(beyond, target))
                if other is not None and other.is_better(best):
                    best, improved = other, True
                    break
        return best

    def _beyond(self, own: Gait, edge: Edge, fraction: float) -> Gait | None:
        """The gait at the own value with a freed parameter beyond an edge; None if there is none."""
        try:
            return self._at(own, edge.key, own.dynamics.parameter(edge.key) + fraction * edge.change)
        except (ProblemError, SolveError):  # beyond the bounds of the parameter, or Newton's method fails
            return None

    def _member(self, family: _Family, value: float) -> Gait | None:
        """The gait of a family at a value, with the mode sequence that holds there; None if it is not found."""
        near = sorted(family.gaits, key=lambda each: abs(each - value))[:2]
        for known in near:
            try:
                point = self._point(family.gaits[known], self._over.key, value)
            except SolveError:
                continue
            if point is not None and all(monitor.value > 0 for monitor in point.monitors.values()):
                return point.gait
        return family.gaits[near[0]] if near[0] == value else None

    def _shares(self, values: Sequence[float], target: tuple[float, float], aggregate: Aggregate) -> list[float]:
        """Weight of every scenario in the objective."""
        if aggregate is Aggregate.WORST:
            return [0.0] * len(values)
        if aggregate is Aggregate.MEAN:
            shares = dict.fromkeys(values, 0.0)
            for node, weight in zip(np.linspace(*target, NODES).tolist(), _trapezoid(NODES), strict=True):
                shares[self._nearest(values, node)] += weight
            return [*shares.values()]
        at = self._own if self._over.at is None or len(values) == 1 else float(np.clip(self._over.at, *target))
        chosen = self._nearest(values, at)
        return [float(value == chosen) for value in values]

    def _nearest(self, values: Sequence[float], value: float) -> float:
        return min(values, key=lambda each: abs(each - value))

    def _at(self, gait: Gait, key: str, value: float) -> Gait | None:
        """The gait of the same mode sequence at a nearby value of a parameter; None if Newton's method fails."""
        point = self._point(gait, key, value)
        return None if point is None else point.gait

    def _point(self, gait: Gait, key: str, value: float) -> CurvePoint | None:
        """The same gait as a point of its curve."""
        known = gait.dynamics.parameter(key)
        metric = Metric.of(gait, abs(value - known) or self._width)
        point = first_point(gait, key, metric, float(np.sign(value - known)) or 1.0)
        return point if value == known else point.at_parameter(value)

    def _followed(self, gait: Gait, target: tuple[float, float]) -> _Family:
        """The gaits of the control of ``gait`` along a range, as far as they are functions of the parameter."""
        gaits, ends = {self._own: gait}, list[tuple[float, str]]()
        for to in target:
            if to == self._own:
                continue
            last = self._own
            for record in follow_family(
                gait, Request(parameter=self._over.key, to=(to,)), should_stop=self._should_stop
            ):
                if isinstance(record, BranchPoint):
                    gaits[record.value], last = record.gait, record.value
                elif record.type == "fold" or (record.type in TERMINAL and not record.bound):
                    ends.append((last, record.reason or record.type))
                    break
        return _Family(gaits=dict(sorted(gaits.items())), ends=tuple(ends))

    def _added(self, control: _Control, family: _Family, target: tuple[float, float]) -> dict[float, Gait]:
        """The gaits at the values at which a constraint is violated most, and near the ends of the family.

        If the family covers the range, the values at which the objective counts are added too.
        """
        gaits, key = family.gaits, self._over.key
        values, added = [*gaits], dict[float, Gait]()

        def add(value: float, gait: Gait | None) -> None:
            known = (*control.values, *added)
            if gait is not None and all(abs(value - each) > SAME_VALUE * self._width for each in known):
                added[value] = gait

        for last, _ in family.ends:
            near = self._nearest(values, last - BEFORE_END * (last - self._own))
            add(near, gaits[near])
        if not family.ends and self._over.aggregate is not Aggregate.WORST:
            mean = self._over.aggregate is Aggregate.MEAN
            at = self._own if self._over.at is None else self._over.at
            for value in np.linspace(*target, NODES).tolist() if mean else [float(np.clip(at, *target))]:
                add(value, self._at(gaits[self._nearest(values, value)], key, value))
        level = control.optimum.objective if control.optimum and control.complete else None
        rows = [self._violations(gait, level) for gait in gaits.values()]
        for name in rows[0]:
            heights = np.array([row[name] for row in rows])
            k = int(heights.argmax())
            peak, gait, height = values[k], gaits[values[k]], heights[k]
            if 0 < k < len(values) - 1 and gaits[values[k - 1]].cycle == gait.cycle == gaits[values[k + 1]].cycle:
                refined = self._at(gait, key, _vertex(values[k - 1 : k + 2], heights[k - 1 : k + 2]))
                if refined is not None and (higher := self._violations(refined, level)[name]) > height:
                    peak, gait, height = refined.dynamics.parameter(key), refined, higher
            if height > LARGEST_VIOLATION:
                add(peak, gait)
        return added

    def _violations(self, gait: Gait, level: float | None) -> dict[str, float]:
        """The violation of each constraint by a gait, relative to its bound; negative if the constraint is met.

        Parameters
        ----------
        level : the largest objective of the scenarios, under ``worst``.
        """
        rows = {}
        for name, span in self._design.constraints.items():
            unit = max(*(abs(bound) for bound in (span.minimum, span.maximum) if np.isfinite(bound)), SMALL)
            value = gait.scalar(name)
            rows[name] = max(value - span.maximum, span.minimum - value) / unit if np.isfinite(value) else -inf
        if level is not None and self._over.aggregate is Aggregate.WORST and self._design.objective:
            rows[OBJECTIVE] = (self._objective(gait) - level) / max(abs(level), SMALL)
        return rows

    def _objective(self, gait: Gait) -> float:
        return sum(weight * gait.scalar(name) for name, weight in self._design.objective.items())

    def _shown(self, control: _Control, family: _Family) -> DesignRange:
        """The description of a design that holds over the whole range."""
        points = tuple(
            RangePoint(
                value=value,
                objective=self._objective(gait),
                spectral_radius=gait.scalar(RADIUS),
                sequence=str(gait.cycle),
            )
            for value, gait in family.gaits.items()
        )
        worst = max(points, key=lambda point: (round(point.objective, 12), -abs(point.value - self._own)))
        assert control.optimum is not None
        objective = control.optimum.objective
        rows = {value: self._violations(gait, objective) for value, gait in family.gaits.items()}
        tightest = {name: max(rows, key=lambda value: rows[value][name]) for name in self._design.constraints}
        return replace(
            _described(self._over, self._own),
            objective=objective if self._design.objective else None,
            worst_at=worst.value if self._design.objective else None,
            binding={name: at for name, at in tightest.items() if rows[at][name] > -LARGEST_VIOLATION},
            scenarios=tuple(sorted(control.values)),
            single=self._objective(self._single) if self._design.objective else None,
            points=points,
        )

    def _too_wide(self, known: _Control, share: float, reason: str) -> Gait:
        """The failed attempt that states the widest range for which a control was found; see ``_target``."""
        key, widest = self._over.key, self._target(share)
        message = f"no control was found for {key} from {self._over.lower:g} to {self._over.upper:g}"
        found = f"the widest range with one is {widest[0]:.6g} to {widest[1]:.6g}"
        message += f"; {found if share else f'there is one for {self._own:g} alone'}. Beyond it, {reason}"
        cause = Cause(what=self._over.key, description=message, needed=self._width, available=widest[1] - widest[0])
        gait = self._failed(known, Status.INFEASIBLE, message)
        return replace(gait, causes=(cause,), over=replace(_described(self._over, self._own), widest=widest))

    def _failed(self, known: _Control, status: Status, message: str) -> Gait:
        """The failed attempt that records the last control."""
        own = known.own
        durations = np.array([duration for _, duration in own.phases])
        return Gait(
            problem=self._design_as_stated,
            dynamics=own.dynamics,
            status=status,
            message=message,
            solver=own.solver,
            best=best_point(own.problem, own.state, durations, own.freed),
            over=_described(self._over, self._own),
        )


def _vertex(values: Sequence[float], heights: Sequence[float] | Array) -> float:
    """The value at which the parabola through three points is largest, between the outer ones."""
    left, right = values[0] - values[1], values[2] - values[1]
    down, up = heights[0] - heights[1], heights[2] - heights[1]
    bend = (up / right - down / left) / (right - left)
    slope = down / left - bend * left
    return float(np.clip(values[1] - slope / (2 * bend), values[0], values[2])) if bend < 0 else values[1]


def _trapezoid(n: int) -> list[float]:
    """Weights of the trapezoidal rule for the mean of n equally spaced values."""
    return [(0.5 if k in (0, n - 1) else 1.0) / (n - 1) for k in range(n)]
