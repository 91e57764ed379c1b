"""Types of the records of gaits, walks, branches and searches, and the identities that their numbers satisfy.

    period = sum of the durations        step_length = speed period        radius = max |multiplier|

Every record that is read from a file is checked here. A number that is possible but wrong passes unless an identity
relates it to others; `gaitopt verify` detects it.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NotRequired

from annotated_types import Ge, Gt, Len
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    TypeAdapter,
    ValidationInfo,
    with_config,
)
from pydantic_core import PydanticCustomError
from typing_extensions import TypedDict

from gaitopt.gait.gait import Status
from gaitopt.model.cycle import Cycle
from gaitopt.model.modes import Mode
from gaitopt.problem.scalars import SCALARS

LARGEST, MOST, MOST_STEPS, MOST_MULTIPLIERS = 1e30, 1_000_000_000, 64, 100
"""Limits of a number, a count, the steps of a cycle and the multipliers; far beyond any walker."""
LONGEST_LIST, LONGEST_TEXT = 100_000, 100_000
SAME = 1e-9
"""Relative difference of two numbers that are equal up to rounding."""
CONTROL_CHARACTERS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
"""Not allowed in any text of a record; a terminal would obey them."""
STATES = "states"
"""Key of a validation's context: the names that every state must have."""


def _plain(text: str) -> str:
    if CONTROL_CHARACTERS.search(text):
        raise PydanticCustomError("text", "Control characters in a text")
    return text


def _mode(text: str) -> str:
    Mode(text)
    return text


def _limited(value: Any) -> Any:
    """Refuse huge integers early, as the message of pydantic would print all their digits."""
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > LARGEST:
        raise PydanticCustomError("large", "A number beyond {largest}", {"largest": LARGEST})
    return value


Number = Annotated[float, BeforeValidator(_limited), Field(strict=True, ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Positive = Annotated[Number, Gt(0)]
NotNegative = Annotated[Number, Ge(0)]
Count = Annotated[int, BeforeValidator(_limited), Field(strict=True, ge=0, le=MOST)]
Flag = Annotated[bool, Field(strict=True)]
Text = Annotated[str, Field(strict=True, max_length=LONGEST_TEXT), AfterValidator(_plain)]
Word = Annotated[str, Field(strict=True, max_length=200, pattern=r"^[\w .:,+=-]+$")]
"""A name, safe to print and to draw."""
ModeText = Annotated[str, Field(strict=True, max_length=200), AfterValidator(_mode)]
Numbers = Annotated[list[Number], Len(max_length=LONGEST_LIST)]


def _named(state: dict[str, float], info: ValidationInfo) -> dict[str, float]:
    names = (info.context or {}).get(STATES)
    if names is not None and {*state} != {*names}:
        raise PydanticCustomError("names", "Must have the states {names}", {"names": ", ".join(names)})
    return state


State = Annotated[dict[Word, Number], AfterValidator(_named)]


@with_config(ConfigDict(extra="allow"))
class _Phase(TypedDict):
    mode: ModeText
    duration: Positive


@with_config(ConfigDict(extra="allow"))
class _Untimed(TypedDict):
    mode: ModeText
    duration: None


def _of_mode(phase: Mapping[str, Any]) -> Mapping[str, Any]:
    if not all(isinstance(value, str) for key, value in phase.items() if key != "duration"):
        raise PydanticCustomError("stops", "Stops and switches must have a state in words")
    Mode.from_record(phase)
    return phase


Phases = Annotated[list[Annotated[_Phase, AfterValidator(_of_mode)]], Len(1, 1000)]


class _Step(TypedDict):
    phases: Phases
    impact: ModeText
    period: Positive
    step_length: Number
    state: State


class _Multiplier(TypedDict):
    re: Number
    im: Number


class _Claim(TypedDict):
    name: Word
    figure: Number | None
    tolerance: Number
    passed: Flag
    note: Text


class _Verification(TypedDict):
    passed: Flag
    claims: Annotated[list[_Claim], Len(1, 1000)]
    period_error: Number | None
    state_error: Number | None
    multiplier_error: Number | None
    mode_sequence_matches: Flag


def _passed(record: Mapping[str, Any]) -> Mapping[str, Any]:
    if record["passed"] != all(claim["passed"] for claim in record["claims"]):
        raise PydanticCustomError("passed", "Must be true where all claims have passed, and only there")
    for claim in record["claims"]:
        if claim["passed"] and (claim["figure"] is None or claim["figure"] > claim["tolerance"]):
            raise PydanticCustomError("claim", "A claim has passed with a figure beyond its tolerance")
    figures = {claim["name"]: claim["figure"] for claim in record["claims"]}
    for name in ("period", "state", "multiplier"):
        if record[f"{name}_error"] != figures.get("multipliers" if name == "multiplier" else name):
            raise PydanticCustomError("error", "{name}_error is not the figure of its claim", {"name": name})
    sequence = [claim["passed"] for claim in record["claims"] if claim["name"] == "mode sequence"]
    if sequence != [record["mode_sequence_matches"]]:
        raise PydanticCustomError("sequence", "mode_sequence_matches is not what its claim says")
    return record


Verification = Annotated[_Verification, AfterValidator(_passed)]


class _Measures(TypedDict):
    """Scalars of a gait."""

    period: Positive
    step_length: Number
    speed: Number
    work: Number
    damping_loss: NotRequired[NotNegative]  # not in records from before there were dampers
    cost_of_transport: Number | None
    absolute_cost_of_transport: NotNegative | None
    torque_squared: NotNegative
    peak_torque: NotNegative
    slip_distance: NotNegative
    foot_clearance: Number | None
    required_friction: NotNegative | None
    impulse_ratio: NotNegative | None
    min_normal_force: Number | None


class _Gait(_Measures):
    problem: NotRequired[Word]
    status: Literal[Status.CONVERGED, "converged"]
    message: Text
    friction: Number | dict[Word, Number]
    n_steps: Annotated[Count, Ge(1), Field(le=MOST_STEPS)]
    impact: ModeText
    phases: Phases
    state: State
    steps: NotRequired[Annotated[list[_Step], Len(1, MOST_STEPS)]]
    multipliers: Annotated[list[_Multiplier], Len(max_length=MOST_MULTIPLIERS)]
    spectral_radius: NotNegative
    parameters: dict[Word, Number]
    solver: dict[Word, Number | Flag | Text | None]
    verification: Verification | None


class _Special(_Gait):
    """A gait at a special point, where it may have no multipliers."""

    spectral_radius: NotNegative | None  # type: ignore[misc]  # wider than that of a gait


def _consistent(record: Mapping[str, Any]) -> Mapping[str, Any]:
    """Check the identities between the numbers of a gait."""

    def agree(key: str, value: float, words: str, size: float = 0.0) -> None:
        if not math.isclose(record[key], value, rel_tol=SAME, abs_tol=SAME * size):
            context = {"key": key, "stated": f"{record[key]:.12g}", "value": f"{value:.12g}", "words": words}
            raise PydanticCustomError("identity", "{key} is {stated}, but {words} is {value}", context)

    cycle = Cycle.from_record(record)
    steps: Sequence[Mapping[str, Any]] = record.get("steps", (record,))
    if record["n_steps"] != len(cycle.steps) or steps[-1]["impact"] != record["impact"]:
        raise PydanticCustomError("steps", "Its steps do not have the number or the impact that it states")
    agree("period", sum(phase["duration"] for phase in record["phases"]), "the sum of the durations")
    agree("step_length", record["speed"] * record["period"], "speed times period", 1.0)
    for step in steps if "steps" in record else ():
        if not math.isclose(step["period"], sum(phase["duration"] for phase in step["phases"]), rel_tol=SAME):
            raise PydanticCustomError("identity", "The period of a step is not the sum of its durations")
    moduli = [math.hypot(m["re"], m["im"]) for m in record["multipliers"]]
    if (record["spectral_radius"] is None) != (not moduli):
        raise PydanticCustomError("radius", "A spectral_radius without multipliers, or multipliers without one")
    if moduli:
        agree("spectral_radius", max(moduli), "the largest modulus of the multipliers", 1e-6)
    return record


GaitRecord = Annotated[_Gait, AfterValidator(_consistent)]


class _Point(_Gait):
    record: Literal["point"]
    branch: Count
    index: Count
    value: Number
    tangent: Numbers
    length: Number
    intervals: NotRequired[list[Count]]


PointRecord = Annotated[_Point, AfterValidator(_consistent)]


@with_config(ConfigDict(extra="allow"))
class _Side(TypedDict):
    """One side of a change of modes."""


def _cycle(side: Mapping[str, Any]) -> Mapping[str, Any]:
    try:
        Cycle.from_record(side)
    except (AttributeError, KeyError, TypeError) as error:
        raise PydanticCustomError("cycle", "No mode sequence") from error
    return side


@with_config(ConfigDict(extra="forbid"))
class _Empty(TypedDict):
    """In place of a gait that does not exist."""


SpecialRecord = TypedDict(
    "SpecialRecord",
    {
        "record": Literal["special"],
        "branch": Count,
        "type": Word,
        "value": Number,
        "status": Literal["converged", "guess"],
        "reason": Text,
        "next": Annotated[list[Count], Len(max_length=1000)],
        "bound": NotRequired[Flag],
        "from": NotRequired[Annotated[_Side, AfterValidator(_cycle)]],
        "to": NotRequired[Annotated[_Side, AfterValidator(_cycle)]],
        "tangent": NotRequired[Numbers | None],
        "gait": _Empty | Annotated[_Special, AfterValidator(_consistent)],
    },
)


class ContinuationRecord(TypedDict):
    """The first line of a branch."""

    record: Literal["continuation"]
    parameter: Word
    to: Annotated[list[Number], Len(1, 1000)]
    lower: NotRequired[Number | None]
    upper: NotRequired[Number | None]
    start: NotRequired[Word]


class _SectionPoint(TypedDict):
    time: NotNegative
    impact: ModeText | None
    state: State


class _Axis(TypedDict):
    key: Word
    lower: Number
    upper: Number
    count: Annotated[Count, Ge(1)]
    unit: NotRequired[Literal["", "deg"]]


Axes = Annotated[list[_Axis], Len(1, 20)]


class SweepRecord(TypedDict):
    """A sweep: its grid. Its counts follow from its table."""

    over: Axes


class BasinRecord(TypedDict):
    """A basin: its grid and the fixed coordinates. The rest follows from its tiles."""

    over: Axes
    base: dict[Word, Number]


class WalkRecord(TypedDict):
    """A simulated walk; the scalars of its last step follow from its table."""

    problem: Word
    status: Word
    message: Text
    steps: Count
    section: Annotated[list[_SectionPoint], Len(1)]
    gait_states: list[State]
    parameters: dict[Word, Number]


@with_config(ConfigDict(extra="allow"))
class _Attempt(TypedDict):
    status: Literal["not_converged", "infeasible", "set_aside"]
    message: Text
    start: NotRequired[Word]
    phases: NotRequired[list[Annotated[_Untimed, AfterValidator(_of_mode)]]]
    impact: NotRequired[ModeText | None]
    parameters: NotRequired[dict[Word, Number | None]]
    verification: NotRequired[None]


def _without_scalars(record: Mapping[str, Any]) -> Mapping[str, Any]:
    stated = next((name for name in SCALARS if record.get(name) is not None), None)
    if stated is not None or (record.get("phases") and record.get("impact") is None):
        raise PydanticCustomError(
            "attempt", "A failed attempt with {key}", {"key": stated or "phases without an impact"}
        )
    return record


class _JobGait(_Gait):
    job: NotRequired[Word]
    start: NotRequired[Word]


def _outcome(record: Any) -> str:
    return "gait" if isinstance(record, Mapping) and record.get("status") == Status.CONVERGED else "attempt"


Solved = Annotated[
    Annotated[_JobGait, AfterValidator(_consistent), Tag("gait")]
    | Annotated[_Attempt, AfterValidator(_without_scalars), Tag("attempt")],
    Discriminator(_outcome),
]
"""A gait, or a failed attempt; in files of jobs and of fronts."""


def _keyed(record: Any) -> Any:
    if not isinstance(record, Mapping) or not isinstance(record.get("job"), str):
        raise PydanticCustomError("job", "A line needs the key of its job")
    return record


JobRecord = Annotated[Solved, BeforeValidator(_keyed)]


class _Place(TypedDict):
    value: Number
    objective: Number | None
    pareto: Flag


def _placed(record: Any) -> Any:
    place = _PLACE.validate_python(record)
    converged = _outcome(record) == "gait"
    solver = record.get("solver") if converged else None
    if place["objective"] != (solver.get("objective") if isinstance(solver, Mapping) else None):
        raise PydanticCustomError("objective", "The objective is not that of the solver")
    return record


_PLACE = TypeAdapter(_Place)


class FrontRecord(TypedDict):
    """A front: at every point a gait or a failed attempt, with its objective."""

    over: Word
    points: Annotated[list[Annotated[Solved, BeforeValidator(_placed)]], Len(1)]


class _CandidateStep(TypedDict):
    phases: Phases
    impact: ModeText


class _Candidate(TypedDict):
    steps: Annotated[list[_CandidateStep], Len(1, MOST_STEPS)]
    state: State
    parameters: dict[Word, Number]
    start: Text


class PartRecord(TypedDict):
    """A line of the file of a search: the candidates of one part, with its key."""

    part: Word
    method: Word
    starts: Count
    candidates: list[Annotated[_Candidate, AfterValidator(_cycle)]]


def differing(stated: Any, true: Any, rel: float = 1e-7, key: str = "") -> str:
    """Key of the first entry of a record that differs from a true one; empty where there is none.

    Only entries of both are compared, numbers to a relative difference; ``None`` counts as an entry.
    """
    if isinstance(true, Mapping) and isinstance(stated, Mapping):
        pairs = ((f"{key}.{name}" if key else name, stated[name], true[name]) for name in true if name in stated)
        return next(filter(None, (differing(a, b, rel, name) for name, a, b in pairs)), "")
    if isinstance(true, list | tuple) and isinstance(stated, list | tuple):
        pairs = ((f"{key}.{k}", a, b) for k, (a, b) in enumerate(zip(stated, true, strict=False)))
        return (
            key if len(stated) != len(true) else next(filter(None, (differing(a, b, rel, n) for n, a, b in pairs)), "")
        )
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (stated, true))
    if numbers and not (abs(true) <= LARGEST and abs(stated) <= LARGEST):
        return key
    same = math.isclose(stated, true, rel_tol=rel, abs_tol=1e-9) if numbers else stated == true
    if true is None or (isinstance(true, float) and math.isnan(true)):
        same = stated is None
    return "" if same else key
