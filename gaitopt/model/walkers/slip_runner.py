"""Spring-loaded inverted pendulum: a point mass that runs on massless springy legs. Blickhan (1989), Geyer (2006).

``theta`` is the angle of the stance leg from the slope's normal; ``shortening`` is the difference between the full
length of the leg, at which it takes off, and its length. In flight the next leg is held at the angle of attack,
measured from the ground; it lands without an impulse. Energy is conserved, which would give the return map a multiplier
of one. The parameter ``energy`` removes it: one rate is free on the section at touchdown.
"""

from types import SimpleNamespace
from typing import Annotated, Any

from casadi import SX, cos, if_else, pi, sin, sqrt, vertcat
from pydantic import Field

from gaitopt.model.mechanism import Body, Mechanism, coil, polar
from gaitopt.model.units import SMALLEST_SIZE, Angle, Positive, Stiffness, Within
from gaitopt.model.walker import Walker


class SlipRunner(Walker):
    """Spring-loaded inverted pendulum on level ground."""

    model = "slip_runner"
    shape = ("theta", "shortening")
    section = ()
    section_rates = ("theta",)
    lengths = ("shortening",)
    flies = True
    massless_feet = True
    largest_angle = pi / 2

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
        """A point mass; the foot that lands is ahead of it at the angle of attack."""
        body = vertcat(q.x, q.y) + polar(p.leg_length - q.shortening, q.theta)
        foot = body - polar(p.leg_length, p.attack - pi / 2)
        return Mechanism(
            bodies=(Body(mass=p.mass, position=body),),
            gravity=vertcat(0, -p.gravity),
            swing_foot=foot,
            touchdown=(q.y - foot[1]) / p.leg_length,
            upright=cos(q.theta),
            relabel=vertcat(p.attack - pi / 2, 0),
            potential_while={"contact": p.stiffness * q.shortening**2 / 2},
        )

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[SX, ...], ...]:
        """The spring from the foot to the body; in flight from the position of the next foot."""
        body = vertcat(q.x, q.y) + polar(p.leg_length - q.shortening, q.theta)
        next_foot = body - polar(p.leg_length, p.attack - pi / 2)
        on_ground = if_else(q.shortening > 0, vertcat(q.x, q.y), next_foot)
        return (coil(on_ground, body, 0.08 * p.leg_length),)

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """The leg has its full length and the angle of attack."""
        return (p.attack - pi / 2, 0.0)

    @classmethod
    def rates_after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """The kinetic energy is the energy less the potential energy at touchdown."""
        square = 2 * (p.energy / p.mass - p.gravity * p.leg_length * sin(p.attack))
        return (free.dtheta, sqrt(square - (p.leg_length * free.dtheta) ** 2))
