"""Proof of a gait or of a family: boxes are found by search in long precision, and each is checked like any other.

What a proof is tried with: precise orbits, and steps that can be verified. Nothing here has to be right.

Boxes that cover a family, each tilted along it and as long as can be proved; one for a single gait.
"""

import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from importlib.metadata import version
from math import floor, log10
from typing import Any

import numpy as np
from flint import arb

from gaitopt.errors import ProblemError, StorageError, UnknownNameError
from gaitopt.gait.gait import Gait
from gaitopt.model.margins import ending_margin
from gaitopt.proof.certificate import SCHEMA, BoxRecord, read_certificate, reference_record
from gaitopt.proof.check import EXISTENCE, STATEMENT, check_box, sign_change_claim, silent, theorem
from gaitopt.proof.claims import Claim
from gaitopt.proof.graph import NotProved, precision
from gaitopt.proof.orbit import BREAKPOINT, Arc, Box, Orbit, column, deviations, exact, middle
from gaitopt.proof.statement import (
    INTERVAL,
    Piece,
    Proof,
    Statement,
    ball,
    exact_texts,
    refuse_what_is_not_modelled,
    restore_statement,
)
from gaitopt.proof.taylor import PRECISION, Field, expand

LEAST = 1e-300
SAFETY, LARGEST_GROWTH, LARGEST_CUT = 0.9, 1.5, 0.6
"""The next step relative to one with a remainder of 10^-order, and bounds of its length relative to the last."""


def arcs_of(gait: Gait) -> list[Arc]:
    """The arcs of a gait, without steps."""
    cycle, arcs, first = gait.problem.cycle, [], 0
    for step in gait.steps:
        lasts = [k + 1 == len(step.arc_phases) or step.arc_phases[k + 1] != p for k, p in enumerate(step.arc_phases)]
        for arc, phase, last in zip(step.arcs, step.arc_phases, lasts, strict=True):
            event = ending_margin(arc.mode, cycle.after(first + phase)) if last else BREAKPOINT
            arcs.append(Arc(arc.mode, int(arc.segment), first + phase, event, ()))
        first += len(step.phases)
    return arcs


def plan(orbit: Orbit, gait: Gait) -> tuple[list[Arc], list[arb]]:
    """Arcs with the steps of their integration, and the nodes and durations of a gait in doubles."""
    arcs, nodes = [], list[arb]()
    for j, (arc, doubles) in enumerate(zip(orbit.arcs, gait.arcs, strict=True)):
        start = [*map(arb, map(float, doubles.states[0])), arb(float(doubles.start))]
        if arc.mode.sticks:
            start[-2] = arb(0)
        lengths, states = _steps(orbit, orbit.field(arc.mode, j), orbit.middle(start, 0), float(doubles.duration))
        arcs.append(replace(arc, fractions=tuple(h / float(doubles.duration) for h in lengths[:-1])))
        nodes += [value for y in states for value in y[: orbit.n]]
    return arcs, [*nodes, *(arb(float(arc.duration)) for arc in gait.arcs)]


def newton(orbit: Orbit, centre: Sequence[arb]) -> tuple[list[arb], list[arb]]:
    """A step of Newton's method for the orbit in the middle of the interval, and its derivative in the parameter."""
    zero = [arb(0)] * orbit.size
    passage = orbit.traverse(Box(centre, zero, zero))
    matrix = middle(orbit, passage)
    C = np.linalg.inv(matrix[:, :-1])
    residual = [arb(0)] * orbit.size
    for row, values in passage.residual.items():
        residual[row : row + len(values)] = values
    change = exact(C) * column(residual)
    rate = -C @ matrix[:, -1]
    return [(u - d).mid() for u, d in zip(centre, change.entries(), strict=True)], [*map(arb, rate.tolist())]


def _steps(orbit: Orbit, field: Field, y: list[arb], duration: float) -> tuple[list[float], list[list[arb]]]:
    """Lengths of the steps of an arc, and the states between them."""
    left, h, lengths, states = duration, duration, list[float](), [y]
    while left > 0:
        h = left if h > left else min(h, left / 2) if 2 * h > left else h
        try:
            step = expand(field, y, arb(h), orbit.order)
        except NotProved:
            h *= LARGEST_CUT
            continue
        last = max(float(c[-1].abs_upper()) for c in step.beyond)
        ratio = SAFETY * (10.0**-orbit.order / max(last, LEAST)) ** (1 / orbit.order) / h
        if ratio < LARGEST_CUT:
            h *= LARGEST_CUT
            continue
        y, left = [value.mid() for value in step.end], left - h
        lengths.append(h)
        states.append(y)
        h *= min(ratio, LARGEST_GROWTH)
    return lengths, states


RADIUS = 1e-11
"""Half width of the box of a single orbit in which it is shown to be unique, in every unknown."""
SHARE, LEAST_RADIUS = 0.003, 1e-12
"""Half widths that are tried first for a family, in its tilt and at least."""
INFLATION = 1.25
"""Half widths that are tried next, in what Krawczyk's operator makes of the last ones."""
ROUNDS = 4
"""How often that is tried."""
GROWTH, CUT = 1.25, 0.6
"""Of the length of a box after a success; after a failure it is multiplied by ``CUT``."""
LEAST_COVER = 1 / 256
"""Length, in that of the interval, below which a claim that is not shown is taken for one that does not hold."""
MOST_TRIES = 1000
"""Boxes, with those that are too long, after which a cover is given up."""
DIGITS = 30

CheckedBox = tuple[BoxRecord, Piece]


def cover(statement: Statement, gait: Gait, progress: Callable[[str], None]) -> tuple[Sequence[Arc], list[CheckedBox]]:
    """Arcs with their steps, and boxes from one end of the interval to the other; at the ends of a bracket points.

    Raises
    ------
    NotProved
        If the family cannot be followed, or the ends of a bracket cannot be distinguished.
    """
    search = _Cover(statement, gait, progress)
    return search.statement.arcs, list(search.boxes())


class _Cover:
    """A walk along a family.

    Attributes
    ----------
    statement : with the steps of the integration.
    """

    def __init__(self, statement: Statement, gait: Gait, progress: Callable[[str], None]) -> None:
        self._progress, self._tries, self._curvature = progress, 0, list[float]()
        self._value, self._unit = 0.0, ""
        if statement.varied is not None:
            self._unit = statement.interval[0].partition(" ")[2]
            self._value = float(arb(float(gait.p[statement.varied])) / ball(f"1 {self._unit}".strip()))
        here = (self._text(self._value),) * 2 if statement.varied is not None else ()
        arcs, centre = plan(statement.orbit(here), gait)
        self.statement = replace(statement, arcs=arcs)
        self._start = (self.statement.orbit(here), *newton(self.statement.orbit(here), centre))

    def boxes(self) -> Iterator[CheckedBox]:
        """All boxes in order of the parameter."""
        statement = self.statement
        if statement.varied is None:
            yield self._box((), self._start)[0]
            return
        lower, upper = (float(end.partition(" ")[0]) for end in statement.interval)
        if statement.special is None:
            yield from reversed(list(self._walk(self._value, lower)))
            yield from self._walk(self._value, upper)
            return
        ends = [self._box((end, end), self._start, at_end=True)[0] for end in statement.interval]
        claim = sign_change_claim(statement.special, [piece for _, piece in ends])
        if not claim.proved:
            raise NotProved(claim.words)
        yield ends[0]
        yield from self._walk(lower, upper)
        yield ends[1]

    def _walk(self, edge: float, end: float) -> Iterator[CheckedBox]:
        """Boxes from one value of the parameter to another, or to the first one with a claim that does not hold."""
        length, start = end - edge, self._start
        while edge != end:
            following = end if abs(length) >= abs(end - edge) else edge + length
            self._tries += 1
            if self._tries > MOST_TRIES:
                raise NotProved(f"the family is covered to {edge!r} with boxes {abs(length):.2g} long, not to {end!r}")
            try:
                box, start = self._box(tuple(map(self._text, sorted((edge, following)))), start)
            except NotProved as failure:
                self._progress(f"{abs(length):.2g} is too long for a box at {edge!r}: {failure}")
                length = (following - edge) * CUT
                continue
            yield box
            if not all(claim.proved for claim in box[1].claims):
                return
            edge, length = following, (following - edge) * GROWTH
            self._progress(f"covered to {edge!r}, towards {end!r}")

    def _box(self, interval: Sequence[str], start: Any, *, at_end: bool = False) -> tuple[CheckedBox, Any]:
        """A box over an interval of the parameter and what is proved on it, and the orbit in its middle.

        Raises
        ------
        NotProved
            If it is too long for that.
        """
        orbit = self.statement.orbit(interval)
        before, centre, rate = start
        if orbit.interval:
            moved = orbit.interval[0] - before.interval[0]
            centre = [(u + v * moved).mid() for u, v in zip(centre, rate, strict=True)]
        place = (orbit.interval[0], arb(0)) if orbit.interval else ()
        point = Orbit(orbit.system, orbit.p, orbit.varied, place, orbit.sequence, orbit.arcs, orbit.order)
        centre, rate = newton(point, centre)
        half = orbit.interval[1].mid() if orbit.interval else arb(0)
        tilt = [(v * half).mid() for v in rate]
        radii = self._radii(tilt, float(half))
        for _ in range(ROUNDS):
            record = BoxRecord(
                interval=list(interval),
                centre=[_digits(u) for u in centre],
                tilt=[_digits(v) for v in tilt],
                radii=[f"{radius:.2e}" for radius in radii],
            )
            piece = check_box(self.statement, record, at_end=at_end)
            if half == 0 or piece.image is None or piece.claims[0].proved:
                break
            moves = deviations(piece.outer, piece.image)
            centre = [(u + move.mid()).mid() for u, move in zip(centre, moves, strict=True)]
            radii = [INFLATION * float(move.rad()) + LEAST_RADIUS for move in moves]
        if half != 0 and piece.inner is not None:
            self._curvature = [radius / float(half) ** 2 for radius in radii]
        doubtful = [claim.words for claim in piece.claims if not claim.proved and not claim.refuted]
        moduli = [abs(m) for m in piece.multipliers]
        if self.statement.special is None and not (all(m < 1 for m in moduli) or any(m > 1 for m in moduli)):
            doubtful.append("whether it is stable is not shown")
        if doubtful and (piece.inner is None or self._is_long(interval)):
            raise NotProved(doubtful[0])
        return (record, piece), (point, centre, rate)

    def _radii(self, tilt: Sequence[arb], half: float) -> list[float]:
        if half == 0:
            return [RADIUS] * len(tilt)
        if self._curvature:
            return [max(curvature * half**2, LEAST_RADIUS) for curvature in self._curvature]
        return [SHARE * float(abs(v)) + LEAST_RADIUS for v in tilt]

    def _is_long(self, interval: Sequence[str]) -> bool:
        if not interval:
            return False
        length, whole = (float(abs(ball(b) - ball(a))) for a, b in (interval, self.statement.interval))
        return length > LEAST_COVER * whole

    def _text(self, value: float) -> str:
        return f"{value!r} {self._unit}".strip()


def _digits(value: arb) -> str:
    return str(value.str(DIGITS, radius=False, more=True))


ORDER, ORDER_OF_FAMILY = 20, 16
"""Of the integration of a narrow box, and of a long one."""
WIDTHS = (1e-8, 1e-7, 1e-6, 1e-5)
"""Of brackets of special points, tried in this order."""


def prove(gait: Gait, intervals: Mapping[str, str] | None = None, *, progress: Callable[[str], None] = silent) -> Proof:
    """Prove that a gait exists, is locally unique, has its mode sequence, and is stable or unstable.

    What ``gaitopt.prove`` does, which documents the arguments; ``progress`` called with words on how far the search is.
    """
    texts = _texts(gait, intervals or {})
    proof = _prove(gait, texts, progress)
    if intervals and len(intervals) == 1 and not proof.claims[0].proved:
        proof = _prove(gait, texts, progress, varied=next(iter(intervals)))
    return proof


def prove_special(
    gait: Gait, parameter: str, kind: str, width: float | None = None, *, progress: Callable[[str], None] = silent
) -> Proof:
    """Prove that a family of gaits has a special point next to one of them.

    Parameters
    ----------
    gait : converged, at the special point as well as that is known.
    parameter : dotted key of what varies.
    kind : one of ``BRACKETED``: a bifurcation, or a change of the mode sequence or of the impact.
    width : of the bracket in the parameter; None for the narrowest whose ends can be distinguished.
    """
    value = gait.dynamics.parameter(parameter)
    for interval in brackets(value, WIDTHS if width is None else (width,)):
        proof = _prove(gait, _texts(gait, {parameter: interval}), progress, varied=parameter, special=kind)
        if proof.proved:
            break
    return proof


def brackets(value: float, widths: Sequence[float]) -> Iterator[str]:
    """Intervals of given widths around a value, their ends in few digits."""
    for width in widths:
        places = 1 - floor(log10(width))
        lower, upper = (f"{end:.{places}f}" for end in (value - width / 2, value + width / 2))
        if float(lower) == float(upper):
            raise UnknownNameError(f"a bracket of width {width:g} around {value!r} has no length; use a wider one")
        yield f"{lower}{INTERVAL}{upper}"


def _prove(
    gait: Gait,
    texts: Mapping[str, str],
    progress: Callable[[str], None],
    *,
    varied: str | None = None,
    special: str | None = None,
) -> Proof:
    """The proof with the boxes that a search has found, or without any."""
    header = _header(gait, texts, varied, special)
    try:
        refuse_what_is_not_modelled(gait.problem, gait.system)
    except NotProved as failure:
        return Proof(gait.problem.name, (Claim(STATEMENT, proved=False, words=str(failure)),), header)
    with precision(PRECISION):
        try:
            statement = restore_statement(read_certificate({**header, "arcs": _arcs(arcs_of(gait))}))
        except (ValueError, StorageError) as error:  # of an interval, as everything else is the gait's
            raise ProblemError(f"{gait.problem.name}: {error}") from error
        try:
            arcs, boxes = cover(statement, gait, progress)
        except NotProved as failure:
            claim = Claim(EXISTENCE, proved=False, words=f"no boxes can be verified: {failure}")
            return Proof(gait.problem.name, (claim,), header, statement.words)
        records, pieces = zip(*boxes, strict=True)
        certificate = {**header, "arcs": _arcs(arcs), "boxes": [record.model_dump() for record in records]}
        return theorem(replace(statement, arcs=arcs), pieces, certificate)


def _arcs(arcs: Sequence[Arc]) -> list[dict[str, Any]]:
    return [{**asdict(arc), "mode": str(arc.mode), "fractions": list(arc.fractions)} for arc in arcs]


def _texts(gait: Gait, intervals: Mapping[str, str]) -> dict[str, str]:
    texts = exact_texts(gait.problem, gait.dynamics.parameters)
    for key, interval in intervals.items():
        if key not in texts:
            raise UnknownNameError(f"no parameter is called {key!r}; there are {', '.join(texts)}")
        texts[key] = INTERVAL.join(end.strip() for end in interval.split(INTERVAL))
    return texts


def _header(gait: Gait, texts: Mapping[str, str], varied: str | None, special: str | None) -> dict[str, Any]:
    """Everything that a proof is checked from, except its boxes."""
    return {
        "schema": SCHEMA,
        "problem": gait.problem.name,
        "resolved": replace(gait.problem, origin=None).resolved(),
        "parameters": texts,
        "reference": reference_record(gait.system.control),
        "varied": varied,
        "special": special,
        "order": ORDER if varied is None or special is not None else ORDER_OF_FAMILY,
        "arcs": [],
        "boxes": [],
        "versions": {name: version(name) for name in ("gaitopt", "casadi", "python-flint")}
        | {"python": platform.python_version()},
    }
