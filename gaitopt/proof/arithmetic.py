"""Rigorous arithmetic: real balls, numbers that depend on a parameter, and CasADi's expressions in both.

A ball is a midpoint and a radius (``arb`` of python-flint); every operation returns a ball that contains all exact
results. A ``Tilted`` number is a value and a slope, a box that is tilted along a parameter:

    a(s) in a.value + a.slope s      for every s in [-1, 1]

Value and slope may be balls, power series in time (``arb_series``) or matrices (``arb_mat``). A number that does not
depend on the parameter is the ball itself. The operations use the mean value theorem

    f(a(s)) in f(a.value) + f'(a([-1, 1])) a.slope s

``BallFunction`` evaluates a CasADi SX function instruction by instruction in any of these numbers. The walker's
equations are therefore written once, for the simulation and for the proof.

References
----------
F. Johansson (2017), Arb: efficient arbitrary-precision midpoint-radius interval arithmetic, IEEE Trans. Comput. 66.
"""

import copyreg
import operator
import re
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from math import pi
from typing import Any

import casadi as ca
from casadi import Function
from flint import acb, arb, arb_mat, ctx, fmpq

from gaitopt.model.units import DECIMAL

Number = Any
"""A ball (``arb``), a power series in time (``arb_series``), or a ``Tilted`` one of these."""
Matrix = Any
"""A matrix of balls (``arb_mat``), or a ``Tilted`` one."""

PRECISION = 128
"""Bits of every midpoint."""
RADIUS_BITS = 64
"""Bits of a pickled radius; Arb keeps 30."""
LARGEST_DENOMINATOR = 360
"""A constant is read as n pi / d if it is the double of that number, d is at most this and n at most twice this."""
EXTRA_DIGITS, MOST_DIGITS = 2, 30
"""Decimal bounds end this many places after the first one in which they differ, and have at most this many places."""
INTERVAL = ".."
"""Separates the ends of an interval of a parameter, as in ``0.95..1``."""
UNIT = arb(0, 1)
"""The interval [-1, 1]."""

_FLINT_IN_USE = threading.RLock()
"""FLINT's precision and length of series are global to the process: one thread computes at a time."""


def _sinh(a: Number) -> Number:
    return (a.exp() - (-a).exp()) / 2


def _cosh(a: Number) -> Number:
    return (a.exp() + (-a).exp()) / 2


def _power(a: Number, b: Number) -> Number:
    if isinstance(b, arb) and b.is_exact() and b.is_integer():
        n = round(float(b))
        return a**n if n >= 0 else 1 / a**-n
    return (b * a.log()).exp()


def _maximum(a: Number, b: Number) -> Number:
    if isinstance(a, arb) and isinstance(b, arb):
        return a.max(b)
    difference = hull(a) - hull(b)
    first = difference.coeffs()[0] if hasattr(difference, "coeffs") else difference
    if first > 0 or first < 0:
        return a if first > 0 else b
    raise NotProved("a maximum may change from one of its arguments to the other")


UNARY: Mapping[int, Callable[[Number], Number]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_FABS: lambda a: _maximum(a, -a),
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
"""CasADi's instructions of one operand. Those with a jump (sign, floor) are missing: they are not analytic. A maximum
or an absolute value is analytic where it is known which of its arguments is the larger one."""
BINARY: Mapping[int, Callable[[Number, Number], Number]] = {
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_DIV: operator.truediv,
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_HYPOT: lambda a, b: (a * a + b * b).sqrt(),
    ca.OP_FMAX: _maximum,
    ca.OP_ATAN2: lambda a, b: 2 * (a / (b + (a * a + b * b).sqrt())).atan(),
}


class NotProved(Exception):
    """A claim that could not be proved; the message says where it fails and by how much."""


class Refuted(NotProved):
    """A claim whose contrary is proved.

    Attributes
    ----------
    margin : name of the margin that is proved to be negative; empty if it is not a single margin.
    """

    def __init__(self, message: str, margin: str = "") -> None:
        super().__init__(message)
        self.margin = margin


@contextmanager
def precision(bits: int = PRECISION) -> Iterator[None]:
    """Compute with balls of this precision within the block; other threads wait until the block ends."""
    with _FLINT_IN_USE, ctx.workprec(bits):
        length = ctx.cap
        try:
            yield
        finally:
            ctx.cap = length


def ball(text: str) -> arb:
    """The ball of an exact value (``0.14``, ``13 deg``), or of an interval ``lo..hi`` of such values.

    Raises
    ------
    ValueError
        If a value is not a decimal number, or one with ``deg`` or ``rad``, or if the ends have different units.
    """
    lower, between, upper = text.partition(INTERVAL)
    if between:
        ends = lower.strip(), upper.strip()
        if ends[0].partition(" ")[2] != ends[1].partition(" ")[2]:
            raise ValueError(f"{text!r}: state both ends in the same unit")
        return ball(ends[0]).union(ball(ends[1]))
    number, _, unit = text.partition(" ")
    if unit not in ("", "rad", "deg") or re.fullmatch(DECIMAL, number) is None:
        raise ValueError(f"{text!r} is not an exact value; write a decimal number, or one with deg or rad")
    value = arb(number)
    return value * arb.pi() / 180 if unit == "deg" else value


@dataclass(frozen=True, slots=True)
class Tilted:
    """A number, series or matrix a(s) in value + slope s, for every s in [-1, 1]."""

    value: Any
    slope: Any

    def at(self, s: arb) -> Any:
        """An enclosure for all values in the ball ``s``."""
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
        """Square root."""
        return Tilted(self.value.sqrt(), self.slope / (2 * hull(self).sqrt()))

    def exp(self) -> "Tilted":
        """Exponential function."""
        return Tilted(self.value.exp(), hull(self).exp() * self.slope)

    def log(self) -> "Tilted":
        """Natural logarithm."""
        return Tilted(self.value.log(), self.slope / hull(self))

    def sin(self) -> "Tilted":
        """Sine."""
        return Tilted(self.value.sin(), hull(self).cos() * self.slope)

    def cos(self) -> "Tilted":
        """Cosine."""
        return Tilted(self.value.cos(), -hull(self).sin() * self.slope)

    def atan(self) -> "Tilted":
        """Arc tangent."""
        return Tilted(self.value.atan(), self.slope / (1 + hull(self) * hull(self)))


def at(a: Any, s: arb) -> Any:
    """An enclosure for all values in the ball ``s``; ``a`` itself if it does not depend on the parameter."""
    return a.at(s) if isinstance(a, Tilted) else a


def hull(a: Any) -> Any:
    """An enclosure for every s in [-1, 1]."""
    return at(a, UNIT)


def assemble(entries: Sequence[Number], build: Callable[[list[Number]], Any]) -> Any:
    """A series or matrix that ``build`` makes from its entries; tilted if one of the entries is."""
    if not any(isinstance(entry, Tilted) for entry in entries):
        return build(list(entries))
    values = [entry.value if isinstance(entry, Tilted) else entry for entry in entries]
    return Tilted(build(values), build([entry.slope if isinstance(entry, Tilted) else 0 for entry in entries]))


def entries_of(a: Any, entries: Callable[[Any], Sequence[Number]]) -> list[Number]:
    """The entries of a series or matrix, the inverse of ``assemble``; ``entries`` lists those of an untilted one."""
    if not isinstance(a, Tilted):
        return list(entries(a))
    return [Tilted(value, slope) for value, slope in zip(entries(a.value), entries(a.slope), strict=True)]


def matrix(columns: int, entries: Sequence[Number]) -> Matrix:
    """A matrix from its entries, row by row."""
    return assemble(entries, lambda values: arb_mat(len(entries) // columns, columns, values))


def matrix_from_columns(rows: int, entries: Sequence[Number]) -> Matrix:
    """A matrix from its entries, column by column, as ``BallFunction`` returns them."""
    columns = len(entries) // rows
    return matrix(columns, [entries[i + rows * j] for i in range(rows) for j in range(columns)])


def matrix_entries(a: Matrix) -> list[Number]:
    """The entries of a matrix, row by row."""
    return entries_of(a, arb_mat.entries)


class BallFunction:
    """A CasADi SX function, evaluated in balls; the first input is variable, the others are constant.

    Parameters
    ----------
    function : a function with dense inputs.
    constants : values of all inputs but the first. Subexpressions of constants are evaluated once, here.
    number : the value of a constant in the function.

    Raises
    ------
    ValueError
        If an instruction of the function is not analytic; the message names the function.
    """

    def __init__(
        self,
        function: Function,
        constants: Sequence[Sequence[arb]],
        number: Callable[[float], Number] | None = None,
    ) -> None:
        number = exact_constant if number is None else number
        self._name = function.name()
        self._sizes = [function.numel_out(k) for k in range(function.n_out())]
        self._values: list[Number] = []
        self._steps: list[tuple[int, Callable[..., Number], int, int | None]] = []
        self._inputs: list[tuple[int, int]] = []
        self._outputs: list[tuple[int, int, int]] = []
        slot: dict[int, int] = {}  # work vector of CasADi -> index in _values
        variable: set[int] = set()
        for k in range(function.n_instructions()):
            operation, operands = function.instruction_id(k), function.instruction_input(k)
            results = function.instruction_output(k)
            if operation == ca.OP_OUTPUT:
                output, nonzero = results
                sparsity = function.sparsity_out(output)
                entry = sparsity.row()[nonzero] + sparsity.get_col()[nonzero] * sparsity.size1()  # column by column
                self._outputs.append((output, int(entry), slot[operands[0]]))
                continue
            result = len(self._values)
            self._values.append(None)
            if operation == ca.OP_CONST:
                self._values[-1] = number(function.instruction_constant(k))
            elif operation == ca.OP_INPUT:
                source, entry = operands
                if source == 0:
                    self._inputs.append((result, entry))
                    variable.add(result)
                else:
                    self._values[-1] = constants[source - 1][entry]
            else:
                slots = tuple(slot[operand] for operand in operands)
                table: Mapping[int, Callable[..., Number]] = UNARY if len(slots) == 1 else BINARY
                if operation not in table:
                    kink = f"CasADi's operation {operation} is not analytic; write the expression without kinks"
                    raise ValueError(f"{self._name}: {kink}")
                apply = table[operation]
                if variable.isdisjoint(slots):
                    self._values[-1] = apply(*(self._values[i] for i in slots))
                else:
                    variable.add(result)
                    self._steps.append((result, apply, slots[0], slots[1] if len(slots) > 1 else None))
            slot[results[0]] = result

    def __call__(self, variable: Sequence[Number]) -> list[list[Number]]:
        """All outputs; each is a list of its entries, column by column.

        Parameters
        ----------
        variable : entries of the first input: balls, power series in time, or tilted ones.

        Raises
        ------
        NotProved
            If a divisor may be zero.
        """
        values = self._values
        for slot, entry in self._inputs:
            values[slot] = variable[entry]
        try:
            for slot, apply, a, b in self._steps:
                values[slot] = apply(values[a]) if b is None else apply(values[a], values[b])
        except (ZeroDivisionError, ValueError) as failure:  # division of balls, of series
            raise NotProved(f"{self._name}: a divisor may be zero") from failure
        except AttributeError as failure:  # a function that Tilted lacks
            raise NotProved(f"{self._name}: {failure.name} cannot be enclosed along a family") from failure
        outputs: list[list[Number]] = [[arb(0)] * size for size in self._sizes]
        for output, entry, slot in self._outputs:
            outputs[output][entry] = values[slot]
        return outputs


def exact_constant(value: float) -> arb:
    """The exact value of a constant in an expression: n pi / d if the constant is its double, else the double."""
    ratio = ratio_to_pi(value)
    return arb(value) if ratio is None else arb.pi() * fmpq(ratio.numerator, ratio.denominator)


def ratio_to_pi(value: float) -> Fraction | None:
    """n / d if a constant is the double of n pi / d, otherwise None."""
    if value == 0 or value == int(value):
        return None
    ratio = Fraction(value / pi).limit_denominator(LARGEST_DENOMINATOR)
    near = abs(float(ratio) * pi - value) <= 2**-52 * abs(value)
    return ratio if near and 0 < abs(ratio.numerator) <= 2 * LARGEST_DENOMINATOR else None


def decimal_bounds(ball: arb) -> list[str]:
    """[lo, hi] as decimal strings, rounded outward."""
    with precision():
        lower, upper = _fraction(ball.lower()), _fraction(ball.upper())
    width, places = upper - lower, 0
    while width and places < MOST_DIGITS and width * 10**places < 1:
        places += 1
    places = MOST_DIGITS if width == 0 else min(places + EXTRA_DIGITS, MOST_DIGITS)
    scale = 10**places
    return [_decimal((lower * scale).__floor__(), places), _decimal((upper * scale).__ceil__(), places)]


def _fraction(exact: arb) -> Fraction:
    mantissa, exponent = exact.man_exp()
    return Fraction(int(mantissa)) * Fraction(2) ** int(exponent)


def _decimal(units: int, places: int) -> str:
    """units / 10^places as a decimal string."""
    sign, digits = "-" if units < 0 else "", str(abs(units)).rjust(places + 1, "0")
    return f"{sign}{digits[:-places]}.{digits[-places:]}" if places else f"{sign}{digits}"


def _reduce(ball: arb) -> tuple[Any, ...]:
    """How a ball is pickled: by mantissa and exponent of its midpoint and of its radius."""
    if not ball.is_finite():
        return arb, (str(ball),)
    return _rebuild, tuple((int(m), int(e)) for m, e in (ball.mid().man_exp(), ball.rad().man_exp()))


def _rebuild(middle: tuple[int, int], radius: tuple[int, int]) -> arb:
    """The pickled ball. FLINT rounds every given radius up, even one that it can hold, so it gets a smaller one."""
    mantissa, exponent = radius
    if mantissa == 0:
        return arb(middle)
    ball = arb(middle, arb((mantissa * 2**RADIUS_BITS - 1, exponent - RADIUS_BITS)))
    return ball if ball.rad() >= arb(radius) else arb(middle, arb(radius))


copyreg.pickle(arb, _reduce)
copyreg.pickle(acb, lambda ball: (acb, (ball.real, ball.imag)))
