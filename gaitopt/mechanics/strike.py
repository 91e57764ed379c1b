"""Plastic impact of a joint stop: it locks, while the stance foot sticks or slips by the rule of impacts.

    M (dq_plus - dq_minus) = J' L + W' F,      J dq_plus = 0,      v_n_plus = 0

    stick    v_t_plus = 0
    slip     F_t = -mu s F_n,  s = sgn v_t_plus

with J the derivative of the gaps of all stops that are locked from now on, and L their impulses. As the gaps do not
depend on where the foot is, what the stops do to a foot that is held is an impulse F_0, and with the apparent mass C of
the foot of a walker with locked stops F = F_0 + C (v_t_plus - v_t_minus, 0)'. The swing foot is in the air. With F = 0
the stance foot leaves the ground.
"""

from casadi import SX, horzcat, vertcat

from gaitopt.mechanics.contact import solve_locked, solve_spd
from gaitopt.mechanics.impact import Impact
from gaitopt.mechanics.lagrangian import EquationsOfMotion


def strike(eom: EquationsOfMotion, slip: SX | None, kinetic: SX, locked: SX) -> Impact:
    """The impact after which the stops are locked and the stance foot slips, or is at rest.

    Parameters
    ----------
    slip : SX - sign s of the slip; None stops the foot.
    locked : SX, shape (m, n_shape) - derivative of the gaps of the stops that are locked from now on.
    """
    n = len(eom.walker.shape)
    A, coupling = eom.M[:n, :n], eom.M[n:, :n]
    bounce = solve_spd(A, locked.T)
    change = -bounce @ solve_spd(locked @ bounce, locked @ eom.dq[:n])
    response = solve_locked(A, coupling.T, locked)
    held, C = coupling @ change, eom.M[n:, n:] - coupling @ response
    s = SX(0) if slip is None else slip
    painleve = C[0, 0] + kinetic * s * C[1, 0]
    dv_t = -eom.dq[n] if slip is None else -(held[0] + kinetic * s * held[1]) / painleve
    slip_velocity = SX(0) if slip is None else eom.dq[n] + dv_t
    return Impact(
        z_plus=vertcat(_posture(eom), eom.state(eom.dq[:n] + change - response[:, 0] * dv_t, slip_velocity)),
        impulse=held + C[:, 0] * dv_t,
        slip_velocity=slip_velocity,
        lift_velocity=SX.nan(),
        painleve=painleve,
    )


def take_off(eom: EquationsOfMotion, locked: SX) -> Impact:
    """The impact after which the stops are locked and the stance foot has left the ground.

    Parameters
    ----------
    locked : SX, shape (m, n_shape) - derivative of the gaps of the stops that are locked from now on.
    """
    n = len(eom.walker.shape)
    J = horzcat(locked, SX.zeros(locked.shape[0], 2))
    bounce = solve_spd(eom.M, J.T)
    rates = eom.dq - bounce @ solve_spd(J @ bounce, J @ eom.dq)
    return Impact(
        z_plus=vertcat(_posture(eom), eom.state(rates[:n], rates[n], rates[n + 1])),
        impulse=SX.zeros(2),
        slip_velocity=SX(0),
        lift_velocity=rates[n + 1],
        painleve=SX.nan(),
    )


def _posture(eom: EquationsOfMotion) -> SX:
    return eom.z[: len(eom.walker.coordinates())]
