"""Compass biped with a torso held upright by springs at the hip: a walker of one's own, in one page.

    V_spring = k/2 (torso - theta1)^2 + k/2 (torso + theta2)^2

One spring connects the torso with each leg, so that together they hold it on the bisector of the legs and close
the legs like scissors. Swapping the feet leaves V_spring as it is: an impact may not change a potential energy.

Use the class in a library call, or register it for problem files in the ``pyproject.toml`` of your own package:

    [project.entry-points."gaitopt.walkers"]
    torso_compass = "torso_compass:TorsoCompass"
"""

from math import pi
from types import SimpleNamespace
from typing import Annotated, Any, Self

from casadi import cos, sin, vertcat
from pydantic import Field, model_validator

from gaitopt import Body, Mechanism, Walker
from gaitopt.model.mechanism import polar
from gaitopt.model.units import Angle, Positive


class TorsoCompass(Walker):
    """Legs as in ``CompassBiped``, and a rigid torso on the hip; all angles from the slope's normal.

    The motor at the hip acts between torso and stance leg: Q_torso = hip, Q_theta1 = -hip.
    """

    model = "torso_compass"
    shape = ("theta1", "theta2", "torso")
    section = ("theta1", "torso")
    actuators = ("hip",)
    tracked = ("torso",)

    leg_length: Annotated[Positive, Field(description="length of a leg [m]")]
    leg_mass: Annotated[Positive, Field(description="point mass on each leg [kg]")]
    leg_com: Annotated[Positive, Field(description="distance of the leg's mass from its foot [m]")]
    torso_mass: Annotated[Positive, Field(description="mass of the torso [kg]")]
    torso_com: Annotated[Positive, Field(description="distance of the torso's centre of mass from the hip [m]")]
    torso_inertia: Annotated[Positive, Field(description="moment of inertia about its centre of mass [kg m^2]")]
    stiffness: Annotated[Positive, Field(description="stiffness of each hip spring [N m/rad]")]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]
    slope: Annotated[Angle, Field(gt=-pi / 2, lt=pi / 2, description="slope, downhill along x [rad]")]

    @model_validator(mode="after")
    def _com_within_leg(self) -> Self:
        if self.leg_com >= self.leg_length:
            raise ValueError(f"leg_com = {self.leg_com:g} m must be less than leg_length = {self.leg_length:g} m")
        return self

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """Two point masses and a rigid body; touchdown when both legs have the same angle."""
        foot = vertcat(q.x, q.y)
        hip = foot + polar(p.leg_length, q.theta1)
        torso = hip + polar(p.torso_com, q.torso)
        return Mechanism(
            bodies=(
                Body(mass=p.leg_mass, position=foot + polar(p.leg_com, q.theta1)),
                Body(mass=p.leg_mass, position=hip - polar(p.leg_length - p.leg_com, -q.theta2)),
                Body(mass=p.torso_mass, position=torso, inertia=p.torso_inertia, angle=q.torso),
            ),
            gravity=p.gravity * vertcat(sin(p.slope), -cos(p.slope)),
            swing_foot=hip - polar(p.leg_length, -q.theta2),
            touchdown=q.theta1 - q.theta2,
            upright=cos(q.theta1) * cos(q.torso),
            relabel=vertcat(-q.theta2, -q.theta1, q.torso),
            motors=(q.torso - q.theta1,),
            potential=p.stiffness / 2 * ((q.torso - q.theta1) ** 2 + (q.torso + q.theta2) ** 2),
        )

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """Both feet are on the ground: theta2 = theta1."""
        return (free.theta1, free.theta1, free.torso)
