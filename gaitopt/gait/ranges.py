"""The result of a design over a range of a parameter: objective, stability and constraints along the range."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class RangePoint:
    """The gait of a design at one value of the parameter.

    Attributes
    ----------
    value : value of the parameter.
    objective, spectral_radius : objective and spectral radius of the gait at this value.
    sequence : phases and impact of the gait as a text.
    """

    value: float
    objective: float
    spectral_radius: float
    sequence: str


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignRange:
    """A design over a range of a parameter.

    Attributes
    ----------
    key, lower, upper : dotted key of the parameter, and both ends of its range.
    aggregate : the number that was minimised: the ``worst`` value of the objective over the range, its ``mean``, or the
        value ``at`` one value of the parameter.
    at : value of the parameter at which the objective counts if ``aggregate`` is ``at``.
    objective : the minimised value; None if there is no objective, or no design.
    worst_at : value of the parameter at which the objective is largest.
    binding : for each constraint that is at its bound, by name, the value of the parameter where it is.
    scenarios : values of the parameter whose gaits were designed together.
    single : objective at the problem's own value if the design is made for this value alone.
    points : the gaits along the range, confirmed by continuation.
    widest : the widest range for which a control was found; None if one was found for the whole range.
    """

    key: str
    lower: float
    upper: float
    aggregate: str
    at: float
    objective: float | None = None
    worst_at: float | None = None
    binding: Mapping[str, float] = field(default_factory=dict)
    scenarios: tuple[float, ...] = ()
    single: float | None = None
    points: tuple[RangePoint, ...] = ()
    widest: tuple[float, float] | None = None

    def to_record(self) -> dict[str, Any]:
        """One JSON object: the entry ``over`` of the gait's record."""
        return {
            "parameter": self.key,
            "range": [self.lower, self.upper],
            "aggregate": self.aggregate,
            "at": self.at,
            "objective": self.objective,
            "worst_at": self.worst_at,
            "binding": dict(self.binding),
            "scenarios": [*self.scenarios],
            "single": self.single,
            "points": {
                "value": [point.value for point in self.points],
                "objective": [point.objective for point in self.points],
                "spectral_radius": [point.spectral_radius for point in self.points],
                "sequence": [point.sequence for point in self.points],
            },
        }

    @staticmethod
    def from_record(record: Mapping[str, Any]) -> "DesignRange":
        """The inverse of ``to_record``."""
        columns = record["points"]
        rows = zip(*(columns[name] for name in RangePoint.__dataclass_fields__), strict=True)
        points = (RangePoint(value=v, objective=f, spectral_radius=r, sequence=s) for v, f, r, s in rows)
        return DesignRange(
            key=record["parameter"],
            lower=record["range"][0],
            upper=record["range"][1],
            aggregate=record["aggregate"],
            at=record["at"],
            objective=record["objective"],
            worst_at=record["worst_at"],
            binding=record["binding"],
            scenarios=tuple(record["scenarios"]),
            single=record["single"],
            points=tuple(points),
        )
