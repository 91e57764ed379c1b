"""Compass biped: two straight legs joined at the hip. Gamus & Or (2013), sections IV and V.

``theta1`` is the angle of the stance leg and ``theta2`` that of the swing leg from the slope's normal, so that

    hip = stance foot + l (sin theta1, cos theta1),      swing foot = hip + l (sin theta2, -cos theta2)

The ankle motor acts between ground and stance leg, the hip motor between the legs: Q_theta1 = ankle + hip and
Q_theta2 = hip, because theta2 is measured in the opposite direction.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import Annotated, Any

from casadi import pi
from pydantic import Field

from gaitopt.model.mechanism import Link, Mechanism
from gaitopt.model.units import NonNegative, Positive, Slope, shorter
from gaitopt.model.walker import Walker


class CompassBiped(Walker):
    """Compass biped with point masses on the legs and at the hip."""

    model = "compass_biped"
    shape = ("theta1", "theta2")
    section = ("theta1",)
    actuators = ("ankle", "hip")
    tracked = ("theta1", "theta2")
    largest_angle = pi / 2

    leg_length: Annotated[Positive, Field(description="length of a leg [m]")]
    leg_mass: Annotated[Positive, Field(description="point mass on each leg [kg]")]
    leg_com: Annotated[Positive, Field(description="distance of the leg's mass from its foot [m]")]
    hip_mass: Annotated[NonNegative, Field(description="point mass at the hip [kg]")]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")]

    _com_within_leg = shorter("leg_com", "leg_length")

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The mechanism of the links, with the motor at the ankle, which acts between ground and stance leg."""
        return replace(super().mechanism(q, p), motors=(q.theta1, q.theta1 + q.theta2))

    @classmethod
    def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
        """Both legs, each with half of the mass at the hip."""
        legs = {"tip": (0, -p.leg_length), "com": (0, p.leg_com - p.leg_length), "mass": p.leg_mass, "foot": True}
        return (
            Link(name="stance_leg", parent="swing_leg", joint="hip", angle=q.theta1, **legs),
            Link(name="stance_hip", parent="stance_leg", angle=q.theta1, mass=p.hip_mass / 2),
            Link(name="swing_leg", angle=-q.theta2, **legs),
            Link(name="swing_hip", parent="swing_leg", angle=-q.theta2, mass=p.hip_mass / 2),
        )

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """Both feet are on the ground: theta2 = theta1."""
        return (free.theta1, free.theta1)
