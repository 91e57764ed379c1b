"""Arcs of many states at once, in the lanes of heyoka's batch integrators.

Every lane has its own time, step length and events; where its arc ends, the next state takes its place. What happens
in one lane does not depend on the others, to the last bit.
"""

from dataclasses import dataclass
from typing import Any

import heyoka as hy
import numpy as np
from numpy.typing import NDArray

from gaitopt.mechanics import HybridSystem, Mode, margin_names
from gaitopt.simulation.events import EDGE, INSTANT, PRIORITY, SIMULTANEOUS
from gaitopt.simulation.heyoka_functions import CompiledRows
from gaitopt.simulation.heyoka_integrators import LANES, batch_integrator
from gaitopt.simulation.heyoka_stepper import BARELY_MOVING, MAX_TAYLOR_STEPS, RATE_EDGE

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]

LIMIT, FAILURE = -1, -2
"""Codes of arcs that end at their time limit, or because the integrator cannot go on."""
SUCCESS, TIME_LIMIT = int(hy.taylor_outcome.success), int(hy.taylor_outcome.time_limit)


@dataclass(frozen=True, slots=True, kw_only=True)
class Arrivals:
    """Where arcs end, and why.

    Attributes
    ----------
    times : ndarray, shape (n,) - time since the last impact [s].
    states : ndarray, shape (n, n_z).
    events : ndarray, shape (n,) - index in ``margin_names`` of the margin that fell to zero, ``LIMIT`` or ``FAILURE``.
    """

    times: Array
    states: Array
    events: Indices


class HeyokaBatch:
    """What a ``Stepper`` does, for many states of one system at fixed parameters.

    Parameters
    ----------
    system : the walker under its control law.
    p : ndarray, shape (n_p,) - parameters.
    """

    def __init__(self, system: HybridSystem, p: Array) -> None:
        self._system, self._p = system, np.array(p)
        self._events = {mode: CompiledRows(system.events(mode), {2: self._p}) for mode in Mode}
        self._constants: dict[Mode, Array] = {}
        self.data = np.array([system.data(k) for k in range(len(system.control.breakpoints) + 1)])

    def advance(self, mode: Mode, segments: Indices, times: Array, states: Array, limits: Array) -> Arrivals:
        """Integrate arcs in one mode to their first events or time limits.

        Parameters
        ----------
        segments : ndarray, shape (n,) - segments of the control.
        times, limits : ndarray, shape (n,) - times since the last impact [s].
        states : ndarray, shape (n, n_z) - states at ``times``.
        """
        at_edge, fallen = _departure(*self._margins(mode, segments, times, states))
        arrivals = Arrivals(times=times.copy(), states=states.copy(), events=_first(mode, fallen, LIMIT))
        if mode is not Mode.STICK:
            arrivals.states[states[:, -1] == 0, -1] = mode.direction * BARELY_MOVING
        waiting = np.flatnonzero(~fallen.any(axis=1) & (times < limits))
        constants = self._runtime(mode)[segments]
        _Lanes(batch_integrator(self._system, mode).taylor, constants, limits, at_edge, arrivals).run(waiting)
        return self._settled(mode, segments, arrivals, waiting)

    def _settled(self, mode: Mode, segments: Indices, arrivals: Arrivals, moved: Indices) -> Arrivals:
        """Of simultaneous events the one that counts."""
        rows = moved[arrivals.events[moved] >= 0]
        if rows.size:
            margins, rates = self._margins(mode, segments[rows], arrivals.times[rows], arrivals.states[rows])
            together = (rates < 0) & (np.abs(margins) <= -rates * SIMULTANEOUS)
            together[np.arange(rows.size), arrivals.events[rows]] = True
            arrivals.events[rows] = _first(mode, together, LIMIT)
        return arrivals

    def _margins(self, mode: Mode, segments: Indices, times: Array, states: Array) -> list[Array]:
        return self._events[mode](times[:, None], states, self.data[segments])

    def _runtime(self, mode: Mode) -> Array:
        """Runtime parameters on every segment of the control; shape (n_segments, n_par)."""
        if mode not in self._constants:
            integrator = batch_integrator(self._system, mode)
            self._constants[mode] = np.array([integrator.values(self._p, data) for data in self.data])
        return self._constants[mode]


class _Lanes:
    """One pass of arcs through the lanes of a batch integrator."""

    def __init__(self, taylor: Any, constants: Array, limits: Array, at_edge: Flags, arrivals: Arrivals) -> None:
        self._taylor, self._constants, self._limits = taylor, constants, limits
        self._at_edge, self._arrivals = at_edge, arrivals
        self._rows = [-1] * LANES
        self._stops = np.zeros(LANES)
        self._counts = [0] * LANES
        self._starts = [0.0] * LANES

    def run(self, waiting: Indices) -> None:
        """Integrate the arcs of the rows ``waiting``; their ends replace the starts in the arrivals."""
        if not waiting.size:
            return
        first = waiting[0]
        self._spare = self._arrivals.times[first], self._arrivals.states[first].copy(), self._constants[first]
        queue = iter(waiting.tolist())
        active = sum([self._load(lane, queue) for lane in range(LANES)])
        taylor, stops = self._taylor, self._stops
        while active:
            taylor.step((stops - taylor.time).tolist())
            for lane, (outcome, _) in enumerate(taylor.step_res):
                code = int(outcome)
                if self._rows[lane] >= 0 and (code != SUCCESS or self._exhausted(lane)) and self._ends(lane, code):
                    active += self._load(lane, queue) - 1

    def _exhausted(self, lane: int) -> bool:
        self._counts[lane] += 1
        return self._counts[lane] > MAX_TAYLOR_STEPS

    def _ends(self, lane: int, code: int) -> bool:
        """Whether the arc in a lane ends here; if so, it is recorded."""
        row, time, event = self._rows[lane], float(self._taylor.time[lane]), -code - 1
        n_margins = self._at_edge.shape[1]
        if 0 <= event < n_margins and time <= self._starts[lane] + INSTANT and self._at_edge[row, event]:
            return False  # it has only left its edge
        if not 0 <= event < n_margins:
            event = LIMIT if code == TIME_LIMIT else FAILURE
        arrivals = self._arrivals
        arrivals.times[row] = self._limits[row] if event == LIMIT else time
        arrivals.states[row], arrivals.events[row] = self._taylor.state[:, lane], event
        return True

    def _load(self, lane: int, queue: Any) -> int:
        """Put the next arc into a lane; without one, a state that does not move. Returns how many arcs that are."""
        row = next(queue, -1)
        time, state, constants = self._spare
        stop = time
        if row >= 0:
            time, state, constants = self._arrivals.times[row], self._arrivals.states[row], self._constants[row]
            stop = self._limits[row]
        taylor = self._taylor
        high, low = (part.copy() for part in taylor.dtime)  # the other lanes keep the low part of their time
        high[lane], low[lane] = time, 0.0
        taylor.set_dtime(high, low)
        taylor.state[:, lane], taylor.pars[:, lane] = state, constants
        taylor.reset_cooldowns(lane)
        self._rows[lane], self._starts[lane], self._stops[lane], self._counts[lane] = row, time, stop, 0
        return int(row >= 0)


def _departure(margins: Array, rates: Array) -> tuple[Flags, Flags]:
    """Which margins start at their edge, and which do not hold from the start; ``touchdown``, the first, may not."""
    fallen = np.where(margins < -EDGE, margins + INSTANT * rates < 0, (margins <= EDGE) & (rates < -RATE_EDGE))
    fallen[:, 0] = False
    return margins <= EDGE, fallen


def _first(mode: Mode, flags: Flags, otherwise: int) -> Indices:
    """For each row the flagged margin that comes first by priority; shape (n,)."""
    order = np.argsort([PRIORITY.index(name) for name in margin_names(mode)])
    first = order[np.argmax(flags[:, order], axis=1)]
    return np.where(flags.any(axis=1), first, otherwise)
