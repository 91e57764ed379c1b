"""Kneed walker: a compass with a knee in the swing leg, which locks before the foot comes down. McGeer (1990).

``theta1`` is the angle of the straight stance leg, ``theta2`` that of the swing thigh and ``theta3`` that of the swing
shank, all measured as those of the compass. The knee bends backward: its gap theta2 - theta3 is positive while it is
free. It locks with a plastic impact when the leg is straight.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import Annotated, Any

from casadi import pi, vertcat
from pydantic import Field

from gaitopt.model.mechanism import Link, Mechanism, polar
from gaitopt.model.units import NonNegative, Positive, Slope
from gaitopt.model.walker import Walker


class KneedWalker(Walker):
    """Kneed walker with point masses on thighs, shanks and at the hip."""

    model = "kneed_walker"
    shape = ("theta1", "theta2", "theta3")
    section = ("theta1",)
    section_rates = ("theta1", "theta2")
    stops = ("knee",)
    largest_angle = pi / 2

    thigh_length: Annotated[Positive, Field(description="hip to knee [m]")]
    thigh_mass: Annotated[Positive, Field(description="point mass on each thigh [kg]")]
    thigh_com: Annotated[Positive, Field(description="distance of the thigh's mass from the knee [m]")]
    shank_length: Annotated[Positive, Field(description="knee to foot [m]")]
    shank_mass: Annotated[Positive, Field(description="point mass on each shank [kg]")]
    shank_com: Annotated[Positive, Field(description="distance of the shank's mass from the foot [m]")]
    hip_mass: Annotated[NonNegative, Field(description="point mass at the hip [kg]")]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")]

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The mechanism of the links with the stop of the knee; straight legs with the same angle touch down."""
        return replace(
            super().mechanism(q, p),
            touchdown=q.theta1 - q.theta2,
            relabel=vertcat(-q.theta2, -q.theta1, -q.theta1 - (q.theta2 - q.theta3)),  # the gap, zero, stays
            stops={"knee": q.theta2 - q.theta3},
        )

    @classmethod
    def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
        """Thighs and shanks, with a fixed knee in the stance leg, and the mass at the hip."""
        knee = (0, -p.thigh_length)
        thighs = {"tip": knee, "com": (0, p.thigh_com - p.thigh_length), "mass": p.thigh_mass}
        shanks = {
            "position": knee,
            "tip": (0, -p.shank_length),
            "foot": True,
            "com": (0, p.shank_com - p.shank_length),
            "mass": p.shank_mass,
        }
        return (
            Link(name="stance_thigh", angle=q.theta1, **thighs),
            Link(name="stance_shank", parent="stance_thigh", angle=q.theta1, **shanks),
            Link(name="swing_thigh", parent="stance_thigh", joint="hip", angle=-q.theta2, **thighs),
            Link(name="swing_shank", parent="swing_thigh", joint="knee", angle=-q.theta3, **shanks),
            Link(name="hip_mass", parent="stance_thigh", angle=q.theta1, mass=p.hip_mass),
        )

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """Both feet are on the ground, both legs straight."""
        return (free.theta1, free.theta1, free.theta1)

    @classmethod
    def rates_after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """The knee of the swing leg was locked until the impact."""
        return (free.dtheta1, free.dtheta2, free.dtheta2)

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[Any, ...], ...]:
        """The straight stance leg; thigh and shank of the swing leg."""
        foot = vertcat(q.x, q.y)
        hip = foot + polar(p.thigh_length + p.shank_length, q.theta1)
        knee = hip - polar(p.thigh_length, -q.theta2)
        return (foot, hip), (hip, knee, knee - polar(p.shank_length, -q.theta3))
