"""What a walker is: its parameters, and its mechanism stated in CasADi symbols.

A walker is a frozen pydantic model: its fields are the physical parameters, with units, ranges and
messages; its class attributes name the coordinates; ``mechanism`` states where the masses are. Everything
else (M, B, G, W, E, contact, impact, multipliers) is derived from that by gaitopt.

Coordinates ``q = (shape..., x, y)``: (x, y) is the stance foot, x along the slope downhill, y along its normal.

What a walker consists of, in CasADi symbols: bodies, springs, dampers, guards; and points and lines to state it.
"""

import copyreg
import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from itertools import product
from operator import attrgetter
from pickle import PicklingError
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from casadi import SX, norm_2, vertcat
from pydantic import BaseModel, ConfigDict

from gaitopt.errors import UnknownNameError
from gaitopt.model.modes import CONTACTS, STOP_STATES, SWITCH_STATES, Mode


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


if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)  # pydantic has no public name for it


class WalkerClass(ModelMetaclass):
    """The class of walker classes, by which pickles name a walker: by the module and the name of its class."""


class Walker(BaseModel, ABC, metaclass=WalkerClass):
    """Base of every walker; derive from it, declare the parameters as fields, and state the mechanism.

    Class attributes
    ----------------
    model : the name used in problem files.
    shape : names of the shape coordinates.
    section : those shape coordinates that are free just after an impact.
    section_rates : those shape coordinates whose rates are free just after an impact; all unless given.
    exchanged : parameters of the stance leg, each with that of the swing leg with which it changes places when the
        feet swap roles; of legs that are alike none. A cycle then has an even number of steps.
    stops : names of the joint stops; a stop locks where its gap closes, and all are released by the impact of the foot.
    open_in_impact : those stops that are released before the impulse of the foot's impact rather than after it.
    switches : names of the switches; one is thrown where its margin falls to zero, and all are off after an impact.
    flies : whether the walker leaves the ground; its steps then end out of flight.
    massless_feet : whether feet (and what connects them with the bodies) have no mass. They land without an impulse, as
        ``landing`` says, cannot slip, and in flight count as staying where they were.
    lengths : those shape coordinates that are lengths [m] rather than angles [rad].
    pushes : whether the walker pushes off with its stance foot just before the swing foot lands.
    actuators : names of the actuators.
    tracked : for each actuator the shape coordinate whose error drives it under a PD law.
    largest_angle : size of the shape coordinates beyond which the walker does not walk [rad].
    """

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)

    model: ClassVar[str]
    shape: ClassVar[tuple[str, ...]]
    section: ClassVar[tuple[str, ...]]
    section_rates: ClassVar[tuple[str, ...] | None] = None
    exchanged: ClassVar[Mapping[str, str]] = {}
    stops: ClassVar[tuple[str, ...]] = ()
    open_in_impact: ClassVar[tuple[str, ...]] = ()
    switches: ClassVar[tuple[str, ...]] = ()
    flies: ClassVar[bool] = False
    massless_feet: ClassVar[bool] = False
    lengths: ClassVar[tuple[str, ...]] = ()
    pushes: ClassVar[bool] = False
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
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[SX, ...], ...]:
        """Lines that draw the walker, each a sequence of points [m], with arguments as for ``mechanism``.

        It concerns pictures alone. Without any, the walker is drawn from its bodies and feet.
        """
        return ()

    @classmethod
    def contact(cls, q: SimpleNamespace, p: SimpleNamespace) -> SX:
        """Where the stance foot touches the ground in pictures, shape (2,) [m]; (x, y) unless the walker says more."""
        return vertcat(q.x, q.y)

    @classmethod
    def rates_after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """All shape rates just after an impact, from the free ones of ``section_rates`` (``free.dtheta`` and so on)."""
        return tuple(getattr(free, f"d{name}") for name in cls.shape)

    @classmethod
    def landing(
        cls, q: SimpleNamespace, dq: SimpleNamespace, p: SimpleNamespace
    ) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Shape coordinates, and their rates, just after a massless foot has landed, from those just before."""
        raise NotImplementedError(f"{cls.__name__} has massless feet, but does not say how they land")

    @classmethod
    def contacts(cls) -> tuple[Mode, ...]:
        """What the foot can do."""
        ground = CONTACTS[:1] if cls.massless_feet else CONTACTS
        return (*ground, Mode.FLIGHT) if cls.flies else ground

    @classmethod
    def modes(cls) -> tuple[Mode, ...]:
        """Every mode: what the foot can do, with every state of the stops and switches."""
        choices = [*([STOP_STATES] * len(cls.stops)), *([SWITCH_STATES] * len(cls.switches))]
        states = [dict(zip((*cls.stops, *cls.switches), each, strict=True)) for each in product(*choices)]
        return tuple(Mode.of(contact, stops) for stops in states for contact in cls.contacts())

    @classmethod
    def steps_per_cycle(cls) -> int:
        """The number of steps of a cycle is a multiple of this: 1 if the legs are alike, 2 if they differ."""
        return 2 if cls.exchanged else 1

    @classmethod
    def step_parameters(cls, p: Any) -> tuple[Any, ...]:
        """Parameters in each of the first ``steps_per_cycle`` steps, after which they repeat.

        Parameters
        ----------
        p : ndarray or CasADi symbols, shape (n,) - those of the first step: the fields in order, and others after them.
        """
        if not cls.exchanged:
            return (p,)
        names, n = [*cls.model_fields], p.size if isinstance(p, np.ndarray) else p.numel()
        partners = {**cls.exchanged, **{swing: stance for stance, swing in cls.exchanged.items()}}
        swapped = [names.index(partners.get(name, name)) for name in names]
        return p, p[[*swapped, *range(len(names), n)]]

    @classmethod
    def released(cls, contact: Mode) -> Mode:
        """What the foot does, with all stops free and all switches off, as just after its impact."""
        return Mode.of(contact, dict.fromkeys(cls.stops, "free") | dict.fromkeys(cls.switches, "off"))

    @classmethod
    def coordinates(cls) -> tuple[str, ...]:
        """Names of the coordinates of the state: the shape, the height y of a foot that can fly, and x."""
        return (*cls.shape, *(("y",) if cls.flies and not cls.massless_feet else ()), "x")

    @classmethod
    def state_names(cls) -> tuple[str, ...]:
        """Names of the integrated state ``z``: the coordinates, then their rates."""
        names = cls.coordinates()
        return (*names, *(f"d{name}" for name in names))

    @classmethod
    def section_names(cls, *, slipping: bool) -> tuple[str, ...]:
        """Names of the section coordinates: those that are free just after a sticking or slipping impact."""
        rates = cls.shape if cls.section_rates is None else cls.section_rates
        return (*cls.section, *(f"d{name}" for name in rates), *(("dx",) if slipping else ()))


def _pickled(walker: WalkerClass) -> tuple[Any, ...]:
    """What a pickle holds of a walker's class; cloudpickle, which Dask uses, sends classes of no module by value.

    Raises
    ------
    PicklingError
        If no import finds it.
    """
    module, name, model = walker.__module__, walker.__qualname__, getattr(walker, "model", "?")
    try:
        found = attrgetter(name)(sys.modules[module])
    except (KeyError, AttributeError):
        found = None
    if found is not walker:
        raise PicklingError(
            f"walker {model}: another process cannot import its class {name} from the module {module}; "
            "define the class at the top level of a module, under its own name"
        )
    return _imported, (module, name, model)


def _imported(module: str, name: str, model: str) -> Any:
    """The class of a walker.

    Raises
    ------
    UnknownNameError
        If it cannot be imported.
    """
    try:
        return attrgetter(name)(import_module(module))
    except (ImportError, AttributeError) as error:
        raise UnknownNameError(
            f"walker {model}: its class {name} cannot be imported from the module {module} in this process ({error}); "
            "install the package of the walker there"
        ) from error


copyreg.pickle(WalkerClass, _pickled)
