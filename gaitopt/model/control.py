"""Control laws: joint torques u(t, q, dq, s, p), where t is the time since the last impact.

A law is a frozen pydantic model with the content of the section ``control`` of a problem file. Its numbers are
parameters, entries of the vector p of the system: they can be set, freed, swept and continued. Everything else is
structure.

A law is smooth between its breakpoints, which are fixed times since the impact. On each segment between two breakpoints
it reads ``segment data`` r, so that one compiled function serves all segments.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Annotated, Any, ClassVar, TypeAlias, get_args, get_origin

import numpy as np
from casadi import SX, vertcat
from pydantic import BaseModel, ConfigDict, Field, create_model

from gaitopt.arrays import Array
from gaitopt.model.declaration import actuator_units
from gaitopt.model.instant import Instant
from gaitopt.model.reference import Path, Reference
from gaitopt.model.step_feedback import StepFeedback
from gaitopt.model.units import MOTOR_WORDS, Finite, Positive, Within, symmetric, words_and_unit
from gaitopt.model.walker import PluginClass, WalkerType

OWN_PACKAGE = "gaitopt."
SectionType: TypeAlias = type[BaseModel]
TORQUE = Within(unit="torque", possible=symmetric(1000), usual=symmetric(10))
OF_MOTOR = {"N m": TORQUE, "N": replace(TORQUE, unit="force")}
"""Range of a motor's torque or force, by its unit."""


class Fixed:
    """Annotation of a number that is structure rather than a parameter: ``Annotated[Positive, gaitopt.Fixed]``.

    A number on which ``breakpoints``, ``horizon``, ``period`` or ``data`` depend has to be fixed. It keeps its value:
    it cannot be freed, continued or swept, and ``now.p`` has it as a number rather than a symbol.
    """


class Control(BaseModel, ABC, metaclass=PluginClass):
    """Base class of control laws: declare the parameters as fields, and define ``torques``.

    A field of type float is a parameter, and so is every entry of a mapping from names to floats: it can be set, freed,
    swept and continued by its key, ``control.kp`` or ``control.gains.hip``. All other fields are structure, and so are
    floats annotated with ``Fixed``; their change requires new expressions. ``section`` and ``faults`` restrict the keys
    for a walker.

    In the body of a subclass ``type`` is the law's name: write ``WalkerType`` there instead of ``type[Walker]``.

    Class attributes
    ----------------
    type : the name used in problem files.
    version : a text that is part of the digest of a problem if the law is from another package; change it whenever the
        equations change.
    jumps : whether the torques may jump at breakpoints; otherwise they must be continuous there.
    restarts : whether the law's clock restarts at every impact; if not, the law has a ``period``, with which a cycle
        ends, ``gait: {section: clock}``.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)

    type: ClassVar[str]
    version: ClassVar[str] = "1"
    jumps: ClassVar[bool] = False
    restarts: ClassVar[bool] = True

    @abstractmethod
    def torques(self, now: Instant) -> Mapping[str, Any]:
        """Torques by actuator name [N m]; a motor that is left out is off.

        Parameters
        ----------
        now : time, coordinates, phase variables and parameters in CasADi symbols.
        """

    @property
    def phase_variable(self) -> str:
        """The phase variable that has to be monotone along each step; empty if the law has none."""
        return ""

    def quantities(self, now: Instant) -> Mapping[str, SX]:
        """Further expressions of the law by name, which can be evaluated along a gait; none by default."""
        return {}

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times since impact at which a segment ends and the next begins [s]."""
        return ()

    @property
    def horizon(self) -> float:
        """Time since impact up to which the law is defined [s]."""
        return np.inf

    @property
    def period(self) -> float | None:
        """Period of a clock of the law's own [s]; None if there is none."""
        return None

    @property
    def exchanged(self) -> Mapping[str, str]:
        """Pairs of keys of parameters that take each other's values after every step; none by default."""
        return {}

    def data(self, segment: int) -> Array:
        """Segment data r, of the same length in all segments."""
        return np.zeros(0)

    def faults(self, walker: WalkerType) -> Iterator[tuple[Path, str]]:
        """Mistakes in the law for a walker: keys below ``control``, with a message for each."""
        yield from unknown_actuators(walker, limits=self.limits)
        for name, reference in self.targets.items():
            yield from (((name, *path), message) for path, message in reference.faults(walker))
        if self.step_feedback is not None:
            faults = self.step_feedback.faults(self.parameters)
            yield from ((("step_feedback", *path), message) for path, message in faults)
            if {*self.unknowns(walker)} - {*self.step_feedback.free}:
                yield ("step_feedback",), "corrects a law whose numbers are known, but some are unknowns of a design"

    @classmethod
    def section(cls, walker: WalkerType) -> SectionType:
        """The keys that a problem file may give for a walker; by default those of the class."""
        return cls

    @property
    def targets(self) -> dict[str, Reference]:
        """References among the fields, by name."""
        return {name: value for name, value in self if isinstance(value, Reference)}

    @property
    def parameters(self) -> dict[str, float]:
        """Values of the scalars that can be set, freed or continued, by their key below ``control``."""
        values = dict[str, float]()
        for name, value in sorted(self, key=lambda item: item[0] == "limits"):
            if isinstance(value, Reference):
                values |= {f"{name}.{key}": number for key, number in value.parameters.items()}
            elif is_parameter(type(self), name):
                values |= {f"{name}.{k}": v for k, v in value.items()} if isinstance(value, Mapping) else {name: value}
        return values

    @property
    def feedback_parameters(self) -> dict[str, float]:
        """Values of the gains of ``step_feedback`` and of its nominal state, by their key below ``control``."""
        return {} if self.step_feedback is None else self.step_feedback.parameters

    def unit(self, key: str) -> str:
        """Unit of a parameter by its key below ``control``, for motors that act on angles; from its description."""
        described = type(self).model_fields.get(key.partition(".")[0])
        return "" if described is None else words_and_unit(described.description or "")[1].partition(", or ")[0]

    @property
    def structure(self) -> tuple[object, ...]:
        """Key of the systems that can share the law's expressions: the law without the values of its parameters."""
        numbers = {name for name in dict(self) if is_parameter(type(self), name)}
        references = self.targets
        excluded: Any = {**dict.fromkeys(numbers | {*references}, True), "step_feedback": {"at": True}}
        fixed = self.model_dump_json(exclude=excluded)
        return (type(self), tuple(self.parameters), fixed, *(each.structure for each in references.values()))

    @property
    def untimed(self) -> "Control":
        """The law that stands for all laws with the same expressions and any breakpoints; by default this one."""
        return self

    @property
    def source(self) -> tuple[str, Path]:
        """Name or path of the problem whose gait the law needs, and the path of its key; empty if there is none."""
        for name, reference in self.targets.items():
            source, path = reference.source
            if source:
                return source, ("control", name, *path)
        return "", ()

    @property
    def record(self) -> dict[str, Any]:
        """JSON data from which the same law is read: its type, the version of another package's law, and its keys."""
        law = type(self)
        version = {} if law.__module__.startswith(OWN_PACKAGE) else {"version": law.version}
        keys = self.model_dump(mode="json", exclude_none=True, exclude=None if self.limits else {"limits"})
        return {"type": law.type, **version, **keys}

    def unknowns(self, walker: WalkerType) -> dict[str, tuple[float, float]]:
        """Bounds of the parameters that a design determines rather than the problem file."""
        references = self.targets.items()
        spans = {f"{name}.{key}": span for name, each in references for key, span in each.unknowns(walker).items()}
        gains = {} if self.step_feedback is None else self.step_feedback.free
        return spans | {key: free.free for key, free in gains.items()}

    def guesses(self, values: Mapping[str, float], walker: WalkerType) -> dict[str, object]:
        """Dotted keys and values of a problem whose guess of the law's unknowns are the known parameters ``values``."""
        changes = dict[str, object]()
        for name, reference in self.targets.items():
            above = f"control.{name}."
            known = {key.removeprefix(above): value for key, value in values.items() if key.startswith(above)}
            changes |= {f"{above}{key}": value for key, value in reference.guesses(known, walker).items()}
        if self.step_feedback is not None:
            for key, free in self.step_feedback.free.items():
                if (full := f"control.{key}") in values:
                    changes[full] = free.near(values[full]).record
        return changes

    limits: Annotated[
        dict[str, Positive],
        Field(description="largest torque or force L of each motor [N m, or N]; it applies L tanh(u / L) instead of u"),
        Within(unit="torque", possible=(0, 1000)),
    ] = {}
    step_feedback: Annotated[
        StepFeedback | None,
        Field(description="feedback from step to step: parameters of the law are corrected once per cycle"),
    ] = None


def unknown_actuators(walker: WalkerType, **stated: Iterable[str]) -> Iterator[tuple[Path, str]]:
    """Faults: names below the keys of a law that are not actuators of a walker."""
    known = ", ".join(walker.actuators) or "none"
    for key, names in stated.items():
        unknown = (name for name in names if name not in walker.actuators)
        yield from (((key, name), f"no actuator is called {name}; there are {known}") for name in unknown)


@lru_cache(maxsize=1024)
def is_parameter(section: SectionType, name: str) -> bool:
    """Whether an entry of a section has parameters: an extra key, a float, or a mapping from names to floats."""
    info = section.model_fields.get(name)
    if info is None:
        return True
    if Fixed in info.metadata:
        return False
    origin = get_origin(info.annotation)
    is_mapping = isinstance(origin, type) and issubclass(origin, Mapping)
    value = get_args(info.annotation)[-1] if is_mapping else info.annotation
    return value is float or (get_origin(value) is Annotated and get_args(value)[0] is float)


def parameter_names(law: Control, symbols: SX) -> SimpleNamespace:
    """Symbols of a law's parameters as nested namespaces; a level whose keys are numbers is a column.

    The other fields, which are structure, have their values.

    Parameters
    ----------
    symbols : SX - symbols in the order of ``law.parameters``.
    """

    def nested(entries: Mapping[str, Any]) -> Any:
        if entries and all(key.isdigit() for key in entries):
            return vertcat(*entries.values())
        return SimpleNamespace(**{key: nested(v) if isinstance(v, Mapping) else v for key, v in entries.items()})

    tree: dict[str, Any] = {
        name: {}
        for name, value in law
        if isinstance(value, Reference) or (isinstance(value, Mapping) and is_parameter(type(law), name))
    }
    for k, key in enumerate(law.parameters):
        level, (*above, last) = tree, key.split(".")
        for name in above:
            level = level.setdefault(name, {})
        level[last] = symbols[k]
    known = {name: nested(v) if isinstance(v, Mapping) else v for name, v in tree.items()}
    return SimpleNamespace(**{name: value for name, value in law if name not in known}, **known)


@lru_cache(maxsize=64)
def _torques(walker: WalkerType) -> SectionType:
    """The keys of constant torques for a walker."""
    limits = Control.model_fields["limits"]
    fields: dict[str, Any] = {
        name: (
            Annotated[
                Finite,
                Field(description=f"{MOTOR_WORDS[unit]} of the {name.replace('_', ' ')} [{unit}]"),
                OF_MOTOR[unit],
            ],
            ...,
        )
        for name, unit in actuator_units(walker).items()
    }
    fields["limits"] = (limits.annotation, limits)
    feedback = Control.model_fields["step_feedback"]
    fields["step_feedback"] = (feedback.annotation, feedback)
    config = ConfigDict(frozen=True, extra="forbid")
    return create_model("Torques", __config__=config, __doc__=ConstantTorque.__doc__, **fields)


class _NoKeys(BaseModel):
    """No torques: a passive walker."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class NoControl(Control):
    """No torques: a passive walker."""

    type = "none"

    @classmethod
    def section(cls, walker: WalkerType) -> SectionType:
        """The section of a law without keys."""
        return _NoKeys

    def torques(self, now: Instant) -> Mapping[str, SX]:
        """No torques, because no motor acts."""
        return {}


class ConstantTorque(Control):
    """Constant torques by the walker's actuator names [N m]."""

    model_config = ConfigDict(frozen=True, extra="allow", validate_default=True)
    __pydantic_extra__: dict[str, Finite]

    type = "constant_torque"

    @classmethod
    def section(cls, walker: WalkerType) -> SectionType:
        """The section with one key per actuator."""
        return _torques(walker)

    def torques(self, now: Instant) -> Mapping[str, SX]:
        """The torques, which are the parameters of the law."""
        return {name: value for name, value in vars(now.p).items() if name not in Control.model_fields}
