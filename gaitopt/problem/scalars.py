"""The table of scalars, which gives the label, unit, meaning, range and formula of each.

    work = W_push + int P dt        cost of transport = work / (m g L)        speed = L / T

A formula is written once, in terms of ``Quantities`` of a cycle. It is evaluated with numbers (``gait.measures``), with
numbers that carry derivatives, and with expressions of the NLP (``design``). A scalar without a formula is the
largest or smallest value of some curves, each a quotient of quantities at an ``Instant``; as expressions they are
bounded by rows that are linear in the extremum. Proofs enclose the scalars by formulas of their own, to stay
independent.

Two ranges do not follow from a sign: the feet are never farther apart than twice the leg length l, which also bounds
the slip of one step; and the ground carries the weight m g on average over a period.

References
----------
Gamus & Or (2013), eq. (22) for the cost of transport.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from math import inf
from typing import Any, NamedTuple, Protocol, cast

from gaitopt.model.control import Control
from gaitopt.model.declaration import actuator_units
from gaitopt.model.registry import registered_walkers
from gaitopt.model.units import MOTOR_WORDS, OF_FORCES, Interval, Within, symmetric, words_and_unit
from gaitopt.model.walker import Walker

POSITIVE: Interval = (0, inf)
MOTORS, PUSH, DAMPERS, FLIGHT = "motors", "push", "dampers", "flight"
"""What a gait may have that some scalars need: motors, the push-off of the stance foot, dampers in joints, and phases
in which no foot touches the ground."""


class Quantities(Protocol):
    """The quantities of a cycle in terms of which formulas are written, summed over its steps.

    They are numbers, numbers with derivatives or symbolic expressions; formulas use +, / and abs.
    """

    @property
    def duration(self) -> Any:
        """The time T from the first impact to the last [s]."""

    @property
    def distance(self) -> Any:
        """The distance L from the first footprint to the last [m]."""

    @property
    def slip(self) -> Any:
        """Path of the sliding foot [m]."""

    @property
    def weight(self) -> Any:
        """The weight m g [N]."""

    @property
    def transport(self) -> Any:
        """Weight times distance, m g L [J]; nan if the walker stays on the spot."""

    @property
    def incline(self) -> Any:
        """The component of gravity along the ground divided by gravity, sin(slope)."""

    @property
    def push_work(self) -> Any:
        """Work of the push-offs before the impacts [J]."""

    def integral(self, rate: str) -> Any:
        """Integral over time of ``power`` of all motors, ``absolute_power``, ``loss`` or ``squared_torque``."""


class Instant(NamedTuple):
    """Contact force, torques, and height of the swing foot at one instant, or as arrays or curves at several ones.

    At an impact the impulse takes the place of the force.
    """

    force_t: Any
    force_n: Any
    torque: Any
    height: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Scalar:
    """One scalar of a gait.

    Attributes
    ----------
    label, unit : label and unit in tables and on axes.
    meaning : a longer text; empty if the label says everything.
    within : range of the scalar in its natural unit.
    needs : the gait must have one of these (motors, push-off, dampers, flight); empty if every gait has the scalar.
    of_designs : whether objectives and constraints may name it.
    formula : the scalar from the quantities of a cycle; None for an extremum.
    extremum : 1 for the largest of some values, -1 for the smallest, 0 for a formula.
    quotient : numerator and denominator of these values at an instant; the denominator is None if it is one.
    both_signs : whether the extremum is taken over the values with both signs.
    sticking : whether the extremum is taken only over instants at which the foot sticks.
    """

    label: str
    unit: str = ""
    meaning: str = ""
    within: Within
    needs: tuple[str, ...] = ()
    of_designs: bool = True
    formula: Callable[[Quantities], Any] | None = None
    extremum: int = 0
    quotient: Callable[[Instant], tuple[Any, Any]] | None = None
    both_signs: bool = False
    sticking: bool = False

    @property
    def signs(self) -> tuple[int, ...]:
        """The signs with which the values enter the extremum."""
        return (1, -1) if self.both_signs else (1,)

    def bounded(self, level: Any, at: Instant) -> list[Any]:
        """Expressions that are not negative if and only if ``level`` bounds the values at an instant.

        Denominators are positive.
        """
        assert self.quotient is not None
        above, below = self.quotient(at)
        end = level if below is None else level * below
        return [self.extremum * (end - sign * above) for sign in self.signs]

    @property
    def description(self) -> str:
        """The meaning with its unit; a unit that depends on the motors is given for torques and for forces."""
        unit = ", or ".join(filter(None, (self.unit, OF_FORCES.get(self.unit))))
        return f"{self.meaning or self.label}{f' [{unit}]' if unit else ''}"


def _work(cycle: Quantities) -> Any:
    return cycle.push_work + cycle.integral("power")


def _absolute_work(cycle: Quantities) -> Any:
    return abs(cycle.push_work) + cycle.integral("absolute_power")


SCALARS: Mapping[str, Scalar] = {
    "period": Scalar(
        label="period",
        unit="s",
        meaning="time of one step",
        within=Within(unit="time", possible=(1e-6, 1000), usual=(0.1, 50)),
        formula=lambda cycle: cycle.duration,
    ),
    "step_length": Scalar(
        label="step length",
        unit="m",
        meaning="distance of two footprints, slip included",
        within=Within(unit="length", possible=symmetric(4)),
        formula=lambda cycle: cycle.distance,
    ),
    "speed": Scalar(
        label="speed",
        unit="m/s",
        meaning="step length per period",
        within=Within(unit="speed", possible=symmetric(100), usual=symmetric(2)),
        formula=lambda cycle: cycle.distance / cycle.duration,
    ),
    "work": Scalar(
        label="motor work",
        unit="J",
        meaning="net work of the motors",
        within=Within(unit="torque", possible=symmetric(1e4), usual=symmetric(10)),
        needs=(MOTORS, PUSH),
        formula=_work,
    ),
    "damping_loss": Scalar(
        label="energy that the dampers take",
        unit="J",
        within=Within(unit="torque", possible=POSITIVE),
        needs=(DAMPERS,),
        of_designs=False,
        formula=lambda cycle: cycle.integral("loss"),
    ),
    "cost_of_transport": Scalar(
        label="cost of transport",
        meaning="work per weight and step length",
        within=Within(possible=symmetric(1e6), usual=symmetric(10)),
        needs=(MOTORS, PUSH),
        formula=lambda cycle: _work(cycle) / cycle.transport,
    ),
    "absolute_cost_of_transport": Scalar(
        label="absolute cost of transport",
        meaning="integral of |power| of each motor per weight and step length",
        within=Within(possible=(0, 1e6), usual=(0, 10)),
        needs=(MOTORS, PUSH),
        formula=lambda cycle: _absolute_work(cycle) / cycle.transport,
    ),
    "gravity_cost": Scalar(
        label="gravity's cost",
        meaning="work of gravity per weight and step length, sin(slope)",
        within=Within(possible=symmetric(1)),
        formula=lambda cycle: cycle.incline,
    ),
    "torque_squared": Scalar(
        label="integral of squared torques",
        unit="N^2 m^2 s",
        meaning="integral of the squares of the torques or motor forces",
        within=Within(unit="torque_squared", possible=POSITIVE),
        needs=(MOTORS,),
        formula=lambda cycle: cycle.integral("squared_torque"),
    ),
    "torque_cost": Scalar(
        label="squared torques per step length",
        unit="N^2 m s",
        meaning="integral of the squares of the torques or motor forces per step length",
        within=Within(unit="torque_cost", possible=symmetric(float("inf"))),
        needs=(MOTORS,),
        formula=lambda cycle: cycle.integral("squared_torque") / (cycle.transport / cycle.weight),
    ),
    "peak_torque": Scalar(
        label="peak torque",
        unit="N m",
        meaning="largest torque or force of a motor",
        within=Within(unit="torque", possible=POSITIVE, usual=(0, 10)),
        needs=(MOTORS,),
        extremum=1,
        quotient=lambda at: (at.torque, None),
        both_signs=True,
    ),
    "slip_distance": Scalar(
        label="slip distance",
        unit="m",
        meaning="path of the sliding foot",
        within=Within(unit="length", possible=(0, 2)),
        formula=lambda cycle: cycle.slip,
    ),
    "foot_clearance": Scalar(
        label="foot clearance",
        unit="m",
        meaning="largest height of the swing foot after mid-swing",
        within=Within(unit="length", possible=symmetric(2)),
        extremum=1,
        quotient=lambda at: (at.height, None),
    ),
    "apex_height": Scalar(
        label="apex height",
        unit="m",
        meaning="largest height of the centre of mass in flight",
        within=Within(unit="length", possible=symmetric(1000)),
        needs=(FLIGHT,),
        of_designs=False,
        extremum=1,
    ),
    "spectral_radius": Scalar(
        label="largest multiplier modulus",
        meaning="largest modulus of the Floquet multipliers",
        within=Within(possible=POSITIVE),
        extremum=1,
    ),
    "required_friction": Scalar(
        label="friction required to stick",
        meaning="largest |f_t|/f_n while sticking",
        within=Within(possible=(0, 1000), usual=(0, 3)),
        extremum=1,
        quotient=lambda at: (at.force_t, at.force_n),
        both_signs=True,
        sticking=True,
    ),
    "impulse_ratio": Scalar(
        label="impulse ratio required to stick",
        meaning="|F_t|/F_n of an impact that sticks",
        within=Within(possible=POSITIVE),
        extremum=1,
        quotient=lambda at: (at.force_t, at.force_n),
        both_signs=True,
    ),
    "min_normal_force": Scalar(
        label="smallest normal force",
        unit="N",
        within=Within(unit="force", possible=(0, 1)),
        extremum=-1,
        quotient=lambda at: (at.force_n, None),
    ),
}
"""All scalars by their keys in a result, in the order of tables."""
MEASURES = tuple(name for name in SCALARS if name != "spectral_radius")
"""The scalars that follow from a motion without its derivatives."""
DESIGN_SCALARS = tuple(name for name, scalar in SCALARS.items() if scalar.of_designs)
SLIPLESS_STEP = Within(unit="length", possible=symmetric(2))
"""Range of the step length of a gait without slip."""

CLEARANCE, ANGLE = "clearance", "angle."
"""Names of the constraints along the whole step, which open-loop torques may have: the height of the swing foot, and
what precedes the name of a link or joint whose angle is bounded."""

FRICTION_LABELS = {
    "friction": "coefficient of friction",
    "friction.static": "coefficient of static friction",
    "friction.kinetic": "coefficient of kinetic friction",
    "friction.viscous": "drag of a slipping foot",
}
NUMBER_UNITS = {"viscous": "N s/m"}
"""Units of friction by the last name of the dotted key. Walkers and control laws state units in descriptions."""
COLUMN_UNITS = {"t": "s", "f_t": "N", "f_n": "N"}
"""Units of those columns of a motion that are neither states nor motors."""


def scalar_values(record: Mapping[str, Any]) -> dict[str, float | None]:
    """The friction and the scalars of a record by their keys; the numbers of a friction law have dotted keys."""
    friction = record.get("friction")
    if isinstance(friction, Mapping):
        numbers = dict[str, float | None]()
        for name, value in friction.items():
            by_kind = {f".{kind}": v for kind, v in value.items()} if isinstance(value, Mapping) else {"": value}
            numbers |= {f"friction.{name}{kind}": v for kind, v in by_kind.items()}
    else:
        numbers = {"friction": friction}
    return numbers | {key: record[key] for key in SCALARS if key in record}


def relevant_scalars(records: Iterable[Mapping[str, Any]]) -> list[str]:
    """Keys of ``scalar_values``, without those that need motors, push-offs, dampers or flight where all are zero."""
    known = [scalar_values(record) for record in records]
    keys = dict.fromkeys(key for values in known for key in values)
    needed = {key for key in keys if key in SCALARS and SCALARS[key].needs}
    return [key for key in keys if key not in needed or any(values.get(key) for values in known)]


class Driven(Protocol):
    """A problem or a hybrid system; whether its motors exert torques or forces determines units."""

    @property
    def walker(self) -> Any:
        """The walker of a problem, or the class of the walker of a system."""

    @property
    def control(self) -> Control:
        """The control law."""


def label_of(key: str, of: Driven | None = None) -> str:
    """The label of a scalar or of a number of the friction law; the friction of a contact has the contact's name.

    Parameters
    ----------
    key : key of the scalar, or dotted key of the number.
    of : problem or system whose motors determine whether the label says torque or force.
    """
    if key in FRICTION_LABELS or not key.startswith("friction."):
        label = FRICTION_LABELS[key] if key in FRICTION_LABELS else SCALARS[key].label
        units = {*_motor_units(of).values()}
        return label.replace("torque", " or ".join(MOTOR_WORDS[unit] for unit in sorted(units))) if units else label
    _, contact, *kind = key.split(".")
    return f"{FRICTION_LABELS['.'.join(('friction', *kind))]}, {contact.replace('_', ' ')}"


def state_unit(name: str, of: Driven | None = None) -> str:
    """The unit of a state: coordinates of the foot and declared lengths are in metres, all others are angles.

    Parameters
    ----------
    of : problem or system whose state it is; by default the lengths of all registered walkers count.
    """
    rate, walkers = name.startswith("d"), registered_walkers().values() if of is None else (of.walker,)
    lengths = {"x", "y"}.union(*(walker.lengths for walker in walkers))
    return ("m" if name[rate:] in lengths else "rad") + ("/s" if rate else "")


def phase_of(key: str) -> int | None:
    """The phase, from 0, whose duration a key ``phases.K.duration`` means; None if it means something else."""
    first, _, rest = key.partition(".")
    number, _, last = rest.partition(".")
    return int(number) if (first, last) == ("phases", "duration") and number.isdecimal() else None


def unit_of(key: str, of: Driven | None = None) -> str:
    """The unit of a column of results; empty for pure numbers and unknown keys.

    Parameters
    ----------
    key : a scalar, ``state.NAME``, a time, a force, a motor or a parameter.
    of : problem or system to whose motors and control law the key refers.
    """
    motors, names = _motor_units(of), key.split(".")
    if key.startswith("state."):
        return state_unit(names[-1], of)
    if phase_of(key) is not None:
        return "s"
    if key in SCALARS:
        unit, acting = SCALARS[key].unit, {*motors.values()}
    elif key in motors or names[0] in COLUMN_UNITS:
        return motors.get(key) or COLUMN_UNITS[names[0]]
    elif names[0] == "control" and len(names) > 1:
        motor = next((name for name in names if name in motors), "")
        unit = "" if of is None else "N m" if names[1] == motor else of.control.unit(key.partition(".")[2])
        acting = {motors[motor]} if motor else {*motors.values()} if unit != "rad" else set()
    else:
        unit, acting = NUMBER_UNITS.get(names[-1], ""), set[str]()
        walkers = (_walker_of(of),) if of is not None else registered_walkers().values()
        for walker in walkers if names[0] == "walker" else ():
            if names[-1] in walker.model_fields:
                unit = words_and_unit(walker.model_fields[names[-1]].description or "")[1]
    units = dict.fromkeys(OF_FORCES.get(unit, unit) if motor == "N" else unit for motor in sorted(acting))
    return " or ".join(units) or unit


def _motor_units(of: Driven | None) -> Mapping[str, str]:
    return {} if of is None else actuator_units(_walker_of(of))


def _walker_of(of: Driven) -> type[Walker]:
    """The class of the walker of a problem or a system."""
    return cast(type[Walker], of.walker if isinstance(of.walker, type) else type(of.walker))
