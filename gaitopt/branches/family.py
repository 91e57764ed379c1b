"""A family of gaits from one of its gaits or from a special point, towards targets; and the same taken up again."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from typing import Any

from gaitopt.branches.monitors import with_friction
from gaitopt.branches.request import Request, check_request
from gaitopt.branches.walk import Record, first_walks
from gaitopt.callbacks import Stop
from gaitopt.errors import SolveError
from gaitopt.gait.branch import TERMINAL, SpecialPoint
from gaitopt.gait.gait import Gait


def follow_family(
    start: Gait | SpecialPoint, request: Request, *, done: Sequence[Mapping[str, Any]] = (), should_stop: Stop = None
) -> Iterator[Record]:
    """The points and special points of a family, one by one, as ``gaitopt.continuation`` describes them.

    ``done`` are the JSON records of an unfinished family, see ``resumable``.
    """
    stated = start if isinstance(start, Gait) else start.gait
    if stated is None:
        raise SolveError(f"there is no gait at the special point {start!r}")
    gait = with_friction(stated, request.parameter)
    check_request(gait, request)
    numbers = count(1 + max((n for record in done for n in (record["branch"], *record.get("next", ()))), default=-1))
    stored, begun_later = _records_by_walk(done)
    unnumbered = (first for first in stored if first not in begun_later)
    walks = first_walks(start, gait, request)
    for walk in walks:  # which grow on the way
        own = stored.get(next(unnumbered, -1) if walk.number is None else walk.number, [])
        walk = walk.with_metric_of(own)
        walks += [branch for record in own for branch in walk.restored_branches(record)]
        if own and own[-1].get("type") in TERMINAL:
            continue
        for record in walk.continuer(own, numbers, should_stop).records(with_first=not own):
            if isinstance(record, SpecialPoint):
                record, begun = walk.branches(record, numbers)
                walks += begun
            yield record
        if should_stop is not None and should_stop():
            return


def resumable(records: Sequence[Mapping[str, Any]], request: Request) -> list[Mapping[str, Any]]:
    """The records from which an unfinished family goes on.

    Special points after the last point of a walk are located again. The end of a walk that had taken all it was allowed
    is left out if ``request`` allows it more.
    """
    again = set[int]()
    for own in _records_by_walk(records)[0].values():
        points = sum(record["record"] == "point" for record in own)
        for record in reversed(own):
            closed = record.get("type") in TERMINAL and not (record.get("open") and request.exhausted(points) is None)
            if record["record"] == "point" or closed:
                break
            again.add(id(record))
    return [record for record in records if id(record) not in again]


def _records_by_walk(records: Sequence[Mapping[str, Any]]) -> tuple[dict[int, list[Mapping[str, Any]]], set[int]]:
    """The records of each walk by the number of its first branch, and those numbers that special points have given."""
    first, walks, given = dict[int, int](), dict[int, list[Mapping[str, Any]]](), set[int]()
    for record in records:
        walk = first.setdefault(record["branch"], record["branch"])
        walks.setdefault(walk, []).append(record)
        following = list(record.get("next", ()))
        if following and "to" in record:  # the walk itself goes on with the first
            first[following.pop(0)] = walk
        given.update(following)
    return walks, given
