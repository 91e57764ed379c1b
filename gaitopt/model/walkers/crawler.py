"""Crawler: two masses on a line, joined by a spring, a damper and a motor, with different friction on the ground.

The motor pushes the masses apart in one half of its period and pulls them together in the other. With suitable friction
one mass rests in each half while the other slides, and the crawler advances. Each slide is half an oscillation:

    gap(t) = rest + F/k + exp(-s t) (a cos(w t) + b sin(w t)),    s = c / (2 m),    w^2 = k/m - s^2

for the mass m that slides, where the force F includes gravity along the slope and friction. The slides end where the
gap's rate is zero, so that the multiplier of the gap is exp(-(s_1 pi/w_1 + s_2 pi/w_2)).
"""

from types import SimpleNamespace
from typing import Annotated

from casadi import SX, vertcat
from pydantic import Field

from gaitopt.model.mechanism import Body, Contact, Damper, Mechanism, coil, inclined
from gaitopt.model.units import Damping, Positive, Slope, Stiffness
from gaitopt.model.walker import Walker

SIDE = 0.12
"""Half the side of a mass, relative to the rest length of the spring."""


class Crawler(Walker):
    """Two masses on a line."""

    model = "crawler"
    shape = ("gap", "rise")
    lengths = shape
    contacts = ("rear", "front")
    actuators = ("drive",)
    tracked = ("gap",)

    rear_mass: Annotated[Positive, Field(description="mass of the rear [kg]")]
    front_mass: Annotated[Positive, Field(description="mass of the front [kg]")]
    stiffness: Annotated[Stiffness, Field(description="stiffness of the spring [N/m]")]
    damping: Annotated[Damping, Field(description="coefficient of the damper [N s/m]")]
    rest: Annotated[Positive, Field(description="distance of the masses at which the spring has no force [m]")]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")]

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """(x, y) is below the rear mass; the front one is ``gap`` ahead and ``rise`` higher, which stays 0."""
        rear, front, up = vertcat(q.x, q.y), vertcat(q.x + q.gap, q.y + q.rise), vertcat(0, SIDE * p.rest)
        return Mechanism(
            bodies=(Body(mass=p.rear_mass, position=rear + up), Body(mass=p.front_mass, position=front + up)),
            gravity=inclined(p.gravity, p.slope),
            upright=SX(1),
            motors=(q.gap,),
            potential=p.stiffness / 2 * (q.gap - p.rest) ** 2,
            dampers=(Damper(coefficient=p.damping, across=q.gap),),
            contacts={"rear": Contact(position=rear), "front": Contact(position=front)},
            length=SX(p.rest),
        )

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[SX, ...], ...]:
        """Two boxes, and the spring between them."""
        side = SIDE * p.rest
        rear, front = vertcat(q.x, q.y), vertcat(q.x + q.gap, q.y + q.rise)
        corners = ((-side, 0), (side, 0), (side, 2 * side), (-side, 2 * side), (-side, 0))
        boxes = tuple(tuple(at + vertcat(*corner) for corner in corners) for at in (rear, front))
        return (*boxes, coil(rear + vertcat(side, side), front + vertcat(-side, side), side))
