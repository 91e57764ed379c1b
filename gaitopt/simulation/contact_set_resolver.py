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
ends with a name where no combination is consistent, or several are. A mode whose ``regularity`` is not positive counts
like any other: it satisfies the laws of contact and friction, although not as their only solution.

While motions are compared, a control law that computes torques for contacts that are held holds all contacts that touch
just before. If the torques of the chosen mode differ, because a contact leaves, the mode is decided anew with these.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait.trajectory import ImpactRecord, impact_record
from gaitopt.model.buffered import Buffers, buffered
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import ImpactLaw
from gaitopt.model.modes import OFF, Mode
from gaitopt.model.section import TOUCHDOWN
from gaitopt.model.transitions import AT_REST, CONE, Ending, Transition
from gaitopt.simulation.contact_forces import ContactForces, ContactInstant, Solutions
from gaitopt.simulation.contact_resolver import Termination, margin_and_rate
from gaitopt.simulation.events import EDGE, LOOK_AHEAD, STEADY, bends_decide, falls_at_start

ALIKE = 1e-9
"""Motions are the same if their accelerations, or velocities, differ by less, in natural units."""
SLIPS = {str(mode) for mode in CONE}
AT_REST_TOO = 1e-11
"""A slip velocity below this, in natural units, is zero where another contact has just come to rest."""
TOUCHING = 1e-9
"""A contact of a given state is on the ground if its height is smaller, and stays there if its normal velocity is, in
natural units."""
HOPELESS = 1e-3
"""A force of the wrong sign that is larger than this part of the weight has it for longer than an instant: it would
have to change by the weight within a millionth of the unit of time."""


@dataclass(frozen=True, slots=True)
class _Option:
    """A consistent combination: the mode, and its accelerations or the rates after it in natural units."""

    mode: Mode
    motion: Array


class _Motion:
    """The k-th of the motions at an instant; its second derivatives are found from the motion a little later."""

    def __init__(self, instant: ContactInstant, mode: Mode, held: Mode, found: Solutions, k: int) -> None:
        self._instant, self._mode, self._held, self._found, self._k = instant, mode, held, found, k
        self._later: tuple[ContactInstant, Solutions] | None = None

    def slips_back(self, contact: int) -> bool:
        """Whether a contact that should slip moves to the other side."""
        slip = self._found.modes.slip[self._k, contact]
        margin, rate = slip * self._instant.velocities[contact, 0], slip * self._found.contact[self._k, contact, 0]
        if margin > AT_REST_TOO:
            return False
        margin, bend = min(margin, 0.0), 0.0  # at rest to within rounding
        if bends_decide(margin, rate):
            bend = (slip * self._ahead[1].contact[0, contact, 0] - rate) / LOOK_AHEAD
        return bool(falls_at_start("slip_velocity", margin, rate, bend))

    def lacks_force(self) -> bool:
        """Whether a contact would have to be pulled at, or held by more friction than there is."""
        names, margins = self._instant.margins(self._mode, self._held, self._found, self._k)
        for j, margin in enumerate(margins):
            if margin > EDGE:
                continue
            if not margin > -HOPELESS:
                return True
            rate, bend = self._instant.rates(self._mode, self._held, self._found.motion[self._k])[j], 0.0
            if bends_decide(margin, rate):
                later, motions = self._ahead
                bend = (later.rates(self._mode, self._held, motions.motion[0])[j] - rate) / LOOK_AHEAD
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
            self._later = moved, moved.motions((self._mode,), self._held)
        return self._later


class ContactSetResolver:
    """Decides about the contacts of one system at fixed parameters.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.

    Attributes
    ----------
    system : the walker under its control law.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self._dynamics, self.system = dynamics, dynamics.system
        scales = dynamics.scales
        self._speed, self._impulse = scales.speed, scales.impulse
        self._names = dynamics.system.walker.contacts
        self._place = {name: k for k, name in enumerate(self._names)}
        self._massless = dynamics.system.walker.massless_contacts
        self._weightless = np.array([name in self._massless for name in self._names])
        self._drops, self._stick_first = dynamics.friction_drops, dynamics.stick_comes_first
        self._frictionless = dynamics.system.law is ImpactLaw.FRICTIONLESS
        self._forces = ContactForces(dynamics)
        self._points = Buffers(dynamics.system.contact_points)

    def below_ground(self, z: Array) -> str | None:
        """Message about a contact that counts and is below the ground in a given state; None if there is none."""
        heights, _, counts = self._points(z, self._dynamics.p)
        for name, height, counted in zip(self._names, heights.tolist(), counts.tolist(), strict=True):
            if name not in self._massless and counted > 0 and height < -TOUCHING * self._dynamics.scales.length:
                return f"{name} is {-height:.6g} m below the ground at the start"
        return None

    def settled(self, z: Array, *, at_rest: bool) -> Array:
        """The state as it is: velocities of contacts are no coordinates."""
        return z

    def start(self, z: Array, *, anywhere: bool) -> tuple[Mode, Transition | None] | Termination:
        """What contacts do in a given state, with the row of the table if one of them is on the ground and comes down.

        Parameters
        ----------
        anywhere : whether the state may be any: stops are then locked whose gap and its rate are zero.
        """
        reason = self.below_ground(z)
        if reason is not None:
            return Termination(Ending.SCUFFING, reason)
        heights, velocities, counts = (values.copy() for values in self._points(z, self._dynamics.p))
        length, words, landing = self._dynamics.scales.length, dict[str, str](), list[str]()
        for k, (name, (v_t, v_n)) in enumerate(zip(self._names, velocities.reshape(-1, 2) / self._speed, strict=True)):
            grounded = abs(heights[k]) <= TOUCHING * length
            slip = "stick" if abs(v_t) <= TOUCHING else str(Mode.slip(v_t))
            words[name] = slip if grounded and abs(v_n) <= TOUCHING else OFF
            if grounded and v_n < -TOUCHING and counts[k] > 0 and name not in self._massless:
                landing.append(name)
        mode = self.system.walker.released(Mode.of_contacts(words))
        for stop in mode.free if anywhere else ():  # a landing has just released the stops
            gap, rate = margin_and_rate(self._dynamics, stop, mode, z)
            if abs(gap) <= TOUCHING and abs(rate) * self._dynamics.scales.time <= TOUCHING:
                mode = mode.with_next(stop)
        if not landing:
            return mode, None
        row = self.system.transitions.of(mode)[f"gap.{landing[0]}"]
        if row.ends_step:
            reason = f"{landing[0]} is on the ground and comes down where the step starts, which its landing ends"
            return Termination(Ending.IMPACT_INCONSISTENT, reason)
        return mode, row

    def following(self, transition: Transition, t: float, z: Array, segment: int) -> Mode | Termination:
        """The mode after an event without a reset: forces decide, unless there is one candidate."""
        if len(transition.candidates) == 1:
            return transition.candidates[0]
        return self.mode_at_rest(transition.candidates, t, z, segment)

    def mode_at_rest(self, candidates: tuple[Mode, ...], t: float, z: Array, segment: int) -> Mode | Termination:
        """The one of ``candidates`` that is consistent with the forces at time ``t`` in state ``z``."""
        instant = self._forces.at(t, z, segment)
        candidates = self._with_others_at_rest(candidates, instant.velocities)
        touching = {name for mode in candidates for name in mode.touching}
        held = candidates[0]
        if self._forces.law_depends_on_holding:
            held = held.with_states({name: "stick" if name in touching else OFF for name in self._names})
        while True:
            chosen = self._chosen(instant, candidates, touching, held)
            if isinstance(chosen, Termination) or not self._forces.law_depends_on_holding:
                return chosen
            if {*chosen.touching} == {*held.touching}:
                return chosen
            # within the phase the law holds fewer contacts, and its torques jump
            held = chosen.with_states(dict.fromkeys(chosen.touching, "stick"))
            candidates = tuple(mode for mode in candidates if {*mode.touching} <= {*chosen.touching})

    def _chosen(
        self, instant: ContactInstant, candidates: Sequence[Mode], touching: set[str], held: Mode
    ) -> Mode | Termination:
        """The only consistent one of some modes.

        Parameters
        ----------
        touching : contacts on the ground, which move away from it in the modes in which they are off.
        held : the contacts that the control law holds.
        """
        known = [mode for mode in candidates if not self._forces.is_undetermined(mode)]
        found = instant.motions(known, held)
        options = [
            _Option(known[k], found.motion[k])
            for k in self._conceivable(found, touching)
            if self._holds(instant, found, k, touching, held)
        ]
        different = self._different(options)
        if len(different) == 1 or (different and self._drops):
            return self._preferred(different).mode
        if different:
            names = " and ".join(option.mode.brief for option in different)
            return Termination(Ending.CONTACT_AMBIGUOUS, f"several motions are consistent: {names}")
        if len(known) < len(candidates):
            words = "contacts of different friction slip together, so that the forces do not determine the motion"
            return Termination(Ending.UNDETERMINED, words)
        among = f"none of {len(candidates)} combinations of {', '.join(sorted(touching)) or 'no contact'}"
        words = f"no motion is consistent with the contact forces: {among}"
        regularity = self._forces.regularity(instant.mechanics, known, self._forces.friction.kinetic)
        singular = [f"{mode.brief} {value:.4g}" for mode, value in zip(known, regularity, strict=True) if value <= EDGE]
        if singular:
            return Termination(Ending.PAINLEVE, f"{words}; regularity is not positive: {', '.join(singular)}")
        return Termination(Ending.CONTACT_INCONSISTENT, words)

    def _with_others_at_rest(self, candidates: tuple[Mode, ...], velocities: Array) -> tuple[Mode, ...]:
        """The candidates, and what contacts can do that come to rest at the same instant as another one."""
        for name in (name for k, name in enumerate(self._names) if abs(velocities[k, 0]) <= AT_REST_TOO):
            known = {mode.contacts[name] for mode in candidates}
            if known & SLIPS and not known >= {*AT_REST}:
                words = [mode.with_states({name: word}) for mode in candidates for word in AT_REST]
                candidates = tuple(dict.fromkeys(words))
        return candidates

    def strike(self, mode: Mode, transition: Transition, z_minus: Array) -> tuple[Mode, Array] | Termination:
        """Mode and state just after a contact has landed, or a stop has locked, in ``mode`` and state ``z_minus``.

        Forces then decide about the motion.
        """
        assert transition.reset is not None
        of = transition.reset.of
        landing = {of} & {*self._names}
        chosen = self._impact(transition.candidates, landing, z_minus)
        if isinstance(chosen, Termination):
            return chosen
        z_plus, _ = buffered(self.system.contact_impact(chosen, mode))(z_minus, self._dynamics.p)
        return chosen, z_plus.copy()

    def impact(self, mode: Mode, transition: Transition, z_minus: Array) -> ImpactRecord | Termination:
        """The end of a step in ``mode`` and state ``z_minus``: an impact with the feet swapped after it, or none."""
        assert transition.reset is not None
        if self.system.cycle_end != TOUCHDOWN:
            return impact_record(self._dynamics, mode.contact, z_minus, mode)
        held = [self.system.walker.held_in_impact(candidate.contact, mode) for candidate in transition.candidates]
        chosen = self._impact(held, {transition.reset.of}, z_minus)
        if isinstance(chosen, Termination):
            return chosen
        return impact_record(self._dynamics, self.system.walker.swapped(chosen.contact), z_minus, mode)

    def _impact(self, candidates: Iterable[Mode], landing: set[str], z_minus: Array) -> Mode | Termination:
        """The mode after the only consistent impact; contacts that arrive at the same instant take part.

        Parameters
        ----------
        landing : the contact that lands; empty for the impact of a stop.
        """
        heights, mechanics = self._points(z_minus, self._dynamics.p)[0].copy(), self._forces.mechanics(z_minus)
        before, size, place = mechanics.velocities, self._dynamics.scales.length, self._place
        massless = landing & {*self._massless}
        for name in landing - massless:
            if heights[place[name]] < -TOUCHING * size:
                depth = -heights[place[name]]
                words = f"{name} scuffs: it is {depth:.3g} m below the ground where it begins to count as a contact"
                return Termination(Ending.SCUFFING, words)
            if before[place[name], 1] >= -EDGE:
                words = f"{name} does not come down: its normal velocity is {before[place[name], 1]:.6g} sqrt(g l)"
                return Termination(Ending.IMPACT_INCONSISTENT, words)
        touching = {name for mode in candidates for name in mode.touching}
        for name in {*self._names} - touching - {*self._massless}:
            if abs(heights[place[name]]) <= TOUCHING * size and before[place[name], 1] < -TOUCHING:
                landing = landing | {name}
                touching.add(name)
                candidates = [mode.with_states({name: word}) for mode in candidates for word in AT_REST]
        conceivable = [mode for mode in candidates if massless <= {*mode.touching}]
        known = [mode for mode in conceivable if not self._forces.is_undetermined(mode)]
        kinetic = self._forces.friction.kinetic
        if self._frictionless:
            kinetic = np.where([name in landing for name in self._names], 0.0, kinetic)
        found = self._forces.impacts(mechanics, known, kinetic)
        options = [
            _Option(mode, mechanics.dq + found.motion[k])
            for k, mode in enumerate(known)
            if self._follows(found, k, touching, mechanics.J)
        ]
        different = self._different(options)
        if len(different) == 1 or (different and self._stick_first):
            chosen = self._preferred(different).mode
            regularity = self._forces.regularity(mechanics, (chosen,), kinetic).item() if chosen.slips else 1.0
            if regularity > 0:
                return chosen
            words = f"the impulses have no unique solution: regularity is {regularity:.4g} after {chosen.brief}"
            return Termination(Ending.PAINLEVE, words)
        if different:
            names = " and ".join(option.mode.brief for option in different)
            return Termination(Ending.IMPACT_AMBIGUOUS, f"several impacts are consistent: {names}")
        if len(known) < len(conceivable):
            words = "contacts of different friction slip together, so that the impulses do not determine the impact"
            return Termination(Ending.UNDETERMINED, words)
        return Termination(Ending.IMPACT_INCONSISTENT, f"no impact of {', '.join(sorted(touching))} is consistent")

    def _follows(self, found: Solutions, k: int, touching: set[str], J: Array) -> bool:
        """Whether what the contacts do after the k-th impact agrees with their impulses and velocities."""
        modes, touches = found.modes, np.array([name in touching for name in self._names])
        slip, closed, shared, sticks = modes.slip[k], modes.closed[k], modes.shared[k], modes.sticks[k]
        normal, tangential, after = found.normal[k], found.tangential[k], found.contact[k]
        if not np.all(np.isfinite(found.motion[k])):
            return False
        friction = self._forces.friction.static
        agrees = (
            np.all(after[touches & ~closed, 1] > EDGE)
            and np.all(normal[sticks | (slip != 0)] > -EDGE)
            and np.all((slip * after[:, 0])[slip != 0] > EDGE)
            and np.all((np.abs(tangential) <= friction * normal * (1 + EDGE) + EDGE)[sticks])
        )
        if not agrees or not shared.any():
            return bool(agrees)
        return all(value >= -EDGE for value in self._forces.margins(modes.modes[k], tangential, normal, J)[1])

    def _conceivable(self, found: Solutions, touching: set[str]) -> list[int]:
        """The motions without a force or an acceleration that is clearly of the wrong sign."""
        modes, friction = found.modes, self._forces.friction
        lowest = np.where(modes.own, found.normal, 0)
        lowest = np.minimum(
            lowest, np.where(modes.sticks, friction.static * found.normal - np.abs(found.tangential), 0)
        )
        off = ~modes.closed & ~self._weightless & np.array([name in touching for name in self._names])
        lowest = np.minimum(lowest, np.where(off, found.contact[:, :, 1], 0))
        return np.flatnonzero(np.all(lowest > -HOPELESS, axis=1)).tolist()  # neither do NaN pass

    def _holds(self, instant: ContactInstant, found: Solutions, k: int, touching: set[str], held: Mode) -> bool:
        """Whether the k-th mode is consistent at this instant."""
        mode = found.modes.modes[k]
        motion = _Motion(instant, mode, held, found, k)
        lifted = [name for name in touching if name not in mode.touching]
        return (
            not any(motion.slips_back(self._place[name]) for name, slip in mode.directions.items() if slip)
            and all(
                self._is_pulled(instant, mode.with_states({name: "stick"}), name, held, found)
                if name in self._massless
                else motion.separates(self._place[name])
                for name in lifted
            )
            and not motion.lacks_force()  # last, because rates of forces take the most time
        )

    def _is_pulled(self, instant: ContactInstant, closed: Mode, name: str, held: Mode, found: Solutions) -> bool:
        """Whether the ground would have to pull at a massless contact in a mode in which it is closed."""
        modes = found.modes.modes
        k, found = (modes.index(closed), found) if closed in modes else (0, instant.motions((closed,), held))
        names, margins = instant.margins(closed, held, found, k)
        j = names.index(f"normal_force.{name}")
        if margins[j] > EDGE:
            return False
        return bool(falls_at_start("normal_force", margins[j], instant.rates(closed, held, found.motion[k])[j]))

    def _different(self, options: list[_Option]) -> list[_Option]:
        """The options that move the walker differently, the first of those that move it alike."""
        different: list[_Option] = []
        for option in options:
            close = ALIKE * (1 + np.abs(option.motion).max())
            if all(np.abs(option.motion - other.motion).max() > close for other in different):
                different.append(option)
        return different

    def _preferred(self, different: list[_Option]) -> _Option:
        """The motion in which the most contacts stick."""
        return max(different, key=lambda option: sum(word == "stick" for word in option.mode.contacts.values()))
