"""A trace in two parameters that is stored in a run folder, and read back from it."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from gaitopt.branches.request import motionless_gait
from gaitopt.callbacks import Stop
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import CheckedTracePoint, TraceRecord, TraceRequestRecord, TraceSpecialRecord
from gaitopt.gait.trace import CurveStart, Trace, TracePoint, TraceSpecial, trace_table
from gaitopt.problem.problem import Problem
from gaitopt.requests import TraceRequest
from gaitopt.runs.lines import CurveFile, LinesPlan
from gaitopt.store.branch import resumable_trace, stored_traces
from gaitopt.store.gaits import trace_point, trace_special

TRACE_FILE = "trace.jsonl"


def _fault(problem: Problem, request: TraceRequestRecord, record: TraceRecord) -> str:
    """The fault of a point or special point of a trace, as text; empty if there is none."""
    keys = [request["parameter"], request["key"]]
    if [*record["values"]] != keys:
        return f"values: must be those of {' and '.join(keys)}"
    for key, value in record["values"].items():
        objection = problem.objection(key, value) if key in problem.parameters else None
        if objection:
            return f"values.{key}: {objection}"
    return ""


TRACE = CurveFile(
    noun="trace", command="trace", name=TRACE_FILE, table="trace.csv", number="curve",
    request=TraceRequestRecord, point=CheckedTracePoint,
    special=TraceSpecialRecord, fault=_fault, rows=trace_table,
)  # fmt: skip
"""The file of a trace."""


@dataclass(frozen=True, kw_only=True)
class TracePlan(LinesPlan[CurveStart, TraceRecord]):
    """A special point to be followed in two parameters, and the run folder in which the trace is stored.

    Attributes
    ----------
    start : the gait and the condition from which the trace begins.
    """

    file: ClassVar[CurveFile] = TRACE

    request: TraceRequest
    start: CurveStart

    @property
    def head(self) -> dict[str, Any]:
        """The request, and the condition that holds along the curve."""
        request = {**self.request.arguments, "to": list(self.request.to)}
        return {"record": "trace", "parameter": self.start.parameter, **request, **self.start.to_record()}

    @property
    def name(self) -> str:
        """Type of the special point, second parameter and targets."""
        margin = self.start.margin[0] if self.start.margin else ""
        targets = "_".join(f"{to:g}" for to in self.request.to)
        names = filter(None, ("trace", margin or self.start.type, self.start.parameter, self.request.key, targets))
        return re.sub(r"[^0-9A-Za-z._]+", "-", "-".join(names))

    def resumable(self, records: list[TraceRecord]) -> list[TraceRecord]:
        """See ``LinesPlan``."""
        from gaitopt.branches.trace import in_second  # reading a stored trace needs no continuation

        return resumable_trace(records, in_second(self.request).exhausted)

    def follow(
        self, start: CurveStart, done: list[TraceRecord], should_stop: Stop
    ) -> Iterable[TracePoint | TraceSpecial]:
        """See ``LinesPlan``."""
        from gaitopt.branches.trace import follow_curve

        family = traced_family(self.problem, start.parameter, self.request.key)
        stored = stored_traces(family, (start.parameter, self.request.key), done)
        return follow_curve(start, self.request, done=stored, should_stop=should_stop)


def traced_family(problem: Problem, first: str, second: str) -> Gait:
    """A gait without a motion, with the friction law that has both parameters."""
    family = motionless_gait(problem, first)
    return motionless_gait(family.problem, second)


def restore_trace(folder: Path) -> Trace:
    """The trace in a run folder; raises the errors of ``CurveFile.stored`` and ``CurveFile.restored``."""
    problem, request, records = TRACE.stored(folder)
    first, second = request["parameter"], request["key"]
    family = traced_family(problem, first, second)
    points, specials = TRACE.restored(
        folder, records, partial(trace_point, family), partial(trace_special, family, first)
    )
    return Trace(parameters=(first, second), type=request["type"], points=points, specials=specials)
