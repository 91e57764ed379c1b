"""A special point of a family traced in two parameters: the gaits of the curve, and its codimension-two points."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.display import counted
from gaitopt.gait.branch import ContinuationState, SpecialPoint
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import ConditionRecord, TraceRecord
from gaitopt.model.cycle import Cycle
from gaitopt.model.modes import Mode
from gaitopt.problem.statement import cycle_data


class MonitorKey(NamedTuple):
    """The quantity that a monitor of a mode sequence watches.

    Attributes
    ----------
    kind : ``duration``, ``onset``, ``pull``, ``breakpoint`` or the name of a margin; ``touchdown`` is a second
        touchdown within the step. For named contacts, ``onset`` and ``pull`` include the name of the contact.
    phase : index of the phase, None for an impact.
    step : index of the step that an impact ends.
    """

    kind: str
    phase: int | None = None
    step: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveStart:
    """A gait through which a curve of special points passes, or at which it begins.

    Attributes
    ----------
    type : type of all gaits of the curve: ``fold``, ``period_doubling``, ``neimark_sacker`` or ``margin``.
    parameter : dotted key of the first parameter.
    gait : the gait.
    margin : the margin that vanishes along the curve; None for a bifurcation.
    kappa : approximate cosine of the angle of the pair of multipliers on the unit circle, for Neimark-Sacker points.
    """

    type: str
    parameter: str
    gait: Gait
    margin: MonitorKey | None = None
    kappa: float = 0.0

    @staticmethod
    def from_record(record: ConditionRecord, parameter: str, gait: Gait) -> "CurveStart":
        """The start that ``to_record`` has written."""
        margin = record.get("margin")
        return CurveStart(
            type=record["type"],
            parameter=parameter,
            gait=gait,
            margin=None if margin is None else MonitorKey(**margin),
            kappa=record.get("kappa", 0.0),
        )

    @property
    def condition(self) -> str:
        """The condition along the curve as text: the margin that vanishes, or the type of bifurcation."""
        return self.type if self.margin is None else f"{self.type} {self.margin.kind}"

    def to_record(self) -> ConditionRecord:
        """One JSON object, without the gait."""
        record: ConditionRecord = {"type": self.type}
        if self.margin is not None:
            kind, phase, step = self.margin
            record["margin"] = {"kind": kind, "phase": phase, "step": step}
        if self.type == "neimark_sacker":
            record["kappa"] = self.kappa
        return record


@dataclass(frozen=True, slots=True, kw_only=True)
class TracePoint(ReadOnlyArrays):
    """One gait of a curve of special points.

    Attributes
    ----------
    curve : number of the curve; it changes with the mode sequence.
    index : number of the point within its curve.
    values : both parameters by dotted key.
    gait : the gait with its motion.
    condition : the condition that holds along the curve, as in the record of a ``CurveStart``.
    tangent : ndarray - unit tangent of the curve in scaled section coordinates, durations and parameters.
    length : arclength to the next trial point.
    walk : state of the continuation at this point.
    """

    curve: int
    index: int
    values: Mapping[str, float]
    gait: Gait
    condition: ConditionRecord
    tangent: Array
    length: float
    walk: ContinuationState | None = None

    def __repr__(self) -> str:
        return f"<TracePoint {self.curve}.{self.index} at {_point_text(self.values)}: {self.gait!r}>"

    def to_record(self) -> dict[str, Any]:
        """One JSON object: the keys of a gait, and its position on the curve."""
        return {
            "record": "point",
            "curve": self.curve,
            "index": self.index,
            "values": dict(self.values),
            **self.gait.to_record(),
            "condition": self.condition,
            "tangent": self.tangent.tolist(),
            "length": self.length,
            "walk": None if self.walk is None else self.walk.to_record(),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceSpecial:
    """A codimension-two point of a curve, or its end.

    Attributes
    ----------
    curve : number of its curve.
    type : name of the point, such as ``resonance_1_2``, ``fold_flip``, ``margin_crossing`` or ``margin_fold``; or
        ``end``.
    values : both parameters by dotted key.
    codimension : 2, or 1 for the end of a curve at a bound of the request.
    status : ``converged`` if located to machine precision, ``guess`` if only bracketed.
    reason : an explanation, if any.
    coefficients : coefficients of the normal form of the curve's bifurcation; None at a resonance that has none.
    next : the curves that begin at this point or pass through it, each with the gait from which ``gaitopt.trace``
        follows it.
    before, after : mode sequences on both sides of a margin.
    bound : whether this end is a bound of the request; the curve itself continues beyond it.
    open : whether the continuation would proceed with more points or more time.
    gait : the gait at this point.
    """

    curve: int
    type: str
    values: Mapping[str, float]
    codimension: int
    status: str
    reason: str = ""
    coefficients: Mapping[str, float | None] = field(default_factory=dict)
    next: tuple[CurveStart, ...] = ()
    before: Cycle | None = None
    after: Cycle | None = None
    bound: bool = False
    open: bool = False
    gait: Gait | None = None

    def __repr__(self) -> str:
        reason = f": {self.reason}" if self.reason else ""
        at = _point_text(self.values)
        return f"<TraceSpecial {self.type} at {at} (curve {self.curve}, {self.status}){reason}>"

    def to_record(self) -> dict[str, Any]:
        """One JSON object with the keys of the command line."""
        record: dict[str, Any] = {
            "record": "special",
            "curve": self.curve,
            "type": self.type,
            "values": dict(self.values),
            "codimension": self.codimension,
            "status": self.status,
            "reason": self.reason,
            "coefficients": dict(self.coefficients),
            "next": [
                start.to_record() | ({} if start.gait is self.gait else {"gait": start.gait.to_record()})
                for start in self.next
            ],
        }
        record |= {name: True for name, holds in (("bound", self.bound), ("open", self.open)) if holds}
        for key, cycle in (("from", self.before), ("to", self.after)):
            if cycle is not None:
                record[key] = cycle_data(cycle)
        record["gait"] = {} if self.gait is None else self.gait.to_record()
        return record


@dataclass(frozen=True, kw_only=True)
class Trace:
    """The curves of a special point over two parameters: their points, and their special points, in order.

    Attributes
    ----------
    parameters : dotted keys of both parameters, that of the branch first.
    type : type of the special point with which the trace began.
    points, specials : points and special points in the order of the continuation; consecutive points of the same mode
        sequence have the same curve number.
    """

    parameters: tuple[str, str]
    type: str
    points: tuple[TracePoint, ...] = ()
    specials: tuple[TraceSpecial, ...] = ()

    def __repr__(self) -> str:
        counts = f"{counted(len(self), 'point')}, {counted(len(self.specials), 'special point')}"
        return f"<Trace of a {self.type} over {' and '.join(self.parameters)}: {counts}>"

    def __len__(self) -> int:
        return len(self.points)

    def __iter__(self) -> Iterator[TracePoint]:
        return iter(self.points)

    @property
    def values(self) -> Array:
        """Both parameters at every point; shape (n, 2)."""
        return np.array([[point.values[key] for key in self.parameters] for point in self.points]).reshape(-1, 2)

    def special(self, kind: str) -> tuple[TraceSpecial, ...]:
        """Special points of a type."""
        return tuple(special for special in self.specials if special.type == kind)

    def to_records(self) -> list[dict[str, Any]]:
        """The JSON objects of all points, then of all special points."""
        return [*(point.to_record() for point in self.points), *(special.to_record() for special in self.specials)]


def collected_trace(start: SpecialPoint | CurveStart, key: str, records: Sequence[TracePoint | TraceSpecial]) -> Trace:
    """The trace of points and special points in the order in which they were computed."""
    return Trace(
        parameters=(start.parameter, key),
        type=start.type,
        points=tuple(record for record in records if isinstance(record, TracePoint)),
        specials=tuple(record for record in records if isinstance(record, TraceSpecial)),
    )


def trace_table(records: Sequence[TraceRecord]) -> tuple[list[str], list[list[Any]]]:
    """Header and rows of the table of a trace: points and special points in the order of their records."""
    first = next(record for record in records if record["record"] == "point")
    scalars = [k for k, v in first.items() if isinstance(v, int | float) and k not in ("curve", "index")]
    states = [f"state.{name}" for name in first["state"]]
    header, rows = ["curve", "index", *first["values"], "type", "phases", "impact", *states, *scalars], []
    for record in records:
        gait: Mapping[str, Any] = record if record["record"] == "point" else record["gait"]
        row: dict[str, Any] = {**gait, **record, **record["values"]}
        row["type"] = "point" if record["record"] == "point" else record["type"]
        row |= {f"state.{name}": value for name, value in gait["state"].items()}
        row["phases"] = " ".join(Mode.from_record(phase).brief for phase in gait["phases"])
        rows.append([row.get(column) for column in header])
    return header, rows


def _point_text(values: Mapping[str, float]) -> str:
    return ", ".join(f"{key} = {value:.9g}" for key, value in values.items())
