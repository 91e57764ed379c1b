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

from gaitopt.arrays import Array
from gaitopt.gait import Ending, ImpactRecord
from gaitopt.mechanics import ONSETS, Dynamics, ImpactLaw, Mode, margin_names
from gaitopt.mechanics.buffered import BufferedFunction
from gaitopt.simulation.events import EDGE, LOOK, bends_decide, falls, is_touchdown
from gaitopt.simulation.natural import PointFunctions, units


@dataclass(frozen=True, slots=True)
class Termination:
    """A motion that cannot go on: the named ending, and the reason in words."""

    ending: Ending
    reason: str


CANNOT_SLIP = Termination(Ending.PAINLEVE, "a foot without mass cannot slip, and friction does not hold it")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Candidate:
    """One conceivable impact, and whether it contradicts itself."""

    mode: Mode
    z_plus: Array
    impulse: Array
    slip_velocity: float
    lift_velocity: float
    painleve: float

    def __str__(self) -> str:
        f_t, f_n = self.impulse
        if self.mode.sticks:
            return f"stick needs F_t = {f_t:.6g}, F_n = {f_n:.6g} N s"
        return (
            f"{self.mode} has F_n = {f_n:.6g} N s, v_t = {self.slip_velocity:.6g} m/s, "
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
        self._ground = tuple(contact for contact in system.walker.contacts() if contact is not Mode.FLIGHT)
        self._units = units(dynamics)
        self._point = PointFunctions(dynamics, self._units)
        self._approach, self._push = BufferedFunction(system.approach), BufferedFunction(system.push)
        self._impacts = {mode: BufferedFunction(system.impact(mode)) for mode in system.walker.modes()}

    def mode_at_rest(self, mode: Mode, t: float, z: Array, data: Array) -> Mode | Termination:
        """Mode of a foot that is at rest (dx = 0) at time ``t`` in state ``z`` on the segment with ``data``.

        Parameters
        ----------
        mode : any with the states of the stops.
        """
        stuck, *slipping = (mode.with_contact(contact) for contact in self._ground)
        tau, zeta = t / self._units.time, z / self._units.state
        point = [output.copy() for output in self._point(stuck, tau, zeta, data)]
        stick = dict(zip(margin_names(stuck), point[1].tolist(), strict=True))
        if not all(map(isfinite, stick.values())):
            return Termination(Ending.NUMERICAL, "the contact forces are not finite")
        slips = {slip: self._margins(slip, tau, zeta, data) for slip in slipping}
        leaves = self._leaves(stuck, tau, zeta, data, point)
        possible = [stuck] if not self._pulled(stuck, point) and not any(leaves.values()) else []
        possible += [m for m, s in slips.items() if leaves[m] and s["painleve"] > 0 and s["normal_force"] > 0]
        lifts = any(s["normal_force"] * s["painleve"] < 0 for s in slips.values())
        if lifts and not possible and self._system.walker.flies:
            return mode.with_contact(Mode.FLIGHT)
        if lifts and not possible:
            return Termination(Ending.LIFT_OFF, "no mode keeps the foot on the ground")
        if len(possible) == 1 and not lifts:
            return possible[0]
        if not slipping:
            return CANNOT_SLIP
        choices = " and ".join([*possible, *(["lift-off"] if lifts else [])]) or "neither a mode nor lift-off"
        values = " and ".join(f"{self._painleve(m, t, z, data):.6g} kg in {m}" for m in slips)
        return Termination(Ending.PAINLEVE, f"{choices} possible at once: C_tt + mu s C_nt is {values}")

    def impact(self, z_minus: Array) -> ImpactRecord | Termination:
        """The impact at touchdown in state ``z_minus``."""
        if self._system.walker.pushes:
            p_t, p_n = self._push(z_minus, self._p)[0]
            if abs(p_t) > self._friction * p_n * (1 + EDGE):
                words = f"the foot that pushes off slips: its push needs friction {abs(p_t) / p_n:.6g}"
                return Termination(Ending.PUSH_SLIPS, f"{words}, has {self._friction:g}")
        v_n = float(self._approach(z_minus, self._p)[0][0])
        if v_n >= -EDGE * self._units.speed:
            words = f"the swing foot does not come down: its normal velocity is {v_n:.6g} m/s"
            return Termination(Ending.IMPACT_INCONSISTENT, f"{words}, so that it touches the ground from below")
        released = self._system.walker.released
        candidates = [self._candidate(released(contact), z_minus) for contact in self._ground]
        if self._system.walker.massless_feet:
            return self._record(candidates[0], candidates[0], z_minus)
        chosen = self._consistent_one(candidates)
        return chosen if isinstance(chosen, Termination) else self._record(*chosen, z_minus)

    def strike(self, mode: Mode, stop: str, z_minus: Array) -> tuple[Mode, Array] | Termination:
        """What the foot does just after a stop has locked in state ``z_minus``, and the state there."""
        locked = mode.with_next(stop)
        if mode.flies:
            return locked, self._candidate(locked, z_minus).z_plus
        candidates = [self._candidate(locked.with_contact(contact), z_minus) for contact in self._ground]
        if self._system.walker.flies and not any(map(self._consistent, candidates)):
            flight = self._candidate(locked.with_contact(Mode.FLIGHT), z_minus)
            if flight.lift_velocity > 0:
                return flight.mode, flight.z_plus
        if all(candidate.impulse[1] < 0 for candidate in candidates):
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
        _, margins, rates = self._point(mode, t / self._units.time, z / self._units.state, data)
        touchdown = margin_names(mode).index("touchdown")
        return bool(is_touchdown(margins[touchdown], rates[touchdown]))

    def _pulled(self, mode: Mode, point: list[Array]) -> bool:
        """Whether the ground would have to pull at the foot; at touchdown the force of a spring rises from zero."""
        row = margin_names(mode).index("normal_force")
        force, rate = point[1][row], point[2][row]
        return bool(force < -EDGE or (force <= EDGE and rate <= 0))

    def _leaves(self, mode: Mode, tau: float, zeta: Array, data: Array, point: list[Array]) -> dict[Mode, bool]:
        """Which slips the foot is pushed into: the margins of the cone that do not hold for longer than an instant."""
        flow, margins, rates = point
        later = rates
        if any(map(bends_decide, margins.tolist(), rates.tolist())):
            later = self._point(mode, tau + LOOK, zeta + LOOK * flow, data)[2]
        rows = zip(margin_names(mode), margins.tolist(), rates.tolist(), (later - rates).tolist(), strict=True)
        left = {name: falls(name, value, rate, change / LOOK) for name, value, rate, change in rows}
        return {mode.with_contact(onset): left[name] for name, onset in ONSETS.items()}

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
        f_t, f_n = candidate.impulse
        if candidate.mode.sticks:
            return bool(f_n > 0 and abs(f_t) <= self._friction * f_n * (1 + EDGE))
        return bool(f_n > 0 and candidate.mode.direction * candidate.slip_velocity > 0)

    def _at_edge(self, stick: _Candidate) -> bool:
        f_t, f_n = stick.impulse
        return bool(abs(f_t) >= self._friction * f_n * (1 - EDGE))

    def _candidate(self, mode: Mode, z_minus: Array) -> _Candidate:
        z_plus, impulse, slip, lift, painleve = (output.copy() for output in self._impacts[mode](z_minus, self._p))
        return _Candidate(
            mode=mode,
            z_plus=z_plus,
            impulse=impulse,
            slip_velocity=float(slip[0]),
            lift_velocity=float(lift[0]),
            painleve=float(painleve[0]),
        )

    def _painleve(self, mode: Mode, t: float, z: Array, data: Array) -> float:
        return float(self._system.margins(mode)(t, z, self._p, data)[margin_names(mode).index("painleve")])

    def _margins(self, mode: Mode, tau: float, zeta: Array, data: Array) -> dict[str, float]:
        margins = self._point(mode, tau, zeta, data)[1]
        return dict(zip(margin_names(mode), margins.tolist(), strict=True))
