"""Walkers with named contacts, each with numbers and with mechanics written by hand as an oracle."""

from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from casadi import SX, cos, pi, sin, vertcat
from numpy.typing import NDArray
from oracles import Link, Mass, Oracle, Point, slope_gravity

from gaitopt.model.control import NoControl
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import COULOMB, ContactFriction, Friction, shared_friction
from gaitopt.model.mechanism import Body, Contact, Mechanism, inclined
from gaitopt.model.system import HybridSystem
from gaitopt.model.walker import Walker
from gaitopt.model.walkers.crawler import Crawler
from gaitopt.model.walkers.heel_toe import HeelToe
from gaitopt.model.walkers.inchworm import Inchworm

Array = NDArray[np.float64]


class Frame(Walker):
    """A rigid body on two feet, ``half`` beside its centre of mass and ``height`` below it."""

    model = "frame"
    shape = ("theta",)
    section = ()
    contacts = ("left", "right")

    half: float
    height: float
    mass: float
    inertia: float
    gravity: float
    slope: float

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        centre, c, s = vertcat(q.x, q.y), cos(q.theta), sin(q.theta)

        def foot(aside: SX) -> Contact:
            return Contact(position=centre + vertcat(c * aside - s * p.height, -s * aside - c * p.height))

        return Mechanism(
            bodies=(Body(mass=p.mass, position=centre, inertia=p.inertia, angle=q.theta),),
            gravity=inclined(p.gravity, p.slope),
            upright=cos(q.theta),
            contacts={"left": foot(-p.half), "right": foot(p.half)},
        )

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        return (0.0,)


@dataclass(frozen=True)
class ContactCase:
    """A walker with numbers, and its oracle with the contacts as points."""

    walker: Walker
    oracle: Oracle
    points: dict[str, Point]

    def dynamics(self, friction: float | dict[str, float]) -> Dynamics:
        """The passive system with one coefficient for all contacts, or one for each."""
        return dynamics_of(self.walker, friction)

    def state(self, q: Array, dq: Array) -> Array:
        """State (shape, y, x, rates) from coordinates (shape, x, y) and their rates."""
        order = [*range(len(self.walker.shape)), len(self.walker.shape) + 1, len(self.walker.shape)]
        return np.concatenate([q[order], dq[order]])


@cache
def passive(walker: type[Walker], names: tuple[str, ...]) -> HybridSystem:
    shared = shared_friction(walker.contacts, COULOMB)
    each = ContactFriction(tuple((name, Friction(f"friction.{name}", f"friction.{name}")) for name in names))
    return HybridSystem(walker, NoControl(), friction=each if names else shared)


def dynamics_of(walker: Walker, friction: float | dict[str, float]) -> Dynamics:
    numbers = [float(value) for _, value in walker]
    values = list(friction.values()) if isinstance(friction, dict) else [friction]
    names = tuple(friction) if isinstance(friction, dict) else ()
    return Dynamics(passive(type(walker), names), np.array([*numbers, *values]))


def heel_toe(**changed: float) -> ContactCase:
    numbers = {
        "leg_length": 1.0, "leg_mass": 5.0, "leg_com": 0.5, "hip_mass": 10.0, "heel": 0.02, "toe": 0.04,
        "gravity": 9.81, "slope": 0.0524,
    } | changed  # fmt: skip
    stance, swing = Link(numbers["leg_length"], 0), Link(-numbers["leg_length"], 1, sign=-1)

    def sole(links: tuple[Link, ...], index: int, sign: int, ahead: float) -> Point:
        return Point((*links, Link(ahead, index, sign=sign, offset=pi / 2)))

    return ContactCase(
        HeelToe(**numbers),
        Oracle(
            masses=(
                Mass(numbers["leg_mass"], Point((Link(numbers["leg_com"], 0),))),
                Mass(numbers["hip_mass"], Point((stance,))),
                Mass(
                    numbers["leg_mass"], Point((stance, Link(numbers["leg_com"] - numbers["leg_length"], 1, sign=-1)))
                ),
            ),
            swing_foot=Point((stance, swing)),
            gravity=slope_gravity(numbers["gravity"], numbers["slope"]),
            hip=Point((stance,)),
        ),
        {
            "heel": sole((), 0, 1, -numbers["heel"]),
            "toe": sole((), 0, 1, numbers["toe"]),
            "swing_heel": sole((stance, swing), 1, -1, -numbers["heel"]),
            "swing_toe": sole((stance, swing), 1, -1, numbers["toe"]),
        },
    )


def frame(half: float, height: float, *, slope: float = 0.0, inertia: float | None = None) -> ContactCase:
    """A frame of mass 1; by default with the inertia of a homogeneous block."""
    inertia = (half**2 + height**2) / 3 if inertia is None else inertia
    walker = Frame(half=half, height=height, mass=1.0, inertia=inertia, gravity=9.81, slope=slope)
    below = Link(-height, 0)
    feet = {name: Point((below, Link(side * half, 0, offset=pi / 2))) for name, side in (("left", -1), ("right", 1))}
    oracle = Oracle(
        masses=(Mass(1.0, Point(()), inertia),), swing_foot=Point(()), gravity=slope_gravity(9.81, slope), hip=Point(())
    )
    return ContactCase(walker, oracle, feet)


@dataclass(frozen=True)
class Along:
    """A point that is carried by coordinates along x and y, besides those of the base point."""

    carried: tuple[int, ...] = ()

    def position(self, q: Array) -> Array:
        return q[-2:] + (q[list(self.carried)] if self.carried else 0)

    def jacobian(self, q: Array) -> Array:
        J = np.zeros((2, q.size))
        J[:, -2:] = np.eye(2)
        J[:, list(self.carried)] += np.eye(2)[:, : len(self.carried)]
        return J

    def velocity(self, q: Array, dq: Array) -> Array:
        return self.jacobian(q) @ dq

    def centripetal(self, q: Array, dq: Array) -> Array:
        return np.zeros(2)


def crawler(walker: Crawler) -> ContactCase:
    rear, front = Along(), Along((0, 1))
    masses = (Mass(walker.rear_mass, rear), Mass(walker.front_mass, front))
    oracle = Oracle(masses=masses, swing_foot=rear, gravity=slope_gravity(walker.gravity, walker.slope), hip=rear)
    return ContactCase(walker, oracle, {"rear": rear, "front": front})


def inchworm(walker: Inchworm) -> ContactCase:
    hinge = Point(())
    coms, feet = (
        [Point((Link(-length, index, sign=sign),)) for index, sign in ((0, 1), (1, -1))]
        for length in (walker.link_com, walker.link_length)
    )
    links = [Mass(walker.link_mass, com, walker.link_inertia, index) for index, com in enumerate(coms)]
    oracle = Oracle(
        masses=(Mass(walker.hinge_mass, hinge), *links),
        swing_foot=hinge,
        gravity=slope_gravity(walker.gravity, walker.slope),
        hip=hinge,
    )
    return ContactCase(walker, oracle, dict(zip(("rear", "front"), feet, strict=True)))
