"""Runner on a springy leg with an unsprung foot: a spring-loaded inverted pendulum whose foot may slide.

``theta`` is the angle of the leg from the slope's normal; ``shortening`` is the difference between its full length and
its length. At full length a stop ends the extension and pulls the foot off the ground. A spring between the leg and the
body, whose orientation is fixed, swings the leg forward again. The slope balances the loss in impacts.
"""

from types import SimpleNamespace
from typing import Annotated, Any

from casadi import SX, cos, pi, vertcat
from pydantic import Field

from gaitopt.model.mechanism import Body, Mechanism, coil, inclined, polar
from gaitopt.model.units import SMALLEST_SIZE, Angle, Positive, Slope, Stiffness, TurningStiffness
from gaitopt.model.walker import Walker


class SlipRunnerFoot(Walker):
    """Runner on one springy leg with an unsprung foot."""

    model = "slip_runner_foot"
    shape = ("theta", "shortening")
    section = ("theta",)
    lengths = ("shortening",)
    stops = ("leg",)
    open_in_impact = ("leg",)
    flies = True
    largest_angle = pi / 2

    body_mass: Annotated[Positive, Field(description="mass of the body [kg]")]
    foot_mass: Annotated[Positive, Field(description="mass of the foot [kg]")]
    leg_length: Annotated[Positive, Field(description="full length of the leg [m]")]
    stiffness: Annotated[Stiffness, Field(ge=SMALLEST_SIZE, description="stiffness of the leg [N/m]")]
    hip_stiffness: Annotated[
        TurningStiffness, Field(ge=SMALLEST_SIZE, description="stiffness of the spring that turns the leg [N m/rad]")
    ]
    hip_rest: Annotated[
        Angle, Field(ge=-pi, le=pi, description="angle of the leg at which this spring has no torque [rad]")
    ]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")]

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """Two point masses; touchdown when the foot is back on the ground."""
        foot = vertcat(q.x, q.y)
        return Mechanism(
            bodies=(
                Body(mass=p.foot_mass, position=foot),
                Body(mass=p.body_mass, position=foot + polar(p.leg_length - q.shortening, q.theta)),
            ),
            gravity=inclined(p.gravity, p.slope),
            swing_foot=foot,
            touchdown=SX(-q.y / p.leg_length),
            upright=cos(q.theta),
            relabel=vertcat(q.theta, q.shortening),
            stops={"leg": q.shortening / p.leg_length},
            potential=p.stiffness * q.shortening**2 / 2 + p.hip_stiffness * (q.theta - p.hip_rest) ** 2 / 2,
        )

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[SX, ...], ...]:
        """The spring from the foot to the body."""
        foot = vertcat(q.x, q.y)
        return (coil(foot, foot + polar(p.leg_length - q.shortening, q.theta), 0.08 * p.leg_length),)

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """The leg has its full length."""
        return (free.theta, 0.0)
