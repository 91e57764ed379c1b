"""A family of gaits from one of its gaits or from a special point, towards targets; and the same taken up again."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import count
from typing import Any

from gaitopt.errors import SolveError
from gaitopt.families.coefficients import with_friction
from gaitopt.families.continuer import Record
from gaitopt.families.request import Request, check_request
from gaitopt.families.walks import Walk, first_walks
from gaitopt.gait import TERMINAL, Branch, BranchPoint, Gait, SpecialPoint


def continuation(
    start: Gait | SpecialPoint,
    parameter: str,
    to: float | Sequence[float],
    *,
    lower: float | None = None,
    upper: float | None = None,
    events: Mapping[str, Callable[[Gait], float]] | None = None,
    max_points: int = 2000,
    max_seconds: float | None = None,
    verify_every: int = 10,
    doublings: int = 0,
    progress: Callable[[int, float], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Branch:
    """Continue a gait in a parameter, through folds and changes of the mode sequence.

    Parameters
    ----------
    start : a converged gait; or a special point of a branch, from which the other branches that begin there are
        continued: at a ``period_doubling`` the cycles of twice as many steps, at a ``branch_point`` both halves of the
        curve that crosses the known one, at a change of modes the mode sequences that were not followed.
    parameter : dotted key of any scalar of walker, friction or control.
    to : value of the parameter towards which to go, and at which to stop; two values to go both ways.
    lower, upper : further bounds of the parameter, for families that turn round.
    events : functions of a gait, continuous along the family: ``{"fast": lambda gait: gait.scalar("speed") - 0.5}``.
        Their zeros are located as precisely as bifurcations, and are special points of that type.
    max_points, max_seconds : bounds on the work of each walk.
    verify_every : every so many points is confirmed by the simulator.
    doublings : how many times in turn the family that begins at a period doubling is followed as well.
    progress : called after every record with their number and the parameter.
    should_stop : polled before every point.

    Returns
    -------
    branch : points and special points.

    Raises
    ------
    UnknownNameError
        If there is no such parameter; the message lists the near misses.
    ProblemError
        If a target lies beyond a bound, or no other branch can begin at such a special point.
    SolveError
        If ``start`` is a failed attempt, or no other branch is found at it.
    """
    request = Request(
        parameter=parameter,
        to=(float(to),) if isinstance(to, int | float) else tuple(map(float, to)),
        lower=lower,
        upper=upper,
        events=events or {},
        max_points=max_points,
        max_seconds=max_seconds,
        verify_every=verify_every,
        doublings=doublings,
    )
    records = list[Record]()
    for record in follow_family(start, request, should_stop=should_stop):
        records.append(record)
        if progress is not None:
            progress(len(records), record.value)
    return Branch(
        parameter=parameter,
        points=tuple(record for record in records if isinstance(record, BranchPoint)),
        specials=tuple(record for record in records if isinstance(record, SpecialPoint)),
    )


def follow_family(
    start: Gait | SpecialPoint,
    request: Request,
    *,
    done: Sequence[Mapping[str, Any]] = (),
    should_stop: Callable[[], bool] | None = None,
) -> Iterator[Record]:
    """As ``continuation``, record by record; ``done`` are the JSON records that there are (see ``resumable``)."""
    gait = with_friction(_gait_of(start), request.parameter)
    check_request(gait, request)
    numbers = count(1 + max((n for record in done for n in (record["branch"], *record.get("next", ()))), default=-1))
    stored, walks = _walks_done(done), first_walks(start, gait, request)
    for index, walk in enumerate(walks):  # which grow on the way
        own = stored[index] if index < len(stored) else ()
        walks += [
            walk.doubled(record, *record["next"])
            for record in own
            if record.get("type") == "period_doubling" and record["next"]
        ]
        if own and own[-1].get("type") in TERMINAL:
            continue
        for record in _records(walk, own, numbers, should_stop):
            yield record
            if isinstance(record, SpecialPoint) and record.type == "period_doubling" and record.next:
                walks.append(walk.doubled(record, *record.next))
        if should_stop is not None and should_stop():
            return


def _records(
    walk: Walk, done: Sequence[Mapping[str, Any]], numbers: Iterator[int], should_stop: Callable[[], bool] | None
) -> Iterator[Record]:
    """The records of one walk; one whose beginning is not found, though it has a number, has an end only."""
    try:
        continuer = walk.continuer(done, numbers, should_stop)
    except SolveError as error:
        if walk.number is None:
            raise
        yield walk.failed(str(error))
        return
    yield from continuer.records(with_first=not done)


def _gait_of(start: Gait | SpecialPoint) -> Gait:
    """The gait to start from.

    Raises
    ------
    SolveError
        If a special point has none.
    """
    if isinstance(start, Gait):
        return start
    if start.gait is None:
        raise SolveError(f"there is no gait at the special point {start.type} at {start.value:g}")
    return start.gait


def resumable(records: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The records from which an unfinished family goes on: special points after the last point are found again."""
    kept = list(records)
    while kept and kept[-1].get("record") == "special" and kept[-1]["type"] not in TERMINAL:
        kept.pop()
    return kept


def _walks_done(done: Sequence[Mapping[str, Any]]) -> list[Sequence[Mapping[str, Any]]]:
    """The records of each walk; a terminal special point closes one."""
    walks: list[list[Mapping[str, Any]]] = []
    closed = True
    for record in done:
        if closed:
            walks.append([])
        walks[-1].append(record)
        closed = record.get("type") in TERMINAL
    return list(walks)
