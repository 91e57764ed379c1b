"""Walks along a family: from a gait towards each target, and along every branch that begins at a special point."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from gaitopt.families.coefficients import coefficient_bounds
from gaitopt.families.continuer import FIRST_LENGTH, Continuer
from gaitopt.families.limits import Limits
from gaitopt.families.records import restored_point, restored_special
from gaitopt.families.request import Request
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
    parameter : dotted key.
    metric, limits : what arclength is measured with, and where to stop.
    begin : finds the first gait.
    number : of its first branch, None if no number is reserved for it.
    origin : the value of the parameter at which it begins.
    """

    gait: Gait
    parameter: str
    metric: Metric
    limits: Limits
    begin: Callable[[], Beginning]
    origin: float
    number: int | None = None

    def continuer(
        self, done: Sequence[Record], numbers: Iterator[int], should_stop: Callable[[], bool] | None
    ) -> Continuer:
        """The walk from its first gait, or from the last point that is ``done``."""
        points = [record for record in done if record["record"] == "point"]
        if not points:
            segment, point = self.begin()
            number = next(numbers) if self.number is None else self.number
            return Continuer(
                segment,
                point,
                self.limits,
                numbers=numbers,
                number=number,
                length=FIRST_LENGTH,
                should_stop=should_stop,
            )
        last = points[-1]
        segment, point = restored_point(self.gait, self.parameter, self.metric, last)
        return Continuer(
            segment,
            point,
            self.limits,
            numbers=numbers,
            number=last["branch"],
            index=last["index"],
            length=last["length"],
            count=len(points),
            should_stop=should_stop,
        )

    def doubled(self, special: SpecialPoint | Record, number: int) -> "Walk":
        """The walk along the family that begins at a period doubling of this one, with the same limits."""

        def begin() -> Beginning:
            point = special
            if not isinstance(point, SpecialPoint):
                point = restored_special(self.gait, self.parameter, point)
            return beginnings(point, self.parameter, self.metric)[0]

        return Walk(
            gait=self.gait,
            parameter=self.parameter,
            metric=self.metric,
            limits=self.limits,
            begin=begin,
            origin=special.value if isinstance(special, SpecialPoint) else special["value"],
            number=number,
        )

    def failed(self, reason: str) -> SpecialPoint:
        """The end of a walk whose first gait is not found."""
        assert self.number is not None
        return SpecialPoint(branch=self.number, type="end", value=self.origin, status="guess", reason=reason)


def first_walks(start: Gait | SpecialPoint, gait: Gait, request: Request) -> list[Walk]:
    """Towards each target from a gait; along every other branch from a special point, the targets being bounds.

    ``gait`` is that of ``start``, restated for the parameter.
    """
    value = float(gait.p[gait.system.parameters.index(request.parameter)])
    spans = [abs(to - value) for to in request.to]
    if isinstance(start, SpecialPoint):
        metric = Metric.of(gait, gait.period, max(spans))
        found = beginnings(replace(start, gait=gait), request.parameter, metric)
        limits = [_limits(gait, request, request.to, len(segment.cycle.steps)) for segment, _ in found]
        walks: list[tuple[Metric, Limits, Callable[[], Beginning]]] = [
            (metric, own, partial(_given, beginning)) for beginning, own in zip(found, limits, strict=True)
        ]
    else:
        metrics = [Metric.of(gait, gait.period, span) for span in spans]
        walks = [
            (
                metric,
                _limits(gait, request, (to,), len(gait.steps)),
                partial(started, gait, request.parameter, metric, 1.0 if to > value else -1.0),
            )
            for to, metric in zip(request.to, metrics, strict=True)
        ]
    return [
        Walk(gait=gait, parameter=request.parameter, metric=metric, limits=limits, begin=begin, origin=value)
        for metric, limits, begin in walks
    ]


def _given(beginning: Beginning) -> Beginning:
    return beginning


def _limits(gait: Gait, request: Request, targets: Sequence[float], n_steps: int) -> Limits:
    """Bounds at the targets, and as far on the other side unless the request has bounds of its own."""
    value = float(gait.p[gait.system.parameters.index(request.parameter)])
    least, largest = coefficient_bounds(gait, request.parameter)
    span = max(abs(to - value) for to in targets)
    lower = value - span if request.lower is None else request.lower
    upper = value + span if request.upper is None else request.upper
    below, above = ([to for to in targets if side * (to - value) > 0] for side in (-1, 1))
    return Limits(
        lower=max(min(below, default=lower), least),
        upper=min(max(above, default=upper), largest),
        events=request.events,
        max_points=request.max_points,
        max_seconds=request.max_seconds,
        verify_every=request.verify_every,
        most_steps=n_steps * 2**request.doublings,
    )
