"""Taylor integrators of heyoka for the modes of a system, compiled once per equations and kept.

The order of the series follows from the tolerance (20 in double precision), the length of a step from its last two
coefficients; events are roots of the margins' own series, each lifted by a runtime parameter of its own. All is in
natural units. Biscani & Izzo (2021), doi:10.1093/mnras/stab1032.

Compiled code goes to heyoka's cache on disk, so that only the first run on a machine waits for the compiler. Every
thread has its own copy of an integrator, whose state is overwritten by use.
"""

import threading
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import heyoka as hy
import numpy as np
from casadi import Function

from gaitopt.arrays import Array
from gaitopt.mechanics import HybridSystem, Mode, margin_names
from gaitopt.simulation.events import INSTANT
from gaitopt.simulation.heyoka.convert import convert
from gaitopt.simulation.natural import natural_system
from gaitopt.threads import per_thread

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
    return _Equations(natural_system(system).arc(mode), len(margin_names(mode)))


@per_thread(maxsize=32)
def _integrator(equations: _Equations, **options: Any) -> Integrator:
    """The integrator of this thread, with the options of ``_compiled``."""
    with COMPILING:
        compiled = _compiled(equations, **options)
        return replace(compiled, taylor=copy(compiled.taylor))


@lru_cache(maxsize=32)
def _compiled(
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
