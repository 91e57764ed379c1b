"""A family of gaits from one of its gaits, towards one value of a parameter or two; and the same taken up again."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitopt.errors import ProblemError, SolveError, UnknownNameError
from gaitopt.families.change import with_cycle
from gaitopt.families.coefficients import coefficient_bounds, with_friction
from gaitopt.families.continuer import FIRST_LENGTH, Continuer, Record
from gaitopt.families.limits import Limits
from gaitopt.families.segment import Metric, Point, Segment, segment_through
from gaitopt.gait import TERMINAL, Branch, BranchPoint, Gait, SpecialPoint
from gaitopt.mechanics import Cycle, Mode, ModeSequence
from gaitopt.nlp.rollout import roll_out

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What family is wanted.

    Attributes
    ----------
    parameter : dotted key of a scalar of walker, friction or control.
    to : values of the parameter at which to stop, one after the other, each time from the first gait.
    lower, upper : bounds for families that turn round; None as far beyond the first gait as the target is before it.
    max_points, max_seconds : bounds on the work of each target.
    verify_every : every so many points is confirmed by the simulator, 0 for none.
    """

    parameter: str
    to: tuple[float, ...]
    lower: float | None = None
    upper: float | None = None
    max_points: int = 2000
    max_seconds: float | None = None
    verify_every: int = 10

    def to_record(self) -> dict[str, Any]:
        """One JSON object, the first line of a stored branch."""
        return {"record": "continuation", **asdict(self), "to": list(self.to)}


def continuation(
    gait: Gait,
    parameter: str,
    to: float | Sequence[float],
    *,
    lower: float | None = None,
    upper: float | None = None,
    max_points: int = 2000,
    max_seconds: float | None = None,
    verify_every: int = 10,
    progress: Callable[[int, float], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Branch:
    """Continue a gait in a parameter, through folds and changes of the mode sequence.

    Parameters
    ----------
    gait : a converged gait.
    parameter : dotted key of any scalar of walker, friction or control.
    to : value of the parameter towards which to go, and at which to stop; two values to go both ways.
    lower, upper : further bounds of the parameter, for families that turn round.
    max_points, max_seconds : bounds on the work.
    verify_every : every so many points is confirmed by the simulator.
    progress : called after every point with their number and the parameter.
    should_stop : polled before every point.

    Returns
    -------
    branch : points and special points.

    Raises
    ------
    UnknownNameError
        If there is no such parameter; the message lists the near misses.
    ProblemError
        If a target lies beyond a bound.
    SolveError
        If ``gait`` is a failed attempt.
    """
    request = Request(
        parameter=parameter,
        to=(float(to),) if isinstance(to, int | float) else tuple(map(float, to)),
        lower=lower,
        upper=upper,
        max_points=max_points,
        max_seconds=max_seconds,
        verify_every=verify_every,
    )
    records = list[Record]()
    for record in follow_family(gait, request, should_stop=should_stop):
        records.append(record)
        if progress is not None:
            progress(len(records), record.value)
    return Branch(
        parameter=parameter,
        points=tuple(record for record in records if isinstance(record, BranchPoint)),
        specials=tuple(record for record in records if isinstance(record, SpecialPoint)),
    )


def follow_family(
    gait: Gait,
    request: Request,
    *,
    done: Sequence[Mapping[str, Any]] = (),
    should_stop: Callable[[], bool] | None = None,
) -> Iterator[Record]:
    """As ``continuation``, record by record; ``done`` are the JSON records that there are (see ``resumable``)."""
    gait = with_friction(gait, request.parameter)
    check_request(gait, request)
    sweeps = _sweeps(done)
    highest = max((record["branch"] for record in done), default=-1)
    sweeps += [()] * (len(request.to) - len(sweeps))
    for to, made in zip(request.to, sweeps, strict=True):
        if made and made[-1].get("type") in TERMINAL:
            continue
        continuer = _continuer(gait, request, to, made, highest + 1, should_stop)
        for record in continuer.records(with_first=not made):
            highest = max(highest, record.branch)
            yield record
        if should_stop is not None and should_stop():
            return


def check_request(gait: Gait, request: Request) -> None:
    """Refuse a request that cannot be met.

    Raises
    ------
    UnknownNameError, ProblemError, SolveError
        As ``continuation``.
    """
    if not gait.steps:
        raise SolveError(f"{gait.problem.name} is {gait.status}, so there is nothing to continue: {gait.message}")
    names = gait.system.parameters
    if request.parameter not in names:
        near = ", ".join(get_close_matches(request.parameter, names, n=3, cutoff=0.3)) or ", ".join(names)
        raise UnknownNameError(f"{request.parameter} is no parameter of {gait.problem.name}; did you mean {near}?")
    if isinstance(gait.problem.parameters.get(request.parameter), int):
        raise UnknownNameError(
            f"--param {request.parameter}: is a whole number, along which there is no family; "
            f"solve for one value after the other with --set {request.parameter}=N"
        )
    value = float(gait.p[names.index(request.parameter)])
    for to in request.to:
        if to == value or not np.isfinite(to):
            raise ProblemError(
                f"{request.parameter} is {value:g} at the start: the target must be another finite value"
            )
        if request.lower is not None and min(to, value) < request.lower:
            raise ProblemError(f"{request.parameter}: {min(to, value):g} lies below the bound {request.lower:g}")
        if request.upper is not None and max(to, value) > request.upper:
            raise ProblemError(f"{request.parameter}: {max(to, value):g} lies above the bound {request.upper:g}")


def resumable(records: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The records from which an unfinished family goes on: special points after the last point are found again."""
    kept = list(records)
    while kept and kept[-1].get("record") == "special" and kept[-1]["type"] not in TERMINAL:
        kept.pop()
    return kept


def _sweeps(done: Sequence[Mapping[str, Any]]) -> list[Sequence[Mapping[str, Any]]]:
    """The records of each target; a terminal special point closes one."""
    sweeps: list[list[Mapping[str, Any]]] = []
    closed = True
    for record in done:
        if closed:
            sweeps.append([])
        sweeps[-1].append(record)
        closed = record.get("type") in TERMINAL
    return list(sweeps)


def _continuer(
    gait: Gait,
    request: Request,
    to: float,
    made: Sequence[Mapping[str, Any]],
    number: int,
    should_stop: Callable[[], bool] | None,
) -> Continuer:
    """The walk towards one target, from the gait or from the last point that was made."""
    value = float(gait.p[gait.system.parameters.index(request.parameter)])
    span, ahead = abs(to - value), 1.0 if to > value else -1.0
    least, largest = coefficient_bounds(gait, request.parameter)
    lower = to if ahead < 0 else (value - span if request.lower is None else request.lower)
    upper = to if ahead > 0 else (value + span if request.upper is None else request.upper)
    limits = Limits(
        lower=max(lower, least),
        upper=min(upper, largest),
        max_points=request.max_points,
        max_seconds=request.max_seconds,
        verify_every=request.verify_every,
    )
    metric = Metric.of(gait, gait.period, span)
    points = [record for record in made if record["record"] == "point"]
    if points:
        last = points[-1]
        segment, point = _restored(gait, request.parameter, metric, last)
        return Continuer(
            segment,
            point,
            limits,
            number=last["branch"],
            index=last["index"],
            length=last["length"],
            count=len(points),
            should_stop=should_stop,
        )
    segment, point = _first(gait, request.parameter, metric, ahead)
    return Continuer(segment, point, limits, number=number, length=FIRST_LENGTH, should_stop=should_stop)


def _first(gait: Gait, parameter: str, metric: Metric, ahead: float) -> tuple[Segment, Point]:
    """The branch of a gait, and its first point with the tangent in the wanted direction."""
    durations = np.array([duration for _, duration in gait.phases])
    rolled = roll_out(gait.system, gait.p, gait.problem.cycle, gait.state, durations)
    segment, w = segment_through(gait.problem, gait.system, parameter, metric, rolled, gait.p)
    forward = np.zeros(w.size)
    forward[-1] = ahead
    return segment, _started(segment, w, forward)


def _restored(gait: Gait, parameter: str, metric: Metric, record: Mapping[str, Any]) -> tuple[Segment, Point]:
    """The branch and the point that a record holds, on the mesh that it had."""
    system = gait.system
    durations = np.array([phase["duration"] for phase in record["phases"]])
    state = np.array([record["state"][name] for name in system.state_names])
    p = gait.p.copy()
    p[system.parameters.index(parameter)] = record["value"]
    problem = with_cycle(gait.problem, system, _recorded_cycle(record), state)
    rolled = roll_out(system, p, problem.cycle, state, durations)
    segment, w = segment_through(problem, system, parameter, metric, rolled, p, record["intervals"])
    return segment, _started(segment, w, segment.curve.direction(np.array(record["tangent"])))


def _recorded_cycle(record: Mapping[str, Any]) -> Cycle:
    steps = record.get("steps", (record,))
    modes = [tuple(Mode(phase["mode"]) for phase in step["phases"]) for step in steps]
    return Cycle(tuple(ModeSequence(own, Mode(step["impact"])) for own, step in zip(modes, steps, strict=True)))


def _started(segment: Segment, w: Array, forward: Array) -> Point:
    point = segment.start(w, forward)
    if point is None:
        raise SolveError(
            f"{segment.problem.name}: the gait cannot be continued in {segment.parameter}: Newton's method fails at it"
        )
    return point
