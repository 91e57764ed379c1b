"""The checker: verify a certificate in one pass, without any search, and conclude what its boxes prove together.

Every box has to pass Krawczyk's test; on its image the mode sequence is proved, and multipliers and measures are
enclosed. A theorem is proved if every claim of its kind is present and holds. A family is connected if the orbit at the
end of one box lies where the orbit of the next box is unique. A special point lies between two parameter values if its
test function has opposite signs there:

    neimark_sacker     the number of multipliers outside the unit circle changes by two, none is 1 or -1 in between
    period_doubling    prod_k (1 + lambda_k)
    others             a margin of the mode or of the impact
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import pairwise
from math import prod
from typing import Any

from flint import acb, arb, arb_mat

from gaitopt.display import counted
from gaitopt.model.control import Control
from gaitopt.model.section import CLOCK
from gaitopt.model.transitions import IMPACT_MARGINS, PHASE_MARGINS, Ending, Margin
from gaitopt.model.transitions import kind as kind_of
from gaitopt.model.walker import Walker
from gaitopt.proof.arithmetic import NotProved, at, decimal_bounds, precision
from gaitopt.proof.certificate import BoxRecord, DurationRecord, read_certificate
from gaitopt.proof.claims import ProofClaim, measure_bounds, mode_claim_names, mode_sequence_claims
from gaitopt.proof.law_data import DURATION_ERROR, LAW_DATA, OWN_DURATION_ERROR, duration_claim, motion_claim
from gaitopt.proof.orbit import (
    SPLIT,
    CycleEnclosure,
    TiltedBox,
    deviations,
    krawczyk,
    multipliers,
    precondition,
    require_contraction,
    return_map,
    union_of_multipliers,
)
from gaitopt.proof.statement import Hypotheses, Statement, restore_box, restore_statement

STATEMENT, EXISTENCE, MOTION = "statement", "existence and uniqueness", "motion"
COMPLETENESS, STABILITY = "completeness", "stability"
CONNECTION, SIGN_CHANGE = "connected family", "sign change"
"""Names of claims, besides those of the mode sequence."""
UNDECIDED = "exists, and its stability is undecided"


def _margins_ending(*tables: Mapping[str, Margin], ending: Ending | None) -> tuple[str, ...]:
    """Names of the margins that end a motion in this way when they reach zero; None: another mode or impact follows."""
    return tuple(name for table in tables for name, margin in table.items() if margin.ending == ending)


MARGIN_CHANGES: Mapping[str, tuple[str, ...]] = {
    "mode_change": _margins_ending(PHASE_MARGINS, ending=None),
    "impact_change": _margins_ending(IMPACT_MARGINS, ending=None),
    "lift_off": _margins_ending(PHASE_MARGINS, IMPACT_MARGINS, ending=Ending.LIFT_OFF),
    "painleve": _margins_ending(PHASE_MARGINS, IMPACT_MARGINS, ending=Ending.PAINLEVE),
}
"""Special points beyond which the orbit is not a gait of its mode sequence, and the margins that are negative there."""
BRACKETED = ("neimark_sacker", "period_doubling", *MARGIN_CHANGES)
"""Types of special points that can be proved."""


@dataclass(frozen=True, slots=True)
class CheckedBox:
    """What is proved on one box.

    Attributes
    ----------
    outer : the box of the certificate, in which the orbit is unique.
    interval : ends of the varying parameter as texts; empty if none varies.
    image : the image of the box under Krawczyk's operator, even if it proves nothing.
    inner : the image, if it is proved to hold the orbit. None if an enclosure failed; all fields below are then empty.
    state : bounds of the state just after the last impact, by name.
    durations : bounds of the durations of the phases [s].
    derivatives : derivatives of the return map, one for each subinterval (``SPLIT``) of the parameter's interval.
    multipliers : bounds of the multipliers, largest modulus first.
    cycle : enclosure of one cycle of the motion.
    """

    outer: TiltedBox
    interval: Sequence[str]
    image: TiltedBox | None = None
    inner: TiltedBox | None = None
    claims: tuple[ProofClaim, ...] = ()
    state: Mapping[str, arb] = field(default_factory=dict)
    durations: tuple[arb, ...] = ()
    measures: Mapping[str, arb | None] = field(default_factory=dict)
    derivatives: Sequence[arb_mat] = ()
    multipliers: tuple[acb, ...] = ()
    cycle: CycleEnclosure | None = None


@dataclass(frozen=True)
class Proof:
    """What a certificate proves.

    Attributes
    ----------
    problem : name of the problem.
    claims : statements of the theorem; the theorem is proved if all of them are.
    certificate : the JSON object from which it is proved.
    statement : the hypotheses, and what is not proved; empty if the certificate gives no valid hypotheses.
    state : bounds of the state just after the impact, by name.
    durations : bounds of the durations of the phases [s].
    measures : bounds of the measures, by name.
    multipliers : bounds of the multipliers, largest modulus first; empty for a bracket of a special point.
    minimal_period : whether the period is proved to be the shortest one; None if no orbit is proved.
    """

    problem: str
    claims: tuple[ProofClaim, ...]
    certificate: Mapping[str, Any]
    statement: Hypotheses = field(default_factory=Hypotheses)
    state: Mapping[str, arb] | None = None
    durations: tuple[arb, ...] = ()
    measures: Mapping[str, arb | None] | None = None
    multipliers: tuple[acb, ...] = ()
    minimal_period: bool | None = None

    def __repr__(self) -> str:
        stability = {True: ", stable", False: ", unstable", None: ""}[self.stable]
        proved = sum(claim.proved for claim in self.claims)
        return f"<Proof about {self.problem}: {proved} of {counted(len(self.claims), 'claim')} proved{stability}>"

    @property
    def proved(self) -> bool:
        """Whether there are claims and all of them are proved."""
        return bool(self.claims) and all(claim.proved for claim in self.claims)

    @property
    def spectral_radius(self) -> arb | None:
        """Bounds of the largest modulus of a multiplier."""
        # not cached: up to Python 3.11 a cached property takes a lock, and one thread would take it before FLINT's lock
        # and another one after it
        if not self.multipliers:
            return None
        with precision():
            moduli = [abs(multiplier) for multiplier in self.multipliers]
            return max(modulus.lower() for modulus in moduli).union(max(modulus.upper() for modulus in moduli))

    @property
    def stable(self) -> bool | None:
        """Whether the gait is stable; None if the bounds do not decide."""
        radius = self.spectral_radius
        return True if radius is not None and radius < 1 else False if radius is not None and radius > 1 else None

    def to_record(self) -> dict[str, Any]:
        """One JSON object; bounds are decimal strings rounded outward."""
        varied, radius = self.certificate.get("varied"), self.spectral_radius
        family = {}
        if varied is not None and self.statement:
            interval = self.statement["parameters"][varied]
            family = {"parameter": varied, "interval": interval, "special": self.certificate["special"]}
        statement = dict(self.statement)
        if self.minimal_period is False:
            statement["not_proved"] = [*self.statement["not_proved"], "whether the period is the least one"]
        measures = {
            name: decimal_bounds(value) if value is not None and value.is_finite() else None
            for name, value in (self.measures or {}).items()
        }
        claims = [
            {
                "claim": claim.name,
                "proved": claim.proved,
                "words": claim.finding,
                "margin": None if claim.margin is None else decimal_bounds(claim.margin)[0],
            }
            for claim in self.claims
        ]
        state = None if self.state is None else {name: decimal_bounds(value) for name, value in self.state.items()}
        return {
            "problem": self.problem,
            "proved": self.proved,
            **family,
            "statement": statement,
            "state": state,
            "durations": [decimal_bounds(value) for value in self.durations],
            "period": None,
            **measures,
            "minimal_period": self.minimal_period,
            "multipliers": [{"re": decimal_bounds(m.real), "im": decimal_bounds(m.imag)} for m in self.multipliers],
            "spectral_radius": None if radius is None else decimal_bounds(radius),
            "stable": self.stable,
            "claims": claims,
        }


def check(
    certificate: Mapping[str, Any],
    *,
    walkers: Sequence[type[Walker]] = (),
    controls: Sequence[type[Control]] = (),
) -> Proof:
    """Verify a certificate.

    Parameters
    ----------
    certificate : the JSON object that ``gaitopt prove`` has written.
    walkers, controls : classes that the problem may name besides those that are registered.

    Raises
    ------
    StorageError
        If a field of the certificate is missing, unknown, or has a wrong value.
    """
    with precision():
        statement: Statement | None = None
        try:
            statement = restore_statement(read_certificate(certificate), walkers, controls)
            boxes = list(_checked_boxes(statement))
        except (ValueError, NotProved) as fault:
            claim = ProofClaim(STATEMENT, proved=False, finding=str(fault))
            name = statement.problem.name if statement else "unknown"
            return Proof(name, (claim,), certificate, statement.printed if statement else Hypotheses())
        return conclude(statement, boxes, certificate)


def _checked_boxes(statement: Statement) -> Iterator[CheckedBox]:
    """What is proved on each box, up to the first one that does not hold an orbit.

    Raises
    ------
    ValueError
        If there is no box, more than one box without a varying parameter, or a box that does not fit the equations.
    """
    records = statement.record.boxes
    if not records:
        raise ValueError("it has no boxes: nothing is proved")
    if len(records) != 1 and not statement.interval:
        raise ValueError(f"{counted(len(records), 'box', 'boxes')}, but no parameter that varies")
    for k, record in enumerate(records):
        box = check_box(statement, record, at_end=k in (0, len(records) - 1))
        yield box
        if box.inner is None:
            return


def check_box(statement: Statement, record: BoxRecord, *, at_end: bool = True, is_source: bool = False) -> CheckedBox:
    """What is proved on one box of a certificate.

    For a single orbit, margins and multipliers are enclosed on the image of the box under Krawczyk's operator. Boxes
    inside the bracket of a special point need no multipliers. If the special point is a zero of a margin, these boxes
    need no claims about the mode sequence either.

    Parameters
    ----------
    at_end : whether the box is the first or the last one of the certificate.
    is_source : whether the orbit is a gait that gives law data; only existence, mode sequence and motion then matter.
    """
    orbit, outer = restore_box(statement, record)
    box, special = CheckedBox(outer, record.interval), statement.special
    try:
        cycle = orbit.enclose(outer)
        inverse = precondition(orbit, cycle)
        line = orbit.enclose(replace(outer, deviation=[arb(0)] * orbit.size)) if orbit.is_long else cycle
        image = krawczyk(orbit, outer, line, inverse)
        box = replace(box, image=image)
        require_contraction(orbit, outer, image)
        radius = max(w.abs_upper() for w in outer.deviation).str(3, radius=False)
        finding = f"exactly one periodic orbit lies within {radius} of the centre in every unknown"
        box = replace(box, claims=(ProofClaim(EXISTENCE, proved=True, finding=finding),))
        if not orbit.is_long and not is_source:
            # the image holds the orbit too, and gives narrower bounds of everything else
            narrow = TiltedBox(outer.centre, outer.tilt, [move.union(arb(0)) for move in deviations(outer, image)])
            cycle = orbit.enclose(narrow)
            inverse = precondition(orbit, cycle)
            image = krawczyk(orbit, narrow, cycle, inverse)
        derivatives = list[arb_mat]()
        if not is_source:
            derivative = return_map(orbit, outer, cycle, inverse)
            derivatives = [at(derivative, s) for s in (SPLIT if orbit.is_long else [arb(0)])]
        if at_end or special not in MARGIN_CHANGES:
            box = replace(box, claims=(*box.claims, *mode_sequence_claims(orbit, cycle)))
        unknowns = image.hull
        durations = [unknowns[entry] for entry in orbit.durations]
        return replace(
            box,
            inner=image,
            state=dict(zip(orbit.system.state_names, unknowns, strict=False)),
            durations=orbit.phase_durations(durations),
            measures={} if is_source else measure_bounds(orbit, cycle, sum(durations, arb(0))),
            derivatives=derivatives,
            multipliers=() if is_source or (special is not None and not at_end) else multipliers(derivatives),
            cycle=cycle,
        )
    except NotProved as failure:
        claim = ProofClaim(MOTION if box.claims else EXISTENCE, proved=False, finding=str(failure))
        return replace(box, claims=(*box.claims, claim))


def conclude(statement: Statement, boxes: Sequence[CheckedBox], certificate: Mapping[str, Any]) -> Proof:
    """What the boxes of a certificate prove together.

    Every box has to prove existence and the claims about the mode sequence. If the special point is a zero of a margin,
    the latter have to hold only at the end where the orbit is a gait; the claim on the sign change covers the other.
    """
    special = statement.special
    modes = mode_claim_names(statement.system, statement.law, statement.cycle, statement.arcs)
    brackets_margin, last = special in MARGIN_CHANGES, len(boxes) - 1
    gait_end = _gait_end(boxes) if brackets_margin else None
    claims = list(
        _merge_claims(
            [claim for claim in box.claims if gait_end in (None, k) or claim.name not in modes]
            for k, box in enumerate(boxes)
        )
    )
    proof = Proof(statement.problem.name, tuple(claims), certificate, statement.printed)
    if boxes and all(box.inner is not None for box in boxes):
        proof = replace(
            proof,
            state={name: _union([box.state[name] for box in boxes]) for name in boxes[0].state},
            durations=tuple(map(_union, zip(*(box.durations for box in boxes), strict=True))),
            measures={name: _union([box.measures[name] for box in boxes]) for name in boxes[0].measures},
            multipliers=()
            if special is not None
            else union_of_multipliers(box.multipliers for box in boxes if box.multipliers),
            minimal_period=all(_is_minimal(statement, box) for box in boxes),
        )
    missing = [
        name
        for k, box in enumerate(boxes)
        for name in ((EXISTENCE, *modes) if not brackets_margin or k in (0, last) else (EXISTENCE,))
        if name not in {claim.name for claim in box.claims}
    ]
    if missing or any(box.inner is None for box in boxes):
        if proof.proved:
            reason = f"is not proved on every box: {', '.join(missing) or MOTION}"
            proof = replace(proof, claims=(*claims, ProofClaim(COMPLETENESS, proved=False, finding=reason)))
        return proof
    if statement.interval:
        if not brackets_margin and not proof.proved:
            return proof
        claims.append(connection_claim(boxes, statement.interval))
    if _has_law_data(statement):
        claims.append(_law_data_claim(statement, boxes))
    if special is not None:
        claims.append(sign_change_claim(special, boxes))
    else:
        verdict = {True: "stable", False: "unstable", None: UNDECIDED}[proof.stable]
        finding = f"{verdict}: the largest modulus of a multiplier is {proof.spectral_radius}"
        claims.append(ProofClaim(STABILITY, proved=proof.spectral_radius is not None, finding=finding))
        if proof.stable is None:
            silent = [
                *proof.statement["not_proved"],
                "whether the gait is stable: a multiplier may be on the unit circle",
            ]
            proof = replace(proof, statement={**proof.statement, "not_proved": silent})
    return replace(proof, claims=tuple(claims))


def _is_minimal(statement: Statement, box: CheckedBox) -> bool:
    """Whether the period is the shortest one.

    In a cycle of steps, the states after later impacts differ from the first. A cycle that ends with the clock of its
    law does not repeat a shorter sequence of modes.
    """
    assert box.cycle is not None
    cycle = statement.cycle
    if statement.problem.cycle_end == CLOCK:
        modes = [mode for k, mode in enumerate(cycle.phases) if mode is not cycle.phases[k - 1]]
        return len(modes) > 1 and all(modes != modes[k:] + modes[:k] for k in range(1, len(modes)))
    starts = [box.cycle.starts[[arc.phase for arc in statement.arcs].index(phase)] for phase in cycle.first_phases]
    return not any(all(a.overlaps(b) for a, b in zip(starts[0], other, strict=True)) for other in starts[1:])


def _has_law_data(statement: Statement) -> bool:
    """Whether data of the law come from the orbit itself or from another gait, which then has to be proved too."""
    return isinstance(statement.record.law, DurationRecord) or statement.reference is not None


def _law_data_claim(statement: Statement, boxes: Sequence[CheckedBox]) -> ProofClaim:
    """The claim that law data fit the orbit itself, or a proved gait of the problem from which they come."""
    data, source = statement.record.law, statement.reference
    periods = [sum(box.durations, arb(0)) for box in boxes]
    if statement.own_duration is not None:
        return duration_claim(statement.own_duration, _union(periods), OWN_DURATION_ERROR, "the orbit")
    if source is None:
        return ProofClaim(LAW_DATA, proved=False, finding="the proof of the gait that gives the duration is missing")
    name = source.problem.name
    try:
        (record,) = source.record.boxes
        box = check_box(source, record, is_source=True)
    except ValueError as fault:
        return ProofClaim(LAW_DATA, proved=False, finding=f"{name}: its proof has not one box that fits: {fault}")
    claims = [*box.claims, *([_law_data_claim(source, [box])] if _has_law_data(source) and box.inner else [])]
    needed = (EXISTENCE, *mode_claim_names(source.system, source.law, source.cycle, source.arcs))
    failed = [f"{claim.name}: {claim.finding}" for claim in claims if not claim.proved]
    failed += [f"{name} is missing" for name in needed if name not in {claim.name for claim in claims}]
    if failed or box.cycle is None:
        return ProofClaim(LAW_DATA, proved=False, finding=f"the gait of {name} is not proved: {failed[0]}")
    if isinstance(data, DurationRecord):
        return duration_claim(data.duration, sum(box.durations, arb(0)), DURATION_ERROR, f"a proved gait of {name}")
    orbit, _ = restore_box(source, source.record.boxes[0])
    until = max(arb(each.upper()) for each in periods)
    return motion_claim(statement, orbit, box.cycle, sum(box.durations, arb(0)), until)


def _merge_claims(claims_by_box: Iterable[Sequence[ProofClaim]]) -> Iterator[ProofClaim]:
    """One claim for each name; it is proved if it is proved on every box, with the smallest margin of all boxes."""
    by_name: dict[str, list[ProofClaim]] = {}
    for claims in claims_by_box:
        for claim in claims:
            by_name.setdefault(claim.name, []).append(claim)
    for name, claims in by_name.items():
        worst = min(claims, key=lambda claim: claim.proved)
        margins = [claim.margin for claim in claims if claim.margin is not None]
        is_first = len(claims) > 1 and worst.proved
        finding = f"in {len(claims)} boxes; first: {worst.finding}" if is_first else worst.finding
        yield ProofClaim(name, worst.proved, finding, min(margins) if margins and worst.proved else None)


def _union(values: Sequence[Any]) -> Any:
    return None if None in values else reduce(arb.union, values)


def connection_claim(boxes: Sequence[CheckedBox], interval: Sequence[str]) -> ProofClaim:
    """The claim that the boxes cover the interval, and that neighbouring boxes hold the same orbit where they meet."""

    def holds(outer: TiltedBox, s: int, inner: TiltedBox, t: int) -> bool:
        pairs = zip(outer.at(arb(s)), inner.at(arb(t)), strict=True)
        return all(values.contains(value) for values, value in pairs)

    for k, (box, following) in enumerate(pairwise(boxes), start=1):
        if (
            box.inner is None
            or following.inner is None
            or box.interval[1] != following.interval[0]
            or not (holds(box.outer, 1, following.inner, -1) or holds(following.outer, -1, box.inner, 1))
        ):
            gap = f"boxes {k} and {k + 1} are not shown to hold the same orbit"
            return ProofClaim(CONNECTION, proved=False, finding=gap)
    if [boxes[0].interval[0], boxes[-1].interval[1]] != list(interval):
        return ProofClaim(CONNECTION, proved=False, finding="the boxes do not reach both ends of the interval")
    finding = f"the orbits form one smooth family, without a gap, in {counted(len(boxes), 'box', 'boxes')}"
    return ProofClaim(CONNECTION, proved=True, finding=finding)


def sign_change_claim(kind: str, boxes: Sequence[CheckedBox]) -> ProofClaim:
    """The claim that the test function of a special point changes its sign between the first box and the last."""
    tests = {"neimark_sacker": _neimark_sacker, "period_doubling": _period_doubling}
    try:
        finding = _margin_change(kind, boxes) if kind in MARGIN_CHANGES else tests[kind](boxes)
    except NotProved as failure:
        return ProofClaim(SIGN_CHANGE, proved=False, finding=str(failure))
    return ProofClaim(SIGN_CHANGE, proved=True, finding=finding)


def _neimark_sacker(boxes: Sequence[CheckedBox]) -> str:
    outside = []
    for box in (boxes[0], boxes[-1]):
        moduli = [abs(m) for m in box.multipliers]
        if any(modulus.contains(1) for modulus in moduli):
            raise NotProved("whether a multiplier is outside the unit circle at an end is not shown")
        outside.append(sum(bool(modulus > 1) for modulus in moduli))
    if abs(outside[0] - outside[1]) != 2:
        raise NotProved(f"{outside[0]} and {outside[1]} multipliers are outside the unit circle at the ends")
    for matrix in (matrix for box in boxes for matrix in box.derivatives):
        for real in (1, -1):
            unit = arb_mat([[real * int(i == j) for j in range(matrix.ncols())] for i in range(matrix.nrows())])
            if not (matrix - unit).det() != 0:
                raise NotProved(f"a multiplier may pass through {real}")
    return (
        f"{outside[0]} multipliers are outside the unit circle at one end and {outside[1]} at the other, and none is 1 "
        "or -1 in between: a complex pair crosses the unit circle"
    )


def _period_doubling(boxes: Sequence[CheckedBox]) -> str:
    ends = [prod((m + 1 for m in box.multipliers), start=acb(1)).real for box in (boxes[0], boxes[-1])]
    if not ends[0] * ends[1] < 0:
        values = " and ".join(str(end.str(6)) for end in ends)
        raise NotProved(f"the product of all multipliers plus one is {values} at the ends: no change of sign")
    return "the product of all multipliers plus one changes its sign: one of them is -1 in between"


def _gait_end(boxes: Sequence[CheckedBox]) -> int | None:
    """Index of the first or last box, whichever end is the only one at which the orbit has its mode sequence."""
    gaits = [k for k in (0, len(boxes) - 1) if all(claim.proved for claim in boxes[k].claims)]
    return gaits[0] if len(gaits) == 1 else None


def _margin_change(kind: str, boxes: Sequence[CheckedBox]) -> str:
    end = _gait_end(boxes)
    if end is None:
        raise NotProved("it is not shown that the mode sequence holds at one end and is violated at the other")
    refuted = [claim for claim in boxes[-1 if end == 0 else 0].claims if claim.refuted]
    if not refuted:
        raise NotProved("it is not shown that the mode sequence is violated at the other end")
    foreign = [claim for claim in refuted if kind_of(claim.violated) not in MARGIN_CHANGES[kind]]
    if foreign:
        raise NotProved(f"what is violated at the other end makes it no {kind}: {foreign[0].finding}")
    here, there = ("lower", "upper") if end == 0 else ("upper", "lower")
    return (
        f"at the {here} end the orbit is a gait of its mode sequence; at the {there} end it is not, because a margin "
        f"that makes a {kind} is negative: {refuted[0].name}: {refuted[0].finding}"
    )
