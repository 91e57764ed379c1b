"""A walker at one state, as numbers: where its bodies are, how they move, and what a swap of the feet makes of it.

Whether a walker is made of numbers, and is the same body just before and just after its feet swap roles.

An impact changes velocities by impulses at the feet and renames the coordinates; it moves no mass and stores no energy.
With s_plus = relabel(s_minus) and the stance foot at the former swing foot, at every touchdown

    bodies_plus = bodies_minus      mass, inertia, position, velocity and spin, in any order
    V_plus = V_minus                potential energy of springs; dampers store none, and take some
    s_minus lies on the guard       for every s_plus out of ``after_impact``, and all stops are locked there

(of walkers with massless feet the positions alone).

Everything else (return map, multipliers, costs) stands on that, so a walker that breaks it is refused.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
from casadi import SX, Function, densify, horzcat, jacobian, jtimes, norm_2, vec, vertcat

from gaitopt.arrays import Array
from gaitopt.building import built_once
from gaitopt.errors import ProblemError
from gaitopt.model.buffered import buffered
from gaitopt.model.declaration import (
    calling,
    check_class,
    shown,
    state_after_impact,
    state_landing,
    state_mechanism,
    state_picture,
)
from gaitopt.model.lagrangian import parameter_namespace
from gaitopt.model.units import LARGEST, Scales
from gaitopt.model.walker import Walker


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
    shape, rates = buffered(_section(walker))([float(free.get(name, 0.0)) for name in names], p)
    return shape.copy(), rates.copy()


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


@built_once(maxsize=8)
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


@built_once(maxsize=8)
def _section(walker: type[Walker]) -> Function:
    """(section coordinates, p) -> shape coordinates and their rates just after an impact."""
    names = walker.section_names(slipping=True)
    free, p = SX.sym("free", len(names)), SX.sym("p", len(walker.model_fields))
    named = SimpleNamespace(**{name: free[i] for i, name in enumerate(names)})
    return Function("section", [free, p], [*state_after_impact(walker, named, parameter_namespace(walker, p))])


@built_once(maxsize=8)
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


SAMPLES = 4
"""Random touchdowns; what holds at one of them by chance does not hold at all."""
TOUCHDOWNS = 32
"""Random touchdowns at which only numbers are looked for, which is quick."""
SWING = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Parts of the way from the posture after an impact to that before the next one."""
FALLEN = -1e-9
"""A margin of being upright below this is a fall; a wheel on two spokes is at zero, up to rounding."""
SPREAD = 0.3
"""Of the free coordinates [rad]: the half-angles of walking legs."""
AGREEMENT = 1e-9
"""In natural units: the geometry is known to rounding."""
DEFINITE = 1e-12
"""Least eigenvalue of the mass matrix after its diagonal is scaled to one: the rounding of its factorisation."""
NEWTON_STEPS = 20
"""To invert ``relabel``; one suffices, as it is affine for all but exotic walkers."""


def check_walker(walker: type[Walker] | Walker, parameters: Mapping[str, float] | None = None) -> None:
    """Refuse a walker whose class is not well formed, or that contradicts itself where its feet swap roles.

    Parameters
    ----------
    walker : a walker, or the class of one.
    parameters : the fields of the class by name; not needed with a walker that has them.

    Raises
    ------
    ProblemError
        If masses jump, springs gain or lose energy, ``relabel`` cannot be inverted, ``after_impact`` is no posture in
        which a step begins, a coordinate has no inertia, something is not a number, or the class is not that of a
        walker (see ``declaration``). The message names the walker and the reason.
    """
    check_class(walker if isinstance(walker, type) else type(walker))
    model = walker if isinstance(walker, type) else type(walker)
    values = dict(parameters or {}) if isinstance(walker, type) else {k: getattr(walker, k) for k in model.model_fields}
    reason = _parameter_fault(model, values)
    if reason is None:
        with calling(model, "its equations"):
            reason = _contradiction(model, tuple(float(values[name]) for name in model.model_fields))
    if reason is not None:
        raise ProblemError(f"{model.__name__}: {reason}")


def _parameter_fault(model: type[Walker], values: Mapping[str, object]) -> str | None:
    """Which parameter is not a finite number, if one is not."""
    for name in model.model_fields:
        value = values.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return f"the parameter {name} is {shown(value)}, but must be a number"
        if not -LARGEST <= value <= LARGEST:
            return f"the parameter {name} is {shown(value)}, but must be a number of at most {LARGEST:g} in size"
    return None


@lru_cache(maxsize=64)
def _contradiction(walker: type[Walker], parameters: tuple[float, ...]) -> str | None:
    """What is wrong with a walker, in words, or None."""
    p = np.array(parameters)
    n = len(walker.shape)
    straight = posture(walker, np.zeros(n + 2), np.zeros(n + 2), p)
    if not (np.isfinite(straight.bodies).all() and (straight.bodies[:, :2] >= 0).all()):
        return "a body has a mass or inertia that is negative or no number"
    scales = _scales(straight)
    if scales is None:
        undefined = not_a_number(walker, np.zeros(n), p)
        return undefined or "it has no length, no mass or no gravity to stand against"
    random = np.random.default_rng(0)
    spread = min(SPREAD, walker.largest_angle)
    steps = walker.step_parameters(p)
    for k in range(TOUCHDOWNS):
        legs = steps[k % len(steps)], steps[(k + 1) % len(steps)]
        free = dict(zip(walker.section, spread * random.uniform(-1, 1, len(walker.section)), strict=True))
        reason = _not_a_number_after(walker, free, legs[1])
        if reason is None and k < SAMPLES:
            rates = random.standard_normal(n) / scales.time
            reason = _contradiction_at(walker, legs, free, rates, scales)
        if reason is not None:
            return reason
    return None


def _not_a_number_after(walker: type[Walker], free: Mapping[str, float], p: Array) -> str | None:
    """What is not a number just after the touchdown that leads to the section coordinates ``free``."""
    shape, rates = section_posture(walker, free, p)
    given = ", ".join(f"{name} = {value:.4g}" for name, value in free.items())
    at = f"at {given}" if given else "whatever the posture"
    for method, prefix, values in (("after_impact", "", shape), ("rates_after_impact", "d", rates)):
        for name, value in zip(walker.shape, values, strict=True):
            if not np.isfinite(value):
                rest = " and rates of zero" if prefix else ""
                return f"{method} gives {prefix}{name} = {value:g} {at}{rest}, but must give a number"
    return not_a_number(walker, shape, p)


def _contradiction_at(
    walker: type[Walker], legs: tuple[Array, Array], free: Mapping[str, float], rates: Array, scales: Scales
) -> str | None:
    """What is wrong at the touchdown that leads to the section coordinates ``free``.

    Parameters
    ----------
    legs : parameters before and after it; they differ where the legs do.
    """
    p, p_plus = legs
    s_plus, _ = section_posture(walker, free, p_plus)
    if walker.massless_feet:
        at_rest = posture(walker, np.array([*s_plus, 0, 0]), np.zeros(s_plus.size + 2), p)
        return _landing_jump(at_rest, walker, p, scales) or _without_inertia(walker, at_rest.mass_matrix)
    s_minus = _before_relabelling(walker, s_plus, p)
    if s_minus is None:
        return "relabel cannot be inverted: after the swap of the feet the posture before it is no longer known"
    swing = (not_a_number(walker, s_plus + part * (s_minus - s_plus), p) for part in SWING)
    undefined = next((reason for reason in swing if reason is not None), None)
    if undefined is not None:
        return undefined
    J = posture(walker, np.array([*s_minus, 0, 0]), np.zeros(rates.size + 2), p).gap_jacobian
    locked = rates - np.linalg.pinv(J) @ J @ rates  # all stops are locked at touchdown
    before = posture(walker, np.array([*s_minus, 0, 0]), np.array([*locked, 0, 0]), p)
    q_plus = np.array([*s_plus, *before.foot[0]])
    after = posture(walker, q_plus, np.array([*before.relabel_rate, *before.foot[1]]), p_plus)
    wrong = _posture_fault(walker, before, after, s_plus, scales)
    if wrong is not None:
        return wrong
    jump = _jump(before.bodies, after.bodies, scales)
    if jump is not None:
        return jump
    energies = before.spring_energy, after.spring_energy
    if abs(energies[1] - energies[0]) > AGREEMENT * max(scales.energy, abs(energies[0])):
        change = f"from {energies[0]:.6g} J to {energies[1]:.6g} J when the feet swap roles"
        return f"its potential energy jumps {change}: springs must act alike on both legs"
    if before.dissipation < 0:
        power = f"{-before.dissipation:.3g} W at a touchdown"
        return f"its dampers give energy, {power}: their coefficients must not be negative"
    return _without_inertia(walker, after.mass_matrix)


def _posture_fault(walker: type[Walker], before: Posture, after: Posture, s_plus: Array, scales: Scales) -> str | None:
    """What is wrong with the postures just before and just after a touchdown, apart from masses and springs."""
    if abs(before.guard) > AGREEMENT * before.guard_slope or after.guard > AGREEMENT * after.guard_slope:
        return (
            "after_impact and touchdown contradict each other: a step would begin in the posture "
            f"{posture_words(walker, s_plus)}, which is not that just after a touchdown "
            f"(guard {before.guard:.3g} before relabelling, {after.guard:.3g} after it)"
        )
    if np.abs([*before.gaps, *after.gaps]).max(initial=0.0) > AGREEMENT:
        return "a stop is not at its end at touchdown, or not just after it: its gap must be zero in both postures"
    if abs(before.foot[0, 1]) > AGREEMENT * scales.length:
        return f"the swing foot is {before.foot[0, 1]:.3g} m above the ground where touchdown is zero"
    if after.upright < FALLEN:
        where = posture_words(walker, s_plus)
        return f"upright is {after.upright:.3g} just after a touchdown, at {where}: it must be positive while it walks"
    return None


def _landing_jump(before: Posture, walker: type[Walker], p: Array, scales: Scales) -> str | None:
    """Whether bodies are elsewhere after a massless foot has landed; their velocities are the walker's own affair."""
    q = np.array([*before.relabel, *before.foot[0]])
    after = posture(walker, q, np.zeros(q.size), p)
    return _jump(before.bodies, after.bodies, scales)


def _jump(before: Array, after: Array, scales: Scales) -> str | None:
    """Which body has no counterpart after the swap of the feet, if one has none."""
    before, after = (bodies[(bodies[:, :2] > 0).any(axis=1)] for bodies in (before, after))
    distances = _distances(before, after, scales)
    for body, row in zip(before, distances, strict=True):
        partner = int(np.argmin(row))
        if not row[partner] <= AGREEMENT:
            mass, _, x, y = body[:4]
            return (
                f"its masses jump when the feet swap roles: the body of {mass:g} kg at ({x:.4g}, {y:.4g}) m is not "
                "there, or does not move so, just after it; both legs must have the same masses at the same places, "
                "and relabel must describe the same posture and motion from the other foot"
            )
        distances[:, partner] = np.inf  # no other body becomes this one
    return None


def _distances(before: Array, after: Array, scales: Scales) -> Array:
    """By how much every body before differs from every body after, in natural units; shape (n, n)."""
    first, second = before[:, None], after[None, :]
    size = np.maximum(np.abs(first[..., :2]), np.abs(second[..., :2]))
    relative = np.abs(first[..., :2] - second[..., :2]) / np.where(size > 0, size, 1.0)
    # the sign of an angle is a convention, which may differ between the legs
    spin = np.where(first[..., 1] > 0, np.abs(np.abs(first[..., 6]) - np.abs(second[..., 6])) * scales.time, 0.0)
    units = np.array([scales.length, scales.length, scales.speed, scales.speed])
    moved = np.abs(first[..., 2:6] - second[..., 2:6]) / units
    return np.concatenate([relative, moved, spin[..., None]], axis=-1).max(axis=-1)


def _without_inertia(walker: type[Walker], mass_matrix: Array) -> str | None:
    inertia = np.diag(mass_matrix)
    if not (inertia > 0).all():
        massless = ", ".join(name for name, value in zip(walker.shape, inertia, strict=True) if not value > 0)
        return f"nothing has inertia against {massless}: the mass matrix is singular"
    normalised = mass_matrix / np.sqrt(np.outer(inertia, inertia))
    if np.linalg.eigvalsh(normalised)[0] > DEFINITE:
        return None
    return f"the mass matrix is not positive definite: {', '.join(walker.shape)} do not move masses independently"


def _before_relabelling(walker: type[Walker], s_plus: Array, p: Array) -> Array | None:
    """The shape coordinates that ``relabel`` maps to ``s_plus``, by Newton's method."""
    s, foot = s_plus.copy(), np.zeros(2)
    for _ in range(NEWTON_STEPS):
        here = posture(walker, np.concatenate([s, foot]), np.zeros(s.size + 2), p)
        if not np.isfinite(here.relabel_jacobian).all() or np.linalg.cond(here.relabel_jacobian) > 1 / AGREEMENT:
            return None
        if np.abs(here.relabel - s_plus).max() < AGREEMENT / 10:
            return s
        s = s - np.linalg.solve(here.relabel_jacobian, here.relabel - s_plus)
    return None


def _scales(straight: Posture) -> Scales | None:
    length = float(np.linalg.norm(straight.bodies[:, 2:4], axis=1).max(initial=0.0))
    mass = float(straight.bodies[:, 0].sum())
    if not (length > 0 and straight.gravity > 0 and mass > 0):
        return None
    return Scales(length=length, time=float(np.sqrt(length / straight.gravity)), mass=mass)
