"""Plastic impact of the swing foot, with or without slip of the colliding foot, and the swap of the feet.

    M (dq_plus - dq_minus) = W_swing' F                                    Gamus & Or (2013), eq. (8)

    stick               v_plus = 0                                         eq. (9)
    slip, coulomb       F_t = -mu s F_n,  v_n_plus = 0,  s = sgn v_t_plus  eq. (11)
    slip, frictionless  F_t = 0,          v_n_plus = 0

The former stance foot is free during the impact. Where the walker pushes off with it, an impulse P comes before that,

    M (dq_minus - dq) = W' P

by which dq_minus differs from the rates dq at touchdown. After the impact the feet swap roles: the colliding foot
becomes the origin of the coordinates and the walker relabels its shape.

With the velocity v of the colliding foot in place of that of the stance foot, the impulse acts on v alone, and

    F = C (v_plus - v_minus)        C = (W_swing M^-1 W_swing')^-1, the apparent mass of the colliding foot

without an inverse of M, which is singular for walkers whose mass sits in a single point. The mass matrix in these
coordinates is summed up from positions relative to the colliding foot: a transformation of M would lose the inertia
of a light leg in the rounding of a heavy hip.
"""

from dataclasses import dataclass
from types import SimpleNamespace

from casadi import SX, dot, horzcat, jacobian, jtimes, vertcat, vertsplit

from gaitopt.mechanics.contact import solve_locked
from gaitopt.mechanics.declaration import state_landing
from gaitopt.mechanics.lagrangian import EquationsOfMotion, parameter_namespace
from gaitopt.mechanics.modes import ImpactLaw


@dataclass(frozen=True, slots=True, kw_only=True)
class Impact:
    """One impact as a function of the state just before it.

    Attributes
    ----------
    z_plus : SX, shape (n_z,) - state just after the impact, feet swapped.
    impulse : SX, shape (2,) - contact impulse (F_t, F_n) at the colliding foot [N s].
    slip_velocity : SX - tangential velocity of the colliding foot just after the impact [m/s].
    lift_velocity : SX - normal velocity of the former stance foot just after the impact [m/s]; nan where it stays on
        the ground (at a stop), or has been in the air.
    painleve : SX - det(C) w_n' M^-1 Gamma, the apparent mass of the slipping foot [kg]; it must be positive.
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
    """The push of a walker; of one that does not push off nothing changes. ``locked`` as for ``impact``."""
    impulse = eom.mechanism.push
    if impulse is None:
        return Push(impulse=SX.zeros(2), rates=eom.dq, work=SX(0))
    n = len(eom.walker.shape)
    held = horzcat(locked, SX.zeros(locked.shape[0], 2))
    change = solve_locked(eom.M, vertcat(SX.zeros(n), impulse), held)
    return Push(impulse=impulse, rates=eom.dq + change, work=dot(impulse, eom.dq[n:] + change[n:] / 2))


def impact(eom: EquationsOfMotion, slip: SX | None, law: ImpactLaw, kinetic: SX, locked: SX) -> Impact:
    """The impact after which the colliding foot slips or is at rest; whether that is consistent is not decided here.

    Parameters
    ----------
    slip : SX - sign s of the slip, or an unknown between -1 and 1; None stops the foot.
    locked : SX, shape (m, n_shape) - derivative of the gaps of the stops that are locked until after the impact.
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
    """Blocks of the mass matrix in the velocity of the swing foot and the shape rates: foot, foot by shape, shape."""
    n = len(eom.walker.shape)
    shape = eom.q[:n]
    coupling, shape_mass = SX.zeros(2, n), SX.zeros(n, n)
    for body in eom.mechanism.bodies:
        arm = jacobian(body.position - eom.mechanism.swing_foot, shape)
        turn = jacobian(SX(body.angle), shape)
        coupling += body.mass * arm
        shape_mass += body.mass * (arm.T @ arm) + body.inertia * (turn.T @ turn)
    return eom.mass * SX.eye(2), coupling, shape_mass
