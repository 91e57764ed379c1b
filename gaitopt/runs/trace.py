"""A trace in two parameters that is stored in a run folder, and read back from it."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from gaitopt.branches.request import Request, motionless_gait
from gaitopt.callbacks import Stop
from gaitopt.errors import StorageError
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import CheckedTracePoint, TraceRecord, TraceRequestRecord, TraceSpecialRecord
from gaitopt.gait.trace import CurveStart, Trace, TracePoint, TraceSpecial, trace_table
from gaitopt.problem.problem import Problem
from gaitopt.requests import TraceRequest, entries
from gaitopt.runs.lines import LinesPlan
from gaitopt.store.formats import damaged, validated
from gaitopt.store.gaits import closing_error, problem_of_record, trace_point, trace_special
from gaitopt.store.run import Run
from gaitopt.store.trace import resumable_trace, stored_traces

TRACE_FILE = "trace.jsonl"
LARGEST_CLOSING_ERROR = 1e-6
"""Largest difference between the states at the start and the end of a cycle, in natural units."""


@dataclass(frozen=True, kw_only=True)
class TracePlan(LinesPlan[CurveStart, TraceRecord]):
    """A special point to be followed in two parameters, and the run folder in which the trace is stored.

    Attributes
    ----------
    request : the request of the trace.
    start : where it begins.
    """

    noun: ClassVar[str] = "trace"
    file: ClassVar[str] = TRACE_FILE
    table: ClassVar[str] = "trace.csv"
    effort: ClassVar[tuple[str, ...]] = tuple(n for n, entry in entries(TraceRequest).items() if entry.about.effort)

    request: TraceRequest
    start: CurveStart

    @property
    def head(self) -> dict[str, Any]:
        """The request, and what is followed."""
        request = {name: getattr(self.request, name) for name in entries(TraceRequest)}
        record = {"record": "trace", "parameter": self.start.parameter, **request, "to": list(self.request.to)}
        return record | self.start.to_record()

    @property
    def name(self) -> str:
        """Type of the special point, second parameter and targets."""
        margin = self.start.margin[0] if self.start.margin else ""
        targets = "_".join(f"{to:g}" for to in self.request.to)
        words = filter(None, ("trace", margin or self.start.type, self.start.parameter, self.request.key, targets))
        return re.sub(r"[^0-9A-Za-z._]+", "-", "-".join(words))

    def read(self) -> tuple[Mapping[str, Any] | None, list[TraceRecord]]:
        """See ``LinesPlan``."""
        return read_trace(self.run, self.problem)

    def resumable(self, records: list[TraceRecord]) -> list[TraceRecord]:
        """See ``LinesPlan``."""
        limits = Request(parameter=self.request.key, to=self.request.to, max_points=self.request.max_points)
        return resumable_trace(records, limits.exhausted)

    def follow(
        self, start: CurveStart, done: list[TraceRecord], should_stop: Stop
    ) -> Iterable[TracePoint | TraceSpecial]:
        """See ``LinesPlan``."""
        from gaitopt.branches.trace import follow_curve  # reading a stored trace needs no continuation

        family = traced_family(self.problem, start.parameter, self.request.key)
        stored = stored_traces(family, (start.parameter, self.request.key), done)
        return follow_curve(start, self.request, done=stored, should_stop=should_stop)

    def rows(self, records: list[TraceRecord]) -> tuple[list[str], list[list[Any]]]:
        """See ``LinesPlan``."""
        return trace_table(records)


def traced_family(problem: Problem, first: str, second: str) -> Gait:
    """A gait without a motion, with the friction law that has both parameters."""
    family = motionless_gait(problem, first)
    return motionless_gait(family.problem, second)


def stored_trace(folder: Path) -> tuple[Problem, TraceRequestRecord, list[TraceRecord]]:
    """Problem, request and records of the trace in a run folder.

    Raises
    ------
    StorageError
        If the folder is not a run, is broken or newer, or its trace has no point.
    """
    run = Run(folder)
    problem = run.problem()
    request, records = read_trace(run, problem)
    if request is None or not any(record["record"] == "point" for record in records):
        raise StorageError(f"{folder / TRACE_FILE} contains no trace yet; `gaitopt trace` writes one")
    first = next(record for record in records if record["record"] == "point")
    return problem_of_record(problem, first), request, records


def restore_trace(folder: Path) -> Trace:
    """The trace in a run folder; raises as ``stored_trace``, and if the motion of a point is not periodic."""
    problem, request, records = stored_trace(folder)
    first, second = request["parameter"], request["key"]
    family, path = traced_family(problem, first, second), folder / TRACE_FILE
    points, specials = list[TracePoint](), list[TraceSpecial]()
    try:
        for record in records:
            if record["record"] == "special":
                specials.append(trace_special(family, first, record))
                continue
            point = trace_point(family, record)
            growth = max(1.0, point.gait.spectral_radius or 0.0)
            if not closing_error(point.gait.steps) < LARGEST_CLOSING_ERROR * growth:
                raise damaged(path, f"point {point.curve}.{point.index}: its motion is not periodic")
            points.append(point)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise StorageError(f"{path} does not contain a trace ({error!r})") from error
    parameters = (first, second)
    return Trace(parameters=parameters, type=request["type"], points=tuple(points), specials=tuple(specials))


def read_trace(run: Run, problem: Problem) -> tuple[TraceRequestRecord | None, list[TraceRecord]]:
    """The request of the trace of a problem in a run, and its records; None and no records if there is none."""
    path, lines = run.path(TRACE_FILE), run.lines(TRACE_FILE)
    if not lines:
        return None, []
    request = validated(TraceRequestRecord, lines[0], path, 1)
    keys, records = [request["parameter"], request["key"]], list[TraceRecord]()
    for number, line in enumerate(lines[1:], start=2):
        model: Any = TraceSpecialRecord if line.get("record") == "special" else CheckedTracePoint
        record: TraceRecord = validated(model, line, path, number, states=problem.walker.state_names())
        if [*record["values"]] != keys:
            raise damaged(path, f"values: must be those of {' and '.join(keys)}", number)
        for key, value in record["values"].items():
            objection = problem.objection(key, value) if key in problem.parameters else None
            if objection:
                raise damaged(path, f"values.{key}: {objection}", number)
        records.append(record)
    return request, records
