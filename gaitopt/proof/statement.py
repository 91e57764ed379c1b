"""What a certificate is about: equations, mode sequence and boxes, rebuilt from its problem or compared with it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flint import arb

from gaitopt.mechanics import (
    CONTACTS,
    Control,
    CoulombFriction,
    Cycle,
    HybridSystem,
    Mode,
    StaticKineticFriction,
    ending_margin,
)
from gaitopt.problem import CurveReference, PDSpec, Problem
from gaitopt.proof.certificate import (
    MOST_UNKNOWNS,
    BoxRecord,
    CertificateRecord,
    certified_control,
    certified_problem,
    digest,
)
from gaitopt.proof.graph import NotProved
from gaitopt.proof.orbit import BREAKPOINT, Arc, Box, Orbit
from gaitopt.proof.parameters import INTERVAL, ball


@dataclass(frozen=True, slots=True)
class Statement:
    """What is to be proved.

    Attributes
    ----------
    p : parameters in balls.
    varied : index of the parameter along which a family is followed, if one is.
    interval : its ends as texts; empty where nothing varies.
    order : of the integration.
    special : type of the special point that is bracketed, if one is.
    records : of the boxes, in order of the parameter.
    words : the hypotheses of the theorem as they are printed, and what it does not say.
    """

    name: str
    system: HybridSystem
    p: Sequence[arb]
    sequence: Cycle
    arcs: Sequence[Arc]
    varied: int | None
    interval: tuple[str, ...]
    order: int
    special: str | None
    records: Sequence[BoxRecord]
    words: dict[str, Any]

    def orbit(self, interval: Sequence[str]) -> Orbit:
        """The equations on an interval of the parameter that varies."""
        ends = [ball(text) for text in interval]
        place: tuple[arb, ...] = ()
        if ends:
            half = arb(0) if interval[0] == interval[1] else (ends[1] - ends[0]) / 2
            place = ((ends[0] + ends[1]) / 2, half)
        return Orbit(self.system, self.p, self.varied, place, self.sequence, self.arcs, self.order)


def restore_statement(record: CertificateRecord) -> Statement:
    """The statement of a certificate.

    Raises
    ------
    ValueError
        If it does not fit its problem.
    NotProved
        If its modes are none that can be proved.
    """
    problem = certified_problem(record)
    friction = CoulombFriction() if isinstance(problem.friction, float) else StaticKineticFriction()
    control = certified_control(problem, record.reference)
    system = HybridSystem(type(problem.walker), control, problem.impact_law, friction)
    refuse_what_is_not_modelled(problem, system)
    texts, varied = record.parameters, record.varied
    _check_parameters(problem, system, texts)
    arcs = [Arc(Mode(a.mode), a.segment, a.phase, a.event, tuple(a.fractions)) for a in record.arcs]
    _check_arcs(arcs, problem.cycle, control)
    if varied is not None and varied not in texts:
        raise ValueError(f"no parameter is called {varied}")
    if varied is None and record.special is not None:
        raise ValueError(f"a special point of type {record.special}, but no parameter that varies")
    interval = () if varied is None else tuple(text.strip() for text in texts[varied].split(INTERVAL))
    if varied is not None and len(interval) != 2:
        raise ValueError(f"{varied} varies, but {texts[varied]} is no interval")
    return Statement(
        name=problem.name,
        system=system,
        p=[ball(texts[key]) for key in system.parameters],
        sequence=problem.cycle,
        arcs=arcs,
        varied=None if varied is None else system.parameters.index(varied),
        interval=interval,
        order=record.order,
        special=record.special,
        records=record.boxes,
        words=_words(problem, system, record),
    )


def restore_box(statement: Statement, record: BoxRecord) -> tuple[Orbit, Box]:
    """A box of a certificate, and the equations for it.

    Raises
    ------
    ValueError
        If it does not fit the equations.
    """
    if len(record.interval) != len(statement.interval):
        raise ValueError(f"a box states {len(record.interval)} ends of the parameter, not {len(statement.interval)}")
    if len(set(record.interval)) == 2 and not ball(record.interval[0]) < ball(record.interval[1]):
        raise ValueError(f"a box from {record.interval[0]} to {record.interval[1]}: the smaller end comes first")
    orbit = statement.orbit(record.interval)
    if orbit.size > MOST_UNKNOWNS:
        raise ValueError(f"{orbit.size} nodes and durations are more than {MOST_UNKNOWNS}")
    centre, tilt = ([arb(text).mid() for text in texts] for texts in (record.centre, record.tilt))
    deviation = [arb(0, arb(text).lower()) for text in record.radii]
    if not len(centre) == len(tilt) == len(deviation) == orbit.size:
        raise ValueError(f"a box of {len(centre)} entries does not fit {orbit.size} nodes and durations")
    if not orbit.is_long and any(not v.is_zero() for v in tilt):
        raise ValueError("a box is tilted, but no parameter varies along it")
    return orbit, Box(centre, tilt, deviation)


def _words(problem: Problem, system: HybridSystem, record: CertificateRecord) -> dict[str, Any]:
    """The hypotheses of the theorem, and what it does not say about this problem."""
    spec, designed = problem.control, [*problem.free, *(f"control.{name}" for name in system.control.unknowns)]
    control, curve = str(spec.type), None
    silent = ["whether anything but the swing foot touches the ground, and that foot before its touchdown (scuffing)"]
    if isinstance(spec, PDSpec) and isinstance(spec.reference, CurveReference):
        points = {key: text for key, text in record.parameters.items() if key.startswith("control.reference.")}
        curve = digest({"duration": system.control.breakpoints[0], "points": points})
        control = f"PD tracking of the Bezier curve with this SHA-256, beyond its end: {spec.reference.beyond_end}"
    elif isinstance(spec, PDSpec) and record.reference is not None:
        curve = digest(record.reference.model_dump(mode="json"))
        control = f"PD tracking of the curve with this SHA-256, beyond its end: {spec.reference.beyond_end}"
        source = "another gait" if problem.reference is None else problem.reference.name
        silent.append(f"whether that curve is the motion of {source}, which the problem names")
    if problem.objective or problem.constraints:
        silent.append("whether the problem's constraints are met, and its objective is least")
    return {
        "sha256": problem.digest,
        "walker": problem.walker.model,
        "friction": "static and kinetic" if system.friction.two_coefficients else "coulomb",
        "impact_law": str(problem.impact_law),
        "mode_sequence": str(problem.cycle),
        "control": control,
        "curve_sha256": curve,
        "parameters": {key: record.parameters[key] for key in system.parameters},
        "designed": [key for key in system.parameters if key in designed],
        "not_proved": silent,
    }


def refuse_what_is_not_modelled(problem: Problem, system: HybridSystem) -> None:
    """Refuse a walker with modes that no proof here knows.

    Raises
    ------
    NotProved
        If it has joint stops, flight, switches or a push-off, or another mode than that one foot sticks or slips.
    """
    walker = system.walker
    reasons = {
        "joint stops": walker.stops,
        "flight": walker.flies,
        "switches": walker.switches,
        "a push-off": walker.pushes,
    }
    unknown = " and ".join(reason for reason, present in reasons.items() if present)
    if unknown:
        raise NotProved(f"{problem.name}: a {walker.model} has {unknown}, of which nothing can be proved")
    for mode in (*problem.cycle.phases, *problem.cycle.impacts):
        if mode not in CONTACTS:
            raise NotProved(f"{problem.name}: nothing can be proved about a phase or an impact with {mode}")


def _check_parameters(problem: Problem, system: HybridSystem, texts: dict[str, str]) -> None:
    """Whether the exact values are those of the problem, up to the rounding of its doubles."""
    if set(texts) != set(system.parameters):
        different = ", ".join(sorted(set(texts) ^ set(system.parameters))[:5])
        raise ValueError(f"its parameters are not those of its problem: {different[:200]}")
    known = {**{f"control.{key}": value for key, value in system.control.parameters.items()}, **problem.parameters}
    free = {*problem.free, *(f"control.{name}" for name in system.control.unknowns)}
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
        near = abs(value - double) <= abs(double) * arb(2) ** -51 or (len(ends) == 2 and value.contains(double))
        if key not in free and not near:
            raise ValueError(f"{key} is {texts[key]} in the certificate, but {known[key]!r} in its problem")


def _check_arcs(arcs: list[Arc], sequence: Cycle, control: Control) -> None:
    """Whether the arcs follow the mode sequence and end with the events that it names."""
    phases = [arc.phase for arc in arcs]
    if phases != sorted(phases) or set(phases) != set(range(len(sequence.phases))):
        raise ValueError("the arcs do not follow the mode sequence of the problem")
    segment = 0
    for j, arc in enumerate(arcs):
        after = arcs[j + 1].phase if j + 1 < len(arcs) else None
        mode = sequence.phases[arc.phase]
        event = BREAKPOINT if after == arc.phase else ending_margin(mode, sequence.after(arc.phase))
        if (arc.mode, arc.event, arc.segment) != (mode, event, segment):
            raise ValueError(
                f"arc {j + 1} is {arc.mode} on segment {arc.segment} until {arc.event[:40]}, but the mode sequence of "
                f"the problem has {mode} on segment {segment} until {event}"
            )
        if event == BREAKPOINT and segment >= len(control.breakpoints):
            raise ValueError(f"arc {j + 1} ends with a breakpoint, but the control has {len(control.breakpoints)}")
        segment = 0 if event == "touchdown" else segment + (event == BREAKPOINT)
