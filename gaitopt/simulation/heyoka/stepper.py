"""Arcs by heyoka's Taylor series: some ten steps to a phase, events at roots of the series, both to rounding.

heyoka reports every simple root of a margin in a step, in order of time. Margins that start at their edge (the level
feet, a slip at its onset, which is a double root) are lifted off it, see ``events.lift``; Newton's method leads from
the root of the lifted margin to that of the margin itself. Inside, all is in natural units.
"""

from functools import lru_cache, partial
from typing import Any

import heyoka as hy
import numpy as np

from gaitopt.arrays import Array
from gaitopt.mechanics import Dynamics, Mode, margin_names
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
from gaitopt.simulation.heyoka.integrators import (
    Integrator,
    event_integrator,
    flow_integrator,
    variational_integrator,
)
from gaitopt.simulation.natural import PointFunctions, units
from gaitopt.simulation.stepper import Arrival

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
        unit, names = self._units, margin_names(mode)
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
        names, shift = margin_names(mode), end - near.time
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
