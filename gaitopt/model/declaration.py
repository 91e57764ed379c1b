"""The class of a walker: checks of its attributes, and calls of its methods with checks of their results.

A class may come from any package. Its attributes are checked before they are used. The results of its methods are
checked before they enter an equation: each expression must have the right shape and depend only on those arguments on
which it may depend. An error is one sentence that names the class and the attribute or method.
"""

import inspect
import math
from collections.abc import Callable, Iterator, Mapping
from itertools import combinations
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from casadi import DM, SX, Function, depends_on, horzcat, jacobian, vertcat
from pydantic.fields import FieldInfo

from gaitopt.arrays import Array
from gaitopt.building import built_once
from gaitopt.display import counted
from gaitopt.errors import ProblemError
from gaitopt.model.foreign import (
    FOOT_COORDINATES,
    MODEL,
    NAME_WORDS,
    Reader,
    calling,
    check_declared,
    doubles,
    field_faults,
    is_finite,
    is_list,
    is_name,
    shown,
    symbols_of,
)
from gaitopt.model.links import Tree, state_tree
from gaitopt.model.mechanism import Body, Contact, Damper, Mechanism
from gaitopt.model.modes import STOP_STATES, SWITCH_STATES
from gaitopt.model.units import words_and_unit
from gaitopt.model.walker import Walker

COLUMNS = ("t", "mode", "f_t", "f_n")
"""Columns of the table of a motion that are not coordinates, rates or actuators."""
RESERVED = (
    *COLUMNS,
    "contact",
    "impact",
    "model",
    "type",
    "version",
    "limits",
    "touchdown",
    "upright",
    "clearance",
    "painleve",
)
"""Words that have another meaning, and so cannot be names of stops, switches, sections or actuators."""
MARGIN_NAMES = (
    "gap",
    "normal_force",
    "cone_forward",
    "cone_backward",
    "slip_velocity",
    "regularity",
    "onset",
    "pull",
    "breakpoint",
    "clock",
    "impulse",
    "impulse_cone_forward",
    "impulse_cone_backward",
    "lift_velocity",
    "touchdown_rate",
    "impact_slip_velocity",
    "impact_regularity",
    "impact_painleve",
    "impact_onset",
    "push_cone_forward",
    "push_cone_backward",
    "push_landing",
)
"""Margins of phases and impacts, and events, in addition to those above, that cannot be names of stops, switches or
sections, because each of these gives its name to its margin, whose unit and ending would then be those of the other."""
DERIVED = (
    "contact_names",
    "foot_modes",
    "modes",
    "held_in_impact",
    "partners",
    "pushing",
    "steps_per_cycle",
    "step_parameters",
    "released",
    "coordinates",
    "state_names",
    "section_names",
    "model_post_init",
)
"""Methods of ``Walker`` that follow from the class attributes, and so must not be overridden."""
OVERRIDABLE = ("mechanism", "links", "after_impact", "rates_after_impact", "landing", "outline", "contact")
"""Methods that a class may define."""
ATTRIBUTES = tuple(Walker.__annotations__)
LISTS = (
    "shape", "section", "section_rates", "stops", "open_in_impact", "switches", "lengths", "actuators", "external",
    "tracked",
    "phases", "contacts", "massless_contacts", "landing_contacts", "closing_stops",
    "sections",
)  # fmt: skip
"""Class attributes that are tuples of names."""
REMEDIES = {
    "model": ': write model = "NAME" in its body; problem files name the walker by it',
    "shape": ': write shape = ("theta1", ...) in its body, the names of its coordinates',
}


def check_class(walker: object) -> None:
    """Check the attributes and parameters of a class; none of its methods is called.

    Raises
    ------
    ProblemError
        If an attribute is missing, has the wrong type, names something twice, or contradicts another attribute.
    """
    check_declared(walker, Walker, _class_faults)


class SymbolicMechanism(NamedTuple):
    """Coordinates (shape, x, y) and parameters, and the mechanism and the links in terms of them; no links are None."""

    q: SX
    p: SX
    mechanism: Mechanism
    tree: Tree | None


@built_once(maxsize=32)
def symbolic_mechanism(walker: type[Walker]) -> SymbolicMechanism:
    """The mechanism of a walker as expressions of symbols, which are the same in every call."""
    q, p = vertcat(*map(SX.sym, (*walker.shape, *FOOT_COORDINATES))), SX.sym("p", len(walker.model_fields))
    named = named_arguments(walker, q, p)
    tree = state_tree(walker, *named) if has_links(walker) else None
    return SymbolicMechanism(q, p, state_mechanism(walker, *named), tree)


def named_arguments(walker: type[Walker], q: SX, p: SX) -> tuple[SimpleNamespace, SimpleNamespace]:
    """The arguments of ``Walker.mechanism``: coordinates (shape, x, y) and parameters by name, from columns of them."""
    names = (*walker.shape, *FOOT_COORDINATES)
    return SimpleNamespace(**{name: q[k] for k, name in enumerate(names)}), parameter_namespace(walker, p)


def parameter_values(walker: Walker) -> Array:
    """The parameters of a walker in the order of its fields; shape (n_p,)."""
    return np.array([float(getattr(walker, name)) for name in type(walker).model_fields])


def parameter_namespace(walker: type[Walker], p: SX) -> SimpleNamespace:
    """The entries of ``p`` by the names of the walker's fields."""
    return SimpleNamespace(**{name: p[i] for i, name in enumerate(walker.model_fields)})


def state_mechanism(walker: type[Walker], q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
    """``Walker.mechanism`` with all entries checked and converted to SX.

    Parameters
    ----------
    q, p : coordinates (shape, x, y) and parameters by name; coordinates that are not symbols are not checked.

    Raises
    ------
    ProblemError
        If the method raises, an entry has the wrong type or shape or depends on a forbidden argument, the number of
        entries is wrong, or a body does not move with the stance foot.
    """
    with calling(walker, "mechanism"):
        stated = walker.mechanism(q, p)
    if not isinstance(stated, Mechanism):
        raise ProblemError(f"{walker.__name__}: mechanism returns {shown(stated)}, but must return a Mechanism")
    reason = next(_container_faults(walker, stated), None)
    if reason is not None:
        raise ProblemError(f"{walker.__name__}: {reason}")
    read = Reader(walker, q, p)
    stops = {name: read.scalar(f"Mechanism.stops[{name!r}]", gap, "shape") for name, gap in stated.stops.items()}
    for name, gap in stops.items():
        if depends_on(jacobian(gap, read.shape), read.shape):
            raise ProblemError(f"{walker.__name__}: Mechanism.stops[{name!r}] must be affine in the shape coordinates")
    mechanism = Mechanism(
        bodies=tuple(
            Body(
                mass=read.scalar(f"Mechanism.bodies[{k}].mass", body.mass, "parameters"),
                position=read.vector(f"Mechanism.bodies[{k}].position", body.position, 2, "all"),
                inertia=read.scalar(f"Mechanism.bodies[{k}].inertia", body.inertia, "parameters"),
                angle=read.scalar(f"Mechanism.bodies[{k}].angle", body.angle, "shape"),
            )
            for k, body in enumerate(stated.bodies)
        ),
        gravity=read.vector("Mechanism.gravity", stated.gravity, 2, "parameters"),
        swing_foot=read.vector("Mechanism.swing_foot", stated.swing_foot, 2, "all"),
        touchdown=read.scalar("Mechanism.touchdown", stated.touchdown, "height"),
        upright=read.scalar("Mechanism.upright", stated.upright, "height"),
        trailing_foot=None
        if stated.trailing_foot is None
        else read.vector("Mechanism.trailing_foot", stated.trailing_foot, 2, "all"),
        relabel=stated.relabel
        if walker.contacts and SX(stated.relabel).is_empty()
        else read.vector("Mechanism.relabel", stated.relabel, len(walker.shape), "shape"),
        stops=stops,
        switches={name: _checked_switch(walker, read, name, margin) for name, margin in stated.switches.items()},
        sections={
            name: _checked_switch(walker, read, name, margin, "sections") for name, margin in stated.sections.items()
        },
        phases={
            name: read.scalar(f"Mechanism.phases[{name!r}]", phase, "shape") for name, phase in stated.phases.items()
        },
        motors=tuple(
            _checked_motor(walker, read, f"Mechanism.motors[{k}]", name, angle)
            for k, (name, angle) in enumerate(zip(walker.actuators, stated.motors, strict=True))
        ),
        potential=read.scalar("Mechanism.potential", stated.potential, "shape"),
        potential_while={
            state: read.scalar(f"Mechanism.potential_while[{state!r}]", energy, "shape")
            for state, energy in stated.potential_while.items()
        },
        dampers=tuple(
            Damper(
                coefficient=read.scalar(f"Mechanism.dampers[{k}].coefficient", damper.coefficient, "parameters"),
                across=read.scalar(f"Mechanism.dampers[{k}].across", damper.across, "shape"),
            )
            for k, damper in enumerate(stated.dampers)
        ),
        push={
            name: read.vector("Mechanism.push" + (f"[{name!r}]" if walker.contacts else ""), impulse, 2, "shape")
            for name, impulse in stated.pushes.items()
        },
        length=None if stated.length is None else read.scalar("Mechanism.length", stated.length, "parameters"),
        contacts={name: _checked_contact(walker, read, name, contact) for name, contact in stated.contacts.items()},
    )
    if vertcat(q.x, q.y).is_valid_input():  # symbols rather than a given position of the foot
        if not (walker.contacts or depends_on(mechanism.touchdown, symbols_of(vars(q).values()))):
            raise ProblemError(f"{walker.__name__}: Mechanism.touchdown must depend on the shape coordinates")
        points = {f"body {k}": body.position for k, body in enumerate(mechanism.bodies)}
        points |= {f"contact {name}": contact.position for name, contact in mechanism.contacts.items()}
        points |= {} if walker.contacts else {"the swing foot": mechanism.swing_foot}
        for name, point in points.items():
            with_foot = jacobian(point, vertcat(q.x, q.y))
            if not with_foot.is_constant() or not DM(with_foot - SX.eye(2)).is_zero():
                raise ProblemError(f"{walker.__name__}: {name} does not move along with the stance foot (q.x, q.y)")
    return mechanism


@built_once(maxsize=64)
def joint_limits(walker: type[Walker]) -> Mapping[str, tuple[tuple[float, float] | None, float | None]]:
    """Range [rad] and largest torque [N m] of every joint of a walker's links by name; None for no limit."""
    if not has_links(walker):
        return {}
    q, p = SX.sym("q", len(walker.shape) + len(FOOT_COORDINATES)), SX.sym("p", len(walker.model_fields))
    links = state_tree(walker, *named_arguments(walker, q, p)).links
    return {link.joint: (link.range, link.effort) for link in links if link.joint}


@built_once(maxsize=64)
def actuator_units(walker: type[Walker]) -> Mapping[str, str]:
    """Unit of the force of every actuator by its name: ``N`` if the motor acts on a length, ``N m`` if on an angle.

    If all lengths l of a walker grow in proportion, the derivative e of a motor's angle or length by a coordinate grows
    with the power (de/dl l) / e (Euler), to which the dimension of the coordinate is added. If the mechanism is faulty,
    the unit is ``N m``; reading the problem reports the fault.
    """
    if not walker.actuators:
        return {}
    try:
        variables, parameters, mechanism, _ = symbolic_mechanism(walker)
    except ProblemError:
        return dict.fromkeys(walker.actuators, "N m")
    motors, p = mechanism.motors, vars(parameter_namespace(walker, parameters))
    q = {name: variables[k] for k, name in enumerate((*walker.shape, *FOOT_COORDINATES))}
    units = {name: words_and_unit(field.description or "")[1] for name, field in walker.model_fields.items()}
    metres = {*walker.lengths, *FOOT_COORDINATES, *(name for name, unit in units.items() if unit == "m")}
    lengths, symbols = vertcat(*(symbol for name, symbol in (q | p).items() if name in metres)), {**q, **p}
    slopes = horzcat(*(jacobian(vertcat(*motors), q[name]) for name in q))
    growths = [jacobian(slopes[:, k], lengths) @ lengths for k in range(len(q))]
    sample = np.random.default_rng(0).uniform(0.4, 0.6, len(symbols))
    values = Function("slopes", [vertcat(*symbols.values())], [slopes, horzcat(*growths)])(sample)
    slope, growth = (np.asarray(value) for value in values)
    acts_on = np.abs(slope).argmax(axis=1)  # the coordinate with the largest derivative
    rows = zip(walker.actuators, slope, growth, acts_on.tolist(), strict=True)
    coordinates = (*q,)
    powers = {name: (d[k] / e[k] if e[k] else 0.0) + (coordinates[k] in metres) for name, e, d, k in rows}
    return {name: "N" if round(power) == 1 else "N m" for name, power in powers.items()}


def is_default(walker: type[Walker], method: str) -> bool:
    """Whether a class does not define a method of ``OVERRIDABLE`` itself."""
    return inspect.getattr_static(walker, method) is inspect.getattr_static(Walker, method)


def has_links(walker: type[Walker]) -> bool:
    """Whether a class defines its links. Those of a base class do not count if the class redefines the mechanism."""
    bases = walker.__mro__
    links, mechanism = (next(base for base in bases if name in vars(base)) for name in ("links", "mechanism"))
    return links is not Walker and bases.index(links) <= bases.index(mechanism)


def state_after_impact(walker: type[Walker], free: SimpleNamespace, p: SimpleNamespace) -> tuple[SX, SX]:
    """Shape coordinates and their rates just after an impact, (n_shape,) each, from those of the section.

    Raises
    ------
    ProblemError
        If one of the two methods raises, or does not return one expression per shape coordinate.
    """
    read, results = Reader(walker, free, p), []
    for name in ("after_impact", "rates_after_impact"):
        with calling(walker, name):
            stated = getattr(walker, name)(free, p)
        results.append(_read_shape(walker, read, name, stated))
    return results[0], results[1]


def state_landing(walker: type[Walker], q: SimpleNamespace, dq: SimpleNamespace, p: SimpleNamespace) -> tuple[SX, SX]:
    """Shape coordinates and their rates just after a massless foot has landed, shape (n_shape,) each.

    Raises
    ------
    ProblemError
        If ``Walker.landing`` raises, or does not return two sequences of expressions.
    """
    with calling(walker, "landing"):
        stated = walker.landing(q, dq, p)
    if not (is_list(stated, object) and len(stated) == 2):
        expected = "two tuples: the shape coordinates and their rates"
        raise ProblemError(f"{walker.__name__}: landing returns {shown(stated)}, but must return {expected}")
    read = Reader(walker, SimpleNamespace(**vars(q), **{f"d{name}": rate for name, rate in vars(dq).items()}), p)
    return _read_shape(walker, read, "landing", stated[0]), _read_shape(walker, read, "landing", stated[1])


def state_picture(
    walker: type[Walker], q: SimpleNamespace, p: SimpleNamespace, tree: Tree | None = None
) -> tuple[tuple[tuple[SX, ...], ...], SX]:
    """The lines of ``Walker.outline``, each a tuple of points of shape (2,), and the point of ``Walker.contact`` [m].

    Parameters
    ----------
    tree : the links at ``q`` and ``p``, if they are known.

    Raises
    ------
    ProblemError
        If one of the two methods raises, or does not return these.
    """
    read = Reader(walker, q, p)
    if tree is None and has_links(walker):
        tree = state_tree(walker, q, p)
    with calling(walker, "outline"):
        lines = tree.lines() if tree and is_default(walker, "outline") else walker.outline(q, p)
    if not (is_list(lines, tuple | list) and all(len(line) > 1 for line in lines)):
        expected = "a tuple of lines, each a tuple of at least two points"
        raise ProblemError(f"{walker.__name__}: outline returns {shown(lines)}, but must return {expected}")
    drawn = tuple(
        tuple(read.vector(f"outline, line {k}, point {i}", point, 2, "all") for i, point in enumerate(line))
        for k, line in enumerate(lines)
    )
    with calling(walker, "contact"):
        point = tree.contact if tree and is_default(walker, "contact") else walker.contact(q, p)
    return drawn, read.vector("contact", point, 2, "all")


def _read_shape(walker: type[Walker], read: Reader, method: str, stated: object) -> SX:
    """One expression per shape coordinate, as a column."""
    if not isinstance(stated, tuple | list):
        expected = "a tuple of one expression per shape coordinate"
        raise ProblemError(f"{walker.__name__}: {method} returns {shown(stated)}, but must return {expected}")
    if len(stated) != len(walker.shape):
        counts = f"{len(stated)} coordinates, but shape has {len(walker.shape)}"
        raise ProblemError(f"{walker.__name__}: {method} gives {counts}")
    names = zip(walker.shape, stated, strict=True)
    return vertcat(*(read.scalar(f"{name} of {method}", value, "all") for name, value in names))


def _checked_switch(
    walker: type[Walker], read: Reader, name: str, margin: Callable[[SimpleNamespace], SX], entry: str = "switches"
) -> Callable[[SimpleNamespace], SX]:
    """The margin of a switch, or of a section, checked wherever it is evaluated."""
    what = f"Mechanism.{entry}[{name!r}]"

    def checked(rates: SimpleNamespace) -> SX:
        with calling(walker, what):
            value = margin(rates)
        symbols = vertcat(read.symbols, symbols_of(vars(rates).values()))
        return Reader(walker, SimpleNamespace(symbols=symbols), SimpleNamespace()).scalar(what, value, "all")

    checked(SimpleNamespace(**{rate: SX.sym(rate) for rate in (*walker.shape, *FOOT_COORDINATES)}))
    return checked


def _checked_motor(walker: type[Walker], read: Reader, what: str, name: str, angle: Any) -> SX:
    """The angle or length of a motor; an external motor's force must not depend on the position along the ground."""
    if name not in walker.external:
        return read.scalar(what, angle, "motor")
    moved = read.scalar(what, angle, "all")
    if depends_on(jacobian(moved, vertcat(read.shape, read.height, read.along)), read.along):
        rule = "must depend on x with a constant factor: the place on the ground makes no difference to the motion"
        raise ProblemError(f"{walker.__name__}: {what} {rule}")
    return moved


def _checked_contact(walker: type[Walker], read: Reader, name: str, contact: Contact) -> Contact:
    """A contact point with its expressions checked."""
    what = f"Mechanism.contacts[{name!r}]"
    for key in contact.places:
        if key not in walker.shape:
            reason = f"{what}.places names {shown(key)}, which is not a shape coordinate"
            raise ProblemError(f"{walker.__name__}: {reason}")
    return Contact(
        position=read.vector(f"{what}.position", contact.position, 2, "all"),
        counts=read.scalar(f"{what}.counts", contact.counts, "height"),
        places={key: read.scalar(f"{what}.places[{key!r}]", value, "height") for key, value in contact.places.items()},
        gap=None if contact.gap is None else read.scalar(f"{what}.gap", contact.gap, "height"),
    )


def _container_faults(walker: type[Walker], mechanism: Mechanism) -> Iterator[str]:
    """Messages about the containers of a mechanism, whose entries must agree with the class attributes."""
    for name, kind in (("bodies", Body), ("dampers", Damper), ("motors", object)):
        value: Any = getattr(mechanism, name)
        if not is_list(value, kind):
            entries = "angles" if kind is object else f"{kind.__name__}(...)"
            yield f"Mechanism.{name} is {shown(value)}, but must be a tuple of {entries}"
    for name in ("stops", "switches", "phases", "potential_while", "contacts", "sections"):
        value = getattr(mechanism, name)
        if not isinstance(value, Mapping):
            yield f"Mechanism.{name} is {shown(value)}, but must be a mapping from names to expressions"
    if not mechanism.bodies:
        yield "Mechanism.bodies is empty: a walker needs at least one body"
    if len(mechanism.motors) != len(walker.actuators):
        number = counted(len(mechanism.motors), "entry", "entries")
        yield f"Mechanism.motors has {number}, but actuators has {len(walker.actuators)}"
    yield from _push_faults(walker, mechanism)
    for name in ("stops", "switches", "phases", "contacts", "sections"):
        names, declared = (*getattr(mechanism, name),), getattr(walker, name)
        if names != declared:
            yield f"Mechanism.{name} has {', '.join(map(str, names)) or 'none'}, but {name} are {declared}"
    for entry, margins in (("switches", mechanism.switches), ("sections", mechanism.sections)):
        for name, margin in margins.items():
            if not callable(margin):
                rule = "must be a function of the rates, lambda dq: ..."
                yield f"Mechanism.{entry}[{name!r}] is {shown(margin)}, but {rule}"
    states = ["contact", *walker.contacts, *(f"{stop} {state}" for stop in walker.stops for state in STOP_STATES)]
    states += [f"{switch} {state}" for switch in walker.switches for state in SWITCH_STATES]
    for name in mechanism.potential_while:
        if name not in states:
            yield f"Mechanism.potential_while names {shown(name)}; allowed: {', '.join(states)}"


def _push_faults(walker: type[Walker], mechanism: Mechanism) -> Iterator[str]:
    """Messages about the impulses of the contacts that push off."""
    if bool(walker.pushes) is (mechanism.push is None):
        yield f"pushes is {walker.pushes}, but Mechanism.push is {'missing' if mechanism.push is None else 'given'}"
    if isinstance(walker.pushes, tuple) and walker.pushes:
        named = (*mechanism.push,) if isinstance(mechanism.push, Mapping) else shown(mechanism.push)
        if named != walker.pushes:
            yield f"Mechanism.push has {named}, but must be a mapping from the names of pushes, {walker.pushes}"


def _class_faults(walker: type[Walker]) -> Iterator[str]:
    """Messages about the attributes, methods and parameters of a class."""
    if is_default(walker, "mechanism") and is_default(walker, "links"):
        yield "lacks mechanism: define it, or define links"
    yield from _attribute_faults(walker)
    for name in OVERRIDABLE:
        if not isinstance(inspect.getattr_static(walker, name), classmethod | staticmethod):
            yield f"{name} must be a class method: write @classmethod above it"
    for name in DERIVED:
        if inspect.getattr_static(walker, name) is not inspect.getattr_static(Walker, name):
            yield f"{name} must not be overridden: it follows from the class attributes"
    yield from _name_faults(walker)
    for name, field in walker.model_fields.items():
        yield from (f"the parameter {name} {why}" for why in _field_faults(name, field))
    config = walker.model_config
    if not config.get("frozen") or config.get("extra") != "forbid":
        yield "model_config must keep frozen=True and extra='forbid'"
    exchanged = _exchanged(walker.exchanged)
    unknown = {*exchanged} - {*walker.model_fields}
    if unknown:
        yield f"exchanged names {', '.join(sorted(unknown))}, which is not a parameter"
    if doubles(exchanged):
        yield f"exchanged names {doubles(exchanged)} twice: each parameter changes places with one other"


def _attribute_faults(walker: type[Walker]) -> Iterator[str]:
    """Messages about class attributes that are missing or have values of a wrong type."""
    for name in ATTRIBUTES:
        if name in walker.model_fields:
            yield f"{name} has an annotation of a type, which makes it a parameter: write {name} = ... without one"
        elif not (hasattr(walker, name) if name != "section" else _section_of(walker) is not None):
            yield f"does not define its {name}{REMEDIES.get(name, '')}"
    stated: dict[str, Any] = {name: getattr(walker, name) for name in ATTRIBUTES if name != "section"}
    stated["section"] = _section_of(walker)
    if not (isinstance(stated["model"], str) and MODEL.fullmatch(stated["model"])):
        yield f"model is {shown(stated['model'])}, but must be a word, by which problem files name the walker"
    for name in LISTS:
        value = stated[name]
        if name == "section_rates" and value is None:
            continue
        if not isinstance(value, tuple):
            remedy = f"; write {name} = ({value!r},)" if isinstance(value, str) else ""
            yield f"{name} is {shown(value)}, but must be a tuple of names{remedy}"
        strange = [entry for entry in value if not is_name(entry)]
        if strange:
            yield f"{name} has the entry {shown(strange[0])}, but must be a tuple of names, each {NAME_WORDS}"
        if doubles(value) and name != "tracked":
            yield f"{name} names {doubles(value)} twice"
    for name in ("flies", "massless_feet", *(() if stated["contacts"] else ("pushes",))):
        if not isinstance(stated[name], bool):
            yield f"{name} is {shown(stated[name])}, but must be True or False"
    largest = stated["largest_angle"]
    is_number = isinstance(largest, int | float) and not isinstance(largest, bool)
    if not (is_number and 0 < largest <= math.pi):
        yield f"largest_angle is {shown(largest)}, but must be a number above 0 and at most pi"
    posture = stated["posture"]
    if not (isinstance(posture, Mapping) and all(map(is_finite, posture.values()))):
        yield f"posture is {shown(posture)}, but must be a mapping from shape coordinates to numbers"
    if not (isinstance(stated["exchanged"], Mapping) and all(map(is_name, _exchanged(stated["exchanged"])))):
        yield f"exchanged is {shown(stated['exchanged'])}, but must be a mapping from parameters to parameters"


def _name_faults(walker: type[Walker]) -> Iterator[str]:
    """Messages about names in the attributes that contradict each other."""
    if not walker.shape:
        yield "shape is empty: a walker has at least one coordinate besides its foot"
    if set(walker.shape) & {*FOOT_COORDINATES}:
        yield "shape names x or y, which are the coordinates of the stance foot"
    names = (*walker.shape, *FOOT_COORDINATES, *(f"d{name}" for name in (*walker.shape, *FOOT_COORDINATES)))
    if doubles(names):
        yield f"{doubles(names)} would be both a coordinate and the rate of another one: rename it in shape"
    columns = {*walker.shape} & {*COLUMNS}
    if columns:
        yield f"shape names {', '.join(sorted(columns))}, which is another column of the table of a motion: rename it"
    yield from _motor_faults(walker, names)
    for attribute in ("section", "section_rates", "posture", "lengths", "tracked"):
        named = _section_of(walker) if attribute == "section" else getattr(walker, attribute)
        foreign = {*(named or ())} - {*walker.shape, *(walker.actuators if attribute == "tracked" else ())}
        if foreign:
            yield f"{', '.join(sorted(foreign))} is not a shape coordinate, but {attribute} names it"
    for attribute in ("open_in_impact", "closing_stops"):
        if {*getattr(walker, attribute)} - {*walker.stops}:
            unknown = ", ".join(sorted({*getattr(walker, attribute)} - {*walker.stops}))
            yield f"{attribute} names {unknown}, which is not a stop"
    if "clock" in walker.phases:
        yield "phases names clock, which means the time since the impact: rename it"
    taken = {*walker.phases} & {*names}
    if taken:
        yield f"phases names {', '.join(sorted(taken))}, which is a coordinate or a rate: rename it"
    devices = (*walker.stops, *walker.switches, *walker.sections)
    for first, second in combinations(("stops", "switches", "sections"), 2):
        if twice := {*getattr(walker, first)} & {*getattr(walker, second)}:
            yield f"{', '.join(sorted(twice))} is named by both {first} and {second}"
    yield from _contact_faults(walker) if walker.contacts else ()
    taken = ({*devices, *walker.actuators} & {*RESERVED}) | ({*devices} & {*MARGIN_NAMES})
    if taken:
        conflict = "has another meaning in problem files: rename the stop, switch, section or actuator"
        yield f"{', '.join(sorted(taken))} {conflict}"


def _contact_faults(walker: type[Walker]) -> Iterator[str]:
    """Messages about attributes of a walker with named contacts."""
    if walker.massless_feet:
        remedy = "name the contacts at the end of massless parts in massless_contacts"
        yield f"massless_feet is True, but has no effect on a walker with contacts: {remedy}"
    if walker.exchanged and not walker.landing_contacts:
        yield "exchanged names legs that swap places, but nothing lands that ends a step: name it in landing_contacts"
    pushes, able = walker.pushes, [name for name in walker.contacts if name not in walker.massless_contacts]
    if pushes is not False and (not isinstance(pushes, tuple) or doubles(pushes) or {*pushes} - {*able}):
        expected = f"a tuple of those contacts with a mass that push off; possible: {', '.join(able) or 'none'}"
        yield f"pushes is {shown(pushes)}, but must be {expected}"


def _motor_faults(walker: type[Walker], names: tuple[str, ...]) -> Iterator[str]:
    """Messages about names of motors; ``names`` are those of coordinates and rates."""
    both, foreign = {*walker.actuators} & {*names}, {*walker.external} - {*walker.actuators}
    if both:
        yield f"actuators names {', '.join(sorted(both))}, which is a coordinate or a rate: rename one"
    if foreign:
        yield f"external names {', '.join(sorted(foreign))}, which is not an actuator"
    if walker.tracked and len(walker.tracked) != len(walker.actuators):
        number = counted(len(walker.tracked), "entry", "entries")
        yield f"tracked has {number}, but actuators has {len(walker.actuators)}"


def _field_faults(name: str, field: FieldInfo) -> Iterator[str]:
    """Messages about one parameter."""
    yield from field_faults(Walker, name, field, ATTRIBUTES)
    if field.annotation not in (float, int):
        kind = getattr(field.annotation, "__name__", str(field.annotation))
        yield f"is of type {kind}, but must be a number: float, int, or a type of gaitopt.model.units"
    if not (field.description is None or isinstance(field.description, str)):
        yield f"has the description {shown(field.description)}, which is not a text"


def _section_of(walker: type[Walker]) -> Any:
    """``Walker.section`` as classes define it; () if the closure of the legs chooses it, None if it is missing."""
    defined = [vars(base)["section"] for base in walker.__mro__ if "section" in vars(base)]
    return defined[0] if defined else () if is_default(walker, "after_impact") else None


def _exchanged(pairs: Mapping[str, str]) -> tuple[str, ...]:
    return (*pairs, *pairs.values())
