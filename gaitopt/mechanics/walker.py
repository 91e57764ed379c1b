"""What a walker is: its parameters, and its mechanism stated in CasADi symbols.

A walker is a frozen pydantic model: its fields are the physical parameters, with units, ranges and
messages; its class attributes name the coordinates; ``mechanism`` states where the masses are. Everything
else (M, B, G, W, E, contact, impact, multipliers) is derived from that by gaitopt.

Coordinates ``q = (shape..., x, y)``: (x, y) is the stance foot, x along the slope downhill, y along its normal.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import entry_points
from types import SimpleNamespace
from typing import Any, ClassVar

from casadi import SX, vertcat
from pydantic import BaseModel, ConfigDict

from gaitopt.errors import UnknownNameError

ENTRY_POINT_GROUP = "gaitopt.walkers"


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
    motors : tuple of SX - the angle on which each actuator acts, in the order of ``Walker.actuators`` [rad].
    potential : SX - potential energy besides gravity, of springs for instance [J].
    """

    bodies: tuple[Body, ...]
    gravity: SX
    swing_foot: SX
    touchdown: SX
    upright: SX
    relabel: SX
    motors: tuple[SX, ...] = ()
    potential: Any = field(default_factory=lambda: SX(0))


class Walker(BaseModel, ABC):
    """Base of every walker; derive from it, declare the parameters as fields, and state the mechanism.

    Class attributes
    ----------------
    model : the name used in problem files.
    shape : names of the shape coordinates.
    section : those shape coordinates that are free just after an impact.
    actuators : names of the actuators.
    tracked : for each actuator the shape coordinate whose error drives it under a PD law.
    largest_angle : size of the shape coordinates beyond which the walker does not walk [rad].
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    model: ClassVar[str]
    shape: ClassVar[tuple[str, ...]]
    section: ClassVar[tuple[str, ...]]
    actuators: ClassVar[tuple[str, ...]] = ()
    tracked: ClassVar[tuple[str, ...]] = ()
    largest_angle: ClassVar[float] = math.pi

    @classmethod
    @abstractmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The mechanism; ``q`` holds the coordinates by name (shape, x, y), ``p`` the parameters by field name."""

    @classmethod
    @abstractmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """All shape coordinates just after an impact, from the free ones of ``section``."""

    @classmethod
    def state_names(cls) -> tuple[str, ...]:
        """Names of the integrated state ``z = (shape, x, d shape, dx)``."""
        rates = tuple(f"d{name}" for name in cls.shape)
        return (*cls.shape, "x", *rates, "dx")

    @classmethod
    def section_names(cls, *, slipping: bool) -> tuple[str, ...]:
        """Names of the section coordinates: those that are free just after a sticking or slipping impact."""
        rates = tuple(f"d{name}" for name in cls.shape)
        return (*cls.section, *rates, *(("dx",) if slipping else ()))


def polar(length: Any, angle: Any) -> SX:
    """The point at ``length`` from the origin, ``angle`` from the slope's normal towards downhill; shape (2,) [m]."""
    return vertcat(length * SX(angle).sin(), length * SX(angle).cos())


@lru_cache(maxsize=1)
def registered_walkers() -> Mapping[str, type[Walker]]:
    """Every walker that a problem file may name: ours, and those of the entry-point group ``gaitopt.walkers``."""
    found = {point.name: point.load() for point in entry_points(group=ENTRY_POINT_GROUP)}
    return dict(sorted(found.items()))


def find_walker(model: str) -> type[Walker]:
    """The walker registered as ``model``.

    Raises
    ------
    UnknownNameError
        If no such walker is registered; the message lists those that are.
    """
    walkers = registered_walkers()
    if model not in walkers:
        raise UnknownNameError(f"no walker is called {model!r}; registered: {', '.join(walkers)}")
    return walkers[model]
