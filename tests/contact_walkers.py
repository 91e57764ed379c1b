"""Walkers with several contacts, each with numbers and with mechanics written by hand as an oracle."""

from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from casadi import SX, cos, pi, sin, sqrt, sumsqr, vertcat
from numpy.typing import NDArray
from oracles import Link, Mass, Oracle, Point, slope_gravity

from gaitopt.model.control import NoControl
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import COULOMB, ContactFriction, Friction
from gaitopt.model.system import HybridSystem
from gaitopt.model.walker import Body, Contact, Damper, Mechanism, Walker, inclined, polar

Array = NDArray[np.float64]


class HeelToe(Walker):
    """A compass whose legs end in rigid flat feet without mass; (x, y) is the ankle of the stance leg."""

    model = "heel_toe"
    shape = ("theta1", "theta2")
    section = ("theta1",)
    contacts = ("heel", "toe", "swing_heel", "swing_toe")
    landing_contacts = ("swing_heel", "swing_toe")
    exchanged_contacts = {"heel": "swing_heel", "toe": "swing_toe"}  # noqa: RUF012

    leg_length: float
    leg_mass: float
    leg_com: float
    hip_mass: float
    heel: float
    toe: float
    gravity: float
    slope: float

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        ankle = vertcat(q.x, q.y)
        hip = ankle + polar(p.leg_length, q.theta1)
        other = hip - polar(p.leg_length, -q.theta2)

        def sole(ankle: SX, angle: SX, ahead: SX) -> SX:
            return ankle + ahead * vertcat(cos(angle), -sin(angle))

        past = q.theta1 - 0.05
        return Mechanism(
            bodies=(
                Body(mass=p.leg_mass, position=ankle + polar(p.leg_com, q.theta1)),
                Body(mass=p.hip_mass, position=hip),
                Body(mass=p.leg_mass, position=hip - polar(p.leg_length - p.leg_com, -q.theta2)),
            ),
            gravity=inclined(p.gravity, p.slope),
            upright=cos(q.theta1),
            swing_foot=other,
            relabel=vertcat(-q.theta2, -q.theta1),
            contacts={
                "heel": Contact(position=sole(ankle, q.theta1, -p.heel)),
                "toe": Contact(position=sole(ankle, q.theta1, p.toe)),
                "swing_heel": Contact(position=sole(other, -q.theta2, -p.heel), counts=past),
                "swing_toe": Contact(position=sole(other, -q.theta2, p.toe), counts=past),
            },
        )

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        return (free.theta1, free.theta1)


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


class Crawler(Walker):
    """Two masses on a line with a spring, a damper and a motor between them."""

    model = "crawler"
    shape = ("gap", "rise")
    section = ("gap",)
    lengths = shape
    contacts = ("rear", "front")
    actuators = ("drive",)
    tracked = ("gap",)

    rear_mass: float
    front_mass: float
    stiffness: float
    damping: float
    rest: float
    gravity: float
    slope: float

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        rear, front = vertcat(q.x, q.y), vertcat(q.x + q.gap, q.y + q.rise)
        return Mechanism(
            bodies=(Body(mass=p.rear_mass, position=rear), Body(mass=p.front_mass, position=front)),
            gravity=inclined(p.gravity, p.slope),
            upright=SX(1),
            motors=(q.gap,),
            potential=p.stiffness / 2 * (q.gap - p.rest) ** 2,
            dampers=(Damper(coefficient=p.damping, across=q.gap),),
            contacts={"rear": Contact(position=rear), "front": Contact(position=front)},
            length=SX(p.rest),
        )

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        return (free.gap, 0.0)


class SpringMassWalker(Walker):
    """Spring-mass walking: a point mass (x, y) on two massless springy legs. Geyer, Seyfarth, Blickhan (2006)."""

    model = "slip_walker"
    shape = ("front_x", "front_y", "back_x", "back_y")
    section = ()
    lengths = shape
    contacts = ("front", "back")
    massless_contacts = contacts
    landing_contacts = ("back",)
    exchanged_contacts = {"front": "back"}  # noqa: RUF012

    mass: float
    leg_length: float
    stiffness: float
    attack: float
    gravity: float

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
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
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        return (0.0,) * 4


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
    shared = ContactFriction.shared(walker.contacts, COULOMB)
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
        masses=(Mass(1.0, Point(()), inertia),),
        swing_foot=Point(()),
        gravity=slope_gravity(9.81, slope),
        hip=Point(()),
    )
    return ContactCase(walker, oracle, feet)


CRAWLER = Crawler(rear_mass=1.0, front_mass=1.5, stiffness=20.0, damping=1.5, rest=0.5, gravity=9.81, slope=0.1)
SPRING_MASS = SpringMassWalker(mass=80.0, leg_length=1.0, stiffness=14e3, attack=np.deg2rad(69), gravity=9.81)
