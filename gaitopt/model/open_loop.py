"""Open-loop torques: functions of the time since the impact only, on N equal intervals of a duration T.

    constant    u(t) = c_k                                        on  k T / N <= t < (k + 1) T / N
    linear      u(t) = c_k + (c_(k+1) - c_k) (N t / T - k)

In a problem without ``duration`` the values c_k are unknowns, and T is the period of the gait that is sought
(``gaitopt.design.open_loop``). With ``duration`` the law is fixed in time, and its last piece extends beyond T.
"""

from collections.abc import Iterator, Mapping
from enum import StrEnum
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from casadi import SX, dot
from pydantic import ConfigDict, Field, create_model, model_validator

from gaitopt.arrays import Array
from gaitopt.display import counted
from gaitopt.model.control import OF_MOTOR, Control, Fixed, SectionType, unknown_actuators
from gaitopt.model.declaration import actuator_units, joint_limits
from gaitopt.model.instant import Instant
from gaitopt.model.reference import Path
from gaitopt.model.units import MOTOR_WORDS, Duration, Finite, Positive, Within
from gaitopt.model.walker import WalkerType

MOST_INTERVALS = 200
"""Largest number of intervals: the time of an optimisation grows with it, and torques of a step need far fewer."""
Bounds = Annotated[tuple[Finite, ...], Field(min_length=2, max_length=2)]


class Order(StrEnum):
    """Torques on an interval: constant, or linear and then continuous."""

    CONSTANT = "constant"
    LINEAR = "linear"


class OpenLoop(Control):
    """Torques as functions of time, which an optimisation finds."""

    model_config = ConfigDict(frozen=True, extra="allow", validate_default=True)
    __pydantic_extra__: dict[str, tuple[Finite, ...]]

    type = "open_loop"
    jumps = True

    intervals: Annotated[
        int, Field(ge=1, le=MOST_INTERVALS, strict=True, description="number of equal intervals of the period")
    ]
    order: Annotated[Order, Field(description="torques are constant on each interval, or linear and continuous")] = (
        Order.LINEAR
    )
    duration: Annotated[
        Duration | None,
        Fixed,
        Field(description="duration of all intervals together [s], if torques are known; by default that of the gait"),
        Within(unit="time", possible=(0, 1000), usual=(0.1, 50)),
    ] = None
    bounds: Annotated[
        dict[str, Bounds],
        Field(
            description="lower and upper bound of the torque or force of each motor [N m, or N]; by default its effort"
        ),
    ] = {}  # noqa: RUF012 - pydantic copies it
    rates: Annotated[
        dict[str, Positive],
        Fixed,
        Field(description="largest rate of the torque or force of each motor [N m/s, or N/s]; linear order only"),
    ] = {}  # noqa: RUF012

    @classmethod
    def section(cls, walker: WalkerType) -> SectionType:
        """The keys of the class, and one key for each actuator."""
        return _section(walker)

    @model_validator(mode="before")
    @classmethod
    def _zeros(cls, data: Any) -> Any:
        """Fill in zeros as the first guess of torques that are left out."""
        if not (isinstance(data, Mapping) and isinstance(data.get("intervals"), int)):
            return data
        count = data["intervals"] + (data.get("order", Order.LINEAR) == Order.LINEAR)
        names = {*data} - {*cls.model_fields}
        return {key: (0.0,) * count if key in names and value is None else value for key, value in data.items()}

    @property
    def count(self) -> int:
        """Number of values of each motor."""
        return self.intervals + (self.order is Order.LINEAR)

    @property
    def values(self) -> dict[str, tuple[float, ...]]:
        """Values c_k by actuator [N m]."""
        return dict(self.__pydantic_extra__)

    @property
    def parameters(self) -> dict[str, float]:
        """The values by the keys ``ACTUATOR.K``, and the limits."""
        rows = {f"{name}.{k}": value for name, row in self.values.items() for k, value in enumerate(row)}
        return rows | {f"limits.{name}": value for name, value in self.limits.items()}

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which one interval ends and the next begins [s]."""
        return (
            () if self.duration is None else tuple(self.duration * k / self.intervals for k in range(1, self.intervals))
        )

    @property
    def untimed(self) -> "OpenLoop":
        """The law of unit intervals: start and length of an interval are segment data."""
        return self if self.duration is None else self.model_copy(update={"duration": None})

    def data(self, segment: int) -> Array:
        """Start and length of an interval, and a weight for every interval: 1 for this one, 0 for the others."""
        length = 1.0 if self.duration is None else self.duration / self.intervals
        return np.concatenate([[length * segment, length], np.eye(self.intervals)[segment]])

    def faults(self, walker: WalkerType) -> Iterator[tuple[Path, str]]:
        """Errors about motors that the walker does not have, empty ranges, and wrong numbers of values."""
        yield from super().faults(walker)
        yield from unknown_actuators(walker, bounds=self.bounds, rates=self.rates)
        if self.rates and self.order is Order.CONSTANT:
            yield ("rates",), "limits the rate of torques that jump: write order: linear, or leave rates out"
        for name, (lower, upper) in self.bounds.items():
            if lower >= upper:
                message = f"[{lower:g}, {upper:g}] is empty: the lower bound comes first"
                message += f"; did you mean [{-abs(upper):g}, {abs(upper):g}]?" if lower == -upper != 0 else ""
                yield ("bounds", name), message
        spans = self.spans(walker)
        for name, row in self.values.items():
            lower, upper = spans.get(name, (-np.inf, np.inf))
            if len(row) != self.count:
                intervals = counted(self.intervals, f"{self.order} interval")
                yield (name,), f"has {counted(len(row), 'value')}, must have {self.count} for {intervals}"
            if lower < upper and not lower <= 0 <= upper and not any(row):
                reason = f"[{lower:g}, {upper:g}] excludes zero, the first guess of the torque of {name}"
                yield (
                    ("bounds", name),
                    f"{reason}; did you mean [{-abs(upper):g}, {abs(upper):g}]? Else give {name}: [...]",
                )
                continue
            for k, value in enumerate(row):
                if lower < upper and not lower <= value <= upper:
                    yield (name, k), f"{value:g} is outside of the bounds [{lower:g}, {upper:g}] of {name}"

    def spans(self, walker: WalkerType) -> dict[str, tuple[float, float]]:
        """Range of the torque of every motor: ``bounds``, or the effort of its joint if there is one, or no limit."""
        efforts = {name: effort for name, (_, effort) in joint_limits(walker).items() if effort is not None}
        largest = {name: efforts.get(name, np.inf) for name in walker.actuators}
        return {name: (-limit, limit) for name, limit in largest.items()} | {
            name: (lower, upper) for name, (lower, upper) in self.bounds.items()
        }

    def unknowns(self, walker: WalkerType) -> dict[str, tuple[float, float]]:
        """Bounds of the values, unless the law is fixed in time."""
        if self.duration is not None:
            return {}
        return {f"{name}.{k}": span for name, span in self.spans(walker).items() for k in range(self.count)}

    def guesses(self, values: Mapping[str, float], walker: WalkerType) -> dict[str, object]:
        """The values of all motors, if they are known."""
        rows = {name: [values.get(f"control.{name}.{k}") for k in range(self.count)] for name in walker.actuators}
        if self.duration is not None or any(value is None for row in rows.values() for value in row):
            return {}
        return {f"control.{name}": row for name, row in rows.items()}

    def fixed(self, values: Mapping[str, float], duration: float) -> "OpenLoop":
        """The law with known values, given by dotted keys of a problem, and fixed in time.

        Raises
        ------
        KeyError
            If a value is missing.
        """
        rows = {name: tuple(values[f"control.{name}.{k}"] for k in range(self.count)) for name in self.values}
        return self.model_validate({**self.model_dump(), **rows, "duration": duration})

    def torques(self, now: Instant) -> Mapping[str, SX]:
        """The torques in the interval of the segment data."""
        s, selected = (now.t - now.r[0]) / now.r[1], now.r[2:]

        def torque(c: SX) -> SX:
            if self.order is Order.CONSTANT:
                return dot(selected, c)
            start, end = dot(selected, c[:-1]), dot(selected, c[1:])
            return start + (end - start) * s

        return {name: torque(SX(getattr(now.p, name))) for name in self.values}


@lru_cache(maxsize=64)
def _section(walker: WalkerType) -> SectionType:
    """The keys of open-loop torques for a walker."""
    fields: dict[str, Any] = {
        name: (entry.annotation if not entry.metadata else Annotated[(entry.annotation, *entry.metadata)], entry)
        for name, entry in OpenLoop.model_fields.items()
    }
    template = "values of the {} of the {} [{}]: a first guess, or with a duration the known values; zero if left out"
    for name, unit in actuator_units(walker).items():
        described = Field(description=template.format(MOTOR_WORDS[unit], name.replace("_", " "), unit))
        fields[name] = (Annotated[tuple[Finite, ...] | None, described, OF_MOTOR[unit]], None)
    return create_model(
        "OpenLoopSection", __config__=ConfigDict(frozen=True, extra="forbid"), __doc__=OpenLoop.__doc__, **fields
    )
