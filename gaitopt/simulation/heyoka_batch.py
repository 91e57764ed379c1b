"""One step of many states at once, on heyoka: the hybrid simulator with arrays instead of numbers.

The simulator repeats two operations until every step has ended: it integrates all states of one mode over their next
arc, and it applies an event to all states whose arc ended with it. The rules are those of ``events``,
``contact_resolver`` and ``simulator``; the table of transitions is the same. Arcs are integrated in the lanes of
heyoka's batch integrators. Every lane has its own time, step length and events; when its arc ends, the next state is
loaded into it. Clear cases of a lone foot are decided for all states at once. ``ContactResolver`` decides the other
cases one by one: those at an edge, those without exactly one consistent candidate, and those of named contacts. The
result of a state does not depend on the other states, not even in its last bit.

This module needs heyoka.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import heyoka as hy
import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.gait.trajectory import ImpactRecord
from gaitopt.model.buffered import RowMap
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import FOOT, SWING_FOOT, Mode
from gaitopt.model.section import CLOCK, TOUCHDOWN
from gaitopt.model.transitions import Ending, Transition, grounded
from gaitopt.simulation.clear_cases import is_at_edge, is_within_cone
from gaitopt.simulation.contact_resolver import ContactResolver, Termination
from gaitopt.simulation.engine import MAX_ARC_STEPS
from gaitopt.simulation.events import (
    AT_REST,
    INSTANT,
    LOOK_AHEAD,
    NEAR,
    bends_decide,
    coincides,
    falls_at_limit,
    falls_at_start,
    is_armed,
    lift,
    priority,
)
from gaitopt.simulation.heyoka_code import LANES, HeyokaRowMap, Integrator, integrator
from gaitopt.simulation.heyoka_stepper import HeyokaStepper
from gaitopt.simulation.natural import NaturalDynamics
from gaitopt.simulation.outcomes import ENDINGS, NONE, Codes, StepOutcomes, max_phases
from gaitopt.simulation.simulator import MAX_SWITCHES, accumulation, segment_ends

Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]

LIMIT, FAILURE = -1, -2
"""Codes of arcs that end at their time limit, or because the integrator cannot continue."""
TIME_LIMIT = int(hy.taylor_outcome.time_limit)
UNFINISHED = int(hy.taylor_outcome.success), int(hy.taylor_outcome.step_limit)
"""Outcomes of lanes whose arcs have not ended: heyoka stops all lanes if one ends, or after ``STEPS_AT_ONCE``."""
MOST_RESOLVERS = 64
"""Largest number of resolvers in the cache, which has one for every combination of tiles."""
STEPS_AT_ONCE = 500
"""Lanes are examined after this many integration steps, even if none has ended; an arc of a walk takes tens."""


class BatchSimulator:
    """Simulates steps of many states of one system at fixed parameters.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    max_switches : largest number of mode switches within a step.
    """

    def __init__(self, dynamics: Dynamics, *, max_switches: int = MAX_SWITCHES) -> None:
        self.dynamics, self.system = dynamics, dynamics.system
        self._table, self._modes = dynamics.system.transitions, dynamics.system.walker.modes()
        self._arcs, self._resolver = BatchArcs(dynamics), BatchResolver(dynamics)
        self._max_switches, self._ends = max_switches, np.array(segment_ends(dynamics))

    def step(self, states: Array, p: Array | None = None, first: Array | None = None, n: int = 0) -> StepOutcomes:
        """Simulate one step from each of the states just after an impact, shape (n, n_z).

        Parameters
        ----------
        p : ndarray, shape (n, n_p) - parameters of every state, only for walkers that stand on one foot; by default
            those of the system. Only the friction, height and slope of the tiles may differ from state to state.
            Feedback from step to step corrects them.
        first : ndarray, shape (n, n_z) - states in which the cycles began, from which this feedback follows; by default
            ``states``.
        n : number of the step.
        """
        correction = self.system.correction
        if correction is not None:
            p = np.tile(self.dynamics.p, (len(states), 1)) if p is None else p
            p = correction(p, states if first is None else first, n)
        motions = _Motions(states, self.dynamics, p)
        motions.states, modes, endings, landings = self._resolver.start(motions.states)
        motions.choose(np.arange(len(states)), modes, endings)
        starts = endings == 0
        for (mode, guard), landing in landings.items():
            starts[landing] = False
            self._strike(motions, mode, self._table.of(mode)[guard], np.array(landing))
        self._continue(motions, np.flatnonzero(starts))
        while (running := np.flatnonzero(motions.endings < 0)).size:
            codes = motions.modes[running]
            for code in np.unique(codes):
                mode, rows = self._modes[code], running[codes == code]
                segments = motions.segments[rows]
                arrivals = self._arcs.advance(
                    mode, segments, motions.times[rows], motions.states[rows], self._ends[segments], motions.p_of(rows)
                )
                motions.arrive(rows, code, arrivals)
                for event in np.unique(arrivals.events):
                    self._follow(motions, mode, event, rows[arrivals.events == event])
        return motions.outcomes()

    def _follow(self, motions: "_Motions", mode: Mode, event: int, rows: Indices) -> None:
        """Continue the given rows, all in the same mode, after the same event."""
        if event == FAILURE:
            motions.end(rows, Ending.NUMERICAL)
            return
        if event == LIMIT:  # a segment of the control has ended
            last = motions.segments[rows] == len(self._ends) - 1
            if self.system.cycle_end == CLOCK:
                self._land(motions, mode, self._table.between(mode, None), rows[last])
            else:
                motions.end(rows[last], Ending.NO_TOUCHDOWN)
            motions.segments[rows[~last]] += 1
            self._continue(motions, rows[~last])
            return
        transition = [*self._table.of(mode).values()][event]
        if transition.ending is not None:
            motions.end(rows, transition.ending)
            return
        if transition.ends_step:
            self._land(motions, mode, transition, rows)
            return
        if transition.at_rest:
            motions.states[rows] = self._resolver.settled(mode, motions.states[rows])
        rows = motions.switch(rows, self._max_switches, strikes=transition.reset is not None)
        if transition.reset is not None:
            self._strike(motions, mode, transition, rows)
        else:
            self._decide(motions, rows, transition)

    def _land(self, motions: "_Motions", mode: Mode, transition: Transition, rows: Indices) -> None:
        """End the steps of the given rows."""
        impacts, endings, states, step_lengths = self._resolver.land(
            mode, transition, motions.states[rows], motions.p_of(rows)
        )
        motions.impacts[rows], motions.endings[rows] = impacts, endings
        motions.states[rows], motions.step_lengths[rows] = states, step_lengths

    def _strike(self, motions: "_Motions", mode: Mode, transition: Transition, rows: Indices) -> None:
        """Continue the given rows after the impact of a contact or a stop within the step."""
        modes, endings, motions.states[rows] = self._resolver.strike(
            mode, transition, motions.states[rows], motions.p_of(rows)
        )
        motions.choose(rows, modes, endings)
        assert transition.reset is not None
        motions.swapped[rows] = transition.reset.swaps
        self._continue(motions, rows[endings == 0])

    def _continue(self, motions: "_Motions", rows: Indices) -> None:
        """Continue the given rows at the start of a step, or after a jump of the torques, where forces decide."""
        codes = motions.modes[rows]
        for code in np.unique(codes):
            self._decide(motions, rows[codes == code], self._table.at_breakpoint(self._modes[code]))

    def _decide(self, motions: "_Motions", rows: Indices, transition: Transition) -> None:
        """Continue the given rows after an event without a reset."""
        if transition.is_decided:
            motions.modes[rows] = self._modes.index(transition.candidates[0])
            return
        modes, endings = self._resolver.mode_at_rest(
            transition.candidates, motions.times[rows], motions.states[rows], motions.segments[rows],
            motions.p_of(rows),
        )  # fmt: skip
        motions.choose(rows, modes, endings)


@dataclass(frozen=True, slots=True, kw_only=True)
class Arrivals:
    """Ends of arcs.

    Attributes
    ----------
    times : ndarray, shape (n,) - time since the last impact [s].
    states : ndarray, shape (n, n_z) - state at this time.
    events : ndarray, shape (n,) - index in ``margin_names`` of the margin that fell to zero, ``LIMIT`` or ``FAILURE``.
    """

    times: Array
    states: Array
    events: Indices


class _Motions:
    """The motions of one call of ``BatchSimulator.step``: the state, mode and history of every row.

    A motion whose ending is -1 has not ended.
    """

    def __init__(self, states: Array, dynamics: Dynamics, p: Array | None) -> None:
        n, system, self._p = len(states), dynamics.system, p
        self._names, self._all_modes = system.state_names, system.walker.modes()
        self._unit, self._strikes = dynamics.scales.time, defaultdict[int, list[float]](list)
        self.states = np.array(states, dtype=float)
        self.states[:, system.n_shape] = 0.0
        self.times, self.step_lengths = np.zeros(n), np.full(n, np.nan)
        self.segments, self.switches = np.zeros(n, dtype=np.intp), np.zeros(n, dtype=np.intp)
        self.modes = np.full(n, NONE)
        self.endings, self.impacts = np.full(n, -1), np.full(n, NONE)
        self.phases, self._n_phases = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.intp)
        self.swapped = np.zeros(n, dtype=np.bool_)  # whether a landing has just swapped the feet

    def p_of(self, rows: Indices) -> Array | None:
        """Parameters of the given rows; None if all rows have those of the system."""
        return None if self._p is None else self._p[rows]

    def arrive(self, rows: Indices, code: int, arrivals: Arrivals) -> None:
        """Record arcs in one mode. A phase continues across a breakpoint, and an empty arc is not a phase."""
        base, most = len(self._all_modes) + 1, max_phases(self._all_modes)
        moved = arrivals.times > self.times[rows]
        new = rows[moved & ((self.phases[rows] % base != code + 1) | self.swapped[rows])]
        self.swapped[rows[moved]] = False
        self._n_phases[new] += 1
        self.phases[new] = np.where(self._n_phases[new] > most, 0, self.phases[new] * base + code + 1)
        self.times[rows], self.states[rows] = arrivals.times, arrivals.states

    def switch(self, rows: Indices, most: int, *, strikes: bool) -> Indices:
        """Record an event within the steps of the given rows, and end motions that already had ``most`` events.

        Parameters
        ----------
        strikes : whether the event is the impact of a contact or a stop; motions whose impacts accumulate are ended.

        Returns
        -------
        rows : the rows whose motions continue.
        """
        for row in rows.tolist() if strikes else ():
            self._strikes[row].append(float(self.times[row]))
        is_last = self.switches[rows] >= most
        self.switches[rows] += 1
        ended = is_last.copy()
        self.end(rows[is_last], Ending.CHATTERING)
        for k, row in enumerate(rows.tolist()) if self._strikes else ():
            impacts, last = self._strikes.get(row, ()), bool(is_last[k])
            if accumulation(impacts, float(self.times[row]), is_last=last, unit=self._unit) < np.inf:
                self.end(rows[k : k + 1], Ending.IMPACTS_ACCUMULATE)
                ended[k] = True
        return rows[~ended]

    def end(self, rows: Indices, ending: Ending) -> None:
        """End the motion of the given rows."""
        self.endings[rows] = ENDINGS.index(ending)

    def choose(self, rows: Indices, modes: Codes, endings: Codes) -> None:
        """Continue in ``modes``; end the motions of rows with a positive ending."""
        self.modes[rows] = modes
        self.endings[rows[endings > 0]] = endings[endings > 0]

    def outcomes(self) -> StepOutcomes:
        """The steps, after all have ended."""
        return StepOutcomes(
            names=self._names,
            states=self.states,
            endings=self.endings,
            times=self.times,
            step_lengths=self.step_lengths,
            phases=self.phases,
            impacts=self.impacts,
            modes=self._all_modes,
        )


class BatchResolver:
    """Decides about the feet of many states of one system at fixed parameters."""

    def __init__(self, dynamics: Dynamics) -> None:
        self._system, self._natural = dynamics.system, NaturalDynamics(dynamics)
        self._one_by_one = ContactResolver(dynamics)
        self._clear, self._slowest = self._one_by_one.clear, AT_REST * dynamics.scales.speed
        system, p = dynamics.system, dynamics.p
        self._p = p
        self._modes, self._data = system.walker.modes(), _segment_data(dynamics)
        self._after_impact = system.walker.foot_modes()
        self._ground = tuple(mode.contact for mode in system.transitions.landed)
        self._friction = dynamics.contact_friction.get(FOOT, dynamics.static_friction)
        self._dynamics, self._on_tiles = dynamics, dict[bytes, ContactResolver]()
        self._impacts: dict[tuple[tuple[str, ...], tuple[str, ...]], HeyokaRowMap] = {}
        self._pushes: dict[tuple[tuple[str, ...], tuple[str, ...]], HeyokaRowMap] = {}
        self._rests: dict[tuple[Mode, ...], HeyokaRowMap] = {}

    def start(self, states: Array) -> tuple[Array, Codes, Codes, dict[tuple[Mode, str], list[int]]]:
        """The modes in which steps start.

        Returns
        -------
        states : ndarray, shape (n, n_z) - the states; the slip velocity of a lone foot is zero if it only consists of
            rounding errors.
        modes, endings : ndarrays, shape (n,) - modes, and endings of motions that cannot start.
        landings : rows in which a contact on the ground comes down, by the mode and the guard of the contact.
        """
        n, landings = len(states), defaultdict[tuple[Mode, str], list[int]](list)
        modes, endings = np.full(n, NONE), np.zeros(n, dtype=np.int64)
        if self._clear is not None and self._system.cycle_end == TOUCHDOWN:
            states = states.copy()
            states[np.abs(states[:, -1]) <= self._slowest, -1] = 0.0
            stick, *slips = (self._modes.index(mode) for mode in self._one_by_one.system.transitions.landed)
            dx = states[:, -1]
            modes = np.select([dx > 0, dx < 0], slips or [NONE, NONE], default=stick)
            endings[modes == NONE] = ENDINGS.index(Ending.PAINLEVE)
            return states, modes, endings, landings
        for k, state in enumerate(states):
            if not np.isfinite(state).all():
                endings[k] = ENDINGS.index(Ending.NUMERICAL)
                continue
            began = self._one_by_one.start(state, anywhere=False)
            if isinstance(began, Termination):
                endings[k] = ENDINGS.index(began.ending)
                continue
            mode, lands = began
            modes[k] = self._modes.index(mode)
            if lands is not None:
                landings[mode, lands.guard].append(k)
        return states, modes, endings, landings

    def settled(self, mode: Mode, states: Array) -> Array:
        """States in which contacts that have come to rest in a mode have slip velocities of exactly zero."""
        if self._clear is None:
            return np.array([self._one_by_one.settled(state, stopped=mode) for state in states]).reshape(states.shape)
        states[:, -1] = 0.0
        return states

    def _resolver(self, p: Array | None, row: int) -> ContactResolver:
        """The resolver for one state, with the parameters of its row."""
        if p is None:
            return self._one_by_one
        key = p[row].tobytes()
        if key not in self._on_tiles:
            if len(self._on_tiles) >= MOST_RESOLVERS:
                self._on_tiles.clear()
            self._on_tiles[key] = ContactResolver(Dynamics(self._system, p[row]))
        return self._on_tiles[key]

    def mode_at_rest(
        self, candidates: tuple[Mode, ...], times: Array, states: Array, segments: Indices, p: Array | None = None
    ) -> tuple[Codes, Codes]:
        """Modes of feet at rest, and endings of motions without a consistent mode; both of shape (n,).

        Parameters
        ----------
        candidates : possible modes, the same for all states; stick first.
        times : ndarray, shape (n,) - times since the last impact [s].
        states : ndarray, shape (n, n_z) - states at these times.
        segments : ndarray, shape (n,) - segments of the control.
        p : see ``BatchSimulator.step``.
        """
        modes, clear = self._clear_modes(candidates, times, states, segments, p)
        endings = np.zeros_like(modes)
        for k in np.flatnonzero(~clear):
            decision = self._resolver(p, int(k)).mode_at_rest(candidates, float(times[k]), states[k], int(segments[k]))
            if isinstance(decision, Termination):
                modes[k], endings[k] = NONE, ENDINGS.index(decision.ending)
            else:
                modes[k] = self._modes.index(decision)
        return modes, endings

    def _clear_modes(
        self, candidates: tuple[Mode, ...], times: Array, states: Array, segments: Indices, p: Array | None
    ) -> tuple[Codes, Flags]:
        """Modes of a lone foot at rest, and whether each one is clear; see ``mode_at_rest``."""
        n = times.size
        if self._clear is None or not n:
            return np.full(n, NONE), np.zeros(n, dtype=np.bool_)
        stuck, *slips = grounded(candidates)
        fixed = {2: self._natural.parameters(stuck), 4: self._natural.margins([stuck, *slips][-1])}
        if candidates not in self._rests:
            self._rests[candidates] = HeyokaRowMap(self._natural.functions.rest(stuck, slips), fixed)
        taus, zetas = times / self._natural.time, states / self._natural.state
        of_rows = None if p is None else [_with(p, fixed[2]), np.tile(fixed[4], (n, 1))]
        arguments = taus[:, None], zetas, self._data[segments]
        _, margins, rates, *slipping = self._rests[candidates](*arguments, fixed=of_rows)
        possible, clear = self._clear.at_rest(margins.T, rates.T, [slip.T for slip in slipping])
        return self._modes.index(candidates[0]) + np.argmax(possible, axis=0), clear

    def strike(
        self, mode: Mode, transition: Transition, states: Array, p: Array | None = None
    ) -> tuple[Codes, Codes, Array]:
        """Modes just after a contact lands or a stop locks, endings if no impact is possible, and states after it."""
        modes, endings, after = np.zeros(len(states), dtype=np.int64), np.zeros(len(states), np.int64), states.copy()
        for k, state in enumerate(states):
            struck = self._resolver(p, int(k)).strike(mode, transition, state)
            if isinstance(struck, Termination):
                modes[k], endings[k] = NONE, ENDINGS.index(struck.ending)
            else:
                modes[k], after[k] = self._modes.index(struck[0]), struck[1]
        return modes, endings, after

    def land(
        self, mode: Mode, transition: Transition, states: Array, p: Array | None = None
    ) -> tuple[Codes, Codes, Array, Array]:
        """Impacts at touchdown, endings if no impact is possible, states after the impacts and step lengths [m]."""
        impacts, clear, after, step_lengths = self._clear_impacts(mode, states, p)
        endings = np.zeros_like(impacts)
        for k in np.flatnonzero(~clear):
            decision = self._resolver(p, int(k)).impact(mode, transition, states[k])
            if isinstance(decision, ImpactRecord):
                impacts[k] = self._after_impact.index(decision.mode)
                after[k], step_lengths[k] = decision.state, decision.step_length
            else:
                impacts[k], endings[k] = NONE, ENDINGS.index(decision.ending)
                after[k], step_lengths[k] = states[k], np.nan
        return impacts, endings, after, step_lengths

    def _clear_impacts(self, mode: Mode, states: Array, p: Array | None) -> tuple[Codes, Flags, Array, Array]:
        """Impacts of a lone foot, whether each is clear, states after them and step lengths [m]; see ``land``."""
        (n, n_z), before = states.shape, (mode.touching, mode.locked)
        if self._clear is None or self._system.cycle_end != TOUCHDOWN:
            return np.full(n, NONE), np.zeros(n, dtype=np.bool_), states.copy(), np.full(n, np.nan)
        if before not in self._impacts:
            function = self._system.impacts(mode, *map(self._system.walker.swapped, self._ground))
            self._impacts[before] = HeyokaRowMap(function, {1: self._p})
        of_rows = None if p is None else [p]
        columns, approach = self._impacts[before](states, fixed=of_rows)
        candidates = columns.reshape(n, len(self._ground), -1)
        values = candidates[:, :, n_z:].transpose(1, 2, 0)
        landing, standing = self._static(SWING_FOOT, p), self._static(FOOT, p)
        consistent, clear = self._clear.impact(self._ground, values, approach[:, 0], landing)
        impacts = np.argmax(consistent, axis=0)
        after, x = candidates[np.arange(n), impacts, :n_z], self._system.n_shape
        step_lengths = after[:, x].copy()
        after[:, x] = 0.0
        if self._system.walker.pushes:
            if before not in self._pushes:
                self._pushes[before] = HeyokaRowMap(self._system.push(mode), {1: self._p})
            p_t, p_n = self._pushes[before](states, fixed=of_rows)[0].T
            friction = self._friction if standing is None else standing
            clear &= is_within_cone(p_t, p_n, friction) & ~is_at_edge(p_t, p_n, friction)
        return impacts, clear, after, step_lengths

    def _static(self, contact: str, p: Array | None) -> Array | None:
        """Static coefficient of a contact in every row, shape (n,); None if it is that of the system in all rows."""
        if p is None:
            return None
        coefficients = self._system.contact_coefficients(p.T)  # on tiles they differ from contact to contact
        static, _, _ = coefficients.get(contact) or coefficients[FOOT]
        return np.asarray(static)


class BatchArcs:
    """Integrates arcs of many states of one system at fixed parameters.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self._natural, self._table = NaturalDynamics(dynamics), dynamics.system.transitions
        self._points: dict[Mode, HeyokaRowMap] = {}
        self._integrators: dict[Mode, tuple[Integrator, Array]] = {}
        self._single, self._data = HeyokaStepper(dynamics), _segment_data(dynamics)
        self._constants: dict[Mode, RowMap] = {}
        self._descent: HeyokaRowMap | None = None

    def advance(
        self, mode: Mode, segments: Indices, times: Array, states: Array, limits: Array, p: Array | None = None
    ) -> Arrivals:
        """Integrate arcs in one mode to their first events or time limits.

        Parameters
        ----------
        segments : ndarray, shape (n,) - segments of the control.
        times, limits : ndarray, shape (n,) - times since the last impact [s].
        states : ndarray, shape (n, n_z) - states at ``times``.
        p : see ``BatchSimulator.step``.
        """
        arrivals = self._advance(mode, segments, times, states, limits, p)
        names, system = self._table.margin_names(mode), self._natural.system
        if not system.uneven or TOUCHDOWN not in names or p is None:
            return arrivals
        self._descent = self._descent or HeyokaRowMap(system.descent, {1: p[0]})
        rows = np.arange(len(states))
        while rows.size:  # see ``ground.comes_down``
            rows = rows[arrivals.events[rows] == names.index(TOUCHDOWN)]
            if rows.size:
                rates = self._descent(arrivals.states[rows], fixed=[p[rows]])[0]
                rows = rows[~(rates < 0).all(axis=1)]
            if rows.size:
                later = self._advance(
                    mode, segments[rows], arrivals.times[rows], arrivals.states[rows], limits[rows], p[rows]
                )
                for name in ("times", "states", "events"):
                    getattr(arrivals, name)[rows] = getattr(later, name)
        return arrivals

    @np.errstate(all="ignore")  # forces are infinite if the equations are singular
    def _advance(
        self, mode: Mode, segments: Indices, times: Array, states: Array, limits: Array, p: Array | None
    ) -> Arrivals:
        natural, names = self._natural, self._table.margin_names(mode)
        taus, zetas = times / natural.time, states / natural.state
        flow, margins, rates = self._point(mode, segments, taus, zetas, p)
        bends = np.zeros_like(rates)
        close = np.flatnonzero(bends_decide(margins, rates).any(axis=1))
        if close.size:
            ahead = taus[close] + LOOK_AHEAD, zetas[close] + LOOK_AHEAD * flow[close]
            later = self._point(mode, segments[close], *ahead, _rows(p, close))
            bends[close] = (later[2] - rates[close]) / LOOK_AHEAD
        violated = np.column_stack(
            [falls_at_start(*column) for column in zip(names, margins.T, rates.T, bends.T, strict=True)]
        )
        ends = Arrivals(times=taus.copy(), states=zetas, events=_first_by_priority(names, violated))
        moved = np.flatnonzero(~violated.any(axis=1) & (times < limits))
        if moved.size:
            compiled, constants = self._integrator(mode)
            lifts = [lift(*column) for column in zip(names, margins.T, rates.T, strict=True)]
            if p is None:
                of_rows = constants[segments]
            else:
                of_rows = self._constants[mode](_with(p, natural.parameters(mode)), self._data[segments])[0]
            pars = np.column_stack([of_rows, *lifts])
            speeds = np.nan_to_num(np.abs(flow[moved]).max(axis=1), nan=np.inf)
            _Lanes(compiled.taylor, pars, limits / natural.time, ends, moved, moved[np.argmin(speeds)]).run()
        slow = self._locate(mode, segments, ends, moved, taus, margins, p)
        arrivals = Arrivals(times=times.copy(), states=states.copy(), events=ends.events)
        latest = np.fmax(ends.times[moved] * natural.time, times[moved])
        arrivals.times[moved] = np.where(ends.events[moved] == LIMIT, limits[moved], latest)
        arrivals.states[moved] = ends.states[moved] * natural.state
        at_limit = np.flatnonzero(ends.events == LIMIT)
        if at_limit.size:
            end = self._point(mode, segments[at_limit], ends.times[at_limit], ends.states[at_limit], _rows(p, at_limit))
            falling = [falls_at_limit(*column) for column in zip(names, end[1].T, end[2].T, strict=True)]
            ends.events[at_limit] = _first_by_priority(names, np.column_stack(falling))
        for k in slow:
            single = self._single if p is None else HeyokaStepper(Dynamics(natural.system, p[k]))
            arrival = single.advance(mode, int(segments[k]), float(times[k]), states[k], float(limits[k]))
            arrivals.times[k], arrivals.states[k] = arrival.time, arrival.state
            event = FAILURE if arrival.failure else LIMIT
            arrivals.events[k] = event if arrival.event is None else names.index(arrival.event)
        return arrivals

    def _locate(
        self, mode: Mode, segments: Indices, ends: Arrivals, moved: Indices, starts: Array, first: Array,
        p: Array | None,
    ) -> Indices:  # fmt: skip
        """Move from the roots of lifted margins to those of the margins, and rank simultaneous events.

        Parameters
        ----------
        starts, first : ndarrays, shapes (n,) and (n, n_margins) - times and margins at the starts of the arcs.

        Returns
        -------
        slow : rows whose margins fall so slowly that one Newton step does not locate the root.
        """
        rows, names = moved[ends.events[moved] >= 0], self._table.margin_names(mode)
        if not rows.size:
            return rows
        flow, margins, rates = self._point(mode, segments[rows], ends.times[rows], ends.states[rows], _rows(p, rows))
        fired = np.arange(rows.size), ends.events[rows]
        shift = -margins[fired] / rates[fired]
        linear = (rates[fired] < 0) & (np.abs(shift) <= NEAR)
        shift = np.where(linear, shift, 0.0)
        ends.times[rows] += shift
        ends.states[rows] += shift[:, None] * flow
        armed = np.column_stack([is_armed(*column) for column in zip(names, first[rows].T, strict=True)])
        armed |= (ends.times[rows] > starts[rows] + INSTANT)[:, None]
        simultaneous = coincides(margins + shift[:, None] * rates, rates) & armed
        simultaneous[fired] = True
        ends.events[rows] = _first_by_priority(names, simultaneous)
        return rows[~linear]

    def _point(self, mode: Mode, segments: Indices, taus: Array, zetas: Array, p: Array | None) -> list[Array]:
        """Rates of the states, margins, and rates of the margins, in natural units; a row for every state."""
        parameters = self._natural.parameters(mode)
        if mode not in self._points:
            self._points[mode] = HeyokaRowMap(self._natural.functions.point(mode), {2: parameters})
        of_rows = None if p is None else [_with(p, parameters)]
        return self._points[mode](taus[:, None], zetas, self._data[segments], fixed=of_rows)

    def _integrator(self, mode: Mode) -> tuple[Integrator, Array]:
        """The integrator of a mode, and its runtime parameters on every segment; shape (n_segments, n_par)."""
        if mode not in self._integrators:
            compiled = integrator(self._natural.functions.arc(mode), lanes=LANES)
            parameters = self._natural.parameters(mode)
            self._integrators[mode] = compiled, np.array([compiled.values(parameters, data) for data in self._data])
            self._constants[mode] = RowMap(compiled.constants)
        return self._integrators[mode]


class _Lanes:
    """Arcs that pass through the lanes of a batch integrator.

    A lane without an arc integrates from the start of the row ``idle`` again, which is appended as row -1. This motion
    should be slow, because a number that becomes infinite in one lane stops all lanes.
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
        """Integrate the arcs of the rows ``waiting``, and replace their starts in ``arrivals`` by their ends."""
        queue, taylor, rows, counts = iter(self._waiting.tolist()), self._taylor, self._rows, self._counts
        arrivals = self._arrivals
        self._load(range(LANES), queue)
        while max(rows) >= 0:
            # integrate to the time limits, to the first event, or for some steps
            taylor.propagate_until(self._stops, max_steps=min(MAX_ARC_STEPS - max(counts), STEPS_AT_ONCE))
            ended = []
            for lane, (outcome, _, _, steps) in enumerate(taylor.propagate_res):
                counts[lane] += steps
                code = int(outcome)
                # if a motion becomes infinite, heyoka takes steps of no length, which it does not count; in a lane that
                # has arrived, it takes no steps at all
                arrived = taylor.time[lane] >= self._stops[lane]
                is_stuck = outcome == hy.taylor_outcome.step_limit and not steps and not arrived
                if code not in UNFINISHED or counts[lane] >= MAX_ARC_STEPS or is_stuck:
                    if (row := rows[lane]) >= 0:
                        arrivals.times[row], arrivals.states[row] = taylor.time[lane], self._state[lane]
                        arrivals.events[row] = code
                    ended.append(lane)
            if ended:
                self._load(ended, queue)
        # turn heyoka's outcomes into events; if a motion became infinite, only its start is known
        codes = arrivals.events[self._waiting]
        others = np.where(codes == TIME_LIMIT, LIMIT, FAILURE)
        arrivals.events[self._waiting] = np.where((codes < 0) & (codes >= -len(taylor.t_events)), -codes - 1, others)
        for row in self._waiting[~np.isfinite(arrivals.states[self._waiting]).all(axis=1)]:
            arrivals.times[row], arrivals.states[row] = self._times[row], self._states[row]

    def _load(self, lanes: Iterable[int], queue: Iterator[int]) -> None:
        """Put the next arcs into some lanes, in a loop, because a list of indices takes NumPy ten times as long."""
        high, low = (each.copy() for each in self._taylor.dtime)  # the other lanes keep the low part of their time
        for lane in lanes:
            self._rows[lane] = row = next(queue, -1)
            self._counts[lane] = 0
            high[lane], low[lane], self._stops[lane] = self._times[row], 0.0, self._limits[row]
            self._state[lane], self._pars[lane] = self._states[row], self._constants[row]
            self._taylor.reset_cooldowns(lane)
        self._taylor.set_dtime(high, low)


def _rows(p: Array | None, rows: Indices) -> Array | None:
    return None if p is None else p[rows]


def _with(p: Array, parameters: Array) -> Array:
    """Parameters of ``NaturalDynamics`` in every row, shape (n, n_par); ``p`` replaces the parameters of the system."""
    return np.hstack([p, np.tile(parameters[p.shape[1] :], (len(p), 1))])


def _first_by_priority(names: Sequence[str], events: Flags) -> Indices:
    """For each row, the event of highest priority among simultaneous ones, or ``LIMIT`` if none; shape (n,)."""
    order = np.argsort([priority(name) for name in names])
    first = order[np.argmax(events[:, order], axis=1)]
    return np.where(events.any(axis=1), first, LIMIT)


def _segment_data(dynamics: Dynamics) -> Array:
    """Data of all segments of the control; shape (n_segments, n_r)."""
    control = dynamics.system.control
    return np.array([dynamics.system.data(k) for k in range(len(control.breakpoints) + 1)])
