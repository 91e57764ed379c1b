"""What the foot does where more than one thing is possible: at rest on the ground, and at an impact.

At rest, with f_stick the force that holds the foot, mu f_n + s f_t its margin to slip with sign s, C the apparent
mass of the foot and a_n the normal acceleration that the foot would have without contact,

    stick             f_n > 0 and both margins positive
    slip with sign s  its margin negative, C_tt + mu s C_nt > 0, and f_n > 0 while slipping
    lift off          a_n > 0, which is f_n (C_tt + mu s C_nt) < 0 of either slip

exactly at the edge of the cone the derivatives of the margin decide. At an impact, Gamus & Or (2013), eqs (9)-(11),
the swing foot comes down, v_n < 0 just before it, and

    stick             F_n > 0 and |F_t| <= mu F_n
    slip with sign s  F_n > 0 and s v_t > 0 just after it

where F_n (C_tt + mu s C_nt) = -det(C) v_n, so that no impact slips in the paradox of Painleve. All of them are
checked; where none or several hold, the motion ends by name.
"""

from dataclasses import dataclass
from math import isfinite
from typing import NamedTuple

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait.trajectory import Ending, ImpactRecord
from gaitopt.model.buffered import Buffers
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.margins import ONSETS, margin_names
from gaitopt.model.modes import ImpactLaw, Mode
from gaitopt.simulation.events import EDGE, LOOK, Point, bends_decide, falls, is_touchdown
from gaitopt.simulation.natural import PAINLEVE, PointFunctions, units


@dataclass(frozen=True, slots=True)
class Termination:
    """A motion that cannot go on: the named ending, and the reason in words."""

    ending: Ending
    reason: str


NORMAL_FORCE = margin_names(Mode.STICK).index("normal_force")
"""Its place among the margins of every mode on the ground."""
CONE = {name: margin_names(Mode.STICK).index(name) for name in ONSETS}
"""Places of the margins of the cone in stick."""
CANNOT_SLIP = Termination(Ending.PAINLEVE, "a foot without mass cannot slip, and friction does not hold it")


class _Candidate(NamedTuple):
    """One conceivable impact, and what tells whether it contradicts itself."""

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
        self._system = system = dynamics.system
        self._law, self._p = system.law, dynamics.p
        self._friction, self._drops = dynamics.static_friction, dynamics.friction_drops
        self._n_x = system.n_shape
        self._contacts = tuple(contact for contact in system.walker.contacts() if contact is not Mode.FLIGHT)
        self._units = units(dynamics)
        self._points = PointFunctions(dynamics, self._units)
        self._push = Buffers(system.push)
        self._released = system.walker.released(Mode.STICK)
        self._ground: dict[Mode, tuple[Mode, ...]] = {}
        self._impacts: dict[tuple[Mode, ...], Buffers] = {}

    def mode_at_rest(self, mode: Mode, t: float, z: Array, data: Array) -> Mode | Termination:
        """Mode of a foot that is at rest (dx = 0) at time ``t`` in state ``z`` on the segment with ``data``.

        Parameters
        ----------
        mode : any with the states of the stops.
        """
        stuck, *slipping = ground = self._on_ground(mode)
        tau, zeta = t / self._units.time, z / self._units.state
        point, margins = self._points.at_rest(stuck, ground[1:], tau, zeta, data)
        if not all(map(isfinite, point.margins)):
            return Termination(Ending.NUMERICAL, "the contact forces are not finite")
        leaves = self._leaves(stuck, point, data)
        forces = {slip: (own[NORMAL_FORCE], own[PAINLEVE]) for slip, own in zip(slipping, margins, strict=True)}
        possible = [stuck] if not _pulled(point) and not leaves else []
        possible += [
            slip for slip, (force, mass) in forces.items() if slip.contact in leaves and mass > 0 and force > 0
        ]
        lifts = any(force * mass < 0 for force, mass in forces.values())
        if lifts and not possible and self._system.walker.flies:
            return mode.with_contact(Mode.FLIGHT)
        if lifts and not possible:
            return Termination(Ending.LIFT_OFF, "no mode keeps the foot on the ground")
        if len(possible) == 1 and not lifts:
            return possible[0]
        if not slipping:
            return CANNOT_SLIP
        choices = " and ".join([*possible, *(["lift-off"] if lifts else [])]) or "neither a mode nor lift-off"
        values = " and ".join(f"{self._painleve(m, t, z, data):.6g} kg in {m}" for m in slipping)
        return Termination(Ending.PAINLEVE, f"{choices} possible at once: C_tt + mu s C_nt is {values}")

    def impact(self, z_minus: Array) -> ImpactRecord | Termination:
        """The impact at touchdown in state ``z_minus``."""
        if self._system.walker.pushes:
            p_t, p_n = self._push(z_minus, self._p)[0]
            if abs(p_t) > self._friction * p_n * (1 + EDGE):
                words = f"the foot that pushes off slips: its push needs friction {abs(p_t) / p_n:.6g}"
                return Termination(Ending.PUSH_SLIPS, f"{words}, has {self._friction:g}")
        candidates, v_n = self._candidates(self._on_ground(self._released), z_minus)
        if v_n >= -EDGE * self._units.speed:
            words = f"the swing foot does not come down: its normal velocity is {v_n:.6g} m/s"
            return Termination(Ending.IMPACT_INCONSISTENT, f"{words}, so that it touches the ground from below")
        if self._system.walker.massless_feet:
            return self._record(candidates[0], candidates[0], z_minus)
        chosen = self._consistent_one(candidates)
        return chosen if isinstance(chosen, Termination) else self._record(*chosen, z_minus)

    def strike(self, mode: Mode, stop: str, z_minus: Array) -> tuple[Mode, Array] | Termination:
        """What the foot does just after a stop has locked in state ``z_minus``, and the state there."""
        locked = mode.with_next(stop)
        if mode.flies:
            return locked, self._candidates((locked,), z_minus)[0][0].z_plus
        candidates, _ = self._candidates(self._on_ground(locked), z_minus)
        if self._system.walker.flies and not any(map(self._consistent, candidates)):
            (flight,), _ = self._candidates((locked.with_contact(Mode.FLIGHT),), z_minus)
            if flight.lift_velocity > 0:
                return flight.mode, flight.z_plus
        if all(candidate.f_n < 0 for candidate in candidates):
            words = f"the stop {stop} would pull the stance foot off the ground"
            return Termination(Ending.LIFT_OFF, f"{words}: {'; '.join(map(str, candidates))}")
        chosen = self._consistent_one(candidates)
        return chosen if isinstance(chosen, Termination) else (chosen[0].mode, chosen[0].z_plus)

    def _consistent_one(self, candidates: list[_Candidate]) -> tuple[_Candidate, _Candidate] | Termination:
        """The only impact that does not contradict itself, and the one that would hold the foot."""
        consistent, stick = [candidate for candidate in candidates if self._consistent(candidate)], candidates[0]
        precedence = self._law is ImpactLaw.FRICTIONLESS or self._drops
        if stick in consistent and (precedence or self._at_edge(stick)):
            consistent = [stick]  # at the edge a slip has no velocity: it is the same impact
        if len(consistent) == 1:
            return consistent[0], stick
        ending = Ending.IMPACT_AMBIGUOUS if consistent else Ending.IMPACT_INCONSISTENT
        verdict = " and ".join(c.mode for c in consistent) + " are" if consistent else "no impact is"
        numbers = "; ".join(map(str, candidates))
        return Termination(ending, f"{verdict} consistent at mu = {self._friction:g}: {numbers}")

    def touches_down(self, mode: Mode, t: float, z: Array, data: Array) -> bool:
        """Whether the swing foot touches down at this very time, which ends an arc for another reason."""
        if mode.free:
            return False
        point = self._points(mode, t / self._units.time, z / self._units.state, data)
        touchdown = margin_names(mode).index("touchdown")
        return bool(is_touchdown(point.margins[touchdown], point.rates[touchdown]))

    def _leaves(self, stuck: Mode, point: Point, data: Array) -> set[Mode]:
        """Which slips the foot is pushed into: the margins of the cone that do not hold for longer than an instant."""
        margins, rates = point.margins, point.rates
        near = [name for name, k in CONE.items() if margins[k] <= EDGE]
        decided = not any(bends_decide(margins[CONE[name]], rates[CONE[name]]) for name in near)
        later = rates if decided else self._points(stuck, *point.shifted(LOOK), data).rates
        rows = ((name, margins[CONE[name]], rates[CONE[name]], later[CONE[name]]) for name in near)
        return {ONSETS[name] for name, m, rate, end in rows if falls(name, m, rate, (end - rate) / LOOK)}

    def _record(self, chosen: _Candidate, stick: _Candidate, z_minus: Array) -> ImpactRecord | Termination:
        if chosen.lift_velocity <= 0:
            words = f"the former stance foot would move into the ground at {chosen.lift_velocity:.6g} m/s"
            return Termination(Ending.DOUBLE_SUPPORT, f"{words} after an impact with {chosen.mode}")
        state = chosen.z_plus.copy()
        state[self._n_x] = 0.0
        return ImpactRecord(
            mode=chosen.mode.contact,
            state=state,
            step_length=float(chosen.z_plus[self._n_x]),
            impulse=chosen.impulse,
            stick_impulse=stick.impulse,
            push_work=float(self._push(z_minus, self._p)[1][0]) if self._system.walker.pushes else 0.0,
        )

    def _consistent(self, candidate: _Candidate) -> bool:
        f_t, f_n = candidate.f_t, candidate.f_n
        if candidate.mode.sticks:
            return f_n > 0 and abs(f_t) <= self._friction * f_n * (1 + EDGE)
        return f_n > 0 and candidate.mode.direction * candidate.slip_velocity > 0

    def _at_edge(self, stick: _Candidate) -> bool:
        return abs(stick.f_t) >= self._friction * stick.f_n * (1 - EDGE)

    def _on_ground(self, mode: Mode) -> tuple[Mode, ...]:
        """What a foot on the ground can do with the stops and switches as they are, stick first."""
        if mode not in self._ground:
            self._ground[mode] = tuple(mode.with_contact(contact) for contact in self._contacts)
        return self._ground[mode]

    def _candidates(self, modes: tuple[Mode, ...], z_minus: Array) -> tuple[list[_Candidate], float]:
        """Impacts of all of ``modes``, and the approach."""
        if modes not in self._impacts:
            self._impacts[modes] = Buffers(self._system.impacts(modes))
        impacts, approach = self._impacts[modes](z_minus, self._p)
        columns, n = impacts.reshape(len(modes), -1).copy(), self._system.n_z
        candidates = [_Candidate(mode, own[:n], *own[n:].tolist()) for mode, own in zip(modes, columns, strict=True)]
        return candidates, approach.item()

    def _painleve(self, mode: Mode, t: float, z: Array, data: Array) -> float:
        return float(self._system.margins(mode)(t, z, self._p, data)[PAINLEVE])


def _pulled(point: Point) -> bool:
    """Whether the ground would have to pull at the foot; at touchdown the force of a spring rises from zero."""
    force, rate = point.margins[NORMAL_FORCE], point.rates[NORMAL_FORCE]
    return force < -EDGE or (force <= EDGE and rate <= 0)
