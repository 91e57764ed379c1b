"""The contract between a control law and a walker: checks of a law's class, and of the torques that it gives.

A law may come from any package. Each error is one sentence that names the class and the attribute or method.
"""

import inspect
from collections.abc import Iterator, Mapping
from types import SimpleNamespace
from weakref import WeakSet

from casadi import SX, tanh, vertcat

from gaitopt.errors import ProblemError
from gaitopt.model.control import Control, Instant, is_parameter
from gaitopt.model.declaration import MODEL, NAME, NAME_WORDS, Reader, calling, shown

ATTRIBUTES = ("type", "version", "jumps", "restarts")
_PASSED: WeakSet[type[Control]] = WeakSet()
"""Classes that have passed ``check_law``."""


def check_law(law: object) -> None:
    """Check the attributes and parameters of a class of control laws; none of its methods is called.

    Raises
    ------
    ProblemError
        If an attribute is missing or has the wrong type.
    """
    if not (isinstance(law, type) and issubclass(law, Control)):
        raise ProblemError(f"{shown(law)} is no subclass of gaitopt.Control")
    if law in _PASSED:
        return
    with calling(law, "reading its attributes"):
        if inspect.isabstract(law):
            raise ProblemError(f"{law.__name__}: lacks {', '.join(sorted(law.__abstractmethods__))}")
        reason = next(_class_faults(law), None)
    if reason is not None:
        raise ProblemError(f"{law.__name__}: {reason}")
    _PASSED.add(law)


def _class_faults(law: type[Control]) -> Iterator[str]:
    """Messages about the attributes and fields of a class."""
    for name in ATTRIBUTES:
        if name in law.model_fields:
            yield f"{name} has an annotation of a type, which makes it a key: write {name} = ... without one"
        elif not hasattr(law, name):
            yield f"does not define its {name}"
    for name, words in (("type", "by which problem files name the law"), ("version", "such as '1'")):
        value = getattr(law, name)
        if not (isinstance(value, str) and MODEL.fullmatch(value)):
            yield f"{name} is {shown(value)}, but must be a word, {words}"
    for name in ("jumps", "restarts"):
        if not isinstance(getattr(law, name), bool):
            yield f"{name} is {shown(getattr(law, name))}, but must be True or False"
    if not law.restarts:
        yield "restarts is False, but gaitopt computes gaits only of laws whose clock restarts at every impact"
    for name, field in law.model_fields.items():
        if name not in Control.model_fields and (hasattr(Control, name) or name in ATTRIBUTES):
            yield f"the key {name} has the name of an attribute or method of Control: rename it"
        if not NAME.fullmatch(name):
            yield f"the key {name} must have {NAME_WORDS}"
        if field.alias is not None or field.validation_alias is not None:
            yield f"the key {name} has an alias: problem files name it as the class does"
        if field.exclude:
            yield f"the key {name} is excluded from records of the law"
    if not law.model_config.get("frozen"):
        yield "model_config must keep frozen=True"


def symbolic(law: Control, p: SimpleNamespace) -> Control:
    """The law with symbols in place of its parameters, so that ``self.kp`` and ``now.p.kp`` are the same."""
    fields = type(law).model_fields
    values = dict(law)
    for name in values:
        if is_parameter(fields.get(name)):
            known = getattr(p, name)
            values[name] = vars(known) if isinstance(known, SimpleNamespace) else known
    return type(law).model_construct(**values)


def torques(law: Control, now: Instant, friction: SX) -> SX:
    """The torques of a law, checked and within its limits, shape (n_u,) [N m].

    Parameters
    ----------
    friction : SX - coefficients of the friction law, on which the accelerations of a slipping foot depend.

    Raises
    ------
    ProblemError
        If ``Control.torques`` raises, or does not return one expression of the given symbols for some of the motors.
    """
    kind, walker = type(law), now.robot.walker
    with calling(kind, "torques"):
        stated = symbolic(law, now.p).torques(now)
    if not isinstance(stated, Mapping):
        words = "a mapping from actuators to torques"
        raise ProblemError(f"{kind.__name__}: torques returns {shown(stated)}, but must return {words}")
    for name in stated:
        if name not in walker.actuators:
            has = f"has the actuators {', '.join(walker.actuators)}" if walker.actuators else "has no actuators"
            raise ProblemError(f"{kind.__name__}: torques names {shown(name)}, but {walker.model} {has}")
    symbols = [now.t, now.robot.z, now.robot.p, now.r, friction, *_leaves(now.p)]
    read = Reader(kind, SimpleNamespace(symbols=vertcat(*symbols)), SimpleNamespace())
    limits = vars(now.p.limits)
    result = []
    for name in walker.actuators:
        u = read.scalar(f"torques[{name!r}]", stated.get(name, SX(0)), "all")
        result.append(limits[name] * tanh(u / limits[name]) if name in limits else u)
    return vertcat(SX(0, 1), *result)


def _leaves(names: SimpleNamespace) -> Iterator[SX]:
    for value in vars(names).values():
        yield from _leaves(value) if isinstance(value, SimpleNamespace) else (value,)
