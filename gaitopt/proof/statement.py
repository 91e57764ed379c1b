"""The statement of a theorem, derived from the texts of a certificate by the project's own reader.

Walker, parameters, control law, friction, mode sequence, events and segments follow from the texts. Designed values are
compared with their bounds. Law data contain angles only: their rates are derived, and their pieces have to meet. Exact
values are the decimals of the texts, multiplied by pi / 180 where a text says ``deg``.
"""

import hashlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from importlib.metadata import packages_distributions, version
from itertools import pairwise, product
from math import isfinite
from typing import Any, TypedDict

import numpy as np
from casadi import Function
from flint import arb

from gaitopt.errors import ProblemError
from gaitopt.model.control import OWN_PACKAGE, Control
from gaitopt.model.curve import BeyondEnd, Curve, Piece, Row, continued
from gaitopt.model.cycle import BREAKPOINT, Cycle
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import Friction
from gaitopt.model.modes import Mode
from gaitopt.model.open_loop import OpenLoop
from gaitopt.model.reference import ARGUMENT, FORMS, CurveReference, GaitReference, Reference, TableReference
from gaitopt.model.section import TOUCHDOWN, has_stated_sections, section_of
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import Transitions, contact_of
from gaitopt.model.urdf import UrdfWalker
from gaitopt.model.walker import Walker
from gaitopt.problem.faults import shown
from gaitopt.problem.problem import Problem
from gaitopt.problem.statement import digest_of
from gaitopt.problem.writing import ExactValues, ProblemText, read_problem
from gaitopt.proof.arithmetic import INTERVAL, NotProved, ball
from gaitopt.proof.certificate import (
    MOST_UNKNOWNS,
    ArcRecord,
    BoxRecord,
    CertificateRecord,
    DurationRecord,
    MotionRecord,
    OrbitRecord,
    sha256,
)
from gaitopt.proof.identities import (
    dependent_contacts,
    is_rigid,
    modes_of_contacts,
    require_conditions,
    require_heights,
    require_same_everywhere,
)
from gaitopt.proof.law import ExactLaw, exact_law, exact_piece
from gaitopt.proof.orbit import Orbit, OrbitArc, TiltedBox

NOT_COVERED = "proofs do not cover that"
_CHOICES = {
    True: "sticking is chosen where both are consistent",
    False: "the mode in which the most contacts stick is chosen where several are consistent",
}
"""What is chosen where several modes are consistent, for a foot that stands alone and for named contacts."""
MOST_INTERVALS = 10
"""Largest number of parameters with intervals: all corners are examined, and 2^10 of them take a few seconds."""
LARGEST_JUMP = 1e-9
"""Largest jump, in natural units, where two pieces of a tracked angle meet: of the angle, and of its rate times the
length of the piece."""
REFERENCE_KEYS = {*ARGUMENT, *(kind.kind for kind in FORMS), "joints", "degree"}
"""Keys of a reference. The control points of a joint with such a name would be taken for the number of that key."""
LINK_NUMBERS = ("mass", "com", "inertia", "position", "tip", "foot_radius", "damping", "zero")
"""The numbers of each link that the printed statement about a robot from a file contains."""


class Hypotheses(TypedDict, total=False):
    """The printed statement of a theorem: its hypotheses, and the claims that are not proved.

    Attributes
    ----------
    sha256 : digest of the problem.
    texts : SHA-256 of the problem's text, and of every file that it names, by name.
    changed : values that replace those of the text, by dotted key.
    walker : model of the walker.
    walker_data : numbers of the links of a robot from a file; module, distribution and version of a walker or law from
        another package; and the SHA-256 of the CasADi expressions of either.
    friction, impact_law, mode_sequence : laws of the contact, and the modes.
    cycle_end : the event that ends a cycle, unless it is a landing: ``clock``, or the name of a margin.
    control : type of the control law.
    law : values of the law's keys that are not parameters: durations, spans, tables, tracked curves.
    parameters : exact values by dotted key; an interval for the varying one.
    designed : keys of the parameters that the problem leaves free.
    reference : the hypotheses about the gait from which the law's data come, if the certificate holds its proof.
    """

    sha256: str
    texts: dict[str, str]
    changed: dict[str, Any]
    walker: str
    walker_data: dict[str, str]
    friction: str
    impact_law: str
    mode_sequence: str
    cycle_end: str
    control: str
    law: dict[str, str]
    parameters: dict[str, str]
    designed: list[str]
    not_proved: list[str]
    reference: "Hypotheses"


@dataclass(frozen=True, slots=True)
class Statement:
    """The theorem that a certificate claims.

    Attributes
    ----------
    record : the choices, law data and search data of the certificate.
    problem : the problem, with designed torques fixed.
    law : breakpoints and segment data in balls.
    p : parameters in balls.
    cycle : the mode sequence, with the phases that end at a breakpoint of the law.
    arcs : the arcs of one cycle, in order of time.
    varied : index of the varying parameter; None if none varies.
    interval : ends of the varying parameter as texts; empty if none varies.
    special : type of the special point in the interval; None if the theorem is not about one.
    reference : the statement about the gait from which the law's data come; None if the certificate has none.
    printed : the hypotheses of the theorem, and what is not proved.
    """

    record: OrbitRecord
    problem: Problem
    system: HybridSystem
    law: ExactLaw
    p: Sequence[arb]
    cycle: Cycle
    arcs: Sequence[OrbitArc]
    varied: int | None
    interval: tuple[str, ...]
    special: str | None
    reference: "Statement | None"
    printed: Hypotheses

    @property
    def own_duration(self) -> float | None:
        """The duration of open-loop torques that a design finds [s]; None for other laws."""
        law = self.record.law
        return law.duration if isinstance(law, DurationRecord) and isinstance(self.problem.control, OpenLoop) else None

    def orbit(self, interval: Sequence[str]) -> Orbit:
        """The equations of the orbit on an interval of the varying parameter."""
        ends = [ball(text) for text in interval]
        middle_and_half: tuple[arb, ...] = ()
        if ends:
            half = arb(0) if interval[0] == interval[1] else (ends[1] - ends[0]) / 2
            middle_and_half = ((ends[0] + ends[1]) / 2, half)
        return Orbit(
            self.system, self.law, self.p, self.varied, middle_and_half, self.cycle, self.arcs, self.record.order
        )


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
        If the texts are not those of a valid problem, or if choices, law data or search data contradict them.
    NotProved
        If the claims do not cover the walker, its law or one of its modes.
    """
    source = record.problem.source
    problem = read_problem(source, walkers=walkers, controls=controls)
    return _restore(record, problem, source, record.intervals, record.varied, record.special)


def _restore(
    record: OrbitRecord,
    problem: Problem,
    source: ProblemText,
    intervals: Mapping[str, str],
    varied: str | None = None,
    special: str | None = None,
) -> Statement:
    """The statement about one problem; raises the errors of ``restore_statement``."""
    if problem.is_open:
        raise ValueError(f"{problem.name}: the mode sequence is open")
    if problem.control.step_feedback is not None:
        raise NotProved("feedback from step to step is not covered; prove the gait of the problem without it")
    exact, designed = ExactValues(source), _designed(problem, record.designed, intervals)
    stated, problem = problem, _with_torques(problem, record, designed)
    control = _completed(problem.control, problem, record, is_fixed=problem is not stated)
    end = problem.cycle_end
    system = HybridSystem(type(problem.walker), control, problem.impact_law, problem.friction_law, end)
    refuse_uncovered_walkers(problem, system)
    texts = _parameter_texts(problem, system, exact, designed, intervals)
    duration = record.law.duration if isinstance(record.law, DurationRecord) else None
    law, p = exact_law(control, exact, duration), [ball(texts[key]) for key in system.parameters]
    if isinstance(record.law, MotionRecord):
        _require_joints(control, natural_length(system, p), system)
    if varied is not None and varied not in intervals:
        raise ValueError(f"{varied} varies, but it has no interval")
    if varied is None and special is not None:
        raise ValueError(f"a special point of type {special}, but no parameter that varies")
    interval = () if varied is None else tuple(text.strip() for text in intervals[varied].split(INTERVAL))
    reference = _restore_reference(record, problem, source)
    printed = _hypotheses(stated, system, source, record, exact, texts, sorted(designed))
    if reference is not None:
        name, silent = reference.problem.name, reference.printed["not_proved"]
        printed["reference"] = reference.printed
        printed["not_proved"] += [f"{name}: {claim}" for claim in silent if claim not in printed["not_proved"]]
    cycle = _timed(record.arcs, problem.cycle)
    return Statement(
        record=record,
        problem=problem,
        system=system,
        law=law,
        p=p,
        cycle=cycle,
        arcs=_arcs(record.arcs, cycle, system.transitions, control),
        varied=None if varied is None else system.parameters.index(varied),
        interval=interval,
        special=special,
        reference=reference,
        printed=printed,
    )


def _restore_reference(record: OrbitRecord, problem: Problem, source: ProblemText) -> Statement | None:
    """The statement about the gait from which the law's data come."""
    if record.reference is None:
        return None
    if record.law is None or problem.reference is None:
        raise ValueError("it holds the proof of another gait, from which its law takes nothing")
    (text,) = source.problems.values()
    return _restore(record.reference, problem.reference, text, {})


def _designed(problem: Problem, values: Mapping[str, str], intervals: Mapping[str, str]) -> dict[str, str]:
    """Values or intervals of the parameters that the problem leaves free, within their bounds."""
    unknowns = {key: (free.lower, free.upper) for key, free in problem.free.items()}
    unknowns |= {f"control.{key}": span for key, span in problem.control.unknowns(type(problem.walker)).items()}
    twice, given = {*values} & {*intervals}, {**values, **{key: intervals[key] for key in intervals if key in unknowns}}
    if different := sorted(twice | ({*given} ^ {*unknowns})):
        keys = ", ".join(different[:5])[:200]
        raise ValueError(f"the designed values are not those that its problem leaves free: {keys}")
    for key, (lower, upper) in unknowns.items():
        for text in given[key].split(INTERVAL):
            value = float(ball(text.strip()).mid())
            exact = ball(text.strip())
            bounds = [(side, bound) for side, bound in ((-1, lower), (1, upper)) if isfinite(bound)]
            if any(side * exact > side * ball(repr(bound)) for side, bound in bounds):  # bounds are decimals too
                raise ValueError(f"{key} is designed to be {text}, outside of its bounds [{lower!r}, {upper!r}]")
            if key in problem.free and (objection := problem.objection(key, value)):
                raise ValueError(f"{key} cannot be {text}: {objection}")
    if problem.free:
        try:  # all of them together
            problem.with_fixed({key: float(ball(given[key]).mid()) for key in problem.free})
        except ProblemError as error:
            raise ValueError(f"the designed values contradict each other: {error}") from error
    return given


def _with_torques(problem: Problem, record: OrbitRecord, designed: Mapping[str, str]) -> Problem:
    """The problem with its free open-loop torques replaced by their designed values."""
    law = problem.control
    if not isinstance(law, OpenLoop) or law.duration is not None:
        return problem
    if not isinstance(record.law, DurationRecord):
        raise ValueError(f"the torques of {problem.name} are unknowns, but the certificate states no duration of them")
    values = {key: float(ball(text).mid()) for key, text in designed.items()}
    fixed = law.fixed(values, record.law.duration)
    return replace(problem, control=fixed, objective={}, constraints={})  # they chose the torques


def _completed(law: Control, problem: Problem, record: OrbitRecord, *, is_fixed: bool) -> Control:
    """The control law of a problem, completed by the law data of a certificate.

    Parameters
    ----------
    is_fixed : whether the law data have already been used as the duration of torques.

    Raises
    ------
    ValueError
        If the law needs other data, needs none, or the data contradict the problem.
    """
    stated = law.targets
    completed = {name: _completed_reference(each, law, problem, record.law) for name, each in stated.items()}
    bound = {name: each for name, each in completed.items() if each is not stated[name]}
    over_clock = (each for each in bound.values() if not each.motion().phase)
    used = any(not isinstance(each, CurveReference) or each.curve.duration is None for each in over_clock)
    if record.law is not None and not (used or is_fixed):
        raise ValueError(f"it states data of a control law, of which the {law.type} of its problem needs none")
    return law.model_copy(update=bound) if bound else law


def _completed_reference(
    reference: Reference, law: Control, problem: Problem, data: MotionRecord | DurationRecord | None
) -> Reference:
    """A reference completed by the law data of a certificate; raises the errors of ``_completed``."""
    walker = type(problem.walker)
    for name in reference.names:
        if name in REFERENCE_KEYS:
            raise NotProved(f"a joint is called {name}, which is a key of references: not covered; rename it")
    if isinstance(reference, CurveReference):
        zeros, phase, duration = reference.zeros(walker), law.phase_variable, reference.curve.duration
        if phase:
            span = reference.span or getattr(law, "span", None)
            if span is None:
                raise NotProved(
                    f"the curves over {phase} take their span from another gait; state it: span: [START, END]"
                )
            return reference.with_points(zeros, (span[0], span[1]), phase)
        if duration is None:
            if not isinstance(data, DurationRecord):
                raise ValueError("its curve takes as long as a step of another gait, but it states no duration")
            duration = data.duration
        return reference.with_points(zeros, (0.0, duration), phase)
    if not isinstance(reference, GaitReference):
        return reference
    if law.phase_variable or reference.beyond_end is None:
        raise NotProved(
            "the control law tracks another gait as a function of a phase variable: not covered; "
            "give its control points, reference: {bezier: ...}"
        )
    if not isinstance(data, MotionRecord):
        raise ValueError("its problem tracks the motion of another gait, which it does not contain")
    return reference.with_curve(_tracked_motion(data, reference.followers(walker), reference.beyond_end))


def _tracked_motion(record: MotionRecord, joints: tuple[str, ...], beyond_end: BeyondEnd) -> Curve:
    """The tracked motion of a certificate, extended beyond its end by the problem's rule.

    Raises
    ------
    ValueError
        If its pieces do not follow each other, or do not state a series for every joint.
    """
    edges = [0.0, *(piece.end for piece in record.pieces)]
    if any(
        piece.start != edge or not piece.end > piece.start for piece, edge in zip(record.pieces, edges, strict=False)
    ):
        raise ValueError("the pieces of its reference do not follow each other from time zero")
    for k, piece in enumerate(record.pieces, start=1):
        if len(piece.angles) != len(joints) or len({len(row) for row in piece.angles}) > 1:
            raise ValueError(f"piece {k} of its reference does not state the motion of {len(joints)} joints")
    pieces = tuple(
        Piece(start=piece.start, end=piece.end, rows=tuple(map(tuple, piece.angles))) for piece in record.pieces
    )
    if beyond_end is BeyondEnd.FLOW:
        return Curve(names=joints, pieces=pieces, horizon=pieces[-1].end, beyond_end=beyond_end)
    return continued(joints, pieces, pieces[-1].end, beyond_end)


def _require_joints(control: Control, length: float, system: HybridSystem) -> None:
    """Require that tracked angles and their rates are continuous where two pieces meet."""
    for reference in control.targets.values():
        if not isinstance(reference, GaitReference):
            continue
        motion = reference.motion()
        for k, (one, other) in enumerate(pairwise(map(exact_piece, motion.stated)), start=2):
            jumps = _jumps(one.rows, other.rows), _jumps(one.slopes, other.slopes)
            for name, jump, rate in zip(motion.names, *jumps, strict=True):
                largest = LARGEST_JUMP * (length if name in system.walker.lengths else 1.0)
                if not (abs(jump) < largest and abs(rate * (one.end - one.start)) < largest):
                    start = motion.pieces[k - 1].start
                    raise ValueError(f"the reference of {name} jumps where its piece {k} starts, at {start!r} s")


def _jumps(before: Sequence[Row], after: Sequence[Row]) -> list[arb]:
    """The end of each series, where T_k is 1, minus the start of the next one, where T_k is (-1)^k."""
    starts = (sum((-c if k % 2 else c for k, c in enumerate(row)), arb(0)) for row in after)
    return [sum(row, arb(0)) - start for row, start in zip(before, starts, strict=True)]


def natural_length(system: HybridSystem, p: Sequence[arb]) -> float:
    """Natural unit of length, about the length of a leg [m]."""
    return Dynamics(system, np.array([float(value.mid()) for value in p])).scales.length


def refuse_uncovered_walkers(problem: Problem, system: HybridSystem) -> None:
    """Refuse walkers and modes whose resets and conditions are not among the claims.

    Raises
    ------
    NotProved
        If no claim covers the walker, one of its modes, or the end of its cycle; the message says why.
    """
    walker, name = system.walker, problem.name
    if walker.placed_contacts():
        feature = "massless contacts with coordinates of their own, whose forces do not follow from accelerations"
        raise NotProved(f"{name}: a {walker.model} has {feature}; {NOT_COVERED}")
    if any(mode.is_named != bool(walker.contacts) for mode in problem.cycle.phases):
        raise NotProved(f"{name}: both feet are on the ground in a phase; proofs cover feet that stand alone")
    require_heights(walker)
    for mode in problem.cycle.phases:
        for other in modes_of_contacts(system, mode) if walker.contacts else (mode,):
            dependent_contacts(walker, other)
    section = system.section(problem.cycle)
    require_conditions(walker, section)
    require_same_everywhere(walker, section)
    if walker.stands_on_one():
        landing = section_of(walker, problem.cycle.phases[-1], problem.cycle.impact, TOUCHDOWN)
        is_solved, feature = not landing.is_explicit, "a posture after its impact that Newton's method solves for"
        if is_solved and walker.section_rates is not None:
            raise NotProved(f"{name}: a {walker.model} has {feature}, and rates that follow from others; {NOT_COVERED}")
        if is_solved and problem.cycle_end != TOUCHDOWN:
            raise NotProved(f"{name}: a {walker.model} has {feature}, and lands within its cycle; {NOT_COVERED}")
    if "energy" in walker.model_fields and not section.is_explicit:
        raise NotProved(f"{name}: its energy is a parameter, and a condition of its section; {NOT_COVERED}")


def _parameter_texts(
    problem: Problem,
    system: HybridSystem,
    exact: ExactValues,
    designed: Mapping[str, str],
    intervals: Mapping[str, str],
) -> dict[str, str]:
    """The exact value of every parameter: its interval, its designed value, or its number in the problem's text."""
    known = {**{f"control.{key}": value for key, value in system.control.parameters.items()}, **problem.parameters}
    unknown = [key for key in intervals if key not in system.parameters]
    if unknown:
        raise ValueError(f"no parameter is called {shown(unknown[0])}")
    for key, text in intervals.items():
        ends = [end.strip() for end in text.split(INTERVAL)]
        if type(known[key]) is int or not ball(ends[0]) < ball(ends[1]):
            raise ValueError(f"{key} cannot be the interval {text}")
        for end in ends:
            objection = key in problem.parameters and problem.objection(key, float(ball(end).mid()))
            if objection:
                raise ValueError(f"{key} cannot be {end}: {objection}")
    _check_corners(problem, designed, {key: text for key, text in intervals.items() if key in problem.parameters})
    given = {**designed, **intervals}
    texts = {key: given[key] if key in given else exact(key, known[key]) for key in system.parameters}
    law = system.friction
    for each in (law,) if isinstance(law, Friction) else [of_contact for _, of_contact in law.laws]:
        static, kinetic = texts[each.static], texts[each.kinetic]
        if not each.may_drop:
            continue
        equal = static == kinetic and INTERVAL not in static
        if not equal and not ball(kinetic) <= ball(static):
            raise ValueError(f"kinetic friction, {kinetic}, may be above static friction, {static}")
    if problem.cycle_end != TOUCHDOWN or len(problem.cycle.steps) % 2:  # the doubles are the same
        swapped = law.exchanged(system.walker.partners()) if system.walker.step_ends() else ()
        for key, k in zip(law.parameters, swapped, strict=False):
            one, other = texts[key], texts[law.parameters[k]]
            if one != other and (INTERVAL in one + other or Fraction(one) != Fraction(other)):
                raise ValueError(f"contacts that swap roles have different friction, {one} and {other}")
    return texts


def _check_corners(problem: Problem, designed: Mapping[str, str], intervals: Mapping[str, str]) -> None:
    """Refuse intervals if the parameters at one of their corners contradict each other."""
    if len(intervals) > MOST_INTERVALS:
        raise ValueError(f"{len(intervals)} parameters have intervals, at most {MOST_INTERVALS} may have one")
    if problem.free:
        problem = problem.with_fixed({key: float(ball(designed[key]).mid()) for key in problem.free})
    ends = ([float(ball(end.strip()).mid()) for end in text.split(INTERVAL)] for text in intervals.values())
    for corner in product(*ends):
        try:
            problem.replace(dict(zip(intervals, corner, strict=True)))
        except ProblemError as error:
            raise ValueError(f"the intervals contain values that contradict each other: {error}") from error


def _timed(records: Sequence[ArcRecord], sequence: Cycle) -> Cycle:
    """The mode sequence with the phases that end at a breakpoint of the control law.

    Raises
    ------
    ValueError
        If such a phase is the last one of its step, or an arc within its phase is said to end it.
    """
    timed = {record.phase for record in records if record.timed}
    last = {record.phase: record for record in records}
    for record in (record for record in records if record.timed):
        is_inner = record.phase < len(sequence.phases) and sequence.after(record.phase) is not None
        if record is not last[record.phase] or not is_inner or sequence.reset_after(record.phase) is not None:
            raise ValueError(f"phase {record.phase + 1} cannot end at a breakpoint of the control law")
    return sequence.with_timed(timed)


def _arcs(records: Sequence[ArcRecord], sequence: Cycle, table: Transitions, control: Control) -> list[OrbitArc]:
    """The arcs of one cycle. Two arcs of a phase meet at a breakpoint of the law; the last one ends with its event.

    Raises
    ------
    ValueError
        If the arcs do not follow the mode sequence, or need more breakpoints than the law has.
    """
    phases = [record.phase for record in records]
    if phases != sorted(phases) or set(phases) != set(range(len(sequence.phases))):
        raise ValueError("the arcs do not follow the mode sequence of the problem")
    arcs, segment = list[OrbitArc](), 0
    for record, after in zip(records, [*phases[1:], None], strict=True):
        mode, ends_phase = sequence.phases[record.phase], after != record.phase
        row = table.ending(sequence, record.phase) if ends_phase else table.at_breakpoint(mode)
        if ends_phase:
            _require_change(sequence, record.phase, table)
        if row.guard == BREAKPOINT and segment >= len(control.breakpoints):
            raise ValueError(
                f"arc {len(arcs) + 1} ends with a breakpoint, but the control has {len(control.breakpoints)}"
            )
        zeros = row.zeros
        if not table.walker.massless_feet:  # those of contacts of other bodies are zero in a symmetric motion only
            names = [name for name in zeros[1:] if is_rigid(table.walker, (contact_of(zeros[0]), contact_of(name)))]
            zeros = (*zeros[:1], *names)
        arcs.append(OrbitArc(mode, segment, record.phase, row.guard, zeros, ends_phase, tuple(record.fractions)))
        segment = 0 if row.ends_step else segment + (row.guard == BREAKPOINT)
    return arcs


def _require_change(sequence: Cycle, phase: int, table: Transitions) -> None:
    """Require that the event that ends a phase explains the next mode; it is the only equation there.

    Raises
    ------
    ValueError
        If a timed phase ends with a slip that stops or turns, or a switch that triggers, without its own event.
    NotProved
        If two or more contacts land, or stop without being parts of one body, at the same instant.
    """
    mode, after, struck = sequence.phases[phase], sequence.after(phase), table.struck(sequence, phase)
    row = table.ending(sequence, phase)
    if row.guard == BREAKPOINT and after not in row.candidates:
        raise ValueError(
            f"{sequence.phase_words(phase)} cannot end at a breakpoint of the control law, as {after} follows"
        )
    landed = () if struck is None else tuple(name for name in struck.touching if name not in mode.touching)
    for names, what in ((landed, "land"), (sequence.stop_together(phase), "stop")):
        if len(names) > 1 and not (what == "stop" and is_rigid(table.walker, names)):
            raise NotProved(f"{' and '.join(names)} {what} at one instant; {NOT_COVERED}")


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


# the printed statement


def _hypotheses(
    problem: Problem,
    system: HybridSystem,
    source: ProblemText,
    record: OrbitRecord,
    exact: ExactValues,
    texts: Mapping[str, str],
    designed: list[str],
) -> Hypotheses:
    """The printed statement about a problem that law data and designed values complete."""
    scuffing = "whether anything but the swing foot touches the ground, or that foot before its touchdown (scuffing)"
    if problem.walker.contacts:
        scuffing = "whether anything but the contacts touches the ground, or a contact in a posture in which none lands"
    not_proved = [scuffing]
    if isinstance(record.law, MotionRecord) and record.reference is None:
        name = problem.control.source[0]
        not_proved.append(f"whether the tracked curve is the motion of {name}, which the problem names")
    if problem.objective or problem.constraints:
        not_proved.append("whether the problem's constraints are met, and its objective is least")
    return {
        "sha256": problem.digest,
        "texts": dict(_text_digests(problem.name, source)),
        "changed": dict(_changes("", source)),
        "walker": problem.walker.model,
        "walker_data": _provenance(problem, system),
        "friction": f"static and kinetic; {_CHOICES[problem.walker.stands_on_one()]}"
        if system.friction.may_drop
        else "coulomb",
        "impact_law": str(problem.impact_law),
        "mode_sequence": str(problem.cycle),
        **({} if problem.cycle_end == TOUCHDOWN else {"cycle_end": problem.cycle_end}),
        "control": problem.control.type,
        "law": _law_texts(problem.control, system.control, record, exact),
        "parameters": {key: texts[key] for key in system.parameters},
        "designed": [key for key in system.parameters if key in designed],
        "not_proved": not_proved,
    }


def _text_digests(name: str, source: ProblemText) -> list[tuple[str, str]]:
    """Digests of all texts; a file is named after the problem that names it."""
    digests = [(name, sha256(source.text)), *((f"{name}: {file}", sha256(text)) for file, text in source.files.items())]
    for reference, text in source.problems.items():
        digests += _text_digests(f"{name}: {reference}", text)
    return digests


def _changes(above: str, source: ProblemText) -> list[tuple[str, Any]]:
    """Changed values of a problem and of those that it names, by dotted key after their names."""
    changes = [(f"{above}{key}", value) for key, value in source.changes.items()]
    for reference, text in source.problems.items():
        changes += _changes(f"{above}{reference}: ", text)
    return changes


def _law_texts(law: Control, completed: Control, record: OrbitRecord, exact: ExactValues) -> dict[str, str]:
    """The entries of a control law that are not parameters, with exact values and whole tables."""
    texts = dict[str, str]()

    def add(key: str, value: Any) -> None:
        if f"control.{key}" in parameters:
            return
        if isinstance(value, Mapping) and {*value} == {"file", "text"}:
            texts[key] = f"{value['file']}, SHA-256 {sha256(value['text'])}"
            return
        if isinstance(value, Mapping | list):
            for name, entry in value.items() if isinstance(value, Mapping) else enumerate(value):
                add(f"{key}.{name}", entry)
        else:
            number = isinstance(value, float) or (isinstance(value, int) and not isinstance(value, bool))
            is_double = number and not law.__module__.startswith(OWN_PACKAGE)
            texts[key] = (
                f"{value!r}, a double" if is_double else exact(f"control.{key}", value) if number else str(value)
            )

    parameters = {f"control.{key}" for key in (*law.parameters, *completed.parameters)}
    parameters |= {key.replace("reference.", "reference.bezier.", 1) for key in parameters}
    for key, value in law.record.items():
        if key != "type":
            add(key, value)
    for name, reference in completed.targets.items():
        if isinstance(reference, TableReference):
            for column, cells in reference.table.decimals.items():
                texts[f"{name}.table.{column}"] = ", ".join(cells)
            if reference.degree is None:
                texts[f"{name}.curve"] = "cubic spline through all rows, twice differentiable, not-a-knot"
    if isinstance(record.law, DurationRecord):
        texts["duration"] = f"{record.law.duration!r}, an exact double"
    elif isinstance(record.law, MotionRecord):
        texts["curve_sha256"] = digest_of(record.law.model_dump(mode="json"))
        texts["curve"] = "Chebyshev series with exact doubles; rates are their derivatives"
        texts["pieces"] = ", ".join(repr(piece.start) for piece in record.law.pieces)
        texts["end"] = repr(record.law.pieces[-1].end)
    return texts


def _provenance(problem: Problem, system: HybridSystem) -> dict[str, str]:
    """Identifies equations that do not come from this package: links of a robot's file, modules, and a digest."""
    origins, walker = dict[str, str](), type(problem.walker)
    if issubclass(walker, UrdfWalker):
        origins["walker"] = f"robot in the file {walker.file}, with the feet {' and '.join(walker.feet)}"
        for link in walker.bodies:
            numbers = ((name, getattr(link, name)) for name in LINK_NUMBERS)
            origins[f"link {link.name}"] = ", ".join(
                f"{name} {_plain(value)}" for name, value in numbers if value is not None
            )
    for kind, plugin in (("walker", walker), ("control", type(problem.control))):
        included = getattr(sys.modules.get(plugin.__module__), plugin.__name__, None) is plugin
        if not (f"{plugin.__module__}.".startswith(OWN_PACKAGE) and included) and kind not in origins:
            origins[kind] = _origin(plugin)
    if origins:
        origins["expressions_sha256"] = expressions_digest(system, problem.cycle)
    return origins


def _plain(value: Any) -> str:
    return repr(np.asarray(value, dtype=float).tolist()).replace("'", "")


@cache
def _distributions() -> Mapping[str, list[str]]:
    """The distributions of every importable package; to list them takes a quarter of a second."""
    return packages_distributions()


def _origin(plugin: type) -> str:
    """Module, distribution and version of a class from another package."""
    names = _distributions().get(plugin.__module__.partition(".")[0], [])
    distribution = f"{names[0]} {version(names[0])}" if names else "no distribution"
    return f"{plugin.__module__}:{plugin.__qualname__}, {distribution}, version {getattr(plugin, 'version', 'none')}"


def expressions_digest(system: HybridSystem, cycle: Cycle) -> str:
    """SHA-256 of the scalar operations of flow, margins, impacts and section, with their constants."""
    functions: list[Function] = []
    for mode in dict.fromkeys(cycle.phases):
        functions += [system.flow(mode), system.margins(mode)]
    functions += [system.lift] if has_stated_sections(system.walker, system.cycle_end) else []
    resets = dict[Mode, tuple[Mode, Mode, bool]]()
    for phase, before in enumerate(cycle.phases):
        if (struck := system.transitions.struck(cycle, phase)) is not None:
            resets.setdefault(struck, (struck, before, cycle.after(phase) is None))
    for struck, before, ends_step in resets.values():
        functions += [system.reset(struck, before, ends_step=ends_step), system.impact_margins(struck, before)]
    digest = hashlib.sha256()
    for function in functions:
        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            inputs, outputs = function.instruction_input(k), function.instruction_output(k)
            constant = function.instruction_constant(k) if not inputs else ""
            digest.update(repr((operation, inputs, outputs, constant)).encode())
    return digest.hexdigest()
