"""Arcs of many states at once, in the lanes of heyoka's batch integrators.

Every lane has its own time, step length and events; where its arc ends, the next state takes its place. What happens
in one lane does not depend on the others, to the last bit. The rules at the start of an arc and at its end are those
of ``events``; inside, all is in natural units.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import heyoka as hy
import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
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
from gaitopt.simulation.heyoka_stepper import LANES, MAX_TAYLOR_STEPS, HeyokaRowMap, HeyokaStepper, batch_integrator
from gaitopt.simulation.natural import natural_system, units
from gaitopt.simulation.stepper import FAILURE, LIMIT, Arrivals, Indices

Flags = NDArray[np.bool_]

TIME_LIMIT = int(hy.taylor_outcome.time_limit)
GOES_ON = int(hy.taylor_outcome.success), int(hy.taylor_outcome.step_limit)
"""Outcomes of lanes that stop only because another one does."""


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

    @np.errstate(all="ignore")  # where the equations are singular, forces are infinite
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
        ends = Arrivals(times=taus.copy(), states=zetas, events=_first(self._names(mode), fallen, LIMIT))
        lifts = [lift(*column) for column in zip(self._names(mode), margins.T, rates.T, strict=True)]
        constants = np.column_stack([self._runtime(mode)[segments], *lifts])
        if moved.size:
            taylor = batch_integrator(self._system, mode).taylor
            speeds = np.nan_to_num(np.abs(start[0][moved]).max(axis=1), nan=np.inf)
            _Lanes(taylor, constants, limits / unit.time, ends, moved, moved[np.argmin(speeds)]).run()
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
        columns = zip(self._names(mode), margins.T, rates.T, bends.T, strict=True)
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
        shift = -margins[fired] / rates[fired]
        linear = (rates[fired] < 0) & (np.abs(shift) <= NEAR)
        shift = np.where(linear, shift, 0.0)
        ends.times[rows] += shift
        ends.states[rows] += shift[:, None] * flow
        together = coincides(margins + shift[:, None] * rates, rates)
        together[:, 0] &= (first[rows, 0] > EDGE) | (ends.times[rows] > starts[rows] + INSTANT)
        together[fired] = True
        ends.events[rows] = _first(self._names(mode), together, LIMIT)
        return rows[~linear]

    def _advance_alone(
        self, mode: Mode, data: Array, time: float, state: Array, limit: float, arrivals: Arrivals, row: int
    ) -> None:
        """One arc by the scalar stepper."""
        arrival = self._alone.advance(mode, data, float(time), state, float(limit))
        arrivals.times[row], arrivals.states[row] = arrival.time, arrival.state
        event = FAILURE if arrival.failure else LIMIT
        arrivals.events[row] = event if arrival.event is None else self._names(mode).index(arrival.event)

    def _names(self, mode: Mode) -> tuple[str, ...]:
        return self._system.transitions.margin_names(mode)

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
    """One pass of arcs through the lanes of a batch integrator.

    Behind the arcs of all rows, as row -1, is that of the row ``idle`` without its length, where lanes rest that have
    nothing left to do. It should be a harmless one: what becomes infinite in a lane stops all of them.
    """

    def __init__(
        self, taylor: Any, constants: Array, limits: Array, arrivals: Arrivals, waiting: Indices, idle: int
    ) -> None:
        self._times, self._limits = ([*each.tolist(), arrivals.times[idle]] for each in (arrivals.times, limits))
        self._states, self._constants = (np.vstack([each, each[idle]]) for each in (arrivals.states, constants))
        self._taylor, self._state, self._pars = taylor, taylor.state.T, taylor.pars.T
        self._arrivals, self._waiting = arrivals, waiting
        self._rows, self._stops, self._counts = [-1] * LANES, [0.0] * LANES, [0] * LANES

    def run(self) -> None:
        """Integrate the arcs of the rows ``waiting``; their ends replace the starts in the arrivals."""
        queue, taylor, rows, counts = iter(self._waiting.tolist()), self._taylor, self._rows, self._counts
        self._load(range(LANES), queue)
        while max(rows) >= 0:
            taylor.propagate_until(self._stops, max_steps=MAX_TAYLOR_STEPS - max(counts))  # or to the first event
            ended = []
            for lane, (outcome, _, _, steps) in enumerate(taylor.propagate_res):
                counts[lane] += steps
                code = int(outcome)
                if code not in GOES_ON or counts[lane] >= MAX_TAYLOR_STEPS:
                    if rows[lane] >= 0:
                        self._record(lane, code)
                    ended.append(lane)
            if ended:
                self._load(ended, queue)
        self._decode()

    def _load(self, lanes: Iterable[int], queue: Iterator[int]) -> None:
        """Put the next arcs into some lanes, one by one, as NumPy takes ten times as long for a list of indices."""
        high, low = (part.copy() for part in self._taylor.dtime)  # the other lanes keep the low part of their time
        for lane in lanes:
            self._rows[lane] = row = next(queue, -1)
            self._counts[lane] = 0
            high[lane], low[lane], self._stops[lane] = self._times[row], 0.0, self._limits[row]
            self._state[lane], self._pars[lane] = self._states[row], self._constants[row]
            self._taylor.reset_cooldowns(lane)
        self._taylor.set_dtime(high, low)

    def _record(self, lane: int, outcome: int) -> None:
        """Write down where the arc in a lane ends."""
        row, arrivals = self._rows[lane], self._arrivals
        arrivals.times[row], arrivals.states[row] = self._taylor.time[lane], self._state[lane]
        arrivals.events[row] = outcome

    def _decode(self) -> None:
        """From heyoka's outcomes to events; of a motion that became infinite nothing is known beyond the start."""
        arrivals, rows = self._arrivals, self._waiting
        codes = arrivals.events[rows]
        others = np.where(codes == TIME_LIMIT, LIMIT, FAILURE)
        arrivals.events[rows] = np.where((codes < 0) & (codes >= -len(self._taylor.t_events)), -codes - 1, others)
        lost = rows[~np.isfinite(arrivals.states[rows]).all(axis=1)]
        for row in lost:
            arrivals.times[row], arrivals.states[row] = self._times[row], self._states[row]


def _first(names: Sequence[str], flags: Flags, otherwise: int) -> Indices:
    """For each row the flagged margin that comes first by priority; shape (n,)."""
    order = np.argsort([priority(name) for name in names])
    first = order[np.argmax(flags[:, order], axis=1)]
    return np.where(flags.any(axis=1), first, otherwise)
