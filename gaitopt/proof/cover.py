"""Boxes that cover a family of gaits, each along a polynomial in the parameter and as long as can be proved."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from flint import arb

from gaitopt.gait import Gait
from gaitopt.proof.branch import sign_change_claim
from gaitopt.proof.check import check_box, silent
from gaitopt.proof.graph import NotProved
from gaitopt.proof.parameters import ball
from gaitopt.proof.parametric import Parametric, hull
from gaitopt.proof.search import is_usable, plan, refine, replan, unknowns, without_last
from gaitopt.proof.statement import Statement, parameter, polynomial
from gaitopt.proof.theorem import Piece

RADII = ("1e-10", "1e-12", "1e-14")
"""Half widths of the box of a single orbit in which it is shown to be unique, tried in this order."""
INFLATION = 4
"""Half widths of a box along a family, in what Newton's method leaves open."""
LEAST_RADIUS = 1e-16
DEGREES, DEGREES_OF_BRACKET, DEGREES_OF_POINT = (1, 2, 3, 3), (1, 1), (0, 0)
"""Of the polynomials in the parameter, from one Newton step to the next: a long box costs less than many short ones."""
NEARLY = 1.05
"""A box that reaches the end but for this is made a little longer."""
GROWTH = 1.6
"""Of the length of a box after a success; it is halved after a failure."""
LEAST = 1 / 32
"""Length, in that of the interval, below which a claim that is not shown is taken for one that does not hold."""
MOST_TRIES = 100
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
    search = _Cover(statement, gait, silent)
    for radius in RADII:
        record = search.record((), search.start, [radius] * len(search.start))
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
    search = _Cover(statement, gait, progress)
    lower, upper = statement.interval
    if statement.special is None:
        return [*reversed(list(search.walk(search.value, lower))), *search.walk(search.value, upper)]
    ends = [search.box((end, end), search.start, DEGREES_OF_POINT, at_end=True) for end in (lower, upper)]
    claim = sign_change_claim(statement.special, [piece for _, piece in ends])
    if not claim.proved:
        raise NotProved(claim.words)
    return [ends[0], *search.walk(lower, upper), ends[1]]


class _Cover:
    """A walk along a family.

    Attributes
    ----------
    value : of the parameter at the gait, in the unit of the interval.
    start : the gait.
    """

    def __init__(self, statement: Statement, gait: Gait, progress: Callable[[str], None]) -> None:
        self._statement, self._progress, self._tries, self.value = statement, progress, 0, ""
        p: arb | None = None
        interval: tuple[str, ...] = ()
        if statement.varied is not None:
            p = arb(float(gait.p[statement.varied]))
            _, _, unit = statement.interval[0].partition(" ")
            self.value = _text(float(p / ball(f"1 {unit}".strip())), unit)
            interval = (self.value, self.value)
        orbit = statement.orbit([[] for _ in statement.arcs], p)
        self._n_xi, self._lengths = orbit.n_xi, plan(orbit, gait)
        self.start, _ = self._orbit(interval, unknowns(orbit, gait), DEGREES_OF_POINT)

    def box(
        self, interval: Sequence[str], centre: Sequence[Any], degrees: Sequence[int], *, at_end: bool = False
    ) -> Found:
        """A box over an interval of the parameter, and what is proved on it.

        Raises
        ------
        NotProved
            If it is too long for that.
        """
        centre, left = self._orbit(interval, centre, degrees)
        record = self.record(interval, centre, [_digits(INFLATION * d + LEAST_RADIUS, 5) for d in left])
        piece = check_box(self._statement, record, at_end=at_end)
        doubtful = [claim.words for claim in piece.claims if not claim.proved and not claim.refuted]
        if doubtful and (piece.inner is None or _length(interval) > LEAST * _length(self._statement.interval)):
            raise NotProved(doubtful[0])
        return record, piece

    def walk(self, first: str, last: str) -> Iterator[Found]:
        """Boxes from one value of the parameter to another, or to the first one with a claim that does not hold.

        Raises
        ------
        NotProved
            If there would be too many of them.
        """
        degrees: Sequence[int] = DEGREES if self._statement.special is None else DEGREES_OF_BRACKET
        centre: Sequence[Any] = self.start
        (edge, unit), end = _number(first), _number(last)[0]
        length, before = end - edge, [edge, end]
        while edge != end:
            length = end - edge if abs(length) * NEARLY > abs(end - edge) else length
            span = sorted((edge, edge + length))
            texts = tuple(last if x == end else first if x == _number(first)[0] else _text(x, unit) for x in span)
            self._tries += 1
            if self._tries > MOST_TRIES:
                raise NotProved(f"the family is covered to {edge!r} with boxes {abs(length):.2g} long, not to {end!r}")
            try:
                box = self.box(texts, _moved(centre, before, span), degrees)
            except NotProved as failure:
                self._progress(f"{abs(length):.2g} is too long for a box at {edge!r}: {failure}")
                length /= 2
                continue
            yield box
            if not all(claim.proved for claim in box[1].claims):
                return
            centre, before, degrees = box[1].outer.centre, span, degrees[-1:]
            edge, length = _number(texts[0] if length < 0 else texts[1])[0], length * GROWTH
            self._progress(f"covered to {edge!r}, towards {end!r}")

    def record(self, interval: Sequence[str], centre: Sequence[Any], radii: list[str]) -> dict[str, Any]:
        """A box as a certificate states it."""
        coefficients = [value.coefficients if isinstance(value, Parametric) else [value] for value in centre]
        return {
            "interval": list(interval),
            "centre": [[_digits(c, CENTRE_DIGITS) for c in row] for row in coefficients],
            "radii": radii,
            "steps": without_last(self._lengths),
        }

    def _orbit(
        self, interval: Sequence[str], centre: Sequence[Any], degrees: Sequence[int]
    ) -> tuple[Sequence[Any], list[arb]]:
        """Orbits over an interval, and how far off they may be."""
        for degree in degrees:
            orbit = self._statement.orbit(without_last(self._lengths), parameter(interval, degree))
            centre, left, passage = refine(orbit, [_of_degree(value, degree) for value in centre])
        durations = [float(hull(T).mid()) for T in centre[self._n_xi :]]
        if not is_usable(self._lengths, durations):
            self._lengths = replan(orbit, passage.starts, durations)
        return centre, left


def _moved(centre: Sequence[Any], before: Sequence[float], span: Sequence[float]) -> list[Any]:
    """Polynomials on one interval of the parameter as polynomials on another one."""
    half = (before[1] - before[0]) / 2
    if not half or not isinstance(centre[0], Parametric):
        return list(centre)
    offset, ratio = (sum(span) - sum(before)) / 2 / half, (span[1] - span[0]) / 2 / half
    moved = []
    for value in centre:
        s = Parametric([arb(offset), arb(ratio), *[arb(0)] * (len(value.coefficients) - 2)])
        total: Any = value.coefficients[-1]
        for c in reversed(value.coefficients[:-1]):
            total = s * total + c
        moved.append(total.mid())
    return moved


def _of_degree(value: Any, degree: int) -> Any:
    coefficients = value.coefficients if isinstance(value, Parametric) else [value]
    return polynomial([*coefficients, *[arb(0)] * degree][: degree + 1])


def _number(text: str) -> tuple[float, str]:
    """A value of the parameter as the problem's file writes it, and its unit."""
    number, _, unit = text.partition(" ")
    return float(number), unit


def _text(number: float, unit: str) -> str:
    return f"{number!r} {unit}".strip()


def _length(interval: Sequence[str]) -> float:
    return abs(_number(interval[1])[0] - _number(interval[0])[0])


def _digits(value: arb, digits: int) -> str:
    return str(value.str(digits, radius=False, more=True))
