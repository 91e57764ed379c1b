"""Re-verification of a certificate, in one pass and without any search: what is proved about the gait that it states.

On the box X = centre + [-radius, radius] of the unknowns Krawczyk's operator

    K = centre - C F(centre) + (1 - C F'(X)) (X - centre),        C an approximate inverse of F'

proves, where K lies in the interior of X, that F has exactly one zero in X, and that it lies in K. Margins, impact and
multipliers are then enclosed for every motion that starts in K.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from flint import arb, arb_mat, ctx

from gaitopt.mechanics import (
    CoulombFriction,
    Cycle,
    HybridSystem,
    Mode,
    StaticKineticFriction,
    ending_margin,
)
from gaitopt.problem import Problem, restore_problem
from gaitopt.proof.bundle import identity
from gaitopt.proof.claims import Claim, mode_sequence_claims
from gaitopt.proof.control import restore_control
from gaitopt.proof.graph import NotProved
from gaitopt.proof.measures import measures, multipliers
from gaitopt.proof.orbit import BREAKPOINT, Arc, Orbit, Passage
from gaitopt.proof.parameters import INTERVAL, ball
from gaitopt.proof.taylor import PRECISION, Step
from gaitopt.proof.theorem import Proof

SCHEMA = "gaitopt-proof-1"
EXISTENCE = "existence and uniqueness"


def check(certificate: Mapping[str, Any]) -> Proof:
    """Verify a certificate.

    Raises
    ------
    KeyError, TypeError, AttributeError
        If it is no certificate at all.
    """
    before = ctx.cap
    try:
        with ctx.workprec(PRECISION):
            return _check(certificate)
    finally:
        ctx.cap = before


def _check(certificate: Mapping[str, Any]) -> Proof:
    try:
        orbit, sequence, name = restore_orbit(certificate)
    except ValueError as fault:
        claim = Claim("statement", proved=False, words=str(fault))
        return Proof(problem=str(certificate.get("problem")), claims=(claim,), certificate=certificate)
    proof = Proof(problem=name, claims=(), certificate=certificate)
    try:
        centre, deviation, words = prove_existence(orbit, certificate)
    except NotProved as failure:
        return replace(proof, claims=(Claim(EXISTENCE, proved=False, words=str(failure)),))
    claims = [Claim(EXISTENCE, proved=True, words=words)]
    try:
        passage = orbit.traverse(centre, [spread.union(arb(0)) for spread in deviation])
        claims += mode_sequence_claims(orbit, passage, sequence)
    except NotProved as failure:
        return replace(proof, claims=(*claims, Claim("motion", proved=False, words=str(failure))))
    box = [c + spread for c, spread in zip(centre, deviation, strict=True)]
    return _with_results(replace(proof, claims=tuple(claims)), orbit, box, passage)


def restore_orbit(certificate: Mapping[str, Any]) -> tuple[Orbit, Cycle, str]:
    """The equations that a certificate is about, its mode sequence, and the name of its problem.

    Raises
    ------
    ValueError
        If the certificate is of another schema, or does not fit its problem.
    """
    if certificate.get("schema") != SCHEMA:
        raise ValueError(f"not a certificate of the schema {SCHEMA}")
    problem = restore_problem(certificate["resolved"])
    friction = CoulombFriction() if isinstance(problem.friction, float) else StaticKineticFriction()
    control = restore_control(certificate["control"])
    system = HybridSystem(type(problem.walker), control, problem.impact_law, friction)
    texts = certificate["parameters"]
    _check_parameters(problem, system, texts)
    arcs = [_restore_arc(record) for record in certificate["arcs"]]
    _check_arcs(arcs, problem.cycle)
    p = [ball(texts[key]) for key in system.parameters]
    return Orbit(system, p, arcs, problem.cycle.impact), problem.cycle, problem.name


def prove_existence(orbit: Orbit, certificate: Mapping[str, Any]) -> tuple[list[arb], list[arb], str]:
    """The centre of X, the deviations of the only zero in X from it, and the claim in words.

    Krawczyk's operator is applied once more to its own result, which is far narrower than X.

    Raises
    ------
    NotProved
        If Krawczyk's test fails.
    """
    centre = [arb(text).mid() for text in certificate["centre"]]
    radius = arb(certificate["radius"])
    if len(centre) != len(orbit.unknowns):
        raise NotProved(f"the box has {len(centre)} entries, but there are {len(orbit.unknowns)} unknowns")
    deviation = [arb(0, radius.lower())] * len(centre)
    first = krawczyk(orbit, centre, deviation)
    for name, inside, outside in zip(orbit.unknowns, first, deviation, strict=True):
        if not outside.contains_interior(inside):
            raise NotProved(f"Krawczyk's operator moves {name} by {inside.str(5)}, out of +/- {radius.str(3)}")
    words = f"exactly one periodic orbit lies within {radius.str(3, radius=False)} of the centre in every unknown"
    return centre, krawczyk(orbit, centre, first), words


def krawczyk(orbit: Orbit, centre: list[arb], deviation: list[arb]) -> list[arb]:
    """Krawczyk's operator on the box ``centre + deviation``, relative to the centre.

    Raises
    ------
    NotProved
        If the motion cannot be followed, or F' is singular.
    """
    n = len(centre)
    passage = orbit.traverse(centre, [spread.union(arb(0)) for spread in deviation])
    try:
        C = passage.slope.mid().inv()
    except ZeroDivisionError as failure:
        raise NotProved("the derivative of the shooting equations is singular") from failure
    rest = (identity(n) - C * passage.slope) * arb_mat(n, 1, deviation) - C * arb_mat(n, 1, passage.residual)
    return list(rest.entries())


def _with_results(proof: Proof, orbit: Orbit, box: list[arb], passage: Passage) -> Proof:
    """The proof with measures and multipliers, and what follows from them."""
    n_xi = len(orbit.section)
    durations = [arb(0)] * (1 + orbit.arcs[-1].phase)
    for arc, duration in zip(orbit.arcs, box[n_xi:], strict=True):
        durations[arc.phase] += duration
    result = replace(
        proof,
        state=dict(zip(orbit.system.state_names, orbit.start(box[:n_xi])[:-1], strict=True)),
        durations=tuple(durations),
        measures=measures(orbit, passage, box[n_xi:]),
        multipliers=tuple(multipliers(orbit, passage)),
    )
    verdict = {True: "stable", False: "unstable", None: "whether it is stable is not shown"}[result.stable]
    words = f"{verdict}: the largest modulus of a multiplier is {result.spectral_radius}"
    claim = Claim("stability", proved=result.stable is not None, words=words)
    return replace(result, claims=(*result.claims, claim))


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
    """Whether the arcs follow the mode sequence and end with the events that it names.

    Raises
    ------
    ValueError
        If they do not.
    """
    phases = [arc.phase for arc in arcs]
    if phases != sorted(phases) or set(phases) != set(range(len(sequence.phases))):
        raise ValueError("the arcs do not follow the mode sequence of the problem")
    for j, (arc, after) in enumerate(zip(arcs, [*phases[1:], None], strict=True)):
        mode = sequence.phases[arc.phase]
        event = (
            BREAKPOINT if after == arc.phase else ending_margin(mode, None if after is None else sequence.phases[after])
        )
        segment = 0 if j == 0 else arcs[j - 1].segment + (arcs[j - 1].event == BREAKPOINT)
        if (arc.mode, arc.event, arc.segment) != (mode, event, segment):
            raise ValueError(
                f"arc {j + 1} is {arc.mode} on segment {arc.segment} until {arc.event}, but the mode sequence of the "
                f"problem has {mode} on segment {segment} until {event}"
            )


def _restore_arc(record: Mapping[str, Any]) -> Arc:
    steps = tuple(Step(h, tuple((lo, hi) for lo, hi in speeds)) for h, speeds in record["steps"])
    return Arc(Mode(record["mode"]), record["segment"], record["phase"], record["event"], steps)
