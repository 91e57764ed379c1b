"""Boxes that cover a family, each tilted along it and as long as can be proved; one for a single gait."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from flint import arb

from gaitopt.gait import Gait
from gaitopt.proof.branch import sign_change_claim
from gaitopt.proof.certificate import BoxRecord
from gaitopt.proof.check import check_box
from gaitopt.proof.graph import NotProved
from gaitopt.proof.krawczyk import deviations
from gaitopt.proof.orbit import Arc, Orbit
from gaitopt.proof.parameters import ball
from gaitopt.proof.search import newton, plan
from gaitopt.proof.statement import Statement
from gaitopt.proof.theorem import Piece

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
LEAST = 1 / 256
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
        return length > LEAST * whole

    def _text(self, value: float) -> str:
        return f"{value!r} {self._unit}".strip()


def _digits(value: arb) -> str:
    return str(value.str(DIGITS, radius=False, more=True))
