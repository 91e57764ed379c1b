"""A walker at one state, as numbers: where its bodies are, how they move, and what a swap of the feet makes of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
from casadi import SX, Function, densify, horzcat, jacobian, jtimes, norm_2, vec, vertcat

from gaitopt.arrays import Array
from gaitopt.mechanics.declaration import state_after_impact, state_landing, state_mechanism, state_picture
from gaitopt.mechanics.lagrangian import parameter_namespace
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
    upright : positive unless the walker has fallen.
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
    upright: float
    spring_energy: float
    dissipation: float
    gravity: float
    gaps: Array
    gap_jacobian: Array


def posture(walker: type[Walker], q: Array, dq: Array, p: Array) -> Posture:
    """The walker at coordinates ``q`` and rates ``dq``, both of shape (n_shape + 2,), and parameters ``p``."""
    outputs = map(np.asarray, _kinematics(walker)(q, dq, p))
    bodies, foot, relabel, slope, rate, M, guard, guard_slope, upright, spring, loss, gravity, gaps, gap_slope = outputs
    return Posture(
        bodies=bodies.T,
        foot=foot.T,
        relabel=relabel.ravel(),
        relabel_jacobian=slope,
        relabel_rate=rate.ravel(),
        mass_matrix=M,
        guard=float(guard[0, 0]),
        guard_slope=float(np.linalg.norm(guard_slope)),
        upright=float(upright[0, 0]),
        spring_energy=float(spring[0, 0]),
        dissipation=float(loss[0, 0]),
        gravity=float(gravity[0, 0]),
        gaps=gaps.ravel(),
        gap_jacobian=gap_slope,
    )


def section_posture(walker: type[Walker], free: Mapping[str, float], p: Array) -> tuple[Array, Array]:
    """Shape coordinates and their rates just after an impact, shape (n_shape,) each.

    Parameters
    ----------
    free : section coordinates and rates by name; those that are left out are zero.
    p : parameters, shape (n_p,).

    Raises
    ------
    ProblemError
        If ``Walker.after_impact`` or ``Walker.rates_after_impact`` does not give all of them.
    """
    names = walker.section_names(slipping=True)
    shape, rates = _section(walker)([float(free.get(name, 0.0)) for name in names], p)
    return np.asarray(shape).ravel(), np.asarray(rates).ravel()


def not_a_number(walker: type[Walker], shape: Array, p: Array) -> str | None:
    """What is not a finite number where a walker has a posture and is at rest, in words; None if everything is.

    Parameters
    ----------
    shape : shape coordinates, shape (n_shape,).
    p : parameters, shape (n_p,).
    """
    names, function = _parts(walker)
    values = np.asarray(function(shape, p)).ravel()
    bad = np.flatnonzero(~np.isfinite(values))
    if not bad.size:
        return None
    return f"{names[bad[0]]} is {values[bad[0]]:g} at {posture_words(walker, shape)}, but must be a number"


def posture_words(walker: type[Walker], shape: Array) -> str:
    """``theta1 = 0.2, theta2 = 0.2``."""
    return ", ".join(f"{name} = {value:.4g}" for name, value in zip(walker.shape, shape, strict=True))


@lru_cache(maxsize=8)
def _kinematics(walker: type[Walker]) -> Function:
    """(q, dq, p) -> what a ``Posture`` holds, in its order."""
    n, p = len(walker.shape), SX.sym("p", len(walker.model_fields))
    names = (*walker.shape, "x", "y")
    q, dq = SX.sym("q", len(names)), SX.sym("dq", len(names))
    coordinates = SimpleNamespace(**{name: q[i] for i, name in enumerate(names)})
    mechanism = state_mechanism(walker, coordinates, parameter_namespace(walker, p))
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
        mechanism.upright,
        SX(mechanism.potential),
        sum((SX(d.coefficient) * jtimes(SX(d.across), q, dq) ** 2 for d in mechanism.dampers), SX(0)),
        norm_2(mechanism.gravity),
        gaps,
        jacobian(gaps, q[:n]),
    ]
    return Function("kinematics", [q, dq, p], outputs)


@lru_cache(maxsize=8)
def _section(walker: type[Walker]) -> Function:
    """(section coordinates, p) -> shape coordinates and their rates just after an impact."""
    names = walker.section_names(slipping=True)
    free, p = SX.sym("free", len(names)), SX.sym("p", len(walker.model_fields))
    named = SimpleNamespace(**{name: free[i] for i, name in enumerate(names)})
    return Function("section", [free, p], [*state_after_impact(walker, named, parameter_namespace(walker, p))])


@lru_cache(maxsize=8)
def _parts(walker: type[Walker]) -> tuple[tuple[str, ...], Function]:
    """What a class states besides what follows an impact: a name for each entry, and (shape, p) -> all entries at rest.

    Equations of motion hold derivatives of the parts of a mechanism, so that these are parts of their own.
    """
    shape, p = SX.sym("shape", len(walker.shape)), SX.sym("p", len(walker.model_fields))
    q = SimpleNamespace(**{name: shape[k] for k, name in enumerate(walker.shape)}, x=SX(0), y=SX(0))
    dq = SimpleNamespace(**{name: SX(0) for name in vars(q)})
    parameters = parameter_namespace(walker, p)
    m = state_mechanism(walker, q, parameters)
    parts = {
        "Mechanism.gravity": m.gravity,
        "Mechanism.swing_foot": m.swing_foot,
        "Mechanism.touchdown": m.touchdown,
        "Mechanism.upright": m.upright,
        "Mechanism.relabel": m.relabel,
        "Mechanism.potential": m.potential,
    }
    for k, body in enumerate(m.bodies):
        states = {"mass": body.mass, "position": body.position, "inertia": body.inertia, "angle": body.angle}
        parts |= {f"Mechanism.bodies[{k}].{name}": part for name, part in states.items()}
    parts |= {f"Mechanism.motors[{k}]": angle for k, angle in enumerate(m.motors)}
    parts |= {f"Mechanism.dampers[{k}].coefficient": damper.coefficient for k, damper in enumerate(m.dampers)}
    parts |= {f"Mechanism.dampers[{k}].across": damper.across for k, damper in enumerate(m.dampers)}
    parts |= {f"Mechanism.stops[{name!r}]": gap for name, gap in m.stops.items()}
    parts |= {f"Mechanism.potential_while[{state!r}]": energy for state, energy in m.potential_while.items()}
    parts |= {} if m.push is None else {"Mechanism.push": m.push}
    slopes = {f"the derivative of {name}": jacobian(part, shape) for name, part in parts.items()}
    parts |= {f"Mechanism.switches[{name!r}]": margin(dq) for name, margin in m.switches.items()}
    if walker.massless_feet:
        landed = state_landing(walker, q, dq, parameters)
        parts |= {f"{name} after landing": values for name, values in zip(("posture", "rate"), landed, strict=True)}
    lines, contact = state_picture(walker, q, parameters)
    parts |= {f"line {k} of outline": vertcat(*line) for k, line in enumerate(lines)}
    parts |= {"contact": contact} | slopes
    names = tuple(name for name, part in parts.items() for _ in range(part.numel()))
    return names, Function("parts", [shape, p], [densify(vertcat(*map(vec, parts.values())))])
