"""Types of all stored records, which writers, checks and readers share, and the identities between their numbers.

    period = sum of the durations        step_length = speed period        radius = max |multiplier|

``GaitRecord``, ``PointRecord``, ... declare the contents of records. A reader of a file checks a record against the
type ``CheckedGait``, ``CheckedPoint``, ..., which adds limits and identities; the rest of the package relies on them. A
wrong number within its limits is not noticed unless an identity relates it to others; `gaitopt verify` detects it.
"""

import math
import re
from collections.abc import Container, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, NotRequired, cast

from annotated_types import Ge, Gt, Le, Len
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    with_config,
)
from pydantic_core import PydanticCustomError
from typing_extensions import TypedDict, TypeIs

from gaitopt.model.cycle import BREAKPOINT, UNTIL, Cycle
from gaitopt.model.modes import IMPACT, Mode
from gaitopt.problem.scalars import SCALARS

if TYPE_CHECKING:
    from gaitopt.gait.trajectory import Step

LARGEST_NUMBER, LARGEST_COUNT, MOST_STEPS, MOST_MULTIPLIERS = 1e30, 1_000_000_000, 64, 100
"""Limits of a number, of a count, of the steps of a cycle and of its multipliers; any walker stays far below."""
LONGEST_LIST, LONGEST_TEXT = 100_000, 100_000
"""Largest number of entries of a list, and of characters of a text."""
LONGEST_KEY = 200
"""Largest number of characters of a key in a message."""
SAME = 1e-9
"""Largest relative difference of two numbers that are equal up to rounding."""
CONTROL_CHARACTERS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
"""Characters that no text of a record may contain, because a terminal would interpret them."""
STATES = "states"
"""Key of the validation context under which the names stand that every state must have."""


def _plain(text: str) -> str:
    if CONTROL_CHARACTERS.search(text):
        raise PydanticCustomError("text", "Control characters in a text")
    return text


def _mode(record: str | dict[str, str]) -> str | dict[str, str]:
    Mode.from_record(record)
    return record


Number = Annotated[float, Field(strict=True, ge=-LARGEST_NUMBER, le=LARGEST_NUMBER, allow_inf_nan=False)]
Positive = Annotated[Number, Gt(0)]
NotNegative = Annotated[Number, Ge(0)]
Count = Annotated[int, Field(strict=True, ge=0, le=LARGEST_COUNT)]
Flag = Annotated[bool, Field(strict=True)]
Text = Annotated[str, Field(strict=True, max_length=LONGEST_TEXT), AfterValidator(_plain)]
Word = Annotated[str, Field(strict=True, max_length=200, pattern=r"^[\w .:,+=-]+$")]
"""A name, safe to print and to draw."""
OutcomeWord = Annotated[str, Field(strict=True, pattern=r"^(holds|fails|not_examined|no_linear_range)$")]
ModeText = Annotated[
    Annotated[str, Field(strict=True, max_length=200)] | Annotated[dict[Word, Word], Len(1, 100)], AfterValidator(_mode)
]
"""The mode of a foot, or the state of every named contact."""
Numbers = Annotated[list[Number], Len(max_length=LONGEST_LIST)]


def _named(state: dict[str, float], info: ValidationInfo) -> dict[str, float]:
    names = (info.context or {}).get(STATES)
    if names is not None and {*state} != {*names}:
        raise PydanticCustomError("names", "Must have the states {names}", {"names": ", ".join(names)})
    return state


State = Annotated[dict[Word, Number], AfterValidator(_named)]


@with_config(ConfigDict(extra="allow"))
class PhaseRecord(TypedDict):
    """A phase. States of stops and switches are entries under their names; ``until`` marks a timed phase.

    A phase that vanishes at a special point has the duration 0 there. If the phase begins with the impact of a named
    contact, ``impact`` is the mode just after it.
    """

    mode: ModeText
    duration: NotNegative
    until: NotRequired[Literal["breakpoint"]]
    impact: NotRequired[ModeText]


def phase_record(mode: Mode, duration: float, *, timed: bool = False, struck: Mode | None = None) -> PhaseRecord:
    """The record of a phase with its duration [s].

    Parameters
    ----------
    timed : whether the phase ends at a breakpoint of the control.
    struck : the mode just after the impact of a named contact, if the phase begins with one.
    """
    remarks = ({UNTIL: BREAKPOINT} if timed else {}) | ({} if struck is None else {IMPACT: struck.words})
    # where a phase vanishes, rounding may make its duration negative
    return cast(PhaseRecord, {**mode.record, "duration": max(duration, 0.0), **remarks})


def phase_records(step: "Step", timed: Container[int] = (), first: int = 0) -> list[PhaseRecord]:
    """The records of the phases of a step.

    Parameters
    ----------
    timed : indices of the timed phases, counted through all steps.
    first : index of the first phase of the step.
    """
    struck = step.landings
    return [
        phase_record(mode, duration, timed=k in timed, struck=struck.get(k - first))
        for k, (mode, duration) in enumerate(step.phases, start=first)
    ]


@with_config(ConfigDict(extra="allow"))
class UntimedPhaseRecord(TypedDict):
    """A phase of a failed solve."""

    mode: ModeText
    duration: None


def _of_mode(phase: Mapping[str, Any]) -> Mapping[str, Any]:
    if not all(isinstance(value, str) for key, value in phase.items() if key not in ("duration", "mode", IMPACT)):
        raise PydanticCustomError("stops", "Stops and switches must have a state in words")
    Mode.from_record(phase)
    return phase


Phases = Annotated[list[Annotated[PhaseRecord, AfterValidator(_of_mode)]], Len(1, 1000)]


class StepRecord(TypedDict):
    """A step of a cycle of several steps; its state is the one just after the impact before it."""

    phases: Phases
    impact: ModeText
    period: Positive
    step_length: Number
    state: State


class MultiplierRecord(TypedDict):
    """Real and imaginary part of a Floquet multiplier."""

    re: Number
    im: Number


class ClaimRecord(TypedDict):
    """A claim about a gait: the figure that its check computed, and the largest figure that passes."""

    name: Word
    figure: Number | None
    tolerance: Number
    passed: Flag
    note: Text
    outcome: NotRequired[OutcomeWord]  # not in records of earlier versions


class VerificationRecord(TypedDict):
    """A verification by simulation."""

    passed: Flag
    claims: Annotated[list[ClaimRecord], Len(1, 1000)]
    period_error: Number | None
    state_error: Number | None
    multiplier_error: Number | None
    mode_sequence_matches: Flag


def _passed(record: VerificationRecord) -> VerificationRecord:
    if record["passed"] != all(claim["passed"] for claim in record["claims"]):
        raise PydanticCustomError("passed", "Must be true where all claims have passed, and only there")
    for claim in record["claims"]:
        if claim["passed"] and (claim["figure"] is None or claim["figure"] > claim["tolerance"]):
            raise PydanticCustomError("claim", "A claim has passed with a figure beyond its tolerance")
        if "outcome" in claim and claim["passed"] != (claim["outcome"] == "holds"):
            raise PydanticCustomError("outcome", "The outcome of a claim is holds if and only if it has passed")
    figures = {claim["name"]: claim["figure"] for claim in record["claims"]}
    errors = {
        "period": record["period_error"],
        "state": record["state_error"],
        "multipliers": record["multiplier_error"],
    }
    for name, error in errors.items():
        if error != figures.get(name):
            context = {"name": name.removesuffix("s")}
            raise PydanticCustomError("error", "{name}_error is not the figure of its claim", context)
    sequence = [claim["passed"] for claim in record["claims"] if claim["name"] == "mode sequence"]
    if sequence != [record["mode_sequence_matches"]]:
        raise PydanticCustomError("sequence", "mode_sequence_matches is not what its claim says")
    return record


class MeasureRecord(TypedDict):
    """Scalars of a gait."""

    period: Positive
    step_length: Number
    speed: Number
    work: Number
    damping_loss: NotRequired[NotNegative]  # missing in records that were written before dampers existed
    cost_of_transport: Number | None
    absolute_cost_of_transport: NotNegative | None
    gravity_cost: NotRequired[Number | None]  # like torque_cost and apex_height, missing in records of version 0.1
    torque_squared: NotNegative
    torque_cost: NotRequired[Number | None]
    peak_torque: NotNegative
    slip_distance: NotNegative
    foot_clearance: Number | None
    apex_height: NotRequired[Number | None]
    required_friction: NotNegative | None
    impulse_ratio: NotNegative | None
    min_normal_force: Number | None


class ContactRecord(TypedDict):
    """Scalars of one named contact; None where they are not defined."""

    required_friction: NotNegative | None
    min_normal_force: Number | None
    slip_distance: NotNegative


class ContactsRecord(TypedDict):
    """Numbers of a gait of a walker with several contacts; not in the records of others."""

    contacts: NotRequired[dict[Word, ContactRecord]]
    undetermined: NotRequired[list[Word]]
    undetermined_bounds: NotRequired[dict[Word, Annotated[list[Number], Len(2, 2)]]]


class ZeroDynamicsRecord(TypedDict):
    """The zero dynamics of a gait under virtual constraints; None where they are not defined."""

    delta_squared: NotNegative | None
    potential_max: Number | None
    invariant: Flag


class ConstraintRecord(TypedDict):
    """Numbers of a gait under virtual constraints; not in the records of others."""

    decoupling_min_singular_value: NotRequired[NotNegative]
    zero_dynamics: NotRequired[ZeroDynamicsRecord]


class TrackingRecord(TypedDict):
    """Errors of a joint that follows a reference, just after the impact and at the end of the cycle [rad, or m]."""

    start: Number
    end: Number


class ControlRecord(TypedDict):
    """Numbers of a gait under a control law; not in the records of passive walkers and of constant torques."""

    control: NotRequired[dict[Word, Number]]
    tracking_errors: NotRequired[dict[Word, TrackingRecord]]
    fit_errors: NotRequired[dict[Word, Number]]


class RangePointsRecord(TypedDict):
    """Columns of the ``RangePoint`` of a design over a range, in ascending order of the parameter."""

    value: Numbers
    objective: Numbers
    spectral_radius: Annotated[list[NotNegative], Len(max_length=LONGEST_LIST)]
    sequence: Annotated[list[Text], Len(max_length=LONGEST_LIST)]


class RangeRecord(TypedDict):
    """A ``DesignRange``."""

    parameter: Word
    range: tuple[Number, Number]
    aggregate: Literal["worst", "mean", "at"]
    at: Number
    objective: Number | None
    worst_at: Number | None
    binding: dict[Word, Number]
    scenarios: Numbers
    single: Number | None
    points: RangePointsRecord


class GaitRecord(MeasureRecord, ConstraintRecord, ContactsRecord, ControlRecord):
    """A gait: the state just after the impact before its first step, modes with durations, scalars and multipliers."""

    problem: NotRequired[Word]
    status: Literal["converged"]
    message: Text
    friction: Number | dict[Word, Number]
    n_steps: Annotated[Count, Ge(1), Field(le=MOST_STEPS)]
    impact: ModeText
    phases: Phases
    state: State
    steps: NotRequired[Annotated[list[StepRecord], Len(1, MOST_STEPS)]]
    multipliers: Annotated[list[MultiplierRecord], Len(max_length=MOST_MULTIPLIERS)]
    spectral_radius: NotNegative | None
    parameters: dict[Word, Number]
    solver: dict[Word, Number | Flag | Text | None]
    verification: Annotated[VerificationRecord, AfterValidator(_passed)] | None
    over: NotRequired[RangeRecord]


def _consistent(record: GaitRecord) -> GaitRecord:
    """Check the identities between the numbers of a gait; at a special point it may have no multipliers."""

    def agree(key: str, stated: float, value: float, definition: str, size: float = 0.0) -> None:
        if not math.isclose(stated, value, rel_tol=SAME, abs_tol=SAME * size):
            context = {"key": key, "stated": f"{stated:.12g}", "value": f"{value:.12g}", "definition": definition}
            raise PydanticCustomError("identity", "{key} is {stated}, but {definition} is {value}", context)

    cycle, steps = Cycle.from_record(record), record.get("steps", [])
    last_impact = steps[-1]["impact"] if steps else record["impact"]
    if record["n_steps"] != len(cycle.steps) or last_impact != record["impact"]:
        raise PydanticCustomError("steps", "Its steps do not have the number or the impact that it states")
    durations = sum(phase["duration"] for phase in record["phases"])
    agree("period", record["period"], durations, "the sum of the durations")
    agree("step_length", record["step_length"], record["speed"] * record["period"], "speed times period", 1.0)
    for step in steps:
        if not math.isclose(step["period"], sum(phase["duration"] for phase in step["phases"]), rel_tol=SAME):
            raise PydanticCustomError("identity", "The period of a step is not the sum of its durations")
    moduli, radius = [math.hypot(m["re"], m["im"]) for m in record["multipliers"]], record["spectral_radius"]
    if (radius is None) != (not moduli):
        raise PydanticCustomError("radius", "A spectral_radius without multipliers, or multipliers without one")
    if radius is not None:
        agree("spectral_radius", radius, max(moduli), "the largest modulus of the multipliers", 1e-6)
    return record


def _regular(record: GaitRecord) -> GaitRecord:
    if record["spectral_radius"] is None:
        raise PydanticCustomError("radius", "spectral_radius must be a number")
    if not all(phase["duration"] for phase in record["phases"]):
        raise PydanticCustomError("duration", "Every duration must be greater than 0")
    return record


Complete = (AfterValidator(_consistent), AfterValidator(_regular))
CheckedGait = Annotated[GaitRecord, *Complete]


class ContinuationStateRecord(TypedDict):
    """A ``ContinuationState``; an arc consists of phase, segment, start and end [s], and number of intervals."""

    unknowns: Numbers
    direction: Numbers
    arcs: list[tuple[Count, Count, Number | None, Number | None, Annotated[Count, Ge(1)]]]
    origin: Number
    metric: Numbers
    earlier: Annotated[Count, Le(1)]
    others: NotRequired[Numbers]


class PointRecord(GaitRecord):
    """A point of a branch: its gait, branch, index and value; ``walk`` is missing in files of earlier versions."""

    record: Literal["point"]
    branch: Count
    index: Count
    value: Number
    tangent: Numbers
    length: Number
    intervals: NotRequired[list[Count]]
    walk: NotRequired[ContinuationStateRecord | None]


CheckedPoint = Annotated[PointRecord, *Complete]


@with_config(ConfigDict(extra="allow"))
class CycleRecord(TypedDict):
    """A mode sequence: ``phases`` and ``impact``, or ``steps`` that have these keys."""


def _of_cycle(record: Mapping[str, Any]) -> Mapping[str, Any]:
    try:
        Cycle.from_record(record)
    except (AttributeError, KeyError, TypeError) as error:
        raise PydanticCustomError("cycle", "No mode sequence") from error
    return record


@with_config(ConfigDict(extra="forbid"))
class EmptyRecord(TypedDict):
    """An empty record, which takes the place of a gait that does not exist."""


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
        "contact": NotRequired[Word],
        "bound": NotRequired[Flag],
        "open": NotRequired[Flag],
        "from": NotRequired[Annotated[CycleRecord, AfterValidator(_of_cycle)]],
        "to": NotRequired[Annotated[CycleRecord, AfterValidator(_of_cycle)]],
        "coefficients": NotRequired[Annotated[dict[Word, Number | None], Len(max_length=10)]],
        "tangent": NotRequired[Numbers | None],
        "gait": EmptyRecord | Annotated[GaitRecord, AfterValidator(_consistent)],
    },
)
BranchRecord = PointRecord | SpecialRecord


def special_gait(record: SpecialRecord) -> GaitRecord | None:
    """The gait at a special point, if there is one."""
    return cast(GaitRecord, record["gait"]) if record["gait"] else None


class RequestRecord(TypedDict):
    """The first line of a branch: the request of its continuation."""

    record: Literal["continuation"]
    parameter: Word
    to: Annotated[list[Number], Len(1, 1000)]
    lower: NotRequired[Number | None]
    upper: NotRequired[Number | None]
    start: NotRequired[Word]


class MarginRecord(TypedDict):
    """The monitor of a mode sequence; ``phase`` is None for the impact that ends a step."""

    kind: Word
    phase: Count | None
    step: Count


class ConditionRecord(TypedDict):
    """What vanishes along a curve of special points; see ``trace.CurveStart``.

    At points of a margin, ``beyond`` is the mode sequence on its other side if the multipliers jump there, None if they
    do not jump; it is missing where that is not decided.
    """

    type: Word
    margin: NotRequired[MarginRecord]
    kappa: NotRequired[Number]
    gait: NotRequired[Annotated[GaitRecord, AfterValidator(_consistent)]]
    beyond: NotRequired[Annotated[CycleRecord, AfterValidator(_of_cycle)] | None]


Values = Annotated[dict[Word, Number], Len(2, 2)]


class TracePointRecord(GaitRecord):
    """A point of a curve in two parameters: its gait and its position on the curve."""

    record: Literal["point"]
    curve: Count
    index: Count
    values: Values
    condition: ConditionRecord
    tangent: Numbers
    length: Number
    intervals: NotRequired[list[Count]]
    walk: ContinuationStateRecord


CheckedTracePoint = Annotated[TracePointRecord, *Complete]
TraceSpecialRecord = TypedDict(
    "TraceSpecialRecord",
    {
        "record": Literal["special"],
        "curve": Count,
        "type": Word,
        "values": Values,
        "codimension": Count,
        "status": Literal["converged", "guess"],
        "reason": Text,
        "coefficients": Annotated[dict[Word, Number | None], Len(max_length=10)],
        "next": Annotated[list[ConditionRecord], Len(max_length=10)],
        "bound": NotRequired[Flag],
        "open": NotRequired[Flag],
        "from": NotRequired[Annotated[CycleRecord, AfterValidator(_of_cycle)]],
        "to": NotRequired[Annotated[CycleRecord, AfterValidator(_of_cycle)]],
        "gait": Annotated[GaitRecord, AfterValidator(_consistent)],
    },
)
TraceRecord = TracePointRecord | TraceSpecialRecord


class TraceRequestRecord(TypedDict):
    """The first line of a trace: its request."""

    record: Literal["trace"]
    type: Word
    parameter: Word
    key: Word
    to: Annotated[list[Number], Len(1, 1000)]


class SectionRecord(TypedDict):
    """The state of a walk after an impact; the first record of a walk is its start and has no impact."""

    time: NotNegative
    impact: ModeText | None
    state: State


class ImpactEntry(TypedDict):
    """An impact of a walk; see ``impacts.impact_records``. Records of early versions have none."""

    time: NotNegative
    step: Count
    of: list[Word]
    impact: ModeText
    impulse: dict[Word, Number | None] | dict[Word, dict[Word, Number | None]] | None


class AxisRecord(TypedDict):
    """An axis of a grid."""

    key: Word
    lower: Number
    upper: Number
    count: Annotated[Count, Ge(1)]
    unit: NotRequired[Literal["", "deg"]]


Axes = Annotated[list[AxisRecord], Len(1, 20)]


class SweepRecord(TypedDict):
    """The grid of a sweep; its counts follow from its table."""

    over: Axes


class AttractorsRecord(TypedDict):
    """Attractors over a parameter: the axis, and the keys of its jobs in the order of the values."""

    over: AxisRecord
    jobs: Annotated[list[Word], Len(1, 1_000_000)]


class LongRunRecord(TypedDict):
    """A motion that walks settle on.

    ``period_steps`` is None if the motion does not repeat itself, ``lyapunov`` if the exponent is not finite.
    """

    states: Annotated[list[Numbers], Len(1, 1_000_000)]
    period_steps: Annotated[Count, Ge(1)] | None
    lyapunov: Number | None
    starts: Annotated[Count, Ge(1)]


class RobustnessRecord(TypedDict):
    """How robust a gait is: the keys of the figures in their order."""

    jobs: Annotated[list[Word], Len(1)]


class FigureRecord(TypedDict):
    """One figure of the robustness of a gait."""

    job: NotRequired[Word]
    figure: Word
    value: Any


class SettledRecord(TypedDict):
    """The motions that walks settle on at one value of the parameter, and how many other walks have which ending."""

    job: NotRequired[Word]
    value: Number
    attractors: list[LongRunRecord]
    endings: dict[Word, Annotated[Count, Ge(1)]]


class AtlasPointRecord(GaitRecord):
    """A gait of a branch of an atlas, with its first parameter."""

    value: Number


AtlasSegments = list[Annotated[list[Annotated[AtlasPointRecord, AfterValidator(_consistent)]], Len(1, 1000)]]


class DoubledRecord(TypedDict):
    """A branch of doubled gaits of an atlas, which begins at its first special point."""

    segments: AtlasSegments
    specials: list[SpecialRecord]
    doubled: list["DoubledRecord"]


class AtlasJobRecord(TypedDict):
    """A branch of an atlas: its segments and special points; or a traced curve; or the verified gait of a region."""

    job: NotRequired[Word]
    value: NotRequired[Number]
    segments: NotRequired[AtlasSegments]
    specials: NotRequired[list[SpecialRecord]]
    doubled: NotRequired[list[DoubledRecord]]
    reason: NotRequired[Text]
    at: NotRequired[dict[Word, Number]]
    gait: NotRequired[Annotated[GaitRecord, AfterValidator(_consistent)] | None]
    type: NotRequired[Word]
    steps: NotRequired[Count]
    trace: NotRequired[list[Annotated[Numbers, Len(2, 2)]]]
    located: NotRequired[list[TraceSpecialRecord]]


class AtlasRecord(TypedDict):
    """The two ranges of an atlas, and the keys of its jobs."""

    over: Axes
    jobs: Annotated[list[Word], Len(1, 1_000_000)]


class BasinRecord(TypedDict):
    """The grid, the fixed coordinates, the floor and the freed parameters of a basin; its tiles have all else."""

    over: Axes
    base: dict[Word, Number]
    floor: NotRequired[dict[Word, list[Any]]]
    parameters: NotRequired[dict[Word, Number]]


class WalkRecord(TypedDict):
    """A simulated walk; the scalars of its last step follow from its table."""

    problem: Word
    status: Word
    message: Text
    steps: Count
    section: Annotated[list[SectionRecord], Len(1)]
    final_state: NotRequired[State]
    time: NotRequired[NotNegative]
    impacts: NotRequired[list[ImpactEntry]]
    gait_states: list[State]
    parameters: dict[Word, Number]
    floor: NotRequired[dict[Word, list[Any]]]


@with_config(ConfigDict(extra="allow"))
class AttemptRecord(TypedDict):
    """A failed solve, or a job without a result; see ``SolvedRecord`` for ``start``."""

    status: Literal["not_converged", "infeasible", "interrupted", "set_aside"]
    message: Text
    job: NotRequired[Word]
    start: NotRequired[Word]
    phases: NotRequired[list[Annotated[UntimedPhaseRecord, AfterValidator(_of_mode)]]]
    impact: NotRequired[ModeText | None]
    state: NotRequired[None]
    parameters: NotRequired[dict[Word, Number | None]]
    verification: NotRequired[None]


def _without_scalars(record: Mapping[str, Any]) -> Mapping[str, Any]:
    if record["status"] == "interrupted":
        raise PydanticCustomError("attempt", "An interrupted solve is not stored")
    stated = next((name for name in SCALARS if record.get(name) is not None), None)
    if stated is not None or (record.get("phases") and record.get("impact") is None):
        raise PydanticCustomError(
            "attempt", "A failed attempt with {key}", {"key": stated or "phases without an impact"}
        )
    return record


class SolvedRecord(GaitRecord):
    """A gait in a file of jobs or of a front.

    ``job`` is the key of its job, ``start`` how its solve started (``cold``, ``warm``, ``neighbour`` or ``scan``), and
    ``gaits`` the number of gaits that a scan found.
    """

    job: NotRequired[Word]
    start: NotRequired[Word]
    gaits: NotRequired[Annotated[Count, Ge(2)]]


OutcomeRecord = SolvedRecord | AttemptRecord


def is_gait(record: OutcomeRecord) -> TypeIs[SolvedRecord]:
    """Whether a job found a gait."""
    return record["status"] == "converged"


def _outcome(record: Any) -> str:
    return "gait" if isinstance(record, Mapping) and record.get("status") == "converged" else "attempt"


CheckedOutcome = Annotated[
    Annotated[SolvedRecord, *Complete, Tag("gait")]
    | Annotated[AttemptRecord, AfterValidator(_without_scalars), Tag("attempt")],
    Discriminator(_outcome),
]
"""A gait or a failed attempt in the file of jobs or of a front."""


def _keyed(record: Any) -> Any:
    if not isinstance(record, Mapping) or not isinstance(record.get("job"), str):
        raise PydanticCustomError("job", "A line needs the key of its job")
    return record


CheckedJob = Annotated[CheckedOutcome, BeforeValidator(_keyed)]


class FrontEntryRecord(TypedDict):
    """The entries that a gait or an attempt has only in a front."""

    value: Number
    objective: Number | None
    pareto: Flag


_FRONT_ENTRY = TypeAdapter(FrontEntryRecord)


def _of_front(record: Any) -> Any:
    entry = _FRONT_ENTRY.validate_python(record)
    solver = record.get("solver") if _outcome(record) == "gait" else None
    if entry["objective"] != (solver.get("objective") if isinstance(solver, Mapping) else None):
        raise PydanticCustomError("objective", "The objective is not that of the solver")
    if solver is not None and entry["objective"] is None:
        raise PydanticCustomError("objective", "A design that is solved has an objective")
    return record


class FrontRecord(TypedDict):
    """A front: a gait or a failed attempt at every point, which also has the entries of ``FrontEntryRecord``."""

    over: Word
    points: Annotated[list[Annotated[CheckedOutcome, BeforeValidator(_of_front)]], Len(1)]


class CandidateStepRecord(TypedDict):
    """Modes and durations of a step of a candidate."""

    phases: Phases
    impact: ModeText


class CandidateRecord(TypedDict):
    """A motion that may be a gait; ``start`` describes the start from which the search found it."""

    steps: Annotated[list[CandidateStepRecord], Len(1, MOST_STEPS)]
    state: State
    parameters: dict[Word, Number]
    start: Text


class SearchRecord(TypedDict):
    """The candidates that one job of a search found, and the number of its starts."""

    method: Word
    starts: Count
    candidates: list[Annotated[CandidateRecord, AfterValidator(_of_cycle)]]


class SearchLineRecord(SearchRecord):
    """A line of the file of a search: the record of a job, and the key of the job."""

    part: Word


def first_fault(error: ValidationError) -> str:
    """Key and message of the first fault of a record, without the value, which may be huge or unprintable."""
    first = error.errors(include_input=False, include_url=False)[0]
    key = ".".join(str(name) for name in first["loc"])[:LONGEST_KEY]
    return f"{key}: {first['msg']}" if key else first["msg"]


def differing(stated: Any, true: Any, rel: float = 1e-7, key: str = "") -> str:
    """Key of the first entry of a record that differs from the true one; empty if there is none.

    Only entries that both have are compared, numbers up to the relative difference ``rel``. ``None`` is compared like
    any other value.
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
    if numbers and not (abs(true) <= LARGEST_NUMBER and abs(stated) <= LARGEST_NUMBER):
        return key
    same = math.isclose(stated, true, rel_tol=rel, abs_tol=1e-9) if numbers else stated == true
    if true is None or (isinstance(true, float) and math.isnan(true)):
        same = stated is None
    return "" if same else key
