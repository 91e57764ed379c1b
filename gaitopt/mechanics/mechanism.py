"""What a walker consists of, in CasADi symbols: bodies, springs, dampers, guards; and points and lines to state it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from casadi import SX, norm_2, vertcat


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """A point mass, or with ``inertia`` and ``angle`` a rigid body.

    Attributes
    ----------
    mass : SX or float [kg]
    position : SX, shape (2,) - centre of mass [m]
    inertia : SX or float - about the centre of mass [kg m^2]
    angle : SX - orientation [rad]
    """

    mass: Any
    position: SX
    inertia: Any = 0.0
    angle: Any = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Damper:
    """A viscous damper, which resists with ``coefficient`` times the rate of what it is mounted across.

    Attributes
    ----------
    coefficient : SX or float [N m s/rad or N s/m], not negative.
    across : SX - an angle or a length, as a function of the coordinates [rad or m].
    """

    coefficient: Any
    across: SX


@dataclass(frozen=True, slots=True, kw_only=True)
class Mechanism:
    """Positions and angles of a walker as functions of ``q``, in CasADi symbols.

    Attributes
    ----------
    bodies : the masses.
    gravity : SX, shape (2,) - acceleration of gravity in (x, y) [m/s^2].
    swing_foot : SX, shape (2,) - the foot that will collide [m].
    touchdown : SX - guard; the swing foot lands when it crosses zero from below.
    upright : SX - positive while the walker is walking; zero is a fall.
    relabel : SX, shape (n_shape,) - shape coordinates after the feet have swapped roles.
    stops : gaps of the joint stops by name, affine in the shape: positive while free, held at zero while locked; an
        angle [rad], or a length by the length of a leg.
    switches : margins of the switches by name, without unit: positive while off; functions of the coordinates' rates,
        which they are given by name (``dq.theta``).
    motors : tuple of SX - the angle on which each actuator acts, in the order of ``Walker.actuators`` [rad].
    potential : SX - potential energy besides gravity, of springs for instance [J].
    potential_while : further potential energy, which acts only in a state: ``contact`` (the foot is on the ground), or
        that of a stop or switch, such as ``thrust on`` [J].
    dampers : the viscous dampers.
    push : SX, shape (2,) - impulse of the ground on the stance foot just before the swing foot lands, of a walker that
        pushes off [N s].
    """

    bodies: tuple[Body, ...]
    gravity: SX
    swing_foot: SX
    touchdown: SX
    upright: SX
    relabel: SX
    stops: Mapping[str, SX] = field(default_factory=dict)
    switches: Mapping[str, Callable[[SimpleNamespace], SX]] = field(default_factory=dict)
    motors: tuple[SX, ...] = ()
    potential: Any = field(default_factory=lambda: SX(0))
    potential_while: Mapping[str, SX] = field(default_factory=dict)
    dampers: tuple[Damper, ...] = ()
    push: SX | None = None


def polar(length: Any, angle: Any) -> SX:
    """The point at ``length`` from the origin, ``angle`` from the slope's normal towards downhill; shape (2,) [m]."""
    return vertcat(length * SX(angle).sin(), length * SX(angle).cos())


def inclined(gravity: Any, slope: Any) -> SX:
    """Acceleration of gravity [m/s^2] along a slope, downhill, and along its normal; shape (2,)."""
    return gravity * vertcat(SX(slope).sin(), -SX(slope).cos())


def coil(start: SX, end: SX, width: Any, turns: int = 5) -> tuple[SX, ...]:
    """Points of a zigzag line from ``start`` to ``end`` [m] that draws a spring with turns of some ``width`` [m]."""
    along = end - start
    aside = width / 2 * vertcat(-along[1], along[0]) / norm_2(along)
    zigzag = (start + (k + 0.5) / (2 * turns) * along + (-1) ** k * aside for k in range(2 * turns))
    return (start, *zigzag, end)
