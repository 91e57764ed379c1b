"""Decisions about the contacts: the modes that are consistent with forces, or with impulses.

All combinations of states of the touching contacts are examined. The conditions of a motion are

    closed          f_n > 0; if the contact sticks, the force lies within the friction cone
    slip from rest  the acceleration has the sign of the slip
    off             the contact moves away from the ground

If a value is zero, its rate decides. After an impact

    stays           F_n > 0; the impulse lies within the cone if the contact sticks, and opposes the slip otherwise
    leaves          no impulse, and a velocity away from the ground

Combinations that move the walker in the same way, such as sticking and slipping without a velocity, count once. If
several motions are consistent because friction drops at the onset of slip, the one that sticks is taken. In all other
cases the motion ends, with an ending that says whether no combination is consistent or more than one. A mode of named
contacts is accepted even if its ``regularity`` is not positive: it satisfies the laws of contact and friction, although
not as their only solution.

**A contact that rests alone on the ground** never begins a slip in Painleve's paradox. If friction wedges it in, it
could stick as well as lift off. It sticks, because the plastic impact, or the phase before, has loaded it, and the
force of a slightly compliant contact tends to that of sticking. For a walker that stands on one foot at a time,
``ClearCases`` decides the cases that rounding cannot change.

A walker may declare that it never leaves the ground (``Walker.leaves_ground``). If all its contacts would leave it, the
motion ends with ``lift_off``.

Some control laws compute torques for a motion in which all contacts stick. While motions are compared, these are the
contacts that touch just before. If the chosen mode implies other torques, because a contact leaves, the decision is
repeated with these torques.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait.trajectory import ImpactRecord, impact_record
from gaitopt.model.buffered import Buffers, buffered
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import ImpactLaw
from gaitopt.model.modes import OFF, Mode
from gaitopt.model.transitions import AT_REST, CANNOT_SLIP, CONE, PHASE_MARGINS, Ending, Transition, grounded
from gaitopt.simulation.clear_cases import ClearCases, is_within_cone
from gaitopt.simulation.contact_forces import ContactForces, ContactInstant, Solutions
from gaitopt.simulation.events import AT_REST as SLIPS_NO_MORE
from gaitopt.simulation.events import EDGE, LOOK_AHEAD, STEADY, bends_decide, falls_at_start
from gaitopt.simulation.natural import NaturalDynamics

ALIKE = 1e-9
"""Motions are the same if their accelerations, or velocities, differ by less than this, in natural units."""
SLIPS = {str(mode) for mode in CONE}
"""States of a contact that slips."""
AT_REST_TOO = 1e-11
"""A slip velocity below this, in natural units, counts as zero if another contact has just come to rest."""
ROUNDED = 1e-15
"""A slip velocity below this, in natural units, is not corrected."""
TOUCHING = 1e-9
"""A contact is on the ground if its height is below this, and stays there if its normal velocity is below this, in
natural units."""
HOPELESS = 1e-3
"""A motion is ruled out if a force has the wrong sign and exceeds this fraction of the weight. To become admissible at
once, such a force would have to change by the weight within a millionth of the unit of time."""


@dataclass(frozen=True, slots=True)
class Termination:
    """The end of a motion that cannot continue, and its reason as a sentence."""

    ending: Ending
    reason: str


@dataclass(frozen=True, slots=True)
class _Option:
    """A consistent mode, its index among those examined, and its motion in natural units.

    ``motion`` has the accelerations in the mode, or the rates after an impact.
    """

    index: int
    mode: Mode
    motion: Array


class _Motion:
    """The k-th of the motions that were computed for one instant, with its second derivatives.

    A second derivative is the difference to the same motion a little later, divided by the time between them.
    """

    def __init__(self, instant: ContactInstant, mode: Mode, law_mode: Mode, found: Solutions, k: int) -> None:
        self._instant, self._mode, self._law_mode, self._found, self._k = instant, mode, law_mode, found, k
        self._later: tuple[ContactInstant, Solutions] | None = None

    def slips_back(self, contact: int) -> bool:
        """Whether a contact moves in the direction opposite to its slip."""
        slip = self._found.modes.slip[self._k, contact]
        margin, rate = slip * self._instant.velocities[contact, 0], slip * self._found.contact[self._k, contact, 0]
        if margin > AT_REST_TOO:
            return False
        margin, bend = min(margin, 0.0), 0.0  # the contact is at rest up to rounding
        if bends_decide(margin, rate):
            bend = (slip * self._ahead[1].contact[0, contact, 0] - rate) / LOOK_AHEAD
        return bool(falls_at_start("slip_velocity", margin, rate, bend))

    def lacks_force(self, only: str | None = None) -> bool:
        """Whether the ground would have to pull at a contact, or to provide more friction than it can.

        Parameters
        ----------
        only : the only margin to be examined; None for all margins.
        """
        names, margins = self._instant.margins(self._mode, self._law_mode, self._found, self._k)
        for j, margin in enumerate(margins):
            if margin > EDGE or only not in (None, names[j]):
                continue
            if not margin > -HOPELESS:
                return True
            rate, bend = self._instant.rates(self._mode, self._law_mode, self._found.motion[self._k])[j], 0.0
            if bends_decide(margin, rate):
                later, motions = self._ahead
                bend = (later.rates(self._mode, self._law_mode, motions.motion[0])[j] - rate) / LOOK_AHEAD
            if falls_at_start(names[j], margin, rate, bend):
                return True
        return False

    def separates(self, contact: int) -> bool:
        """Whether a contact that is off moves away from the ground."""
        value = self._found.contact[self._k, contact, 1]
        if abs(value) > STEADY:
            return bool(value > 0)
        return bool((self._ahead[1].contact[0, contact, 1] - value) / LOOK_AHEAD > STEADY)

    @property
    def _ahead(self) -> tuple[ContactInstant, Solutions]:
        if self._later is None:
            moved = self._instant.after(LOOK_AHEAD, self._mode, self._found.motion[self._k])
            self._later = moved, moved.motions((self._mode,), self._law_mode)
        return self._later


class ContactResolver:
    """Decides about the contacts of one system at fixed parameters.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    natural : the same in natural units, if the integrator has it.

    Attributes
    ----------
    system : the walker under its control law.
    clear : the decisions of clear cases if the table has the margin ``painleve``; otherwise None.
    """

    def __init__(self, dynamics: Dynamics, natural: NaturalDynamics | None = None) -> None:
        self._dynamics, self.system = dynamics, dynamics.system
        walker, scales = dynamics.system.walker, dynamics.scales
        self._speed, self._impulse = scales.speed, scales.impulse
        self._names, self._base = walker.landing_points(), walker.base_contact()
        self._number = {name: k for k, name in enumerate(self._names)}
        self._massless = walker.weightless()
        self._weightless = np.array([name in self._massless for name in self._names])
        self._drops, self._stick_first = dynamics.friction_drops, dynamics.stick_comes_first
        self._frictionless = dynamics.system.law is ImpactLaw.FRICTIONLESS
        self._forces = ContactForces(dynamics)
        self._points = Buffers(dynamics.system.contact_points)
        self._natural = natural or NaturalDynamics(dynamics)
        self.clear = ClearCases(dynamics) if dynamics.system.transitions.unique == "painleve" else None
        self._pushes: dict[Mode, Buffers] = {}
        self._impacts: dict[tuple[Mode, tuple[Mode, ...]], Buffers] = {}

    def below_ground(self, z: Array) -> str | None:
        """Message about an active contact that is below the ground in a given state; None if there is none."""
        heights, _, counts = self._points(z, self._dynamics.p)
        for k, name in enumerate(self.system.walker.contact_names()):
            below = heights[k] < -TOUCHING * self._dynamics.scales.length
            if below and counts[k] > 0 and name not in self._massless:
                return f"{name} is {-heights[k]:.6g} m below the ground at the start"
        return None

    def settled(self, z: Array, *, stopped: Mode | None = None) -> Array:
        """A state in which slip velocities that only consist of rounding errors are exactly zero.

        The slip velocity of a foot at the base point is part of the state. For other walkers, after a contact comes to
        rest, the rates are changed by the smallest amount that also stops the contacts that stop at the same instant.

        Parameters
        ----------
        stopped : the mode that a contact has just left by coming to rest.
        """
        if self._base:
            if stopped is None and abs(z[-1]) > SLIPS_NO_MORE * self._speed:
                return z
            z = z.copy()
            z[-1] = 0.0
            return z
        if stopped is None:
            return z
        velocities = self._points(z, self._dynamics.p)[1].reshape(-1, 2)[:, 0].tolist()
        small = [AT_REST_TOO * self._speed >= abs(v) for v in velocities]
        resting = [k for k, name in enumerate(self._names) if name in stopped.touching and small[k]]
        if all(abs(velocities[k]) <= ROUNDED * self._speed for k in resting):
            return z
        normal = [2 * self._number[name] + 1 for name in stopped.touching]
        return self._forces.stopped(z, [2 * k for k in resting], normal)

    def start(self, z: Array, *, anywhere: bool) -> tuple[Mode, Transition | None] | Termination:
        """The mode in a given state, and the transition if a contact on the ground comes down.

        Parameters
        ----------
        anywhere : whether the state may be any state, and not only one just after an impact. Stops are then locked if
            their gap and its rate are zero.
        """
        reason = self.below_ground(z)
        if reason is not None:
            return Termination(Ending.SCUFFING, reason)
        walker, table = self.system.walker, self.system.transitions
        states, landing = self._contact_states(z)
        contact = walker.contact_mode(states)
        if contact not in walker.foot_modes():
            return Termination(Ending.PAINLEVE, CANNOT_SLIP)
        mode = walker.released(contact)
        for stop in mode.free if anywhere else ():  # otherwise the landing has just released the stops
            gap, rate = margin_and_rate(self._dynamics, stop, mode, z)
            if abs(gap) <= TOUCHING and abs(rate) * self._dynamics.scales.time <= TOUCHING:
                mode = mode.with_next(stop)
        if not landing:
            return mode, None
        row = table.of(mode).get(table.name("gap", landing[0]))
        if row is None:
            return Termination(Ending.SCUFFING, PHASE_MARGINS["clearance"].lost)
        if row.ends_step:
            reason = f"{landing[0]} is on the ground and comes down where the step starts, which its landing ends"
            return Termination(Ending.IMPACT_INCONSISTENT, reason)
        return mode, row

    def _contact_states(self, z: Array) -> tuple[dict[str, str], list[str]]:
        """The state of every contact, and the names of the contacts on the ground that come down."""
        heights, velocities, counts = (values.copy() for values in self._points(z, self._dynamics.p))
        length, states, landing = self._dynamics.scales.length, dict[str, str](), list[str]()
        for k, name in enumerate(self.system.walker.contact_names()):
            v_t, v_n = velocities[2 * k : 2 * k + 2] / self._speed
            on_ground = abs(heights[k]) <= TOUCHING * length
            still = 0.0 if name == self._base else TOUCHING  # ``settled`` leaves no rounding at the base point
            states[name] = "stick" if abs(v_t) <= still else str(Mode.slip(v_t))
            if on_ground and v_n < -TOUCHING and counts[k] > 0 and name not in self._massless:
                landing.append(name)
            cannot_slip = name in self.system.walker.placed_contacts() and abs(v_t) > TOUCHING
            if not on_ground or abs(v_n) > TOUCHING or cannot_slip:  # a massless contact that slips is off the ground
                states[name] = OFF
        return states, landing

    def following(self, transition: Transition, t: float, z: Array, segment: int) -> Mode | Termination:
        """The mode after an event without a reset: forces decide, unless there is only one candidate."""
        if transition.is_decided:
            return transition.candidates[0]
        return self.mode_at_rest(transition.candidates, t, z, segment)

    def mode_at_rest(self, candidates: tuple[Mode, ...], t: float, z: Array, segment: int) -> Mode | Termination:
        """The one of ``candidates`` that is consistent with the forces at time ``t`` in state ``z``."""
        if self.clear is not None and candidates[0].sticks:
            ground, at = grounded(candidates), (segment, t / self._natural.time, z / self._natural.state)
            point = self._natural.point(ground[0], *at)
            if all(
                self.clear.sticks(point.margins, point.rates)
            ):  # without functions of slips, which are slow to build
                return ground[0]
            point, slips = self._natural.rest(ground[0], ground[1:], *at)
            possible, clear = self.clear.at_rest(point.margins, point.rates, slips)
            if clear:
                return ground[possible.index(True)]
        instant = self._forces.at(t, z, segment)
        candidates = self._with_others_at_rest(self._with_leaving(candidates), instant.velocities)
        touching = {name for mode in candidates for name in mode.touching}
        law_mode = candidates[0]
        if self._forces.law_assumes_sticking:
            law_mode = law_mode.with_states(dict.fromkeys(touching, "stick")).held
        while True:
            chosen = self._chosen(instant, candidates, touching, law_mode)
            if isinstance(chosen, Termination):
                return chosen
            if not self._forces.law_assumes_sticking or chosen.held.contact is law_mode.contact:
                return self._unless_lifted(chosen, "no mode keeps the foot on the ground")
            # in the chosen mode the law assumes that fewer contacts stick, so that its torques jump
            law_mode = chosen.held
            candidates = tuple(mode for mode in candidates if {*mode.touching} <= {*chosen.touching})

    def _with_leaving(self, candidates: tuple[Mode, ...]) -> tuple[Mode, ...]:
        """The candidates, and the flight that ends the motion of a walker that never leaves the ground."""
        if not self.system.walker.leaves_ground() and grounded(candidates):
            return (*candidates, candidates[0].with_contact(Mode.FLIGHT))
        return candidates

    def _unless_lifted(self, mode: Mode, reason: str) -> Mode | Termination:
        """A mode, or the end of the motion if a walker that never leaves the ground would leave it in this mode."""
        leaves = not mode.touching and not self.system.walker.leaves_ground()
        return Termination(Ending.LIFT_OFF, reason) if leaves else mode

    def _chosen(
        self, instant: ContactInstant, candidates: Sequence[Mode], touching: set[str], law_mode: Mode
    ) -> Mode | Termination:
        """The mode among ``candidates`` that is consistent, or the end of the motion if not exactly one is.

        Parameters
        ----------
        touching : contacts on the ground. In a mode in which such a contact is off, it must move away from the ground.
        law_mode : the mode for which a control law that assumes sticking contacts computes its torques.
        """
        known = [mode for mode in candidates if not self._forces.is_undetermined(mode)]
        with np.errstate(all="ignore"):
            found = instant.motions(known, law_mode)
        if known and not np.isfinite(found.motion).all(axis=1).any():
            return Termination(Ending.NUMERICAL, "the contact forces are not finite")
        options = [
            _Option(k, known[k], found.motion[k])
            for k in self._conceivable(found, touching)
            if self._is_consistent(instant, found, k, touching, law_mode)
        ]
        kinetic = self._forces.friction.kinetic
        rests_alone = len(touching) == 1 and candidates[0].sticks
        if rests_alone:
            slips = [option.mode for option in options if option.mode.slips]
            paradox = {m for m in slips if self._forces.regularity(instant.mechanics, (m,), kinetic).item() <= 0}
            options = [option for option in options if option.mode not in paradox]
        different = self._different(options)
        if len(different) == 1 or (different and (self._drops or rests_alone)):
            return self._preferred(different).mode
        if different:
            names = " and ".join(option.mode.brief for option in different)
            return Termination(Ending.CONTACT_AMBIGUOUS, f"several motions are consistent: {names}")
        if len(known) < len(candidates):
            reason = "contacts of different friction slip together, so that the forces do not determine the motion"
            return Termination(Ending.UNDETERMINED, reason)
        among = f"none of {len(candidates)} combinations of {', '.join(sorted(touching)) or 'no contact'}"
        reason = f"no motion is consistent with the contact forces: {among}"
        if not any(mode.slips for mode in known):
            return Termination(Ending.PAINLEVE, CANNOT_SLIP)
        regularity = self._forces.regularity(instant.mechanics, known, kinetic)
        singular = [f"{mode.brief} {value:.4g}" for mode, value in zip(known, regularity, strict=True) if value <= EDGE]
        if singular:
            return Termination(Ending.PAINLEVE, f"{reason}; regularity is not positive: {', '.join(singular)}")
        return Termination(Ending.CONTACT_INCONSISTENT, reason)

    def _with_others_at_rest(self, candidates: tuple[Mode, ...], velocities: Array) -> tuple[Mode, ...]:
        """The candidates, extended by the states of further contacts that come to rest at the same instant."""
        for name in (name for k, name in enumerate(self._names) if abs(velocities[k, 0]) <= AT_REST_TOO):
            known = {mode.contacts.get(name) for mode in candidates}
            if known & SLIPS and AT_REST[0] not in known:
                extended = [mode.with_states({name: state}) for mode in candidates for state in AT_REST]
                candidates = tuple(dict.fromkeys(extended))
        return candidates

    def strike(self, mode: Mode, transition: Transition, z_minus: Array) -> tuple[Mode, Array] | Termination:
        """Mode and state just after a contact lands, or a stop locks, in ``mode`` and state ``z_minus``.

        The mode is that of the impact; the forces then decide in which mode the motion continues.
        """
        assert transition.reset is not None
        if transition.reset.swaps:
            swapped = self.impact(mode, transition, z_minus)
            if isinstance(swapped, Termination):
                return swapped
            z = swapped.state.copy()
            z[self.system.n_shape] = swapped.step_length  # x continues within a step
            started = self.start(z, anywhere=False)
            return started if isinstance(started, Termination) else (started[0], z)
        of, candidates = transition.reset.of, transition.candidates
        if of in self._names and (fault := self._push_fault(mode, z_minus)):
            return fault
        chosen = self._clear_impact(mode, candidates, z_minus) or self._impact(
            mode, self._with_leaving(candidates), {of} & {*self._names}, z_minus
        )
        if isinstance(chosen, Mode):
            chosen = self._unless_lifted(chosen, f"the stop {of} would pull the foot off the ground")
        if isinstance(chosen, Termination):
            return chosen
        reset = buffered(self.system.reset(chosen, mode, ends_step=False))
        return chosen, reset(z_minus, self._dynamics.p)[0].copy()

    def impact(self, mode: Mode, transition: Transition, z_minus: Array) -> ImpactRecord | Termination:
        """The impact at the end of a step, from ``mode`` and state ``z_minus``; the feet are swapped after it.

        If the step ends without a landing, the record has no impulse.
        """
        assert transition.reset is not None
        if not transition.reset.swaps:
            return impact_record(self._dynamics, mode.contact, z_minus, mode, lands=False)
        if fault := self._push_fault(mode, z_minus):
            return fault
        landed = self._clear_impact(mode, transition.candidates, z_minus)
        if landed is None:
            landings = self.system.transitions.landings(transition, mode)
            chosen = self._impact(mode, tuple(landings), {transition.reset.of}, z_minus)
            if isinstance(chosen, Termination):
                return chosen
            landed = landings.get(chosen) or self.system.walker.swapped(chosen)  # others may have landed as well
        return impact_record(self._dynamics, landed.contact, z_minus, mode, lands=True)

    def _pushing(self, mode: Mode) -> tuple[str, ...]:
        """The contacts that push off if another one lands in a mode."""
        return tuple(name for name in self.system.walker.pushing() if name in mode.touching)

    def _push(self, mode: Mode, z_minus: Array) -> tuple[Array, ...]:
        """Impulses of the contacts that push off, their work, and the rates just after the push."""
        if mode not in self._pushes:
            self._pushes[mode] = Buffers(self.system.push(mode))
        return self._pushes[mode](z_minus, self._dynamics.p)

    def _push_fault(self, mode: Mode, z_minus: Array) -> Termination | None:
        """The end of the motion if a contact that pushes off slips; None if it does not."""
        pushing = self._pushing(mode)
        impulses = self._push(mode, z_minus)[0].reshape(-1, 2).tolist() if pushing else []
        for name, (p_t, p_n) in zip(pushing, impulses, strict=True):
            friction = self._forces.friction.static[self._number[name]]
            if not is_within_cone(p_t, p_n, friction):
                reason = f"its push needs friction {abs(p_t) / p_n:.6g}, has {friction:g}"
                who = self.system.walker.called(name)
                return Termination(Ending.PUSH_SLIPS, f"{who} that pushes off slips: {reason}")
        return None

    def _clear_impact(self, mode: Mode, candidates: tuple[Mode, ...], z_minus: Array) -> Mode | None:
        """The mode after an impact of a lone foot, if rounding cannot change it; None if all modes must be examined."""
        if self.clear is None or not grounded(candidates):
            return None
        if (mode, candidates) not in self._impacts:
            struck = candidates
            if not candidates[0].locked:  # no stop has locked, so that the swing foot has landed
                struck = tuple(self.system.walker.swapped(after.contact) for after in candidates)
            self._impacts[mode, candidates] = Buffers(self.system.impacts(mode, *struck))
        impacts, approach = self._impacts[mode, candidates](z_minus, self._dynamics.p)
        rows = impacts.reshape(len(candidates), -1)[:, self.system.n_z :].tolist()
        consistent, clear = self.clear.impact(candidates, rows, approach.item())
        return candidates[consistent.index(True)] if clear else None

    def _impact(
        self, mode: Mode, candidates: tuple[Mode, ...], landing: set[str], z_minus: Array
    ) -> Mode | Termination:
        """The mode after the only consistent impact, in which contacts that land at the same instant take part.

        Parameters
        ----------
        mode : mode before the impact.
        candidates : possible modes after it, with the names of the contacts before it.
        landing : the contact that lands; empty for the impact of a stop.
        """
        if len(candidates) == 1 and not landing:  # a stop locks in flight
            return candidates[0]
        heights, mechanics = self._points(z_minus, self._dynamics.p)[0].copy(), self._forces.mechanics(z_minus)
        if landing and self._pushing(mode):
            mechanics = mechanics._replace(dq=self._forces.natural_rates(self._push(mode, z_minus)[2]))
        before, size, number = mechanics.velocities, TOUCHING * self._dynamics.scales.length, self._number
        if fault := self._arrival_fault(landing, heights, before):
            return fault
        massless, possible = landing & {*self._massless}, {*self.system.walker.foot_modes()}
        touching = {name for candidate in candidates for name in candidate.touching}
        for name in {*self._names} - touching - {*self._massless}:
            if abs(heights[number[name]]) <= size and before[number[name], 1] < -TOUCHING:
                landing = landing | {name}
                touching.add(name)
                joined = (m.with_states({name: state}) for m in candidates for state in AT_REST)
                candidates = tuple(mode for mode in joined if mode in candidates or mode.contact in possible)
        conceivable = [candidate for candidate in candidates if massless <= {*candidate.touching}]
        if len(conceivable) == 1 and landing == massless:  # a massless contact lands without an impulse
            return conceivable[0]
        known = [candidate for candidate in conceivable if not self._forces.is_undetermined(candidate)]
        kinetic = self._forces.friction.kinetic
        if self._frictionless:
            kinetic = np.where([name in landing for name in self._names], 0.0, kinetic)
        found = self._forces.impacts(mechanics, known, kinetic)
        consistent = self._consistent_impacts(found, touching, mechanics.J)
        options = [_Option(k, known[k], mechanics.dq + found.motion[k]) for k in consistent]
        different = self._different(options)
        is_wedged = len(touching) == 1 and not landing
        if len(different) == 1 or (different and (self._stick_first or is_wedged)):
            chosen = self._preferred(different)
            after, is_regular = chosen.mode, not chosen.mode.slips
            regularity = 1.0 if is_regular else self._forces.regularity(mechanics, (after,), kinetic).item()
            if regularity <= 0:
                reason = f"the impulses have no unique solution: regularity is {regularity:.4g} after {after.brief}"
                return Termination(Ending.PAINLEVE, reason)
            for name in {*mode.touching} - touching:  # these feet have to leave the ground
                lift = found.contact[chosen.index, number[name], 1] * self._speed
                if lift <= 0:
                    reason = f"the former stance foot would move into the ground at {lift:.6g} m/s"
                    return Termination(Ending.DOUBLE_SUPPORT, f"{reason} after an impact with {after.brief}")
            return after
        if different:
            names = " and ".join(option.mode.brief for option in different)
            return Termination(Ending.IMPACT_AMBIGUOUS, f"several impacts are consistent: {names}")
        if len(known) < len(conceivable):
            reason = "contacts of different friction slip together, so that the impulses do not determine the impact"
            return Termination(Ending.UNDETERMINED, reason)
        return Termination(Ending.IMPACT_INCONSISTENT, f"no impact of {', '.join(sorted(touching))} is consistent")

    def _arrival_fault(self, landing: set[str], heights: Array, velocities: Array) -> Termination | None:
        """The end of the motion if a contact would land from below the ground; None if none does."""
        for name in landing - {*self.system.walker.placed_contacts()}:  # these only get their positions when they land
            contact, k = self.system.walker.called(name), self._number[name]
            if heights[k] < -TOUCHING * self._dynamics.scales.length:
                where = f"it is {-heights[k]:.3g} m below the ground where it begins to count as a contact"
                return Termination(Ending.SCUFFING, f"{contact} scuffs: {where}")
            if velocities[k, 1] >= -EDGE:
                velocity = f"{velocities[k, 1] * self._speed:.6g} m/s"
                reason = f"{contact} does not come down: its normal velocity is {velocity}"
                return Termination(Ending.IMPACT_INCONSISTENT, f"{reason}, so that it touches the ground from below")
        return None

    def _consistent_impacts(self, found: Solutions, touching: set[str], J: Array) -> list[int]:
        """Indices of the impacts after which the states of the contacts agree with their impulses and velocities."""
        modes, touches = found.modes, np.array([name in touching for name in self._names])
        slips, sticks, normal, tangential = modes.slip != 0, modes.sticks, found.normal, found.tangential
        bound = self._forces.friction.static * normal * (1 + EDGE) + EDGE
        agrees = (
            np.isfinite(found.motion).all(axis=1)
            & ((found.contact[:, :, 1] > EDGE) | ~touches | modes.closed).all(axis=1)
            & ((normal > -EDGE) | ~(sticks | slips)).all(axis=1)
            & ((modes.slip * found.contact[:, :, 0] > EDGE) | ~slips).all(axis=1)
            & ((np.abs(tangential) <= bound) | ~sticks).all(axis=1)
        )

        def shares_agree(k: int) -> bool:
            values = self._forces.margins(modes.modes[k], tangential[k], normal[k], J)[1]
            return all(value >= -EDGE for value in values)

        return [k for k in np.flatnonzero(agrees).tolist() if not modes.shared[k].any() or shares_agree(k)]

    def _conceivable(self, found: Solutions, touching: set[str]) -> list[int]:
        """Indices of the motions without a force or an acceleration that clearly has the wrong sign."""
        modes, friction = found.modes, self._forces.friction
        lowest = np.where(modes.own, found.normal, 0)
        lowest = np.minimum(
            lowest, np.where(modes.sticks, friction.static * found.normal - np.abs(found.tangential), 0)
        )
        off = ~modes.closed & ~self._weightless & np.array([name in touching for name in self._names])
        lowest = np.minimum(lowest, np.where(off, found.contact[:, :, 1], 0))
        return np.flatnonzero(np.all(lowest > -HOPELESS, axis=1)).tolist()  # NaN does not pass either

    def _is_consistent(
        self, instant: ContactInstant, found: Solutions, k: int, touching: set[str], law_mode: Mode
    ) -> bool:
        """Whether the k-th mode is consistent at this instant."""
        mode = found.modes.modes[k]
        motion = _Motion(instant, mode, law_mode, found, k)
        lifted = [name for name in touching if name not in mode.touching]
        return (
            not any(motion.slips_back(self._number[name]) for name, slip in mode.directions.items() if slip)
            and all(
                self._is_pulled(instant, mode.with_states({name: "stick"}), name, law_mode, found)
                if name in self._massless
                else motion.separates(self._number[name])
                for name in lifted
            )
            and not motion.lacks_force()  # the last condition, because rates of forces take the most time
        )

    def _is_pulled(self, instant: ContactInstant, closed: Mode, name: str, law_mode: Mode, found: Solutions) -> bool:
        """Whether the ground would have to pull at a massless contact if it were closed, which it is in ``closed``."""
        modes = found.modes.modes
        k, found = (modes.index(closed), found) if closed in modes else (0, instant.motions((closed,), law_mode))
        return _Motion(instant, closed, law_mode, found, k).lacks_force(f"normal_force.{name}")

    def _different(self, options: list[_Option]) -> list[_Option]:
        """The options without those that move the walker like an earlier one."""
        different: list[_Option] = []
        for option in options:
            close = ALIKE * (1 + np.abs(option.motion).max())
            if all(np.abs(option.motion - other.motion).max() > close for other in different):
                different.append(option)
        return different

    def _preferred(self, different: list[_Option]) -> _Option:
        """The motion in which the most contacts stick."""
        return max(different, key=lambda option: sum(state == "stick" for state in option.mode.contacts.values()))


def margin_and_rate(dynamics: Dynamics, name: str, mode: Mode, z: Array) -> tuple[float, float]:
    """A margin of a mode and its rate at the start of a motion, in SI."""
    system = dynamics.system
    row = system.transitions.margin_names(mode).index(name)
    margins, rates = buffered(system.events(mode))(0.0, z, dynamics.p, system.data(0))
    return float(margins[row]), float(rates[row])
