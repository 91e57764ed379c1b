"""RABBIT: a torso on two legs with knees, point feet, and motors in hips and knees. Chevallereau et al. (2003).

Shape coordinates are the leans of the links: angles from the slope's normal, positive forward, all with one sign. The
angles of the joints are hip = thigh - torso + pi and knee = shin - thigh; the motors act on these. The default
parameters are those of FROST's model, which names Westervelt et al. (2007); Westervelt, Grizzle & Koditschek (2003) use
a torso of 20 kg. The rotors, 0.83 kg m^2 in every joint, are left out unless ``rotor_inertia`` states them.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import Annotated

from casadi import pi
from pydantic import Field

from gaitopt.model.mechanism import Link, Mechanism
from gaitopt.model.units import Inertia, NonNegative, Positive, Slope, Within
from gaitopt.model.walker import Walker


class Rabbit(Walker):
    """Five-link biped with point feet."""

    model = "rabbit"
    shape = ("torso", "stance_thigh", "stance_shin", "swing_thigh", "swing_shin")
    posture = {  # noqa: RUF012 - a class variable of Walker
        "torso": 0.05,
        "stance_thigh": -0.35,
        "stance_shin": -0.15,
        "swing_thigh": 0.1,
        "swing_shin": 0.4,
    }
    actuators = ("stance_hip", "stance_knee", "swing_hip", "swing_knee")
    phases = ("stance_leg",)
    tracked = actuators

    torso_length: Annotated[
        Positive, Field(description="length of the torso [m]"), Within(unit="length", possible=(0, 100))
    ] = 0.63
    torso_mass: Annotated[Positive, Field(description="mass of the torso [kg]")] = 12.0
    torso_com: Annotated[NonNegative, Field(description="height of its centre of mass above the hip [m]")] = 0.24
    torso_inertia: Annotated[Inertia, Field(description="moment of inertia about its centre of mass [kg m^2]")] = 1.33
    thigh_length: Annotated[Positive, Field(description="hip to knee [m]")] = 0.4
    thigh_mass: Annotated[Positive, Field(description="mass of a thigh [kg]")] = 6.8
    thigh_com: Annotated[NonNegative, Field(description="distance of its centre of mass from the hip [m]")] = 0.11
    thigh_inertia: Annotated[Inertia, Field(description="moment of inertia about its centre of mass [kg m^2]")] = 0.47
    shin_length: Annotated[Positive, Field(description="knee to foot [m]")] = 0.4
    shin_mass: Annotated[Positive, Field(description="mass of a shin [kg]")] = 3.2
    shin_com: Annotated[NonNegative, Field(description="distance of its centre of mass from the knee [m]")] = 0.24
    shin_inertia: Annotated[Inertia, Field(description="moment of inertia about its centre of mass [kg m^2]")] = 0.20
    rotor_inertia: Annotated[
        Inertia, Field(description="moment of inertia of the rotor in a joint, times its gear ratio squared [kg m^2]")
    ] = 0.0
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")] = 9.81
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")] = 0.0

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The mechanism of the links; the phase is the lean of the line from stance foot to hip, for equal lengths."""
        return replace(super().mechanism(q, p), phases={"stance_leg": (q.stance_thigh + q.stance_shin) / 2})

    @classmethod
    def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
        """The torso, and both legs hanging from it."""
        legs = []
        for leg in ("stance", "swing"):
            legs += [
                Link(
                    name=f"{leg}_thigh",
                    parent="torso",
                    joint=f"{leg}_hip",
                    zero=pi,
                    angle=getattr(q, f"{leg}_thigh"),
                    tip=(0, -p.thigh_length),
                    mass=p.thigh_mass,
                    com=(0, -p.thigh_com),
                    inertia=p.thigh_inertia,
                    rotor_inertia=p.rotor_inertia,
                ),
                Link(
                    name=f"{leg}_shin",
                    parent=f"{leg}_thigh",
                    joint=f"{leg}_knee",
                    position=(0, -p.thigh_length),
                    angle=getattr(q, f"{leg}_shin"),
                    tip=(0, -p.shin_length),
                    foot=True,
                    mass=p.shin_mass,
                    com=(0, -p.shin_com),
                    inertia=p.shin_inertia,
                    rotor_inertia=p.rotor_inertia,
                ),
            ]
        torso = Link(
            name="torso",
            angle=q.torso,
            tip=(0, p.torso_length),
            mass=p.torso_mass,
            com=(0, p.torso_com),
            inertia=p.torso_inertia,
        )
        return (torso, *legs)
