"""What a walker is: its parameters, and its mechanism stated in CasADi symbols.

A walker is a frozen pydantic model: its fields are the physical parameters, with units, ranges and
messages; its class attributes name the coordinates; ``mechanism`` states where the masses are. Everything
else (M, B, G, W, E, contact, impact, multipliers) is derived from that by gaitopt.

Coordinates ``q = (shape..., x, y)``: (x, y) is the stance foot, x along the slope downhill, y along its normal.
"""

import copyreg
import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping
from importlib import import_module
from itertools import product
from operator import attrgetter
from pickle import PicklingError
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from casadi import SX, vertcat
from pydantic import BaseModel, ConfigDict

from gaitopt.errors import UnknownNameError
from gaitopt.mechanics.mechanism import Mechanism
from gaitopt.mechanics.modes import CONTACTS, STOP_STATES, SWITCH_STATES, Mode

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
    def standing(cls, p: Any, side: int) -> Any:
        """Parameters in the order of the fields, and others behind them, in the steps of one ``side``.

        Parameters
        ----------
        p : those of the first step of a cycle, numbers or symbols.
        side : 0 where the same leg stands as in the first step, 1 where it is the other one.
        """
        if not (cls.exchanged and side):
            return p
        n = p.size if isinstance(p, np.ndarray) else p.numel()
        return p[[cls.place(k) for k in range(n)]]

    @classmethod
    def place(cls, k: int) -> int:
        """Index of the parameter with which the k-th changes places when the feet swap roles, of most itself."""
        names = (*cls.model_fields,)
        partners = dict(cls.exchanged) | {swing: stance for stance, swing in cls.exchanged.items()}
        return names.index(partners.get(names[k], names[k])) if k < len(names) else k

    @classmethod
    def side(cls, step: int) -> int:
        """Which leg stands in a step, counted from 0: always 0 where both are alike, else 0 and 1 in turn."""
        return step % cls.n_sides()

    @classmethod
    def n_sides(cls) -> int:
        """After how many steps the same leg stands again, as far as the legs differ."""
        return 2 if cls.exchanged else 1

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
