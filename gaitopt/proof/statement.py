"""What a certificate is about: equations, mode sequence and boxes, restored and compared with its problem."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flint import arb

from gaitopt.mechanics import (
    CONTACTS,
    CoulombFriction,
    Cycle,
    HybridSystem,
    Mode,
    StaticKineticFriction,
    ending_margin,
)
from gaitopt.problem import Problem, restore_problem
from gaitopt.proof.control import restore_control
from gaitopt.proof.graph import NotProved
from gaitopt.proof.orbit import BREAKPOINT, Arc, Box, Orbit
from gaitopt.proof.parameters import INTERVAL, ball

SCHEMA = "gaitopt-proof-4"


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
    records: Sequence[Mapping[str, Any]]

    def orbit(self, interval: Sequence[str]) -> Orbit:
        """The equations on an interval of the parameter that varies."""
        ends = [ball(text) for text in interval]
        place: tuple[arb, ...] = ()
        if ends:
            half = arb(0) if interval[0] == interval[1] else (ends[1] - ends[0]) / 2
            place = ((ends[0] + ends[1]) / 2, half)
        return Orbit(self.system, self.p, self.varied, place, self.sequence, self.arcs, self.order)


def restore_statement(certificate: Mapping[str, Any]) -> Statement:
    """The statement of a certificate.

    Raises
    ------
    ValueError
        If it is of another schema, or does not fit its problem.
    NotProved
        If its modes are none that can be proved.
    """
    schema = certificate.get("schema")
    if schema != SCHEMA:
        raise ValueError(f"a certificate of the format {schema}, not {SCHEMA}: check it with the version that wrote it")
    problem = restore_problem(certificate["resolved"])
    friction = CoulombFriction() if isinstance(problem.friction, float) else StaticKineticFriction()
    control = restore_control(certificate["control"])
    system = HybridSystem(type(problem.walker), control, problem.impact_law, friction)
    refuse_what_is_not_modelled(problem, system)
    texts, varied, records = certificate["parameters"], certificate["varied"], certificate["boxes"]
    _check_parameters(problem, system, texts)
    arcs = [
        Arc(Mode(a["mode"]), a["segment"], a["phase"], a["event"], tuple(map(float, a["fractions"])))
        for a in certificate["arcs"]
    ]
    _check_arcs(arcs, problem.cycle)
    index = None if varied is None else system.parameters.index(varied)
    interval = () if varied is None else tuple(text.strip() for text in texts[varied].split(INTERVAL))
    if varied is not None and len(interval) != 2:
        raise ValueError(f"{varied} varies, but {texts[varied]} is no interval")
    p = [ball(texts[key]) for key in system.parameters]
    order, special = int(certificate["order"]), certificate["special"]
    return Statement(problem.name, system, p, problem.cycle, arcs, index, interval, order, special, records)


def restore_box(statement: Statement, record: Mapping[str, Any]) -> tuple[Orbit, Box]:
    """A box of a certificate, and the equations for it.

    Raises
    ------
    ValueError
        If it does not fit the equations.
    """
    orbit = statement.orbit(record["interval"])
    centre, tilt = ([arb(text).mid() for text in record[key]] for key in ("centre", "tilt"))
    deviation = [arb(0, arb(text).lower()) for text in record["radii"]]
    if not len(centre) == len(tilt) == len(deviation) == orbit.size or len(record["interval"]) != len(orbit.interval):
        raise ValueError(f"a box of {len(centre)} entries does not fit {orbit.size} nodes and durations")
    return orbit, Box(centre, tilt, deviation)


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


def _check_parameters(problem: Problem, system: HybridSystem, texts: Mapping[str, str]) -> None:
    """Whether the exact values are those of the problem, up to the rounding of its doubles."""
    known = {**{f"control.{key}": value for key, value in system.control.parameters.items()}, **problem.parameters}
    missing = problem.parameters.keys() - set(system.parameters)
    if missing:
        raise ValueError(f"the control of the certificate does not have the problem's {', '.join(sorted(missing))}")
    free = {*problem.free, *(f"control.{name}" for name in system.control.unknowns)}
    for key in system.parameters:
        value = ball(texts[key])
        double = arb(float(known[key]))
        near = abs(value - double) <= abs(double) * arb(2) ** -51 or (INTERVAL in texts[key] and value.contains(double))
        if key not in free and not near:
            raise ValueError(f"{key} is {texts[key]} in the certificate, but {known[key]!r} in its problem")


def _check_arcs(arcs: list[Arc], sequence: Cycle) -> None:
    """Whether the arcs follow the mode sequence and end with the events that it names."""
    phases = [arc.phase for arc in arcs]
    if phases != sorted(phases) or set(phases) != set(range(len(sequence.phases))):
        raise ValueError("the arcs do not follow the mode sequence of the problem")
    segment = 0
    for j, (arc, after) in enumerate(zip(arcs, [*phases[1:], None], strict=True)):
        mode = sequence.phases[arc.phase]
        event = BREAKPOINT if after == arc.phase else ending_margin(mode, sequence.after(arc.phase))
        if (arc.mode, arc.event, arc.segment) != (mode, event, segment):
            raise ValueError(
                f"arc {j + 1} is {arc.mode} on segment {arc.segment} until {arc.event}, but the mode sequence of the "
                f"problem has {mode} on segment {segment} until {event}"
            )
        segment = 0 if event == "touchdown" else segment + (event == BREAKPOINT)
