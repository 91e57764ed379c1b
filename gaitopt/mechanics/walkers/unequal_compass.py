"""Compass biped whose legs differ: it limps, and its gaits repeat themselves after two steps.

``theta1`` is the angle of the stance leg and ``theta2`` that of the swing leg, whichever these are, measured as those
of the compass. In the first step of a cycle the leg stands that ``leg_mass`` and ``leg_com`` describe, and the other
one swings; in the next step they have changed places.
"""

from types import SimpleNamespace
from typing import Annotated, Any, Self

from casadi import cos, pi, sin, vertcat
from pydantic import Field, model_validator

from gaitopt.mechanics.units import NonNegative, Positive, Slope
from gaitopt.mechanics.walker import Body, Mechanism, Walker, polar


class UnequalCompass(Walker):
    """Compass biped with a point mass at the hip and one on each leg, which may differ in size and place."""

    model = "unequal_compass"
    shape = ("theta1", "theta2")
    section = ("theta1",)
    exchanged = {"leg_mass": "other_leg_mass", "leg_com": "other_leg_com"}  # noqa: RUF012 - a class variable of Walker
    actuators = ("ankle", "hip")
    tracked = ("theta1", "theta2")
    largest_angle = pi / 2

    leg_length: Annotated[Positive, Field(description="length of either leg [m]")]
    leg_mass: Annotated[Positive, Field(description="point mass on the leg that stands in the first step [kg]")]
    leg_com: Annotated[Positive, Field(description="distance of this mass from the leg's foot [m]")]
    other_leg_mass: Annotated[Positive, Field(description="point mass on the other leg [kg]")]
    other_leg_com: Annotated[Positive, Field(description="distance of that mass from the other leg's foot [m]")]
    hip_mass: Annotated[NonNegative, Field(description="point mass at the hip [kg]")]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")]

    @model_validator(mode="after")
    def _com_within_legs(self) -> Self:
        for name in ("leg_com", "other_leg_com"):
            if getattr(self, name) >= self.leg_length:
                raise ValueError(
                    f"{name} = {getattr(self, name):g} m must be less than leg_length = {self.leg_length:g} m"
                )
        return self

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """Three point masses; touchdown when both legs have the same angle."""
        foot = vertcat(q.x, q.y)
        hip = foot + polar(p.leg_length, q.theta1)
        return Mechanism(
            bodies=(
                Body(mass=p.leg_mass, position=foot + polar(p.leg_com, q.theta1)),
                Body(mass=p.hip_mass, position=hip),
                Body(mass=p.other_leg_mass, position=hip - polar(p.leg_length - p.other_leg_com, -q.theta2)),
            ),
            gravity=p.gravity * vertcat(sin(p.slope), -cos(p.slope)),
            swing_foot=hip - polar(p.leg_length, -q.theta2),
            touchdown=q.theta1 - q.theta2,
            upright=cos(q.theta1),
            relabel=vertcat(-q.theta2, -q.theta1),
            motors=(q.theta1, q.theta1 + q.theta2),
        )

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """Both feet are on the ground: theta2 = theta1."""
        return (free.theta1, free.theta1)

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[Any, ...], ...]:
        """Both legs."""
        foot = vertcat(q.x, q.y)
        hip = foot + polar(p.leg_length, q.theta1)
        return (foot, hip), (hip, hip - polar(p.leg_length, -q.theta2))
