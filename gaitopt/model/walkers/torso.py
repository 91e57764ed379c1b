"""Compass biped with a torso, which springs and dampers at both hips hold on the bisector of the legs.

    V_spring = k/2 (torso - theta1)^2 + k/2 (torso + theta2)^2        dampers across the same two angles

A swap of the feet changes neither. The angles of the legs are measured as those of the compass, ``torso`` from the
slope's normal.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import Annotated, Any, ClassVar

from casadi import pi, vertcat
from pydantic import Field

from gaitopt.model.mechanism import Damper, Link, Mechanism, polar
from gaitopt.model.units import Inertia, Positive, Slope, TurningDamping, TurningStiffness, shorter
from gaitopt.model.walker import Walker


class TorsoWalker(Walker):
    """Legs with point masses, and a rigid torso on the hip; the motor acts between torso and stance leg."""

    model = "torso_walker"
    shape = ("theta1", "theta2", "torso")
    section = ("theta1", "torso")
    actuators: ClassVar[tuple[str, ...]] = ("hip",)
    tracked: ClassVar[tuple[str, ...]] = ("torso",)
    largest_angle = pi / 2

    leg_length: Annotated[Positive, Field(description="length of a leg [m]")]
    leg_mass: Annotated[Positive, Field(description="point mass on each leg [kg]")]
    leg_com: Annotated[Positive, Field(description="distance of the leg's mass from its foot [m]")]
    torso_mass: Annotated[Positive, Field(description="mass of the torso [kg]")]
    torso_com: Annotated[Positive, Field(description="distance of the torso's centre of mass from the hip [m]")]
    torso_inertia: Annotated[Inertia, Field(description="moment of inertia about its centre of mass [kg m^2]")]
    hip_stiffness: Annotated[TurningStiffness, Field(description="stiffness of the spring at each hip [N m/rad]")]
    hip_damping: Annotated[TurningDamping, Field(description="coefficient of the damper at each hip [N m s/rad]")]
    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")]
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")]

    _com_within_leg = shorter("leg_com", "leg_length")

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The mechanism of the links, with springs and dampers between the torso and each leg."""
        hips = (q.torso - q.theta1, q.torso + q.theta2)
        return replace(
            super().mechanism(q, p),
            potential=sum(p.hip_stiffness / 2 * angle**2 for angle in hips),
            dampers=tuple(Damper(coefficient=p.hip_damping, across=angle) for angle in hips),
        )

    @classmethod
    def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
        """Both legs and the torso."""
        legs = {"tip": (0, -p.leg_length), "com": (0, p.leg_com - p.leg_length), "mass": p.leg_mass, "foot": True}
        return (
            Link(name="stance_leg", angle=q.theta1, **legs),
            Link(name="swing_leg", parent="torso", joint="swing_hip", angle=-q.theta2, **legs),
            Link(
                name="torso",
                parent="stance_leg",
                joint="hip",
                angle=q.torso,
                tip=(0, 2 * p.torso_com),
                com=(0, p.torso_com),
                mass=p.torso_mass,
                inertia=p.torso_inertia,
            ),
        )

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """Both feet are on the ground: theta2 = theta1."""
        return (free.theta1, free.theta1, free.torso)

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[Any, ...], ...]:
        """Both legs, and the torso as far as twice its centre of mass."""
        foot = vertcat(q.x, q.y)
        hip = foot + polar(p.leg_length, q.theta1)
        return (foot, hip), (hip, hip - polar(p.leg_length, -q.theta2)), (hip, hip + polar(2 * p.torso_com, q.torso))


class DrivenTorso(TorsoWalker):
    """Compass biped with a torso and two motors, between torso and stance leg and between torso and swing leg."""

    model = "driven_torso"
    actuators = ("stance_hip", "swing_hip")
    tracked = ("torso", "theta2")

    @classmethod
    def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
        """The links of ``TorsoWalker``, with joints whose angles are those of the motors."""
        motors = {"hip": ("stance_hip", 1), "swing_hip": ("swing_hip", -1), "": ("", 1)}
        joints = [(link, *motors[link.joint]) for link in super().links(q, p)]
        return tuple(replace(link, joint=name, sign=sign) for link, name, sign in joints)
