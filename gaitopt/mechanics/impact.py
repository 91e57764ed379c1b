"""Plastic impact of the swing foot, with or without slip of the colliding foot, and the swap of the feet.

    M (dq_plus - dq_minus) = W_swing' F                                    Gamus & Or (2013), eq. (8)

    stick               v_plus = 0                                         eq. (9)
    slip, coulomb       F_t = -mu s F_n,  v_n_plus = 0,  s = sgn v_t_plus  eq. (11)
    slip, frictionless  F_t = 0,          v_n_plus = 0

The former stance foot is free during the impact. After it the feet swap roles: the colliding foot becomes
the origin of the coordinates and the walker relabels its shape.
"""

from dataclasses import dataclass

from casadi import SX, jtimes, vertcat

from gaitopt.mechanics.contact import solve_spd
from gaitopt.mechanics.lagrangian import EquationsOfMotion
from gaitopt.mechanics.modes import ImpactLaw, Mode


@dataclass(frozen=True, slots=True, kw_only=True)
class Impact:
    """One impact as a function of the state just before it.

    Attributes
    ----------
    z_plus : SX, shape (n_z,) - state just after the impact, feet swapped.
    impulse : SX, shape (2,) - contact impulse (F_t, F_n) at the colliding foot [N s].
    slip_velocity : SX - tangential velocity of the colliding foot just after the impact [m/s].
    lift_velocity : SX - normal velocity of the former stance foot just after the impact [m/s].
    painleve : SX - det(C) w_n' M^-1 Gamma at the colliding foot; must be positive where it slips.
    """

    z_plus: SX
    impulse: SX
    slip_velocity: SX
    lift_velocity: SX
    painleve: SX


def impact(eom: EquationsOfMotion, mode: Mode, law: ImpactLaw, friction: SX) -> Impact:
    """The impact after which the colliding foot is in ``mode``; whether that is consistent is not decided here."""
    n = len(eom.walker.shape)
    response = solve_spd(eom.M, eom.W_swing.T)
    A = eom.W_swing @ response  # inverse apparent mass of the colliding foot
    v_minus = eom.W_swing @ eom.dq
    mu = friction if law is ImpactLaw.COULOMB else SX(0)
    s = mode.direction
    inverse_mass = A[1, 1] - mu * s * A[1, 0]
    impulse = -solve_spd(A, v_minus) if mode is Mode.STICK else -v_minus[1] / inverse_mass * vertcat(-mu * s, 1)
    dq_plus = eom.dq + response @ impulse
    v_plus = v_minus + A @ impulse
    shape_rates = jtimes(eom.mechanism.relabel, eom.z[:n], dq_plus[:n])
    dx_plus = SX(0) if mode is Mode.STICK else v_plus[0]
    return Impact(
        z_plus=vertcat(eom.mechanism.relabel, eom.mechanism.swing_foot[0], shape_rates, dx_plus),
        impulse=impulse,
        slip_velocity=v_plus[0],
        lift_velocity=dq_plus[-1],
        painleve=inverse_mass,
    )
