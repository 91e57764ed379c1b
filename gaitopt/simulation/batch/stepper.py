"""Arcs of many states at once, in the lanes of heyoka's batch integrators.

Every lane has its own time, step length and events; where its arc ends, the next state takes its place. What happens
in one lane does not depend on the others, to the last bit. The rules at the start of an arc and at its end are those
of ``events``; inside, all is in natural units.
"""

from typing import Any

import heyoka as hy
import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.mechanics import Dynamics, Mode, margin_names
from gaitopt.simulation.events import (
    EDGE,
    INSTANT,
    LOOK,
    NEAR,
    bends_decide,
    coincides,
    falls,
    is_touchdown,
    lift,
    priority,
)
from gaitopt.simulation.heyoka.functions import HeyokaRowMap
from gaitopt.simulation.heyoka.integrators import LANES, batch_integrator
from gaitopt.simulation.heyoka.stepper import MAX_TAYLOR_STEPS, HeyokaStepper
from gaitopt.simulation.natural import natural_system, units
from gaitopt.simulation.stepper import FAILURE, LIMIT, Arrivals, Indices

Flags = NDArray[np.bool_]

SUCCESS, TIME_LIMIT = int(hy.taylor_outcome.success), int(hy.taylor_outcome.time_limit)


class HeyokaBatch:
    """A ``BatchStepper`` on heyoka, for one system at fixed parameters.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self._system, self._units = dynamics.system, units(dynamics)
        system = dynamics.system
        self._points = {mode: self._compiled(mode) for mode in system.walker.modes()}
        self._constants: dict[Mode, Array] = {}
        self._alone = HeyokaStepper(dynamics)
        self.data = np.array([system.data(k) for k in range(len(system.control.breakpoints) + 1)])

    def advance(self, mode: Mode, segments: Indices, times: Array, states: Array, limits: Array) -> Arrivals:
        """Integrate arcs in one mode to their first events or time limits.

        Parameters
        ----------
        segments : ndarray, shape (n,) - segments of the control.
        times, limits : ndarray, shape (n,) - times since the last impact [s].
        states : ndarray, shape (n, n_z) - states at ``times``.
        """
        unit = self._units
        taus, zetas = times / unit.time, states / unit.state
        _, margins, rates = start = self._point(mode, segments, taus, zetas)
        fallen = self._fallen(mode, segments, taus, zetas, start)
        moved = np.flatnonzero(~fallen.any(axis=1) & (times < limits))
        ends = Arrivals(times=taus.copy(), states=zetas, events=_first(mode, fallen, LIMIT))
        lifts = [lift(*column) for column in zip(margin_names(mode), margins.T, rates.T, strict=True)]
        constants = np.column_stack([self._runtime(mode)[segments], *lifts])
        _Lanes(batch_integrator(self._system, mode).taylor, constants, limits / unit.time, ends).run(moved)
        self._land_at_limits(mode, segments, ends, moved)
        far = self._locate(mode, segments, ends, moved, taus, margins)
        arrivals = Arrivals(times=times.copy(), states=states.copy(), events=ends.events)
        at_limit = ends.events[moved] == LIMIT
        arrivals.times[moved] = np.where(at_limit, limits[moved], np.fmax(ends.times[moved] * unit.time, times[moved]))
        arrivals.states[moved] = ends.states[moved] * unit.state
        for k in far:
            self._advance_alone(mode, self.data[segments[k]], times[k], states[k], limits[k], arrivals, k)
        return arrivals

    def _fallen(self, mode: Mode, segments: Indices, taus: Array, zetas: Array, start: list[Array]) -> Flags:
        """Which margins do not hold from the start."""
        flow, margins, rates = start
        bends = np.zeros_like(rates)
        close = np.flatnonzero(bends_decide(margins, rates).any(axis=1))
        if close.size:
            later = self._point(mode, segments[close], taus[close] + LOOK, zetas[close] + LOOK * flow[close])[2]
            bends[close] = (later - rates[close]) / LOOK
        columns = zip(margin_names(mode), margins.T, rates.T, bends.T, strict=True)
        return np.column_stack([falls(*column) for column in columns])

    def _land_at_limits(self, mode: Mode, segments: Indices, ends: Arrivals, moved: Indices) -> None:
        """Where the swing foot touches down at a time limit, this is the event."""
        rows = moved[ends.events[moved] == LIMIT]
        if rows.size:
            _, margins, rates = self._point(mode, segments[rows], ends.times[rows], ends.states[rows])
            ends.events[rows[is_touchdown(margins[:, 0], rates[:, 0])]] = 0

    def _locate(
        self, mode: Mode, segments: Indices, ends: Arrivals, moved: Indices, starts: Array, first: Array
    ) -> Indices:
        """Go from the roots of lifted margins to those of the margins, and tell which of simultaneous events counts.

        Returns the rows whose events are so slow that they are not located in one step of Newton's method.
        """
        rows = moved[ends.events[moved] >= 0]
        if not rows.size:
            return rows
        flow, margins, rates = self._point(mode, segments[rows], ends.times[rows], ends.states[rows])
        fired = np.arange(rows.size), ends.events[rows]
        with np.errstate(divide="ignore", invalid="ignore"):
            shift = -margins[fired] / rates[fired]
        linear = (rates[fired] < 0) & (np.abs(shift) <= NEAR)
        shift = np.where(linear, shift, 0.0)
        ends.times[rows] += shift
        ends.states[rows] += shift[:, None] * flow
        together = coincides(margins + shift[:, None] * rates, rates)
        together[:, 0] &= (first[rows, 0] > EDGE) | (ends.times[rows] > starts[rows] + INSTANT)
        together[fired] = True
        ends.events[rows] = _first(mode, together, LIMIT)
        return rows[~linear]

    def _advance_alone(
        self, mode: Mode, data: Array, time: float, state: Array, limit: float, arrivals: Arrivals, row: int
    ) -> None:
        """One arc by the scalar stepper."""
        arrival = self._alone.advance(mode, data, float(time), state, float(limit))
        arrivals.times[row], arrivals.states[row] = arrival.time, arrival.state
        event = FAILURE if arrival.failure else LIMIT
        arrivals.events[row] = event if arrival.event is None else margin_names(mode).index(arrival.event)

    def _point(self, mode: Mode, segments: Indices, taus: Array, zetas: Array) -> list[Array]:
        """Rates of states, margins and their rates."""
        return self._points[mode](taus[:, None], zetas, self.data[segments])

    def _compiled(self, mode: Mode) -> HeyokaRowMap:
        return HeyokaRowMap(natural_system(self._system).point(mode), {2: self._units.parameters[mode]})

    def _runtime(self, mode: Mode) -> Array:
        """Runtime parameters on every segment of the control; shape (n_segments, n_par)."""
        if mode not in self._constants:
            integrator = batch_integrator(self._system, mode)
            self._constants[mode] = np.array(
                [integrator.values(self._units.parameters[mode], data) for data in self.data]
            )
        return self._constants[mode]


class _Lanes:
    """One pass of arcs through the lanes of a batch integrator."""

    def __init__(self, taylor: Any, constants: Array, limits: Array, arrivals: Arrivals) -> None:
        self._taylor, self._constants, self._limits, self._arrivals = taylor, constants, limits, arrivals
        self._n_events = len(taylor.t_events)
        self._rows = [-1] * LANES
        self._stops = np.zeros(LANES)
        self._counts = [0] * LANES
        self._broken: set[int] = set()

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
            ended = [
                lane
                for lane, (outcome, _) in enumerate(taylor.step_res)
                if self._rows[lane] >= 0 and (int(outcome) != SUCCESS or self._exhausted(lane))
            ]
            for lane in ended:
                self._record(lane, int(taylor.step_res[lane][0]))
            active += sum([self._load(lane, queue) - 1 for lane in ended])

    def _exhausted(self, lane: int) -> bool:
        self._counts[lane] += 1
        return self._counts[lane] > MAX_TAYLOR_STEPS

    def _record(self, lane: int, code: int) -> None:
        """Write down where the arc in a lane ends."""
        row, event, arrivals = self._rows[lane], -code - 1, self._arrivals
        if not 0 <= event < self._n_events:
            event = LIMIT if code == TIME_LIMIT else FAILURE
        arrivals.events[row], state = event, self._taylor.state[:, lane]
        if event == FAILURE and not np.isfinite(state).all():
            self._broken.add(lane)  # nothing is known beyond the start
        else:
            arrivals.times[row], arrivals.states[row] = self._taylor.time[lane], state

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
        for other in self._broken:
            high[other], low[other] = 0.0, 0.0
        self._broken.discard(lane)
        high[lane], low[lane] = time, 0.0
        taylor.set_dtime(high, low)
        taylor.state[:, lane], taylor.pars[:, lane] = state, constants
        taylor.reset_cooldowns(lane)
        self._rows[lane], self._stops[lane], self._counts[lane] = row, stop, 0
        return int(row >= 0)


def _first(mode: Mode, flags: Flags, otherwise: int) -> Indices:
    """For each row the flagged margin that comes first by priority; shape (n,)."""
    order = np.argsort([priority(name) for name in margin_names(mode)])
    first = order[np.argmax(flags[:, order], axis=1)]
    return np.where(flags.any(axis=1), first, otherwise)
