"""The parts of a walker: bodies, links, contacts and the mechanism that they form, in CasADi symbols.

The coordinates are ``q = (shape..., x, y)``: (x, y) is the stance foot, with x along the slope downhill and y along its
normal.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from casadi import SX, norm_2, vertcat

from gaitopt.model.modes import FOOT

ORIGIN = (0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """A point mass, or with ``inertia`` and ``angle`` a rigid body.

    Attributes
    ----------
    mass : SX or float [kg]
    position : SX, shape (2,) - centre of mass [m]
    inertia : SX or float - moment of inertia about the centre of mass [kg m^2]
    angle : SX - orientation [rad]
    """

    mass: Any
    position: SX
    inertia: Any = 0.0
    angle: Any = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Damper:
    """A viscous damper: its force is ``coefficient`` times the rate of ``across``.

    Attributes
    ----------
    coefficient : SX or float [N m s/rad or N s/m], not negative.
    across : SX - an angle or a length, as a function of the coordinates [rad or m].
    """

    coefficient: Any
    across: SX


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """A point of a walker that can touch the ground, whose height is y = 0.

    Attributes
    ----------
    position : SX, shape (2,) - the point [m].
    counts : SX - number that is positive if the point may land, for instance past mid-swing; otherwise it passes
        through the ground.
    places : for a contact at the end of a massless part, its own coordinates with the values that they take when it
        lands. Such a contact sticks or is off.
    gap : SX - number that falls to zero when the point lands; its height by default. A massless contact has no height
        of its own.
    """

    position: SX
    counts: Any = 1.0
    places: Mapping[str, SX] = field(default_factory=dict)
    gap: SX | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Mechanism:
    """Positions and angles of a walker as functions of ``q``, in CasADi symbols.

    Attributes
    ----------
    bodies : the masses.
    gravity : SX, shape (2,) - acceleration of gravity in (x, y) [m/s^2].
    swing_foot : SX, shape (2,) - the foot that will collide [m].
    touchdown : SX - guard; the swing foot lands when it crosses zero from below.
    upright : SX - number that is positive while the walker is upright; the walker falls when it is zero.
    trailing_foot : SX, shape (2,) - the foot that has just left the ground, if the walker falls back on it when
        ``upright`` is zero [m]; None if it does not.
    relabel : SX, shape (n_shape,) - shape coordinates after the feet have swapped roles.
    stops : gaps of the joint stops by name, affine in the shape: positive while free, zero while locked. Each is an
        angle [rad], or a length divided by that of a leg.
    switches : dimensionless margins of the switches by name, positive while off. They are functions of the rates, which
        are given by name (``dq.theta``).
    phases : phase variables by name, functions of the shape and the parameters only.
    motors : tuple of SX - the angle or length on which each actuator acts, in the order of ``Walker.actuators`` [rad or
        m]; for an actuator of ``Walker.external``, the position of the pushed point along its direction [m].
    potential : SX - potential energy without that of gravity, for instance of springs [J].
    potential_while : potential energy that acts only in a state [J]: ``contact`` (the foot is on the ground), or the
        state of a stop or switch, such as ``thrust on``.
    dampers : the viscous dampers.
    push : impulse of the ground on each contact of ``Walker.pushes`` just before another one lands, by its name, each
        of shape (2,) [N s]; without a mapping, the impulse on a stance foot that has no name. None if the walker does
        not push off.
    contacts : the points that can touch the ground by name, if the walker has several contacts.
    sections : dimensionless margins by name, any of which may end a cycle when it falls to zero; they are functions of
        the rates, like ``switches``.
    length : natural unit of length [m]; by default the largest distance of a body from the stance foot, or from a
        contact, when all shape coordinates are zero.
    """

    bodies: tuple[Body, ...]
    gravity: SX
    upright: SX
    swing_foot: SX = field(default_factory=lambda: SX.zeros(2))
    touchdown: SX = field(default_factory=lambda: SX(1))
    trailing_foot: SX | None = None
    relabel: SX = field(default_factory=lambda: SX(0, 1))
    stops: Mapping[str, SX] = field(default_factory=dict)
    switches: Mapping[str, Callable[[SimpleNamespace], SX]] = field(default_factory=dict)
    phases: Mapping[str, SX] = field(default_factory=dict)
    motors: tuple[SX, ...] = ()
    potential: Any = field(default_factory=lambda: SX(0))
    potential_while: Mapping[str, SX] = field(default_factory=dict)
    dampers: tuple[Damper, ...] = ()
    push: SX | Mapping[str, SX] | None = None
    contacts: Mapping[str, Contact] = field(default_factory=dict)
    sections: Mapping[str, Callable[[SimpleNamespace], SX]] = field(default_factory=dict)
    length: SX | None = None

    @property
    def pushes(self) -> Mapping[str, SX]:
        """Impulse of every contact that pushes off, by its name."""
        if self.push is None:
            return {}
        return self.push if isinstance(self.push, Mapping) else {FOOT: self.push}


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """A rigid link of a planar tree; points are in the frame of a link, shape (2,) [m].

    Attributes
    ----------
    name : name of the link.
    angle : SX - absolute angle of the frame, from the slope's normal towards downhill [rad].
    parent : name of the link that carries it; None for the root of the tree.
    joint : name of the joint with the parent; empty for the root, and for a link that is fixed to its parent.
    position : the joint, or the origin of a fixed link, in the frame of the parent; it is the origin of this frame.
    sign : 1, or -1 for a joint whose angle has the opposite sign.
    zero : the joint's angle is ``sign`` times (the angle of this link minus that of its parent), plus ``zero`` [rad].
    tip : the other end of the link in drawings, which is the foot if there is one.
    foot : whether the tip is a foot. The first link with a foot belongs to the stance leg, the second one swings.
    foot_radius : radius of a round foot, whose centre is the tip [m].
    mass : mass [kg].
    com : centre of mass.
    inertia : moment of inertia about the centre of mass [kg m^2].
    rotor_inertia : moment of inertia of the joint's rotor, times the square of the gear ratio [kg m^2].
    damping : coefficient of a viscous damper in the joint [N m s/rad].
    range : smallest and largest angle of the joint; None if it has none [rad].
    effort : largest torque of the joint's motor; None if it has no limit [N m].
    """

    name: str
    angle: Any
    parent: str | None = None
    joint: str = ""
    position: Any = ORIGIN
    sign: int = 1
    zero: float = 0.0
    tip: Any = ORIGIN
    foot: bool = False
    foot_radius: Any = 0.0
    mass: Any = 0.0
    com: Any = ORIGIN
    inertia: Any = 0.0
    rotor_inertia: Any = 0.0
    damping: Any = 0.0
    range: tuple[float, float] | None = None
    effort: float | None = None


def polar(length: Any, angle: Any) -> SX:
    """The point at ``length`` from the origin, ``angle`` from the slope's normal towards downhill; shape (2,) [m]."""
    return vertcat(length * SX(angle).sin(), length * SX(angle).cos())


def inclined(gravity: Any, slope: Any) -> SX:
    """Acceleration of gravity [m/s^2] along a slope, downhill, and along its normal; shape (2,)."""
    return gravity * vertcat(SX(slope).sin(), -SX(slope).cos())


def coil(start: SX, end: SX, width: Any, turns: int = 5) -> tuple[SX, ...]:
    """Points of a zigzag line from ``start`` to ``end`` [m] that draws a spring of this ``width`` [m]."""
    along = end - start
    aside = width / 2 * vertcat(-along[1], along[0]) / norm_2(along)
    zigzag = (start + (k + 0.5) / (2 * turns) * along + (-1) ** k * aside for k in range(2 * turns))
    return (start, *zigzag, end)
