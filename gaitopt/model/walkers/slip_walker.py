"""Spring-mass walking: a point mass (x, y) on two massless springy legs. Geyer, Seyfarth, Blickhan (2006).

Each leg pushes along its length with k (l0 - l) while its foot is on the ground, and leaves where it has its full
length. The other leg is held at the angle of attack, measured from the ground, and lands where the mass has fallen to
the height l0 sin(attack), without an impulse. Both feet are on the ground for a while in every step, which makes this
gait a walk; ``slip_runner`` runs on the same legs. The coordinates of a leg are those of its foot relative to the mass.

Energy is conserved; the parameter ``energy`` fixes it, which removes the multiplier of one from the return map.
"""

from types import SimpleNamespace
from typing import Annotated

from casadi import SX, cos, pi, sin, sqrt, sumsqr, vertcat
from pydantic import Field

from gaitopt.model.mechanism import Body, Contact, Mechanism, coil
from gaitopt.model.units import SMALLEST_SIZE, Angle, Positive, Stiffness, Within
from gaitopt.model.walker import Walker


class SlipWalker(Walker):
    """Point mass on two massless springs, on level ground."""

    model = "slip_walker"
    shape = ("front_x", "front_y", "back_x", "back_y")
    lengths = shape
    contacts = ("front", "back")
    massless_contacts = contacts
    landing_contacts = ("back",)
    exchanged_contacts = {"front": "back"}  # noqa: RUF012

    mass: Annotated[Positive, Field(description="point mass [kg]")]
    leg_length: Annotated[Positive, Field(description="full length of a leg [m]")]
    stiffness: Annotated[Stiffness, Field(ge=SMALLEST_SIZE, description="stiffness of a leg [N/m]")]
    attack: Annotated[
        Angle, Field(ge=0.01, le=pi - 0.01, description="angle of attack, measured from the ground [rad]")
    ]
    energy: Annotated[
        Positive,
        Field(description="mechanical energy relative to the ground [J]"),
        Within(unit="torque", possible=(0, 1e4), usual=(0, 100)),
    ]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The back foot is the next to land, ahead of the mass; then the feet swap names."""
        body = vertcat(q.x, q.y)
        legs = {"front": vertcat(q.front_x, q.front_y), "back": vertcat(q.back_x, q.back_y)}
        placed = p.leg_length * vertcat(cos(p.attack), -sin(p.attack))
        springs = {name: p.stiffness / 2 * (p.leg_length - sqrt(sumsqr(leg))) ** 2 for name, leg in legs.items()}
        return Mechanism(
            bodies=(Body(mass=p.mass, position=body),),
            gravity=vertcat(0, -p.gravity),
            upright=q.y / p.leg_length,
            swing_foot=body,
            relabel=vertcat(q.back_x, q.back_y, q.front_x, q.front_y),
            potential_while=springs,
            contacts={
                name: Contact(
                    position=body + leg,
                    gap=q.y - p.leg_length * sin(p.attack) if name == "back" else SX(1),
                    places={f"{name}_x": placed[0], f"{name}_y": placed[1]},
                )
                for name, leg in legs.items()
            },
            length=SX(p.leg_length),
        )

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[SX, ...], ...]:
        """Both springs from the feet to the mass."""
        body, width = vertcat(q.x, q.y), 0.08 * p.leg_length
        return tuple(coil(body + vertcat(*leg), body, width) for leg in ((q.front_x, q.front_y), (q.back_x, q.back_y)))
