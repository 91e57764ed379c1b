"""The sections of a problem file, one model per mapping: keys, units, ranges and meaning.

The same models validate a file and describe it to an editor. Sections that depend on the walker (its state, its
torques) are made from the walker's own names.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import pi
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, create_model, model_validator
from pydantic.fields import FieldInfo

from gaitopt.mechanics.control.reference import BeyondEnd
from gaitopt.mechanics.modes import ImpactLaw, Mode
from gaitopt.mechanics.ranges import Within, symmetric
from gaitopt.mechanics.units import SMALLEST, Angle, Finite, NonNegative, Number, parse_angle
from gaitopt.mechanics.walker import Walker

MAX_STEPS = 64
"""Of a cycle; beyond that a walk is taken for irregular."""
MAX_PHASES = 64
"""Of one step: known gaits have up to five, and the equations grow with them."""
FRICTION = Within(usual=(0, 3))
DURATION = Within(unit="time", possible=(0, 1000), usual=(0, 50))
Duration = Annotated[Finite, Field(ge=SMALLEST)]
TORQUE = Within(unit="torque", possible=symmetric(1000), usual=symmetric(10))
RATE = Within(unit="rate", possible=symmetric(100), usual=symmetric(5))
SLIP = Within(unit="speed", possible=symmetric(100), usual=symmetric(5))
POSITION = Within(unit="length", possible=symmetric(1000))
LENGTH = Within(unit="length", possible=symmetric(1))
Name = Annotated[str, Field(min_length=1, max_length=1000)]
"""Of another problem: a name, or a path."""


class Section(BaseModel):
    """Base of every section: its fields are all the keys there are."""

    model_config = ConfigDict(frozen=True, extra="forbid")


@dataclass(frozen=True, slots=True, kw_only=True)
class Free:
    """A parameter that is an unknown, in SI: its bounds and its first guess."""

    lower: float
    upper: float
    guess: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """A constraint on a scalar, in SI: -inf or inf where it is open, both equal for an equality."""

    minimum: float
    maximum: float


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenSequence:
    """A mode sequence that is to be found: its impact if that is known, and the largest number of steps of a cycle."""

    impact: Mode | None = None
    steps: int = 1

    def __str__(self) -> str:
        return f"to be found; {self.impact or 'to be found'}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Guess:
    """First guess of a gait.

    Attributes
    ----------
    state : the whole state just after the impact by name [rad, m, rad/s, m/s].
    durations : of the phases [s]; None where the solver is to find them.
    """

    state: Mapping[str, float]
    durations: tuple[float, ...] | None


class GaitReference(Section):
    """The angles of another gait, over the time since the impact."""

    gait: Annotated[Name, Field(description="problem whose gait is tracked: a name, or a path relative to this file")]
    beyond_end: Annotated[
        BeyondEnd,
        Field(
            description="after the reference's end: its motion flows on (flow), its last rate is kept (linear), "
            "its last angle is held (hold), or there is no torque (off)"
        ),
    ]


class Curve(Section):
    """A smooth curve per tracked joint whose coefficients are unknowns."""

    degree: Annotated[int, Field(ge=1, le=20, strict=True, description="degree of the curve of each joint")]
    start: Annotated[Name, Field(description="problem whose gait gives the first guess: a name, or a path")]
    within: Annotated[
        Angle,
        Field(
            ge=SMALLEST,
            le=pi,
            description="bound of the curves' angles on both sides of zero [rad], kept by construction",
        ),
    ] = 0.6
    duration: Annotated[
        Duration | None, Field(description="of the curves [s]; the period of the start's gait if left out"), DURATION
    ] = None
    points: Annotated[
        dict[str, tuple[Angle, ...]] | None,
        Field(
            description="first guess of the degree + 1 Bezier control points of each tracked joint [rad]; "
            "those that come closest to the start's angles if left out"
        ),
    ] = None


class CurveReference(Section):
    """A reference that is to be designed."""

    curve: Curve
    beyond_end: Annotated[
        Literal[BeyondEnd.LINEAR, BeyondEnd.HOLD, BeyondEnd.OFF],
        Field(
            description="after the curve's end: its last rate is kept (linear), its last angle is held (hold), "
            "or there is no torque (off); a curve has no motion of its own that could flow on"
        ),
    ]

    @property
    def degree(self) -> int:
        """Degree of the curve of each joint."""
        return self.curve.degree

    @property
    def start(self) -> str:
        """The problem whose gait gives the first guess."""
        return self.curve.start


class NoControlSpec(Section):
    """A passive walker."""

    type: Literal["none"] = Field("none", description="no torques")


class ConstantTorqueSpec(Section):
    """Constant torques by the walker's actuator names [N m]."""

    type: Literal["constant_torque"] = "constant_torque"
    torques: Mapping[str, Finite]


class PDSpec(Section):
    """PD tracking of a reference whose clock restarts at every impact.

    u = -kp (theta - theta_r) - kd (dtheta - dtheta_r)
    """

    type: Literal["pd"] = Field("pd", description="PD tracking of a reference")
    kp: Annotated[
        Finite,
        Field(ge=0, description="gain on the angle [N m/rad]"),
        Within(unit="torque", possible=(0, 1000), usual=(0, 30)),
    ]
    kd: Annotated[
        Finite,
        Field(ge=0, description="gain on the rate [N m s/rad]"),
        Within(unit="damping", possible=(0, 100), usual=(0, 10)),
    ]
    reference: Annotated[GaitReference | CurveReference, Field(description="motion that the joints track")]


ControlSpec = NoControlSpec | ConstantTorqueSpec | PDSpec


class HeadSection(Section):
    """The keys at the top of a file that are not mappings."""

    name: Annotated[
        str,
        Field(
            pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$",
            max_length=80,
            description="name of the problem, also of its run folder: letters, digits, dot, dash and underscore",
        ),
    ]
    about: Annotated[str, Field(description="what the gait is, in a sentence")] = ""
    friction: Annotated[NonNegative, Field(le=1000, description="coefficient of friction mu"), FRICTION]
    impact_law: Annotated[
        ImpactLaw, Field(description="tangential law of a slipping impact: Coulomb friction, or no tangential impulse")
    ] = ImpactLaw.COULOMB


class FrictionCoefficients(Section):
    """Friction of a foot that sticks, and of one that slips: |f_t| <= mu_s f_n,  f_t = -s mu_k f_n - c dx."""

    static: Annotated[
        NonNegative, Field(le=1000, description="coefficient mu_s that bounds the force of a sticking foot"), FRICTION
    ]
    kinetic: Annotated[
        NonNegative, Field(le=1000, description="coefficient mu_k of a slipping foot, at most the static one"), FRICTION
    ]
    viscous: Annotated[NonNegative, Field(le=1e6, description="drag c of a slip besides that [N s/m]")] = 0.0

    @model_validator(mode="after")
    def _static_is_larger(self) -> Self:
        if self.static < self.kinetic:
            raise ValueError(
                f"static = {self.static:g} is below kinetic = {self.kinetic:g}: "
                "a foot that sticks would then need less force to slip than it meets once it slips"
            )
        return self


class StepSection(Section):
    """The mode sequence of one step."""

    phases: Annotated[tuple[Mode, ...], Field(max_length=MAX_PHASES, description="modes of the stance foot in order")]
    impact: Annotated[Mode, Field(description="what the colliding foot does just after the impact that ends the step")]


class GaitSection(StepSection):
    """A gait that repeats itself after one step, and a first guess."""

    guess: Annotated[dict[str, Any], Field(description="first guess of state and durations")]


class CycleSection(Section):
    """A gait that repeats itself after several steps, and a first guess."""

    steps: Annotated[
        tuple[StepSection, ...], Field(min_length=1, max_length=MAX_STEPS, description="the steps in order")
    ]
    guess: Annotated[dict[str, Any], Field(description="first guess of state and durations of all phases")]


class OpenGaitSection(Section):
    """A gait whose mode sequence is to be found."""

    phases: Annotated[Literal["auto"], Field(description="the modes are to be found")]
    impact: Annotated[
        Mode | None, Field(description="what the colliding foot does just after the impact; any mode if left out")
    ] = None
    steps: Annotated[int, Field(ge=1, le=MAX_STEPS, strict=True, description="steps of a cycle, at most")] = 1
    guess: Annotated[dict[str, Any] | None, Field(description="state near which a gait is preferred")] = None


class GuessSection(Section):
    """First guess: state after impact, and phase durations."""

    state: Annotated[
        dict[str, Any], Field(description="state just after impact; what is left out follows from the section")
    ]
    durations: Annotated[
        tuple[Duration, ...] | None, Field(description="of the phases [s], one each; optional"), DURATION
    ] = None


class FreeSection(Section):
    """An unknown in place of a number."""

    free: Annotated[list[Any], Field(min_length=2, max_length=2, description="bounds [lo, hi] of the unknown")]
    guess: Annotated[Any, Field(description="first guess, within the bounds")]


class RangeSection(Section):
    """Bounds of a scalar, in SI."""

    min: Annotated[Number | None, Field(description="lower bound, none if left out")] = None
    max: Annotated[Number | None, Field(description="upper bound, none if left out")] = None


class AngleRangeSection(RangeSection):
    """Bounds of an angle."""

    min: Annotated[Angle | None, Field(description="lower bound [rad], none if left out")] = None
    max: Annotated[Angle | None, Field(description="upper bound [rad], none if left out")] = None


SECTION_KEYS = ("walker", "control", "gait", "objective", "constraints")
"""Keys of a file besides those of its head."""


@lru_cache
def torques_section(walker: type[Walker]) -> type[Section]:
    """Constant torques of a walker: one key per actuator."""
    torque = {
        name: Annotated[Finite, Field(description=f"torque of the {name} [N m]"), TORQUE] for name in walker.actuators
    }
    kind = Annotated[Literal["constant_torque"], Field(description="constant torques [N m]")]
    return _model("TorquesSection", {"type": kind, **torque})


@lru_cache
def state_section(walker: type[Walker]) -> type[Section]:
    """State of a walker: one optional key per name."""

    def entry(name: str) -> Any:
        if name in {*walker.shape} - {*walker.lengths}:
            largest = walker.largest_angle
            return Annotated[Angle, Field(ge=-largest, le=largest, description="[rad]")]
        known = {"x": ("[m]", POSITION), "dx": ("slip velocity [m/s]", SLIP)}
        known |= dict.fromkeys((*walker.lengths, "y"), ("[m]", LENGTH))
        known |= dict.fromkeys((*(f"d{length}" for length in walker.lengths), "dy"), ("[m/s]", SLIP))
        words, within = known.get(name, ("[rad/s]", RATE))
        return Annotated[Finite, Field(description=words), within]

    return _model("StateSection", {name: entry(name) for name in walker.state_names()}, required=False)


def is_angle(field: FieldInfo) -> bool:
    """Whether a field takes angles with a unit."""
    return any(isinstance(part, BeforeValidator) and part.func is parse_angle for part in field.metadata)


def _model(name: str, keys: Mapping[str, Any], *, required: bool = True) -> type[Section]:
    default = ... if required else None
    fields: dict[str, Any] = {key: (annotation, default) for key, annotation in keys.items()}
    return create_model(name, __base__=Section, **fields)
