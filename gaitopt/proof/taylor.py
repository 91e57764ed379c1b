"""Validated Taylor integration: one step of an analytic vector field, with a rigorous remainder.

If F(B) lies in V for the box B = y0 + [0, h] V, the motion stays in B (Picard), even in y0 + [0, h] F(B). With the
Taylor coefficients F_k(y) of the motion that starts at y

    y(h) = sum_{k < N} F_k(y0) h^k + F_N(B) h^N                                  (Lagrange)

The same holds for any analytic g(y) along the motion, and for the first variation Phi, whose N-th coefficient at a
later time is Phi_N(B) Phi. Everything holds for every y0 in a box.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flint import arb, arb_mat, arb_series, ctx

from gaitopt.proof.field import LOW_DEGREE, Field
from gaitopt.proof.graph import Graph, NotProved
from gaitopt.proof.parametric import hull, matrix, scattered, series, truncated

ORDER = 22
"""N of the state."""
LOW_ORDER = 18
"""N of first variations and of what is observed along the motion: signs and multipliers need fewer digits."""
PRECISION = 128
"""Bits of the state; of all else ``LOW_PRECISION``."""
LOW_PRECISION = 80
PICARD_ROUNDS = 8
"""Attempts to find a box that the motion does not leave within a step."""
WIDENING, LEAST_WIDENING = 0.05, 1e-7
"""By which rates are widened before each attempt, in their own widths and in 1 / s."""


@dataclass(frozen=True, slots=True)
class Series:
    """A function of time on [0, h] as sum_k c_k t^k, the last coefficient a ball for the remainder; its rate alike."""

    value: list[arb]
    rate: list[arb]


@dataclass(frozen=True, slots=True)
class Expansion:
    """The motions over one step, from every point of a box.

    Attributes
    ----------
    field : the vector field.
    series : low-order Taylor coefficients of the motions from the box.
    beyond : of motions from anywhere in B.
    h : length of the step.
    end : a box in which the motions end, wider than it has to be.
    """

    field: Field
    series: list[list[Any]]
    beyond: list[list[arb]]
    h: Any
    end: list[Any]

    def shooting_jacobian(self) -> Any:
        """Derivative of the end with respect to the start, shape (n, n)."""
        n = self.field.n
        with ctx.workprec(LOW_PRECISION):
            at_start, later = _matrices(self.field, self.series), _matrices(self.field.hull, self.beyond)
            steepest = max(sum((abs(later[0][i, j]) for j in range(n)), arb(0)).upper() for i in range(n))
            deviation = arb(0, ((steepest * hull(self.h)).exp() - 1).upper())
            passed = arb_mat(n, n, [deviation + int(i == j) for i in range(n) for j in range(n)])
            total = _variations(later, LOW_ORDER)[-1] * passed
            for term in reversed(_variations(at_start, LOW_ORDER - 1)):
                total = total * self.h + term
            return total

    def along(self, graph: Graph) -> list[Series]:
        """The outputs of a graph of the state along the motions."""
        with ctx.workprec(LOW_PRECISION):
            pairs = zip(_compose(graph, self.series), _compose(graph, self.beyond), strict=True)
            values = [[*map(hull, at_start[:LOW_ORDER]), hull(later[LOW_ORDER])] for at_start, later in pairs]
            return [Series(c, [k * c[k] for k in range(1, len(c))]) for c in values]


def expand(field: Field, start: Sequence[Any], h: Any) -> Expansion:
    """One verified step from every point of the box ``start``.

    Raises
    ------
    NotProved
        If no box is found that the motion cannot leave, or its series are not finite there.
    """
    if not hull(h) > 0:
        raise NotProved(f"{field.mode}: a step of {hull(h).str(5)} s")
    low, h = [truncated(y, LOW_DEGREE) for y in start], truncated(h, LOW_DEGREE)
    box = confine(field.hull, list(map(hull, start)), hull(h))
    with ctx.workprec(LOW_PRECISION):
        at_start = taylor_coefficients(field.low, low, LOW_ORDER + 1)
        beyond = taylor_coefficients(field.hull, box, ORDER + 1)
        end = [evaluate([*c[:LOW_ORDER], b[LOW_ORDER]], h) for c, b in zip(at_start, beyond, strict=True)]
    if not all(hull(y).is_finite() for y in end):
        raise NotProved(f"{field.mode}: the series of the motion are not finite")
    return Expansion(field.low, at_start, beyond, h, end)


def confine(field: Field, start: Sequence[arb], h: arb) -> list[arb]:
    """A box B in which all motions from the box ``start`` stay for a time ``h``.

    Raises
    ------
    NotProved
        If F(B) lies in V for none of the V that are tried.
    """
    elapsed = arb(0).union(h)
    speeds = _rates(field, start)
    for _ in range(PICARD_ROUNDS):
        speeds = [v + arb(0, float(v.rad()) * WIDENING + LEAST_WIDENING) for v in speeds]
        rates = _rates(field, [y + elapsed * v for y, v in zip(start, speeds, strict=True)])
        if not all(rate.is_finite() for rate in rates):
            break
        if all(v.contains(rate) for v, rate in zip(speeds, rates, strict=True)):
            return [y + elapsed * rate for y, rate in zip(start, rates, strict=True)]
        speeds = [v.union(rate) for v, rate in zip(speeds, rates, strict=True)]
    raise NotProved(f"{field.mode}: no box is shown to hold the motion for {h.str(5, radius=False)} s")


def follow(field: Field, expansion: Expansion, centre: Sequence[Any], h: Any, variation: Any) -> list[Any]:
    """End after ``h`` of the motion from one point of the box of an expansion, known up to the tiny balls ``centre``.

    A mean value form: the midpoint in high order, and the variation times what is left.
    """
    middle = [y.mid() for y in centre]
    at_start = taylor_coefficients(field, middle, ORDER)
    rest = variation * matrix(len(middle), 1, [y - m for y, m in zip(centre, middle, strict=True)])
    terms = zip(at_start, expansion.beyond, scattered(rest, arb_mat.entries), strict=True)
    return [evaluate([*c, b[ORDER]], h) + r for c, b, r in terms]


def taylor_coefficients(field: Field, start: Sequence[Any], count: int) -> list[list[Any]]:
    """F_0, ..., F_(count - 1) of each state, one after the other from y' = F(y)."""
    coefficients = [[y] for y in start]
    for k in range(count - 1):
        ctx.cap = k + 1
        (rates,) = field.rate([series(c, k + 1) for c in coefficients])
        for c, rate in zip(coefficients, rates, strict=True):
            c.append(_padded(rate, k + 1)[k] / (k + 1))
    return coefficients


def evaluate(coefficients: Sequence[Any], t: Any) -> Any:
    """A polynomial by Horner's rule."""
    total = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        total = total * t + c
    return total


def _rates(field: Field, y: Sequence[arb]) -> list[arb]:
    return [hull(rate) for rate in field.rate(y)[0]]


def _matrices(field: Field, motion: list[list[Any]]) -> list[Any]:
    """Series of the Jacobian DF along a motion."""
    n, entries = field.n, _compose(field.jacobian, motion)
    return [matrix(n, n, [entries[i + n * j][k] for i in range(n) for j in range(n)]) for k in range(LOW_ORDER + 1)]


def _variations(slopes: list[Any], order: int) -> list[Any]:
    """Taylor coefficients 0 to ``order`` of Phi' = A Phi, Phi(0) = 1, from those of A."""
    n = hull(slopes[0]).nrows()
    phi = [arb_mat(n, n, [int(i == j) for i in range(n) for j in range(n)])]
    for k in range(order):
        total = slopes[0] * phi[k]
        for j in range(1, k + 1):
            total += slopes[j] * phi[k - j]
        phi.append(total * (arb(1) / (k + 1)))
    return phi


def _compose(graph: Graph, motion: list[list[Any]]) -> list[list[Any]]:
    """Series of the outputs of a graph along a motion, LOW_ORDER + 1 coefficients each."""
    count = LOW_ORDER + 1
    ctx.cap = count
    outputs = graph([series(c[:count], count) for c in motion])
    return [_padded(value, count) for output in outputs for value in output]


def _padded(value: Any, length: int) -> list[Any]:
    return scattered(value, lambda part: _coefficients(part, length))


def _coefficients(value: Any, length: int) -> list[arb]:
    if not isinstance(value, arb_series):
        return [arb(value), *[arb(0)] * (length - 1)]
    coefficients = value.coeffs()[:length]
    return [*coefficients, *[arb(0)] * (length - len(coefficients))]
