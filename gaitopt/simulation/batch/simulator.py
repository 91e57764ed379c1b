"""One step of thousands of states: the hybrid simulator with arrays in place of numbers.

The rules are those of ``Simulator``. All states that are in the same mode go through their next arc together, then
all with the same event through what follows, until every step has ended.
"""

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.gait import Ending
from gaitopt.mechanics import CONTACTS, ONSETS, Dynamics, Mode, margin_names
from gaitopt.simulation.batch.resolver import BatchResolver, Landing
from gaitopt.simulation.batch.stepper import HeyokaBatch
from gaitopt.simulation.batch.steps import ENDINGS, BatchSteps, base, max_phases
from gaitopt.simulation.contact_resolver import CANNOT_SLIP
from gaitopt.simulation.events import AT_REST
from gaitopt.simulation.natural import units
from gaitopt.simulation.simulator import FATAL, MAX_STEP_TIME, MAX_SWITCHES
from gaitopt.simulation.stepper import Arrivals

Codes = NDArray[np.int64]
Indices = NDArray[np.intp]


class BatchSimulator:
    """Simulates steps of many states of one system at fixed parameters.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    max_step_time, max_switches : as in ``Simulator``.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        *,
        max_step_time: float | None = None,
        max_switches: int = MAX_SWITCHES,
    ) -> None:
        self.system = system = dynamics.system
        self._max_switches = max_switches
        self._stepper, self._resolver = HeyokaBatch(dynamics), BatchResolver(dynamics)
        self._units, self._modes = units(dynamics), system.walker.modes()
        longest = MAX_STEP_TIME * self._units.time if max_step_time is None else max_step_time
        limit = min(longest, system.control.horizon)
        self._ends = np.array([*(t for t in system.control.breakpoints if t < limit), limit])

    def step(self, states: Array) -> BatchSteps:
        """Simulate one step from each of the states just after an impact, shape (n, n_z)."""
        motion = _Motion(states, self.system.n_shape, AT_REST * self._units.speed, self._modes)
        slips = motion.states[:, -1] != 0
        self._choose_at_rest(motion, np.flatnonzero(~slips))
        if self.system.walker.massless_feet:
            motion.end(np.flatnonzero(slips), CANNOT_SLIP.ending)
        while (going := np.flatnonzero(motion.endings < 0)).size:
            modes = motion.modes[going]
            for code in np.unique(modes):
                self._advance(motion, code, going[modes == code])
        return BatchSteps(
            states=motion.states,
            endings=motion.endings,
            times=motion.times,
            step_lengths=motion.step_lengths,
            phases=motion.phases,
            impacts=motion.impacts,
        )

    def _advance(self, motion: "_Motion", code: int, rows: Indices) -> None:
        """One arc of the given rows, all in the mode with this code, and what follows."""
        mode, segments = self._modes[code], motion.segments[rows]
        arrivals = self._stepper.advance(mode, segments, motion.times[rows], motion.states[rows], self._ends[segments])
        motion.arrive(rows, code, arrivals)
        names = np.array([*margin_names(mode), "failure", "limit"])[arrivals.events]
        for name in np.unique(names):
            self._follow(motion, mode, name, rows[names == name])

    def _follow(self, motion: "_Motion", mode: Mode, event: str, rows: Indices) -> None:
        """What comes after the same event in the given rows, all in the same mode."""
        if event == "failure":
            motion.end(rows, Ending.NUMERICAL)
        elif event == "limit":
            self._pass_breakpoint(motion, rows)
        elif event in FATAL and not (event == "normal_force" and self.system.walker.flies):
            motion.end(rows, FATAL[event].ending)
        elif event == "touchdown":
            motion.land(rows, self._resolver.land(motion.states[rows]))
        else:
            self._switch(motion, mode, event, rows)

    def _switch(self, motion: "_Motion", mode: Mode, event: str, rows: Indices) -> None:
        motion.switches[rows] += 1
        chattering = motion.switches[rows] > self._max_switches
        motion.end(rows[chattering], Ending.CHATTERING)
        rows = rows[~chattering]
        if event == "normal_force":
            motion.modes[rows] = self._modes.index(mode.with_contact(Mode.FLIGHT))
        elif event in mode.off:
            motion.modes[rows] = self._modes.index(mode.with_next(event))
            self._choose_at_rest(motion, rows if mode.sticks else rows[:0])
        elif event in mode.free:
            self._lock(motion, mode, event, rows)
        elif event in ONSETS and self.system.walker.massless_feet:
            motion.end(rows, CANNOT_SLIP.ending)
        elif event in ONSETS:
            motion.modes[rows] = self._modes.index(mode.with_contact(ONSETS[event]))
        else:
            motion.states[rows, -1] = 0.0
            self._choose_at_rest(motion, rows)

    def _lock(self, motion: "_Motion", mode: Mode, stop: str, rows: Indices) -> None:
        """A stop locks in the given rows."""
        modes, states, endings = self._resolver.strike(mode, stop, motion.states[rows])
        motion.modes[rows], motion.states[rows] = modes, states
        motion.endings[rows[endings > 0]] = endings[endings > 0]
        self._choose_at_rest(motion, rows[(endings == 0) & self._sticks(modes)])

    def _pass_breakpoint(self, motion: "_Motion", rows: Indices) -> None:
        last = motion.segments[rows] == len(self._ends) - 1
        motion.end(rows[last], Ending.NO_TOUCHDOWN)
        rows = rows[~last]
        motion.segments[rows] += 1
        self._choose_at_rest(motion, rows[self._sticks(motion.modes[rows])])

    def _sticks(self, codes: Codes) -> NDArray[np.bool_]:
        return codes % len(self.system.walker.contacts()) == CONTACTS.index(Mode.STICK)

    def _choose_at_rest(self, motion: "_Motion", rows: Indices) -> None:
        stops = motion.modes[rows] // len(self.system.walker.contacts())
        for k in np.unique(stops):
            own = rows[stops == k]
            data = self._stepper.data[motion.segments[own]]
            modes, endings = self._resolver.mode_at_rest(k, motion.times[own], motion.states[own], data)
            motion.modes[own] = modes
            motion.endings[own[endings > 0]] = endings[endings > 0]


class _Motion:
    """Where all the states have got to; an ending of -1 means that the motion goes on."""

    def __init__(self, states: Array, n_x: int, at_rest: float, modes: tuple[Mode, ...]) -> None:
        n = len(states)
        self._n_x, self._base, self._max_phases = n_x, base(modes), max_phases(modes)
        self.states = np.array(states, dtype=float)
        self.states[:, n_x] = 0.0
        self.states[np.abs(self.states[:, -1]) <= at_rest, -1] = 0.0
        self.times, self.step_lengths = np.zeros(n), np.full(n, np.nan)
        self.segments, self.switches = np.zeros(n, dtype=np.intp), np.zeros(n, dtype=np.intp)
        slips = CONTACTS.index(Mode.SLIP_FORWARD), CONTACTS.index(Mode.SLIP_BACKWARD)
        dx = self.states[:, -1]
        self.modes = np.select([dx > 0, dx < 0], slips, default=CONTACTS.index(Mode.STICK))  # with all stops free
        self.endings, self.impacts = np.full(n, -1), np.full(n, -1)
        self.phases, self._n_phases = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.intp)

    def arrive(self, rows: Indices, code: int, arrivals: Arrivals) -> None:
        """Record arcs in one mode; an arc across a breakpoint continues its phase, one without duration is none."""
        new = rows[(arrivals.times > self.times[rows]) & (self.phases[rows] % self._base != code + 1)]
        self._n_phases[new] += 1
        self.phases[new] = np.where(self._n_phases[new] > self._max_phases, 0, self.phases[new] * self._base + code + 1)
        self.times[rows], self.states[rows] = arrivals.times, arrivals.states

    def end(self, rows: Indices, ending: Ending) -> None:
        """End the motion of the given rows."""
        self.endings[rows] = ENDINGS.index(ending)

    def land(self, rows: Indices, landing: Landing) -> None:
        """End steps by their impacts."""
        self.endings[rows], self.impacts[rows] = landing.endings, landing.modes
        self.states[rows], self.step_lengths[rows] = landing.states, landing.step_lengths
