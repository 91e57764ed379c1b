"""CasADi functions as heyoka expressions, instruction by instruction.

An SX function is a straight list of scalar instructions on a work vector. Replaying that list on heyoka expressions
gives the same graph, so that both engines integrate the very same equations. What depends on constants alone is left
to CasADi and enters as a runtime parameter ``par[k]``: a Taylor series of it would be wasted, and one compiled
integrator serves all parameter values.

Taylor integrators of heyoka for the modes of a system, compiled once per equations and kept.

The order of the series follows from the tolerance (20 in double precision), the length of a step from its last two
coefficients; events are roots of the margins' own series, each lifted by a runtime parameter of its own. All is in
natural units. Biscani & Izzo (2021), doi:10.1093/mnras/stab1032.

Compiled code goes to heyoka's cache on disk, so that only the first run on a machine waits for the compiler. Every
thread has its own copy of an integrator, whose state is overwritten by use.

Functions of many states at once, compiled by heyoka: the lanes of a register instead of one row after the other.

Arcs by heyoka's Taylor series: some ten steps to a phase, events at roots of the series, both to rounding.

heyoka reports every simple root of a margin in a step, in order of time. Margins that start at their edge (the level
feet, a slip at its onset, which is a double root) are lifted off it, see ``events.lift``; Newton's method leads from
the root of the lifted margin to that of the margin itself. Inside, all is in natural units.
"""

import threading
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import casadi as ca
import heyoka as hy
import numpy as np
from casadi import SX, Function

from gaitopt.arrays import Array
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.simulation.events import (
    EDGE,
    INSTANT,
    LOOK,
    Point,
    coincides,
    fallen,
    is_armed,
    lift,
    priority,
    refine,
    smallest_lift,
)
from gaitopt.simulation.natural import PointFunctions, natural_system, units
from gaitopt.simulation.stepper import Arrival
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


LANES = 8
"""States that a batch integrator advances at once: the doubles of one AVX-512 register, or of two of AVX2. It is the
same on every machine, because the order of roundings depends on it."""
LONGEST_UNROLLED = 450
"""Operations up to which the series are unrolled: two to three times faster, but the compiler's time grows faster than
their number (four seconds for 250, six for 420); beyond it heyoka's compact mode makes loops of them."""
VARIATIONAL_TOLERANCE = 1e-12
"""Of a step with deviations: order 15 instead of 20 takes two thirds of the time, and they are still right to 1e-14,
because heyoka's choice of the step length leaves two digits."""

COMPILING = threading.RLock()
"""Held while heyoka compiles, so that threads that need the same code compile it once."""

hy.set_logger_level_error()  # of a motion that becomes infinite it also warns on stderr


@dataclass(frozen=True, slots=True, kw_only=True)
class Integrator:
    """A compiled integrator of some equations, and what sets its runtime parameters.

    Attributes
    ----------
    taylor : heyoka's integrator, scalar or of ``LANES`` lanes; its state, time and parameters are overwritten by use.
    constants : (parameters, r) -> runtime parameters, shape (n_par,); those behind them are the lifts of the margins.
    """

    taylor: Any
    constants: Function

    def values(self, parameters: Array, data: Array) -> Array:
        """Runtime parameters of a mode (see ``Units``) on the control's segment with ``data``; shape (n_par,)."""
        return np.asarray(self.constants(parameters, data)).ravel()


def event_integrator(system: HybridSystem, mode: Mode, *, precision: type = float) -> Integrator:
    """Motion in one mode that stops where a margin falls through zero."""
    return _integrator(_with_margins(system, mode), precision=precision)


def batch_integrator(system: HybridSystem, mode: Mode) -> Integrator:
    """The same for ``LANES`` states at once."""
    return _integrator(_with_margins(system, mode), lanes=LANES)


def flow_integrator(system: HybridSystem, mode: Mode, *, precision: type = float) -> Integrator:
    """Motion in one mode without events."""
    return _integrator(_Equations(natural_system(system).flow(mode)), precision=precision, unrolled=False)


def variational_integrator(system: HybridSystem, mode: Mode, columns: int) -> Integrator:
    """Motion in one mode with ``columns`` deviations; see ``NaturalSystem.variational``."""
    return _integrator(
        _Equations(natural_system(system).variational(mode, columns)), unrolled=False, tolerance=VARIATIONAL_TOLERANCE
    )


class _Equations:
    """A function (t, y, p, r) -> dy/dt, and margins behind it; equal if its instructions are."""

    def __init__(self, function: Function, n_margins: int = 0) -> None:
        self.function, self.n_margins = function, n_margins
        self._key = (function.serialize(), n_margins)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Equations) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


def _with_margins(system: HybridSystem, mode: Mode) -> _Equations:
    return _Equations(natural_system(system).arc(mode), len(system.transitions.of(mode)))


@per_thread(maxsize=32)
def _integrator(equations: _Equations, **options: Any) -> Integrator:
    """The integrator of this thread, with the options of ``_compiled``."""
    with COMPILING:
        compiled = _compiled_integrators(equations, **options)
        return replace(compiled, taylor=copy(compiled.taylor))


@lru_cache(maxsize=32)
def _compiled_integrators(
    equations: _Equations,
    *,
    precision: type = float,
    lanes: int = 1,
    unrolled: bool = True,
    tolerance: float = 0.0,  # that of rounding
) -> Integrator:
    function = equations.function
    n = function.numel_in(1)
    y = [hy.expression(f"y{k}") for k in range(n)]
    conversion = convert(function, {0: [hy.time], 1: y})
    rates, margins = conversion.outputs[0][:n], conversion.outputs[0][n:]
    n_constants = conversion.constants.numel_out(0)
    n_pars = n_constants + len(margins)
    zeros: Any = np.zeros((max(n, n_pars), lanes), dtype=precision).squeeze()
    event = hy.t_event if lanes == 1 else hy.t_event_batch
    compact = not unrolled or conversion.operations > LONGEST_UNROLLED
    options = {"fp_type": precision, "tol": precision(tolerance), "compact_mode": compact}
    build: Callable[..., Any] = hy.taylor_adaptive if lanes == 1 else hy.taylor_adaptive_batch
    lifted = [margin + hy.par[n_constants + k] for k, margin in enumerate(margins)]
    taylor = build(
        sys=list(zip(y, rates, strict=True)),
        state=zeros[:n].copy(),
        pars=zeros[:n_pars].copy(),
        t_events=[
            event(m, direction=hy.event_direction.negative, cooldown=precision(INSTANT), fp_type=precision)
            for m in lifted
        ],
        force_avx512=lanes > 1,
        **options,
    )
    return Integrator(taylor=taylor, constants=conversion.constants)


BLOCK = 256
"""Rows of one call. Every call has so many, so that a row is rounded the same wherever it stands: what is left over of
a block that does not fill the registers would go through other instructions."""


class HeyokaRowMap:
    """A function of vectors evaluated row by row.

    Parameters
    ----------
    function : CasADi function of vectors.
    fixed : values of inputs that are the same in all rows and all calls, by their index.
    """

    def __init__(self, function: Function, fixed: dict[int, Array]) -> None:
        self._sizes = [function.numel_out(k) for k in range(function.n_out())]
        free = tuple(k for k in range(function.n_in()) if k not in fixed)
        self._compiled, constants = _row_function(_Key(function), free)
        values = np.asarray(constants(*fixed.values()), dtype=float).ravel() if fixed else np.zeros(0)
        self._pars = np.repeat(values[:, None], BLOCK, axis=1)
        self._inputs = np.zeros((sum(function.numel_in(k) for k in free), BLOCK))
        self._outputs = np.zeros((sum(self._sizes), BLOCK))

    def __call__(self, *values: Array) -> list[Array]:
        """Outputs of shape (n, size) from the inputs that are not fixed, each of shape (n, size)."""
        n = len(values[0])
        results = np.empty((n, sum(self._sizes)))
        rows = np.concatenate(values, axis=1).T
        for start in range(0, n, BLOCK):
            count = min(BLOCK, n - start)
            self._inputs[:, :count] = rows[:, start : start + count]
            self._inputs[:, count:] = rows[:, start : start + 1]  # must be something; is not read
            options = {"pars": self._pars} if self._pars.size else {}
            self._compiled(self._inputs, outputs=self._outputs, **options)
            results[start : start + count] = self._outputs[:, :count].T
        return np.split(results, np.cumsum(self._sizes)[:-1], axis=1)


class _Key:
    """A function that is equal to another if its instructions are."""

    def __init__(self, function: Function) -> None:
        self.function, self._text = function, function.serialize()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self._text == other._text

    def __hash__(self) -> int:
        return hash(self._text)


@per_thread(maxsize=32)
def _row_function(key: _Key, free: tuple[int, ...]) -> tuple[Any, Function]:
    """The function of this thread: its calls use memory of its own."""
    with COMPILING:
        compiled, constants = _compiled(key, free)
        return copy(compiled), constants


@lru_cache(maxsize=32)
def _compiled(key: _Key, free: tuple[int, ...]) -> tuple[Any, Function]:
    function = key.function
    variables = {k: [hy.expression(f"v{k}_{i}") for i in range(function.numel_in(k))] for k in free}
    conversion = convert(function, variables)
    outputs = [entry for output in conversion.outputs for entry in output]
    names = [name for group in variables.values() for name in group]
    return hy.cfunc(outputs, names, compact_mode=True), conversion.constants


MAX_TAYLOR_STEPS = 20_000
"""Bound on the work for one arc: walking takes ten, only a very stiff control law takes more."""
NOT_FINITE = "the equations of motion are not finite"
TOO_MANY = f"more than {MAX_TAYLOR_STEPS} integration steps in one arc"


class HeyokaStepper:
    """A ``Stepper`` by heyoka.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    precision : ``float``, or ``numpy.longdouble`` for an oracle; states are returned in double precision.
    """

    def __init__(self, dynamics: Dynamics, *, precision: type = float) -> None:
        self._system = dynamics.system
        self._units, self._precision = units(dynamics), precision
        self._points = PointFunctions(dynamics, self._units)
        self._integrators: dict[tuple[str, Mode, int], _Loaded] = {}

    def at(self, dynamics: Dynamics) -> "HeyokaStepper":
        """The same precision at other parameters; see ``Stepper``."""
        return HeyokaStepper(dynamics, precision=self._precision)

    def advance(self, mode: Mode, data: Array, time: float, state: Array, limit: float) -> Arrival:
        """Integrate one arc from ``time`` to its first event, or to ``limit``; see ``Stepper``."""
        unit, names = self._units, self._system.transitions.margin_names(mode)
        start = self._points(mode, time / unit.time, state / unit.state, data)
        event = fallen(names, start.margins, start.rates, partial(self._look, mode, data, start))
        if event is not None or limit <= time:
            return Arrival(time=time, state=state, event=event)
        taylor = self._loaded("events", mode, data, start.time, start.state)
        taylor.pars[-len(names) :] = _lifts(names, start)
        taylor.reset_cooldowns()
        outcome = taylor.propagate_until(self._precision(limit / unit.time), max_steps=MAX_TAYLOR_STEPS)[0]
        end, zeta = float(taylor.time), np.array(taylor.state, dtype=float)
        k = -int(outcome) - 1
        if 0 <= k < len(names):
            name, end, zeta = self._located(mode, data, start, k, self._points(mode, end, zeta, data))
            return Arrival(time=max(end * unit.time, time), state=zeta * unit.state, event=name)
        if outcome == hy.taylor_outcome.time_limit:
            return Arrival(time=limit, state=zeta * unit.state)
        if outcome == hy.taylor_outcome.step_limit:
            return Arrival(time=end * unit.time, state=zeta * unit.state, failure=TOO_MANY)
        return Arrival(time=time, state=state, failure=NOT_FINITE)  # nothing is known beyond the start

    def sample(self, mode: Mode, data: Array, state: Array, times: Array) -> Array:
        """States at ascending ``times`` of an arc that starts with ``state`` at the first; see ``Stepper``."""
        unit, taus = self._units, times / self._units.time
        taylor = self._loaded("flow", mode, data, taus[0], state / unit.state)
        return np.asarray(taylor.propagate_grid(taus.astype(self._precision))[-1], dtype=float) * unit.state

    def propagate_variations(self, mode: Mode, data: Array, state: Array, deviations: Array, times: Array) -> Array:
        """Deviations at the end of an arc from those at its start; see ``Stepper``."""
        unit, (start, end) = self._units, times / self._units.time
        y, sizes = unit.pack(state, deviations)
        taylor = self._loaded("variational", mode, data, start, y, sizes.size)
        taylor.propagate_until(end)
        return unit.unpack(taylor.state, sizes)

    def _loaded(self, kind: str, mode: Mode, data: Array, time: float, state: Array, columns: int = 0) -> Any:
        """The integrator for one purpose, its parameters, time and state set."""
        key = (kind, mode, columns)
        if key not in self._integrators:
            self._integrators[key] = _Loaded(self._compile(*key), self._units.parameters[mode])
        return self._integrators[key].at(data, self._precision(time), state)

    def _compile(self, kind: str, mode: Mode, columns: int) -> Integrator:
        if kind == "variational":
            return variational_integrator(self._system, mode, columns)
        build = event_integrator if kind == "events" else flow_integrator
        return build(self._system, mode, precision=self._precision)

    def _located(self, mode: Mode, data: Array, start: Point, k: int, near: Point) -> tuple[str, float, Array]:
        """The event that counts at the root of the k-th margin, of which ``near`` is the lifted one; time and state."""
        end, zeta = refine(k, near, partial(self._reach, mode, data))
        names, shift = self._system.transitions.margin_names(mode), end - near.time
        together = [
            names[j]
            for j, rate in enumerate(near.rates)
            if rate < 0 and coincides(near.margins[j] + shift * rate, rate)
            if is_armed(names[j], start.margins[j]) or end > start.time + INSTANT
        ]
        return min((names[k], *together), key=priority), end, zeta

    def _reach(self, mode: Mode, data: Array, point: Point, duration: float) -> Point:
        taylor = self._loaded("flow", mode, data, point.time, point.state)
        taylor.propagate_for(self._precision(duration))
        return self._points(mode, float(taylor.time), np.array(taylor.state, dtype=float), data)

    def _look(self, mode: Mode, data: Array, point: Point) -> list[float]:
        """Rates of the margins a little later, from which their bends follow."""
        return list(self._points(mode, *point.shifted(LOOK), data).rates)


def _lifts(names: tuple[str, ...], start: Point) -> list[float]:
    """By how much every margin is lifted in an arc."""
    lifts = list(_smallest_lifts(names))
    for k, margin in enumerate(start.margins):
        if margin <= EDGE:
            lifts[k] = lift(names[k], margin, start.rates[k])
    return lifts


@lru_cache(maxsize=64)
def _smallest_lifts(names: tuple[str, ...]) -> tuple[float, ...]:
    return tuple(map(smallest_lift, names))


class _Loaded:
    """An integrator at fixed parameters of the walker; ``state`` and ``pars`` are its own memory."""

    def __init__(self, integrator: Integrator, parameters: Array) -> None:
        self._integrator, self._parameters = integrator, parameters
        self._state, self._pars = integrator.taylor.state, integrator.taylor.pars
        self._constants: dict[bytes, Array] = {}

    def at(self, data: Array, time: Any, state: Array) -> Any:
        """The integrator at the start of an arc."""
        segment = data.tobytes()
        if segment not in self._constants:
            self._constants[segment] = self._integrator.values(self._parameters, data)
        constants = self._constants[segment]
        taylor = self._integrator.taylor
        self._pars[: constants.size], taylor.time, self._state[:] = constants, time, state
        return taylor
