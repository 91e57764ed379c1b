"""Compass biped on arc feet, which roll on the ground or slide. McGeer (1990).

With X the position of the arc's centre along the slope, R the arc's radius and theta1 the angle of the stance leg, the
velocity of the foot at its contact with the ground is

    dx = dX - R dtheta1,        x = X - R theta1

The coordinate x of the stance foot is therefore the distance that it has slid: a rolling foot keeps its x, while its
contact with the ground, at x + R theta1, moves. The contact force then acts on x and y alone, as for a point foot. The
angles are those of the compass.
"""

from types import SimpleNamespace
from typing import Annotated, Any

from casadi import pi, vertcat
from pydantic import Field

from gaitopt.model.mechanism import Link, polar
from gaitopt.model.units import Inertia, NonNegative, Positive, Slope, shorter
from gaitopt.model.walker import Walker

ARC = tuple(k / 10 for k in range(-6, 7))
"""Angles from the leg at which the arc is drawn [rad]."""


class RoundFeetCompass(Walker):
    """Compass biped with a point mass at the hip, and rigid legs with feet that are arcs about a centre on the leg."""

    model = "round_feet_compass"
    shape = ("theta1", "theta2")
    section = ("theta1",)
    actuators = ("hip",)
    tracked = ("theta2",)
    largest_angle = pi / 2

    leg_length: Annotated[Positive, Field(description="distance of the hip from the centre of the foot's arc [m]")]
    foot_radius: Annotated[NonNegative, Field(description="radius of the foot's arc [m]; 0 is a point foot")]
    leg_mass: Annotated[Positive, Field(description="mass of each leg [kg]")]
    leg_com: Annotated[NonNegative, Field(description="distance of the leg's centre of mass from the arc's centre [m]")]
    leg_inertia: Annotated[Inertia, Field(description="moment of inertia of a leg about its centre of mass [kg m^2]")]
    hip_mass: Annotated[NonNegative, Field(description="point mass at the hip [kg]")]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")]

    _com_within_leg = shorter("leg_com", "leg_length")

    @classmethod
    def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
        """Both legs, each as far as the centre of its arc, with half of the mass at the hip."""
        legs = {
            "tip": (0, -p.leg_length),
            "foot": True,
            "foot_radius": p.foot_radius,
            "com": (0, p.leg_com - p.leg_length),
            "mass": p.leg_mass,
            "inertia": p.leg_inertia,
        }
        return (
            Link(name="stance_leg", parent="swing_leg", joint="hip", angle=q.theta1, **legs),
            Link(name="stance_hip", parent="stance_leg", angle=q.theta1, mass=p.hip_mass / 2),
            Link(name="swing_leg", angle=-q.theta2, **legs),
            Link(name="swing_hip", parent="swing_leg", angle=-q.theta2, mass=p.hip_mass / 2),
        )

    @staticmethod
    def joints(q: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, Any, Any]:
        """Centre of the stance foot's arc, hip, centre of the swing foot's arc [m]."""
        centre = vertcat(q.x + p.foot_radius * q.theta1, q.y + p.foot_radius)
        hip = centre + polar(p.leg_length, q.theta1)
        return centre, hip, hip - polar(p.leg_length, -q.theta2)

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """Both feet are on the ground: theta2 = theta1."""
        return (free.theta1, free.theta1)

    @classmethod
    def contact(cls, q: SimpleNamespace, p: SimpleNamespace) -> Any:
        """The lowest point of the stance foot's arc."""
        return vertcat(q.x + p.foot_radius * q.theta1, q.y)

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[Any, ...], ...]:
        """Legs down to their arcs, and the arcs."""
        centre, hip, swing_centre = cls.joints(q, p)
        feet = [
            tuple(c - polar(p.foot_radius, a + k) for k in ARC)
            for c, a in ((centre, q.theta1), (swing_centre, -q.theta2))
        ]
        return (hip, feet[0][6]), (hip, feet[1][6]), *feet
