"""Inchworm: two links joined at a hinge, whose ends are both on the ground.

A motor opens and closes the hinge (x, y). ``rear_angle`` and ``front_angle`` are the angles of the links from the
slope's normal, both positive where the links spread. On a slope, or with unequal friction, the ends slide in turn.
"""

from types import SimpleNamespace
from typing import Annotated

from casadi import SX, cos, pi, vertcat
from pydantic import Field

from gaitopt.model.mechanism import Body, Contact, Mechanism, inclined, polar
from gaitopt.model.units import Inertia, Positive, Slope, shorter
from gaitopt.model.walker import Walker


class Inchworm(Walker):
    """Two links on two point feet."""

    model = "inchworm"
    shape = ("rear_angle", "front_angle")
    contacts = ("rear", "front")
    actuators = ("hinge",)
    largest_angle = pi / 2

    link_length: Annotated[Positive, Field(description="length of a link [m]")]
    link_mass: Annotated[Positive, Field(description="mass of a link [kg]")]
    link_com: Annotated[Positive, Field(description="distance of a link's centre of mass from the hinge [m]")]
    link_inertia: Annotated[Inertia, Field(description="moment of inertia about it [kg m^2]")]
    hinge_mass: Annotated[Positive, Field(description="point mass at the hinge [kg]")]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")]

    _com_within_link = shorter("link_com", "link_length")

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The motor acts on the angle between the links, rear_angle + front_angle."""
        hinge = vertcat(q.x, q.y)
        angles = (q.rear_angle, -q.front_angle)
        rear_foot, front_foot = (hinge - polar(p.link_length, angle) for angle in angles)
        links = (
            Body(mass=p.link_mass, position=hinge - polar(p.link_com, angle), inertia=p.link_inertia, angle=angle)
            for angle in angles
        )
        return Mechanism(
            bodies=(Body(mass=p.hinge_mass, position=hinge), *links),
            gravity=inclined(p.gravity, p.slope),
            upright=cos(q.rear_angle) * cos(q.front_angle),
            motors=(q.rear_angle + q.front_angle,),
            contacts={"rear": Contact(position=rear_foot), "front": Contact(position=front_foot)},
        )

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[SX, ...], ...]:
        """Both links."""
        hinge = vertcat(q.x, q.y)
        return ((hinge - polar(p.link_length, q.rear_angle), hinge, hinge - polar(p.link_length, -q.front_angle)),)
