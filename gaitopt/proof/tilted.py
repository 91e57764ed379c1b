"""Numbers that depend on a parameter, as a value and a slope in balls.

    a(s) in a.value + a.slope s      for every s in [-1, 1]

Both may be balls, power series of time or matrices. A number that does not depend on the parameter is no ``Tilted``
but the ball itself. Every operation is exact up to the variation of slopes, as in the mean value theorem

    f(a(s)) in f(a.value) + f'(a([-1, 1])) a.slope s
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from flint import arb

UNIT = arb(0, 1)


@dataclass(frozen=True, slots=True)
class Tilted:
    """A number, a series or a matrix for every s; see the module."""

    value: Any
    slope: Any

    def at(self, s: arb) -> Any:
        """An enclosure for some s."""
        return self.value + self.slope * s

    def __neg__(self) -> "Tilted":
        return Tilted(-self.value, -self.slope)

    def __add__(self, other: Any) -> "Tilted":
        if isinstance(other, Tilted):
            return Tilted(self.value + other.value, self.slope + other.slope)
        return Tilted(self.value + other, self.slope)

    __radd__ = __add__

    def __sub__(self, other: Any) -> "Tilted":
        return self + -other

    def __rsub__(self, other: Any) -> "Tilted":
        return -self + other

    def __mul__(self, other: Any) -> "Tilted":
        if isinstance(other, Tilted):
            return Tilted(self.value * other.value, self.value * other.slope + self.slope * hull(other))
        return Tilted(self.value * other, self.slope * other)

    def __rmul__(self, other: Any) -> "Tilted":
        return Tilted(other * self.value, other * self.slope)

    def __truediv__(self, other: Any) -> "Tilted":
        return self * (other.inv() if isinstance(other, Tilted) else 1 / other)

    def __rtruediv__(self, other: Any) -> "Tilted":
        return other * self.inv()

    def __pow__(self, n: int) -> Any:
        total: Any = arb(1)
        for _ in range(n):
            total = self * total
        return total

    def inv(self) -> "Tilted":
        """1 / a."""
        inverse: Callable[[Any], Any] = (lambda a: a.inv()) if hasattr(self.value, "nrows") else (lambda a: 1 / a)
        value = inverse(self.value)
        return Tilted(value, -value * self.slope * inverse(hull(self)))

    def sqrt(self) -> "Tilted":
        """Square root of it."""
        return Tilted(self.value.sqrt(), self.slope / (2 * hull(self).sqrt()))

    def exp(self) -> "Tilted":
        """Exponential of it."""
        return Tilted(self.value.exp(), hull(self).exp() * self.slope)

    def log(self) -> "Tilted":
        """Logarithm of it."""
        return Tilted(self.value.log(), self.slope / hull(self))

    def sin(self) -> "Tilted":
        """Sine of it."""
        return Tilted(self.value.sin(), hull(self).cos() * self.slope)

    def cos(self) -> "Tilted":
        """Cosine of it."""
        return Tilted(self.value.cos(), -hull(self).sin() * self.slope)

    def atan(self) -> "Tilted":
        """Arc tangent of it."""
        return Tilted(self.value.atan(), self.slope / (1 + hull(self) * hull(self)))


def at(a: Any, s: arb) -> Any:
    """An enclosure for some values of the parameter."""
    return a.at(s) if isinstance(a, Tilted) else a


def hull(a: Any) -> Any:
    """One enclosure for all values of the parameter."""
    return at(a, UNIT)


def gathered(entries: Sequence[Any], build: Callable[[list[Any]], Any]) -> Any:
    """What ``build`` makes of entries, a series or a matrix, which is tilted where an entry is."""
    if not any(isinstance(entry, Tilted) for entry in entries):
        return build(list(entries))
    values = [entry.value if isinstance(entry, Tilted) else entry for entry in entries]
    return Tilted(build(values), build([entry.slope if isinstance(entry, Tilted) else 0 for entry in entries]))


def scattered(a: Any, entries: Callable[[Any], Sequence[Any]]) -> list[Any]:
    """The entries of a series or a matrix."""
    if not isinstance(a, Tilted):
        return list(entries(a))
    return [Tilted(value, slope) for value, slope in zip(entries(a.value), entries(a.slope), strict=True)]
