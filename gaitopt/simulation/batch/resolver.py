"""What the feet of many states do, at rest and at an impact.

The rules are those of ``contact_resolver``. What is plain is decided for all states at once; where anything is out of
the ordinary (an edge, a lost contact, no candidate or several) the state is handed to ``ContactResolver`` by itself.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.gait import ImpactRecord
from gaitopt.mechanics import CONTACTS, Dynamics, ImpactLaw, Mode
from gaitopt.simulation.batch.steps import ENDINGS, NONE
from gaitopt.simulation.contact_resolver import CONE, NORMAL_FORCE, ContactResolver, Termination
from gaitopt.simulation.events import EDGE, INSTANT
from gaitopt.simulation.heyoka.functions import HeyokaRowMap
from gaitopt.simulation.natural import PAINLEVE, natural_system, units

Flags = NDArray[np.bool_]
Codes = NDArray[np.int64]

CONE_EDGE = 1e-9
"""Relative distance from the edge of the cone within which an impact is resolved by itself."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Landing:
    """Impacts of n states.

    Attributes
    ----------
    modes, endings : ndarray, shape (n,) - codes; where the ending is not ``completed``, there was no impact.
    states : ndarray, shape (n, n_z) - state after the impact, x = 0.
    step_lengths : ndarray, shape (n,) [m].
    """

    modes: Codes
    endings: Codes
    states: Array
    step_lengths: Array


class BatchResolver:
    """Decides about the feet of many states of one system at fixed parameters."""

    def __init__(self, dynamics: Dynamics) -> None:
        self._system = system = dynamics.system
        p = dynamics.p
        self._n_x = system.n_shape
        self._friction = dynamics.static_friction
        self._stick_first = system.law is ImpactLaw.FRICTIONLESS or dynamics.friction_drops
        self._one_by_one = ContactResolver(dynamics)
        self._units = units(dynamics)
        self._modes = system.walker.modes()
        self._push = HeyokaRowMap(system.push, {1: p}) if system.walker.pushes else None
        self._contacts = system.walker.contacts()
        self._ground = tuple(mode for mode in self._contacts if not mode.flies)
        self._lifts = not system.walker.flies
        self._impacts = HeyokaRowMap(system.impacts(self._ground), {1: p})
        n = len(self._contacts)
        self._at_rest = [self._rest(self._modes[k : k + len(self._ground)]) for k in range(0, len(self._modes), n)]

    def mode_at_rest(self, stops: int, times: Array, states: Array, data: Array) -> tuple[Codes, Codes]:
        """Modes of feet at rest and, where there is none, endings; both of shape (n,).

        Parameters
        ----------
        stops : index of the states of the stops, the same for all: code of the mode divided by the number of contacts.
        times : ndarray, shape (n,) - times since the last impact [s].
        states : ndarray, shape (n, n_z).
        data : ndarray, shape (n, n_r) - segment data of the control.
        """
        if not times.size:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        taus, zetas = times / self._units.time, states / self._units.state
        first = stops * len(self._contacts)
        _, margins, rates, *slips = self._at_rest[stops](taus[:, None], zetas, data)
        stick, cone = margins[:, NORMAL_FORCE], [margins[:, k] for k in CONE.values()]
        clear = [np.abs(own) > EDGE + INSTANT * np.abs(rates[:, k]) for own, k in zip(cone, CONE.values(), strict=True)]
        forces = [(own[:, NORMAL_FORCE], own[:, PAINLEVE]) for own in slips]
        possible = [(stick > EDGE) & (cone[0] > 0) & (cone[1] > 0)]
        possible += [(own < 0) & (mass > 0) & (force > 0) for own, (force, mass) in zip(cone, forces, strict=False)]
        lifts = np.any([force * mass < 0 for force, mass in forces], axis=0)
        plain = np.all([*clear, np.abs(stick) > EDGE], axis=0) & (np.sum(possible, axis=0) == 1) & ~lifts
        modes = first + np.argmax(possible, axis=0)
        endings = np.zeros_like(modes)
        for k in np.flatnonzero(~plain):
            decision = self._one_by_one.mode_at_rest(self._modes[first], float(times[k]), states[k], data[k])
            if isinstance(decision, Termination):
                modes[k], endings[k] = NONE, ENDINGS.index(decision.ending)
            else:
                modes[k] = self._modes.index(decision)
        return modes, endings

    def strike(self, mode: Mode, stop: str, states: Array) -> tuple[Codes, Array, Codes]:
        """Modes and states just after a stop has locked and, where no impact is possible, endings."""
        modes, after, endings = np.zeros(len(states), dtype=np.int64), states.copy(), np.zeros(len(states), np.int64)
        for k, state in enumerate(states):
            struck = self._one_by_one.strike(mode, stop, state)
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
        consistent = np.column_stack(
            [self._consistent(mode, *candidates[:, k, n_z : n_z + 3].T) for k, mode in enumerate(self._ground)]
        )
        if self._stick_first:
            consistent[:, 1:] &= ~consistent[:, :1]
        modes = np.argmax(consistent, axis=1)
        chosen = candidates[np.arange(n), modes]
        after, lift_velocities = chosen[:, :n_z], chosen[:, n_z + 3]
        step_lengths, endings = after[:, self._n_x].copy(), np.zeros_like(modes)
        after[:, self._n_x] = 0.0
        comes_down = approach[:, 0] < -EDGE * self._units.speed
        lifts = lift_velocities > 0 if self._lifts else True
        plain = comes_down & (consistent.sum(axis=1) == 1) & lifts & ~self._at_edge(*candidates[:, 0, n_z : n_z + 2].T)
        if self._push is not None:
            p_t, p_n = self._push(states)[0].T
            plain &= np.abs(p_t) < self._friction * p_n
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

    def _rest(self, modes: tuple[Mode, ...]) -> HeyokaRowMap:
        """What decides about a foot at rest, of a foot that sticks and then of its slips."""
        stuck, *slips = modes
        fixed = {2: self._units.parameters[stuck], 4: self._units.margins[modes[-1]]}
        return HeyokaRowMap(natural_system(self._system).rest(stuck, tuple(slips)), fixed)

    def _consistent(self, mode: Mode, f_t: Array, f_n: Array, slip_velocity: Array) -> Flags:
        if mode.sticks:
            return (f_n > 0) & (np.abs(f_t) <= self._friction * f_n)
        return (f_n > 0) & (mode.direction * slip_velocity > 0)

    def _at_edge(self, f_t: Array, f_n: Array) -> Flags:
        return np.abs(np.abs(f_t) - self._friction * f_n) <= CONE_EDGE * np.abs(self._friction * f_n)
