"""Decisions about the stance foot: what it does when it is at rest, and after an impact.

A foot at rest is held by the force f_stick, mu f_n + s f_t is its margin to a slip with sign s, C the apparent mass of
the foot, and a_n its normal acceleration without contact:

    stick             f_n > 0 and both margins positive
    slip with sign s  its margin negative, C_tt + mu s C_nt > 0, and f_n > 0 while slipping
    lift off          a_n > 0, which is f_n (C_tt + mu s C_nt) < 0 of either slip, and no stick

Where friction wedges a foot in, it could stick as well as lift off. It sticks: the plastic impact, or the phase before,
has loaded it, and the force of a contact that yields a little goes on to that of sticking. At the edge of the cone the
derivatives of the margin decide. At an impact the swing foot comes down, v_n < 0, and by Gamus & Or (2013), eqs
(9)-(11),

    stick             F_n > 0 and |F_t| <= mu F_n
    slip with sign s  F_n > 0 and s v_t > 0 just after it

where F_n (C_tt + mu s C_nt) = -det(C) v_n, so that no impact slips in the paradox of Painleve. All candidates are
checked; where none is consistent, or several are, the motion ends with a named ending.
"""

from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait.trajectory import ImpactRecord
from gaitopt.model.buffered import Buffers, buffered
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.transitions import CANNOT_SLIP, CONE, Ending, Transition, grounded
from gaitopt.simulation.events import AT_REST, EDGE, LOOK_AHEAD, Point, bends_decide, falls_at_start
from gaitopt.simulation.natural import NaturalDynamics


@dataclass(frozen=True, slots=True)
class Termination:
    """The end of a motion that cannot continue, and the reason in words."""

    ending: Ending
    reason: str


class _Candidate(NamedTuple):
    """A conceivable impact."""

    mode: Mode
    z_plus: Array
    f_t: float
    f_n: float
    slip_velocity: float
    lift_velocity: float
    painleve: float

    @property
    def impulse(self) -> Array:
        """(F_t, F_n) [N s]."""
        return np.array([self.f_t, self.f_n])

    def __str__(self) -> str:
        if self.mode.sticks:
            return f"stick needs F_t = {self.f_t:.6g}, F_n = {self.f_n:.6g} N s"
        return (
            f"{self.mode} has F_n = {self.f_n:.6g} N s, v_t = {self.slip_velocity:.6g} m/s, "
            f"C_tt + mu s C_nt = {self.painleve:.6g} kg"
        )


class ContactResolver:
    """Decides about the foot of one system at fixed parameters.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self._dynamics, self._system, self._natural = dynamics, dynamics.system, NaturalDynamics(dynamics)
        self._friction = dynamics.static_friction
        self._stick_first = dynamics.stick_comes_first
        table = dynamics.system.transitions
        stuck = table.margin_names(Mode.STICK)
        self._normal_force, self._cone = stuck.index("normal_force"), {m: stuck.index(CONE[m]) for m in CONE}
        self._painleve = table.margin_names(Mode.SLIP_FORWARD).index("painleve")
        self._push = Buffers(dynamics.system.push)
        self._impacts: dict[tuple[Mode, ...], Buffers] = {}

    def settled(self, z: Array, *, at_rest: bool) -> Array:
        """A state with a slip velocity of exactly zero instead of its rounding, where the foot is at rest or nearly."""
        if not at_rest and abs(z[-1]) > AT_REST * self._dynamics.scales.speed:
            return z
        z = z.copy()
        z[-1] = 0.0
        return z

    def below_ground(self, z: Array) -> str | None:
        """Message about a contact below the ground; the foot is on it."""

    def start(self, z: Array, *, anywhere: bool) -> tuple[Mode, Transition | None] | Termination:
        """The mode in which a motion starts if the foot at rest sticks; no contact lands there.

        Parameters
        ----------
        anywhere : whether the state may be any, not only one just after an impact.
        """
        stick, *slips = self._system.transitions.landed
        if anywhere and (stick.stops or self._system.walker.flies):
            mode = self._any_mode(z)
            return mode if isinstance(mode, Termination) else (mode, None)
        if z[-1] == 0:
            return stick, None
        following = [mode for mode in slips if mode.direction * z[-1] > 0]
        return (following[0], None) if following else Termination(Ending.PAINLEVE, CANNOT_SLIP)

    def following(self, transition: Transition, t: float, z: Array, segment: int) -> Mode | Termination:
        """The mode after an event without a reset: forces decide about a foot at rest.

        A slip whose foot a jump of the torques lifts off ends with the first event of the next arc.
        """
        if not transition.at_rest:
            return transition.candidates[0]
        return self.mode_at_rest(transition.candidates, t, z, segment)

    def mode_at_rest(self, candidates: tuple[Mode, ...], t: float, z: Array, segment: int) -> Mode | Termination:
        """Mode of a foot that is at rest (dx = 0) at time ``t`` in state ``z`` on a segment of the control.

        Parameters
        ----------
        candidates : what the foot can do, see ``Transitions.at_rest``; stick first.
        """
        stuck, *slipping = ground = grounded(candidates)
        tau, zeta = t / self._natural.time, z / self._natural.state
        point, margins = self._natural.rest(stuck, slipping, segment, tau, zeta)
        if not all(map(isfinite, point.margins)):
            return Termination(Ending.NUMERICAL, "the contact forces are not finite")
        begins = self._slips_that_begin(stuck, point, segment)
        # the ground would have to pull at the foot; at touchdown the force of a spring rises from zero
        force, rate = point.margins[self._normal_force], point.rates[self._normal_force]
        pulled = force < -EDGE or (force <= EDGE and rate <= 0)
        slips = [
            (slip, values[self._normal_force], values[self._painleve])
            for slip, values in zip(slipping, margins, strict=True)
        ]
        possible = [] if pulled or begins else [stuck]
        possible += [slip for slip, f_n, mass in slips if slip.contact in begins and mass > 0 and f_n > 0]
        lifts = any(f_n * mass < 0 for _, f_n, mass in slips)
        if lifts and not possible:
            flight = next((mode for mode in candidates if mode not in ground), None)
            return flight or Termination(Ending.LIFT_OFF, "no mode keeps the foot on the ground")
        if len(possible) == 1:  # a loaded foot stays on the ground, where it could also have been let go
            return possible[0]
        if not slipping:
            return Termination(Ending.PAINLEVE, CANNOT_SLIP)
        choices = " and ".join(possible) or "neither a mode nor lift-off"
        data, p = self._system.data(segment), self._dynamics.p
        masses = ((slip, self._system.margins(slip)(t, z, p, data)[self._painleve]) for slip in slipping)
        values = " and ".join(f"{float(mass):.6g} kg in {slip}" for slip, mass in masses)
        return Termination(Ending.PAINLEVE, f"{choices} possible at once: C_tt + mu s C_nt is {values}")

    def impact(self, mode: Mode, transition: Transition, z_minus: Array) -> ImpactRecord | Termination:
        """The impact that ends a step in ``mode`` and state ``z_minus``."""
        walker, push_work = self._system.walker, 0.0
        if walker.pushes:
            (p_t, p_n), work = self._push(z_minus, self._dynamics.p)
            if not is_within_cone(p_t, p_n, self._friction):
                words = f"the foot that pushes off slips: its push needs friction {abs(p_t) / p_n:.6g}"
                return Termination(Ending.PUSH_SLIPS, f"{words}, has {self._friction:g}")
            push_work = work.item()
        candidates, v_n = self._candidates(transition.candidates, z_minus)
        if not comes_down(v_n, self._natural.speed):
            words = f"the swing foot does not come down: its normal velocity is {v_n:.6g} m/s"
            return Termination(Ending.IMPACT_INCONSISTENT, f"{words}, so that it touches the ground from below")
        has_mass = "impulse" in self._system.transitions.of_impact(Mode.STICK)
        chosen = self._consistent_one(candidates) if has_mass else candidates[0]
        if isinstance(chosen, Termination):
            return chosen
        if chosen.lift_velocity <= 0:
            words = f"the former stance foot would move into the ground at {chosen.lift_velocity:.6g} m/s"
            return Termination(Ending.DOUBLE_SUPPORT, f"{words} after an impact with {chosen.mode}")
        x, state = self._system.n_shape, chosen.z_plus.copy()
        state[x] = 0.0
        return ImpactRecord(
            mode=chosen.mode.contact,
            state=state,
            step_length=float(chosen.z_plus[x]),
            impulse=chosen.impulse,
            stick_impulse=candidates[0].impulse,
            push_work=push_work,
        )

    def strike(self, mode: Mode, transition: Transition, z_minus: Array) -> tuple[Mode, Array] | Termination:
        """Mode and state just after a stop has locked in ``mode`` and state ``z_minus``."""
        ground = grounded(transition.candidates)
        flights = tuple(mode for mode in transition.candidates if mode not in ground)
        if not ground:
            return flights[0], self._candidates(flights, z_minus)[0][0].z_plus
        candidates, _ = self._candidates(ground, z_minus)
        if flights and not any(map(self._is_consistent, candidates)):
            (flight,), _ = self._candidates(flights, z_minus)
            if flight.lift_velocity > 0:
                return flight.mode, flight.z_plus
        if all(candidate.f_n < 0 for candidate in candidates):
            assert transition.reset is not None
            words = f"the stop {transition.reset.of} would pull the stance foot off the ground"
            return Termination(Ending.LIFT_OFF, f"{words}: {'; '.join(map(str, candidates))}")
        chosen = self._consistent_one(candidates)
        return chosen if isinstance(chosen, Termination) else (chosen.mode, chosen.z_plus)

    def _consistent_one(self, candidates: list[_Candidate]) -> _Candidate | Termination:
        """The only consistent impact; the first candidate sticks."""
        consistent, stick = [candidate for candidate in candidates if self._is_consistent(candidate)], candidates[0]
        if stick in consistent and (self._stick_first or is_at_edge(stick.f_t, stick.f_n, self._friction)):
            return stick  # at the edge a slip has no velocity: it is the same impact
        if len(consistent) == 1:
            return consistent[0]
        ending = Ending.IMPACT_AMBIGUOUS if consistent else Ending.IMPACT_INCONSISTENT
        verdict = " and ".join(c.mode for c in consistent) + " are" if consistent else "no impact is"
        numbers = "; ".join(map(str, candidates))
        return Termination(ending, f"{verdict} consistent at mu = {self._friction:g}: {numbers}")

    def _is_consistent(self, candidate: _Candidate) -> bool:
        mode, f_t, f_n = candidate.mode, candidate.f_t, candidate.f_n
        return bool(is_consistent_impact(mode, f_t, f_n, candidate.slip_velocity, self._friction))

    def _candidates(self, modes: tuple[Mode, ...], z_minus: Array) -> tuple[list[_Candidate], float]:
        """Impacts with each of ``modes`` after them, and the normal velocity of the swing foot before them."""
        if modes not in self._impacts:
            self._impacts[modes] = Buffers(self._system.impacts(*modes))
        impacts, approach = self._impacts[modes](z_minus, self._dynamics.p)
        columns, n = impacts.reshape(len(modes), -1).copy(), self._system.n_z
        candidates = [_Candidate(mode, row[:n], *row[n:].tolist()) for mode, row in zip(modes, columns, strict=True)]
        return candidates, approach.item()

    def _any_mode(self, z: Array) -> Mode | Termination:
        """The mode of any state of a walker with flight, stops or switches: forces decide about a foot at rest.

        A stop is locked where its gap and the rate of that are zero; switches are as after a landing. A massless foot
        is in flight where the ground would have to pull at it.
        """
        landed, names, scales = self._system.transitions.landed[0], self._system.state_names, self._dynamics.scales
        state = dict(zip(names, z.tolist(), strict=True))
        lifted = state.get("y", 0.0) > AT_REST * scales.length or state.get("dy", 0.0) > AT_REST * scales.speed
        if self._system.walker.massless_feet:  # on the ground the force would pull
            value, rate = margin_and_rate(self._dynamics, "normal_force", landed, z)
            lifted = value < -AT_REST * scales.force or (value <= AT_REST * scales.force and rate < 0)
        contact = Mode.FLIGHT if lifted else Mode.slip(z[-1]) if z[-1] else Mode.STICK
        mode = Mode.of(contact, {name: "free" if word == "locked" else word for name, word in landed.stops.items()})
        known = {mode.key: mode for mode in self._system.walker.modes()}
        for stop in mode.free:
            locked = Mode.of(contact, {**mode.stops, stop: "locked"})
            free = mode if mode.key in known else next((m for m in known.values() if stop in m.free), None)
            if free is None or locked.key not in known:
                continue
            gap, rate = margin_and_rate(self._dynamics, stop, free, z)
            if abs(gap) <= AT_REST and abs(rate) * scales.time <= AT_REST:
                mode = locked
        if mode.key not in known:
            return Termination(Ending.CONTACT_INCONSISTENT, f"the walker has no mode {mode.brief}")
        return mode

    def _slips_that_begin(self, stuck: Mode, point: Point, segment: int) -> set[Mode]:
        """The slips whose margin of the cone is violated for longer than an instant."""
        margins, rates = point.margins, point.rates
        near = {slip: k for slip, k in self._cone.items() if margins[k] <= EDGE}
        decided = not any(bends_decide(margins[k], rates[k]) for k in near.values())
        ahead = rates if decided else self._natural.point(stuck, segment, *point.after(LOOK_AHEAD)).rates
        return {
            slip
            for slip, k in near.items()
            if falls_at_start(CONE[slip], margins[k], rates[k], (ahead[k] - rates[k]) / LOOK_AHEAD)
        }


def margin_and_rate(dynamics: Dynamics, name: str, mode: Mode, z: Array) -> tuple[float, float]:
    """A margin of a mode and its rate at the start of a motion, in SI."""
    system = dynamics.system
    row = system.transitions.margin_names(mode).index(name)
    margins, rates = buffered(system.events(mode))(0.0, z, dynamics.p, system.data(0))
    return float(margins[row]), float(rates[row])


def is_within_cone(f_t: Any, f_n: Any, friction: float) -> Any:
    """Whether friction can provide a force or an impulse, to within ``EDGE``; floats, or arrays of one shape."""
    return abs(f_t) <= friction * f_n * (1 + EDGE)


def is_at_edge(f_t: Any, f_n: Any, friction: float) -> Any:
    """Whether a force or an impulse lies on the edge of the friction cone; floats, or arrays of one shape."""
    return abs(abs(f_t) - friction * f_n) <= EDGE * abs(friction * f_n)


def is_consistent_impact(mode: Mode, f_t: Any, f_n: Any, slip_velocity: Any, friction: float) -> Any:
    """Whether an impact satisfies the friction law of the mode after it; floats, or arrays of one shape."""
    if mode.sticks:
        return (f_n > 0) & is_within_cone(f_t, f_n, friction)
    return (f_n > 0) & (mode.direction * slip_velocity > 0)


def comes_down(approach: Any, speed: float) -> Any:
    """Whether the swing foot moves towards the ground, in units of ``speed``; a float, or an array."""
    return approach < -EDGE * speed
