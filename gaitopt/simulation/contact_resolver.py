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
from typing import Any, NamedTuple

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait.trajectory import ImpactRecord
from gaitopt.model.buffered import Buffers
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import ImpactLaw
from gaitopt.model.modes import Mode
from gaitopt.model.transitions import CANNOT_SLIP, CONE, Ending, Transition, grounded
from gaitopt.simulation.events import EDGE, LOOK, Point, bends_decide, falls, is_touchdown
from gaitopt.simulation.natural import PointFunctions, Units, units


@dataclass(frozen=True, slots=True)
class Termination:
    """A motion that cannot go on: the named ending, and the reason in words."""

    ending: Ending
    reason: str


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
        self._p, self._friction = dynamics.p, dynamics.static_friction
        self._stick_first = stick_comes_first(dynamics)
        self._n_x = system.n_shape
        self._table = table = system.transitions
        stuck = table.margin_names(Mode.STICK)
        self._normal_force, self._cone = stuck.index("normal_force"), {m: stuck.index(CONE[m]) for m in CONE}
        self._painleve = table.margin_names(Mode.SLIP_FORWARD).index("painleve")
        self._units = units(dynamics)
        self._points = PointFunctions(dynamics, self._units)
        self._push = Buffers(system.push)
        self._impacts: dict[tuple[Mode, ...], Buffers] = {}

    def mode_at_rest(self, candidates: tuple[Mode, ...], t: float, z: Array, data: Array) -> Mode | Termination:
        """Mode of a foot that is at rest (dx = 0) at time ``t`` in state ``z`` on the segment with ``data``.

        Parameters
        ----------
        candidates : what the foot can do, see ``Transitions.at_rest``; stick first.
        """
        stuck, *slipping = ground = grounded(candidates)
        tau, zeta = t / self._units.time, z / self._units.state
        point, margins = self._points.at_rest(stuck, ground[1:], tau, zeta, data)
        if not all(map(isfinite, point.margins)):
            return Termination(Ending.NUMERICAL, "the contact forces are not finite")
        leaves = self._leaves(stuck, point, data)
        forces = {
            slip: (own[self._normal_force], own[self._painleve]) for slip, own in zip(slipping, margins, strict=True)
        }
        possible = [stuck] if not self._pulled(point) and not leaves else []
        possible += [
            slip for slip, (force, mass) in forces.items() if slip.contact in leaves and mass > 0 and force > 0
        ]
        lifts = any(force * mass < 0 for force, mass in forces.values())
        if lifts and not possible:
            flight = next((mode for mode in candidates if mode not in ground), None)
            return flight or Termination(Ending.LIFT_OFF, "no mode keeps the foot on the ground")
        if len(possible) == 1 and not lifts:
            return possible[0]
        if not slipping:
            return Termination(Ending.PAINLEVE, CANNOT_SLIP)
        choices = " and ".join([*possible, *(["lift-off"] if lifts else [])]) or "neither a mode nor lift-off"
        masses = ((slip, self._system.margins(slip)(t, z, self._p, data)[self._painleve]) for slip in slipping)
        values = " and ".join(f"{float(mass):.6g} kg in {slip}" for slip, mass in masses)
        return Termination(Ending.PAINLEVE, f"{choices} possible at once: C_tt + mu s C_nt is {values}")

    def impact(self, z_minus: Array) -> ImpactRecord | Termination:
        """The impact at touchdown in state ``z_minus``."""
        push_work = 0.0
        if self._system.walker.pushes:
            (p_t, p_n), work = self._push(z_minus, self._p)
            if not is_within_cone(p_t, p_n, self._friction):
                words = f"the foot that pushes off slips: its push needs friction {abs(p_t) / p_n:.6g}"
                return Termination(Ending.PUSH_SLIPS, f"{words}, has {self._friction:g}")
            push_work = work.item()
        candidates, v_n = self._candidates(self._table.landed, z_minus)
        if not comes_down(v_n, self._units):
            words = f"the swing foot does not come down: its normal velocity is {v_n:.6g} m/s"
            return Termination(Ending.IMPACT_INCONSISTENT, f"{words}, so that it touches the ground from below")
        chosen: tuple[_Candidate, _Candidate] | Termination = (candidates[0], candidates[0])
        if "impulse" in self._table.of_impact(Mode.STICK):
            chosen = self._consistent_one(candidates)
        if isinstance(chosen, Termination):
            return chosen
        one, stick = chosen
        if one.lift_velocity <= 0:
            words = f"the former stance foot would move into the ground at {one.lift_velocity:.6g} m/s"
            return Termination(Ending.DOUBLE_SUPPORT, f"{words} after an impact with {one.mode}")
        state = one.z_plus.copy()
        state[self._n_x] = 0.0
        return ImpactRecord(
            mode=one.mode.contact,
            state=state,
            step_length=float(one.z_plus[self._n_x]),
            impulse=one.impulse,
            stick_impulse=stick.impulse,
            push_work=push_work,
        )

    def strike(self, transition: Transition, z_minus: Array) -> tuple[Mode, Array] | Termination:
        """What the foot does just after a stop has locked in state ``z_minus``, and the state there."""
        ground = grounded(transition.candidates)
        flights = tuple(mode for mode in transition.candidates if mode not in ground)
        if not ground:
            return flights[0], self._candidates(flights, z_minus)[0][0].z_plus
        candidates, _ = self._candidates(ground, z_minus)
        if flights and not any(map(self._consistent, candidates)):
            (flight,), _ = self._candidates(flights, z_minus)
            if flight.lift_velocity > 0:
                return flight.mode, flight.z_plus
        if all(candidate.f_n < 0 for candidate in candidates):
            assert transition.reset is not None
            words = f"the stop {transition.reset.of} would pull the stance foot off the ground"
            return Termination(Ending.LIFT_OFF, f"{words}: {'; '.join(map(str, candidates))}")
        chosen = self._consistent_one(candidates)
        return chosen if isinstance(chosen, Termination) else (chosen[0].mode, chosen[0].z_plus)

    def touchdown(self, mode: Mode, t: float, z: Array, data: Array) -> Transition | None:
        """The transition of a swing foot that lands at this very time, which ends an arc for another reason."""
        for place, transition in enumerate(self._table.of(mode).values()):
            if transition.ends_step:
                point = self._points(mode, t / self._units.time, z / self._units.state, data)
                return transition if is_touchdown(point.margins[place], point.rates[place]) else None
        return None

    def _consistent_one(self, candidates: list[_Candidate]) -> tuple[_Candidate, _Candidate] | Termination:
        """The only impact that does not contradict itself, and the one that would hold the foot."""
        consistent, stick = [candidate for candidate in candidates if self._consistent(candidate)], candidates[0]
        if stick in consistent and (self._stick_first or is_at_edge(stick.f_t, stick.f_n, self._friction)):
            consistent = [stick]  # at the edge a slip has no velocity: it is the same impact
        if len(consistent) == 1:
            return consistent[0], stick
        ending = Ending.IMPACT_AMBIGUOUS if consistent else Ending.IMPACT_INCONSISTENT
        verdict = " and ".join(c.mode for c in consistent) + " are" if consistent else "no impact is"
        numbers = "; ".join(map(str, candidates))
        return Termination(ending, f"{verdict} consistent at mu = {self._friction:g}: {numbers}")

    def _consistent(self, candidate: _Candidate) -> bool:
        mode, f_t, f_n = candidate.mode, candidate.f_t, candidate.f_n
        return bool(is_consistent_impact(mode, f_t, f_n, candidate.slip_velocity, self._friction))

    def _candidates(self, modes: tuple[Mode, ...], z_minus: Array) -> tuple[list[_Candidate], float]:
        """Impacts of all of ``modes``, and the approach."""
        if modes not in self._impacts:
            self._impacts[modes] = Buffers(self._system.impacts(modes))
        impacts, approach = self._impacts[modes](z_minus, self._p)
        columns, n = impacts.reshape(len(modes), -1).copy(), self._system.n_z
        candidates = [_Candidate(mode, own[:n], *own[n:].tolist()) for mode, own in zip(modes, columns, strict=True)]
        return candidates, approach.item()

    def _leaves(self, stuck: Mode, point: Point, data: Array) -> set[Mode]:
        """Which slips the foot is pushed into: the margins of the cone that do not hold for longer than an instant."""
        margins, rates = point.margins, point.rates
        near = {slip: k for slip, k in self._cone.items() if margins[k] <= EDGE}
        decided = not any(bends_decide(margins[k], rates[k]) for k in near.values())
        later = rates if decided else self._points(stuck, *point.shifted(LOOK), data).rates
        return {
            slip for slip, k in near.items() if falls(CONE[slip], margins[k], rates[k], (later[k] - rates[k]) / LOOK)
        }

    def _pulled(self, point: Point) -> bool:
        """Whether the ground would have to pull at the foot; at touchdown the force of a spring rises from zero."""
        force, rate = point.margins[self._normal_force], point.rates[self._normal_force]
        return force < -EDGE or (force <= EDGE and rate <= 0)


def is_within_cone(f_t: Any, f_n: Any, friction: float) -> Any:
    """Whether friction provides a force or an impulse, to within its edge; floats, or arrays of one shape."""
    return abs(f_t) <= friction * f_n * (1 + EDGE)


def is_at_edge(f_t: Any, f_n: Any, friction: float) -> Any:
    """Whether a force or an impulse lies on the edge of the friction cone; floats, or arrays of one shape."""
    return abs(abs(f_t) - friction * f_n) <= EDGE * abs(friction * f_n)


def is_consistent_impact(mode: Mode, f_t: Any, f_n: Any, slip_velocity: Any, friction: float) -> Any:
    """Whether an impact after which the foot is in ``mode`` agrees with its own result; floats, or arrays."""
    if mode.sticks:
        return (f_n > 0) & is_within_cone(f_t, f_n, friction)
    return (f_n > 0) & (mode.direction * slip_velocity > 0)


def comes_down(approach: Any, units: Units) -> Any:
    """Whether the swing foot moves towards the ground; a float, or an array."""
    return approach < -EDGE * units.speed


def stick_comes_first(dynamics: Dynamics) -> bool:
    """Whether an impact sticks where sticking and slipping are both consistent, as in a ratio of two coefficients."""
    return dynamics.system.law is ImpactLaw.FRICTIONLESS or dynamics.friction_drops
