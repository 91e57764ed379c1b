"""Walks along a family: from a gait towards each target, and along every branch that begins at a special point."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from gaitopt.callbacks import Stop
from gaitopt.errors import ProblemError, SolveError
from gaitopt.families.coefficients import coefficient_bounds
from gaitopt.families.continuer import Continuer
from gaitopt.families.limits import Limits
from gaitopt.families.position import Position
from gaitopt.families.records import recorded_special, resumed_point, stored_metric
from gaitopt.families.request import FOLLOWS, Request
from gaitopt.families.segment import Metric
from gaitopt.families.switching import Beginning, beginnings, started
from gaitopt.gait import Gait, SpecialPoint

Record = Mapping[str, Any]


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

    def continuer(self, done: Sequence[Record], numbers: Iterator[int], should_stop: Stop) -> Continuer:
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

    def with_metric_of(self, done: Sequence[Record]) -> "Walk":
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

    def restored_branches(self, record: Record) -> list["Walk"]:
        """The walks along the other branches of a stored special point."""
        kind = record.get("type", "")
        if kind not in FOLLOWS:
            return []
        own = 1 if "to" in record else 0  # of a change, the first number is that of the known family
        return [
            self._branch(kind, number, partial(self._restored_beginning, record, index))
            for index, number in enumerate(record["next"][own:])
        ]

    def _restored_beginning(self, record: Record, index: int) -> Beginning:
        return self._beginnings(record)[index]

    def _beginnings(self, record: Record) -> list[Beginning]:
        """The first gaits of the other branches through a special point, as far as they are within the limits.

        They are found from its record, so that a walk taken up again finds the same.
        """
        begun = beginnings(recorded_special(self.gait, self.parameter, record), self.parameter, self.metric)
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
