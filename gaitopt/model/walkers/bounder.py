"""Bounding: a rigid trunk on two massless springy legs. McMordie and Buehler (2001); Poulakakis et al. (2006).

Each leg is held at a fixed angle from the vertical, its foot ahead of its hip, until it lands without an impulse; it
pushes along its length with k (l0 - l) and leaves where it has its full length. A cycle uses each leg once; there are
flights between the two stances, or the stances overlap.

(x, y) is the centre of mass, ``pitch`` the rotation of the trunk, positive nose down. The coordinates of a leg are
those of its foot relative to its hip. Energy is conserved; the parameter ``energy`` fixes it.
"""

from types import SimpleNamespace
from typing import Annotated

from casadi import SX, cos, pi, sin, sqrt, sumsqr, vertcat
from pydantic import Field

from gaitopt.model.mechanism import Body, Contact, Mechanism, coil
from gaitopt.model.units import SMALLEST_SIZE, Angle, Inertia, Positive, Stiffness, Within, symmetric
from gaitopt.model.walker import Walker

STEEPEST = Field(ge=-1.5, le=1.5)
"""Range of the angles at which legs may land [rad]: beyond it they would be almost horizontal."""


class Bounder(Walker):
    """Rigid trunk with a front and a back leg, on level ground."""

    model = "bounder"
    shape = ("pitch", "front_x", "front_y", "back_x", "back_y")
    lengths = shape[1:]
    contacts = ("front", "back")
    massless_contacts = contacts
    sections = ("apex", "level")
    largest_angle = pi / 2

    mass: Annotated[Positive, Field(description="mass of the trunk [kg]")]
    inertia: Annotated[
        Inertia, Field(ge=SMALLEST_SIZE, description="moment of inertia about the centre of mass [kg m^2]")
    ]
    hip: Annotated[
        Positive,
        Field(description="distance of each hip from the centre of mass [m]"),
        Within(unit="length", possible=(0, 100), usual=(0, 5)),
    ]
    leg_length: Annotated[Positive, Field(description="full length of a leg [m]")]
    stiffness: Annotated[Stiffness, Field(ge=SMALLEST_SIZE, description="stiffness of a leg [N/m]")]
    front_angle: Annotated[Angle, STEEPEST, Field(description="angle at which the front leg lands, forward [rad]")]
    back_angle: Annotated[Angle, STEEPEST, Field(description="angle at which the back leg lands, forward [rad]")]
    energy: Annotated[
        Positive,
        Field(description="mechanical energy relative to the ground [J]"),
        Within(unit="torque", possible=(0, 1e4), usual=symmetric(100)),
    ]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The mechanism, with the sections ``apex`` (a fall begins) and ``level`` (the nose falls past level)."""
        hips, legs = cls._hips(q, p), cls._legs(q)
        angles, natural_speed = {"front": p.front_angle, "back": p.back_angle}, sqrt(p.gravity * p.leg_length)
        contacts = {}
        for name, angle in angles.items():
            placed = p.leg_length * vertcat(sin(angle), -cos(angle))
            places = {f"{name}_x": placed[0], f"{name}_y": placed[1]}
            contacts[name] = Contact(position=hips[name] + legs[name], gap=hips[name][1] + placed[1], places=places)
        return Mechanism(
            bodies=(Body(mass=p.mass, position=vertcat(q.x, q.y), inertia=p.inertia, angle=q.pitch),),
            gravity=vertcat(0, -p.gravity),
            upright=cos(q.pitch),
            potential_while={
                name: p.stiffness / 2 * (p.leg_length - sqrt(sumsqr(leg))) ** 2 for name, leg in legs.items()
            },
            contacts=contacts,
            sections={"apex": lambda dq: dq.y / natural_speed, "level": lambda dq: -q.pitch},
            length=SX(p.leg_length),
        )

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[SX, ...], ...]:
        """The trunk from hip to hip, and both springs."""
        hips, legs = cls._hips(q, p), cls._legs(q)
        springs = (coil(hips[name] + leg, hips[name], 0.08 * p.leg_length) for name, leg in legs.items())
        return ((hips["back"], hips["front"]), *springs)

    @classmethod
    def _hips(cls, q: SimpleNamespace, p: SimpleNamespace) -> dict[str, SX]:
        centre, ahead = vertcat(q.x, q.y), p.hip * vertcat(cos(q.pitch), -sin(q.pitch))
        return {"front": centre + ahead, "back": centre - ahead}

    @classmethod
    def _legs(cls, q: SimpleNamespace) -> dict[str, SX]:
        return {"front": vertcat(q.front_x, q.front_y), "back": vertcat(q.back_x, q.back_y)}
