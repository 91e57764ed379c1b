"""The contract between a control law and a walker: checks of a law's class, and of the torques that it returns.

A law may come from any package. Each error is one sentence that names the class and the attribute or method.
"""

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from math import inf, isfinite
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
from casadi import (
    OP_CEIL,
    OP_CONST,
    OP_COPYSIGN,
    OP_EQ,
    OP_FABS,
    OP_FLOOR,
    OP_FMAX,
    OP_FMIN,
    OP_FMOD,
    OP_INPUT,
    OP_LE,
    OP_LT,
    OP_NE,
    OP_OUTPUT,
    OP_REMAINDER,
    OP_SIGN,
    SX,
    Function,
    tanh,
    vertcat,
)
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from gaitopt.arrays import Array
from gaitopt.errors import ProblemError
from gaitopt.model.control import OWN_PACKAGE, Control, SectionType, is_parameter, parameter_names
from gaitopt.model.foreign import MODEL, Reader, calling, check_declared, field_faults, shown
from gaitopt.model.instant import Instant
from gaitopt.model.reference import MOST_KNOTS, Path
from gaitopt.model.units import UNITS, Within
from gaitopt.model.walker import WalkerType

ATTRIBUTES = ("type", "version", "jumps", "restarts")
DERIVED = ("targets", "parameters", "structure", "source", "record", "unknowns", "guesses")
"""Methods of ``Control`` that follow from the fields of a class, and so must not be overridden."""
OPAQUE: tuple[object, ...] = (Any, object, dict, list, tuple, set, frozenset, Mapping, Sequence)
"""Annotations that say nothing about the values in a field."""
LARGEST_JUMP = 1e-6
"""Largest difference of the torques at both ends of a period, relative to those in between, that the rounding of the
period may cause."""
PERIOD_FRACTIONS = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0)
"""Fractions of the period at which torques are evaluated, with both ends."""
DEVIATION, STATES = 0.1, 3
"""The torques at both ends of a period are compared in this many states: the guess, and states that deviate from it by
random numbers of this size."""
KINKED = {OP_FABS: "fabs", OP_FMAX: "fmax", OP_FMIN: "fmin"}
"""Operations whose derivatives jump."""
JUMPING = {
    **dict.fromkeys((OP_LT, OP_LE, OP_EQ, OP_NE), "a comparison"),
    OP_SIGN: "sign", OP_FLOOR: "floor", OP_CEIL: "ceil", OP_FMOD: "fmod", OP_REMAINDER: "remainder",
    OP_COPYSIGN: "copysign",
}  # fmt: skip
"""Operations whose values jump."""


def check_law(law: object) -> None:
    """Check the attributes and parameters of a class of control laws; none of its methods is called.

    Raises
    ------
    ProblemError
        If an attribute is missing or has the wrong type.
    """
    check_declared(law, Control, _class_faults)


def _class_faults(law: type[Control]) -> Iterator[str]:
    """Messages about the attributes and fields of a class."""
    for name in ATTRIBUTES:
        if name in law.model_fields:
            yield f"{name} has an annotation of a type, which makes it a key: write {name} = ... without one"
        elif not hasattr(law, name):
            yield f"does not define its {name}"
    for name, hint in (("type", "by which problem files name the law"), ("version", "such as '1'")):
        value = getattr(law, name)
        if not (isinstance(value, str) and MODEL.fullmatch(value)):
            yield f"{name} is {shown(value)}, but must be a word, {hint}"
    for name in ("jumps", "restarts"):
        if not isinstance(getattr(law, name), bool):
            yield f"{name} is {shown(getattr(law, name))}, but must be True or False"
    for name, field in law.model_fields.items():
        if name not in Control.model_fields:
            yield from (f"the key {name} {why}" for why in _field_faults(name, field))
    if law.model_fields["limits"].annotation != Control.model_fields["limits"].annotation:
        yield "the key limits is that of every law, the largest torque of each motor: rename it"
    if not law.model_config.get("frozen"):
        yield "model_config must keep frozen=True"
    for name in DERIVED:
        owner = next(base for base in law.__mro__ if name in vars(base))
        if not owner.__module__.startswith(OWN_PACKAGE):
            yield f"{name} must not be overridden: it follows from the fields of the class"


def _field_faults(name: str, field: FieldInfo) -> Iterator[str]:
    """Messages about one field of a class."""
    yield from field_faults(Control, name, field, ATTRIBUTES)
    annotation = field.annotation
    if any(kind in OPAQUE for kind in _types(annotation)):
        kind = str(annotation) if get_args(annotation) else getattr(annotation, "__name__", str(annotation))
        reason = "which does not say what problem files may give: state one such as float, str or tuple[float, ...]"
        yield f"is of type {kind}, {reason}"
    for entry in field.metadata:
        if isinstance(entry, Within) and entry.unit not in UNITS:
            yield f"has a range in {shown(entry.unit)}, which is not a natural unit: {', '.join(UNITS)}"


def _types(annotation: object) -> Iterator[object]:
    """The types in an annotation; those of a generic one such as ``dict[str, float]`` are its arguments."""
    arguments = [argument for argument in get_args(annotation) if argument is not ...]
    if not arguments:
        yield annotation
    for argument in arguments:
        yield from _types(argument)


def law_section(law: type[Control], walker: WalkerType) -> SectionType:
    """The keys of a law for a walker: ``Control.section``, checked.

    Raises
    ------
    ProblemError
        If the method raises, or does not return a class of pydantic.
    """
    with calling(law, "section"):
        section: object = law.section(walker)
    if not (isinstance(section, type) and issubclass(section, BaseModel)):
        rule = "must return a pydantic class with the keys of the law, such as cls"
        raise ProblemError(f"{law.__name__}: section returns {shown(section)}, but {rule}")
    return section


def law_faults(law: Control, walker: WalkerType) -> Iterator[tuple[Path, str]]:
    """The keys below ``control`` that are wrong, with a message for each: ``Control.faults``, checked.

    Raises
    ------
    ProblemError
        If the method raises, or yields something else.
    """
    kind = type(law)
    with calling(kind, "faults"):
        stated: tuple[Any, ...] = tuple(law.faults(walker))
    for entry in stated:
        path, message = entry if isinstance(entry, tuple) and len(entry) == 2 else (None, None)
        keys = isinstance(path, tuple) and all(isinstance(key, str | int) for key in path)
        if not (keys and isinstance(message, str)):
            expected = 'a path and a message, such as (("gains", "hip"), "is missing")'
            raise ProblemError(f"{kind.__name__}: faults yields {shown(entry)}, but must yield {expected}")
    yield from stated


def check_hooks(law: Control, walker: WalkerType) -> None:
    """Check the results of a law's methods for a walker except torques: clock, phase variable and units.

    Raises
    ------
    ProblemError
        If a method raises, or returns something else than it must.
    """
    kind, name = type(law), type(law).__name__
    with calling(kind, "phase_variable"):
        phase: object = law.phase_variable
    phases = (*walker.shape, *walker.phases)
    if phase != "" and phase not in phases:
        rule = f"must be a phase variable of {walker.model}, {', '.join(phases)}, or empty"
        raise ProblemError(f"{name}: phase_variable is {shown(phase)}, but {rule}")
    for key in law.parameters:
        with calling(kind, "unit"):
            unit: object = law.unit(key)
        if not isinstance(unit, str):
            raise ProblemError(f"{name}: unit({key!r}) is {shown(unit)}, but must be a text such as 'N m/rad'")
    check_clock(law)


def check_period(law: Control, motors: Sequence[str], torques: Function, z: Array, p: Array) -> None:
    """Require that torques which do not jump are the same at both ends of the period of the law's clock.

    Parameters
    ----------
    motors : names of the motors.
    torques : function (t, z, p, r) of their torques.
    z, p : state near which torques are compared, and parameters.

    Raises
    ------
    ProblemError
        If they differ.
    """
    if law.period is None or law.jumps:
        return
    random = np.random.default_rng(0)
    times = [law.period * fraction for fraction in PERIOD_FRACTIONS]
    for size in (0.0, *(DEVIATION,) * (STATES - 1)):
        state = z + size * random.standard_normal(z.size)
        pieces = [law.data(bisect_left(law.breakpoints, time)) for time in times]
        applied = [np.asarray(torques(t, state, p, r)).ravel() for t, r in zip(times, pieces, strict=True)]
        start, end = applied[0], applied[-1]
        if not (np.abs(end - start) <= LARGEST_JUMP * np.abs(applied).max(initial=0.0)).all():
            k = int(np.argmax(np.abs(end - start)))
            jump = f"the motor {motors[k]} applies {start[k]:.6g} at its start and {end[k]:.6g} at its end"
            remedy = "make the torques periodic, or set jumps = True"
            raise ProblemError(f"{type(law).__name__}: period is {law.period:g} s, but {jump}: {remedy}")


def check_clock(law: Control) -> None:
    """Check breakpoints, horizon, period and segment data of a law.

    Raises
    ------
    ProblemError
        If there are too many breakpoints, or they are not increasing times; if segment data differ in length or are not
        numbers; or if one of these depends on a parameter.
    """
    kind, name = type(law), type(law).__name__
    read: dict[str, Callable[[Control], Any]] = {
        "breakpoints": lambda one: tuple(one.breakpoints),
        "horizon": lambda one: one.horizon,
        "period": lambda one: one.period,
        "data": lambda one: [one.data(k) for k in range(len(law.breakpoints) + 1)],
    }
    stated = dict[str, Any]()
    for key, value in read.items():
        with calling(kind, key):
            stated[key] = value(law)
        if key == "breakpoints" and len(stated[key]) > MOST_KNOTS and not kind.__module__.startswith(OWN_PACKAGE):
            limit = f"{len(stated[key]):,} breakpoints divide the motion into as many parts; use at most {MOST_KNOTS}"
            raise ProblemError(f"{name}: {limit}, or smooth torques")
    times, horizon, period = stated["breakpoints"], stated["horizon"], stated["period"]
    if not (all(map(_is_time, times)) and all(a < b for a, b in pairwise((0.0, *times)))):
        raise ProblemError(f"{name}: breakpoints are {shown(times)}, but must be increasing times above 0 [s]")
    if not (horizon == inf or (_is_time(horizon) and horizon > max(times, default=0.0))):
        raise ProblemError(f"{name}: horizon is {shown(horizon)}, but must be a time after the breakpoints [s]")
    if not (_is_time(period) or (period is None and law.restarts)):
        other = "or None" if law.restarts else "because restarts is False: the cycle of a gait ends with it"
        raise ProblemError(f"{name}: period is {shown(period)}, but must be a time above 0 [s], {other}")
    for segment, data in enumerate(stated["data"]):
        numbers = isinstance(data, np.ndarray) and data.ndim == 1 and data.dtype.kind in "iuf"
        if not (numbers and np.isfinite(data).all()):
            rule = "must be a row of finite numbers, such as np.array([1.0, 0.0])"
            raise ProblemError(f"{name}: data({segment}) is {shown(data)}, but {rule}")
    lengths = sorted({data.size for data in stated["data"]})
    if len(lengths) > 1:
        counts = f"{' or '.join(map(str, lengths))} numbers, but must have the same length in every segment"
        raise ProblemError(f"{name}: data has {counts}")
    varied = symbolic(law, parameter_names(law, SX.sym("p", len(law.parameters))))
    for key, value in read.items():
        try:
            same = _equal(value(varied), stated[key])
        except Exception:  # noqa: BLE001 - a law that computes with symbols instead of numbers may raise anything
            same = False
        if not same:
            reason = "depends on a parameter, which may vary: annotate that one as Annotated[float, gaitopt.Fixed]"
            raise ProblemError(f"{name}: {key} {reason}")


def _equal(one: Any, other: Any) -> bool:
    """Whether two values of a law are equal; expressions are compared by their texts."""
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_equal, one, other))
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray) and one.dtype.kind in "iuf":
        return np.array_equal(one, other)
    return repr(one) == repr(other)


def jumping_operations(torques: Function, kinds: Mapping[int, str] = JUMPING) -> tuple[str, ...]:
    """Names of those operations of some kinds in a function (t, z, p, r) that depend on time or state."""
    moves = [False] * torques.sz_w()
    found = dict[str, None]()
    for k in range(torques.n_instructions()):
        operation, operands = torques.instruction_id(k), torques.instruction_input(k)
        if operation == OP_OUTPUT:
            continue
        if operation in (OP_CONST, OP_INPUT):
            moved = operation == OP_INPUT and operands[0] < 2
        else:
            moved = any(moves[operand] for operand in operands)
        if moved and operation in kinds:
            found[kinds[operation]] = None
        moves[torques.instruction_output(k)[0]] = moved
    return tuple(found)


def _is_time(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value) and value > 0


def symbolic(law: Control, p: SimpleNamespace) -> Control:
    """The law with symbols instead of its parameters, so that ``self.kp`` and ``now.p.kp`` are the same."""
    values = dict(law)
    for name in values:
        if is_parameter(type(law), name):
            known = getattr(p, name)
            values[name] = vars(known) if isinstance(known, SimpleNamespace) else known
    return type(law).model_construct(**values)


def torques(law: Control, now: Instant, p: SX) -> SX:
    """The torques of a law, checked and within its limits, shape (n_u,) [N m].

    Parameters
    ----------
    p : SX - all parameters, on which ``Instant.accelerations`` may depend.

    Raises
    ------
    ProblemError
        If ``Control.torques`` raises, or does not return one expression of the given symbols for some of the motors.
    """
    kind, walker = type(law), now.robot.walker
    with calling(kind, "torques"):
        stated = symbolic(law, now.p).torques(now)
    if not isinstance(stated, Mapping):
        expected = "a mapping from actuators to torques"
        raise ProblemError(f"{kind.__name__}: torques returns {shown(stated)}, but must return {expected}")
    for name in stated:
        if name not in walker.actuators:
            has = f"has the actuators {', '.join(walker.actuators)}" if walker.actuators else "has no actuators"
            raise ProblemError(f"{kind.__name__}: torques names {shown(name)}, but {walker.model} {has}")
    read = Reader(kind, SimpleNamespace(symbols=vertcat(now.t, now.robot.z, p, now.r)), SimpleNamespace())
    limits = vars(now.p.limits)
    result = []
    for name in walker.actuators:
        u = read.scalar(f"torques[{name!r}]", stated.get(name, SX(0)), "all")
        result.append(limits[name] * tanh(u / limits[name]) if name in limits else u)
    return vertcat(SX(0, 1), *result)


def quantities(law: Control, now: Instant, p: SX) -> dict[str, SX]:
    """The further expressions of a law by name, checked; for the arguments see ``torques``.

    Raises
    ------
    ProblemError
        If ``Control.quantities`` raises, or does not return expressions of the given symbols by name.
    """
    kind, known = type(law), vertcat(now.t, now.robot.z, p, now.r)
    with calling(kind, "quantities"):
        stated: object = symbolic(law, now.p).quantities(now)
    if not (isinstance(stated, Mapping) and all(isinstance(name, str) for name in stated)):
        rule = "must return a mapping from names to expressions"
        raise ProblemError(f"{kind.__name__}: quantities returns {shown(stated)}, but {rule}")
    read = Reader(kind, SimpleNamespace(symbols=known), SimpleNamespace())
    return {name: read.expression(f"quantities[{name!r}]", value) for name, value in stated.items()}
