"""CasADi functions as heyoka expressions, instruction by instruction.

An SX function is a straight list of scalar instructions on a work vector. Replaying that list on heyoka expressions
gives the same graph, so that both engines integrate the very same equations. What depends on constants alone is left
to CasADi and enters as a runtime parameter ``par[k]``: a Taylor series of it would be wasted, and one compiled
integrator serves all parameter values.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import heyoka as hy
from casadi import SX, Function

UNARY: Mapping[int, Callable[[Any], Any]] = {
    ca.OP_NEG: lambda a: -a,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: 2.0 * a,
    ca.OP_INV: lambda a: 1.0 / a,
    ca.OP_SQRT: hy.sqrt,
    ca.OP_EXP: hy.exp,
    ca.OP_EXPM1: hy.expm1,
    ca.OP_LOG: hy.log,
    ca.OP_LOG1P: hy.log1p,
    ca.OP_SIN: hy.sin,
    ca.OP_COS: hy.cos,
    ca.OP_TAN: hy.tan,
    ca.OP_ASIN: hy.asin,
    ca.OP_ACOS: hy.acos,
    ca.OP_ATAN: hy.atan,
    ca.OP_SINH: hy.sinh,
    ca.OP_COSH: hy.cosh,
    ca.OP_TANH: hy.tanh,
    ca.OP_ASINH: hy.asinh,
    ca.OP_ACOSH: hy.acosh,
    ca.OP_ATANH: hy.atanh,
    ca.OP_ERF: hy.erf,
}
"""Instructions of one operand; those with a kink (fabs, sign, floor) have no Taylor series and are refused."""
BINARY: Mapping[int, Callable[[Any, Any], Any]] = {
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b,
    ca.OP_POW: lambda a, b: a**b,
    ca.OP_CONSTPOW: lambda a, b: a**b,
    ca.OP_ATAN2: hy.atan2,
    ca.OP_HYPOT: lambda a, b: hy.sqrt(a * a + b * b),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Conversion:
    """A function in heyoka's terms.

    Attributes
    ----------
    outputs : for each output one heyoka expression per entry, columns one after the other.
    constants : CasADi function from the constant inputs to the values of ``par[0], par[1], ...``, shape (n_par,).
    operations : how many instructions are left for heyoka.
    """

    outputs: tuple[tuple[Any, ...], ...]
    constants: Function
    operations: int


def convert(function: Function, inputs: Mapping[int, list[Any]]) -> Conversion:
    """Convert an SX function.

    Parameters
    ----------
    function : of dense inputs.
    inputs : heyoka expressions by index of the input, one per entry; an input that is not there is constant.

    Raises
    ------
    ValueError
        If the motion goes through an instruction that is not analytic; the message names the function.
    """
    return _Replay(function, inputs).run()


class _Constant:
    """A value of the constant part of the graph, and the place in ``par`` that it gets when it is needed outside."""

    __slots__ = ("place", "value")

    def __init__(self, value: SX) -> None:
        self.value, self.place = value, -1


class _Replay:
    """One pass through the instructions; ``work`` holds constants and heyoka expressions side by side."""

    def __init__(self, function: Function, inputs: Mapping[int, list[Any]]) -> None:
        self._function, self._inputs = function, inputs
        self._symbols = {
            k: SX.sym(function.name_in(k), function.numel_in(k)) for k in range(function.n_in()) if k not in inputs
        }
        self._work: dict[int, Any] = {}
        self._hoisted: list[SX] = []
        self._operations = 0

    def run(self) -> Conversion:
        f = self._function
        outputs = [[hy.expression(0.0)] * f.numel_out(k) for k in range(f.n_out())]
        places = [_places(f, k) for k in range(f.n_out())]
        for k in range(f.n_instructions()):
            operands, results = f.instruction_input(k), f.instruction_output(k)
            if f.instruction_id(k) == ca.OP_OUTPUT:
                output, nonzero = results
                outputs[output][places[output][nonzero]] = self._expression(self._work[operands[0]])
            else:
                self._work[results[0]] = self._value(k, f.instruction_id(k), operands)
        constants = Function("constants", list(self._symbols.values()), [ca.vertcat(*self._hoisted)])
        return Conversion(outputs=tuple(map(tuple, outputs)), constants=constants, operations=self._operations)

    def _value(self, k: int, operation: int, operands: list[int]) -> Any:
        if operation == ca.OP_CONST:
            return _Constant(SX(self._function.instruction_constant(k)))
        if operation == ca.OP_INPUT:
            source, entry = operands
            constant = source in self._symbols
            return _Constant(self._symbols[source][entry]) if constant else self._inputs[source][entry]
        values = [self._work[operand] for operand in operands]
        if operation == ca.OP_ASSIGN:
            return values[0]
        if all(isinstance(value, _Constant) for value in values):
            evaluate = SX.unary if len(values) == 1 else SX.binary
            return _Constant(evaluate(operation, *(value.value for value in values)))
        return self._apply(operation, [self._expression(value) for value in values])

    def _apply(self, operation: int, operands: list[Any]) -> Any:
        table: Mapping[int, Callable[..., Any]] = UNARY if len(operands) == 1 else BINARY
        if operation not in table:
            raise ValueError(
                f"{self._function.name()}: CasADi's operation {operation} has no Taylor series; "
                "state the walker and its control without kinks, or use the engine scipy"
            )
        self._operations += 1
        return table[operation](*operands)

    def _expression(self, value: Any) -> Any:
        """A value for use outside the constant part: itself, a number, or a new entry of ``par``."""
        if not isinstance(value, _Constant):
            return value
        if value.value.is_constant():
            return hy.expression(float(value.value))
        if value.place < 0:
            value.place = len(self._hoisted)
            self._hoisted.append(value.value)
        return hy.par[value.place]


def _places(function: Function, output: int) -> list[int]:
    """Position of every nonzero of an output among all its entries, columns one after the other."""
    sparsity = function.sparsity_out(output)
    return [row + column * sparsity.size1() for row, column in zip(sparsity.row(), sparsity.get_col(), strict=True)]
