"""Faults of a problem: all errors at once, each with its location, the allowed values and a remedy.

A fault has the path of its key. A ``Place`` turns the path into ``file.yaml:7:9 walker.leg_mass``, or into the
overridden key after the label of the option that set it. For some words that a problem file does not accept (knee,
spring, rough terrain) the message names the walker that has them, or says that the model excludes them.
"""

import difflib
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from string import digits
from types import UnionType
from typing import Annotated, Any, Protocol, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from gaitopt.display import counted
from gaitopt.errors import ProblemError, printable
from gaitopt.model.units import LARGEST_SIZE, SMALLEST_SIZE, Free, is_free
from gaitopt.requests import LONGEST_SHOWN

HINTS: Mapping[str, str] = {
    "knee": "a knee is a joint stop: kneed_walker has one, and its phases state it, {mode: stick, knee: free}",
    "roll|round|arc": "round_feet_compass has feet that roll: they stick where they touch the ground",
    "spring|stiff|damp": "torso_walker and telescopic_compass have springs and dampers, or a class of your own",
    "torso|trunk": "torso_walker has a torso, and driven_torso a motor between it and each leg",
    "telescop|retract": "telescopic_compass has telescopic legs",
    "push": "push_off_compass pushes off with its stance foot",
    "hop|jump|fly|airborne|running": "hopper and slip_runner leave the ground, in phases called flight",
    "limp|other_leg": "the legs of unequal_compass may differ",
    "support|both_feet": "a class with several contacts may have both feet on the ground, such as slip_walker",
    "bounc|rebound|restitution|elastic": "impacts are plastic, and nothing bounces",
    "stair|step_height|rough|terrain|obstacle": "gaits are on a plane slope; `gaitopt simulate --floor` has steps",
    "lateral|yaw|3d|width": "all motion is in a plane",
    "electric|joule": "electrical work with R/k^2 of the windings: objective: {work: 1, torque_squared: R/k^2}",
    "delay|observer|sampl|cpg": "a control is a function of the shape, its rates and the time since the impact",
}
"""Which walker or key has what an unknown key asks for, by a pattern of that key; docs/comparison.md says the same."""


SYNONYMS = {"mu": "friction", "mu_s": "static", "mu_k": "kinetic", "g": "gravity", "incline": "slope"}
"""Keys that other programs use, with the key of a problem file."""
Key = tuple[str | int, ...]
"""Path of a value in the data: keys of mappings and indices of lists."""

LOOKS_ALIKE = 0.3
"""A dotted key is suggested if its similarity by difflib is larger. The ratio is low, because the sections that precede
the last name often differ."""

Model = TypeVar("Model", bound=BaseModel)
Value = TypeVar("Value")


@dataclass(frozen=True, slots=True)
class Fault:
    """One error in the value at ``path``."""

    path: Key
    message: str


class Place(Protocol):
    """The file or mapping in which a problem was stated."""

    def locate(self, path: Key) -> tuple[tuple[int, int], str]:
        """A position to sort by, and the text that locates ``path``."""


@dataclass(frozen=True, slots=True)
class FilePlace:
    """A file; a key that it does not contain is located at the innermost section that it contains."""

    name: str
    marks: Mapping[Key, tuple[int, int]]

    def locate(self, path: Key) -> tuple[tuple[int, int], str]:
        """``file.yaml:7:9 walker.leg_mass``."""
        nearest = next(path[:n] for n in range(len(path), -1, -1) if path[:n] in self.marks)
        line, column = self.marks[nearest]
        return (line, column), f"{plain(self.name)}:{line}:{column} {dotted(path)}".rstrip()


@dataclass(frozen=True, slots=True)
class OverridePlace:
    """Overrides by dotted key; a fault of another key is reported under the override that caused it."""

    keys: Mapping[str, Key]
    label: str = ""

    def related(self, path: Key) -> list[str]:
        """The overrides that set ``path`` or a section around it; if there are none, those that set keys below it."""
        around = [key for key, target in self.keys.items() if path[: len(target)] == target]
        return around or [key for key, target in self.keys.items() if target[: len(path)] == path]

    def locate(self, path: Key) -> tuple[tuple[int, int], str]:
        """``walker.leg_mass`` after the label."""
        keys = self.related(path) or list(self.keys)
        if keys in ([], [dotted(path)]):  # nothing is overridden, or this key alone
            return (0, 0) if not keys else (list(self.keys).index(keys[0]), 0), f"{self.label}{dotted(path)}"
        where = f"{self.label}{', '.join(map(plain, keys))}"
        return (list(self.keys).index(keys[0]), 0), f"{where}: {dotted(path)}"


@dataclass(frozen=True, slots=True)
class ChangedPlace:
    """A file or mapping with overrides, the latest ones first; each value is located where it was set last."""

    source: Place
    overrides: tuple[OverridePlace, ...]

    @classmethod
    def of(cls, place: Place, overrides: OverridePlace) -> "ChangedPlace":
        """``place`` with further overrides.

        Earlier overrides of the same keys are dropped, because a branch overrides its parameter at every point.
        """
        source, earlier = (place.source, place.overrides) if isinstance(place, ChangedPlace) else (place, ())
        others = (layer for layer in earlier if not layer.keys.keys() <= overrides.keys.keys())
        return cls(source, (overrides, *others))

    def locate(self, path: Key) -> tuple[tuple[int, int], str]:
        """``walker.leg_mass`` after the label, or its location in the file."""
        return next((layer for layer in self.overrides if layer.related(path)), self.source).locate(path)


def raise_faults(faults: Iterable[Fault], place: Place) -> None:
    """Raise a ProblemError with one line per fault, in the order of their locations, if there are any."""
    lines = fault_lines(faults, place)
    if lines:
        raise ProblemError("\n".join(lines))


def fault_lines(faults: Iterable[Fault], place: Place) -> list[str]:
    """One line per fault, in the order of their locations; control characters of a file are written as escapes."""
    located = sorted((*place.locate(fault.path), fault.message) for fault in faults)
    return list(dict.fromkeys(printable(f"{where}: {message}", keep="") for _, where, message in located))


def read_section(model: type[Model], data: object, path: Key, faults: list[Fault]) -> Model | None:
    """``data`` as a model whose fields are the keys of one mapping; None if faults were added."""
    if not isinstance(data, Mapping):
        faults.append(Fault(path, f"{shown(data)} is not a mapping; keys: {', '.join(model.model_fields)}"))
        return None
    converted = [Fault((*path, *keys), message) for keys, message in _converted_numbers(model, data)]
    try:
        section = model.model_validate(dict(data))
    except ValidationError as error:
        found = _reported(error, model, data, path)
        known = {fault.path for fault in found}
        faults += [*found, *(fault for fault in converted if fault.path not in known)]
        return None
    faults += converted
    return None if converted else section


def read_value(form: TypeAdapter[Value], value: object, path: Key, faults: list[Fault]) -> Value | None:
    """``value`` in one of the forms that the schema declares; None if faults were added."""
    try:
        return form.validate_python(value)
    except ValidationError as error:
        (model,) = nested_models(form._type) or (BaseModel,)
        faults += _reported(error, model, value, path)
        return None


class SectionReader:
    """Base of the readers of a problem's sections, which add all faults to one list.

    Parameters
    ----------
    data : data of the whole problem.
    faults : list to which faults are added.
    """

    def __init__(self, data: Mapping[str, Any], faults: list[Fault]) -> None:
        self._data, self._faults = data, faults

    def _fault(self, path: Key, message: str) -> None:
        self._faults.append(Fault(path, message))

    def _section(self, model: type[Model], data: object, path: Key) -> Model | None:
        return read_section(model, data, path, self._faults)

    def _value(self, form: TypeAdapter[Value], value: object, path: Key) -> Value | None:
        return read_value(form, value, path, self._faults)


def _converted_numbers(model: type[BaseModel], data: Mapping[str, Any]) -> Iterator[tuple[Key, str]]:
    """Keys of texts and truth values that pydantic would convert to numbers, with a message for each.

    Fields of gaitopt's own classes are strict; those of other packages often are not, and Python reads 1_0 as a number.
    """
    for name, field in model.model_fields.items():
        value, notes = data.get(name), field.metadata
        if isinstance(value, str | bool):
            kind: Any = field.annotation
            entries: list[tuple[Key, Any]] = [((name,), value)]
        elif isinstance(value, Mapping):
            kind = (get_args(field.annotation) or (None,))[-1]
            kind, *notes = get_args(kind) if get_origin(kind) is Annotated else (kind,)
            entries = [((name, str(key)), entry) for key, entry in value.items()]
        else:
            continue
        requirement = {float: _REQUIREMENTS["float_type"], int: _REQUIREMENTS["int_type"]}.get(kind)
        if requirement is None or any(hasattr(note, "func") for note in notes):  # a validator reads texts
            continue
        meaning = field.description or ""
        for keys, entry in entries:
            if isinstance(entry, str | bool):
                yield keys, f"{shown(entry)} {requirement}" + (f" ({meaning})" if meaning else "")


def dotted(path: Key) -> str:
    """``gait.phases[1]`` for ("gait", "phases", 1)."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{plain(key)}" for key in path).removeprefix(".")


def plain(text: str) -> str:
    """The text itself; or the text in quotes if it is empty or contains control characters."""
    return text if text and text.isprintable() else repr(text)


def shown(value: object) -> str:
    """``value`` as the user may have written it, shortened and without control characters."""
    if value is None:
        return "nothing (null)"
    text = {True: "true", False: "false"}[value] if isinstance(value, bool) else repr(value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[: LONGEST_SHOWN - 3]}..."


def near_miss(word: object, allowed: Sequence[str]) -> str:
    """``; did you mean mass?`` if an allowed word is close; otherwise the allowed words and a hint."""
    text = str(word)[:LONGEST_SHOWN]
    synonym = SYNONYMS.get(text.lower(), "")
    close = [synonym] if synonym in allowed else difflib.get_close_matches(text, allowed, n=2)
    if close:
        return f"; did you mean {' or '.join(close)}?"
    hints = [hint for pattern, hint in HINTS.items() if isinstance(word, str) and re.search(pattern, text.lower())]
    names = list[str]()
    for stem, group in groupby(
        allowed, lambda name: name.rstrip(digits) if name.rpartition(".")[2].isdigit() else name
    ):
        first, *others = group  # an open-loop motor has many numbered values: the first and the last suffice
        names += [f"{first} to {others[-1].removeprefix(stem)}"] if len(others) > 1 else [first, *others]
    return "; ".join([f"; allowed: {', '.join(names) or 'none'}", *hints[:1]])


def nearest_keys(key: str, known: Sequence[str]) -> str:
    """``; did you mean walker.slope?``: dotted keys with the same last name; else similar ones; else all."""
    tails = [name for name in known if name.rpartition(".")[2] == key.rpartition(".")[2]]
    near = tails or difflib.get_close_matches(key[:LONGEST_SHOWN], known, n=3, cutoff=LOOKS_ALIKE)
    return f"; did you mean {' or '.join(near)}?" if near else f"; use {', '.join(known)}"


def _reported(error: ValidationError, model: type[BaseModel], data: object, path: Key) -> list[Fault]:
    """The errors of pydantic as faults. A list with wrong entries, which pydantic does not count, is not too short."""
    items = error.errors()
    around = {item["loc"][:k] for item in items for k in range(len(item["loc"]))}
    reported = (item for item in items if item["type"] != "too_short" or item["loc"] not in around)
    return [Fault((*path, *item["loc"]), _message(item, model, data)) for item in reported]


def _message(item: ErrorDetails, model: type[BaseModel], data: object) -> str:
    """The message for an error that pydantic reports about ``data``, in the terms of the problem file."""
    kind, value, limits = item["type"], item.get("input"), item.get("ctx", {})
    if kind == "refused":  # the schema states the whole message
        return item["msg"]
    model, field = _innermost(model, item["loc"], data)
    description = "" if field is None else field.description or ""
    meaning = f" {description}" if description.startswith("[") else description and f" ({description})"
    if kind in ("model_type", "model_attributes_type"):
        inner = _models_within(field) if field else [model]
        keys = ", ".join(dict.fromkeys(key for section in inner for key in section.model_fields))
        return f"{shown(value)} is not a mapping; keys: {keys}"
    if kind == "missing":
        return f"is missing{meaning}"
    if kind == "extra_forbidden":
        return f"unknown key{near_miss(item['loc'][-1], tuple(model.model_fields))}"
    if kind in ("enum", "literal_error"):
        choices = re.findall(r"'(.*?)'", str(limits["expected"]))
        return f"{shown(value)} is not one of the choices{near_miss(value, choices)}"
    if kind in ("too_short", "too_long"):
        shortest, longest = _limits(field, "min_length"), _limits(field, "max_length")
        if shortest == longest:  # both may be missing: the annotation of a tuple lists its entries
            exact = shortest[0] if shortest else limits.get("max_length", limits.get("min_length"))
            needed = f"{exact:g}"
        else:
            needed = f"at least {shortest[0]:g}" if kind == "too_short" else f"at most {longest[0]:g}"
        return f"has {counted(limits['actual_length'], 'entry', 'entries')}, must have {needed}{meaning}"
    if kind == "value_error":
        return f"{limits['error']}{'' if isinstance(value, Mapping) else f'; not {shown(value)}'}"
    if isinstance(value, float) and not math.isfinite(value):
        return f"{value} is not a finite number{meaning}"
    if kind in _LIMITS:
        violated = limits[_LIMITS[kind]]
        lower = max(_limits(field, "ge"), default=-LARGEST_SIZE)
        upper = min(_limits(field, "le"), default=LARGEST_SIZE)
        allowed = f"at least {lower:g} and at most {upper:g}"
        if violated == SMALLEST_SIZE:
            allowed = f"greater than 0, and at least {SMALLEST_SIZE:g}"
        elif lower in (-LARGEST_SIZE, SMALLEST_SIZE) or upper == LARGEST_SIZE:  # which keeps products from overflowing
            allowed = f"at {'least' if kind == 'greater_than_equal' else 'most'} {violated:g}"
        without_unit = "[rad]" in description and isinstance(value, int | float) and abs(value) > 1
        remedy = f"; did you mean {value:g} deg?" if without_unit else ""
        return f"{shown(value)} must be {allowed}{meaning}{remedy}"
    return f"{shown(value)} {_REQUIREMENTS.get(kind, item['msg']).format(**limits)}{meaning}"


def _innermost(
    model: type[BaseModel], keys: Sequence[str | int], data: object
) -> tuple[type[BaseModel], FieldInfo | None]:
    """The innermost model to which a key of a path in ``data`` belongs, and the field of that key."""
    field, kinds = None, [model]
    for key in keys:
        if is_free(data) and all(issubclass(kind, Free) for kind in kinds):
            kinds = [Free]
        if kinds and isinstance(key, str):  # an entry of a list belongs to the field of the list
            model = _named_kind(kinds, str(key), data)
            field = model.model_fields.get(str(key))
            kinds = _models_within(field) if field else []
        try:
            data = data[key]  # type: ignore[index]
        except (LookupError, TypeError):  # a key that is missing, or belongs to no mapping
            data = None
    return model, field


def _named_kind(kinds: Sequence[type[BaseModel]], key: str, data: object) -> type[BaseModel]:
    """The kind of a section that the data name, as those of ``{gait: NAME}`` do; otherwise one that has the key."""

    def rank(kind: type[BaseModel]) -> tuple[int, bool]:
        required = {name for name, field in kind.model_fields.items() if field.is_required()}
        return len(required) if isinstance(data, Mapping) and required <= {*data} else 0, key in kind.model_fields

    return max(kinds, key=rank)


def nested_models(field: Any) -> list[type[BaseModel]]:
    """The models among the types that the value of a field may have."""
    annotation: Any = field.annotation if isinstance(field, FieldInfo) else field
    types = get_args(annotation)
    if get_origin(annotation) is Annotated:
        return nested_models(types[0])
    if get_origin(annotation) in (Union, UnionType):
        return [model for each in types for model in nested_models(each)]
    return [annotation] if isinstance(annotation, type) and not types and issubclass(annotation, BaseModel) else []


def _models_within(field: FieldInfo) -> list[type[BaseModel]]:
    """The models among the types of the value of a field, or of the entries of a list."""
    if get_origin(field.annotation) is tuple:
        return [model for each in get_args(field.annotation) for model in nested_models(each)]
    return nested_models(field)


def _limits(field: FieldInfo | None, name: str) -> list[float]:
    """The limits of a field that pydantic stores under ``name``; an entry of a list has no field, and so no limits."""
    metadata = () if field is None else field.metadata
    return [getattr(limit, name) for limit in metadata if getattr(limit, name, None) is not None]


_LIMITS = {"greater_than_equal": "ge", "less_than_equal": "le"}
_REQUIREMENTS: Mapping[str, Any] = {
    "float_type": "is not a number",
    "float_parsing": "is not a number",
    "int_type": "is not an integer",
    "int_parsing": "is not an integer",
    "is_instance_of": "is not a mode",
    "string_type": "is not a text",
    "list_type": "is not a list",
    "tuple_type": "is not a list",
    "dict_type": "is not a mapping",
    "greater_than": "must be greater than {gt:g}",
    "less_than": "must be less than {lt:g}",
    "string_too_short": "must not be empty",
    "string_too_long": "must have at most {max_length} characters",
    "string_pattern_mismatch": "has characters that are not allowed",
}
