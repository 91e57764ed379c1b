"""The checker: verify a certificate in one pass, without any search.

Every box of a certificate has to pass Krawczyk's test; on its image the mode sequence is proved and the multipliers
and measures are enclosed. ``theorem.conclude`` states what all boxes prove together.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from casadi import SX, Function
from flint import arb

from gaitopt.model.walker import Walker
from gaitopt.proof.arithmetic import BallFunction, NotProved, at, hull, precision
from gaitopt.proof.certificate import BoxRecord, Statement, read_certificate, restore_box, restore_statement
from gaitopt.proof.claims import MOST_HALVINGS, ProofClaim, mode_sequence_claims
from gaitopt.proof.orbit import (
    SPLIT,
    CycleEnclosure,
    Orbit,
    TiltedBox,
    deviations,
    krawczyk,
    multipliers,
    precondition,
    require_contraction,
    return_map,
)
from gaitopt.proof.taylor import TaylorSeries, evaluate
from gaitopt.proof.theorem import EXISTENCE, MARGIN_CHANGES, MOTION, STATEMENT, CheckedBox, Proof, conclude

RELATIVE_WIDTH = 1e-12
"""A part is divided no further once its upper bound exceeds the maximum by less than this, relatively."""


def silent(words: str) -> None:
    """Progress that is not shown."""


def check(
    certificate: Mapping[str, Any],
    progress: Callable[[str], None] = silent,
    *,
    walkers: Sequence[type[Walker]] = (),
) -> Proof:
    """Verify a certificate.

    Parameters
    ----------
    certificate : the JSON object that ``gaitopt prove`` has written.
    progress : called with the number of checked boxes in words.
    walkers : walkers that the problem may name besides those that are registered.

    Raises
    ------
    StorageError
        If it is no certificate: a field is missing, unknown, or has a wrong value.
    """
    with precision():
        statement: Statement | None = None
        try:
            statement = restore_statement(read_certificate(certificate), walkers)
            if not statement.records:
                raise ValueError("it has no boxes: nothing is proved")
            if len(statement.records) != 1 and not statement.interval:
                raise ValueError(f"{len(statement.records)} boxes, but no parameter that varies")
            boxes: list[CheckedBox] = []
            for k, record in enumerate(statement.records):
                boxes.append(check_box(statement, record, at_end=k in (0, len(statement.records) - 1)))
                progress(f"box {k + 1} of {len(statement.records)}")
                if boxes[-1].inner is None:
                    break
        except (ValueError, NotProved) as fault:
            claim = ProofClaim(STATEMENT, proved=False, words=str(fault))
            name = str(certificate.get("problem"))[:80]
            return Proof(name, (claim,), certificate, statement.words if statement else {})
        return conclude(statement, boxes, certificate)


def check_box(statement: Statement, record: BoxRecord, *, at_end: bool = True) -> CheckedBox:
    """What is proved on one box of a certificate.

    For a single orbit, margins and multipliers are enclosed on the image of the box under Krawczyk's operator. Inside a
    bracket of a special point multipliers are not needed, and the mode sequence not if the bracket is of a margin.

    Parameters
    ----------
    at_end : whether the box is the first or the last one of the certificate.
    """
    orbit, outer = restore_box(statement, record)
    box = CheckedBox(outer, record.interval)
    try:
        cycle = orbit.enclose(outer)
        inverse = precondition(orbit, cycle)
        line = orbit.enclose(replace(outer, deviation=[arb(0)] * orbit.size)) if orbit.is_long else cycle
        image = krawczyk(orbit, outer, line, inverse)
        box = replace(box, image=image)
        require_contraction(orbit, outer, image)
        radius = max(w.abs_upper() for w in outer.deviation).str(3, radius=False)
        words = f"exactly one periodic orbit lies within {radius} of the centre in every unknown"
        box = replace(box, claims=(ProofClaim(EXISTENCE, proved=True, words=words),))
        if not orbit.is_long:
            narrow = TiltedBox(outer.centre, outer.tilt, [move.union(arb(0)) for move in deviations(outer, image)])
            cycle = orbit.enclose(narrow)
            inverse = precondition(orbit, cycle)
            image = krawczyk(orbit, narrow, cycle, inverse)
        derivative = return_map(orbit, outer, cycle, inverse)
        derivatives = [at(derivative, s) for s in (SPLIT if orbit.is_long else [arb(0)])]
        if at_end or statement.special not in MARGIN_CHANGES:
            box = replace(box, claims=(*box.claims, *mode_sequence_claims(orbit, cycle)))
        unknowns = image.hull
        durations = [unknowns[entry] for entry in orbit.durations]
        return replace(
            box,
            inner=image,
            state=dict(zip(orbit.system.state_names, unknowns, strict=False)),
            durations=orbit.phase_durations(durations),
            measures=measure_bounds(orbit, cycle, sum(durations, arb(0))),
            derivatives=derivatives,
            multipliers=() if statement.special is not None and not at_end else multipliers(derivatives),
        )
    except NotProved as failure:
        claim = ProofClaim(MOTION if box.claims else EXISTENCE, proved=False, words=str(failure))
        return replace(box, claims=(*box.claims, claim))


def measure_bounds(orbit: Orbit, cycle: CycleEnclosure, period: arb) -> dict[str, arb | None]:
    """Bounds of the measures of every gait in the box, by the names of a gait's record."""
    work, forces = arb(0), list[tuple[TaylorSeries, TaylorSeries, arb, arb]]()
    for j, arc in enumerate(orbit.arcs):
        observation = orbit.field(arc.mode, j).observation
        along = [step.along(observation) for step in cycle.steps[j]]
        starts = [(f_t.value[0], f_n.value[0]) for f_t, f_n, _ in along]
        ends = [*starts[1:], tuple(map(hull, observation(cycle.ends[j])[0][:2]))]
        for step, (f_t, f_n, power), end in zip(cycle.steps[j], along, ends, strict=True):
            work += evaluate([arb(0), *(c / (k + 1) for k, c in enumerate(power.value))], hull(step.h))
            if arc.mode.sticks:
                forces.append((f_t, f_n, hull(step.h), abs(end[0] / end[1])))
    length = arb(0)
    for k, impact in enumerate(orbit.sequence.impacts):
        j = orbit.arcs_of(k)[-1]
        length += orbit.impact(impact, j)(cycle.ends[j])[1][orbit.system.n_shape]
    p = SX.sym("p", len(orbit.p))
    weight = BallFunction(Function("weight", [p], [orbit.system.weight(p)]), [])(orbit.p)[0][0]
    return {
        "period": period,
        "step_length": length,
        "speed": length / period,
        "work": work,
        "cost_of_transport": work / (weight * length),
        "required_friction": largest_force_ratio(forces) if forces else None,
    }


def largest_force_ratio(steps: Iterable[tuple[TaylorSeries, TaylorSeries, arb, arb]]) -> arb:
    """The maximum of |f_t| / f_n, with f_n > 0, over steps of the integration.

    On a part of a step the maximum is that of its ends if the ratio is monotone there; otherwise it is bounded by the
    mean value theorem, or the part is halved.

    Parameters
    ----------
    steps : f_t, f_n, the length of the step [s], and the ratio at its end.
    """
    lower, upper = arb(0), arb(0)
    for f_t, f_n, h, at_end in steps:
        lower, pending = max(lower, at_end.lower()), [(arb(0), arb(h.upper()), MOST_HALVINGS)]
        while pending:
            start, end, depth = pending.pop()
            first, last = (
                abs(evaluate(f_t.value, t) / evaluate(f_n.value, t)) if t < h else at_end for t in (start, end)
            )
            lower = max(lower, first.lower() if first.is_finite() else lower)
            bound = _upper_bound(f_t, f_n, start, end, (first, last))
            if bound <= lower:
                continue
            if depth and not bound <= lower * (1 + RELATIVE_WIDTH):
                middle = ((start + end) / 2).mid()
                pending += [(middle, end, depth - 1), (start, middle, depth - 1)]
            else:
                upper = max(upper, bound)
    return lower.union(max(lower, upper))


def _upper_bound(f_t: TaylorSeries, f_n: TaylorSeries, start: arb, end: arb, at_ends: tuple[arb, arb]) -> arb:
    """An upper bound of |f_t| / f_n between two times, with the ratio at these times."""
    t = start.union(end)
    force, normal = evaluate(f_t.value, t), evaluate(f_n.value, t)
    slope = (evaluate(f_t.rate, t) * normal - force * evaluate(f_n.rate, t)) / normal**2
    bound = max(at_ends[0].upper(), at_ends[1].upper())
    if not (slope > 0 or slope < 0):
        bound = (at_ends[0] + abs(slope) * (end - start)).upper()
    return bound if normal > 0 and bound.is_finite() else arb("inf")
