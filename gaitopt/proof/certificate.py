"""Certificates: their format, and the statement that is rebuilt from one.

A certificate contains a problem, the exact values of its parameters, boxes for the orbit, and the data of the control
law that no problem contains: the pieces of a tracked motion, or the duration of a designed curve. Everything else in
the theorem is rebuilt from the problem, or compared with it. The checker ignores the fields ``versions`` and
``theorem``, which are for readers.

Exact values are decimals as the problem's file writes them, with pi where it writes ``deg``. Each has to round to the
problem's double of it.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Any, Literal, TypedDict

import numpy as np
from flint import arb
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gaitopt.errors import StorageError
from gaitopt.model.closure import is_linear
from gaitopt.model.control import Control
from gaitopt.model.cycle import Cycle
from gaitopt.model.declaration import is_default
from gaitopt.model.modes import CONTACTS, Mode
from gaitopt.model.reference import (
    BeyondEnd,
    BezierCurve,
    CurveReference,
    GaitReference,
    Piece,
    Reference,
    Target,
    continued,
)
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import Transitions
from gaitopt.model.walker import Walker
from gaitopt.problem.faults import shown
from gaitopt.problem.problem import Problem, restore_problem
from gaitopt.problem.statement import digest_of, reference_keys
from gaitopt.proof.arithmetic import INTERVAL, NotProved, ball
from gaitopt.proof.orbit import BREAKPOINT, Orbit, OrbitArc, TiltedBox

SCHEMA = "gaitopt-proof-5"
LARGEST_FILE = 64 * 2**20
"""Bytes of a certificate; the longest known family has some 10^6."""
DEEPEST = 32
"""Levels of nested lists and objects in a certificate."""
MOST_BOXES, MOST_ARCS, MOST_UNKNOWNS = 2000, 1000, 3000
"""The largest known certificates have some 30 boxes, 10 arcs and 900 unknowns."""
LEAST_ORDER, LARGEST_ORDER = 2, 60
"""Bounds of the order of the Taylor series; the prover uses 16 and 20."""
REBUILDING_ERROR = 1e-12
"""Relative difference allowed between the last piece of a reference and the same piece rebuilt on this platform."""
PARAMETER_ERROR = arb(2) ** -51
"""Relative difference allowed between an exact value and the problem's double of it: its rounding."""

_NUMBER = r"[+-]?([0-9]{1,60}\.?[0-9]{0,60}|\.[0-9]{1,60})([eE][+-]?[0-9]{1,3})?"
_VALUE = rf"{_NUMBER}( (deg|rad))?"
EXACT_VALUE = rf"^{_VALUE}$"
"""A decimal number, or one with ``deg`` or ``rad``."""
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
    """A piece of a tracked motion; see ``gaitopt.model.reference.Piece``."""

    start: Real
    end: Real
    angles: Annotated[list[Row], Field(min_length=1, max_length=20)]
    rates: Annotated[list[Row], Field(min_length=1, max_length=20)]
    active: bool


class MotionRecord(_Record):
    """A tracked motion: its pieces, and the horizon [s] to which the last one extends; None for all times."""

    pieces: Annotated[list[PieceRecord], Field(min_length=1, max_length=500)]
    horizon: Real | None


class CurveRecord(_Record):
    """A designed curve: its duration [s]. Its control points are parameters."""

    duration: Annotated[Real, Field(gt=0)]


class ArcRecord(_Record):
    """An arc; see ``gaitopt.proof.orbit.OrbitArc``."""

    mode: Name
    segment: Annotated[int, Field(ge=0, lt=MOST_ARCS)]
    phase: Annotated[int, Field(ge=0, lt=MOST_ARCS)]
    event: Name
    fractions: Annotated[
        list[Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)]], Field(max_length=MOST_UNKNOWNS)
    ]


class BoxRecord(_Record):
    """A box of unknowns; see ``gaitopt.proof.orbit.TiltedBox``. ``interval`` belongs to the varying parameter."""

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
    """The JSON object in a file.

    Raises
    ------
    StorageError
        If it is not JSON, not an object, or too large.
    """
    if len(content) > LARGEST_FILE:
        raise StorageError(f"a certificate has at most {LARGEST_FILE} bytes")

    def refuse(constant: str) -> float:
        raise ValueError(f"{constant} is not a number")

    try:
        data = json.loads(content.decode("utf-8"), parse_constant=refuse)  # refuses NaN and Infinity
    except RecursionError as error:
        raise StorageError("its lists and objects are nested too deeply") from error
    except ValueError as error:  # also of text that is not UTF-8, and of integers with thousands of digits
        raise StorageError(f"it is not JSON: {error}") from error
    if not isinstance(data, dict):
        raise StorageError("it contains no JSON object")
    return data


def read_certificate(certificate: Mapping[str, Any]) -> CertificateRecord:
    """A certificate with fields of the right type and size.

    Raises
    ------
    ValueError
        If it has another format; the message names it.
    StorageError
        If a field is missing, unknown, or has a wrong value; the message names the field.
    """
    schema = certificate.get("schema")
    if isinstance(schema, str) and schema != SCHEMA:
        raise ValueError(
            f"a certificate of the format {shown(schema)}, not {SCHEMA}: check it with the version that wrote it"
        )
    level: list[Any] = [certificate]
    for _ in range(DEEPEST):
        containers = [item for item in level if isinstance(item, Mapping | list)]
        level = [entry for item in containers for entry in (item.values() if isinstance(item, Mapping) else item)]
    if any(isinstance(item, Mapping | list) for item in level):
        raise StorageError(f"its lists and objects are nested in more than {DEEPEST} levels")
    try:
        return CertificateRecord.model_validate(dict(certificate))
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ".".join(str(key)[:60] for key in first["loc"])
        raise StorageError(f"{place}: {first['msg']}") from error


def certified_problem(
    record: CertificateRecord, walkers: Sequence[type[Walker]] = (), controls: Sequence[type[Control]] = ()
) -> Problem:
    """The problem of a certificate.

    Raises
    ------
    ValueError
        If it is not a problem, names a file instead of holding the problem that it tracks, or has another name.
    """
    _refuse_named_reference(record.resolved)
    problem = restore_problem(record.resolved, walkers=walkers, controls=controls)
    if problem.is_open:
        raise ValueError("the mode sequence of its problem is open")
    if problem.name != record.problem:
        raise ValueError(f"it is about {shown(record.problem)}, but its problem is {problem.name}")
    return problem


def _refuse_named_reference(resolved: Mapping[str, Any]) -> None:
    """Refuse the name of a tracked problem in place of the problem: the file of that name may contain anything."""
    for section, key in reference_keys(resolved):
        if not isinstance(section[key], Mapping):
            raise ValueError("its problem refers to another problem instead of containing it")
        _refuse_named_reference(section[key])


def certified_control(problem: Problem, reference: MotionRecord | CurveRecord | None) -> Control:
    """The control law of a problem, completed by the reference data of a certificate.

    Raises
    ------
    ValueError
        If the law needs other data, or the data contradict the problem.
    """
    law = problem.control
    if not law.source[0]:
        if reference is not None:
            raise ValueError(f"the control of its problem is {law.type}, which has no reference")
        return law
    bound = {name: _certified_target(problem, target, reference) for name, target in law.targets.items()}
    return law.model_copy(update=bound)


def _certified_target(problem: Problem, target: Target, reference: MotionRecord | CurveRecord | None) -> Target:
    """A target completed by the reference data of a certificate; raises as ``certified_control``."""
    if isinstance(target, CurveReference):
        if not isinstance(reference, CurveRecord):
            raise ValueError("its problem tracks a designed curve, but it does not state the duration of one")
        curve = target.curve
        if curve.duration not in (None, reference.duration):
            raise ValueError(f"its curve takes {reference.duration!r} s, that of its problem {curve.duration!r} s")
        assert target.beyond_end is not None  # or there is a fault
        return BezierCurve(
            points=dict.fromkeys(target.followers(type(problem.walker)), (0.0,) * (curve.degree + 1)),
            duration=reference.duration,
            beyond_end=BeyondEnd(target.beyond_end),
            within=curve.within,
        )
    if not isinstance(target, GaitReference):
        return target
    if target.beyond_end is None:
        raise ValueError(
            "its problem tracks another gait as a function of a phase variable, which no certificate covers"
        )
    if not isinstance(reference, MotionRecord):
        raise ValueError("its problem tracks the motion of another gait, which it does not contain")
    motion = _tracked_motion(reference, len(target.followers(type(problem.walker))), target.beyond_end)
    return replace(motion, names=target.followers(type(problem.walker)))


def _tracked_motion(record: MotionRecord, joints: int, beyond_end: BeyondEnd) -> Reference:
    """The tracked motion; its pieces follow each other, are series of every joint, and end as the problem says."""
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
    motion = Reference(pieces=pieces, horizon=np.inf if record.horizon is None else record.horizon)
    *before, last = pieces
    if beyond_end is BeyondEnd.FLOW:
        fits = last.active and motion.horizon == last.end
    elif not before or not np.isinf(motion.horizon):
        fits = False
    else:
        rebuilt = continued(before, last.start, beyond_end).pieces[-1]
        fits = (last.active, last.end) == (rebuilt.active, rebuilt.end) and all(
            a.shape == b.shape and np.allclose(a, b, rtol=REBUILDING_ERROR, atol=REBUILDING_ERROR)
            for a, b in ((last.angles, rebuilt.angles), (last.rates, rebuilt.rates))
        )
    if not (fits and all(piece.active for piece in before)):
        raise ValueError(f"its reference does not end as its problem says, with beyond_end: {beyond_end}")
    return motion


class Hypotheses(TypedDict, total=False):
    """The printed statement of a theorem: its hypotheses, and what is not proved.

    Attributes
    ----------
    sha256 : digest of the problem.
    control : type of the control law; for a tracked curve also how it goes on past its end.
    curve_sha256 : digest of a tracked curve, which no problem contains; None if there is none.
    parameters : exact values by dotted key; an interval for the varying one.
    designed : keys of the parameters that the problem leaves free.
    not_proved : what the theorem leaves open.
    """

    sha256: str
    walker: str
    friction: str
    impact_law: str
    mode_sequence: str
    control: str
    curve_sha256: str | None
    parameters: dict[str, str]
    designed: list[str]
    not_proved: list[str]


@dataclass(frozen=True, slots=True)
class Statement:
    """What is to be proved.

    Attributes
    ----------
    record : the certificate.
    p : parameters in balls.
    arcs : in order of time.
    varied : index of the varying parameter; None if none varies.
    interval : ends of the varying parameter as texts; empty if none varies.
    printed : the hypotheses of the theorem, and what is not proved.
    """

    record: CertificateRecord
    problem: Problem
    system: HybridSystem
    p: Sequence[arb]
    arcs: Sequence[OrbitArc]
    varied: int | None
    interval: tuple[str, ...]
    printed: Hypotheses

    @property
    def cycle(self) -> Cycle:
        """The mode sequence."""
        return self.problem.cycle

    def orbit(self, interval: Sequence[str]) -> Orbit:
        """The equations of the orbit on an interval of the varying parameter."""
        ends = [ball(text) for text in interval]
        middle_and_half: tuple[arb, ...] = ()
        if ends:
            half = arb(0) if interval[0] == interval[1] else (ends[1] - ends[0]) / 2
            middle_and_half = ((ends[0] + ends[1]) / 2, half)
        return Orbit(self.system, self.p, self.varied, middle_and_half, self.cycle, self.arcs, self.record.order)


def restore_statement(
    record: CertificateRecord, walkers: Sequence[type[Walker]] = (), controls: Sequence[type[Control]] = ()
) -> Statement:
    """The statement of a certificate.

    Parameters
    ----------
    walkers, controls : classes that the problem may name besides those that are registered.

    Raises
    ------
    ValueError
        If the certificate contradicts its problem.
    NotProved
        If the claims do not cover the walker or one of its modes.
    """
    problem = certified_problem(record, walkers, controls)
    control = certified_control(problem, record.reference)
    system = HybridSystem(type(problem.walker), control, problem.impact_law, problem.friction_law)
    refuse_uncovered_walkers(problem, system)
    texts, varied = record.parameters, record.varied
    _check_parameters(problem, system, texts)
    arcs = [OrbitArc(Mode(a.mode), a.segment, a.phase, a.event, tuple(a.fractions)) for a in record.arcs]
    _check_arcs(arcs, problem.cycle, system.transitions, control)
    if varied is not None and varied not in texts:
        raise ValueError(f"no parameter is called {varied}")
    if varied is None and record.special is not None:
        raise ValueError(f"a special point of type {record.special}, but no parameter that varies")
    interval = () if varied is None else tuple(text.strip() for text in texts[varied].split(INTERVAL))
    if varied is not None and len(interval) != 2:
        raise ValueError(f"{varied} varies, but {texts[varied]} is not an interval")
    return Statement(
        record=record,
        problem=problem,
        system=system,
        p=[ball(texts[key]) for key in system.parameters],
        arcs=arcs,
        varied=None if varied is None else system.parameters.index(varied),
        interval=interval,
        printed=_hypotheses(problem, system, record),
    )


def restore_box(statement: Statement, record: BoxRecord) -> tuple[Orbit, TiltedBox]:
    """The equations on the interval of a box, and the box.

    Raises
    ------
    ValueError
        If the box does not fit the equations.
    """
    if len(record.interval) != len(statement.interval):
        raise ValueError(f"a box states {len(record.interval)} ends of the parameter, not {len(statement.interval)}")
    if len(set(record.interval)) == 2 and not ball(record.interval[0]) < ball(record.interval[1]):
        raise ValueError(f"a box from {record.interval[0]} to {record.interval[1]}: the smaller end comes first")
    orbit = statement.orbit(record.interval)
    if orbit.size > MOST_UNKNOWNS:
        raise ValueError(f"{orbit.size} nodes and durations are more than {MOST_UNKNOWNS}")
    # decimals become balls; the theorem is about the box with these exact centres and radii
    centre, tilt = ([arb(text).mid() for text in texts] for texts in (record.centre, record.tilt))
    deviation = [arb(0, arb(text).lower()) for text in record.radii]
    if not len(centre) == len(tilt) == len(deviation) == orbit.size:
        raise ValueError(f"a box of {len(centre)} entries does not fit {orbit.size} nodes and durations")
    if not orbit.is_long and any(not v.is_zero() for v in tilt):
        raise ValueError("a box is tilted, but no parameter varies along it")
    return orbit, TiltedBox(centre, tilt, deviation)


def _hypotheses(problem: Problem, system: HybridSystem, record: CertificateRecord) -> Hypotheses:
    """The printed statement, rebuilt from the problem and the certificate's data."""
    law = problem.control
    designed = [*problem.free, *(f"control.{name}" for name in system.control.unknowns(system.walker))]
    version = law.record.get("version")
    control, curve = law.type if version is None else f"{law.type}, version {version}", None
    scuffing = "whether anything but the swing foot touches the ground, or that foot before its touchdown (scuffing)"
    not_proved = [scuffing]
    for name, target in law.targets.items():
        if isinstance(target, CurveReference):
            above = f"control.{name}."
            points = {key: text for key, text in record.parameters.items() if key.startswith(above)}
            curve = digest_of({"duration": system.control.breakpoints[0], "points": points})
            control = f"PD tracking of the Bezier curve with this SHA-256, beyond its end: {target.beyond_end}"
        elif isinstance(target, GaitReference) and record.reference is not None:
            curve = digest_of(record.reference.model_dump(mode="json"))
            control = f"PD tracking of the curve with this SHA-256, beyond its end: {target.beyond_end}"
            source = "another gait" if problem.reference is None else problem.reference.name
            not_proved.append(f"whether that curve is the motion of {source}, which the problem names")
    if problem.objective or problem.constraints:
        not_proved.append("whether the problem's constraints are met, and its objective is least")
    return {
        "sha256": problem.digest,
        "walker": problem.walker.model,
        "friction": "static and kinetic" if system.friction.may_drop else "coulomb",
        "impact_law": str(problem.impact_law),
        "mode_sequence": str(problem.cycle),
        "control": control,
        "curve_sha256": curve,
        "parameters": {key: record.parameters[key] for key in system.parameters},
        "designed": [key for key in system.parameters if key in designed],
        "not_proved": not_proved,
    }


def refuse_uncovered_walkers(problem: Problem, system: HybridSystem) -> None:
    """Refuse walkers and modes whose resets and conditions are not among the claims.

    Raises
    ------
    NotProved
        If the walker has several contacts, joint stops, flight, switches, a push-off or a closure that is not linear,
        or a mode is not that one foot sticks or slips.
    """
    walker = system.walker
    if walker.contacts:
        raise NotProved(f"{problem.name}: a {walker.model} has several contacts; proofs do not cover that")
    reasons = {
        "joint stops": walker.stops,
        "flight": walker.flies,
        "switches": walker.switches,
        "a push-off": walker.pushes,
        "a posture after its impact that Newton's method solves for": is_default(walker, "after_impact")
        and not is_linear(walker),
    }
    unknown = " and ".join(reason for reason, present in reasons.items() if present)
    if unknown:
        raise NotProved(f"{problem.name}: a {walker.model} has {unknown}; proofs do not cover that")
    for mode in (*problem.cycle.phases, *problem.cycle.impacts):
        if mode not in CONTACTS:
            raise NotProved(f"{problem.name}: proofs do not cover a phase or an impact with {mode}")


def _check_parameters(problem: Problem, system: HybridSystem, texts: dict[str, str]) -> None:
    """Require that the exact values are those of the problem, up to the rounding of its doubles."""
    if set(texts) != set(system.parameters):
        different = ", ".join(sorted(set(texts) ^ set(system.parameters))[:5])
        raise ValueError(f"its parameters are not those of its problem: {different[:200]}")
    known = {**{f"control.{key}": value for key, value in system.control.parameters.items()}, **problem.parameters}
    free = {*problem.free, *(f"control.{name}" for name in system.control.unknowns(system.walker))}
    for key in system.parameters:
        value, double = ball(texts[key]), arb(float(known[key]))
        ends = [end.strip() for end in texts[key].split(INTERVAL)]
        if len(ends) == 2:
            if type(known[key]) is int or not ball(ends[0]) < ball(ends[1]):
                raise ValueError(f"{key} cannot be the interval {texts[key]}")
            for end in ends:
                objection = key in problem.parameters and problem.objection(key, float(ball(end).mid()))
                if objection:
                    raise ValueError(f"{key} cannot be {end}: {objection}")
        rounded = abs(value - double) <= abs(double) * PARAMETER_ERROR
        if key not in free and not rounded and not (len(ends) == 2 and value.contains(double)):
            raise ValueError(f"{key} is {texts[key]} in the certificate, but {known[key]!r} in its problem")


def _check_arcs(arcs: list[OrbitArc], sequence: Cycle, table: Transitions, control: Control) -> None:
    """Require that the arcs follow the mode sequence, its events, and the breakpoints of the control law."""
    phases = [arc.phase for arc in arcs]
    if phases != sorted(phases) or set(phases) != set(range(len(sequence.phases))):
        raise ValueError("the arcs do not follow the mode sequence of the problem")
    segment = 0
    for j, arc in enumerate(arcs):
        after = arcs[j + 1].phase if j + 1 < len(arcs) else None
        mode = sequence.phases[arc.phase]
        event = BREAKPOINT if after == arc.phase else table.between(mode, sequence.after(arc.phase)).guard
        if (arc.mode, arc.event, arc.segment) != (mode, event, segment):
            raise ValueError(
                f"arc {j + 1} is {arc.mode} on segment {arc.segment} until {arc.event[:40]}, but the mode sequence of "
                f"the problem has {mode} on segment {segment} until {event}"
            )
        if event == BREAKPOINT and segment >= len(control.breakpoints):
            raise ValueError(f"arc {j + 1} ends with a breakpoint, but the control has {len(control.breakpoints)}")
        segment = 0 if event == "touchdown" else segment + (event == BREAKPOINT)
