"""CasADi's SX functions in ball arithmetic: the same graph, instruction by instruction.

The values may be real balls or truncated power series of real balls (``arb``, ``arb_series`` of python-flint); every
result encloses the exact one, and is not finite where the function may not be defined.

Numbers that depend on a parameter, as a value and a slope in balls.

    a(s) in a.value + a.slope s      for every s in [-1, 1]

Both may be balls, power series of time or matrices. A number that does not depend on the parameter is no ``Tilted``
but the ball itself. Every operation is exact up to the variation of slopes, as in the mean value theorem

    f(a(s)) in f(a.value) + f'(a([-1, 1])) a.slope s

Balls: their precision, as decimal strings rounded outward, which enclose what is proved, and in pickles.
"""

import copyreg
import operator
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from math import pi
from typing import Any

import casadi as ca
from casadi import Function
from flint import acb, arb, ctx, fmpq

LARGEST_DENOMINATOR = 360
"""A constant next to n pi / d with d up to this, and n up to its double, stands for that multiple of pi."""


def _sinh(a: Any) -> Any:
    return (a.exp() - (-a).exp()) / 2


def _cosh(a: Any) -> Any:
    return (a.exp() + (-a).exp()) / 2


def _power(a: Any, b: Any) -> Any:
    if isinstance(b, arb) and b.is_exact() and b.is_integer():
        n = round(float(b))
        return a**n if n >= 0 else 1 / a**-n
    return (b * a.log()).exp()


UNARY: Mapping[int, Callable[[Any], Any]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_NEG: operator.neg,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: a + a,
    ca.OP_INV: lambda a: 1 / a,
    ca.OP_SQRT: lambda a: a.sqrt(),
    ca.OP_EXP: lambda a: a.exp(),
    ca.OP_EXPM1: lambda a: a.exp() - 1,
    ca.OP_LOG: lambda a: a.log(),
    ca.OP_LOG1P: lambda a: (1 + a).log(),
    ca.OP_SIN: lambda a: a.sin(),
    ca.OP_COS: lambda a: a.cos(),
    ca.OP_TAN: lambda a: a.sin() / a.cos(),
    ca.OP_ASIN: lambda a: a.asin(),
    ca.OP_ACOS: lambda a: a.acos(),
    ca.OP_ATAN: lambda a: a.atan(),
    ca.OP_SINH: _sinh,
    ca.OP_COSH: _cosh,
    ca.OP_TANH: lambda a: _sinh(a) / _cosh(a),
    ca.OP_ASINH: lambda a: (a + (a * a + 1).sqrt()).log(),
    ca.OP_ACOSH: lambda a: (a + (a * a - 1).sqrt()).log(),
    ca.OP_ATANH: lambda a: ((1 + a).log() - (1 - a).log()) / 2,
}
"""Instructions of one operand; those with a kink (fabs, sign, floor) are not analytic and are refused."""
BINARY: Mapping[int, Callable[[Any, Any], Any]] = {
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_DIV: operator.truediv,
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_HYPOT: lambda a, b: (a * a + b * b).sqrt(),
    ca.OP_ATAN2: lambda a, b: 2 * (a / (b + (a * a + b * b).sqrt())).atan(),
}


class NotProved(Exception):
    """A claim that could not be verified: what, where and by how much."""


class Refuted(NotProved):
    """A claim of which the contrary is verified.

    Attributes
    ----------
    margin : the name of the margin that is proved to be negative; empty where it is no single one.
    """

    def __init__(self, words: str, margin: str = "") -> None:
        super().__init__(words)
        self.margin = margin


class Graph:
    """An SX function of one variable input (the first) and constant ones, for evaluation in balls.

    Parameters
    ----------
    function : dense inputs; the first is the variable.
    constants : values of the other inputs. What depends on them alone is computed once.

    Raises
    ------
    ValueError
        If an instruction is not analytic; the message names the function.
    """

    def __init__(self, function: Function, constants: Sequence[Sequence[arb]]) -> None:
        self._name = function.name()
        self._sizes = [function.numel_out(k) for k in range(function.n_out())]
        self._values: list[Any] = []
        self._steps: list[tuple[int, Callable[..., Any], int, int | None]] = []
        self._inputs: list[tuple[int, int]] = []
        self._outputs: list[tuple[int, int, int]] = []
        place: dict[int, int] = {}
        variable: set[int] = set()
        for k in range(function.n_instructions()):
            operation, operands = function.instruction_id(k), function.instruction_input(k)
            results = function.instruction_output(k)
            if operation == ca.OP_OUTPUT:
                output, nonzero = results
                sparsity = function.sparsity_out(output)
                entry = sparsity.row()[nonzero] + sparsity.get_col()[nonzero] * sparsity.size1()  # column by column
                self._outputs.append((output, int(entry), place[operands[0]]))
                continue
            place_of_result = len(self._values)
            self._values.append(None)
            if operation == ca.OP_CONST:
                self._values[-1] = exact_constant(function.instruction_constant(k))
            elif operation == ca.OP_INPUT:
                source, entry = operands
                if source == 0:
                    self._inputs.append((place_of_result, entry))
                    variable.add(place_of_result)
                else:
                    self._values[-1] = constants[source - 1][entry]
            else:
                places = tuple(place[operand] for operand in operands)
                apply = _operation(function, operation, len(places))
                if variable.isdisjoint(places):
                    self._values[-1] = apply(*(self._values[i] for i in places))
                else:
                    variable.add(place_of_result)
                    self._steps.append((place_of_result, apply, places[0], places[1] if len(places) > 1 else None))
            place[results[0]] = place_of_result

    def __call__(self, variable: Sequence[Any]) -> list[list[Any]]:
        """All outputs, each a list of its entries, columns one after the other.

        Raises
        ------
        NotProved
            If a quotient by what may be zero occurs.
        """
        values = self._values
        for place, entry in self._inputs:
            values[place] = variable[entry]
        try:
            for place, apply, a, b in self._steps:
                values[place] = apply(values[a]) if b is None else apply(values[a], values[b])
        except (ZeroDivisionError, ValueError) as failure:  # of a number, of a series
            raise NotProved(f"{self._name}: a quotient by what may be zero") from failure
        except AttributeError as failure:  # of a polynomial in a parameter
            raise NotProved(f"{self._name}: {failure.name} cannot be enclosed along a family") from failure
        outputs: list[list[Any]] = [[arb(0)] * size for size in self._sizes]
        for output, entry, place in self._outputs:
            outputs[output][entry] = values[place]
        return outputs


def exact_constant(value: float) -> arb:
    """What a constant of a graph stands for: a multiple of pi if it is the double of one, otherwise itself."""
    ratio = pi_multiple(value)
    return arb(value) if ratio is None else arb.pi() * fmpq(ratio.numerator, ratio.denominator)


def pi_multiple(value: float) -> Fraction | None:
    """The n / d of a double that is n pi / d in double arithmetic, if there is one."""
    if value == 0 or value == int(value):
        return None
    ratio = Fraction(value / pi).limit_denominator(LARGEST_DENOMINATOR)
    near = abs(float(ratio) * pi - value) <= 2**-52 * abs(value)
    return ratio if near and 0 < abs(ratio.numerator) <= 2 * LARGEST_DENOMINATOR else None


def _operation(function: Function, operation: int, operands: int) -> Callable[..., Any]:
    table: Mapping[int, Callable[..., Any]] = UNARY if operands == 1 else BINARY
    if operation not in table:
        raise ValueError(f"{function.name()}: CasADi's operation {operation} is not analytic; state it without kinks")
    return table[operation]


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


EXTRA_DIGITS = 2
"""Digits printed beyond the first one in which the bounds differ."""
MOST_DIGITS = 30
BITS = 128
"""Of the bounds, before they become decimals."""
RADIUS_BITS = 64
"""More than the 30 bits of a radius."""
_COMPUTING = threading.RLock()
"""Held while balls are computed: FLINT's precision and length of series hold for the whole process."""


@contextmanager
def precision(bits: int) -> Iterator[None]:
    """Compute with balls of this precision within the block; other threads that do so wait for its end."""
    with _COMPUTING, ctx.workprec(bits):
        length = ctx.cap
        try:
            yield
        finally:
            ctx.cap = length


def interval(ball: arb) -> list[str]:
    """[lo, hi] as decimals."""
    with precision(BITS):
        lower, upper = _fraction(ball.lower()), _fraction(ball.upper())
    places = _places(upper - lower)
    scale = 10**places
    return [_decimal((lower * scale).__floor__(), places), _decimal((upper * scale).__ceil__(), places)]


def complex_interval(ball: acb) -> dict[str, list[str]]:
    """Real and imaginary part as intervals."""
    return {"re": interval(ball.real), "im": interval(ball.imag)}


def _fraction(exact: arb) -> Fraction:
    mantissa, exponent = exact.man_exp()
    return Fraction(int(mantissa)) * Fraction(2) ** int(exponent)


def _places(width: Fraction) -> int:
    """Decimal places that resolve a width."""
    places = 0
    while width and places < MOST_DIGITS and width * 10**places < 1:
        places += 1
    return MOST_DIGITS if width == 0 else min(places + EXTRA_DIGITS, MOST_DIGITS)


def _decimal(units: int, places: int) -> str:
    """units / 10^places."""
    sign, digits = "-" if units < 0 else "", str(abs(units)).rjust(places + 1, "0")
    return f"{sign}{digits[:-places]}.{digits[-places:]}" if places else f"{sign}{digits}"


def _pickled(ball: arb) -> tuple[Any, ...]:
    """What a pickle holds of a ball: mantissa and exponent of its middle and its radius."""
    if not ball.is_finite():
        return arb, (str(ball),)
    return _ball, tuple((int(m), int(e)) for m, e in (ball.mid().man_exp(), ball.rad().man_exp()))


def _ball(middle: tuple[int, int], radius: tuple[int, int]) -> arb:
    """The same ball: FLINT rounds a radius up to the next one that it can hold, even if it can hold this one."""
    mantissa, exponent = radius
    if mantissa == 0:
        return arb(middle)
    ball = arb(middle, arb((mantissa * 2**RADIUS_BITS - 1, exponent - RADIUS_BITS)))
    return ball if ball.rad() >= arb(radius) else arb(middle, arb(radius))


copyreg.pickle(arb, _pickled)
copyreg.pickle(acb, lambda ball: (acb, (ball.real, ball.imag)))
