"""Many steps as arrays, with numbers in place of names: modes, endings and the phases of a step have codes.

What the feet of many states do, at rest and at an impact.

The rules are those of ``contact_resolver``. What is plain is decided for all states at once; where anything is out of
the ordinary (an edge, a lost contact, no candidate or several) the state is handed to ``ContactResolver`` by itself.

One step of thousands of states: the hybrid simulator with arrays in place of numbers.

The rules are those of ``Simulator``. All states that are in the same mode go through their next arc together, then
all with the same event through what follows, until every step has ended.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.gait.trajectory import ImpactRecord
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import CONTACTS, Mode
from gaitopt.model.transitions import CONE, Ending, Transition, grounded
from gaitopt.simulation.contact_resolver import (
    ContactResolver,
    Termination,
    comes_down,
    is_at_edge,
    is_consistent_impact,
    is_within_cone,
    stick_comes_first,
)
from gaitopt.simulation.events import AT_REST, EDGE, INSTANT
from gaitopt.simulation.natural import natural_system, units
from gaitopt.simulation.simulator import MAX_STEP_TIME, MAX_SWITCHES, StepOutcome
from gaitopt.simulation.stepper import FAILURE, LIMIT, Arrivals

if TYPE_CHECKING:
    from gaitopt.simulation.heyoka_stepper import HeyokaRowMap

Codes = NDArray[np.int64]

ENDINGS = tuple(Ending)
"""The code of an ending is its index here; ``completed`` is 0. That of a mode is its index in ``Walker.modes()``, which
counts contacts first: that of the contact is its remainder modulo three. An impact has the code of its contact."""
NONE = -1
"""Code of the mode of a foot or an impact that is not there."""
BITS = 62
"""Of the code of the phases of a step, in which each is a digit, 1 + code of the mode; a longer step has code 0."""


def base(modes: Sequence[Mode]) -> int:
    """Base of the codes of phases."""
    return len(modes) + 1


def max_phases(modes: Sequence[Mode]) -> int:
    """Phases that a code holds."""
    return int(BITS / math.log2(base(modes)))


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchSteps:
    """One step of each of n states.

    Attributes
    ----------
    states : ndarray, shape (n, n_z) - state after the impact, x = 0; where the motion ended before, the state there.
    endings : ndarray, shape (n,) - index in ``ENDINGS``; 0 is ``completed``.
    times : ndarray, shape (n,) - time of the impact, or of the ending [s].
    step_lengths : ndarray, shape (n,) - NaN where there was no impact [m].
    phases : ndarray, shape (n,) - code of the modes gone through, see ``phase_names``.
    impacts : ndarray, shape (n,) - index in ``CONTACTS`` of the impact's mode, -1 where there was none.
    """

    states: Array
    endings: Codes
    times: Array
    step_lengths: Array
    phases: Codes
    impacts: Codes


def phase_code(phases: Sequence[Mode], modes: Sequence[Mode]) -> int:
    """The code of the modes gone through in a step, of a walker with these ``modes``."""
    code = 0
    for mode in phases if len(phases) <= max_phases(modes) else ():
        code = code * base(modes) + modes.index(mode) + 1
    return code


def phase_names(code: int, modes: Sequence[Mode]) -> tuple[Mode, ...]:
    """The modes behind a code, in order."""
    phases = []
    while code > 0:
        code, digit = divmod(code, base(modes))
        phases.append(modes[digit - 1])
    return tuple(reversed(phases))


def stack_outcomes(outcomes: Sequence[StepOutcome], starts: Array, modes: Sequence[Mode]) -> BatchSteps:
    """Steps that were simulated one by one from ``starts``, shape (n, n_z), as arrays."""
    states, times = starts.copy(), np.zeros(len(starts))
    lengths, phases = np.full(len(starts), np.nan), np.zeros(len(starts), dtype=np.int64)
    impacts = np.full(len(starts), NONE)
    for k, step in enumerate(outcome.step for outcome in outcomes):
        if step is None:
            continue
        times[k], states[k] = step.period, step.arcs[-1].states[-1]
        phases[k] = phase_code([mode for mode, _ in step.phases], modes)
        if step.impact is not None:
            states[k], lengths[k] = step.impact.state, step.impact.step_length
            impacts[k] = CONTACTS.index(step.impact.mode)
    endings = np.array([ENDINGS.index(outcome.ending) for outcome in outcomes], dtype=np.int64)
    return BatchSteps(states=states, endings=endings, times=times, step_lengths=lengths, phases=phases, impacts=impacts)


def followed_by(first: BatchSteps, second: BatchSteps, rows: NDArray[np.intp], modes: Sequence[Mode]) -> BatchSteps:
    """Two steps as one: ``first`` and, of those of its ``rows`` that were completed, the steps that followed."""
    codes = [
        (*phase_names(int(a), modes), *phase_names(int(b), modes))
        for a, b in zip(first.phases[rows], second.phases, strict=True)
    ]
    phases = [phase_code(names, modes) for names in codes]
    both = {
        name: getattr(first, name).copy()
        for name in ("states", "endings", "times", "step_lengths", "phases", "impacts")
    }
    both["states"][rows], both["endings"][rows], both["impacts"][rows] = second.states, second.endings, second.impacts
    both["times"][rows] += second.times
    both["step_lengths"][rows] += second.step_lengths
    both["phases"][rows] = phases
    return BatchSteps(**both)


Flags = NDArray[np.bool_]
ResolverCodes = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Landing:
    """Impacts of n states.

    Attributes
    ----------
    modes, endings : ndarray, shape (n,) - codes; where the ending is not ``completed``, there was no impact.
    states : ndarray, shape (n, n_z) - state after the impact, x = 0.
    step_lengths : ndarray, shape (n,) [m].
    """

    modes: ResolverCodes
    endings: ResolverCodes
    states: Array
    step_lengths: Array


class BatchResolver:
    """Decides about the feet of many states of one system at fixed parameters."""

    def __init__(self, dynamics: Dynamics) -> None:
        self._system = system = dynamics.system
        p = dynamics.p
        self._n_x = system.n_shape
        self._friction = dynamics.static_friction
        self._stick_first = stick_comes_first(dynamics)
        self._one_by_one = ContactResolver(dynamics)
        self._units = units(dynamics)
        self._modes = system.walker.modes()
        from gaitopt.simulation.heyoka_stepper import HeyokaRowMap  # optional

        self._push = HeyokaRowMap(system.push, {1: p}) if system.walker.pushes else None
        self._table = table = system.transitions
        self._ground = tuple(mode.contact for mode in table.landed)
        stuck, slips = table.margin_names(Mode.STICK), table.margin_names(Mode.SLIP_FORWARD)
        self._normal_force, self._painleve = stuck.index("normal_force"), slips.index("painleve")
        self._cone = [stuck.index(name) for name in CONE.values()]
        self._lifts = "lift_velocity" in table.of_impact(Mode.STICK)
        self._impacts = HeyokaRowMap(system.impacts(self._ground), {1: p})
        self._at_rest: dict[tuple[Mode, ...], HeyokaRowMap] = {}

    def mode_at_rest(
        self, candidates: tuple[Mode, ...], times: Array, states: Array, data: Array
    ) -> tuple[ResolverCodes, ResolverCodes]:
        """Modes of feet at rest and, where there is none, endings; both of shape (n,).

        Parameters
        ----------
        candidates : what the feet can do, the same for all; stick first.
        times : ndarray, shape (n,) - times since the last impact [s].
        states : ndarray, shape (n, n_z).
        data : ndarray, shape (n, n_r) - segment data of the control.
        """
        if not times.size:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        taus, zetas = times / self._units.time, states / self._units.state
        if candidates not in self._at_rest:
            self._at_rest[candidates] = self._rest(grounded(candidates))
        _, margins, rates, *slips = self._at_rest[candidates](taus[:, None], zetas, data)
        stick, cone = margins[:, self._normal_force], [margins[:, k] for k in self._cone]
        clear = [np.abs(own) > EDGE + INSTANT * np.abs(rates[:, k]) for own, k in zip(cone, self._cone, strict=True)]
        possible = [(stick > EDGE) & (cone[0] > 0) & (cone[1] > 0)]
        possible += [(own < 0) & (slip[:, self._normal_force] > 0) for own, slip in zip(cone, slips, strict=False)]
        unique = [(slip[:, self._painleve] > 0) & (slip[:, self._normal_force] >= 0) for slip in slips]
        plain = np.all([*clear, *unique, np.abs(stick) > EDGE, np.sum(possible, axis=0) == 1], axis=0)
        modes = self._modes.index(candidates[0]) + np.argmax(possible, axis=0)
        endings = np.zeros_like(modes)
        for k in np.flatnonzero(~plain):
            decision = self._one_by_one.mode_at_rest(candidates, float(times[k]), states[k], data[k])
            if isinstance(decision, Termination):
                modes[k], endings[k] = NONE, ENDINGS.index(decision.ending)
            else:
                modes[k] = self._modes.index(decision)
        return modes, endings

    def strike(self, transition: Transition, states: Array) -> tuple[ResolverCodes, Array, ResolverCodes]:
        """Modes and states just after a stop has locked and, where no impact is possible, endings."""
        modes, after, endings = np.zeros(len(states), dtype=np.int64), states.copy(), np.zeros(len(states), np.int64)
        for k, state in enumerate(states):
            struck = self._one_by_one.strike(transition, state)
            if isinstance(struck, Termination):
                modes[k], endings[k] = NONE, ENDINGS.index(struck.ending)
            else:
                modes[k], after[k] = self._modes.index(struck[0]), struck[1]
        return modes, after, endings

    def land(self, states: Array) -> Landing:
        """Impacts at touchdown in the given states, shape (n, n_z)."""
        n, n_z = states.shape
        columns, approach = self._impacts(states)
        candidates = columns.reshape(n, len(self._ground), -1)
        impacts = candidates[:, :, n_z : n_z + 3]  # (F_t, F_n), slip velocity
        consistent = np.column_stack(
            [
                is_consistent_impact(mode, impacts[:, k, 0], impacts[:, k, 1], impacts[:, k, 2], self._friction)
                for k, mode in enumerate(self._ground)
            ]
        )
        if self._stick_first:
            consistent[:, 1:] &= ~consistent[:, :1]
        modes = np.argmax(consistent, axis=1)
        chosen = candidates[np.arange(n), modes]
        after, lift_velocities = chosen[:, :n_z], chosen[:, n_z + 3]
        step_lengths, endings = after[:, self._n_x].copy(), np.zeros_like(modes)
        after[:, self._n_x] = 0.0
        edge = is_at_edge(impacts[:, 0, 0], impacts[:, 0, 1], self._friction)
        lifts = lift_velocities > 0 if self._lifts else True
        plain = comes_down(approach[:, 0], self._units) & (consistent.sum(axis=1) == 1) & lifts & ~edge
        if self._push is not None:
            p_t, p_n = self._push(states)[0].T
            plain &= is_within_cone(p_t, p_n, self._friction) & ~is_at_edge(p_t, p_n, self._friction)
        for k in np.flatnonzero(~plain):
            decision = self._one_by_one.impact(states[k])
            if isinstance(decision, ImpactRecord):
                modes[k], after[k], step_lengths[k] = (
                    CONTACTS.index(decision.mode),
                    decision.state,
                    decision.step_length,
                )
            else:
                modes[k], endings[k] = NONE, ENDINGS.index(decision.ending)
                after[k], step_lengths[k] = states[k], np.nan
        return Landing(modes=modes, endings=endings, states=after, step_lengths=step_lengths)

    def _rest(self, modes: tuple[Mode, ...]) -> "HeyokaRowMap":
        """What decides about a foot at rest, of a foot that sticks and then of its slips."""
        from gaitopt.simulation.heyoka_stepper import HeyokaRowMap  # optional

        stuck, *slips = modes
        fixed = {2: self._units.parameters[stuck], 4: self._units.margins[modes[-1]]}
        return HeyokaRowMap(natural_system(self._system).rest(stuck, tuple(slips)), fixed)


SimulatorCodes = NDArray[np.int64]
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
        self._max_switches, self._table = max_switches, system.transitions
        from gaitopt.simulation.heyoka_batch import HeyokaBatch  # optional

        self._stepper, self._resolver = HeyokaBatch(dynamics), BatchResolver(dynamics)
        self._units, self._modes = units(dynamics), system.walker.modes()
        longest = MAX_STEP_TIME * self._units.time if max_step_time is None else max_step_time
        limit = min(longest, system.control.horizon)
        self._ends = np.array([*(t for t in system.control.breakpoints if t < limit), limit])

    def step(self, states: Array) -> BatchSteps:
        """Simulate one step from each of the states just after an impact, shape (n, n_z)."""
        motion = _Motion(states, self.system.n_shape, AT_REST * self._units.speed, self._modes)
        slips = motion.states[:, -1] != 0
        self._choose_at_rest(motion, np.flatnonzero(~slips), self._table.at_rest(self._table.landed[0]))
        if not any(mode.slips for mode in self._table.landed):
            motion.end(np.flatnonzero(slips), Ending.PAINLEVE)
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
        for event in np.unique(arrivals.events):
            self._follow(motion, mode, event, rows[arrivals.events == event])

    def _follow(self, motion: "_Motion", mode: Mode, event: int, rows: Indices) -> None:
        """What comes after the same event in the given rows, all in the same mode."""
        if event == FAILURE:
            motion.end(rows, Ending.NUMERICAL)
            return
        if event == LIMIT:
            self._pass_breakpoint(motion, rows)
            return
        transition = [*self._table.of(mode).values()][event]
        if transition.ending is not None:
            motion.end(rows, transition.ending)
            return
        if transition.ends_step:
            motion.land(rows, self._resolver.land(motion.states[rows]))
            return
        motion.switches[rows] += 1
        chattering = motion.switches[rows] > self._max_switches
        motion.end(rows[chattering], Ending.CHATTERING)
        rows = rows[~chattering]
        if transition.reset is not None:
            self._strike(motion, transition, rows)
        elif transition.at_rest:
            motion.states[rows, -1] = 0.0
            self._choose_at_rest(motion, rows, transition.candidates)
        else:
            motion.modes[rows] = self._modes.index(transition.candidates[0])

    def _strike(self, motion: "_Motion", transition: Transition, rows: Indices) -> None:
        """A stop locks in the given rows."""
        modes, states, endings = self._resolver.strike(transition, motion.states[rows])
        motion.modes[rows], motion.states[rows] = modes, states
        motion.endings[rows[endings > 0]] = endings[endings > 0]
        self._decide_again(motion, rows[endings == 0])

    def _pass_breakpoint(self, motion: "_Motion", rows: Indices) -> None:
        last = motion.segments[rows] == len(self._ends) - 1
        motion.end(rows[last], Ending.NO_TOUCHDOWN)
        motion.segments[rows[~last]] += 1
        self._decide_again(motion, rows[~last])

    def _decide_again(self, motion: "_Motion", rows: Indices) -> None:
        """The mode of a foot at rest follows from the forces; any other mode goes on."""
        codes = motion.modes[rows]
        for code in np.unique(codes):
            if self._modes[code].sticks:
                self._choose_at_rest(motion, rows[codes == code], self._table.at_rest(self._modes[code]))

    def _choose_at_rest(self, motion: "_Motion", rows: Indices, candidates: tuple[Mode, ...]) -> None:
        data = self._stepper.data[motion.segments[rows]]
        modes, endings = self._resolver.mode_at_rest(candidates, motion.times[rows], motion.states[rows], data)
        motion.modes[rows] = modes
        motion.endings[rows[endings > 0]] = endings[endings > 0]


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
