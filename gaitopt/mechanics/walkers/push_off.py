"""Compass biped that pushes off: an impulse along the stance leg just before the swing foot lands. Kuo (2002).

The push acts between ground and foot in the direction of the leg, so that it needs friction tan(theta1); with less the
motion ends as ``push_slips``. Everything else is that of the compass.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import Annotated, Any, Self

from casadi import pi, vertcat
from pydantic import Field, model_validator

from gaitopt.mechanics.units import NonNegative, Positive, Slope
from gaitopt.mechanics.walker import Mechanism, Walker, polar
from gaitopt.mechanics.walkers.compass_biped import CompassBiped


class PushOffCompass(Walker):
    """Compass biped that pushes off with its stance leg."""

    model = "push_off_compass"
    shape = ("theta1", "theta2")
    section = ("theta1",)
    pushes = True
    actuators = ("ankle", "hip")
    tracked = ("theta1", "theta2")
    largest_angle = pi / 2

    leg_length: Annotated[Positive, Field(description="length of a leg [m]")]
    leg_mass: Annotated[Positive, Field(description="point mass on each leg [kg]")]
    leg_com: Annotated[Positive, Field(description="distance of the leg's mass from its foot [m]")]
    hip_mass: Annotated[NonNegative, Field(description="point mass at the hip [kg]")]
    push: Annotated[NonNegative, Field(description="impulse of the push along the stance leg [N s]")]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")]

    @model_validator(mode="after")
    def _com_within_leg(self) -> Self:
        if self.leg_com >= self.leg_length:
            raise ValueError(f"leg_com = {self.leg_com:g} m must be less than leg_length = {self.leg_length:g} m")
        return self

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The compass, with its push."""
        return replace(CompassBiped.mechanism(q, p), push=polar(p.push, q.theta1))

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """Both feet are on the ground: theta2 = theta1."""
        return CompassBiped.after_impact(free, p)

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[Any, ...], ...]:
        """Both legs."""
        foot = vertcat(q.x, q.y)
        hip = foot + polar(p.leg_length, q.theta1)
        return (foot, hip), (hip, hip - polar(p.leg_length, -q.theta2))
