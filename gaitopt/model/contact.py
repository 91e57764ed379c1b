"""Contact of the feet with the ground: motion with a sticking, slipping or lifted foot, and plastic impacts.

**Motion.** With the shape accelerations eliminated from eq. (2), the force at the stance foot is, with ddy = 0,

    f = f_stick + C (ddx, 0)'         C = (W M^-1 W')^-1, the apparent mass of the foot

where f_stick is the force of eq. (3) that holds the foot. A slip has f_t = -mu s f_n - d (eq. (5)), s = sgn dx, with
the kinetic coefficient mu and the drag d of the friction law, and therefore

    ddx = -((f_t + mu s f_n)_stick + d) / (C_tt + mu s C_nt)

The same formula with an s between -1 and 1 gives the motion of a foot whose mode is unknown. The denominator is
det(C) w_n' M^-1 Gamma of eq. (6); where it is not positive, the slip has no unique solution (Painleve's paradox).

**Impact of the swing foot**, the former stance foot being free:

    M (dq_plus - dq_minus) = W_swing' F                                    eq. (8)

    stick               v_plus = 0                                         eq. (9)
    slip, coulomb       F_t = -mu s F_n,  v_n_plus = 0,  s = sgn v_t_plus  eq. (11)
    slip, frictionless  F_t = 0,          v_n_plus = 0

A walker that pushes off does so just before, with the impulse P on its stance foot: M (dq_minus - dq) = W' P. After the
impact the feet swap roles: the colliding foot becomes the origin of the coordinates and the shape is relabelled. In
coordinates with the velocity v of the colliding foot in place of that of the stance foot, the impulse acts on v alone,

    F = C (v_plus - v_minus)        C = (W_swing M^-1 W_swing')^-1, the apparent mass of the colliding foot

which needs no inverse of M: M is singular for walkers with a single point mass. The mass matrix in these coordinates is
a sum over positions relative to the colliding foot, because a transformation of M would lose the inertia of a light leg
in the rounding of a heavy hip.

**Impact of a joint stop**, after which it is locked and the stance foot sticks or slips, the swing foot in the air:

    M (dq_plus - dq_minus) = J' L + W' F,      J dq_plus = 0,      v_n_plus = 0

    stick    v_t_plus = 0
    slip     F_t = -mu s F_n,  s = sgn v_t_plus

J is the derivative of the gaps of all stops that are locked afterwards, L are their impulses. Gaps do not depend on the
position of the foot. The stops therefore act on a held foot with an impulse F_0, and with the apparent mass C of the
foot while the stops are locked F = F_0 + C (v_t_plus - v_t_minus, 0)'. A foot that takes off has F = 0.

References
----------
Gamus & Or (2013), eqs (2)-(11).
"""

from dataclasses import dataclass
from types import SimpleNamespace

from casadi import SX, dot, horzcat, jacobian, jtimes, vertcat, vertsplit

from gaitopt.model.declaration import state_landing
from gaitopt.model.friction import ImpactLaw
from gaitopt.model.lagrangian import EquationsOfMotion, parameter_namespace


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Accelerations and contact force in one mode.

    Attributes
    ----------
    dz : SX, shape (n_z,) - rate of the state.
    force : SX, shape (2,) - contact force (f_t, f_n) [N].
    painleve : SX - C_tt + mu s C_nt, the apparent mass of the slipping foot [kg]; C_tt in stick; NaN in flight.
    """

    dz: SX
    force: SX
    painleve: SX


def solve_spd(A: SX, b: SX) -> SX:
    """A^-1 b for symmetric positive definite A, by symbolic factors A = L D L' without square roots."""
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
    """x with A x - b = J' l for some l, and J x = 0: the solution under the constraints of locked stops."""
    x = solve_spd(A, b)
    if not J.shape[0]:
        return x
    response = solve_spd(A, J.T)
    return x - response @ solve_spd(J @ response, J @ x)


def motion(
    eom: EquationsOfMotion, slip: SX | None, *, kinetic: SX, drag: SX, springs: SX, torque: SX, locked: SX
) -> Motion:
    """Motion of the walker while its stance foot slips, or is held.

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

    A massless foot has no equation of motion: it keeps its position, and the bodies fall without it.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Impact:
    """One impact as a function of the state just before it.

    Attributes
    ----------
    z_plus : SX, shape (n_z,) - state just after the impact, feet swapped.
    impulse : SX, shape (2,) - contact impulse (F_t, F_n) at the colliding foot [N s].
    slip_velocity : SX - tangential velocity of the colliding foot just after the impact [m/s].
    lift_velocity : SX - normal velocity of the former stance foot just after the impact [m/s]; NaN if it stays on the
        ground (impact of a stop) or was in the air.
    painleve : SX - det(C) w_n' M^-1 Gamma, the apparent mass of the slipping foot [kg], which must be positive; NaN
        without an impulse.
    """

    z_plus: SX
    impulse: SX
    slip_velocity: SX
    lift_velocity: SX
    painleve: SX


@dataclass(frozen=True, slots=True, kw_only=True)
class Push:
    """The push of the stance foot just before the swing foot lands.

    Attributes
    ----------
    impulse : SX, shape (2,) - (P_t, P_n), of the ground on the foot [N s].
    rates : SX, shape (n_q,) - rates just after it, dq_minus of the impact.
    work : SX - kinetic energy that it adds [J].
    """

    impulse: SX
    rates: SX
    work: SX


def push_off(eom: EquationsOfMotion, locked: SX) -> Push:
    """The push of a walker; zero if it does not push off. ``locked`` as for ``impact``."""
    impulse = eom.mechanism.push
    if impulse is None:
        return Push(impulse=SX.zeros(2), rates=eom.dq, work=SX(0))
    n = len(eom.walker.shape)
    held = horzcat(locked, SX.zeros(locked.shape[0], 2))
    change = solve_locked(eom.M, vertcat(SX.zeros(n), impulse), held)
    return Push(impulse=impulse, rates=eom.dq + change, work=dot(impulse, eom.dq[n:] + change[n:] / 2))


def impact(eom: EquationsOfMotion, slip: SX | None, law: ImpactLaw, kinetic: SX, locked: SX) -> Impact:
    """The impact after which the colliding foot slips or is at rest; it may be inconsistent.

    Parameters
    ----------
    slip : SX - sign s of the slip, or an unknown between -1 and 1; None stops the foot.
    locked : SX, shape (m, n_shape) - derivative of the gaps of the stops that stay locked during the impact.
    """
    n = len(eom.walker.shape)
    reach = eom.W_swing[:, :n]  # the swing foot is the stance foot plus a function of the shape
    foot_mass, coupling, shape_mass = _masses(eom)
    response = solve_locked(shape_mass, coupling.T, locked)
    C = foot_mass - coupling @ response

    dq = push_off(eom, locked).rates
    v_minus = eom.W_swing @ dq
    mu = kinetic if law is ImpactLaw.COULOMB else SX(0)
    s = SX(0) if slip is None else slip
    painleve = C[0, 0] + mu * s * C[1, 0]
    dv_n = -v_minus[1]
    dv_t = -v_minus[0] if slip is None else -(C[0, 1] + mu * s * C[1, 1]) * dv_n / painleve
    dv = vertcat(dv_t, dv_n)
    rates = dq[:n] - response @ dv
    slip_velocity = SX(0) if slip is None else v_minus[0] + dv_t
    relabelled = jtimes(eom.mechanism.relabel, eom.q[:n], rates)
    return Impact(
        z_plus=vertcat(
            eom.state(eom.mechanism.relabel, eom.mechanism.swing_foot[0]), eom.state(relabelled, slip_velocity)
        ),
        impulse=C @ dv,
        slip_velocity=slip_velocity,
        lift_velocity=SX.nan() if eom.walker.flies else -(reach @ rates)[1],
        painleve=painleve,
    )


def landing(eom: EquationsOfMotion) -> Impact:
    """The landing of a massless foot, which sticks; see ``Walker.landing``."""
    names = (*eom.walker.shape, "x", "y")
    q, dq = (SimpleNamespace(**dict(zip(names, vertsplit(values), strict=True))) for values in (eom.q, eom.dq))
    shape, rates = state_landing(eom.walker, q, dq, parameter_namespace(eom.walker, eom.p))
    return Impact(
        z_plus=vertcat(eom.state(shape, eom.mechanism.swing_foot[0]), eom.state(rates, SX(0))),
        impulse=SX.zeros(2),
        slip_velocity=SX(0),
        lift_velocity=SX.nan(),
        painleve=SX.nan(),
    )


def _masses(eom: EquationsOfMotion) -> tuple[SX, SX, SX]:
    """Blocks of the mass matrix in the velocity of the swing foot and the shape rates: foot, coupling, shape."""
    n = len(eom.walker.shape)
    shape = eom.q[:n]
    coupling, shape_mass = SX.zeros(2, n), SX.zeros(n, n)
    for body in eom.mechanism.bodies:
        arm = jacobian(body.position - eom.mechanism.swing_foot, shape)
        turn = jacobian(SX(body.angle), shape)
        coupling += body.mass * arm
        shape_mass += body.mass * (arm.T @ arm) + body.inertia * (turn.T @ turn)
    return eom.mass * SX.eye(2), coupling, shape_mass


def strike(eom: EquationsOfMotion, slip: SX | None, kinetic: SX, locked: SX) -> Impact:
    """The impact after which the stops are locked and the stance foot slips, or is at rest.

    Parameters
    ----------
    slip : SX - sign s of the slip; None stops the foot.
    locked : SX, shape (m, n_shape) - derivative of the gaps of the stops that are locked afterwards.
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
    locked : SX, shape (m, n_shape) - derivative of the gaps of the stops that are locked afterwards.
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
