"""Boxes that cover a family of gaits, each centred on an orbit, tilted along it and as long as can be proved."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from flint import arb

from gaitopt.gait import Gait
from gaitopt.proof.box import Box
from gaitopt.proof.branch import sign_change_claim
from gaitopt.proof.check import check_box, krawczyk
from gaitopt.proof.graph import NotProved
from gaitopt.proof.orbit import Orbit
from gaitopt.proof.search import NEWTON_STEPS, is_usable, plan, planned, refine, replan, unknowns
from gaitopt.proof.statement import Statement
from gaitopt.proof.theorem import Piece

RADII = ("1e-10", "1e-12", "1e-14")
"""Half widths of the box of a single orbit in which it is shown to be unique, tried in this order."""
INFLATION = 4
"""Half widths of a tilted box, in those of the deviations from the tangent that Krawczyk's operator finds."""
LEAST_RADIUS = 1e-16
POINT = 1e-30
"""Half length of the boxes at the ends of a bracket: they hold one decimal."""
OVERLAP = 1e-6
"""Of neighbouring boxes, in their half lengths."""
GROWTH = 1.6
"""Of the length of a box after a success; it is halved after a failure."""
LEAST = 1 / 32
"""Half length, in that of the interval, below which a claim that is not shown is taken for one that does not hold."""
MOST_TRIES = 200
"""Boxes, with those that are too long, after which a cover is given up."""
CENTRE_DIGITS = 30

Found = tuple[dict[str, Any], Piece]


def tight_box(statement: Statement, gait: Gait) -> list[Found]:
    """The box of one gait.

    Raises
    ------
    NotProved
        If no steps can be verified.
    """
    lengths = plan(statement.orbit, gait)
    orbit = _with_steps(statement.orbit, lengths)
    point, _ = refine(orbit, unknowns(orbit, gait), None)
    for radius in RADII:
        record = _record(point, [radius] * len(point.centre), lengths)
        piece = check_box(statement, record)
        if piece.inner is not None:
            break
    return [(record, piece)]


def cover(statement: Statement, gait: Gait, progress: Callable[[str], None]) -> list[Found]:
    """Boxes from one end of the interval to the other; those at the ends of a bracket hold the end alone.

    Raises
    ------
    NotProved
        If the family cannot be followed, or the ends of a bracket cannot be told apart.
    """
    lower, upper = (end.mid() for end in statement.interval)
    search = _Cover(statement, gait, progress)
    if statement.special is None:
        return [*reversed(list(search.walk(search.start, lower))), *search.walk(search.start, upper)]
    points = [search.orbit(search.predicted(search.start, s)) for s in (lower, upper)]
    ends = [search.box(point, POINT, at_end=True) for point in points]
    claim = sign_change_claim(statement.special, [piece for _, piece in ends])
    if not claim.proved:
        raise NotProved(claim.words)
    return [ends[0], *search.walk(points[0], upper), ends[1]]


class _Cover:
    """A walk along a family.

    Attributes
    ----------
    start : the gait as a point of the family.
    """

    def __init__(self, statement: Statement, gait: Gait, progress: Callable[[str], None]) -> None:
        self._statement, self._orbit, self._progress = statement, statement.orbit, progress
        self._lengths = plan(self._orbit, gait)
        self._starts: Sequence[Sequence[arb]] = ()
        self._tries, self._least = 0, LEAST * float(statement.interval[1] - statement.interval[0])
        self.start = self.orbit(unknowns(self._orbit, gait), NEWTON_STEPS)

    def predicted(self, point: Box, s: arb) -> list[arb]:
        """The orbit for a value of the parameter, along the tangent."""
        return [(x + rate * (s - point.centre[-1])).mid() for x, rate in zip(point.centre, point.tangent, strict=True)]

    def orbit(self, u: list[arb], rounds: int = 1) -> Box:
        """An orbit and its tangent by Newton's method."""
        durations = [float(T) for T in u[self._orbit.n_xi : -1]]
        if not is_usable(self._lengths, durations):
            self._lengths = replan(self._orbit, self._starts, durations)
        point, passage = refine(_with_steps(self._orbit, self._lengths), u, len(u) - 1, rounds)
        self._starts = passage.starts
        return point

    def box(self, point: Box, half: float, *, at_end: bool) -> Found:
        """A box along the tangent at a point, and what is proved on it.

        Raises
        ------
        NotProved
            If it is too long for that.
        """
        deviation = [arb(0, LEAST_RADIUS)] * (len(point.centre) - 1) + [arb(0, half)]
        wide = replace(point, deviation=deviation)
        image = krawczyk(self._orbit.on(wide, planned(self._orbit, self._lengths)), wide)
        radii = [_digits(INFLATION * d.abs_upper() + LEAST_RADIUS, 5) for d in image.deviation[:-1]]
        record = _record(point, [*radii, repr(half)], self._lengths)
        piece = check_box(self._statement, record, at_end=at_end)
        doubtful = [claim.words for claim in piece.claims if not claim.proved and not claim.refuted]
        if doubtful and (piece.inner is None or half > self._least):
            raise NotProved(doubtful[0])
        return record, piece

    def walk(self, point: Box, target: arb) -> Iterator[Found]:
        """Boxes from a point to a value of the parameter, or to the first one with a claim that does not hold.

        Raises
        ------
        NotProved
            If there would be too many of them.
        """
        edge, end = float(point.centre[-1]), float(target)
        side, half = (1 if end > edge else -1), abs(end - edge) / 2
        while (end - edge) * side > 0:
            half = min(half, abs(end - edge) / 2)
            self._tries += 1
            if self._tries > MOST_TRIES:
                raise NotProved(f"the family is covered to {edge!r} with boxes {2 * half:.2g} long, not to {end!r}")
            try:
                point_there = self.orbit(self.predicted(point, arb(edge + side * half)))
                box = self.box(point_there, half * (1 + OVERLAP), at_end=False)
            except NotProved:
                half /= 2
                continue
            yield box
            if not all(claim.proved for claim in box[1].claims):
                return
            point, edge, half = point_there, edge + 2 * side * half, half * GROWTH
            self._progress(f"covered to {edge:.9g}, towards {end:.9g}")


def _record(point: Box, radii: list[str], lengths: Sequence[Sequence[float]]) -> dict[str, Any]:
    return {
        "centre": [_digits(value, CENTRE_DIGITS) for value in point.centre],
        "radii": radii,
        "along": point.along,
        "tangent": [float(rate) for rate in point.tangent],
        "steps": [list(steps[:-1]) for steps in lengths],
    }


def _digits(value: arb, digits: int) -> str:
    return str(value.str(digits, radius=False, more=True))


def _with_steps(orbit: Orbit, lengths: Sequence[Sequence[float]]) -> Orbit:
    return orbit.on(None, planned(orbit, lengths))
