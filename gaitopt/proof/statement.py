"""What a certificate is about: equations, mode sequence and boxes, rebuilt from its problem or compared with it.

The exact values that a theorem is about: decimals as the problem's file writes them, and pi where it writes deg.

What a file does not state as a number, an override or a value that a design has found, counts as the shortest decimal
of its double.

A theorem about a gait or a family of gaits: its claims, its bounds, and whether all of it is proved.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from typing import Any

from flint import acb, arb, arb_mat
from ruamel.yaml import YAML
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode

from gaitopt.model.control import Control
from gaitopt.model.cycle import Cycle
from gaitopt.model.friction import CoulombFriction, StaticKineticFriction
from gaitopt.model.margins import ending_margin
from gaitopt.model.modes import CONTACTS, Mode
from gaitopt.model.system import HybridSystem
from gaitopt.model.units import parse_angle
from gaitopt.problem.problem import Problem
from gaitopt.problem.schema import CurveReference, PDSpec
from gaitopt.proof.certificate import (
    EXACT_VALUE,
    MOST_UNKNOWNS,
    BoxRecord,
    CertificateRecord,
    certified_control,
    certified_problem,
    digest,
)
from gaitopt.proof.claims import Claim
from gaitopt.proof.graph import NotProved, complex_interval, interval, precision
from gaitopt.proof.orbit import BREAKPOINT, Arc, Box, Orbit
from gaitopt.proof.taylor import PRECISION

INTERVAL = ".."
"""Between the ends of an interval."""


def exact_texts(problem: Problem, values: Mapping[str, float]) -> dict[str, str]:
    """Every parameter of a system as the text of its exact value: ``0.14``, ``1 deg``.

    Parameters
    ----------
    values : the parameters as doubles by dotted key.
    """
    written = dict(_scalars(YAML(typ="safe", pure=True).compose(problem.text))) if problem.text else {}
    return {key: _text(written.get(key), float(value)) for key, value in values.items()}


def ball(text: str) -> arb:
    """The ball of an exact value as ``exact_texts`` writes it, or of an interval ``lo..hi`` of such values.

    Raises
    ------
    ValueError
        If it is not a decimal number, with ``deg`` or ``rad`` where it is an angle.
    """
    lower, between, upper = text.partition(INTERVAL)
    if between:
        return ball(lower.strip()).union(ball(upper.strip()))
    number, _, unit = text.partition(" ")
    value = arb(number)
    if unit not in ("", "rad", "deg") or not value.is_finite():
        raise ValueError(f"{text!r} is no exact value; write a decimal number, or one with deg or rad")
    return value * arb.pi() / 180 if unit == "deg" else value


def _text(written: str | None, value: float) -> str:
    """The text of the file if it stands for this very double, otherwise the double's shortest decimal."""
    text = "" if written is None else " ".join(written.split())
    return text if re.fullmatch(EXACT_VALUE, text) and _double(text) == value else repr(value)


def _double(text: str) -> Any:
    """The double of a number in a file, or what is no number."""
    try:
        return float(text)
    except ValueError:
        pass
    try:
        return parse_angle(text)
    except ValueError:
        return None


def _scalars(node: Node, path: tuple[str, ...] = ()) -> Iterator[tuple[str, str]]:
    if isinstance(node, MappingNode):
        for key, value in node.value:
            yield from _scalars(value, (*path, key.value))
    elif isinstance(node, ScalarNode):
        yield ".".join(path), node.value


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


STABILITY = "stability"


@dataclass(frozen=True, slots=True)
class Piece:
    """What is proved on one box.

    Attributes
    ----------
    outer : the box in which the orbit is unique.
    interval : ends of the parameter that varies, as texts.
    image : of the box under Krawczyk's operator, also where that proves nothing.
    inner : the image as the box that holds the orbit; None, and nothing after the claims, where something could not
        be computed.
    derivatives : of the return map, on parts of the interval.
    multipliers : largest modulus first.
    """

    outer: Box
    interval: Sequence[str]
    image: Box | None = None
    inner: Box | None = None
    claims: tuple[Claim, ...] = ()
    state: Mapping[str, arb] | None = None
    durations: tuple[arb, ...] = ()
    measures: Mapping[str, arb | None] | None = None
    derivatives: Sequence[arb_mat] = ()
    multipliers: tuple[acb, ...] = ()


@dataclass(frozen=True)
class Proof:
    """What a certificate proves.

    Attributes
    ----------
    problem : its name.
    claims : the theorem's statements; all of them have to be proved.
    state : boxes of the state just after the impact, by name.
    durations : of the phases [s].
    measures : by name.
    multipliers : largest modulus first; none for a bracket of a special point.
    certificate : the certificate itself.
    statement : what the theorem is about, and what it does not say; empty where that could not be rebuilt.
    """

    problem: str
    claims: tuple[Claim, ...]
    certificate: Mapping[str, Any]
    statement: Mapping[str, Any] = field(default_factory=dict)
    state: Mapping[str, arb] | None = None
    durations: tuple[arb, ...] = ()
    measures: Mapping[str, arb | None] | None = None
    multipliers: tuple[acb, ...] = ()

    def about(self, pieces: Sequence[Piece]) -> "Proof":
        """The same theorem with the bounds of all orbits of some boxes."""
        if not pieces or any(piece.inner is None for piece in pieces):
            return self
        states, values = [piece.state or {} for piece in pieces], [piece.measures or {} for piece in pieces]
        return replace(
            self,
            state={key: _union([state[key] for state in states]) for key in states[0]},
            durations=tuple(map(_union, zip(*(piece.durations for piece in pieces), strict=True))),
            measures={key: _union([measures[key] for measures in values]) for key in values[0]},
            multipliers=union_of_multipliers(piece.multipliers for piece in pieces if piece.multipliers),
        )

    def __repr__(self) -> str:
        stability = {True: ", stable", False: ", unstable", None: ""}[self.stable]
        proved = sum(claim.proved for claim in self.claims)
        return f"<Proof about {self.problem}: {proved} of {len(self.claims)} claims proved{stability}>"

    @property
    def proved(self) -> bool:
        """Whether every claim is, and there are claims."""
        return bool(self.claims) and all(claim.proved for claim in self.claims)

    @cached_property
    def spectral_radius(self) -> arb | None:
        """Largest modulus of a multiplier."""
        if not self.multipliers:
            return None
        with precision(PRECISION):
            moduli = [abs(multiplier) for multiplier in self.multipliers]
            return max(modulus.lower() for modulus in moduli).union(max(modulus.upper() for modulus in moduli))

    @property
    def stable(self) -> bool | None:
        """Whether the gait is stable, None where that is not decided."""
        radius = self.spectral_radius
        return True if radius is not None and radius < 1 else False if radius is not None and radius > 1 else None

    def _family(self) -> dict[str, Any]:
        """Parameter and interval of a family, and the type of the special point in it."""
        varied = self.certificate.get("varied")
        if varied is None or not self.statement:
            return {}
        interval = self.statement["parameters"][varied]
        return {"parameter": varied, "interval": interval, "special": self.certificate["special"]}

    def stability_claim(self) -> Claim:
        """That the gait is stable, or that it is unstable."""
        verdict = {True: "stable", False: "unstable", None: "whether it is stable is not shown"}[self.stable]
        words = f"{verdict}: the largest modulus of a multiplier is {self.spectral_radius}"
        return Claim(STABILITY, proved=self.stable is not None, words=words)

    def to_record(self) -> dict[str, Any]:
        """One JSON object; bounds are decimal strings rounded outward."""
        values = {name: _bounds(value) for name, value in (self.measures or {}).items()}
        radius = self.spectral_radius
        return {
            "problem": self.problem,
            "proved": self.proved,
            **self._family(),
            "statement": dict(self.statement),
            "state": None if self.state is None else {name: interval(value) for name, value in self.state.items()},
            "durations": [interval(value) for value in self.durations],
            "period": None,
            **values,
            "multipliers": [complex_interval(value) for value in self.multipliers],
            "spectral_radius": None if radius is None else interval(radius),
            "stable": self.stable,
            "claims": [_claim_record(claim) for claim in self.claims],
        }


def _bounds(value: arb | None) -> list[str] | None:
    """A measure as an interval; None where it is not defined, or may be infinite."""
    return interval(value) if value is not None and value.is_finite() else None


def _claim_record(claim: Claim) -> dict[str, Any]:
    margin = None if claim.margin is None else interval(claim.margin)[0]
    return {"claim": claim.name, "proved": claim.proved, "words": claim.words, "margin": margin}


def merged_claims(pieces: Sequence[Piece]) -> Iterator[Claim]:
    """The claims of all boxes: one that fails in a box fails, and of margins the smallest counts."""
    by_name: dict[str, list[Claim]] = {}
    for piece in pieces:
        for claim in piece.claims:
            by_name.setdefault(claim.name, []).append(claim)
    for name, claims in by_name.items():
        worst = min(claims, key=lambda claim: claim.proved)
        margins = [claim.margin for claim in claims if claim.margin is not None]
        words = worst.words if len(claims) == 1 or not worst.proved else f"in {len(claims)} boxes; first: {worst.words}"
        yield Claim(name, worst.proved, words, min(margins) if margins and worst.proved else None)


def _union(values: Sequence[Any]) -> Any:
    return None if None in values else reduce(arb.union, values)


def union_of_multipliers(parts: Iterable[Sequence[acb]]) -> tuple[acb, ...]:
    """Bounds of multipliers, largest modulus first, over the parts of a family."""
    return tuple(map(union, zip(*parts, strict=True)))


def union(values: Iterable[acb]) -> acb:
    """A box around complex boxes."""
    every = list(values)
    return acb(_union([value.real for value in every]), _union([value.imag for value in every]))
