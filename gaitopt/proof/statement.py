"""What a certificate is about: equations, mode sequence and boxes, restored and compared with its problem."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flint import arb

from gaitopt.mechanics import CoulombFriction, Cycle, HybridSystem, Mode, StaticKineticFriction, ending_margin
from gaitopt.problem import Problem, restore_problem
from gaitopt.proof.box import Box
from gaitopt.proof.control import restore_control
from gaitopt.proof.orbit import BREAKPOINT, Arc, Orbit
from gaitopt.proof.parameters import INTERVAL, ball

SCHEMA = "gaitopt-proof-2"


@dataclass(frozen=True, slots=True)
class Statement:
    """What is to be proved.

    Attributes
    ----------
    special : type of the special point that is bracketed, if one is.
    interval : ends of the interval of the parameter that varies, or nothing.
    records : of the boxes, in order of the branch.
    """

    name: str
    orbit: Orbit
    special: str | None
    interval: tuple[arb, ...]
    records: Sequence[Mapping[str, Any]]


def restore_statement(certificate: Mapping[str, Any]) -> Statement:
    """The statement of a certificate.

    Raises
    ------
    ValueError
        If it is of another schema, or does not fit its problem.
    """
    if certificate.get("schema") != SCHEMA:
        raise ValueError(f"not a certificate of the schema {SCHEMA}")
    problem = restore_problem(certificate["resolved"])
    friction = CoulombFriction() if isinstance(problem.friction, float) else StaticKineticFriction()
    control = restore_control(certificate["control"])
    system = HybridSystem(type(problem.walker), control, problem.impact_law, friction)
    texts, varied, records = certificate["parameters"], certificate["varied"], certificate["boxes"]
    _check_parameters(problem, system, texts)
    arcs = [Arc(Mode(a["mode"]), a["segment"], a["phase"], a["event"], ()) for a in certificate["arcs"]]
    _check_arcs(arcs, problem.cycle)
    index = None if varied is None else system.parameters.index(varied)
    interval = () if varied is None else tuple(ball(text.strip()) for text in texts[varied].split(INTERVAL))
    if varied is not None and len(interval) != 2:
        raise ValueError(f"{varied} varies, but {texts[varied]} is no interval")
    orbit = Orbit(system, [ball(texts[key]) for key in system.parameters], problem.cycle, arcs, index)
    return Statement(problem.name, orbit, certificate["special"], interval, records)


def restore_box(orbit: Orbit, record: Mapping[str, Any]) -> Box:
    """A box of a certificate.

    Raises
    ------
    ValueError
        If it does not fit the equations.
    """
    centre = [arb(text).mid() for text in record["centre"]]
    along, tangent = record["along"], [arb(float(entry)) for entry in record["tangent"]]
    radii = [arb(0, arb(text).lower()) for text in record["radii"]]
    n = len(orbit.names)
    fits = along is None and not tangent if orbit.varied is None else along in range(n) and len(tangent) == n
    if not len(centre) == len(radii) == n or not fits or (tangent and tangent[along] != 1):
        raise ValueError(f"a box of {len(centre)} entries does not fit the unknowns {', '.join(orbit.names)}")
    return Box(centre, radii, along, tangent)


def restore_arcs(orbit: Orbit, record: Mapping[str, Any]) -> list[Arc]:
    """The arcs with the steps of a box."""
    return [
        Arc(arc.mode, arc.segment, arc.phase, arc.event, tuple(map(float, steps)))
        for arc, steps in zip(orbit.arcs, record["steps"], strict=True)
    ]


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
