"""A walker at one state, as numbers: where its bodies are, how they move, and what a swap of the feet makes of it."""

from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
from casadi import SX, Function, horzcat, jacobian, jtimes, norm_2, vertcat

from gaitopt.arrays import Array
from gaitopt.errors import ProblemError
from gaitopt.mechanics.lagrangian import check_structure, parameter_namespace
from gaitopt.mechanics.walker import Walker


@dataclass(frozen=True, slots=True, kw_only=True)
class Posture:
    """A walker at one state.

    Attributes
    ----------
    bodies : ndarray, shape (n_bodies, 7) - mass, inertia, position (2), velocity (2), spin.
    foot : ndarray, shape (2, 2) - position and velocity of the swing foot, in rows.
    relabel, relabel_rate : ndarray, shape (n_shape,) - shape coordinates and rates after a swap of the feet.
    relabel_jacobian : ndarray, shape (n_shape, n_shape) - derivative of ``relabel``.
    mass_matrix : ndarray, shape (n_shape, n_shape) - with the stance foot at rest.
    guard, guard_slope : the guard of touchdown, and the length of its gradient.
    spring_energy : potential energy besides gravity [J].
    dissipation : power that the dampers take [W].
    gravity : acceleration of gravity [m/s^2].
    gaps, gap_jacobian : ndarray, shape (n_stops,) and (n_stops, n_shape) - of the joint stops.
    """

    bodies: Array
    foot: Array
    relabel: Array
    relabel_jacobian: Array
    relabel_rate: Array
    mass_matrix: Array
    guard: float
    guard_slope: float
    spring_energy: float
    dissipation: float
    gravity: float
    gaps: Array
    gap_jacobian: Array


def posture(walker: type[Walker], q: Array, dq: Array, p: Array) -> Posture:
    """The walker at coordinates ``q`` and rates ``dq``, both of shape (n_shape + 2,), and parameters ``p``."""
    outputs = map(np.asarray, _kinematics(walker)(q, dq, p))
    bodies, foot, relabel, slope, rate, M, guard, guard_slope, spring, loss, gravity, gaps, gap_slope = outputs
    return Posture(
        bodies=bodies.T,
        foot=foot.T,
        relabel=relabel.ravel(),
        relabel_jacobian=slope,
        relabel_rate=rate.ravel(),
        mass_matrix=M,
        guard=float(guard[0, 0]),
        guard_slope=float(np.linalg.norm(guard_slope)),
        spring_energy=float(spring[0, 0]),
        dissipation=float(loss[0, 0]),
        gravity=float(gravity[0, 0]),
        gaps=gaps.ravel(),
        gap_jacobian=gap_slope,
    )


def section_posture(walker: type[Walker], free: Array, p: Array) -> Array:
    """Shape coordinates just after an impact from those of ``Walker.section``; shape (n_shape,).

    Raises
    ------
    ProblemError
        If ``Walker.after_impact`` does not give all of them.
    """
    shape = np.asarray(_after_impact(walker)(free, p)).ravel()
    if shape.size != len(walker.shape):
        raise ProblemError(
            f"{walker.__name__}: after_impact gives {shape.size} coordinates, but shape has {len(walker.shape)}"
        )
    return shape


@lru_cache(maxsize=8)
def _kinematics(walker: type[Walker]) -> Function:
    """(q, dq, p) -> what a ``Posture`` holds, in its order."""
    n, p = len(walker.shape), SX.sym("p", len(walker.model_fields))
    names = (*walker.shape, "x", "y")
    q, dq = SX.sym("q", len(names)), SX.sym("dq", len(names))
    coordinates = SimpleNamespace(**{name: q[i] for i, name in enumerate(names)})
    mechanism = walker.mechanism(coordinates, parameter_namespace(walker, p))
    check_structure(walker, mechanism, q[-2:])
    bodies, M = [], SX.zeros(n, n)
    for body in mechanism.bodies:
        velocity, spin = jtimes(body.position, q, dq), jtimes(SX(body.angle), q, dq)
        bodies.append(vertcat(body.mass, body.inertia, body.position, velocity, spin))
        J, a = jacobian(body.position, q[:n]), jacobian(SX(body.angle), q[:n])
        M += body.mass * (J.T @ J) + body.inertia * (a.T @ a)
    foot, relabel, guard = mechanism.swing_foot, SX(mechanism.relabel), SX(mechanism.touchdown)
    slope, gaps = jacobian(relabel, q[:n]), vertcat(SX(0, 1), *mechanism.stops.values())
    outputs = [
        horzcat(*bodies),
        horzcat(foot, jtimes(foot, q, dq)),
        relabel,
        slope,
        slope @ dq[:n],
        M,
        guard,
        jacobian(guard, q[:n]),
        SX(mechanism.potential),
        sum((SX(d.coefficient) * jtimes(SX(d.across), q, dq) ** 2 for d in mechanism.dampers), SX(0)),
        norm_2(mechanism.gravity),
        gaps,
        jacobian(gaps, q[:n]),
    ]
    return Function("kinematics", [q, dq, p], outputs)


@lru_cache(maxsize=8)
def _after_impact(walker: type[Walker]) -> Function:
    """(free section coordinates, p) -> shape coordinates just after an impact."""
    free, p = SX.sym("free", len(walker.section)), SX.sym("p", len(walker.model_fields))
    named = SimpleNamespace(**{name: free[i] for i, name in enumerate(walker.section)})
    return Function("after_impact", [free, p], [vertcat(*walker.after_impact(named, parameter_namespace(walker, p)))])
