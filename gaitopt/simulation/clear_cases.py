"""Clear decisions about a foot that stands alone, from compiled margins: rounding cannot change them.

The force f_stick holds a foot at rest, mu f_n + s f_t is its margin to a slip with sign s, and C is the apparent mass
of the foot:

    stick             f_n > 0 and both margins positive
    slip with sign s  its margin negative, C_tt + mu s C_nt > 0, and f_n > 0 while slipping

At an impact the swing foot comes down, v_n < 0, and by Gamus & Or (2013), eqs (9)-(11),

    stick             F_n > 0 and |F_t| <= mu F_n
    slip with sign s  F_n > 0 and s v_t > 0 just after it

where F_n (C_tt + mu s C_nt) = -det(C) v_n, so that F_n > 0 excludes the paradox of Painleve. A case is clear if exactly
one mode is consistent, by more than rounding. At an edge, or if the foot may lift off, ``ContactResolver`` examines all
modes. The functions take floats for one state, or arrays for many states.
"""

from collections.abc import Sequence
from typing import Any

from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import FOOT, SWING_FOOT, Mode
from gaitopt.model.transitions import CONE
from gaitopt.simulation.events import EDGE, INSTANT, STEEP


class ClearCases:
    """Clear decisions about the foot of one system at fixed parameters; values are floats, or arrays of one shape.

    Parameters
    ----------
    dynamics : the dynamics of a walker that stands on one foot at a time.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        table, walker = dynamics.system.transitions, dynamics.system.walker
        friction = dynamics.contact_friction
        self._friction, self._landing_friction = friction[FOOT], friction.get(SWING_FOOT, friction[FOOT])
        self._stick_first = dynamics.stick_comes_first
        self._speed, self._has_mass = dynamics.scales.speed, not walker.weightless()
        self._lifts = self._has_mass and not walker.leaves_ground()
        stuck, slips = table.margin_names(table.landed[0]), table.margin_names(table.landed[-1])
        self._normal_force, self._cone = stuck.index("normal_force"), [stuck.index(name) for name in CONE.values()]
        self._painleve = slips.index("painleve") if self._has_mass else 0

    def sticks(self, stuck: Any, rates: Any) -> tuple[Any, Any]:
        """Whether a foot at rest sticks, and whether rounding cannot change this; if it does not, it slips or leaves.

        Parameters
        ----------
        stuck, rates : margins in natural units, and their rates, while the foot sticks.
        """
        sticks, clear = True, True
        for k in (self._normal_force, *self._cone):
            # the forces on a massless foot that has just landed rise from zero
            rises = (abs(stuck[k]) <= EDGE) & (rates[k] > STEEP)
            sticks = sticks & ((stuck[k] > EDGE) | rises)
            clear = clear & ((abs(stuck[k]) > EDGE + INSTANT * abs(rates[k])) | rises)
        return sticks, clear

    def at_rest(self, stuck: Any, rates: Any, slips: Sequence[Any]) -> tuple[list[Any], Any]:
        """Whether each mode is consistent with the forces on a foot at rest, and whether the decision is clear.

        Parameters
        ----------
        stuck, rates : see ``sticks``.
        slips : margins of every slip that begins from rest; empty for a massless foot.
        """
        sticks, clear = self.sticks(stuck, rates)
        possible: list[Any] = [sticks]
        for k, slip in zip(self._cone, slips, strict=False):
            possible.append((stuck[k] < -EDGE) & (slip[self._normal_force] > 0))
            clear = clear & (sticks | ((slip[self._painleve] > 0) & (slip[self._normal_force] >= 0)))
        return possible, clear & (_count(possible) == 1)

    def impact(self, modes: Sequence[Mode], values: Any, approach: Any, friction: Any = None) -> tuple[list[Any], Any]:
        """Whether each mode is consistent with the impulses of its impact, and whether the decision is clear.

        Parameters
        ----------
        modes : the possible modes just after the impact, stick first and flight last.
        values : for each mode F_t, F_n, v_t and the velocity with which the other foot lifts, see
            ``HybridSystem.impacts``.
        approach : normal velocity with which the foot lands; not used if a stop locks.
        friction : static coefficient of the foot on the ground after the impact; None for that of the system.
        """
        lands = not modes[0].locked
        comes_down = approach < -EDGE * self._speed if lands else True
        if lands and not self._has_mass:
            return [comes_down], comes_down
        (f_t, f_n, *_), mu = values[0], friction
        if mu is None:
            mu = self._landing_friction if lands else self._friction
        leaves = EDGE * self._speed
        consistent = [
            is_consistent_impact(mode, of_mode[0], of_mode[1], of_mode[2], mu) if mode.touching else of_mode[3] > leaves
            for mode, of_mode in zip(modes, values, strict=True)
        ]
        if self._stick_first:
            consistent = [consistent[0], *(each & _not(consistent[0]) for each in consistent[1:])]
        clear = comes_down & _not(is_at_edge(f_t, f_n, mu)) & (_count(consistent) == 1)
        if lands and self._lifts:
            for each, (_, _, _, lift_velocity, *_) in zip(consistent, values, strict=True):
                clear = clear & (_not(each) | (lift_velocity > 0))
        return consistent, clear


def _count(flags: Sequence[Any]) -> Any:
    return sum(1 * flag for flag in flags)


def _not(flag: Any) -> Any:
    return flag ^ True


def is_within_cone(f_t: Any, f_n: Any, friction: Any) -> Any:
    """Whether friction can provide a force or an impulse, up to ``EDGE``; floats, or arrays of one shape."""
    return abs(f_t) <= friction * f_n * (1 + EDGE)


def is_at_edge(f_t: Any, f_n: Any, friction: Any) -> Any:
    """Whether a force or an impulse lies on the edge of the friction cone; floats, or arrays of one shape."""
    return abs(abs(f_t) - friction * f_n) <= EDGE * abs(friction * f_n)


def is_consistent_impact(mode: Mode, f_t: Any, f_n: Any, slip_velocity: Any, friction: float) -> Any:
    """Whether an impact satisfies the friction law of the mode after it; floats, or arrays of one shape."""
    if mode.sticks:
        return (f_n > 0) & is_within_cone(f_t, f_n, friction)
    return (f_n > 0) & (mode.direction * slip_velocity > 0)
