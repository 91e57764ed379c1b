"""Functions of CasADi compiled by heyoka: integrators by Taylor series, and functions of many rows.

An SX function is a list of scalar instructions on a work vector. They are replayed on heyoka's expressions, so that all
engines integrate the same equations. CasADi evaluates subexpressions that only depend on constants; the results become
runtime parameters ``par[k]``, so that one compiled integrator serves all parameter values.

The order of a series follows from the tolerance (20 in double precision), and the step length from its last two
coefficients. Events are roots of the series of the margins, each of which is lifted by a separate runtime parameter
(``events.lift``). F. Biscani & D. Izzo (2021), MNRAS 504, 2614-2628, doi:10.1093/mnras/stab1032.

heyoka caches compiled code on disk, so that only the first run on a machine waits for the compiler. Integrators and
functions write to their own memory, so that every thread has its own copy.
"""

import threading
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import heyoka as hy
import numpy as np
from casadi import SX, Function

from gaitopt.arrays import Array
from gaitopt.building import building
from gaitopt.model.buffered import RowMap
from gaitopt.simulation.events import INSTANT
from gaitopt.threads import per_thread

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
"""CasADi's instructions of one operand. Those with a kink (fabs, sign, floor) have no Taylor series and are missing."""
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


LANES = 8
"""Number of states that a batch integrator advances at once: the doubles of one AVX-512 register, or of two AVX2
registers. It is the same on every machine, because the order of roundings depends on it."""
LONGEST_UNROLLED = 450
"""Largest number of operations of a series that is unrolled. Unrolled code is two to three times faster. Its
compilation takes four seconds for 250 operations and six for 420, but much longer beyond. Longer series are compiled in
heyoka's compact mode, with loops."""
OPTIMISATION = 3
"""Level of LLVM's optimisation. Unoptimised code compiles about six times faster and runs at half the speed."""
VARIATIONAL_TOLERANCE = 1e-12
"""Tolerance of a step with deviations. Order 15 instead of 20 takes two thirds of the time, and the deviations are
still accurate to 1e-14: heyoka's choice of the step length has a reserve of two digits."""
CORRECTED_TOLERANCE = 1e-14
"""Tolerance of a step with deviations under feedback from step to step, whose gains cancel their large growth."""
BLOCK = 256
"""Number of rows in one call of a row function. All calls have this size: if the last rows of a block did not fill the
registers, other instructions would round them differently."""
COMPILING = threading.RLock()
"""A thread takes this lock to compile with heyoka, so that threads that need the same code compile it once."""

hy.set_logger_level_error()  # otherwise heyoka warns on stderr if a motion becomes infinite


@dataclass(frozen=True, slots=True, kw_only=True)
class Conversion:
    """A function as heyoka expressions.

    Attributes
    ----------
    outputs : for each output, one expression per entry in column-major order.
    constants : CasADi function from the constant inputs to the values of ``par[0], par[1], ...``, shape (n_par,).
    operations : number of instructions that heyoka evaluates.
    """

    outputs: tuple[tuple[Any, ...], ...]
    constants: Function
    operations: int


@building
def convert(function: Function, inputs: Mapping[int, list[Any]]) -> Conversion:
    """Convert an SX function.

    Parameters
    ----------
    function : a function with dense inputs.
    inputs : heyoka expressions by index of the input, one per entry; all other inputs are constants.

    Raises
    ------
    ValueError
        If an output depends on ``inputs`` through an instruction that is not analytic; the message names the function.
    """
    f = function
    symbols = {k: SX.sym(f.name_in(k), f.numel_in(k)) for k in range(f.n_in()) if k not in inputs}
    outputs = [[hy.expression(0.0)] * f.numel_out(k) for k in range(f.n_out())]
    positions = []  # index of every nonzero of an output among its entries
    for k in range(f.n_out()):
        pattern = f.sparsity_out(k)
        positions.append([i + j * pattern.size1() for i, j in zip(pattern.row(), pattern.get_col(), strict=True)])
    work: dict[int, Any] = {}  # constants as SX, everything else as heyoka expressions
    parameters: dict[int, tuple[SX, Any]] = {}  # constants that heyoka needs, by identity, with their entries of par
    operations = 0

    def expression(value: Any) -> Any:
        if not isinstance(value, SX):
            return value
        if value.is_constant():
            return hy.expression(float(value))
        return parameters.setdefault(id(value), (value, hy.par[len(parameters)]))[1]

    for k in range(f.n_instructions()):
        operation, operands, results = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            output, nonzero = results
            outputs[output][positions[output][nonzero]] = expression(work[operands[0]])
        elif operation == ca.OP_CONST:
            work[results[0]] = SX(f.instruction_constant(k))
        elif operation == ca.OP_INPUT:
            source, entry = operands
            work[results[0]] = (symbols if source in symbols else inputs)[source][entry]
        elif operation == ca.OP_ASSIGN:
            work[results[0]] = work[operands[0]]
        else:
            values = [work[operand] for operand in operands]
            if all(isinstance(value, SX) for value in values):
                work[results[0]] = (SX.unary if len(values) == 1 else SX.binary)(operation, *values)
                continue
            table: Mapping[int, Callable[..., Any]] = UNARY if len(values) == 1 else BINARY
            if operation not in table:
                raise ValueError(
                    f"{f.name()}: CasADi's operation {operation} has no Taylor series; "
                    "state the walker and its control without kinks, or use the engine scipy"
                )
            work[results[0]] = table[operation](*map(expression, values))
            operations += 1
    constants = Function(
        "constants", list(symbols.values()), [ca.vertcat(*(value for value, _ in parameters.values()))]
    )
    return Conversion(outputs=tuple(map(tuple, outputs)), constants=constants, operations=operations)


class _Key:
    """A function as a key: it is equal to another one with the same instructions."""

    def __init__(self, function: Function) -> None:
        self.function, self._text = function, function.serialize()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self._text == other._text

    def __hash__(self) -> int:
        return hash(self._text)


@dataclass(frozen=True, slots=True, kw_only=True)
class Integrator:
    """A compiled integrator, and the function that sets its runtime parameters.

    Attributes
    ----------
    taylor : heyoka's integrator, scalar or with ``LANES`` lanes; every use overwrites its state, time and parameters.
    constants : (parameters, r) -> runtime parameters, shape (n_par,); the lifts of the margins follow after them.
    """

    taylor: Any
    constants: Function

    def values(self, parameters: Array, data: Array) -> Array:
        """Runtime parameters from those of a mode (``NaturalDynamics``) and segment data of the control; (n_par,)."""
        return np.asarray(self.constants(parameters, data)).ravel()


def integrator(function: Function, **options: Any) -> Integrator:
    """The integrator of this thread for a function (t, y, p, r) -> dy/dt, followed by margins.

    Parameters
    ----------
    precision : ``float`` or ``numpy.longdouble``.
    lanes : number of states that are integrated at once.
    unrolled : whether short series are unrolled, see ``LONGEST_UNROLLED``.
    tolerance : tolerance of the series; 0 for machine precision.
    """
    return _integrator(_key(function), opt_level=OPTIMISATION, **options)


@lru_cache(maxsize=64)
def _key(function: Function) -> _Key:
    """The key of a function; a walk over tiles asks for it in every step, and to serialise takes a millisecond."""
    return _Key(function)


@per_thread(maxsize=32)
def _integrator(key: _Key, **options: Any) -> Integrator:
    with COMPILING:
        compiled = _compiled_integrator(key, **options)
        return replace(compiled, taylor=copy(compiled.taylor))


@lru_cache(maxsize=32)
def _compiled_integrator(
    key: _Key, *, opt_level: int, precision: type = float, lanes: int = 1, unrolled: bool = True, tolerance: float = 0.0
) -> Integrator:
    n = key.function.numel_in(1)
    y = [hy.expression(f"y{k}") for k in range(n)]
    conversion = convert(key.function, {0: [hy.time], 1: y})
    rates, margins = conversion.outputs[0][:n], conversion.outputs[0][n:]
    n_constants = conversion.constants.numel_out(0)
    n_pars = n_constants + len(margins)
    zeros: Any = np.zeros((max(n, n_pars), lanes), dtype=precision).squeeze()
    event = hy.t_event if lanes == 1 else hy.t_event_batch
    build: Callable[..., Any] = hy.taylor_adaptive if lanes == 1 else hy.taylor_adaptive_batch
    falling = {"direction": hy.event_direction.negative, "cooldown": precision(INSTANT), "fp_type": precision}
    taylor = build(
        sys=list(zip(y, rates, strict=True)),
        state=zeros[:n].copy(),
        pars=zeros[:n_pars].copy(),
        t_events=[event(margin + hy.par[n_constants + k], **falling) for k, margin in enumerate(margins)],
        force_avx512=lanes > 1,
        fp_type=precision,
        tol=precision(tolerance),
        compact_mode=not unrolled or conversion.operations > LONGEST_UNROLLED,
        opt_level=opt_level,
    )
    return Integrator(taylor=taylor, constants=conversion.constants)


class HeyokaRowMap:
    """A function of vectors evaluated for every row of an array, with a batch of rows in a register.

    Parameters
    ----------
    function : CasADi function of vectors.
    fixed : values of the inputs that are the same in all rows and calls, by index.
    """

    def __init__(self, function: Function, fixed: dict[int, Array]) -> None:
        self._sizes = [function.numel_out(k) for k in range(function.n_out())]
        free = tuple(k for k in range(function.n_in()) if k not in fixed)
        self._compiled, constants = _row_function(_Key(function), free, OPTIMISATION)
        values = np.asarray(constants(*fixed.values()), dtype=float).ravel() if fixed else np.zeros(0)
        self._pars, self._constants = np.repeat(values[:, None], BLOCK, axis=1), constants
        self._own_pars = self._pars.copy()
        self._own_constants: RowMap | None = None
        self._inputs = np.zeros((sum(function.numel_in(k) for k in free), BLOCK))
        self._outputs = np.zeros((sum(self._sizes), BLOCK))

    def __call__(self, *values: Array, fixed: Sequence[Array] | None = None) -> list[Array]:
        """Outputs of shape (n, size) from the inputs that are not fixed, each of shape (n, size).

        Parameters
        ----------
        fixed : other values of the fixed inputs in every row, of shape (n, size) each.
        """
        n, pars, own = len(values[0]), self._pars, None
        if fixed is not None and pars.size:
            self._own_constants = self._own_constants or RowMap(self._constants)
            pars, own = self._own_pars, self._own_constants(*fixed)[0]
        results = np.empty((n, sum(self._sizes)))
        rows = np.concatenate(values, axis=1).T
        for start in range(0, n, BLOCK):
            count = min(BLOCK, n - start)
            self._inputs[:, :count] = rows[:, start : start + count]
            self._inputs[:, count:] = rows[:, start : start + 1]  # valid numbers, whose outputs are not read
            if own is not None:
                pars[:, :count] = own[start : start + count].T
                pars[:, count:] = own[start][:, None]
            options = {"pars": pars} if pars.size else {}
            self._compiled(self._inputs, outputs=self._outputs, **options)
            results[start : start + count] = self._outputs[:, :count].T
        return np.split(results, np.cumsum(self._sizes)[:-1], axis=1)


@per_thread(maxsize=32)
def _row_function(key: _Key, free: tuple[int, ...], opt_level: int) -> tuple[Any, Function]:
    with COMPILING:
        compiled, constants = _compiled_row_function(key, free, opt_level)
        return copy(compiled), constants


@lru_cache(maxsize=32)
def _compiled_row_function(key: _Key, free: tuple[int, ...], opt_level: int) -> tuple[Any, Function]:
    variables = {k: [hy.expression(f"v{k}_{i}") for i in range(key.function.numel_in(k))] for k in free}
    conversion = convert(key.function, variables)
    outputs = [entry for output in conversion.outputs for entry in output]
    names = [name for group in variables.values() for name in group]
    return hy.cfunc(outputs, names, compact_mode=True, opt_level=opt_level), conversion.constants
