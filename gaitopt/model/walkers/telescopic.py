"""Compass biped with a spring that shortens the swing leg, so that its foot clears the ground; it locks when extended.

``theta1`` and ``theta2`` are the angles of stance and swing leg, measured as those of the compass; ``retraction`` is
the fraction of its length by which the swing leg is shorter. A stop locks a leg at its full length, until its foot
leaves the ground after the next step. Then spring and damper act on its length until it is extended again:

    V_spring = k/2 (l retraction - travel)^2        damper across l retraction
"""

from types import SimpleNamespace
from typing import Annotated, Any

from casadi import cos, pi, vertcat
from pydantic import Field

from gaitopt.model.mechanism import Body, Damper, Mechanism, coil, inclined, polar
from gaitopt.model.units import Damping, NonNegative, Positive, Slope, Stiffness, Within, shorter
from gaitopt.model.walker import Walker


class TelescopicCompass(Walker):
    """Compass biped with telescopic legs: a point mass at the hip, and one on the part of each leg that slides."""

    model = "telescopic_compass"
    shape = ("theta1", "theta2", "retraction")
    section = ("theta1",)
    section_rates = ("theta1", "theta2")
    stops = ("leg",)
    largest_angle = pi / 2

    leg_length: Annotated[Positive, Field(description="length of an extended leg [m]")]
    leg_mass: Annotated[Positive, Field(description="point mass on the sliding part of each leg [kg]")]
    leg_com: Annotated[Positive, Field(description="distance of this mass from the foot [m]")]
    hip_mass: Annotated[NonNegative, Field(description="point mass at the hip [kg]")]
    stiffness: Annotated[Stiffness, Field(description="stiffness of the spring in each leg [N/m]")]
    travel: Annotated[
        NonNegative,
        Field(description="shortening of a leg at which its spring is at rest [m]"),
        Within(unit="length", possible=(0, 1)),
    ]
    damping: Annotated[Damping, Field(description="coefficient of the damper in each leg [N s/m]")]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")]

    _com_within_leg = shorter("leg_com", "leg_length")

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """Three point masses; touchdown when both legs, extended, have the same angle."""
        foot = vertcat(q.x, q.y)
        hip = foot + polar(p.leg_length, q.theta1)
        swing_foot = hip - polar(p.leg_length * (1 - q.retraction), -q.theta2)
        shortened = p.leg_length * q.retraction
        return Mechanism(
            bodies=(
                Body(mass=p.leg_mass, position=foot + polar(p.leg_com, q.theta1)),
                Body(mass=p.hip_mass, position=hip),
                Body(mass=p.leg_mass, position=swing_foot + polar(p.leg_com, -q.theta2)),
            ),
            gravity=inclined(p.gravity, p.slope),
            swing_foot=swing_foot,
            touchdown=q.theta1 - q.theta2,
            upright=cos(q.theta1),
            relabel=vertcat(-q.theta2, -q.theta1, q.retraction),
            stops={"leg": q.retraction},
            potential=p.stiffness / 2 * (shortened - p.travel) ** 2,
            dampers=(Damper(coefficient=p.damping, across=shortened),),
        )

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """Both feet are on the ground, both legs extended."""
        return (free.theta1, free.theta1, 0.0)

    @classmethod
    def rates_after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """The leg that swings now was locked until the impact."""
        return (free.dtheta1, free.dtheta2, 0.0)

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[Any, ...], ...]:
        """Both legs: the sliding part up to its mass, and the spring between that and the hip."""
        foot = vertcat(q.x, q.y)
        hip = foot + polar(p.leg_length, q.theta1)
        swing_foot = hip - polar(p.leg_length * (1 - q.retraction), -q.theta2)
        stance, swing = foot + polar(p.leg_com, q.theta1), swing_foot + polar(p.leg_com, -q.theta2)
        width = 0.1 * p.leg_length
        return (foot, stance), (swing_foot, swing), coil(stance, hip, width), coil(swing, hip, width)
