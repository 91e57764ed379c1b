"""Contact of the stance foot: sticking and slipping, with Coulomb friction, and flight, without a force.

Eliminating the shape accelerations from eq. (2) leaves, at the foot, with ddy = 0,

    f = f_stick + C (ddx, 0)'         C = (W M^-1 W')^-1, the apparent mass of the foot

so that f_stick is the force of eq. (3), which holds the foot still, and with f_t = -mu s f_n - d (eq. (5), s = sgn dx,
mu the kinetic coefficient and d the drag of the friction law)

    ddx = -((f_t + mu s f_n)_stick + d) / (C_tt + mu s C_nt)

An s strictly between -1 and 1 is the friction of a foot at rest, so that one formula holds for every mode of a foot
whose mode is unknown. The denominator is det(C) w_n' M^-1 Gamma of eq. (6): where it loses its sign, the slip has no
unique solution (the paradox of Painleve).  Gamus & Or (2013), eqs (2)-(6).
"""

from dataclasses import dataclass

from casadi import SX, horzcat, vertcat

from gaitopt.mechanics.lagrangian import EquationsOfMotion


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Accelerations and contact force in one mode.

    Attributes
    ----------
    dz : SX, shape (n_z,) - rate of the state.
    force : SX, shape (2,) - contact force (f_t, f_n) [N].
    painleve : SX - C_tt + mu s C_nt, the apparent mass of the slipping foot [kg]; of the foot itself in stick.
    """

    dz: SX
    force: SX
    painleve: SX


def solve_spd(A: SX, b: SX) -> SX:
    """A^-1 b for symmetric positive definite A = L D L' by its factors written out in symbols, free of roots."""
    n = A.shape[0]
    L, D = SX.eye(n), SX.zeros(n)
    for j in range(n):
        LD = [L[j, k] * D[k] for k in range(j)]
        D[j] = A[j, j] - sum((L[j, k] * LD[k] for k in range(j)), SX(0))
        for i in range(j + 1, n):
            L[i, j] = (A[i, j] - sum((L[i, k] * LD[k] for k in range(j)), SX(0))) / D[j]
    x = SX(b)
    for i in range(n):
        x[i, :] = x[i, :] - sum((L[i, k] * x[k, :] for k in range(i)), SX(0))
    for i in reversed(range(n)):
        x[i, :] = x[i, :] / D[i] - sum((L[k, i] * x[k, :] for k in range(i + 1, n)), SX(0))
    return x


def solve_locked(A: SX, b: SX, J: SX) -> SX:
    """x with A x - b = J' l and J x = 0: what ``solve_spd`` gives, as far as locked stops let it."""
    x = solve_spd(A, b)
    if not J.shape[0]:
        return x
    response = solve_spd(A, J.T)
    return x - response @ solve_spd(J @ response, J @ x)


def motion(
    eom: EquationsOfMotion, slip: SX | None, *, kinetic: SX, drag: SX, springs: SX, torque: SX, locked: SX
) -> Motion:
    """Motion of the walker while its stance foot slips, or is held at rest.

    Parameters
    ----------
    slip : SX - sign s of the slip, or an unknown between -1 and 1; None holds the foot.
    kinetic : SX - coefficient mu of a slipping foot.
    drag : SX - force against the slip besides mu f_n, zero at rest [N].
    springs : SX, shape (n_q,) - gradient of the potential energy that acts in this mode only.
    torque : SX, shape (n_u,) - actuator torques u [N m].
    locked : SX, shape (m, n_shape) - derivative of the gaps of the locked stops.
    """
    n = len(eom.walker.shape)
    bias = eom.B + eom.G + springs - eom.E @ torque
    coupling = eom.M[n:, :n]
    free = solve_locked(eom.M[:n, :n], horzcat(-bias[:n], eom.M[:n, n:]), locked)
    rigid, response = free[:, 0], free[:, 1:]
    stick_force = coupling @ rigid + bias[n:]
    C = eom.M[n:, n:] - coupling @ response
    if slip is None:
        ddx, painleve = SX(0), C[0, 0]
    else:
        painleve = C[0, 0] + kinetic * slip * C[1, 0]
        ddx = -(stick_force[0] + kinetic * slip * stick_force[1] + drag) / painleve
    acceleration = rigid - response[:, 0] * ddx
    dx = SX(0) if slip is None else eom.dq[n]
    return Motion(
        dz=vertcat(eom.state(eom.dq[:n], dx), eom.state(acceleration, ddx)),
        force=stick_force + C[:, 0] * ddx,
        painleve=painleve,
    )


def flight(eom: EquationsOfMotion, *, springs: SX, torque: SX, locked: SX) -> Motion:
    """Motion of the walker while no foot touches the ground; parameters as for ``motion``.

    A massless foot has no motion of its own: the bodies fall as they would without it, and it stays where it was.
    """
    n = len(eom.walker.shape)
    bias = eom.B + eom.G + springs - eom.E @ torque
    if eom.walker.massless_feet:
        free = vertcat(solve_locked(eom.M[:n, :n], -bias[:n], locked), SX.zeros(2))
        rates = vertcat(eom.dq[:n], SX.zeros(2))
    else:
        free, rates = solve_locked(eom.M, -bias, horzcat(locked, SX.zeros(locked.shape[0], 2))), eom.dq
    dz = [eom.state(values[:n], values[n], values[n + 1]) for values in (rates, free)]
    return Motion(dz=vertcat(*dz), force=SX.zeros(2), painleve=SX.nan())
