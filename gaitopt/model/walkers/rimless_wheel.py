"""Rimless wheel: a rigid star of spokes that rolls down a slope. Gamus & Or (2013), section III.

``theta`` is the angle of the stance spoke from the slope's normal, from -pi/spokes to +pi/spokes in a step.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import Annotated, Any

from casadi import SX, cos, pi, sin, vertcat
from pydantic import Field

from gaitopt.model.mechanism import Link, Mechanism, polar
from gaitopt.model.units import Positive, Slope, Within
from gaitopt.model.walker import Walker


class RimlessWheel(Walker):
    """Rimless wheel that rolls down a slope."""

    model = "rimless_wheel"
    shape = ("theta",)
    section = ()
    largest_angle = pi / 2

    spokes: Annotated[int, Field(ge=3, le=1000, strict=True, description="number of spokes"), Within(usual=(3, 100))]
    radius: Annotated[Positive, Field(description="length of a spoke [m]")]
    mass: Annotated[Positive, Field(description="mass [kg]")]
    inertia_ratio: Annotated[float, Field(ge=0, le=1, strict=True, description="moment of inertia / (mass radius^2)")]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")]

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The mechanism of the links; the wheel lands with its hub above the middle of two spokes."""
        half_angle = pi / p.spokes
        return replace(
            super().mechanism(q, p),
            touchdown=q.theta - half_angle,
            upright=q.theta + half_angle,  # zero where the wheel falls back on the previous spoke
            trailing_foot=vertcat(q.x, q.y) + polar(p.radius, q.theta) - polar(p.radius, q.theta + 2 * half_angle),
            relabel=SX(q.theta - 2 * half_angle),
        )

    @classmethod
    def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
        """The hub with all mass, the stance spoke and the next one; the others never touch the ground in a step."""
        turn = 2 * pi / p.spokes
        spoke = {"angle": q.theta, "parent": "hub", "foot": True}
        return (
            Link(name="hub", angle=q.theta, mass=p.mass, inertia=p.inertia_ratio * p.mass * p.radius**2),
            Link(name="stance_spoke", tip=(0, -p.radius), **spoke),
            Link(name="swing_spoke", tip=(p.radius * sin(turn), -p.radius * cos(turn)), **spoke),
        )

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """The wheel stands on two spokes: theta = -pi/spokes."""
        return (-pi / p.spokes,)

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[Any, ...], ...]:
        """No lines: figures draw all spokes, whose number is not a symbol."""
        return ()
