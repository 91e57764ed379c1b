"""Decisions about walkers with several contacts: the modes that are consistent with forces, or with impulses.

All combinations of what the touching contacts can do are examined. In a mode of a motion

    closed          f_n > 0; at rest and sticking, the force within the friction cone
    slip from rest  the acceleration has the sign of the slip
    off             the contact moves away from the ground

and at zero the rates decide. After an impact

    stays           F_n > 0; at rest the impulse within the cone, else against the slip
    leaves          no impulse, and a velocity away from the ground

Combinations count once if they move the walker alike, such as sticking and slipping without a velocity. Where several
motions are consistent because friction drops at the onset of slip, the one that sticks counts. Otherwise the motion
ends with a name where no combination is consistent, or several are.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait.trajectory import ImpactRecord, impact_record
from gaitopt.model.buffered import Buffers
from gaitopt.model.contact_transitions import AT_REST
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import OFF, Mode
from gaitopt.model.section import TOUCHDOWN
from gaitopt.model.transitions import Ending, Transition, kind
from gaitopt.simulation.contact_resolver import Termination
from gaitopt.simulation.events import EDGE, LOOK_AHEAD, bends_decide, falls_at_start

ALIKE = 1e-9
"""Motions are the same if their accelerations, or velocities, differ by less, in natural units."""
AT_REST_TOO = 1e-11
"""A slip velocity below this, in natural units, is zero where another contact has just come to rest."""
TOUCHING = 1e-9
"""A contact of a given state touches the ground if its height and normal velocity are below this, in natural units."""


@dataclass(frozen=True, slots=True)
class _Option:
    """A consistent combination: the mode, its acceleration or the velocity after it, and the state after an impact."""

    mode: Mode
    motion: Array
    state: Array


class ContactSetResolver:
    """Decides about the contacts of one system at fixed parameters.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self._dynamics, self._system = dynamics, dynamics.system
        scales = dynamics.scales
        self._time, self._gravity = scales.time, scales.length / scales.time**2
        self._speed, self._impulse = scales.speed, scales.impulse
        self._acceleration = dynamics.state_units[dynamics.system.n_z // 2 :] / scales.time
        self._names = dynamics.system.walker.contacts
        self._massless = dynamics.system.walker.massless_contacts
        self._drops = dynamics.friction_drops
        self._decisions: dict[Mode, Buffers] = {}
        self._impacts: dict[tuple[Mode, tuple[str, ...]], Buffers] = {}
        self._points = Buffers(dynamics.system.contact_points)

    def first_mode(self, t: float, z: Array, segment: int) -> Mode | Termination:
        """Mode of a motion that starts at a state; a contact touches the ground if its height and approach are zero."""
        heights, velocities = (values.copy() for values in self._points(z, self._dynamics.p))
        velocities = velocities.reshape(-1, 2)
        length, words = self._dynamics.scales.length, {}
        for name, height, (v_t, v_n) in zip(self._names, heights, velocities, strict=True):
            touches = abs(height) <= TOUCHING * length and abs(v_n) <= TOUCHING * self._speed
            slip = "stick" if abs(v_t) <= TOUCHING * self._speed else Mode.slip(v_t)
            words[name] = str(slip) if touches else OFF
        mode = self._system.walker.released(Mode.of_contacts(words))
        return self.mode_at_rest(self._system.transitions.at_rest(mode), t, z, segment)

    def mode_at_rest(self, candidates: tuple[Mode, ...], t: float, z: Array, segment: int) -> Mode | Termination:
        """The one of ``candidates`` that is consistent with the forces at time ``t`` in state ``z``."""
        candidates = self._with_others_at_rest(candidates, z)
        touching = {name for mode in candidates for name in mode.touching}
        options: list[_Option] = []
        undetermined = False
        for mode in candidates:
            acceleration = self._consistent(mode, touching, t, z, segment)
            if acceleration is not None and not np.all(np.isfinite(acceleration)):
                undetermined = True
            elif acceleration is not None:
                options.append(_Option(mode, acceleration, z))
        chosen = self._one_of(options)
        if chosen is not None:
            return chosen.mode
        names = " and ".join(option.mode.brief for option in options)
        if options:
            return Termination(Ending.CONTACT_AMBIGUOUS, f"several motions are consistent: {names}")
        if undetermined:
            words = "contacts of different friction slip together, so that the forces do not determine the motion"
            return Termination(Ending.UNDETERMINED, words)
        among = f"none of {len(candidates)} combinations of {', '.join(sorted(touching)) or 'no contact'}"
        return Termination(Ending.CONTACT_INCONSISTENT, f"no motion is consistent with the contact forces: {among}")

    def _with_others_at_rest(self, candidates: tuple[Mode, ...], z: Array) -> tuple[Mode, ...]:
        """The candidates, and what contacts can do that come to rest at the same instant as another one."""
        _, velocities = self._points(z, self._dynamics.p)
        rests = np.abs(velocities.reshape(-1, 2)[:, 0]) <= AT_REST_TOO * self._speed
        slipping = {name for mode in candidates for name, direction in mode.directions.items() if direction}
        for name, stops in zip(self._names, rests, strict=True):
            if stops and name in slipping:
                words = [mode.with_states({name: word}) for mode in candidates for word in AT_REST]
                candidates = tuple(dict.fromkeys(words))
        return candidates

    def strike(self, transition: Transition, z_minus: Array) -> tuple[Mode, Array] | Termination:
        """Mode and state just after a contact has landed in state ``z_minus``; forces then decide about the motion."""
        assert transition.reset is not None
        landing = transition.reset.of
        chosen = self._impact(transition.candidates, landing, z_minus)
        return chosen if isinstance(chosen, Termination) else (chosen.mode, chosen.state)

    def impact(self, mode: Mode, transition: Transition, z_minus: Array) -> ImpactRecord | Termination:
        """The end of a step in ``mode`` and state ``z_minus``: an impact with the feet swapped after it, or none."""
        assert transition.reset is not None
        if self._system.cycle_end != TOUCHDOWN:
            return impact_record(self._dynamics, mode.contact, z_minus, mode)
        chosen = self._impact(transition.candidates, transition.reset.of, z_minus)
        if isinstance(chosen, Termination):
            return chosen
        return impact_record(self._dynamics, self._system.walker.swapped(chosen.mode).contact, z_minus, mode)

    def _impact(self, candidates: Iterable[Mode], landing: str, z_minus: Array) -> _Option | Termination:
        """The only consistent impact; contacts that arrive at the same instant take part."""
        heights, velocities = (values.copy() for values in self._points(z_minus, self._dynamics.p))
        before, size = velocities.reshape(-1, 2) / self._speed, self._dynamics.scales.length
        place = {name: k for k, name in enumerate(self._names)}
        massless = landing in self._massless
        if not massless and heights[place[landing]] < -TOUCHING * size:
            depth = -heights[place[landing]]
            words = f"{landing} scuffs: it is {depth:.3g} m below the ground where it begins to count as a contact"
            return Termination(Ending.SCUFFING, words)
        if not massless and before[place[landing], 1] >= -EDGE:
            words = f"{landing} does not come down: its normal velocity is {before[place[landing], 1]:.6g} sqrt(g l)"
            return Termination(Ending.IMPACT_INCONSISTENT, words)
        touching = {name for mode in candidates for name in mode.touching}
        for name in {*self._names} - touching - {*self._massless}:
            if abs(heights[place[name]]) <= TOUCHING * size and before[place[name], 1] < -TOUCHING:
                touching.add(name)
                candidates = [mode.with_states({name: word}) for mode in candidates for word in AT_REST]
        options, undetermined = list[_Option](), False
        for mode in candidates:
            if massless and landing not in mode.touching:
                continue
            key = mode, ((landing,) if massless else ())
            if key not in self._impacts:
                self._impacts[key] = Buffers(self._system.contact_impact(*key))
            z_plus, impulses, velocities, regularity, shares = self._impacts[key](z_minus, self._dynamics.p)
            impulse, after = impulses.reshape(-1, 2) / self._impulse, velocities.reshape(-1, 2) / self._speed
            if not regularity[0] > 0 or np.any(shares / self._impulse < -EDGE):
                continue
            if all(self._stays(mode, name, impulse[place[name]], after[place[name]], shares.size) for name in touching):
                if not np.all(np.isfinite(z_plus)):
                    undetermined = True
                    continue
                speeds = z_plus[self._system.n_z // 2 :] / self._acceleration / self._time
                options.append(_Option(mode, speeds.copy(), z_plus.copy()))
        chosen = self._one_of(options)
        if chosen is not None:
            return chosen
        if options:
            names = " and ".join(option.mode.brief for option in options)
            return Termination(Ending.IMPACT_AMBIGUOUS, f"several impacts are consistent: {names}")
        if undetermined:
            words = "contacts of different friction slip together, so that the impulses do not determine the impact"
            return Termination(Ending.UNDETERMINED, words)
        return Termination(Ending.IMPACT_INCONSISTENT, f"no impact of {', '.join(sorted(touching))} is consistent")

    def _stays(self, mode: Mode, name: str, impulse: Array, velocity: Array, shares: int) -> bool:
        """Whether what a contact does after an impact agrees with its impulse and velocity, in natural units."""
        if name not in mode.touching:
            return bool(velocity[1] > EDGE)
        if mode.directions[name]:
            return bool(impulse[1] > -EDGE and mode.directions[name] * velocity[0] > EDGE)
        if shares:
            return True  # margins of the group decide
        friction = self._dynamics.contact_friction[name]
        return bool(impulse[1] > -EDGE and abs(impulse[0]) <= friction * impulse[1] * (1 + EDGE) + EDGE)

    def _consistent(self, mode: Mode, touching: set[str], t: float, z: Array, segment: int) -> Array | None:
        """Acceleration in a mode, in natural units, if the mode is consistent; NaN where it is undetermined."""
        dz, margins, rates, separations = self._decide(mode, t, z, segment)
        acceleration = dz[self._system.n_z // 2 :] / self._acceleration
        if not np.all(np.isfinite(acceleration)):
            return acceleration
        lifted, massless = [name for name in self._names if name not in mode.touching], self._massless
        later: tuple[Array, Array, Array, Array] | None = None
        names = self._system.transitions.margin_names(mode)

        def ahead() -> tuple[Array, Array, Array, Array]:
            moved = z + LOOK_AHEAD * self._time * dz
            return self._decide(mode, t + LOOK_AHEAD * self._time, moved, segment) if later is None else later

        for k, name in enumerate(names):
            what, margin, rate, bend = kind(name), margins[k], rates[k], 0.0
            if what not in DECISIVE or (what == "slip_velocity" and margin > EDGE):
                continue
            if what == "slip_velocity":
                margin = min(margin, 0.0)  # at rest to within rounding
            if bends_decide(margin, rate):
                later = ahead()
                bend = (later[2][k] - rate) / LOOK_AHEAD
            if falls_at_start(name, margin, rate, bend) or (what == "regularity" and margin <= EDGE):
                return None
        for k, name in enumerate(lifted):
            if name not in touching:
                continue
            if name in massless:  # it is off where the ground would have to pull at it
                closed = mode.with_states({name: "stick"})
                row = self._system.transitions.margin_names(closed).index(f"normal_force.{name}")
                _, forces, growth, _ = self._decide(closed, t, z, segment)
                if not falls_at_start("normal_force", forces[row], growth[row]):
                    return None
                continue
            value, growing = separations[k], 0.0
            if abs(value) <= STEADY:
                later = ahead()
                growing = (later[3][k] - value) / LOOK_AHEAD
            if not (value > STEADY or growing > STEADY):
                return None
        return acceleration

    def _decide(self, mode: Mode, t: float, z: Array, segment: int) -> tuple[Array, Array, Array, Array]:
        """dz in SI; margins, their rates and normal accelerations of lifted contacts in natural units."""
        if mode not in self._decisions:
            self._decisions[mode] = Buffers(self._system.contact_decision(mode))
        values = self._decisions[mode](t, z, self._dynamics.p, self._system.data(segment))
        dz, margins, rates, separations = (value.copy() for value in values)
        units = self._dynamics.margin_units(mode)
        return dz, margins / units, rates * (self._time / units), separations / self._gravity

    def _one_of(self, options: list[_Option]) -> _Option | None:
        """The only motion among consistent options, or the one that sticks where friction drops; None otherwise."""
        different: list[_Option] = []
        for option in options:
            close = ALIKE * (1 + np.abs(option.motion).max())
            if all(np.abs(option.motion - other.motion).max() > close for other in different):
                different.append(option)
        if len(different) == 1:
            return different[0]
        if different and self._drops:
            return max(different, key=lambda option: sum(word == "stick" for word in option.mode.contacts.values()))
        return None


DECISIVE = ("normal_force", "cone_forward", "cone_backward", "slip_velocity", "regularity")
"""Kinds of margins that decide about a mode; those of groups begin with one of them."""
STEADY = 1e-11
"""A normal acceleration below this, in units of gravity, is zero."""
