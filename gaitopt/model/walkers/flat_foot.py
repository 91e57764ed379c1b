"""Compass biped on feet with mass, whose springy and damped ankles hold them at right angles to the legs.

(x, y) is the ankle of the stance leg; ``foot1`` and ``foot2`` are the angles of stance and swing foot, zero where they
lie flat on the ground. Each foot is a rod from heel to toe, and its ankle lies on it. The heel lands, and the trailing
foot pushes off with its toe until the toe of the stance foot lands; this foot then stays flat until the next strike.
"""

from types import SimpleNamespace
from typing import Annotated

from casadi import SX, cos, pi, sin, vertcat
from pydantic import Field

from gaitopt.model.mechanism import Body, Contact, Damper, Mechanism, inclined, polar
from gaitopt.model.units import Damping, Positive, Slope, Stiffness, shorter
from gaitopt.model.walker import Walker

SMALLEST_LANDING_ANGLE = 0.1
"""The swing foot can land only if the angle of the stance leg is larger [rad]; earlier it would scuff."""


class FlatFoot(Walker):
    """Compass biped with flat feet and springs at its ankles."""

    model = "flat_foot"
    shape = ("theta1", "theta2", "foot1", "foot2")
    contacts = ("heel", "toe", "swing_heel", "swing_toe")
    landing_contacts = ("swing_heel", "swing_toe")
    exchanged_contacts = {"heel": "swing_heel", "toe": "swing_toe"}  # noqa: RUF012
    largest_angle = pi / 2

    leg_length: Annotated[Positive, Field(description="length of a leg, from the hip to the ankle [m]")]
    leg_mass: Annotated[Positive, Field(description="point mass on each leg [kg]")]
    leg_com: Annotated[Positive, Field(description="distance of the leg's mass from its ankle [m]")]
    hip_mass: Annotated[Positive, Field(description="point mass at the hip [kg]")]
    foot_mass: Annotated[Positive, Field(description="mass of each foot, a rod from heel to toe [kg]")]
    heel: Annotated[Positive, Field(description="distance of the heel behind the ankle [m]")]
    toe: Annotated[Positive, Field(description="distance of the toe ahead of the ankle [m]")]
    stiffness: Annotated[Stiffness, Field(description="stiffness of an ankle [N m/rad]")]
    damping: Annotated[Damping, Field(description="damping of an ankle [N m s/rad]")]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")]

    _com_within_leg = shorter("leg_com", "leg_length")

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """Three point masses, two rods, and a spring and a damper at each ankle."""
        ankle, hip, other = cls._joints(q, p)
        inertia, middle = p.foot_mass * (p.heel + p.toe) ** 2 / 12, (p.toe - p.heel) / 2
        bends = (q.foot1 - q.theta1, q.foot2 + q.theta2)
        past = q.theta1 - SMALLEST_LANDING_ANGLE
        return Mechanism(
            bodies=(
                Body(mass=p.leg_mass, position=ankle + polar(p.leg_com, q.theta1)),
                Body(mass=p.hip_mass, position=hip),
                Body(mass=p.leg_mass, position=hip - polar(p.leg_length - p.leg_com, -q.theta2)),
                *(
                    Body(mass=p.foot_mass, position=_sole(joint, angle, middle), inertia=inertia, angle=angle)
                    for joint, angle in ((ankle, q.foot1), (other, q.foot2))
                ),
            ),
            gravity=inclined(p.gravity, p.slope),
            upright=cos(q.theta1),
            swing_foot=other,
            relabel=vertcat(-q.theta2, -q.theta1, q.foot2, q.foot1),
            potential=p.stiffness / 2 * (bends[0] ** 2 + bends[1] ** 2),
            dampers=tuple(Damper(coefficient=p.damping, across=bend) for bend in bends),
            contacts={
                "heel": Contact(position=_sole(ankle, q.foot1, -p.heel)),
                "toe": Contact(position=_sole(ankle, q.foot1, p.toe)),
                "swing_heel": Contact(position=_sole(other, q.foot2, -p.heel), counts=past),
                "swing_toe": Contact(position=_sole(other, q.foot2, p.toe), counts=past),
            },
        )

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[SX, ...], ...]:
        """Both legs and both feet."""
        ankle, hip, other = cls._joints(q, p)
        feet = ((_sole(at, a, -p.heel), _sole(at, a, p.toe)) for at, a in ((ankle, q.foot1), (other, q.foot2)))
        return ((ankle, hip, other), *feet)

    @classmethod
    def _joints(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[SX, SX, SX]:
        """Stance ankle, hip and swing ankle."""
        ankle = vertcat(q.x, q.y)
        hip = ankle + polar(p.leg_length, q.theta1)
        return ankle, hip, hip - polar(p.leg_length, -q.theta2)


def _sole(ankle: SX, angle: SX, ahead: SX) -> SX:
    """The point of a foot this far ahead of its ankle."""
    return ankle + ahead * vertcat(cos(angle), -sin(angle))
