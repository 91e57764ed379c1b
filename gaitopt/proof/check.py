"""Re-verification of a certificate, in one pass and without any search: what is proved about its gait.

What several boxes prove together: a connected family of orbits, and what changes its sign along it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from math import prod
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb, arb_mat

from gaitopt.model.margins import IMPACT_MARGINS, PHASE_MARGINS, Margin
from gaitopt.proof.certificate import BoxRecord, read_certificate
from gaitopt.proof.claims import Claim, measures, mode_claim_names, mode_sequence_claims
from gaitopt.proof.graph import NotProved, at, precision
from gaitopt.proof.orbit import Box, deviations, krawczyk, preconditioned, require_contraction, return_map
from gaitopt.proof.statement import (
    Piece,
    Proof,
    Statement,
    merged_claims,
    restore_box,
    restore_statement,
    union,
    union_of_multipliers,
)
from gaitopt.proof.taylor import PRECISION


def _ending(*tables: Mapping[str, Margin], ending: str | None) -> tuple[str, ...]:
    """The margins whose fall ends a motion in this way; None where another mode or impact follows."""
    return tuple(name for table in tables for name, margin in table.items() if margin.ending == ending)


MARGIN_CHANGES: Mapping[str, tuple[str, ...]] = {
    "mode_change": _ending(PHASE_MARGINS, ending=None),
    "impact_change": _ending(IMPACT_MARGINS, ending=None),
    "lift_off": _ending(PHASE_MARGINS, IMPACT_MARGINS, ending="lift_off"),
    "painleve": _ending(PHASE_MARGINS, IMPACT_MARGINS, ending="painleve"),
}
"""Types of special points beyond which the orbit continues, but is no gait of its mode sequence, and the margins of
which one is negative there."""
CONNECTION, SIGN_CHANGE = "connected family", "sign change"


def connection_claim(pieces: Sequence[Piece], interval: Sequence[str]) -> Claim:
    """Every value of the parameter is covered, and where two boxes meet the orbit of one is that of the other."""
    for k, (piece, following) in enumerate(pairwise(pieces), start=1):
        if not _joined(piece, following):
            return Claim(CONNECTION, proved=False, words=f"boxes {k} and {k + 1} are not shown to hold the same orbit")
    ends = [pieces[0].interval[0], pieces[-1].interval[1]] == list(interval)
    words = f"the orbits form one smooth family, without a gap, in {len(pieces)} boxes"
    return Claim(CONNECTION, proved=ends, words=words if ends else "the boxes do not reach both ends of the interval")


def sign_change_claim(kind: str, pieces: Sequence[Piece]) -> Claim:
    """That what defines a type of special point changes its sign between the first box and the last."""
    try:
        words = _margin(kind, pieces) if kind in MARGIN_CHANGES else _CHANGES[kind](pieces)
    except NotProved as failure:
        return Claim(SIGN_CHANGE, proved=False, words=str(failure))
    return Claim(SIGN_CHANGE, proved=True, words=words)


def _joined(piece: Piece, following: Piece) -> bool:
    """Whether the orbit at the end of one box lies where that of the other is unique, at the same parameter."""
    if piece.inner is None or following.inner is None or piece.interval[1] != following.interval[0]:
        return False
    there, here = (
        (piece.outer.at(arb(1)), piece.inner.at(arb(1))),
        (following.outer.at(arb(-1)), following.inner.at(arb(-1))),
    )
    return _within(here[1], there[0]) or _within(there[1], here[0])


def _within(inner: Sequence[arb], outer: Sequence[arb]) -> bool:
    return all(b.contains(a) for a, b in zip(inner, outer, strict=True))


def _neimark_sacker(pieces: Sequence[Piece]) -> str:
    outside = [_number_outside(pieces[k].multipliers) for k in (0, -1)]
    if abs(outside[0] - outside[1]) != 2:
        raise NotProved(f"{outside[0]} and {outside[1]} multipliers are outside the unit circle at the ends")
    for matrix in (matrix for piece in pieces for matrix in piece.derivatives):
        for real in (1, -1):
            unit = arb_mat([[real * int(i == j) for j in range(matrix.ncols())] for i in range(matrix.nrows())])
            if not (matrix - unit).det() != 0:
                raise NotProved(f"a multiplier may pass through {real}")
    return (
        f"{outside[0]} multipliers are outside the unit circle at one end and {outside[1]} at the other, and none is 1 "
        "or -1 in between: a complex pair crosses the unit circle"
    )


def _period_doubling(pieces: Sequence[Piece]) -> str:
    ends = [prod((m + 1 for m in pieces[k].multipliers), start=acb(1)).real for k in (0, -1)]
    if not ends[0] * ends[1] < 0:
        shown = " and ".join(str(end.str(6)) for end in ends)
        raise NotProved(f"the product of all multipliers plus one is {shown} at the ends: no change of sign")
    return "the product of all multipliers plus one changes its sign: one of them is -1 in between"


def gait_end(pieces: Sequence[Piece]) -> int | None:
    """The end of a bracket, 0 or -1, at which alone the orbit is a gait of the mode sequence."""
    gaits = [k for k in (0, -1) if all(claim.proved for claim in pieces[k].claims)]
    return gaits[0] if len(gaits) == 1 else None


def _margin(kind: str, pieces: Sequence[Piece]) -> str:
    end = gait_end(pieces)
    if end is None:
        raise NotProved("it is not shown that the mode sequence holds at one end and is violated at the other")
    refuted = [claim for claim in pieces[-1 - end].claims if claim.refuted]
    if not refuted:
        raise NotProved("it is not shown that the mode sequence is violated at the other end")
    foreign = [claim for claim in refuted if claim.violated not in MARGIN_CHANGES[kind]]
    if foreign:
        raise NotProved(f"what is violated at the other end makes it no {kind}: {foreign[0].words}")
    here, there = ("lower", "upper") if end == 0 else ("upper", "lower")
    return (
        f"at the {here} end it is a gait of its mode sequence; at the {there} end it is none, because a margin that "
        f"makes a {kind} is negative: {refuted[0].name}: {refuted[0].words}"
    )


def _number_outside(multipliers: Sequence[acb]) -> int:
    moduli = [abs(m) for m in multipliers]
    if any(modulus.contains(1) for modulus in moduli):
        raise NotProved("whether a multiplier is outside the unit circle at an end is not shown")
    return sum(bool(modulus > 1) for modulus in moduli)


_CHANGES: Mapping[str, Callable[[Sequence[Piece]], str]] = {
    "neimark_sacker": _neimark_sacker,
    "period_doubling": _period_doubling,
}
BRACKETED = (*_CHANGES, *MARGIN_CHANGES)
"""Types of special points that can be bracketed."""


STATEMENT, EXISTENCE, MOTION = "statement", "existence and uniqueness", "motion"
COMPLETENESS = "completeness"
PARTS = [arb(2 * k + 1 - 16, 1) / 16 for k in range(16)]
"""Of the interval of a parameter, on each of which multipliers are enclosed."""


def silent(words: str) -> None:
    """Progress that is not shown."""


def check(certificate: Mapping[str, Any], progress: Callable[[str], None] = silent) -> Proof:
    """Verify a certificate.

    Parameters
    ----------
    progress : called with words on how far the verification is.

    Raises
    ------
    StorageError
        If it is no certificate: a field is missing, unknown, or holds what it cannot hold.
    """
    with precision(PRECISION):
        return _check(certificate, progress)


def _check(certificate: Mapping[str, Any], progress: Callable[[str], None]) -> Proof:
    name = str(certificate.get("problem"))[:80]
    statement: Statement | None = None
    try:
        statement = restore_statement(read_certificate(certificate))
        if not statement.records:
            raise ValueError("it has no boxes: nothing is proved")
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
        return Proof(name, (claim,), certificate, statement.words if statement else {})
    return theorem(statement, pieces, certificate)


def theorem(statement: Statement, pieces: Sequence[Piece], certificate: Mapping[str, Any]) -> Proof:
    """What the boxes prove together.

    Every box has to show ``EXISTENCE`` and the claims of the mode sequence. In a bracket of a violated margin only the
    end at which the orbit is a gait shows the latter, and what fails at the other end is what the sign change is about.
    """
    modes = mode_claim_names(statement.system, statement.sequence, statement.arcs)
    special, shown = statement.special, list(pieces)
    if special in MARGIN_CHANGES:
        end = gait_end(pieces)
        if end is not None:
            shown[1:-1] = [_existence_of(piece) for piece in shown[1:-1]]
            shown[-1 - end] = _existence_of(shown[-1 - end])
    claims = list(merged_claims(shown))
    required = [EXISTENCE, *modes]
    incomplete = [
        name
        for k, piece in enumerate(pieces)
        for name in (required if special not in MARGIN_CHANGES or k == 0 or k == len(pieces) - 1 else [EXISTENCE])
        if name not in {claim.name for claim in piece.claims}
    ]
    proof = Proof(statement.name, tuple(claims), certificate, statement.words).about(pieces)
    if incomplete or any(piece.inner is None for piece in pieces):
        if proof.proved:
            words = f"is not shown on every box: {', '.join(incomplete) or 'the motion'}"
            proof = replace(proof, claims=(*claims, Claim(COMPLETENESS, proved=False, words=words)))
        return proof
    if statement.interval and special not in MARGIN_CHANGES and not proof.proved:
        return proof
    if statement.interval:
        claims.append(connection_claim(pieces, statement.interval))
    claims.append(proof.stability_claim() if special is None else sign_change_claim(special, pieces))
    return replace(proof, claims=tuple(claims))


def _existence_of(piece: Piece) -> Piece:
    """A box without its claims on the mode sequence."""
    return replace(piece, claims=tuple(claim for claim in piece.claims if claim.name in (EXISTENCE, MOTION)))


def check_box(statement: Statement, record: BoxRecord, *, at_end: bool = True) -> Piece:
    """What is proved on one box of a certificate.

    For a single orbit margins and multipliers are enclosed on the image of the box under Krawczyk's operator.
    Inside a bracket multipliers are not needed, and beyond a violated margin the orbit is no gait.
    """
    orbit, box = restore_box(statement, record)
    piece = Piece(box, record.interval)
    try:
        passage = orbit.traverse(box)
        defect = preconditioned(orbit, passage)
        line = orbit.traverse(replace(box, deviation=[arb(0)] * orbit.size)) if orbit.is_long else passage
        image = krawczyk(orbit, box, line, defect)
        piece = replace(piece, image=image)
        require_contraction(orbit, box, image)
        radius = max(w.abs_upper() for w in box.deviation).str(3, radius=False)
        words = f"exactly one periodic orbit lies within {radius} of the centre in every unknown"
        piece = replace(piece, claims=(Claim(EXISTENCE, proved=True, words=words),))
        if not orbit.is_long:
            narrow = Box(box.centre, box.tilt, [move.union(arb(0)) for move in deviations(box, image)])
            passage = orbit.traverse(narrow)
            defect = preconditioned(orbit, passage)
            image = krawczyk(orbit, narrow, passage, defect)
        derivative = return_map(orbit, box, passage, defect)
        derivatives = [at(derivative, s) for s in (PARTS if orbit.is_long else [arb(0)])]
        if at_end or statement.special not in MARGIN_CHANGES:
            piece = replace(piece, claims=(*piece.claims, *mode_sequence_claims(orbit, passage)))
        hull = image.hull
        durations = [hull[entry] for entry in orbit.durations]
        return replace(
            piece,
            inner=image,
            state=dict(zip(orbit.system.state_names, hull, strict=False)),
            durations=orbit.phase_durations(durations),
            measures=measures(orbit, passage, sum(durations, arb(0))),
            derivatives=derivatives,
            multipliers=() if statement.special is not None and not at_end else multipliers(derivatives),
        )
    except NotProved as failure:
        claim = Claim(MOTION if piece.claims else EXISTENCE, proved=False, words=str(failure))
        return replace(piece, claims=(*piece.claims, claim))


def multipliers(derivatives: Sequence[arb_mat]) -> tuple[acb, ...]:
    """Eigenvalues of the return map's derivative on all parts of a box, largest modulus first.

    Raises
    ------
    NotProved
        If the bounds of the derivative are too wide to enclose them.
    """
    return union_of_multipliers(
        sorted(eigenvalues(matrix), key=lambda m: (-float(m.abs_upper()), -float(m.real), -float(m.imag)))
        for matrix in derivatives
    )


def eigenvalues(matrix: arb_mat) -> list[acb]:
    """Gershgorin's discs in the basis of approximate eigenvectors; those that overlap stand for each of them.

    Raises
    ------
    NotProved
        If there is no such basis.
    """
    n = matrix.nrows()
    try:
        _, vectors = np.linalg.eig(np.array([[float(value.mid()) for value in row] for row in matrix.tolist()]))
        V = acb_mat([[acb(complex(value)) for value in row] for row in vectors])
        A = V.inv() * acb_mat(matrix) * V
    except (ZeroDivisionError, np.linalg.LinAlgError) as failure:
        raise NotProved("the multipliers cannot be enclosed: the eigenvectors are not independent") from failure
    radii = [arb(0, sum((abs(A[i, j]) for j in range(n) if j != i), arb(0)).upper()) for i in range(n)]
    discs = [A[i, i] + acb(radius, radius) for i, radius in enumerate(radii)]
    for _ in range(n):
        discs = [union(disc for disc in discs if disc.overlaps(own)) for own in discs]
    return discs
