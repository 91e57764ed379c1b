"""Re-verification of a certificate, in one pass and without any search: what is proved about the gait that it states.

On a box of deviations w from its centre, which in a family is a polynomial in the parameter, Krawczyk's operator

    K = -C F(centre) + (1 - C F_w(box)) w,       C an approximate inverse of F_w

proves, where K lies in the interior of the box for every value of the parameter, that F has exactly one zero in it, and
that it lies in K. Margins, impact and multipliers are then enclosed for every motion that starts in K.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from flint import arb, ctx

from gaitopt.proof.box import Box, identity
from gaitopt.proof.branch import MARGIN_CHANGES, connection_claim, sign_change_claim
from gaitopt.proof.claims import Claim, mode_sequence_claims
from gaitopt.proof.graph import NotProved
from gaitopt.proof.measures import measures, multipliers
from gaitopt.proof.orbit import Orbit, Passage
from gaitopt.proof.parametric import Parametric, at, hull
from gaitopt.proof.statement import Statement, restore_box, restore_statement
from gaitopt.proof.taylor import PRECISION
from gaitopt.proof.theorem import Piece, Proof, merged_claims, union_of_multipliers

STATEMENT, EXISTENCE, MOTION = "statement", "existence and uniqueness", "motion"
PARTS = 8
"""Parts of the interval of a parameter, on each of which multipliers are enclosed."""
INVERSE_ROUNDS = 2
"""Newton's method doubles the order in the parameter each time."""


def silent(words: str) -> None:
    """Progress that nobody is told of."""


def check(certificate: Mapping[str, Any], progress: Callable[[str], None] = silent) -> Proof:
    """Verify a certificate.

    Parameters
    ----------
    progress : is told in words how far the verification is.

    Raises
    ------
    KeyError, TypeError, AttributeError
        If it is no certificate at all.
    """
    before = ctx.cap
    try:
        with ctx.workprec(PRECISION):
            return _check(certificate, progress)
    finally:
        ctx.cap = before


def _check(certificate: Mapping[str, Any], progress: Callable[[str], None]) -> Proof:
    try:
        statement = restore_statement(certificate)
        if len(statement.records) != 1 and not statement.interval:
            raise ValueError(f"{len(statement.records)} boxes, but no parameter that varies")
        pieces: list[Piece] = []
        for k, record in enumerate(statement.records):
            at_end = k in (0, len(statement.records) - 1)
            pieces.append(check_box(statement, record, at_end=at_end))
            progress(f"box {k + 1} of {len(statement.records)}")
            if pieces[-1].inner is None:
                break
    except (ValueError, NotProved) as fault:
        claim = Claim(STATEMENT, proved=False, words=str(fault))
        return Proof(problem=str(certificate.get("problem")), claims=(claim,), certificate=certificate)
    return theorem(statement, pieces, certificate)


def theorem(statement: Statement, pieces: Sequence[Piece], certificate: Mapping[str, Any]) -> Proof:
    """What the boxes prove together."""
    at_every_box = tuple(merged_claims(pieces))
    if statement.special in MARGIN_CHANGES:
        at_every_box = tuple(claim for claim in at_every_box if claim.name == EXISTENCE)
    proof = Proof.of(statement.name, pieces, at_every_box, certificate)
    if any(piece.inner is None for piece in pieces) or (statement.interval and not proof.proved):
        return proof
    claims = list(at_every_box)
    if statement.interval:
        claims.append(connection_claim(pieces, statement.interval))
    claims.append(
        proof.stability_claim() if statement.special is None else sign_change_claim(statement.special, pieces)
    )
    return replace(proof, claims=tuple(claims))


def check_box(statement: Statement, record: Mapping[str, Any], *, at_end: bool = True) -> Piece:
    """What is proved on one box of a certificate.

    Inside a bracket multipliers are not needed, and beyond a violated margin the orbit is no gait.
    """
    orbit, box = restore_box(statement, record)
    claims: tuple[Claim, ...] = ()
    try:
        inner, words = prove_existence(orbit, box)
        claims = (Claim(EXISTENCE, proved=True, words=words),)
        passage = orbit.traverse(inner)
        if at_end or statement.special not in MARGIN_CHANGES:
            claims += tuple(mode_sequence_claims(orbit, passage))
        within = statement.special is not None and not at_end
        return _piece(orbit, record["interval"], box, inner, passage, claims, within=within)
    except NotProved as failure:
        name = MOTION if claims else EXISTENCE
        return Piece(box, None, record["interval"], (*claims, Claim(name, proved=False, words=str(failure))))


def _piece(
    orbit: Orbit,
    interval: Sequence[str],
    box: Box,
    inner: Box,
    passage: Passage,
    claims: tuple[Claim, ...],
    *,
    within: bool,
) -> Piece:
    durations = inner.hull[orbit.n_xi :]
    derivatives = orbit.return_maps(passage, PARTS)
    return Piece(
        box,
        inner,
        interval,
        claims,
        state=dict(zip(orbit.system.state_names, map(hull, passage.starts[0]), strict=False)),
        durations=orbit.phase_durations(durations),
        measures=measures(orbit, passage, durations),
        derivatives=derivatives,
        multipliers=() if within else union_of_multipliers(map(multipliers, derivatives)),
    )


def prove_existence(orbit: Orbit, box: Box) -> tuple[Box, str]:
    """A box that holds the only zeros in ``box``, and the claim in words.

    Krawczyk's operator is applied once more to its own result, which is far narrower.

    Raises
    ------
    NotProved
        If Krawczyk's test fails.
    """
    first = krawczyk(orbit, box)
    for name, outside, inside in zip(orbit.names, box.deviation, first.deviation, strict=True):
        if not outside.contains_interior(inside):
            raise NotProved(f"Krawczyk's operator moves {name} by {inside.str(5)}, out of {outside.str(3)}")
    radius = max(w.abs_upper() for w in box.deviation)
    words = f"exactly one periodic orbit lies within {radius.str(3, radius=False)} of the centre in every unknown"
    return krawczyk(orbit, first), words


def krawczyk(orbit: Orbit, box: Box) -> Box:
    """The box that Krawczyk's operator makes of one.

    Raises
    ------
    NotProved
        If the motion cannot be followed, or F_w is singular.
    """
    passage = orbit.traverse(box)
    F_w, F = orbit.slope(passage), orbit.residual(passage)
    C = approximate_inverse(F_w)
    K = hull(identity(len(box.centre)) - C * F_w) * box.column - hull(C * F)
    return replace(box, deviation=K.entries())


def approximate_inverse(matrix: Any) -> Any:
    """Next to the inverse of the middle of a matrix, by Newton's method where it depends on a parameter.

    Raises
    ------
    NotProved
        If it is singular.
    """
    try:
        C = at(matrix, arb(0)).mid().inv().mid()
    except ZeroDivisionError as failure:
        raise NotProved("the derivative of the shooting equations is singular") from failure
    for _ in range(INVERSE_ROUNDS if isinstance(matrix, Parametric) else 0):
        C = (2 * C - C * matrix * C).mid()
    return C
