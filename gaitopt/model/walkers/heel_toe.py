"""Compass biped on rigid flat feet without mass, which rolls over heel and toe.

(x, y) is the ankle of the stance leg; the heel lies ``heel`` behind it and the toe ``toe`` ahead, across the leg. The
walker pivots on its heel until the toe lands, then on its toe until the heel of the other foot lands, and the feet swap
roles. With ``heel`` and ``toe`` towards zero it approaches the compass biped.
"""

from types import SimpleNamespace
from typing import Annotated

from casadi import SX, cos, pi, sin, vertcat
from pydantic import Field

from gaitopt.model.mechanism import Body, Contact, Mechanism, inclined, polar
from gaitopt.model.units import Positive, Slope, shorter
from gaitopt.model.walker import Walker

SMALLEST_LANDING_ANGLE = 0.05
"""The swing foot can land only if the angle of the stance leg is larger [rad]; earlier it would scuff."""


class HeelToe(Walker):
    """Compass biped with heels and toes."""

    model = "heel_toe"
    shape = ("theta1", "theta2")
    contacts = ("heel", "toe", "swing_heel", "swing_toe")
    landing_contacts = ("swing_heel", "swing_toe")
    exchanged_contacts = {"heel": "swing_heel", "toe": "swing_toe"}  # noqa: RUF012
    largest_angle = pi / 2

    leg_length: Annotated[Positive, Field(description="length of a leg, from the hip to the ankle [m]")]
    leg_mass: Annotated[Positive, Field(description="point mass on each leg [kg]")]
    leg_com: Annotated[Positive, Field(description="distance of the leg's mass from its ankle [m]")]
    hip_mass: Annotated[Positive, Field(description="point mass at the hip [kg]")]
    heel: Annotated[Positive, Field(description="distance of the heel behind the ankle [m]")]
    toe: Annotated[Positive, Field(description="distance of the toe ahead of the ankle [m]")]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")]

    _com_within_leg = shorter("leg_com", "leg_length")

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """Three point masses and two soles."""
        ankle, hip, other = cls._joints(q, p)
        (heel, toe), (swing_heel, swing_toe) = cls._sole(ankle, q.theta1, p), cls._sole(other, -q.theta2, p)
        past = q.theta1 - SMALLEST_LANDING_ANGLE
        return Mechanism(
            bodies=(
                Body(mass=p.leg_mass, position=ankle + polar(p.leg_com, q.theta1)),
                Body(mass=p.hip_mass, position=hip),
                Body(mass=p.leg_mass, position=hip - polar(p.leg_length - p.leg_com, -q.theta2)),
            ),
            gravity=inclined(p.gravity, p.slope),
            upright=cos(q.theta1),
            swing_foot=other,
            relabel=vertcat(-q.theta2, -q.theta1),
            contacts={
                "heel": Contact(position=heel),
                "toe": Contact(position=toe),
                "swing_heel": Contact(position=swing_heel, counts=past),
                "swing_toe": Contact(position=swing_toe, counts=past),
            },
        )

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[SX, ...], ...]:
        """Each leg ends in a foot, a triangle of ankle, heel and toe."""
        ankle, hip, other = cls._joints(q, p)
        lines = []
        for joint, angle in ((ankle, q.theta1), (other, -q.theta2)):
            heel, toe = cls._sole(joint, angle, p)
            instep = joint + polar((p.heel + p.toe) / 2, angle)
            lines += [(hip, joint), (instep, heel, toe, instep)]
        return tuple(lines)

    @classmethod
    def _joints(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[SX, SX, SX]:
        """Stance ankle, hip and swing ankle."""
        ankle = vertcat(q.x, q.y)
        hip = ankle + polar(p.leg_length, q.theta1)
        return ankle, hip, hip - polar(p.leg_length, -q.theta2)

    @classmethod
    def _sole(cls, ankle: SX, angle: SX, p: SimpleNamespace) -> tuple[SX, SX]:
        """Heel and toe of a foot."""
        ahead = vertcat(cos(angle), -sin(angle))
        return ankle - p.heel * ahead, ankle + p.toe * ahead
