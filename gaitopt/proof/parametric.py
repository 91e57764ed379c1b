"""Numbers that depend on a parameter, as polynomials of it with balls for coefficients.

    a(s) in a_0 + a_1 s + ... + a_K s^K,      s in [-1, 1]

For each s the coefficients are some numbers in their balls: what lies beyond s^K is bounded and added to a_K, so that
no remainder is lost. Coefficients may be balls, power series of time, or matrices. A number that does not depend on the
parameter is no ``Parametric`` but the ball itself.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from flint import arb, arb_mat, arb_series

UNIT = arb(0.5, 0.5)


@dataclass(frozen=True, slots=True)
class Parametric:
    """A number, a series or a matrix for every s; see the module."""

    coefficients: Sequence[Any]

    @property
    def hull(self) -> Any:
        """One enclosure for all s."""
        return self.at(arb(0, 1))

    def at(self, s: arb) -> Any:
        """An enclosure for some s."""
        total = self.coefficients[-1]
        for c in reversed(self.coefficients[:-1]):
            total = total * s + c
        return total

    def truncated(self, degree: int) -> "Parametric":
        """The same as a polynomial of lower degree."""
        *low, last = self.coefficients[degree:]
        for c in reversed(low):
            last = last * arb(0, 1) + c
        return Parametric([*self.coefficients[:degree], last])

    def mid(self) -> "Parametric":
        """The polynomial in the middle."""
        return Parametric([c.mid() for c in self.coefficients])

    def __neg__(self) -> "Parametric":
        return Parametric([-c for c in self.coefficients])

    def __add__(self, other: Any) -> "Parametric":
        if isinstance(other, Parametric):
            longer, shorter = self.coefficients, other.coefficients
            if len(longer) < len(shorter):
                longer, shorter = shorter, longer
            return Parametric([*(a + b for a, b in zip(longer, shorter, strict=False)), *longer[len(shorter) :]])
        first, *rest = self.coefficients
        return Parametric([first + other, *rest])

    __radd__ = __add__

    def __sub__(self, other: Any) -> "Parametric":
        return self + -other

    def __rsub__(self, other: Any) -> "Parametric":
        return -self + other

    def __mul__(self, other: Any) -> "Parametric":
        if isinstance(other, Parametric):
            return _product(self.coefficients, other.coefficients)
        return Parametric([c * other for c in self.coefficients])

    def __rmul__(self, other: Any) -> "Parametric":
        return Parametric([other * c for c in self.coefficients])

    def __truediv__(self, other: Any) -> "Parametric":
        if not isinstance(other, Parametric):
            return Parametric([c / other for c in self.coefficients])
        return self * other.reciprocal()

    def __rtruediv__(self, other: Any) -> "Parametric":
        return self.reciprocal() * other

    def __pow__(self, n: int) -> Any:
        total: Any = arb(1)
        for _ in range(n):
            total = self * total
        return total

    def reciprocal(self) -> "Parametric":
        """1 / a."""
        return self._composed(lambda x, count: _powers(1 / x, -1 / x, count))

    def sqrt(self) -> "Parametric":
        """Square root of it."""

        def terms(x: Any, count: int) -> list[Any]:
            values = [x.sqrt()]
            for k in range(count - 1):
                values.append(values[-1] * (arb(1) / 2 - k) / (k + 1) / x)
            return values

        return self._composed(terms)

    def exp(self) -> "Parametric":
        """Exponential of it."""
        return self._composed(lambda x, count: _over_factorials([x.exp()], count))

    def log(self) -> "Parametric":
        """Logarithm of it."""

        def terms(x: Any, count: int) -> list[Any]:
            return [x.log(), *(value / (k + 1) for k, value in enumerate(_powers(1 / x, -1 / x, count - 1)))]

        return self._composed(terms)

    def sin(self) -> "Parametric":
        """Sine of it."""
        return self._composed(lambda x, count: _over_factorials([s := x.sin(), c := x.cos(), -s, -c], count))

    def cos(self) -> "Parametric":
        """Cosine of it."""
        return self._composed(lambda x, count: _over_factorials([c := x.cos(), s := -x.sin(), -c, -s], count))

    def _composed(self, terms: Callable[[Any, int], list[Any]]) -> "Parametric":
        """f(a) by Taylor's formula about a_0, from x -> f, f', f'' / 2, ...; its remainder between a_0 and a."""
        first, *rest = self.coefficients
        change = Parametric([first * 0, *rest])
        total = terms(first + UNIT * change.hull, len(self.coefficients))[-1]
        for term in reversed(terms(first, len(rest))):
            total = change * total + term
        return total


def _product(a: Sequence[Any], b: Sequence[Any]) -> Parametric:
    degree = max(len(a), len(b)) - 1
    terms: list[Any] = [None] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            xy = x * y
            terms[i + j] = xy if terms[i + j] is None else terms[i + j] + xy
    return Parametric(terms).truncated(degree)


def _powers(first: Any, ratio: Any, count: int) -> list[Any]:
    values = [first]
    for _ in range(count - 1):
        values.append(values[-1] * ratio)
    return values


def _over_factorials(derivatives: list[Any], count: int) -> list[Any]:
    """f^(k) / k! of a function whose derivatives repeat."""
    values, factorial = [], arb(1)
    for k in range(count):
        values.append(derivatives[k % len(derivatives)] / factorial)
        factorial *= k + 1
    return values


def hull(value: Any) -> Any:
    """One enclosure for all values of the parameter."""
    return value.hull if isinstance(value, Parametric) else value


def at(value: Any, s: arb) -> Any:
    """An enclosure for some values of the parameter."""
    return value.at(s) if isinstance(value, Parametric) else value


def truncated(value: Any, degree: int) -> Any:
    """The same as a polynomial of lower degree, or one enclosure for degree 0."""
    if not isinstance(value, Parametric):
        return value
    return value.truncated(degree) if 0 < degree < len(value.coefficients) else value if degree else value.hull


def series(coefficients: Sequence[Any], length: int) -> Any:
    """A power series of time from its coefficients."""
    return gathered(coefficients, lambda values: arb_series(values, length))


def matrix(rows: int, columns: int, entries: Sequence[Any]) -> Any:
    """A matrix from its entries, row by row."""
    return gathered(entries, lambda values: arb_mat(rows, columns, values))


def gathered(entries: Sequence[Any], build: Callable[[list[arb]], Any]) -> Any:
    """What ``build`` makes of entries, for each power of the parameter if an entry depends on it."""
    degrees = [len(entry.coefficients) for entry in entries if isinstance(entry, Parametric)]
    if not degrees:
        return build([arb(entry) for entry in entries])
    powers = [entry.coefficients if isinstance(entry, Parametric) else [entry] for entry in entries]
    return Parametric([build(list(values)) for values in list(zip_longest(*powers, fillvalue=arb(0)))])


def scattered(value: Any, entries: Callable[[Any], Sequence[arb]]) -> list[Any]:
    """The entries of a matrix or a series, each with all its powers of the parameter."""
    if not isinstance(value, Parametric):
        return list(entries(value))
    return [Parametric(powers) for powers in zip(*(entries(c) for c in value.coefficients), strict=True)]
