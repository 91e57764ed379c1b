"""A family of gaits from one of its gaits or from a special point, towards targets; and the same taken up again."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from typing import Any

from gaitopt.callbacks import Stop
from gaitopt.errors import SolveError
from gaitopt.families.coefficients import with_friction
from gaitopt.families.continuer import Record
from gaitopt.families.request import Request, check_request
from gaitopt.families.walks import first_walks
from gaitopt.gait import TERMINAL, Gait, SpecialPoint


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
    stored, walks = _walks_done(done), first_walks(start, gait, request)
    for index, walk in enumerate(walks):  # which grow on the way
        own = stored[index] if index < len(stored) else ()
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


def resumable(records: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The records from which an unfinished family goes on: special points after the last point are located again."""
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
