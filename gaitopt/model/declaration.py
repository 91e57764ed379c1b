"""The class of a walker: checks of its attributes, and calls of its methods with checks of their results.

A class may come from any package. Its attributes are checked before they are used. The results of its methods are
checked before they enter an equation: each expression has the right shape and depends only on the arguments that it may
depend on. An error is one sentence that names the class and the attribute or method.
"""

import inspect
import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import SimpleNamespace, UnionType
from typing import Any
from weakref import WeakSet

import numpy as np
from casadi import DM, SX, Function, depends_on, jacobian, symvar, vertcat
from pydantic.fields import FieldInfo

from gaitopt.errors import ProblemError
from gaitopt.model.modes import STOP_STATES, SWITCH_STATES
from gaitopt.model.walker import Body, Contact, Damper, Mechanism, Walker

NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*")
"""Names of coordinates, actuators, stops and switches, which occur in keys, columns and compiled functions."""
NAME_WORDS = "a name of ASCII letters and digits, with single underscores between them"
FOOT_COORDINATES = ("x", "y")
RESERVED = ("mode", "contact", "impact", "model", "type", "touchdown", "upright", "clearance", "painleve")
"""Words with another meaning where the names of stops, switches and actuators occur."""
DERIVED = (
    "foot_modes",
    "modes",
    "steps_per_cycle",
    "step_parameters",
    "released",
    "coordinates",
    "state_names",
    "section_names",
    "model_post_init",
)
"""Methods of ``Walker`` that follow from the class attributes."""
OVERRIDABLE = ("mechanism", "after_impact", "rates_after_impact", "landing", "outline", "contact")
"""Methods that a class may define."""
ATTRIBUTES = tuple(Walker.__annotations__)
LISTS = (
    "shape", "section", "section_rates", "stops", "open_in_impact", "switches", "lengths", "actuators", "tracked",
    "contacts", "massless_contacts", "landing_contacts",
)  # fmt: skip
"""Class attributes that are tuples of names."""
KINDS: Any = (SX, DM, int, float, np.number, np.ndarray)
"""Types of a method's results where an expression belongs."""
MODEL = re.compile(r"\w[\w.-]*")
_PASSED: WeakSet[type[Walker]] = WeakSet()
"""Classes that have passed ``check_class``; every point of a branch builds a problem of the same class."""


def check_class(walker: object) -> None:
    """Check the attributes and parameters of a class; none of its methods is called.

    Raises
    ------
    ProblemError
        If an attribute is missing, has the wrong type, names something twice, or contradicts another attribute.
    """
    if not (isinstance(walker, type) and issubclass(walker, Walker)):
        raise ProblemError(f"{shown(walker)} is no subclass of gaitopt.Walker")
    if walker in _PASSED:
        return
    with calling(walker, "reading its attributes"):
        if inspect.isabstract(walker):
            raise ProblemError(f"{walker.__name__}: lacks {', '.join(sorted(walker.__abstractmethods__))}")
        reason = next(_class_faults(walker), None)
    if reason is not None:
        raise ProblemError(f"{walker.__name__}: {reason}")
    _PASSED.add(walker)


@contextmanager
def calling(walker: type[Walker], what: str) -> Iterator[None]:
    """Turn any exception of a class into one sentence.

    Raises
    ------
    ProblemError
        If the body of the ``with`` raises an exception, SystemExit included; KeyboardInterrupt passes.
    """
    try:
        yield
    except ProblemError:
        raise
    except (Exception, SystemExit) as error:  # the code of a class may raise anything
        raise ProblemError(f"{walker.__name__}: {what} raises {raised(error)}") from error


def raised(error: BaseException) -> str:
    """Type and first line of an exception."""
    try:
        lines = str(error).splitlines()
    except Exception:  # noqa: BLE001 - someone's exception may not even have a text
        lines = []
    return ": ".join([type(error).__name__, *lines[:1]])


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
    read = _Reader(walker, q, p)
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
        relabel=stated.relabel
        if walker.contacts and SX(stated.relabel).is_empty()
        else read.vector("Mechanism.relabel", stated.relabel, len(walker.shape), "shape"),
        stops=stops,
        switches={name: _checked_switch(read, name, margin) for name, margin in stated.switches.items()},
        motors=tuple(read.scalar(f"Mechanism.motors[{k}]", angle, "shape") for k, angle in enumerate(stated.motors)),
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
        push=None if stated.push is None else read.vector("Mechanism.push", stated.push, 2, "shape"),
        length=None if stated.length is None else read.scalar("Mechanism.length", stated.length, "parameters"),
        contacts={name: _checked_contact(read, name, contact) for name, contact in stated.contacts.items()},
    )
    if vertcat(q.x, q.y).is_valid_input():  # symbols rather than a given position of the foot
        if not (walker.contacts or depends_on(mechanism.touchdown, _symbols(_entries(q).values()))):
            raise ProblemError(f"{walker.__name__}: Mechanism.touchdown is the same in every posture")
        points = {f"body {k}": body.position for k, body in enumerate(mechanism.bodies)}
        points |= {f"contact {name}": contact.position for name, contact in mechanism.contacts.items()}
        points |= {} if walker.contacts else {"the swing foot": mechanism.swing_foot}
        for name, point in points.items():
            with_foot = jacobian(point, vertcat(q.x, q.y))
            if not with_foot.is_constant() or not DM(with_foot - SX.eye(2)).is_zero():
                raise ProblemError(f"{walker.__name__}: {name} does not move along with the stance foot (q.x, q.y)")
    return mechanism


def state_after_impact(walker: type[Walker], free: SimpleNamespace, p: SimpleNamespace) -> tuple[SX, SX]:
    """Shape coordinates and their rates just after an impact, (n_shape,) each, from those of the section.

    Raises
    ------
    ProblemError
        If one of the two methods raises, or does not return one expression per shape coordinate.
    """
    read, results = _Reader(walker, free, p), []
    for name in ("after_impact", "rates_after_impact"):
        with calling(walker, name):
            stated = getattr(walker, name)(free, p)
        results.append(_read_shape(read, name, stated))
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
    if not (_is_list(stated, object) and len(stated) == 2):
        words = "two tuples: the shape coordinates and their rates"
        raise ProblemError(f"{walker.__name__}: landing returns {shown(stated)}, but must return {words}")
    read = _Reader(walker, SimpleNamespace(**_entries(q), **_entries(dq, "d")), p)
    return _read_shape(read, "landing", stated[0]), _read_shape(read, "landing", stated[1])


def state_picture(
    walker: type[Walker], q: SimpleNamespace, p: SimpleNamespace
) -> tuple[tuple[tuple[SX, ...], ...], SX]:
    """The lines of ``Walker.outline``, each a tuple of points of shape (2,), and the point of ``Walker.contact`` [m].

    Raises
    ------
    ProblemError
        If one of the two methods raises, or does not return these.
    """
    read = _Reader(walker, q, p)
    with calling(walker, "outline"):
        lines = walker.outline(q, p)
    if not (_is_list(lines, tuple | list) and all(len(line) > 1 for line in lines)):
        words = "a tuple of lines, each a tuple of at least two points"
        raise ProblemError(f"{walker.__name__}: outline returns {shown(lines)}, but must return {words}")
    drawn = tuple(
        tuple(read.vector(f"outline, line {k}, point {i}", point, 2, "all") for i, point in enumerate(line))
        for k, line in enumerate(lines)
    )
    with calling(walker, "contact"):
        point = walker.contact(q, p)
    return drawn, read.vector("contact", point, 2, "all")


class _Reader:
    """Reads the results of a walker's methods, whose arguments are coordinates ``q`` and parameters ``p`` by name."""

    def __init__(self, walker: type[Walker], q: SimpleNamespace, p: SimpleNamespace) -> None:
        self.walker = walker
        entries, parameters = _entries(q), _entries(p)
        self.symbols = _symbols([*entries.values(), *parameters.values()])
        foot = {name: entries.pop(name) for name in FOOT_COORDINATES if name in entries}
        self.shape, self.height = _symbols(entries.values()), _symbols([foot["y"]] if "y" in foot else [])
        along = _symbols([foot["x"]] if "x" in foot else [])
        everything = vertcat(self.shape, self.height, along)
        self._forbidden = {
            "all": ("", SX(0, 1)),
            "height": ("the coordinates and parameters, but not of x", along),
            "shape": ("the shape coordinates and parameters, but not of x and y", vertcat(self.height, along)),
            "parameters": ("the parameters alone", everything),
        }

    def scalar(self, what: str, value: Any, of: str) -> SX:
        """One expression."""
        return self.vector(what, value, 1, of)

    def vector(self, what: str, value: Any, size: int, of: str) -> SX:
        """A column of expressions, which depend on the arguments ``of``: a key of ``_forbidden``."""
        name = self.walker.__name__
        form = "one number or expression" if size == 1 else f"a column of {size}, vertcat(...)"
        strange = isinstance(value, bool) or (isinstance(value, np.ndarray) and value.dtype.kind not in "iuf")
        if strange or not isinstance(value, KINDS):
            raise ProblemError(f"{name}: {what} is {shown(value)}, but must be {form} of CasADi's type SX")
        with calling(self.walker, f"reading {what}"):
            expression = SX(value)
        if expression.shape != (size, 1):
            rows, columns = expression.shape
            raise ProblemError(f"{name}: {what} has shape ({rows}, {columns}), but must be {form}")
        foreign = Function("foreign", [self.symbols], [expression], {"allow_free": True}).free_sx()
        if foreign:
            words = ", ".join(str(symbol) for symbol in foreign)
            raise ProblemError(f"{name}: {what} holds {words}, which is none of the symbols that the method was given")
        words, forbidden = self._forbidden[of]
        if forbidden.numel() and depends_on(expression, forbidden):
            raise ProblemError(f"{name}: {what} must be a function of {words}")
        return expression


def _read_shape(read: _Reader, method: str, stated: object) -> SX:
    """One expression per shape coordinate, as a column."""
    walker = read.walker
    if not isinstance(stated, tuple | list):
        words = "a tuple of one expression per shape coordinate"
        raise ProblemError(f"{walker.__name__}: {method} returns {shown(stated)}, but must return {words}")
    if len(stated) != len(walker.shape):
        words = f"{len(stated)} coordinates, but shape has {len(walker.shape)}"
        raise ProblemError(f"{walker.__name__}: {method} gives {words}")
    names = zip(walker.shape, stated, strict=True)
    return vertcat(*(read.scalar(f"{name} of {method}", value, "all") for name, value in names))


def _checked_switch(
    read: _Reader, name: str, margin: Callable[[SimpleNamespace], SX]
) -> Callable[[SimpleNamespace], SX]:
    """The margin of a switch, checked wherever it is evaluated."""
    walker, what = read.walker, f"Mechanism.switches[{name!r}]"

    def checked(rates: SimpleNamespace) -> SX:
        with calling(walker, what):
            value = margin(rates)
        symbols = vertcat(read.symbols, _symbols(_entries(rates).values()))
        return _Reader(walker, SimpleNamespace(symbols=symbols), SimpleNamespace()).scalar(what, value, "all")

    checked(SimpleNamespace(**{rate: SX.sym(rate) for rate in (*walker.shape, *FOOT_COORDINATES)}))
    return checked


def _checked_contact(read: _Reader, name: str, contact: Contact) -> Contact:
    """A contact point with its expressions checked."""
    what = f"Mechanism.contacts[{name!r}]"
    for key in contact.places:
        if key not in read.walker.shape:
            words = f"{what}.places names {shown(key)}, which is no shape coordinate"
            raise ProblemError(f"{read.walker.__name__}: {words}")
    return Contact(
        position=read.vector(f"{what}.position", contact.position, 2, "all"),
        counts=read.scalar(f"{what}.counts", contact.counts, "height"),
        places={key: read.scalar(f"{what}.places[{key!r}]", value, "height") for key, value in contact.places.items()},
        gap=None if contact.gap is None else read.scalar(f"{what}.gap", contact.gap, "height"),
    )


def _container_faults(walker: type[Walker], mechanism: Mechanism) -> Iterator[str]:
    """Messages about the containers of a mechanism, whose entries the class attributes announce."""
    for name, kind in (("bodies", Body), ("dampers", Damper), ("motors", object)):
        value: Any = getattr(mechanism, name)
        if not _is_list(value, kind):
            words = "angles" if kind is object else f"{kind.__name__}(...)"
            yield f"Mechanism.{name} is {shown(value)}, but must be a tuple of {words}"
    for name in ("stops", "switches", "potential_while", "contacts"):
        value = getattr(mechanism, name)
        if not isinstance(value, Mapping):
            yield f"Mechanism.{name} is {shown(value)}, but must be a mapping from names to expressions"
    if not mechanism.bodies:
        yield "Mechanism.bodies is empty: a walker has a mass"
    if len(mechanism.motors) != len(walker.actuators):
        yield f"Mechanism.motors has {len(mechanism.motors)} entries, but actuators has {len(walker.actuators)}"
    if walker.pushes is (mechanism.push is None):
        yield f"pushes is {walker.pushes}, which Mechanism.push contradicts"
    for name in ("stops", "switches", "contacts"):
        names, declared = (*getattr(mechanism, name),), getattr(walker, name)
        if names != declared:
            yield f"Mechanism.{name} has {', '.join(map(str, names)) or 'none'}, but {name} are {declared}"
    for name, margin in mechanism.switches.items():
        if not callable(margin):
            words = f"{shown(margin)}, but must be a function of the rates, lambda dq: ..."
            yield f"Mechanism.switches[{name!r}] is {words}"
    states = ["contact", *walker.contacts, *(f"{stop} {state}" for stop in walker.stops for state in STOP_STATES)]
    states += [f"{switch} {state}" for switch in walker.switches for state in SWITCH_STATES]
    for name in mechanism.potential_while:
        if name not in states:
            yield f"Mechanism.potential_while names {shown(name)}; allowed: {', '.join(states)}"


def _class_faults(walker: type[Walker]) -> Iterator[str]:
    """Messages about the attributes, methods and parameters of a class."""
    yield from _attribute_faults(walker)
    for name in OVERRIDABLE:
        if not isinstance(inspect.getattr_static(walker, name), classmethod | staticmethod):
            yield f"{name} must be a class method: write @classmethod above it"
    for name in DERIVED:
        if inspect.getattr_static(walker, name) is not inspect.getattr_static(Walker, name):
            yield f"{name} must not be overridden: it follows from the class attributes"
    if walker.massless_feet and inspect.getattr_static(walker, "landing") is inspect.getattr_static(Walker, "landing"):
        yield "has massless feet, but does not define how they land: define landing"
    yield from _name_faults(walker)
    for name, field in walker.model_fields.items():
        why = _field_fault(name, field)
        if why is not None:
            yield f"the parameter {name} {why}"
    config = walker.model_config
    if not config.get("frozen") or config.get("extra") != "forbid":
        yield "model_config must keep frozen=True and extra='forbid'"
    exchanged = _exchanged(walker.exchanged)
    unknown = {*exchanged} - {*walker.model_fields}
    if unknown:
        yield f"exchanged names {', '.join(sorted(unknown))}, which is no parameter"
    if _doubles(exchanged):
        yield f"exchanged names {_doubles(exchanged)} twice: each parameter changes places with one other"


def _attribute_faults(walker: type[Walker]) -> Iterator[str]:
    """Messages about class attributes that are missing or have values of a wrong type."""
    for name in ATTRIBUTES:
        if name in walker.model_fields:
            yield f"{name} has an annotation of a type, which makes it a parameter: write {name} = ... without one"
        elif not hasattr(walker, name):
            yield f"does not define its {name}"
    stated: dict[str, Any] = {name: getattr(walker, name) for name in ATTRIBUTES}
    if not (isinstance(stated["model"], str) and MODEL.fullmatch(stated["model"])):
        yield f"model is {shown(stated['model'])}, but must be a word, by which problem files name the walker"
    for name in LISTS:
        value = stated[name]
        if name == "section_rates" and value is None:
            continue
        if not isinstance(value, tuple):
            remedy = f"; write {name} = ({value!r},)" if isinstance(value, str) else ""
            yield f"{name} is {shown(value)}, but must be a tuple of names{remedy}"
        strange = [entry for entry in value if not _is_name(entry)]
        if strange:
            yield f"{name} has the entry {shown(strange[0])}, but must be a tuple of names, each {NAME_WORDS}"
        if _doubles(value) and name != "tracked":
            yield f"{name} names {_doubles(value)} twice"
    for name in ("flies", "massless_feet", "pushes"):
        if not isinstance(stated[name], bool):
            yield f"{name} is {shown(stated[name])}, but must be True or False"
    largest = stated["largest_angle"]
    is_number = isinstance(largest, int | float) and not isinstance(largest, bool)
    if not (is_number and 0 < largest <= math.pi):
        yield f"largest_angle is {shown(largest)}, but must be a number above 0 and at most pi"
    if not (isinstance(stated["exchanged"], Mapping) and all(map(_is_name, _exchanged(stated["exchanged"])))):
        yield f"exchanged is {shown(stated['exchanged'])}, but must be a mapping from parameters to parameters"


def _name_faults(walker: type[Walker]) -> Iterator[str]:
    """Messages about names in the attributes that contradict each other."""
    if not walker.shape:
        yield "shape is empty: a walker has at least one coordinate besides its foot"
    if set(walker.shape) & {*FOOT_COORDINATES}:
        yield "shape names x or y, which are the coordinates of the stance foot"
    names = (*walker.shape, *FOOT_COORDINATES, *(f"d{name}" for name in (*walker.shape, *FOOT_COORDINATES)))
    if _doubles(names):
        yield f"{_doubles(names)} would be both a coordinate and the rate of another one: rename it in shape"
    for part in ("section", "section_rates", "lengths", "tracked"):
        foreign = {*(getattr(walker, part) or ())} - {*walker.shape}
        if foreign:
            yield f"{', '.join(sorted(foreign))} is no shape coordinate, but {part} names it"
    if {*walker.open_in_impact} - {*walker.stops}:
        yield f"open_in_impact names {', '.join(sorted({*walker.open_in_impact} - {*walker.stops}))}, which is no stop"
    if len(walker.tracked) != len(walker.actuators):
        yield f"tracked has {len(walker.tracked)} entries, but actuators has {len(walker.actuators)}"
    devices = (*walker.stops, *walker.switches)
    if set(walker.stops) & set(walker.switches):
        yield f"{', '.join(sorted(set(walker.stops) & set(walker.switches)))} is named by both stops and switches"
    taken = {*devices, *walker.actuators} & {*RESERVED}
    if taken:
        yield f"{', '.join(sorted(taken))} has another meaning in problem files: rename the stop, switch or actuator"


def _field_fault(name: str, field: FieldInfo) -> str | None:
    """Message about one parameter."""
    if hasattr(Walker, name) or name in ATTRIBUTES:
        return "has the name of an attribute or method of Walker: rename it"
    if not NAME.fullmatch(name):
        return f"must have {NAME_WORDS}"
    if field.annotation not in (float, int):
        kind = getattr(field.annotation, "__name__", str(field.annotation))
        return f"is of type {kind}, but must be a number: float, int, or a type of gaitopt.model.units"
    if field.alias is not None or field.validation_alias is not None:
        return "has an alias: problem files name it as the class does"
    if field.exclude:
        return "is excluded from records of the walker"
    if not (field.description is None or isinstance(field.description, str)):
        return f"has the description {shown(field.description)}, which is no text"
    return None


def _exchanged(pairs: Mapping[str, str]) -> tuple[str, ...]:
    return (*pairs, *pairs.values())


def _is_name(value: object) -> bool:
    return isinstance(value, str) and NAME.fullmatch(value) is not None


def _is_list(value: object, kind: type | UnionType) -> bool:
    return isinstance(value, tuple | list) and all(isinstance(entry, kind) for entry in value)


def _doubles(names: tuple[str, ...]) -> str:
    """The names that occur twice, as a list in words."""
    return ", ".join(sorted({name for name in names if names.count(name) > 1}))


def _entries(names: SimpleNamespace, prefix: str = "") -> dict[str, Any]:
    return {f"{prefix}{name}": value for name, value in vars(names).items()}


def _symbols(expressions: Any) -> SX:
    """All symbols in some expressions, as a column."""
    return vertcat(SX(0, 1), *symvar(vertcat(SX(0, 1), *expressions)))


def shown(value: object) -> str:
    """A value in a message: its text if that is short, else its type."""
    try:
        text = repr(value)
    except Exception:  # noqa: BLE001 - the text of someone's object may raise anything
        text = ""
    return text if 0 < len(text) <= 40 and text.isprintable() else f"a value of type {type(value).__name__}"
