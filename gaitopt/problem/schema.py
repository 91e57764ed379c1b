"""The sections of a problem file, one pydantic model per mapping: keys, units, ranges and meaning; and its JSON Schema.

The same models validate a file and describe it to an editor, which completes keys and shows units and ranges. Sections
that depend on the walker (its state, its torques) are made from the walker's own names.
"""

from collections.abc import Iterator, Mapping
from enum import StrEnum
from functools import lru_cache
from typing import Annotated, Any, Literal, Self, get_args, get_origin

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WithJsonSchema,
    WrapValidator,
    create_model,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from gaitopt.model.contract import law_section
from gaitopt.model.control import ConstantTorque, NoControl, is_parameter
from gaitopt.model.friction import ImpactLaw
from gaitopt.model.modes import Mode
from gaitopt.model.open_loop import OpenLoop
from gaitopt.model.reference import Without
from gaitopt.model.registry import registered_controls, registered_walkers
from gaitopt.model.units import (
    ANGLE_UNITS,
    DURATION,
    SMALLEST_SIZE,
    Angle,
    Duration,
    Finite,
    Free,
    NonNegative,
    Number,
    Positive,
    Within,
    one_of_two,
    parse_angle,
    symmetric,
)
from gaitopt.model.walker import Walker
from gaitopt.problem.faults import Key, near_miss, nested_models, shown
from gaitopt.problem.scalars import DESIGN_SCALARS, SCALARS


class Section(BaseModel):
    """Base of every section; keys other than its fields are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid")


def is_angle(field: FieldInfo) -> bool:
    """Whether a field takes angles with a unit."""
    return any(isinstance(entry, BeforeValidator) and entry.func is parse_angle for entry in field.metadata)


def section_model(name: str, keys: Mapping[str, Any], *, required: bool = True) -> type[Section]:
    """A section whose keys depend on the walker."""
    default = ... if required else None
    fields: dict[str, Any] = {key: (annotation, default) for key, annotation in keys.items()}
    return create_model(name, __base__=Section, **fields)


MAX_STEPS = 64
"""Largest number of steps of a cycle; a motion with a longer period counts as irregular."""
MAX_PHASES = 64
"""Largest number of phases of one step. Known gaits have up to eleven, and the equations grow with their number."""
FRICTION = Within(usual=(0, 3))
DRAG = Within(unit="drag", possible=(0, 1e4), usual=(0, 100))
RATE = Within(unit="rate", possible=symmetric(100), usual=symmetric(8))
"""The usual range is wide, because a foot turns faster than a leg swings."""
SLIP = Within(unit="speed", possible=symmetric(100), usual=symmetric(5))
POSITION = Within(unit="length", possible=symmetric(1000))
LENGTH = Within(unit="length", possible=symmetric(1000), usual=symmetric(2))


class Aggregate(StrEnum):
    """How the values of an objective over a range of a parameter count: the largest one, their mean, or one of them."""

    WORST = "worst"
    MEAN = "mean"
    AT = "at"


class HeadSection(Section):
    """The keys at the top of a file that are not mappings."""

    name: Annotated[
        str,
        Field(
            pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$",
            max_length=80,
            description="name of the problem, also of its run folder: letters, digits, dot, dash and underscore",
        ),
    ]
    about: Annotated[str, Field(description="sentence that describes the gait")] = ""
    friction: Annotated[NonNegative, Field(le=1000, description="coefficient of friction mu"), FRICTION]
    impact_law: Annotated[
        ImpactLaw, Field(description="tangential law of a slipping impact: Coulomb friction, or no tangential impulse")
    ] = ImpactLaw.COULOMB


class FrictionCoefficients(Section):
    """Friction of a foot that sticks, and of one that slips: |f_t| <= mu_s f_n,  f_t = -s mu_k f_n - c dx."""

    static: Annotated[
        NonNegative, Field(le=1000, description="coefficient mu_s that bounds the force of a sticking foot"), FRICTION
    ]
    kinetic: Annotated[
        NonNegative, Field(le=1000, description="coefficient mu_k of a slipping foot, at most the static one"), FRICTION
    ]
    viscous: Annotated[NonNegative, Field(le=1e6, description="viscous drag c of a slipping foot [N s/m]"), DRAG] = 0.0

    @model_validator(mode="after")
    def _static_is_larger(self) -> Self:
        if self.static < self.kinetic:
            raise ValueError(
                f"static = {self.static:g} is below kinetic = {self.kinetic:g}: "
                "a sticking foot would then start to slip at a smaller force than friction exerts on a slipping one"
            )
        return self


class RobotFile(Section):
    """The name and the content of a robot's file."""

    file: Annotated[str, Field(min_length=1, max_length=200, description="name of the file, for messages")]
    text: Annotated[str, Field(description="content of the file")]


class RobotSection(Section):
    """A robot in a URDF file."""

    urdf: Annotated[RobotFile, Field(description="URDF file of a planar robot, relative to this file")]
    feet: Annotated[
        tuple[str, str], Field(description="links whose origins are the feet; the first one stands in the first step")
    ]


class MarginSection(Section):
    """The margin that ends a cycle where it falls to zero."""

    margin: Annotated[str, Field(description="name of one of the walker's sections")]


EndWord = Literal["touchdown", "clock"]
CycleEnd = Annotated[
    EndWord | MarginSection,
    one_of_two(
        lambda value: isinstance(value, Mapping | MarginSection),
        TypeAdapter[EndWord](EndWord),
        TypeAdapter(MarginSection),
    ),
    Field(
        description="what ends a cycle: the landing of a foot (touchdown), a period of the control law (clock), whose "
        "time then does not restart at landings, or a margin that falls to zero"
    ),
]


class StepSection(Section):
    """The mode sequence of one step."""

    phases: Annotated[tuple[Mode, ...], Field(max_length=MAX_PHASES, description="modes of the phases in order")]
    impact: Annotated[
        Mode, Field(description="mode of the colliding foot or contacts just after the impact that ends the step")
    ]


class GaitSection(StepSection):
    """A gait with a cycle of one step, and a first guess."""

    section: CycleEnd = "touchdown"
    guess: Annotated[dict[str, Any], Field(description="first guess of state and durations")]


class CycleSection(Section):
    """A gait with a cycle of several steps, and a first guess."""

    section: CycleEnd = "touchdown"
    steps: Annotated[
        tuple[StepSection, ...],
        Field(min_length=1, max_length=MAX_STEPS, description="phases and impact of each step in order"),
    ]
    guess: Annotated[dict[str, Any], Field(description="first guess of state and durations of all phases")]


class OpenGaitSection(Section):
    """A gait with an open mode sequence."""

    phases: Annotated[Literal["auto"], Field(description="the search determines the mode sequence")]
    section: CycleEnd = "touchdown"
    impact: Annotated[
        Mode | None, Field(description="mode of the colliding foot or contacts just after the impact; by default any")
    ] = None
    steps: Annotated[int, Field(ge=1, le=MAX_STEPS, strict=True, description="maximum number of steps of a cycle")] = 1
    guess: Annotated[dict[str, Any] | None, Field(description="state near which a gait is preferred")] = None


class GuessSection(Section):
    """State at the start of the cycle, just after an impact, and durations of the phases."""

    state: Annotated[
        dict[str, Any], Field(description="state at the start of the cycle; what is left out follows from the section")
    ]
    durations: Annotated[
        tuple[Duration, ...] | None,
        Field(description="durations of the phases [s]; by default they are found by simulation"),
        DURATION,
    ] = None


class FirstGuessSection(Section):
    """A guess without a state: the distance of the feet or some postures, and the duration of the step."""

    step_length: Annotated[
        Positive | None,
        Field(description="distance of the feet just after the impact [m]"),
        Within(unit="length", possible=(0, 2)),
    ] = None
    duration: Annotated[Duration, Field(description="duration of the step [s]"), DURATION]
    postures: Annotated[
        tuple[dict[str, Angle], ...] | None,
        Field(
            min_length=2,
            max_length=50,
            description="shape coordinates [rad] at equal times, from just after one impact to just before the next",
        ),
    ] = None

    def faults(self, walker: type[Walker]) -> Iterator[tuple[Key, str]]:
        """The keys that are wrong for a walker, or contradict each other, with a message for each."""
        if (self.step_length is None) == (self.postures is None):
            both = "and postures exclude each other: keep one"
            yield ("step_length",), both if self.postures else "is missing; or give postures, or a state"
        if {"several contacts", "flight", "massless feet"} & {*walker.features()}:
            limit = "between two postures the feet of this walker need not stay on the ground"
            yield (), f"{limit}: give a state; or write phases: auto, and leave the guess out"
            return
        for number, posture in enumerate(self.postures or ()):
            for name in posture:
                if name not in walker.shape:
                    reason = f"is not a shape coordinate of {walker.model}{near_miss(name, walker.shape)}"
                    yield ("postures", number, name), reason
            missing = ", ".join(name for name in walker.shape if name not in posture)
            if missing:
                yield ("postures", number), f"lacks {missing}: a posture states every shape coordinate"


class UntilSection(Section):
    """The end of a simulation: the first of these conditions that holds."""

    time: Annotated[Positive | None, Field(le=1e6, description="time since the start [s]")] = None
    steps: Annotated[int | None, Field(strict=True, ge=1, le=1_000_000, description="number of steps")] = None
    events: Annotated[
        int | None, Field(strict=True, ge=1, le=1_000_000, description="number of events: mode changes and impacts")
    ] = None

    @model_validator(mode="after")
    def _has_an_end(self) -> Self:
        if not self.model_fields_set:
            raise ValueError("is empty: give time, steps or events")
        return self


class RangeSection(Section):
    """Bounds of a scalar, in SI."""

    min: Annotated[Number | None, Field(description="lower bound, none if left out")] = None
    max: Annotated[Number | None, Field(description="upper bound, none if left out")] = None

    @model_validator(mode="after")
    def _has_values(self) -> Self:
        if self.min is None and self.max is None:
            raise ValueError("has neither min nor max: give one or both")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"is empty: min = {self.min:g} is above max = {self.max:g}")
        return self


class AngleRangeSection(RangeSection):
    """Bounds of an angle."""

    min: Annotated[Angle | None, Field(description="lower bound [rad], none if left out")] = None
    max: Annotated[Angle | None, Field(description="upper bound [rad], none if left out")] = None


def _refused(value: object, reason: str) -> PydanticCustomError:
    return PydanticCustomError("refused", f"{shown(value)} {reason}")


def _form(reason: str) -> WrapValidator:
    """A validator that gives every value which a type refuses one message."""

    def read(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        try:
            return handler(value)
        except ValidationError:
            raise _refused(value, reason) from None

    return WrapValidator(read)


def _mapping(reason: str, fewest: int = 0) -> BeforeValidator:
    """A validator that gives every value but a mapping with as many entries one message."""

    def read(value: Any) -> Any:
        if not isinstance(value, Mapping) or len(value) < fewest:
            raise _refused(value, reason)
        return value

    return BeforeValidator(read)


def _constraint(section: type[RangeSection], number: Any, units: str) -> TypeAdapter[RangeSection]:
    """The form of a constraint: a range, or a number, which is a range with equal ends."""
    form = _form(f"is not a constraint: a number or {{min: a, max: b}}, {units}")
    equality: TypeAdapter[float] = TypeAdapter(Annotated[number, form])

    def read(value: Any) -> Any:
        return value if isinstance(value, Mapping) else dict.fromkeys(("min", "max"), equality.validate_python(value))

    return TypeAdapter(Annotated[section, BeforeValidator(read)])  # type: ignore[arg-type]


Weight = Annotated[
    Positive | Annotated[Number, Field(le=-SMALLEST_SIZE)],
    _form(f"is not a weight: give a number, negative to maximise, at least {SMALLEST_SIZE:g} in size"),
]
"""Weight of a scalar in an objective."""
WEIGHTS: TypeAdapter[dict[str, float]] = TypeAdapter(
    Annotated[dict[str, Weight], _mapping("is neither a NAME nor a mapping {NAME: weight}", 1)]
)
"""Form of an objective with weights."""
CONSTRAINTS: TypeAdapter[dict[Any, Any]] = TypeAdapter(
    Annotated[dict[Any, Any], _mapping("is not a mapping {NAME: value} or {NAME: {min, max}}")]
)
CONSTRAINT = _constraint(RangeSection, Number, "in SI")
ANGLE_CONSTRAINT = _constraint(AngleRangeSection, Angle, "in SI or with deg")
"""Forms of all constraints, of one, and of one of an angle."""
_LIMITS = _form("is not a range: give two numbers, [lo, hi]")
LIMITS: TypeAdapter[tuple[float, float]] = TypeAdapter(Annotated[tuple[Number, Number], _LIMITS])
ANGLE_LIMITS: TypeAdapter[tuple[float, float]] = TypeAdapter(Annotated[tuple[Angle, Angle], _LIMITS])
"""Forms of the range of a parameter over which a design holds, and of that of an angle."""
VALUE, ANGLE_VALUE = TypeAdapter[float](Number), TypeAdapter[float](Angle)
"""Forms of the value of such a parameter, and of that of an angle."""
SIMULATION_KEYS = ("state", "until")
"""Keys of a file that states no gait and can only be simulated."""
SECTION_KEYS = ("walker", "control", "gait", *SIMULATION_KEYS, "objective", "constraints", "over", "at")
"""Keys of a file besides those of ``HeadSection``."""
OPEN = "auto"
"""Value of ``gait.phases`` that leaves the mode sequence open."""


@lru_cache
def state_section(walker: type[Walker]) -> type[Section]:
    """The section of a state of this walker, with one optional key for each coordinate and rate."""

    def entry(name: str) -> Any:
        if name in {*walker.shape} - {*walker.lengths}:
            largest = walker.largest_angle
            return Annotated[Angle, Field(ge=-largest, le=largest, description="shape coordinate, an angle [rad]")]
        known = {
            "x": ("position of the foot or base point along the ground [m]", POSITION),
            "dx": ("velocity of the foot or base point along the ground [m/s]", SLIP),
        }
        known |= dict.fromkeys((*walker.lengths, "y"), ("length or height [m]", LENGTH))
        known |= dict.fromkeys(
            (*(f"d{length}" for length in walker.lengths), "dy"), ("rate of a length or height [m/s]", SLIP)
        )
        description, within = known.get(name, ("rate of a shape coordinate [rad/s]", RATE))
        return Annotated[Finite, Field(description=description), within]

    return section_model("StateSection", {name: entry(name) for name in walker.state_names()}, required=False)


@lru_cache
def friction_section(contacts: tuple[str, ...]) -> type[Section]:
    """The section of friction of these contacts, with one coefficient for each."""
    number = Annotated[NonNegative, Field(le=1000, description="coefficient of friction mu"), FRICTION]
    return section_model("FrictionSection", dict.fromkeys(contacts, number))


DIALECT = "https://json-schema.org/draft/2020-12/schema"
ANGLE_TEXT = {
    "type": "string",
    "pattern": rf"^\s*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?\s*({'|'.join(ANGLE_UNITS)})\s*$",
}
LIMIT_NAMES = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}
"""JSON Schema's names of limits. If a validator is between type and limits, pydantic writes its own names."""
NUMBER_OR_ANGLE = {"anyOf": [{"type": "number"}, ANGLE_TEXT]}
STATE_OF_ROBOT = {
    "type": "object",
    "description": "of a robot from a file: angles and rates of its links by name [rad, rad/s], and dx [m/s]",
    "additionalProperties": NUMBER_OR_ANGLE,
}


def problem_schema() -> dict[str, Any]:
    """The JSON schema of problem files, with all registered walkers and control laws."""
    walkers = registered_walkers()
    head = _section(HeadSection, may_be_free=("friction",))
    coefficients = _section(FrictionCoefficients, may_be_free=tuple(FrictionCoefficients.model_fields))
    laws = [*head["properties"]["friction"]["anyOf"], coefficients]
    of_contacts = {
        "description": "friction of every named contact",
        "type": "object",
        "additionalProperties": {"anyOf": laws},
        "not": {"anyOf": [{"required": [key]} for key in (*FrictionCoefficients.model_fields, "free")]},
        "minProperties": 1,
    }
    head["properties"]["friction"]["anyOf"] = [*laws, of_contacts]
    head["properties"]["friction"]["description"] += "; a mapping has static and kinetic values, or those of contacts"
    scalars = "scalars of the result, states (state.NAME), durations (phases.K.duration), free parameters (dotted keys)"
    number, constraints = {"type": "number"}, {}
    weights = [{"type": "string"}, {"type": "object", "additionalProperties": number, "minProperties": 1}]
    for name in DESIGN_SCALARS:  # without the walker only the sign of a scalar can be checked
        scalar = SCALARS[name]
        bound: dict[str, Any] = {**number, "minimum": 0} if scalar.within.possible[0] >= 0 else number
        description = "; ".join(filter(None, (scalar.description, str(scalar.within))))
        constraints[name] = {"description": description, "anyOf": [bound, _range(number, bound)]}
    controls, states = _controls(walkers.values()), [_section(state_section(walker)) for walker in walkers.values()]
    of_robot = {law["properties"]["type"]["const"]: _with_any_motor(law) for law in controls if _has_motors(law)}
    head["properties"] |= {
        "walker": {
            "description": "walker and its parameters",
            "oneOf": [*(_walker(n, w) for n, w in walkers.items()), _robot()],
        },
        "control": {
            "description": "control law of the motors",
            "anyOf": [*controls, *of_robot.values()],
            "default": {"type": "none"},
        },
        "gait": _gait([*states, STATE_OF_ROBOT]),
        "state": {
            "description": "of a problem without gait, which can only be simulated: the state from which it starts",
            "anyOf": [*states, STATE_OF_ROBOT],
        },
        "until": {"description": "where a simulation without gait ends", **_section(UntilSection)},
        "objective": {
            "description": f"scalar that is minimised, or weights of several: {scalars}; a negative weight maximises; "
            "a design over a range may minimise the worst value or the mean",
            "anyOf": [
                *weights,
                *(
                    {
                        "type": "object",
                        "properties": {word: {"anyOf": weights, "description": f"scalar or weights; {value} counts"}},
                        "required": [word],
                        "maxProperties": 1,
                    }
                    for word, value in (
                        (Aggregate.WORST.value, "the largest value over the range"),
                        (Aggregate.MEAN.value, "the mean of nine equally spaced values"),
                    )
                ),
            ],
        },
        "over": {
            "description": "range [lo, hi] of one parameter (dotted key) over which a design is a stable gait and "
            "meets its constraints with one control; it contains the problem's own value, where the phases hold",
            "type": "object",
            "additionalProperties": {"type": "array", "items": NUMBER_OR_ANGLE, "minItems": 2, "maxItems": 2},
            "minProperties": 1,
            "maxProperties": 1,
        },
        "at": {
            "description": "value of the parameter in over at which a plain objective counts, by default its own",
            "type": "object",
            "additionalProperties": NUMBER_OR_ANGLE,
            "minProperties": 1,
            "maxProperties": 1,
        },
        "constraints": {
            "description": f"values or ranges of {scalars}",
            "type": "object",
            "properties": constraints,
            "additionalProperties": {"anyOf": [*NUMBER_OR_ANGLE["anyOf"], _range(NUMBER_OR_ANGLE, NUMBER_OR_ANGLE)]},
        },
    }
    stated = {"properties": {"guess": {"properties": {"state": {"anyOf": states}}}}}
    head[
        "anyOf"
    ] = [  # the links and motors of a robot from a file may have any names, those of other walkers are known
        {"properties": {"walker": {"required": ["urdf"]}}},
        {"properties": {"control": {"anyOf": controls}, "gait": stated}},
    ]
    head["required"] += ["walker"]
    head["description"] = "One periodic gait of a walker that may slip. SI units; angles in rad, or with deg."
    return {"$schema": DIALECT, "title": "gaitopt problem", **head}


def _walker(name: str, walker: type[Walker]) -> dict[str, Any]:
    section = _section(walker, may_be_free=tuple(walker.model_fields))
    section["properties"] = {"model": {"const": name, "description": "selects this walker"}, **section["properties"]}
    section["required"] = ["model", *section.get("required", [])]
    return section


def _robot() -> dict[str, Any]:
    from gaitopt.model.urdf import UrdfWalker  # most problems have no robot from a file

    section = _section(UrdfWalker, may_be_free=tuple(UrdfWalker.model_fields))
    robot = _section(RobotSection)["properties"]
    robot["urdf"] = {"description": robot["urdf"]["description"], "type": "string"}
    names = {"type": "array", "items": {"type": "string"}, "minItems": 2, "maxItems": 2}
    robot["feet"] = {"description": robot["feet"]["description"], **names}
    section["description"] = RobotSection.__doc__
    section["properties"] = {**robot, **section["properties"]}
    section["required"] = [*RobotSection.model_fields, *section.get("required", [])]
    return section


def _controls(walkers: Any) -> list[dict[str, Any]]:
    laws = list[dict[str, Any]]()
    for name, law in registered_controls().items():
        sections: dict[type[BaseModel], None] = dict.fromkeys(
            law_section(law, walker) for walker in walkers if walker.actuators or law is NoControl
        )
        for section in sections:
            numbers = tuple(key for key in section.model_fields if is_parameter(section, key))
            stated = _section(section, may_be_free=numbers)
            description = (law.__doc__ or "").strip().partition("\n")[0].rstrip(".")
            stated["properties"] = {"type": {"const": name, "description": description}, **stated["properties"]}
            stated["required"] = sorted({*stated.get("required", []), "type"})
            kind, required = stated["properties"]["type"], stated["required"]
            same = (one for one in laws if one["properties"]["type"] == kind and one["required"] == required)
            alike = next(same, None)
            if alike is None:
                laws.append(stated)
            else:  # the same law with the keys of another walker's motors: a file must match exactly one entry
                alike["properties"] |= stated["properties"]
    return laws


def _has_motors(law: Mapping[str, Any]) -> bool:
    """Whether the entry of a law has one key for each motor."""
    return law["properties"]["type"]["const"] in (ConstantTorque.type, OpenLoop.type)


def _with_any_motor(law: Mapping[str, Any]) -> dict[str, Any]:
    """The entry of a law that ``_has_motors``, changed so that the motors may have any names."""
    section = ConstantTorque if law["properties"]["type"]["const"] == ConstantTorque.type else OpenLoop
    own = {key: value for key, value in law["properties"].items() if key in ("type", *section.model_fields)}
    motors = [value for key, value in law["properties"].items() if key not in own]
    required = [key for key in law["required"] if key in own]
    return {**law, "properties": own, "required": required, "additionalProperties": motors[0]}


def _gait(states: list[dict[str, Any]]) -> dict[str, Any]:
    guess, first = _section(GuessSection), _section(FirstGuessSection)
    guess["properties"]["state"] = {
        "description": "state at the start of the cycle; what is left out follows from the section",
        "anyOf": states,
    }
    gaits = [_section(GaitSection), _section(CycleSection), _section(OpenGaitSection)]
    for gait in gaits:
        steps = gait["properties"].get("steps", {}).get("items", gait)
        if "impact" in steps.get("required", ()) and "section" in gait["properties"]:
            steps["required"] = [key for key in steps["required"] if key != "impact"]  # only a landing needs it
            needed: dict[str, Any] = {"required": ["impact"]}
            if steps is not gait:
                needed = {"properties": {"steps": {"items": needed}}}
            choices: list[dict[str, Any]] = [needed, {"required": ["section"]}]
            gait["anyOf"] = choices
        gait["properties"]["guess"] = {"description": guess["description"], "oneOf": [guess, first]}
    return {
        "description": "phases and impact of one step or of several steps, or an open mode sequence",
        "oneOf": gaits,
    }


def _section(model: type[BaseModel], may_be_free: tuple[str, ...] = ()) -> dict[str, Any]:
    """The schema of one section, in which nested sections are written out, and angles may have a unit.

    The numbers whose keys are in ``may_be_free`` may be unknowns.
    """
    schema = _inlined(model.model_json_schema())
    schema.pop("title", None)
    for key, entry_field in model.model_fields.items():
        entry = schema["properties"][key]
        entry.pop("title", None)
        ranges = dict.fromkeys(str(within) for within in entry_field.metadata if isinstance(within, Within))
        if ranges:
            entry["description"] = "; ".join([entry.get("description", ""), *ranges])
        stated = any(isinstance(note, WithJsonSchema) for note in entry_field.metadata)
        stated = stated or any(get_origin(choice) is Literal for choice in get_args(entry_field.annotation))
        if (nested := nested_models(entry_field)) and not stated:
            sections = [_section(choice) for choice in nested]
            omitted = [key for note in entry_field.metadata if isinstance(note, Without) for key in note.keys]
            for section in sections:
                section["properties"] = {k: v for k, v in section["properties"].items() if k not in omitted}
            described = {"description": entry["description"]} if "description" in entry else {}
            alone = len(sections) == 1 and not described  # a section describes itself, but not its key
            schema["properties"][key] = sections[0] if alone else {**described, "oneOf": sections}
            continue
        value_types = get_args(entry_field.annotation)
        if "additionalProperties" in entry and is_angle(FieldInfo.from_annotation(value_types[-1])):
            entry["additionalProperties"] = {"anyOf": [entry["additionalProperties"], ANGLE_TEXT]}
        if key in may_be_free and isinstance(entry.get("additionalProperties"), dict):
            value = entry["additionalProperties"]
            entry["additionalProperties"] = {"anyOf": [*value.get("anyOf", [value]), _free(value)]}
        number = entry.get("type") == "number" or {"type": "number"} in entry.get("anyOf", [])
        if not number or not (is_angle(entry_field) or key in may_be_free):
            continue
        own = {LIMIT_NAMES[k]: v for k, v in entry.items() if k in LIMIT_NAMES}
        value = {k: v for k, v in entry.items() if k != "description" and k not in LIMIT_NAMES} | own
        if is_angle(entry_field):
            value = {"anyOf": [*value.get("anyOf", [value]), ANGLE_TEXT]}
        choices = [value, _free(value)] if key in may_be_free else [value]
        kept = {name: entry[name] for name in ("default",) if name in entry}
        schema["properties"][key] = {"description": entry.get("description", ""), "anyOf": choices, **kept}
    return schema


def _range(minimum: dict[str, Any], maximum: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {"min": minimum, "max": maximum},
        "minProperties": 1,
        "additionalProperties": False,
    }


def _free(value: dict[str, Any]) -> dict[str, Any]:
    bounds = {"type": "array", "items": value, "minItems": 2, "maxItems": 2}
    return {
        "description": "an unknown",
        "type": "object",
        "properties": {
            "free": {"description": Free.model_fields["free"].description, **bounds},
            "guess": value,
        },
        "required": ["free", "guess"],
        "additionalProperties": False,
    }


def _inlined(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema after every reference is replaced by the definition to which it refers."""
    definitions = schema.pop("$defs", {})

    def inline(node: Any) -> Any:
        if isinstance(node, list):
            return [inline(item) for item in node]
        if not isinstance(node, dict):
            return node
        if "$ref" in node:
            target = definitions[node["$ref"].removeprefix("#/$defs/")]
            rest = {key: value for key, value in node.items() if key != "$ref"}
            return {**inline(target), **rest}
        return {key: inline(value) for key, value in node.items()}

    return dict(inline(schema))
