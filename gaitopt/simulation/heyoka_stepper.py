"""Arcs by heyoka's Taylor series: some ten steps to a phase, events at roots of the series, both to rounding.

heyoka reports every simple root of a margin in a step, in order of time. What it cannot know is told apart here:
a margin that starts at its edge (the level feet, a slip at its onset, which is a double root) and only leaves it.
"""

from collections.abc import Iterable
from typing import Any

import heyoka as hy
import numpy as np
from numpy.typing import NDArray

from gaitopt.mechanics import HybridSystem, Mode, margin_names
from gaitopt.simulation.buffered import Buffered
from gaitopt.simulation.events import EDGE, INSTANT, PRIORITY, SIMULTANEOUS
from gaitopt.simulation.heyoka_integrators import (
    Integrator,
    event_integrator,
    flow_integrator,
    variational_integrator,
)
from gaitopt.simulation.stepper import Arrival

Array = NDArray[np.float64]

RATE_EDGE = 1e-9
"""A rate this small, in the margin's unit per second, is zero: the margin leaves its edge by its second derivative."""
BARELY_MOVING = 1e-18
"""Slip velocity [m/s] in place of an exact zero, below all rounding. Of a series that begins with zero heyoka may miss
the next root; and at the onset of slip, a double root, this lifts the series off the axis."""
MAX_TAYLOR_STEPS = 20_000
"""Bound on the work for one arc: walking takes ten, only a very stiff control law takes more."""
NOT_FINITE = "the equations of motion are not finite"
TOO_MANY = f"more than {MAX_TAYLOR_STEPS} integration steps in one arc"


class HeyokaStepper:
    """A ``Stepper`` by heyoka.

    Parameters
    ----------
    system : the walker under its control law.
    p : ndarray, shape (n_p,) - parameters.
    precision : ``float``, or ``numpy.longdouble`` for an oracle; states are returned in double precision.
    """

    def __init__(self, system: HybridSystem, p: Array, *, precision: type = float) -> None:
        self._system, self._p, self._precision = system, np.array(p), precision
        self._events = {mode: Buffered(system.events(mode)) for mode in Mode}
        for events in self._events.values():
            events.inputs[2][:] = p
        self._integrators: dict[tuple[str, Mode, int], Integrator] = {}
        self._constants: dict[tuple[str, Mode, int, bytes], Array] = {}

    def advance(self, mode: Mode, data: Array, time: float, state: Array, limit: float) -> Arrival:
        """Integrate one arc from ``time`` to its first event, or to ``limit``; see ``Stepper``."""
        at_edge, fallen = self._departure(mode, data, time, state)
        if fallen is not None or limit <= time:
            return Arrival(time=time, state=state, event=fallen)
        taylor = self._loaded("events", mode, data, time, state)
        if mode is not Mode.STICK and state[-1] == 0:
            taylor.state[-1] = mode.direction * BARELY_MOVING
        taylor.reset_cooldowns()
        names = margin_names(mode)
        while True:
            outcome = taylor.propagate_until(self._precision(limit), max_steps=MAX_TAYLOR_STEPS)[0]
            end, event = float(taylor.time), -int(outcome) - 1
            if not (0 <= event < len(names) and end <= time + INSTANT and names[event] in at_edge):
                break
        z = np.array(taylor.state, dtype=float)
        if 0 <= event < len(names):
            return Arrival(time=end, state=z, event=self._first(mode, data, end, z, names[event]))
        if outcome == hy.taylor_outcome.time_limit:
            return Arrival(time=limit, state=z)
        failure = TOO_MANY if outcome == hy.taylor_outcome.step_limit else NOT_FINITE
        return Arrival(time=end, state=z, failure=failure)

    def sample(self, mode: Mode, data: Array, state: Array, times: Array) -> Array:
        """States at ascending ``times`` of an arc that starts with ``state`` at the first; see ``Stepper``."""
        taylor = self._loaded("flow", mode, data, times[0], state)
        return np.asarray(taylor.propagate_grid(times.astype(self._precision))[-1], dtype=float)

    def transport(self, mode: Mode, data: Array, state: Array, deviations: Array, times: Array) -> Array:
        """Deviations at the end of an arc from those at its start; see ``Stepper``."""
        columns = deviations.shape[1]
        y = np.concatenate([state, deviations.ravel(order="F")])
        taylor = self._loaded("variational", mode, data, times[0], y, columns)
        taylor.propagate_until(times[1])
        return np.array(taylor.state[state.size :]).reshape((-1, columns), order="F")

    def _loaded(self, kind: str, mode: Mode, data: Array, time: float, state: Array, columns: int = 0) -> Any:
        """The integrator for one purpose, its parameters, time and state set."""
        key = (kind, mode, columns)
        if key not in self._integrators:
            self._integrators[key] = self._compile(kind, mode, columns)
        integrator = self._integrators[key]
        place = (*key, data.tobytes())
        if place not in self._constants:
            self._constants[place] = integrator.values(self._p, data)
        taylor = integrator.taylor
        taylor.pars[:], taylor.time, taylor.state[:] = self._constants[place], self._precision(time), state
        return taylor

    def _compile(self, kind: str, mode: Mode, columns: int) -> Integrator:
        if kind == "variational":
            return variational_integrator(self._system, mode, columns)
        build = event_integrator if kind == "events" else flow_integrator
        return build(self._system, mode, precision=self._precision)

    def _departure(self, mode: Mode, data: Array, time: float, state: Array) -> tuple[list[str], str | None]:
        """Margins that start at their edge, and the first by priority that does not hold from the start."""
        at_edge, broken = [], []
        for name, margin, rate in self._margins(mode, data, time, state):
            if margin <= EDGE:
                broken += [name] if name != "touchdown" and falls(margin, rate) else []
                at_edge.append(name)
        return at_edge, min(broken, key=PRIORITY.index) if broken else None

    def _first(self, mode: Mode, data: Array, time: float, state: Array, event: str) -> str:
        """The event that counts among those that are simultaneous with ``event``."""
        margins = self._margins(mode, data, time, state)
        together = [name for name, margin, rate in margins if rate < 0 and abs(margin) <= -rate * SIMULTANEOUS]
        return min((event, *together), key=PRIORITY.index)

    def _margins(self, mode: Mode, data: Array, time: float, state: Array) -> Iterable[tuple[str, float, float]]:
        events = self._events[mode]
        t, z, _, r = events.inputs
        t[0], z[:], r[:] = time, state, data
        events.evaluate()
        margins, rates = events.outputs
        return zip(margin_names(mode), margins.tolist(), rates.tolist(), strict=True)


def falls(margin: float, rate: float) -> bool:
    """Whether a margin that is not above its edge at the start of an arc falls, rather than leaves it upwards."""
    return margin + INSTANT * rate < 0 if margin < -EDGE else rate < -RATE_EDGE
