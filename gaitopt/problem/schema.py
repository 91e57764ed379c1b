"""JSON Schema of a problem file, so that an editor completes keys and shows units and ranges while one types."""

from typing import Any

from pydantic import BaseModel

from gaitopt.mechanics.ranges import Within
from gaitopt.mechanics.registry import registered_walkers
from gaitopt.mechanics.units import ANGLE_UNITS
from gaitopt.mechanics.walker import Walker
from gaitopt.problem.control_sections import (
    Curve,
    CurveReference,
    GaitReference,
    NoControlSpec,
    PDSpec,
    torques_section,
)
from gaitopt.problem.scalars import DESIGN_SCALARS, SCALARS, Scalar
from gaitopt.problem.section import is_angle
from gaitopt.problem.sections import (
    CycleSection,
    FrictionCoefficients,
    GaitSection,
    GuessSection,
    HeadSection,
    OpenGaitSection,
    state_section,
)

DIALECT = "https://json-schema.org/draft/2020-12/schema"
ANGLE_TEXT = {
    "type": "string",
    "pattern": rf"^\s*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?\s*({'|'.join(ANGLE_UNITS)})\s*$",
}
LIMIT_NAMES = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}
"""Where a validator stands between type and limits, pydantic keeps its own names of the limits."""
NUMBER_OR_ANGLE = {"anyOf": [{"type": "number"}, ANGLE_TEXT]}


def problem_schema() -> dict[str, Any]:
    """JSON Schema of a problem file, with every registered walker and every control law."""
    walkers = registered_walkers()
    head = _section(HeadSection, may_be_free=("friction",))
    head["properties"]["friction"]["anyOf"].append(
        _section(FrictionCoefficients, may_be_free=tuple(FrictionCoefficients.model_fields))
    )
    scalars = "a scalar of the result, state.NAME, or a freed dotted key"
    head["properties"] |= {
        "walker": {
            "description": "the walker and its parameters",
            "oneOf": [_walker(n, w) for n, w in walkers.items()],
        },
        "control": {
            "description": "what the motors do",
            "oneOf": _controls(walkers.values()),
            "default": {"type": "none"},
        },
        "gait": _gait(walkers.values()),
        "objective": {
            "description": f"what is minimised: {scalars}; a negative weight maximises",
            "anyOf": [
                {"type": "string"},
                {"type": "object", "additionalProperties": {"type": "number"}, "minProperties": 1},
            ],
        },
        "constraints": {
            "description": f"values or ranges: {scalars}",
            "type": "object",
            "properties": {name: _constraint(SCALARS[name]) for name in DESIGN_SCALARS},
            "additionalProperties": {"anyOf": [*NUMBER_OR_ANGLE["anyOf"], _range(NUMBER_OR_ANGLE, NUMBER_OR_ANGLE)]},
        },
    }
    head["required"] += ["walker", "gait"]
    head["description"] = "One periodic gait of a walker that may slip. SI units; angles in rad, or with deg."
    return {"$schema": DIALECT, "title": "gaitopt problem", **head}


def _walker(name: str, walker: type[Walker]) -> dict[str, Any]:
    section = _section(walker, may_be_free=tuple(walker.model_fields))
    section["properties"] = {"model": {"const": name}, **section["properties"]}
    section["required"] = ["model", *section.get("required", [])]
    return section


def _controls(walkers: Any) -> list[dict[str, Any]]:
    reference = {"oneOf": [_section(GaitReference), _section(CurveReference)]}
    reference["oneOf"][1]["properties"]["curve"] = _section(Curve)
    gains = _section(PDSpec, may_be_free=("kp", "kd"))
    gains["properties"]["reference"] = reference
    torques = [torques_section(walker) for walker in walkers if walker.actuators]
    laws = [
        _section(NoControlSpec),
        *(_section(model, may_be_free=tuple(model.model_fields)) for model in torques),
        gains,
    ]
    for law in laws:
        law["required"] = sorted({*law.get("required", []), "type"})
    return [law for k, law in enumerate(laws) if law not in laws[:k]]


def _gait(walkers: Any) -> dict[str, Any]:
    guess = _section(GuessSection)
    states = [_section(state_section(walker)) for walker in walkers]
    guess["properties"]["state"] = {"description": "state just after impact", "anyOf": states}
    gaits = [_section(GaitSection), _section(CycleSection), _section(OpenGaitSection)]
    for gait in gaits:
        gait["properties"]["guess"] = guess
    return {"description": "phases and impact of one step, of several steps, or to be found", "oneOf": gaits}


def _section(model: type[BaseModel], may_be_free: tuple[str, ...] = ()) -> dict[str, Any]:
    """The schema of one section, without references to others; angles take units, numbers may be unknowns."""
    schema = _inlined(model.model_json_schema())
    schema.pop("title", None)
    for key, field in model.model_fields.items():
        entry = schema["properties"][key]
        entry.pop("title", None)
        ranges = [str(part) for part in field.metadata if isinstance(part, Within)]
        if ranges:
            entry["description"] = "; ".join([entry.get("description", ""), *ranges])
        number = entry.get("type") == "number" or {"type": "number"} in entry.get("anyOf", [])
        if not number or not (is_angle(field) or key in may_be_free):
            continue
        own = {LIMIT_NAMES[k]: v for k, v in entry.items() if k in LIMIT_NAMES}
        value = {k: v for k, v in entry.items() if k != "description" and k not in LIMIT_NAMES} | own
        if is_angle(field):
            value = {"anyOf": [*value.get("anyOf", [value]), ANGLE_TEXT]}
        choices = [value, _free(value)] if key in may_be_free else [value]
        schema["properties"][key] = {"description": entry.get("description", ""), "anyOf": choices}
    return schema


def _constraint(scalar: Scalar) -> dict[str, Any]:
    """A constrained scalar: what can be checked without the walker is what its sign allows."""
    signed = scalar.within.possible[0] >= 0
    least: dict[str, Any] = {"type": "number", "minimum": 0} if signed else {"type": "number"}
    words = "; ".join(filter(None, (scalar.description, str(scalar.within))))
    return {"description": words, "anyOf": [least, _range({"type": "number"}, least)]}


def _range(least: dict[str, Any], most: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {"min": least, "max": most},
        "minProperties": 1,
        "additionalProperties": False,
    }


def _free(value: dict[str, Any]) -> dict[str, Any]:
    bounds = {"type": "array", "items": value, "minItems": 2, "maxItems": 2, "description": "bounds [lo, hi]"}
    return {
        "description": "an unknown",
        "type": "object",
        "properties": {"free": bounds, "guess": value},
        "required": ["free", "guess"],
        "additionalProperties": False,
    }


def _inlined(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema with its definitions in the place of references to them."""
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
