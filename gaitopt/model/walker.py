"""The definition of a walker: its parameters, and its mechanism in CasADi symbols.

A walker is a frozen pydantic model. Its fields are the physical parameters, with units and ranges; its class attributes
name the coordinates; ``mechanism`` defines bodies, springs, dampers and guards. M, B, G, W, E, contact forces, impacts
and multipliers are derived from these.

The coordinates are ``q = (shape..., x, y)``: (x, y) is the stance foot, with x along the slope downhill and y along its
normal.
"""

import copyreg
import inspect
import math
import sys
from abc import ABC
from collections.abc import Mapping
from functools import lru_cache
from importlib import import_module
from itertools import product
from operator import attrgetter
from pickle import PicklingError
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, cast

import numpy as np
from casadi import SX, vertcat
from pydantic import BaseModel, ConfigDict

from gaitopt.errors import ProblemError, UnknownNameError
from gaitopt.model.closure import chosen_section, closed_posture
from gaitopt.model.links import state_tree, tree_mechanism
from gaitopt.model.mechanism import Body as Body  # classes of other packages import these names from here
from gaitopt.model.mechanism import Contact as Contact
from gaitopt.model.mechanism import Damper as Damper
from gaitopt.model.mechanism import Link, Mechanism
from gaitopt.model.mechanism import coil as coil
from gaitopt.model.mechanism import inclined as inclined
from gaitopt.model.mechanism import polar as polar
from gaitopt.model.modes import CONTACTS, FOOT, OFF, STOP_STATES, SWING_FOOT, SWITCH_STATES, Mode

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)  # pydantic has no public name for it


class PluginClass(ModelMetaclass):
    """The class of the classes of walkers and control laws. Pickles of such a class contain its name and its module."""


class WalkerClass(PluginClass):
    """The class of walker classes."""

    @property
    def section(cls) -> tuple[str, ...]:
        """``Walker.section`` as the class defines it, or the best conditioned one for the closure of the legs.

        Raises
        ------
        AttributeError
            If neither the class nor the closure defines it.
        """
        defined = next((vars(base)["section"] for base in cls.__mro__ if "section" in vars(base)), None)
        if defined is not None:
            return cast(tuple[str, ...], defined)
        if cast("type[Walker]", cls).contacts:  # the free coordinates depend on the gait, see ``gaitopt.model.section``
            return ()
        return chosen_section(cast("type[Walker]", cls))


class Walker(BaseModel, ABC, metaclass=WalkerClass):
    """Base class of walkers: declare the parameters as fields, and define the mechanism.

    Class attributes
    ----------------
    model : the name used in problem files.
    shape : names of the shape coordinates.
    section : the shape coordinates that are free just after an impact. Without it they are chosen, see ``closure``.
    posture : a typical posture just after an impact by name [rad, m], near which the closure of the legs is solved
        without ``after_impact``; coordinates that it leaves out are zero.
    section_rates : the shape coordinates whose rates are free just after an impact; all by default.
    exchanged : for legs that differ, each parameter of the stance leg with the corresponding one of the swing leg; the
        two swap their values at touchdown. A cycle then has an even number of steps.
    stops : names of the joint stops; a stop locks when its gap closes, and the impact of the foot releases all stops.
    open_in_impact : the stops that are released before the impulse of the foot's impact rather than after it.
    switches : names of the switches; a switch triggers when its margin falls to zero, and all are off after an impact.
    flies : whether the walker leaves the ground; its steps then end with a flight.
    massless_feet : whether feet, and the legs up to the bodies, have no mass. Such feet land without an impulse, cannot
        slip, and keep their position in flight.
    lengths : the shape coordinates that are lengths [m] rather than angles [rad].
    pushes : whether the walker pushes off with its stance foot just before the swing foot lands. For a walker with
        ``contacts`` it has the names of those that push off, if they are on the ground, just before another one lands.
    actuators : names of the actuators.
    external : the actuators that push the walker from outside, such as a tow, a belt or the wind. Only their entries of
        ``Mechanism.motors`` may depend on x and y, and only linearly on x, because the motion must not depend on where
        the walker is.
    tracked : for each actuator the shape coordinate whose error drives it under a PD law; empty without such a law.
    phases : names of the phase variables, functions of the shape that grow along a step. Every shape coordinate is a
        phase variable too, under its own name.
    largest_angle : largest size of the shape coordinates in walking [rad].
    contacts : names of the contact points, if the walker has several; (x, y) is then a point of your choice.
    massless_contacts : the contacts at the end of massless parts, which have coordinates of their own
        (``Contact.places``).
    landing_contacts : the contacts whose landing ends a step: the shape is then relabelled, and the base point moves to
        ``swing_foot``.
    closing_stops : the stops that must be locked when such a landing ends a step, because ``relabel`` holds for locked
        legs. A foot that comes down earlier scuffs. For a walker on one foot at a time these are all stops.
    exchanged_contacts : contacts of one foot with those of the other one; they swap places at the end of a step.
    sections : names of the margins any of which may end a cycle (``gait: {section: {margin: NAME}}``).
    """

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)

    model: ClassVar[str]
    shape: ClassVar[tuple[str, ...]]
    section: ClassVar[tuple[str, ...]]
    posture: ClassVar[Mapping[str, float]] = {}
    section_rates: ClassVar[tuple[str, ...] | None] = None
    exchanged: ClassVar[Mapping[str, str]] = {}
    stops: ClassVar[tuple[str, ...]] = ()
    open_in_impact: ClassVar[tuple[str, ...]] = ()
    switches: ClassVar[tuple[str, ...]] = ()
    flies: ClassVar[bool] = False
    massless_feet: ClassVar[bool] = False
    lengths: ClassVar[tuple[str, ...]] = ()
    pushes: ClassVar[bool | tuple[str, ...]] = False
    actuators: ClassVar[tuple[str, ...]] = ()
    external: ClassVar[tuple[str, ...]] = ()
    tracked: ClassVar[tuple[str, ...]] = ()
    phases: ClassVar[tuple[str, ...]] = ()
    largest_angle: ClassVar[float] = math.pi
    contacts: ClassVar[tuple[str, ...]] = ()
    massless_contacts: ClassVar[tuple[str, ...]] = ()
    landing_contacts: ClassVar[tuple[str, ...]] = ()
    closing_stops: ClassVar[tuple[str, ...]] = ()
    exchanged_contacts: ClassVar[Mapping[str, str]] = {}
    sections: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The mechanism; ``q`` contains the coordinates by name (shape, x, y), ``p`` the parameters by field name.

        By default it is that of the links, see ``links.tree_mechanism``.
        """
        tree = state_tree(cls, q, p)
        lost = [actuator for actuator in cls.actuators if actuator not in tree.joints]
        if lost and inspect.getattr_static(cls, "mechanism") is inspect.getattr_static(Walker, "mechanism"):
            names = f"{', '.join(lost)}, which is not a joint of its links ({', '.join(tree.joints) or 'none'})"
            raise ProblemError(f"{cls.__name__}: actuators names {names}; define mechanism if it is another motor")
        return tree_mechanism(cls, tree, q, p)

    @classmethod
    def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
        """The links of a walker that is a planar tree; empty by default. For the arguments see ``mechanism``."""
        return ()

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """All shape coordinates just after an impact, from those of ``section``; by default the closure is solved."""
        return closed_posture(cls, free, p)

    @classmethod
    def outline(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[tuple[SX, ...], ...]:
        """Lines that draw the walker, each a sequence of points [m]; for the arguments see ``mechanism``.

        Only pictures use them. By default they are the links; without links a picture joins the bodies and feet.
        """
        return ()

    @classmethod
    def contact(cls, q: SimpleNamespace, p: SimpleNamespace) -> SX:
        """Point at which the stance foot touches the ground in pictures, shape (2,) [m]; by default (x, y)."""
        return vertcat(q.x, q.y)

    @classmethod
    def rates_after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        """All shape rates just after an impact, from those of ``section_rates`` (``free.dtheta`` and so on)."""
        return tuple(getattr(free, f"d{name}") for name in cls.shape)

    @classmethod
    def landing(
        cls, q: SimpleNamespace, dq: SimpleNamespace, p: SimpleNamespace
    ) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Shape coordinates, and their rates, just after a massless foot has landed, from those just before.

        By default the bodies move on as they did, and the shape is that of ``Mechanism.relabel``.
        """
        raise NotImplementedError

    @classmethod
    def contact_names(cls) -> tuple[str, ...]:
        """Names of all contacts: ``foot`` if the walker stands on one at a time."""
        return cls.contacts or (FOOT,)

    @classmethod
    def stands_on_one(cls) -> bool:
        """Whether one contact is on the ground at a time: the ``foot``. Another foot that lands takes its role."""
        return not cls.contacts

    @classmethod
    def leaves_ground(cls) -> bool:
        """Whether the walker has a mode in which no contact is on the ground."""
        return cls.flies or not cls.stands_on_one()

    @classmethod
    def keeps_height(cls) -> bool:
        """Whether y is not a state: the foot at (x, y) never leaves the ground, or is massless and stays there."""
        return cls.stands_on_one() and (cls.massless_feet or not cls.flies)

    @classmethod
    def base_contact(cls) -> str:
        """The contact at the base point (x, y), whose velocity is part of the state; empty if there is no contact."""
        return FOOT if cls.stands_on_one() else ""

    @classmethod
    def may_keep_energy(cls) -> bool:
        """Whether the walker may land without losing energy, by massless feet or by springs that do not always act."""
        return cls.flies or bool(cls.weightless() or cls.switches)

    @classmethod
    def features(cls) -> tuple[str, ...]:
        """Names of the features beyond one foot on the ground, for messages about features that a method lacks."""
        features = {
            "several contacts": cls.contacts,
            "flight": cls.flies,
            "joint stops": cls.stops,
            "switches": cls.switches,
            "a push-off": cls.pushes,
            "massless feet": cls.weightless(),
            "motors that push from outside": cls.external,
        }
        return tuple(text for text, feature in features.items() if feature)

    @classmethod
    def labels(cls) -> tuple[str, ...]:
        """Names that results write beside quantities of contacts; none if the walker stands on one at a time."""
        return cls.contacts

    @classmethod
    def label(cls, contact: str) -> str:
        """The name of a contact if it is one of ``labels``, otherwise an empty text."""
        return contact if contact in cls.labels() else ""

    @classmethod
    def quantity(cls, what: str, contact: str) -> str:
        """The name of a quantity of a contact: ``f_t.left``, or ``f_t`` if the contact has no label."""
        return f"{what}.{cls.label(contact)}".rstrip(".")

    @classmethod
    def called(cls, contact: str) -> str:
        """A contact in messages: ``the swing foot``, or ``the contact left`` if it has a label."""
        return f"the contact {contact}" if cls.label(contact) else f"the {contact.replace('_', ' ')}"

    @classmethod
    def contact_mode(cls, words: Mapping[str, str]) -> Mode:
        """The mode, without stops, in which the contacts have these states by name."""
        return Mode.of_feet({SWING_FOOT: OFF, **words}) if cls.stands_on_one() else Mode.of_contacts(words)

    @classmethod
    def mode_words(cls, *, after_impact: bool = False) -> tuple[str, ...]:
        """Short forms of modes, in a phase or just after an impact; there are none if the contacts have labels."""
        modes = (*CONTACTS, Mode.FLIGHT)[: 3 if after_impact else 4]
        return tuple(map(str, modes)) if cls.stands_on_one() else ()

    @classmethod
    def step_ends(cls) -> tuple[str, ...]:
        """Names of the points whose landing ends a step, after which the feet swap roles."""
        return (SWING_FOOT,) if cls.stands_on_one() else cls.landing_contacts

    @classmethod
    def weightless(cls) -> tuple[str, ...]:
        """Names of the points at the end of massless parts that may touch the ground: some contacts, or both feet."""
        return cls.landing_points() if cls.massless_feet else cls.massless_contacts

    @classmethod
    def placed_contacts(cls) -> tuple[str, ...]:
        """Names of the massless contacts. Each has coordinates of its own, which take new values when it lands."""
        return cls.massless_contacts

    @classmethod
    def landing_points(cls) -> tuple[str, ...]:
        """Names of all points that may touch the ground: the contacts, or ``foot`` and ``swing_foot``."""
        return cls.contacts or (FOOT, SWING_FOOT)

    @classmethod
    def struck_contacts(cls, mode: Mode) -> tuple[str, ...]:
        """Contacts with impulses in an impact, named as before it: all contacts, or the foot that is on the ground."""
        return (*mode.touching, FOOT)[:1] if cls.stands_on_one() else cls.contacts

    @classmethod
    def pushing(cls) -> tuple[str, ...]:
        """Names of the contacts that push off."""
        return cls.pushes if isinstance(cls.pushes, tuple) else (FOOT,) if cls.pushes else ()

    @classmethod
    def foot_modes(cls) -> tuple[Mode, ...]:
        """States of the foot, or of the contacts, as modes without stops."""
        return _foot_modes(cls)

    @classmethod
    def statement(cls) -> dict[str, Any]:
        """The keys of a problem file, besides the parameters, that name this walker."""
        return {"model": cls.model}

    @classmethod
    def modes(cls) -> tuple[Mode, ...]:
        """All modes: every state of the foot with every state of the stops and switches."""
        choices = {**dict.fromkeys(cls.stops, STOP_STATES), **dict.fromkeys(cls.switches, SWITCH_STATES)}
        states = [dict(zip(choices, choice, strict=True)) for choice in product(*choices.values())]
        return tuple(Mode.of(contact, stops) for stops in states for contact in cls.foot_modes())

    @classmethod
    def swapped(cls, mode: Mode) -> Mode:
        """A mode in which the contacts that are partners have swapped their states."""
        return _swapped(cls, mode)

    @classmethod
    def held_in_impact(cls, contacts: Mode, before: Mode) -> Mode:
        """A mode of the contacts just after the impact that ends a step, with the stops that are locked during it.

        Modes of other impacts contain their stops already, and are returned unchanged.
        """
        if contacts.stops or not cls.stops:
            return contacts
        locked = [name for name in before.locked if name not in cls.open_in_impact]
        return Mode.of(contacts, {name: STOP_STATES[name in locked] for name in cls.stops})

    @classmethod
    def partners(cls) -> dict[str, str]:
        """The partner of every contact that swaps places with another one."""
        exchanged = cls.exchanged_contacts if cls.contacts else {FOOT: SWING_FOOT}
        return {**exchanged, **{theirs: ours for ours, theirs in exchanged.items()}}

    @classmethod
    def steps_per_cycle(cls) -> int:
        """The number of which the steps of a cycle are a multiple: 1 if the legs are alike, 2 if they differ."""
        return 2 if cls.exchanged else 1

    @classmethod
    def step_parameters(cls, p: Any) -> tuple[Any, ...]:
        """Parameters in each of the first ``steps_per_cycle`` steps, after which they repeat.

        Parameters
        ----------
        p : ndarray or CasADi symbols, shape (n,) - parameters of the first step: the fields in order, then any others.
        """
        if not cls.exchanged:
            return (p,)
        names, n = [*cls.model_fields], p.size if isinstance(p, np.ndarray) else p.numel()
        partners = {**cls.exchanged, **{swing: stance for stance, swing in cls.exchanged.items()}}
        swapped = [names.index(partners.get(name, name)) for name in names]
        return p, p[[*swapped, *range(len(names), n)]]

    @classmethod
    def released(cls, contact: Mode) -> Mode:
        """A state of the foot with all stops free and all switches off, as just after its impact."""
        return Mode.of(contact, dict.fromkeys(cls.stops, "free") | dict.fromkeys(cls.switches, "off"))

    @classmethod
    def coordinates(cls) -> tuple[str, ...]:
        """Names of the coordinates of the state: the shape, the height y of a foot that can fly, and x."""
        return (*cls.shape, *(() if cls.keeps_height() else ("y",)), "x")

    @classmethod
    def state_names(cls) -> tuple[str, ...]:
        """Names of the integrated state ``z``: the coordinates, then their rates."""
        names = cls.coordinates()
        return (*names, *(f"d{name}" for name in names))

    @classmethod
    def section_names(cls, *, slipping: bool) -> tuple[str, ...]:
        """Names of the section coordinates, which are free just after a sticking or slipping impact."""
        rates = cls.shape if cls.section_rates is None else cls.section_rates
        return (*cls.section, *(f"d{name}" for name in rates), *(("dx",) if slipping else ()))


@lru_cache(maxsize=64)  # four contacts have 256
def _foot_modes(walker: type[Walker]) -> tuple[Mode, ...]:
    if walker.contacts:
        choices: dict[str, tuple[str, ...]] = dict.fromkeys(walker.contacts, (*CONTACTS, OFF))
        choices |= dict.fromkeys(walker.massless_contacts, (Mode.STICK, OFF))
        combined = [dict(zip(choices, choice, strict=True)) for choice in product(*choices.values())]
        return tuple(Mode.of_contacts(states) for states in combined)
    ground = CONTACTS[:1] if walker.massless_feet else CONTACTS
    return (*ground, Mode.FLIGHT) if walker.flies else ground


WalkerType: TypeAlias = type[Walker]
"""A class of walkers. In the body of a control law ``type`` is the law's name, so that ``type[Walker]`` is
impossible."""


def _pickled(plugin: PluginClass) -> tuple[Any, ...]:
    """Reduce a class to its names for a pickle; cloudpickle, which Dask uses, would send some classes by value.

    Raises
    ------
    PicklingError
        If an import would not find the class.
    """
    if "rebuilt_by" in vars(plugin):  # a class that was made from the content of a file
        return cast(tuple[Any, ...], vars(plugin)["rebuilt_by"])
    module, name = plugin.__module__, plugin.__qualname__
    is_walker = issubclass(plugin, Walker)
    title = f"walker {getattr(plugin, 'model', '?')}" if is_walker else f"control law {getattr(plugin, 'type', '?')}"
    try:
        importable = attrgetter(name)(sys.modules[module])
    except (KeyError, AttributeError):
        importable = None
    if importable is not plugin:
        raise PicklingError(
            f"{title}: another process cannot import its class {name} from the module {module}; "
            "define the class at the top level of a module, under its own name"
        )
    return _imported, (module, name, title)


@lru_cache(maxsize=256)
def _swapped(walker: type[Walker], mode: Mode) -> Mode:
    partner = walker.partners()
    contacts = {name: mode.contacts[partner.get(name, name)] for name in walker.landing_points()}
    return mode.with_contact(Mode.of_contacts(contacts) if walker.contacts else Mode.of_feet(contacts))


def _imported(module: str, name: str, title: str) -> Any:
    """The class of a walker or a control law, which messages call ``title``.

    Raises
    ------
    UnknownNameError
        If it cannot be imported.
    """
    try:
        return attrgetter(name)(import_module(module))
    except (ImportError, AttributeError) as error:
        owner = title.rpartition(" ")[0]
        raise UnknownNameError(
            f"{title}: its class {name} cannot be imported from the module {module} in this process ({error}); "
            f"install the package of the {owner} there"
        ) from error


copyreg.pickle(PluginClass, _pickled)
copyreg.pickle(WalkerClass, _pickled)
