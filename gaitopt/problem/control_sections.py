"""The control section of a problem file, one model per kind of control."""

from collections.abc import Mapping
from functools import lru_cache
from math import pi
from typing import Annotated, Literal

from pydantic import Field

from gaitopt.mechanics.control.reference import BeyondEnd
from gaitopt.mechanics.ranges import Within, symmetric
from gaitopt.mechanics.units import SMALLEST, Angle, Finite
from gaitopt.mechanics.walker import Walker
from gaitopt.problem.section import DURATION, Duration, Name, Section, section_model

TORQUE = Within(unit="torque", possible=symmetric(1000), usual=symmetric(10))


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
        Within(usual=(0.01, pi)),
    ] = 0.6
    duration: Annotated[
        Duration | None,
        Field(description="of the curves [s]; the period of the start's gait if left out"),
        Within(unit="time", possible=DURATION.possible, usual=(0.1, DURATION.usual[1])),
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


@lru_cache
def torques_section(walker: type[Walker]) -> type[Section]:
    """Constant torques of a walker: one key per actuator."""
    torque = {
        name: Annotated[Finite, Field(description=f"torque of the {name} [N m]"), TORQUE] for name in walker.actuators
    }
    kind = Annotated[Literal["constant_torque"], Field(description="constant torques [N m]")]
    return section_model("TorquesSection", {"type": kind, **torque})
