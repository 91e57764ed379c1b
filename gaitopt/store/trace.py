"""A stored trace in two parameters, read back so that the resumed trace has the same bits as an uninterrupted one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gaitopt.arrays import Array
from gaitopt.gait.branch import ContinuationState
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import ConditionRecord, TraceRecord
from gaitopt.store.branch import StoredPoint, last_point, unusable


@dataclass(frozen=True, kw_only=True)
class StoredTrace:
    """The stored part of the walk along a curve towards one target.

    Attributes
    ----------
    count : number of points.
    largest : largest number of a curve.
    is_complete : whether the walk has reached its end.
    last : the last point; None if the walk is complete.
    condition : the condition that holds along the curve at the last point.
    metric : ndarray - scales of arclength.
    """

    count: int
    largest: int
    is_complete: bool
    last: StoredPoint | None
    condition: ConditionRecord
    metric: Array


def stored_traces(family: Gait, free: tuple[str, str], records: Sequence[TraceRecord]) -> list[StoredTrace]:
    """The walks of a trace, from its records, in the order of their targets.

    Parameters
    ----------
    family : the gait from which it begins, with the friction law that has both parameters.
    free : dotted keys of both.

    Raises
    ------
    StorageError
        If a walk cannot be resumed from its records.
    """
    traces = list[StoredTrace]()
    for walk in _walks(records):
        points = [record for record in walk if record["record"] == "point"]
        is_complete = walk[-1]["record"] == "special"
        last = points[-1]
        try:
            metric = ContinuationState.from_record(last["walk"]).metric
        except ValueError as error:
            raise unusable(last, error) from error
        traces.append(
            StoredTrace(
                count=len(points),
                largest=last["curve"],
                is_complete=is_complete,
                last=None if is_complete else last_point(family, {key: last["values"][key] for key in free}, points),
                condition=last["condition"],
                metric=metric,
            )
        )
    return traces


def resumable_trace(records: Sequence[TraceRecord], exhausted: Callable[[int], str | None]) -> list[TraceRecord]:
    """The records from which an unfinished trace is resumed.

    Special points after the last point are dropped, because they are located again.

    Parameters
    ----------
    exhausted : function of the number of points of a walk that says why the walk pauses there; None if it proceeds.
    """
    kept = list[TraceRecord]()
    for walk in _walks(records):
        points = [k for k, record in enumerate(walk) if record["record"] == "point"]
        end = walk[-1]
        ended = end["record"] == "special" and end["type"] == "end"
        paused = ended and end["record"] == "special" and end.get("open") and exhausted(len(points)) is None
        kept += walk if ended and not paused else walk[: points[-1] + 1]
        if paused or not ended:
            break
    return kept


def _walks(records: Sequence[TraceRecord]) -> list[list[TraceRecord]]:
    """The records of each walk: up to the end of its curve."""
    walks = list[list[TraceRecord]]()
    begins = True
    for record in records:
        if begins:
            walks.append([])
        walks[-1].append(record)
        begins = record["record"] == "special" and record["type"] == "end"
    return [walk for walk in walks if any(record["record"] == "point" for record in walk)]
