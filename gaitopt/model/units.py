"""Units: the natural units of a walker, ranges of numbers in these units, and the types of parameters.

    length l,    time sqrt(l / g),    mass m,    speed sqrt(g l),    force m g,    torque and energy m g l

l is the distance of the farthest body from the stance foot with all shape coordinates zero: the length of a straight
leg. Every tolerance, time limit and step length is in natural units, so that dimensionless results do not depend on the
units of a problem. A number outside its possible range causes an error, outside its usual range a remark.

Numbers in problem files are in SI units; angles may be in ``deg`` or ``rad``. This table of units is closed, because a
general units library would parse and evaluate arbitrary expressions.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Generic, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)


@dataclass(frozen=True, slots=True)
class Scales:
    """Natural units of one walker at given parameters.

    Attributes
    ----------
    length : unit of length [m].
    time : unit of time [s].
    mass : unit of mass [kg].
    """

    length: float
    time: float
    mass: float

    @classmethod
    def of(cls, length: float, gravity: float, mass: float) -> "Scales":
        """The units of a walker with this length of a leg [m] and total mass [kg] under this gravity [m/s^2]."""
        return cls(length=float(length), time=math.sqrt(length / gravity), mass=float(mass))

    @property
    def speed(self) -> float:
        """Length per time, sqrt(g l) [m/s]."""
        return self.length / self.time

    @property
    def force(self) -> float:
        """The weight m g [N]."""
        return self.mass * self.length / self.time**2

    @property
    def impulse(self) -> float:
        """Force times time [N s]."""
        return self.force * self.time

    @property
    def energy(self) -> float:
        """Weight times length, also the unit of torque [J]."""
        return self.force * self.length


Checked = TypeVar("Checked", bound=BaseModel)
Value = TypeVar("Value")
UNITS: Mapping[str, tuple[str, Callable[[Scales], float]]] = {
    "one": ("", lambda s: 1.0),
    "angle": (" rad", lambda s: 1.0),
    "mass": (" m", lambda s: s.mass),
    "length": (" l", lambda s: s.length),
    "time": (" sqrt(l/g)", lambda s: s.time),
    "rate": (" sqrt(g/l)", lambda s: 1 / s.time),
    "speed": (" sqrt(g l)", lambda s: s.speed),
    "force": (" m g", lambda s: s.force),
    "impulse": (" m sqrt(g l)", lambda s: s.impulse),
    "torque": (" m g l", lambda s: s.energy),
    "damping": (" m g l sqrt(l/g)", lambda s: s.energy * s.time),
    "stiffness": (" m g/l", lambda s: s.force / s.length),
    "drag": (" m sqrt(g/l)", lambda s: s.mass / s.time),
    "inertia": (" m l^2", lambda s: s.mass * s.length**2),
    "torque_squared": (" (m g l)^2 sqrt(l/g)", lambda s: s.energy**2 * s.time),
    "torque_cost": (" (m g)^2 l sqrt(l/g)", lambda s: s.energy**2 * s.time / s.length),
}
"""Natural units: symbol and value in SI; l is the length of a leg, m the total mass, g gravity."""
SI = {
    "one": "1",
    "mass": "kg",
    "length": "m",
    "time": "s",
    "rate": "1/s",
    "speed": "m/s",
    "force": "N",
    "impulse": "N s",
    "torque": "N m",
}
"""SI units of margins by their natural unit."""
OF_FORCES = {
    "N m": "N",
    "N m/s": "N/s",
    "N m/rad": "N/m",
    "N m s/rad": "N s/m",
    "N^2 m^2 s": "N^2 s",
    "N^2 m s": "N^2 s/m",
    "rad": "m",
}
"""SI units of motors that act on lengths, by those of motors that act on angles."""
MOTOR_WORDS = {"N": "motor force", "N m": "torque"}
"""The name of a motor's force, by its unit."""
Interval = tuple[float, float]
ANY: Interval = (-math.inf, math.inf)


@dataclass(frozen=True, slots=True, kw_only=True)
class Within:
    """Annotation of a number: its range in a natural unit.

    Attributes
    ----------
    unit : a key of ``UNITS``.
    possible : lower and upper bound; values outside are errors.
    usual : lower and upper bound; values outside are probably mistakes.
    """

    unit: str = "one"
    possible: Interval = ANY
    usual: Interval = ANY

    def size(self, scales: Scales) -> float:
        """The natural unit in SI."""
        return UNITS[self.unit][1](scales)

    def bounds(self, scales: Scales) -> Interval:
        """The possible range in SI."""
        size = self.size(scales)
        return self.possible[0] * size, self.possible[1] * size

    def objection(self, lower: float, upper: float, scales: Scales) -> str | None:
        """Message if no value from ``lower`` to ``upper`` [SI] is possible; otherwise None."""
        lowest, highest = self.bounds(scales)
        if upper >= lowest and lower <= highest:
            return None
        value = upper if upper < lowest else lower
        stated, natural = _range_text((lowest, highest), ""), _range_text(self.possible, UNITS[self.unit][0])
        return f"{value:g} is impossible: must be {stated}{f' ({natural})' if natural != stated else ''}"

    def remark(self, lower: float, upper: float, scales: Scales) -> str | None:
        """Message if all values from ``lower`` to ``upper`` [SI] are unusual; otherwise None."""
        symbol, size = UNITS[self.unit][0], self.size(scales)
        if upper >= self.usual[0] * size and lower <= self.usual[1] * size:
            return None
        value = upper if upper < self.usual[0] * size else lower
        if self.unit == "angle" and value == float(f"{value:.3g}"):  # few digits: the user has typed this number
            return f"{value:g} rad is {math.degrees(value):.3g} deg; did you mean {value:g} deg?"
        natural = f", that is {value / size:.3g}{symbol}" if symbol else ""
        return f"{value:g}{natural} is unusual; usually {_range_text(self.usual, symbol)}"

    def __str__(self) -> str:
        symbol = UNITS[self.unit][0]
        spans = [("", self.possible), ("usually ", self.usual)]
        return "; ".join(f"{prefix}{_range_text(span, symbol)}" for prefix, span in spans if span != ANY)


class Free(BaseModel, Generic[Value]):
    """An unknown in place of a number: a design determines it within its bounds.

    The type of the values is that of the number; ``Free[Any]`` has values that are not read yet.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", title="Free", json_schema_extra={"description": "an unknown"}
    )

    free: Annotated[tuple[Value, Value], Field(description="bounds [lo, hi] of the unknown")]
    guess: Annotated[Value, Field(description="first guess, within the bounds")]

    @property
    def lower(self) -> Value:
        """The lower bound."""
        return self.free[0]

    @property
    def upper(self) -> Value:
        """The upper bound."""
        return self.free[1]

    @property
    def record(self) -> dict[str, Any]:
        """The unknown as data of a problem file."""
        return {"free": [*self.free], "guess": self.guess}

    def __repr_name__(self) -> str:
        return "Free"

    def near(self: "Free[float]", value: float) -> "Free[float]":
        """The same unknown, whose guess is the value within the bounds that is closest to ``value``."""
        return self.model_copy(update={"guess": float(min(max(value, self.lower), self.upper))})

    def faults(self: "Free[float]") -> Iterator[tuple[tuple[str, ...], str]]:
        """Keys whose values contradict each other, with a message for each."""
        span = f"[{self.lower:g}, {self.upper:g}]"
        if not self.lower < self.upper:
            yield ("free",), f"is empty: {span} needs lo < hi; for a fixed value, give a number"
        elif not self.lower <= self.guess <= self.upper:
            yield ("guess",), f"{self.guess:g} is outside of its bounds {span}"


def is_free(value: object) -> bool:
    """Whether data of a problem file state an unknown."""
    return isinstance(value, Mapping) and "free" in value


def one_of_two(is_second: Callable[[Any], bool], first: TypeAdapter[Any], second: TypeAdapter[Any]) -> WrapValidator:
    """A validator that reads a value in one of two forms, because the errors of a union of both are about both."""

    def read(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        return (second if is_second(value) else first).validate_python(value)

    return WrapValidator(read)


def number_or_free(number: TypeAdapter[float], free: TypeAdapter[Free[float]]) -> WrapValidator:
    """A validator that reads a mapping with the key ``free`` as an unknown, and any other value as a number."""
    return one_of_two(lambda value: is_free(value) or isinstance(value, Free), number, free)


def words_and_unit(description: str) -> tuple[str, str]:
    """The text and the unit of a description: ``radius; 0 is a point`` and ``m`` for ``radius [m]; 0 is a point``."""
    text, _, rest = description.partition(" [")
    unit, _, more = rest.partition("]")
    return text + more, unit


def symmetric(size: float) -> Interval:
    """The interval from minus ``size`` to ``size``."""
    return (-size, size)


def _range_text(span: Interval, unit: str) -> str:
    lowest, highest = (f"{value:g}{unit if value else ''}" for value in span)
    if span[0] == -span[1]:
        return f"at most {highest} in size"
    if math.isinf(span[0]):
        return f"at most {highest}"
    if math.isinf(span[1]):
        return f"at least {lowest}"
    return f"from {lowest} to {highest}"


def shorter(distance: str, length: str) -> Any:
    """A validator for the body of a walker's class: the ``distance`` of a mass must be less than the ``length`` [m]."""

    def check(model: Checked) -> Checked:
        value, limit = getattr(model, distance), getattr(model, length)
        if value >= limit:
            raise ValueError(
                f"{distance} = {value:g} m must be less than {length} = {limit:g} m: "
                "a mass at or beyond the hip leaves the swing leg without inertia or turns it over"
            )
        return model

    return model_validator(mode="after")(check)


ANGLE_UNITS = {"rad": 1.0, "deg": math.pi / 180}
DECIMAL = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
"""Pattern of a decimal number."""
_NUMBER = re.compile(rf"{DECIMAL}|[+-]?\.?(?:inf|nan)", re.IGNORECASE)
LONGEST_COUNT = 100
"""Largest number of digits of a whole number; Python's ``int`` reads some thousand."""
_ANGLE = re.compile(rf"\s*({DECIMAL})\s*(deg|rad)\s*")


def parse_number(text: str) -> float:
    """The value of a decimal number, ``inf`` or ``nan``.

    Python's ``float`` also reads ``1_0`` and digits of other scripts, which are mistakes in a file or an option.

    Raises
    ------
    ValueError
        If the text is not such a number.
    """
    if _NUMBER.fullmatch(text.strip()) is None:
        raise ValueError(f"{text.strip()!r} is not a number: write decimal digits, such as 0.25 or 2.5e-1")
    return float(text.replace(".inf", "inf").replace(".nan", "nan"))


def parse_count(text: str) -> int | None:
    """The whole number that at most ``LONGEST_COUNT`` ASCII digits state; None for any other text."""
    return int(text) if len(text) <= LONGEST_COUNT and text.isascii() and text.isdecimal() else None


def parse_angle(value: object) -> object:
    """The angle of a text like ``"1 deg"`` or ``"0.1 rad"`` in radians; a value that is not a text is not changed.

    Raises
    ------
    ValueError
        If a text is not a number followed by ``deg`` or ``rad``.
    """
    if not isinstance(value, str):
        return value
    match = _ANGLE.fullmatch(value)
    if match is None:
        raise ValueError("write an angle as a number in rad, or with its unit: 1 deg, 0.1 rad")
    return float(match[1]) * ANGLE_UNITS[match[2]]


SMALLEST_SIZE, LARGEST_SIZE = 1e-30, 1e30
"""Bounds of masses, lengths and forces, within which their products neither vanish nor overflow in any units."""
STEEPEST = math.radians(80)
"""Steepest slope [rad]. Steady walking needs the friction tan(slope), which is nearly 6 there."""

Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
"""A number whose range depends on the walker."""
Number = Annotated[Finite, Field(ge=-LARGEST_SIZE, le=LARGEST_SIZE)]
"""A finite number."""
Positive = Annotated[Number, Field(ge=SMALLEST_SIZE)]
"""A finite number above zero."""
NonNegative = Annotated[Number, Field(ge=0)]
"""A finite number, zero allowed."""
Angle = Annotated[Number, BeforeValidator(parse_angle)]
"""A finite angle [rad]; texts such as ``1 deg`` are converted."""
Duration = Annotated[Finite, Field(ge=SMALLEST_SIZE)]
"""A time [s]."""
DURATION = Within(unit="time", possible=(0, 1000), usual=(0, 50))
Stiffness = Annotated[NonNegative, Within(unit="stiffness", possible=(0, 1e6), usual=(0, 1e4))]
"""Stiffness of a spring along a line [N/m]."""
TurningStiffness = Annotated[NonNegative, Within(unit="torque", possible=(0, 1e6), usual=(0, 1e3))]
"""Stiffness of a spring in a joint [N m/rad]."""
Damping = Annotated[NonNegative, Within(unit="drag", possible=(0, 1e4), usual=(0, 100))]
"""Coefficient of a damper along a line [N s/m]."""
TurningDamping = Annotated[NonNegative, Within(unit="damping", possible=(0, 1e4), usual=(0, 100))]
"""Coefficient of a damper in a joint [N m s/rad]."""
Inertia = Annotated[NonNegative, Within(unit="inertia", possible=(0, 100), usual=(0, 1))]
"""Moment of inertia about the centre of mass [kg m^2]."""
Slope = Annotated[Angle, Field(ge=-STEEPEST, le=STEEPEST), Within(unit="angle", usual=symmetric(math.radians(30)))]
"""An inclination of the ground [rad]."""
