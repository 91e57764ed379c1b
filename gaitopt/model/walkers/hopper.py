"""Hopper: a body on a springy leg with an unsprung foot, driven by a constant thrust. Raibert (1986).

``shortening`` is the full length of the leg less its present length. At full length the spring has no force and a stop
ends the extension. While the leg shortens, only the spring acts on it; after maximum compression a constant thrust acts
as well. When the leg reaches its stop, it pulls the foot off the ground and stays locked until the foot lands.

The speed of touchdown and its multiplier have closed forms. With rho = m_b / (m_b + m_f), A = (rho^-2 - 1) m_b / (2 F),

    v* = sqrt(m_b (1 + 2 A g) / (k A^2)),      multiplier rho^2 + (1 - rho^2) / (2 (1 + A g))
"""

from types import SimpleNamespace
from typing import Annotated, Any

from casadi import SX, sqrt, vertcat
from pydantic import Field

from gaitopt.model.mechanism import Body, Mechanism, coil
from gaitopt.model.units import SMALLEST_SIZE, Positive, Stiffness, Within
from gaitopt.model.walker import Walker


class Hopper(Walker):
    """Hopper that hops on the spot."""

    model = "hopper"
    shape = ("shortening",)
    section = ()
    lengths = ("shortening",)
    stops = ("leg",)
    open_in_impact = ("leg",)
    switches = ("thrust",)
    flies = True

    leg_length: Annotated[Positive, Field(description="full length of the leg [m]")]
    body_mass: Annotated[Positive, Field(description="mass of the body [kg]")]
    foot_mass: Annotated[Positive, Field(description="mass of the foot [kg]")]
    stiffness: Annotated[Stiffness, Field(ge=SMALLEST_SIZE, description="stiffness of the leg [N/m]")]
    thrust: Annotated[
        Positive,
        Field(description="force that extends the leg after maximum compression [N]"),
        Within(unit="force", possible=(0, 1e4), usual=(0, 100)),
    ]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """Two point masses above each other."""
        foot = vertcat(q.x, q.y)
        leg = p.leg_length - q.shortening
        natural_speed = sqrt(p.gravity * p.leg_length)
        return Mechanism(
            bodies=(
                Body(mass=p.foot_mass, position=foot),
                Body(mass=p.body_mass, position=foot + vertcat(0, leg)),
            ),
            gravity=vertcat(0, -p.gravity),
            swing_foot=foot,
            touchdown=-q.y / p.leg_length,
            upright=leg / p.leg_length,
            relabel=SX(q.shortening),
            stops={"leg": q.shortening / p.leg_length},
            switches={"thrust": lambda dq: dq.shortening / natural_speed},
            potential=p.stiffness * q.shortening**2 / 2,
            potential_while={"thrust on": p.thrust * q.shortening},
        )

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[SX, ...], ...]:
        """The spring from the foot to the body."""
        foot = vertcat(q.x, q.y)
        return (coil(foot, foot + vertcat(0, p.leg_length - q.shortening), 0.08 * p.leg_length),)

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """The leg has its full length."""
        return (0.0,)
