"""What several boxes prove together: a connected family of orbits, and what changes its sign along it."""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from math import prod

from flint import acb, arb, arb_mat

from gaitopt.mechanics.margins import IMPACT_MARGINS, PHASE_MARGINS, Margin
from gaitopt.proof.claims import Claim
from gaitopt.proof.graph import NotProved
from gaitopt.proof.theorem import Piece


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
