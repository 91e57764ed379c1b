"""CasADi's SX functions in ball arithmetic: the same graph, instruction by instruction.

The values may be real balls or truncated power series of real balls (``arb``, ``arb_series`` of python-flint); every
result encloses the exact one, and is not finite where the function may not be defined.
"""

import operator
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from math import pi
from typing import Any

import casadi as ca
from casadi import Function
from flint import arb, fmpq

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
