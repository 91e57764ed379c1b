"""The format of a certificate: which fields it has, what each may hold, and the control law that it completes.

A certificate holds a problem, exact values of its parameters, boxes for the orbit, and those data of the control law
that no problem contains: the pieces of a tracked motion, or the duration of a designed curve. Everything else that the
theorem speaks of is rebuilt from the problem. The fields ``versions`` and ``theorem`` are for readers: no proof uses
them.
"""

import json
from collections.abc import Mapping
from hashlib import sha256
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gaitopt.errors import StorageError
from gaitopt.model.control import (
    BeyondEnd,
    BezierTracking,
    ConstantTorque,
    Control,
    NoControl,
    Piece,
    ProportionalDerivative,
    Reference,
    continued,
)
from gaitopt.problem.faults import shown
from gaitopt.problem.problem import Problem, restore_problem
from gaitopt.problem.schema import ConstantTorqueSpec, CurveReference, PDSpec

SCHEMA = "gaitopt-proof-5"
LARGEST_FILE = 64 * 2**20
"""Bytes of a certificate; that of the longest known family has some 10^6."""
DEEPEST = 32
"""Levels of nested lists and objects in a certificate."""
MOST_BOXES, MOST_ARCS, MOST_UNKNOWNS = 2000, 1000, 3000
"""The largest known certificates have some 30 boxes, 10 arcs and 900 unknowns."""
LEAST_ORDER, LARGEST_ORDER = 2, 60
"""Of the Taylor series; the search uses 16 and 20."""
ROUNDING = 1e-12
"""Relative difference by which the end of a reference may differ when it is rebuilt on another platform."""

_NUMBER = r"[+-]?([0-9]{1,60}\.?[0-9]{0,60}|\.[0-9]{1,60})([eE][+-]?[0-9]{1,3})?"
_VALUE = rf"{_NUMBER}( (deg|rad))?"
EXACT_VALUE = rf"^{_VALUE}$"
"""A decimal number, or an angle with its unit."""
Number = Annotated[str, Field(pattern=rf"^{_NUMBER}$", max_length=140)]
Radius = Annotated[str, Field(pattern=r"^[0-9]{1,60}(\.[0-9]{1,60})?([eE][+-]?[0-9]{1,3})?$", max_length=140)]
Value = Annotated[str, Field(pattern=EXACT_VALUE, max_length=140)]
ValueOrInterval = Annotated[str, Field(pattern=rf"^{_VALUE}( *\.\. *{_VALUE})?$", max_length=300)]
Name = Annotated[str, Field(max_length=200)]
Real = Annotated[float, Field(ge=-1e9, le=1e9, allow_inf_nan=False)]
Row = Annotated[list[Real], Field(min_length=1, max_length=1000)]
Entries = Annotated[list[Number], Field(max_length=MOST_UNKNOWNS)]


class _Record(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class PieceRecord(_Record):
    """A piece of a tracked motion, see ``gaitopt.model.control.Piece``."""

    start: Real
    end: Real
    angles: Annotated[list[Row], Field(min_length=1, max_length=20)]
    rates: Annotated[list[Row], Field(min_length=1, max_length=20)]
    active: bool


class MotionRecord(_Record):
    """A tracked motion: its pieces, the last one for all times up to the horizon [s]."""

    pieces: Annotated[list[PieceRecord], Field(min_length=1, max_length=500)]
    horizon: Real | None


class CurveRecord(_Record):
    """What a designed curve needs besides its control points, which are parameters: its duration [s]."""

    duration: Annotated[Real, Field(gt=0)]


class ArcRecord(_Record):
    """An arc, see ``gaitopt.proof.orbit.Arc``."""

    mode: Name
    segment: Annotated[int, Field(ge=0, lt=MOST_ARCS)]
    phase: Annotated[int, Field(ge=0, lt=MOST_ARCS)]
    event: Name
    fractions: Annotated[
        list[Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)]], Field(max_length=MOST_UNKNOWNS)
    ]


class BoxRecord(_Record):
    """A box of unknowns, see ``gaitopt.proof.orbit.Box``; ``interval`` is that of the parameter that varies."""

    interval: Annotated[list[Value], Field(max_length=2)]
    centre: Entries
    tilt: Entries
    radii: Annotated[list[Radius], Field(max_length=MOST_UNKNOWNS)]


class CertificateRecord(_Record):
    """All fields of a certificate."""

    schema_: Annotated[Literal["gaitopt-proof-5"], Field(alias="schema")]
    problem: Name
    resolved: dict[str, Any]
    parameters: Annotated[dict[Name, ValueOrInterval], Field(max_length=1000)]
    reference: MotionRecord | CurveRecord | None
    varied: Name | None
    special: Literal["neimark_sacker", "period_doubling", "mode_change", "impact_change", "lift_off", "painleve"] | None
    order: Annotated[int, Field(ge=LEAST_ORDER, le=LARGEST_ORDER)]
    arcs: Annotated[list[ArcRecord], Field(max_length=MOST_ARCS)]
    boxes: Annotated[list[BoxRecord], Field(max_length=MOST_BOXES)]
    versions: dict[Name, Name]
    theorem: dict[str, Any] | None = None


def parse_certificate(content: bytes) -> dict[str, Any]:
    """The data of a file that may hold a certificate.

    Raises
    ------
    StorageError
        If they are not JSON, or not an object of a size that a certificate can have.
    """
    if len(content) > LARGEST_FILE:
        raise StorageError(f"a certificate has at most {LARGEST_FILE} bytes")
    try:
        data = json.loads(content.decode("utf-8"), parse_constant=_no_number)
    except RecursionError as error:
        raise StorageError("its lists and objects are nested too deeply") from error
    except ValueError as error:  # also of text that is not UTF-8, and of integers with thousands of digits
        raise StorageError(f"it is not JSON: {error}") from error
    if not isinstance(data, dict):
        raise StorageError("it holds no JSON object")
    return data


def read_certificate(certificate: Mapping[str, Any]) -> CertificateRecord:
    """A certificate whose fields all have the right type and size.

    Raises
    ------
    ValueError
        If it has another format, which the message names.
    StorageError
        If a field is missing, unknown, or holds what it cannot hold; the message names the field.
    """
    schema = certificate.get("schema")
    if isinstance(schema, str) and schema != SCHEMA:
        raise ValueError(
            f"a certificate of the format {shown(schema)}, not {SCHEMA}: check it with the version that wrote it"
        )
    if _is_deep(certificate):
        raise StorageError(f"its lists and objects are nested in more than {DEEPEST} levels")
    try:
        return CertificateRecord.model_validate(dict(certificate))
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ".".join(str(key)[:60] for key in first["loc"])
        raise StorageError(f"{place}: {first['msg']}") from error


def _is_deep(data: Any) -> bool:
    level = [data]
    for _ in range(DEEPEST):
        containers = [item for item in level if isinstance(item, Mapping | list)]
        level = [entry for item in containers for entry in (item.values() if isinstance(item, Mapping) else item)]
    return any(isinstance(item, Mapping | list) for item in level)


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is no number")


def certified_problem(record: CertificateRecord) -> Problem:
    """The problem of a certificate.

    Raises
    ------
    ValueError
        If it is none, names a file instead of holding the problem that it tracks, or has another name.
    """
    _require_whole(record.resolved)
    problem = restore_problem(record.resolved)
    if problem.is_open:
        raise ValueError("the mode sequence of its problem is open")
    if problem.name != record.problem:
        raise ValueError(f"it is about {shown(record.problem)}, but its problem is {problem.name}")
    return problem


def _require_whole(resolved: Mapping[str, Any]) -> None:
    """Refuse a name in the place of a tracked problem: a file of that name may hold anything."""
    control = resolved.get("control")
    reference = control.get("reference") if isinstance(control, Mapping) else None
    curve = reference.get("curve") if isinstance(reference, Mapping) else None
    for holder, key in ((reference, "gait"), (curve, "start")):
        if isinstance(holder, Mapping) and key in holder:
            if not isinstance(holder[key], Mapping):
                raise ValueError("its problem names another problem instead of holding it")
            _require_whole(holder[key])


def reference_record(control: Control) -> dict[str, Any] | None:
    """The data of a control law that its problem does not contain."""
    if isinstance(control, BezierTracking):
        return {"duration": control.duration}
    if isinstance(control, ProportionalDerivative):
        pieces = [
            {
                "start": piece.start,
                "end": piece.end,
                "angles": piece.angles.tolist(),
                "rates": piece.rates.tolist(),
                "active": piece.active,
            }
            for piece in control.reference.pieces
        ]
        horizon = control.reference.horizon
        return {"pieces": pieces, "horizon": None if np.isinf(horizon) else horizon}
    return None


def certified_control(problem: Problem, reference: MotionRecord | CurveRecord | None) -> Control:
    """The control law of a problem, completed by the reference data of a certificate.

    Raises
    ------
    ValueError
        If the data are not those that this law lacks, or contradict the problem.
    """
    spec = problem.control
    if not isinstance(spec, PDSpec):
        if reference is not None:
            raise ValueError(f"the control of its problem is {spec.type}, which has no reference")
        return ConstantTorque(torques=dict(spec.torques)) if isinstance(spec, ConstantTorqueSpec) else NoControl()
    if isinstance(spec.reference, CurveReference):
        if not isinstance(reference, CurveRecord):
            raise ValueError("its problem tracks a designed curve, but it does not state the duration of one")
        curve = spec.reference.curve
        if curve.duration not in (None, reference.duration):
            raise ValueError(f"its curve takes {reference.duration!r} s, that of its problem {curve.duration!r} s")
        return BezierTracking(
            kp=spec.kp,
            kd=spec.kd,
            points=dict.fromkeys(problem.walker.tracked, (0.0,) * (curve.degree + 1)),
            duration=reference.duration,
            beyond_end=BeyondEnd(spec.reference.beyond_end),
            within=curve.within,
        )
    if not isinstance(reference, MotionRecord):
        raise ValueError("its problem tracks the motion of another gait, but it does not hold one")
    motion = _motion(reference, len(problem.walker.tracked))
    _require_end(motion, spec.reference.beyond_end)
    return ProportionalDerivative(kp=spec.kp, kd=spec.kd, reference=motion)


def _motion(record: MotionRecord, joints: int) -> Reference:
    """The tracked motion.

    Raises
    ------
    ValueError
        If its pieces do not follow each other, or are not series of every joint.
    """
    starts = [piece.start for piece in record.pieces]
    if starts[0] != 0 or any(b <= a for a, b in pairwise(starts)):
        raise ValueError("the pieces of its reference do not follow each other from time zero")
    for k, piece in enumerate(record.pieces, start=1):
        if len(piece.angles) != joints or len(piece.rates) != joints or not piece.end > piece.start:
            raise ValueError(f"piece {k} of its reference does not state the motion of {joints} joints over a time")
        if len({len(row) for row in piece.angles}) > 1 or len({len(row) for row in piece.rates}) > 1:
            raise ValueError(f"the series of piece {k} of its reference differ in length")
    pieces = tuple(
        Piece(
            start=piece.start,
            end=piece.end,
            angles=np.array(piece.angles, dtype=float),
            rates=np.array(piece.rates, dtype=float),
            active=piece.active,
        )
        for piece in record.pieces
    )
    return Reference(pieces=pieces, horizon=np.inf if record.horizon is None else record.horizon)


def _require_end(motion: Reference, beyond_end: BeyondEnd) -> None:
    """Whether a motion goes on past its end as the problem says.

    Raises
    ------
    ValueError
        If it does not.
    """
    *before, last = motion.pieces
    if beyond_end is BeyondEnd.FLOW:
        fits = last.active and motion.horizon == last.end
    else:
        fits = bool(before) and np.isinf(motion.horizon) and _agree(last, continued(before, last.start, beyond_end))
    if not (fits and all(piece.active for piece in before)):
        raise ValueError(f"its reference does not end as its problem says, with beyond_end: {beyond_end}")


def _agree(piece: Piece, rebuilt: Reference) -> bool:
    """Whether a piece is the last one of a motion, but for rounding."""
    expected = rebuilt.pieces[-1]
    pairs = [(piece.angles, expected.angles), (piece.rates, expected.rates)]
    return (
        piece.active is expected.active
        and piece.end == expected.end
        and all(a.shape == b.shape and np.allclose(a, b, rtol=ROUNDING, atol=ROUNDING) for a, b in pairs)
    )


def digest(data: Any) -> str:
    """SHA-256 of JSON-able data, written in one way only."""
    text = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return sha256(text.encode()).hexdigest()
