"""Consistency of a walker: it consists of numbers, and a swap of the feet moves no mass and stores no energy.

An impact changes velocities by impulses at the feet and renames the coordinates. With s_plus = relabel(s_minus) and the
stance foot at the former swing foot, at every touchdown

    bodies_plus = bodies_minus      mass, inertia, position, velocity and spin, in any order
    V_plus = V_minus                potential energy of springs; dampers dissipate energy
    s_minus lies on the guard       for every s_plus from ``after_impact``, with all stops locked

For walkers with massless feet only the positions must agree. A walker with several contacts has no special postures for
this: if it relabels its shape, bodies, springs and exchanged contacts are compared in any posture. Return map,
multipliers and costs rely on these equations, so that it is an error if a walker violates them.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
from casadi import SX, Function, densify, horzcat, is_equal, jacobian, jtimes, norm_2, solve, substitute, vec, vertcat

from gaitopt.arrays import Array
from gaitopt.building import built_once
from gaitopt.errors import GaitoptWarning, ProblemError
from gaitopt.model.buffered import buffered
from gaitopt.model.declaration import (
    check_class,
    has_links,
    is_default,
    named_arguments,
    state_landing,
    state_picture,
    symbolic_mechanism,
)
from gaitopt.model.foreign import calling, shown
from gaitopt.model.lagrangian import equations_of_motion, inertia
from gaitopt.model.mechanism import Body
from gaitopt.model.section import stated_lift
from gaitopt.model.units import LARGEST_SIZE, Scales
from gaitopt.model.walker import Walker

CHECKED_TOUCHDOWNS = 4
"""Number of random touchdowns at which the equations are checked. If an equation is wrong, it holds at none of them."""
TOUCHDOWNS = 32
"""Number of random touchdowns after which all coordinates must be numbers, which is a quick check."""
SWING_FRACTIONS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Fractions of the way from the posture after an impact to that before the next one."""
FALLEN = -1e-9
"""A walker whose ``upright`` is below this has fallen; for a wheel on two spokes it is zero, up to rounding."""
SPREAD = 0.3
"""Range of the random section coordinates [rad]: the half-angles of walking legs."""
AGREEMENT = 1e-9
"""Tolerance of the equations in natural units, above the rounding of the geometry."""
LINKS_TOLERANCE = 1e-12
"""Largest relative difference of the mass matrix and of positions between links and mechanism: rounding, with a
reserve."""
COMPARISON_DEPTH = 50
"""Depth to which CasADi compares the expression trees of links and mechanism, which have a few operations per link."""
SMALLEST_EIGENVALUE = 1e-12
"""Smallest eigenvalue of a definite mass matrix whose diagonal is scaled to one: the rounding of its factorisation."""
POSTURE_STEPS = 60
"""Largest number of steps towards a posture with a given step length."""
LONGEST_TURN = 0.3
"""Longest step towards such a posture [rad]."""
NUDGE = 1e-7
"""Step of the differences for such a posture, and size of the last step towards it [rad]."""
NEWTON_STEPS = 20
"""Largest number of Newton steps to invert ``relabel``. One is enough if it is affine, as for all but exotic
walkers."""


def check_walker(walker: type[Walker] | Walker, parameters: Mapping[str, float] | None = None) -> None:
    """Check the class of a walker, and the consistency of its mechanism when the feet swap roles.

    Parameters
    ----------
    walker : a walker, or the class of one.
    parameters : values of the fields by name if ``walker`` is a class.

    Raises
    ------
    ProblemError
        If masses jump, springs gain or lose energy, ``relabel`` cannot be inverted, ``after_impact`` is not a posture
        in which a step begins, a coordinate has no inertia, an expression is not a number, or the class is ill formed
        (see ``declaration``). The message names the walker and the reason.

    Warns
    -----
    GaitoptWarning
        If a body has an angle without an inertia, or an inertia without an angle.
    """
    model = walker if isinstance(walker, type) else type(walker)
    check_class(model)
    values = dict(parameters or {}) if isinstance(walker, type) else {k: getattr(walker, k) for k in model.model_fields}
    for name in model.model_fields:
        value = values.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ProblemError(f"{model.__name__}: the parameter {name} is {shown(value)}, but must be a number")
        if not -LARGEST_SIZE <= value <= LARGEST_SIZE:
            limit = f"must be a number of at most {LARGEST_SIZE:g} in size"
            raise ProblemError(f"{model.__name__}: the parameter {name} is {shown(value)}, but {limit}")
    with calling(model, "its equations"):
        reason = _fault(model, tuple(float(values[name]) for name in model.model_fields))
    if reason is not None:
        raise ProblemError(f"{model.__name__}: {reason}")
    for remark in forgotten_inertia(model):
        warnings.warn(f"{model.__name__}: {remark}", GaitoptWarning, stacklevel=2)


@built_once(maxsize=32)
def forgotten_inertia(walker: type[Walker]) -> tuple[str, ...]:
    """A remark on every body that has an angle without an inertia, or an inertia without an angle.

    Bodies that follow from links always have an angle; without inertia they are point masses on purpose.
    """
    if is_default(walker, "mechanism"):
        return ()
    bodies = symbolic_mechanism(walker).mechanism.bodies
    remarks = {
        (True, False): "has an angle, but no inertia: it moves like a point mass; state its inertia",
        (False, True): "has an inertia, but no angle: it never turns; state its angle",
    }
    kinds = [(not SX(body.angle).is_constant(), not SX(body.inertia).is_zero()) for body in bodies]
    return tuple(f"body {k} {remarks[kind]}" for k, kind in enumerate(kinds) if kind in remarks)


def section_posture(walker: type[Walker], free: Mapping[str, float], p: Array) -> tuple[Array, Array]:
    """Shape coordinates and their rates just after an impact, shape (n_shape,) each.

    Parameters
    ----------
    free : section coordinates and rates by name; those that are missing are zero.
    p : parameters, shape (n_p,).

    Raises
    ------
    ProblemError
        If ``Walker.after_impact`` or ``Walker.rates_after_impact`` does not return all of them.
    """
    names = walker.section_names(slipping=True)
    z, n = buffered(stated_lift(walker))([float(free.get(name, 0.0)) for name in names], p)[0], len(walker.shape)
    return z[:n].copy(), z[len(z) // 2 :][:n].copy()


def stepping_posture(walker: type[Walker], step_length: float, p: Array) -> Array:
    """The posture just after an impact whose feet are ``step_length`` [m] apart, near ``walker.posture``; (n_shape,).

    It is found by Gauss-Newton steps in the section coordinates, each as short as possible.

    Raises
    ------
    ProblemError
        If the legs do not reach so far; the message says how far they do.
    """
    names = walker.section

    def stretched(length: float) -> Array | None:
        x = np.array([walker.posture.get(name, 0.0) for name in names])
        for _ in range(POSTURE_STEPS):
            here = _lead(walker, x, p)
            slopes = np.array([(_lead(walker, x + e, p) - here) / NUDGE for e in NUDGE * np.eye(x.size)])
            step = slopes * (here + length) / max(float(slopes @ slopes), np.finfo(float).tiny)
            if not np.isfinite(step).all():
                return None
            x -= step * min(1.0, LONGEST_TURN / max(float(np.abs(step).max()), LONGEST_TURN))
            if np.abs(step).max() < NUDGE:
                return section_posture(walker, dict(zip(names, x.tolist(), strict=True)), p)[0]
        return None

    posture = stretched(step_length)
    if posture is not None:
        return posture
    shorter = (step_length * fraction for fraction in np.arange(0.95, 0.0, -0.05))
    longest = next((length for length in shorter if stretched(length) is not None), 0.0)
    raise ProblemError(f"{step_length:g} m is too long: the legs of {walker.model} reach about {longest:.2g} m")


def _lead(walker: type[Walker], x: Array, p: Array) -> float:
    """Distance of the swing foot in front of the stance foot just after an impact, from section coordinates [m]."""
    shape, _ = section_posture(walker, dict(zip(walker.section, x.tolist(), strict=True)), p)
    return float(swing_foot(walker, shape, p)[0])


def swing_foot(walker: type[Walker], shape: Array, p: Array) -> Array:
    """Position of the swing foot relative to the stance foot [m], shape (2,)."""
    return buffered(_feet(walker))(shape, p)[0].copy()


def before_impact(walker: type[Walker], shape: Array, p: Array) -> Array:
    """The shape coordinates just before an impact, from those just after it; shape (n_shape,)."""
    return buffered(_feet(walker))(shape, p)[1].copy()


@built_once(maxsize=8)
def _feet(walker: type[Walker]) -> Function:
    """(shape just after an impact, p) -> position of the swing foot, and the shape just before the impact."""
    (q, p, mechanism, _), n = symbolic_mechanism(walker), len(walker.shape)
    s, relabel = q[:n], SX(mechanism.relabel)
    swing_foot = substitute(mechanism.swing_foot, q[n:], SX.zeros(2))
    swap, offset = jacobian(relabel, s), substitute(relabel, s, SX.zeros(s.numel()))
    return Function("feet", [s, p], [densify(swing_foot), densify(solve(swap, s - offset))])


@lru_cache(maxsize=64)
def _fault(walker: type[Walker], parameters: tuple[float, ...]) -> str | None:
    """Message about the first contradiction of a walker; None if there is none."""
    p, n = np.array(parameters), len(walker.shape)
    if has_links(walker) and not is_default(walker, "mechanism"):
        reason = _links_fault(walker, p)
        if reason is not None:
            return reason
    if walker.contacts:
        return _contacts_fault(walker, p)
    straight = posture_at(walker, np.zeros(n + 2), np.zeros(n + 2), p)
    if not (np.isfinite(straight.bodies).all() and (straight.bodies[:, :2] >= 0).all()):
        return "a body has a mass or inertia that is negative or no number"
    length, mass = np.linalg.norm(straight.bodies[:, 2:4], axis=1).max(initial=0.0), straight.bodies[:, 0].sum()
    if not (length > 0 and np.linalg.norm(straight.gravity) > 0 and mass > 0):
        return _undefined(walker, np.zeros(n), p) or "its length, mass or gravity is zero"
    scales = Scales.of(length, float(np.linalg.norm(straight.gravity)), mass)
    random = np.random.default_rng(0)
    spread = min(SPREAD, walker.largest_angle)
    steps = walker.step_parameters(p)
    solved, near = is_default(walker, "after_impact"), [walker.posture.get(name, 0.0) for name in walker.section]
    for k in range(TOUCHDOWNS):
        before, after = steps[k % len(steps)], steps[(k + 1) % len(steps)]
        here = near if solved and not k else near + spread * random.uniform(-1, 1, len(walker.section))
        free = dict(zip(walker.section, here, strict=True))
        if solved and not np.isfinite(section_posture(walker, free, after)[0]).all():
            if not k:
                return _never_closed(walker, free)
            continue  # the legs do not reach the ground, which only matters near the posture of the class
        reason = _undefined_after_impact(walker, free, after)
        if reason is None and k < CHECKED_TOUCHDOWNS:
            rates = random.standard_normal(n) / scales.time
            reason = _touchdown_fault(walker, (before, after), free, rates, scales)
        if reason is not None:
            return reason
    return None


def _contacts_fault(walker: type[Walker], p: Array) -> str | None:
    """Message about the first contradiction of a walker with several contacts; None if there is none."""
    eom, n, partner = equations_of_motion(walker), len(walker.shape), walker.partners()
    contacts, p_plus = eom.mechanism.contacts, walker.step_parameters(p)[-1]
    size = Function("size", [eom.p], [eom.length, eom.gravity, eom.mass])
    length, gravity, mass = (float(np.asarray(value).item()) for value in size(p))
    if not (length > 0 and gravity > 0 and mass > 0):
        return "its length, mass or gravity is zero"
    scales = Scales.of(length, gravity, mass)
    random, massless = np.random.default_rng(0), {k for contact in contacts.values() for k in contact.places}
    closing = [walker.stops.index(name) for name in walker.closing_stops]
    kept = [k for k, name in enumerate((*walker.shape, "x", "y")) if name not in massless]
    for _ in range(CHECKED_TOUCHDOWNS):
        q = random.uniform(-SPREAD, SPREAD, n + 2)
        dq = random.standard_normal(n + 2) / scales.time
        here = posture_at(walker, q, dq, p)
        if closing:  # they are locked when the feet swap roles
            slope = here.gap_jacobian[closing]
            q[:n] -= np.linalg.pinv(slope) @ here.gaps[closing]
            dq[:n] -= np.linalg.pinv(slope) @ (slope @ dq[:n])
            here = posture_at(walker, q, dq, p)
        if not all(np.isfinite(value).all() for value in (here.mass_matrix, here.contacts, here.spring_energy)):
            return f"its equations are not finite at {_posture_words(walker, q[:n])}"
        reason = _without_inertia(walker, here.mass_matrix[np.ix_(kept, kept)])
        if reason is not None or not walker.landing_contacts:
            return reason
        q_plus, dq_plus = np.array([*here.relabel, *here.foot[0]]), np.array([*here.relabel_rate, *here.foot[1]])
        there = posture_at(walker, q_plus, dq_plus, p_plus)
        reason = _jump(here.bodies, there.bodies, scales)
        if reason is not None:
            free = ", ".join(name for name in walker.stops if name not in walker.closing_stops)
            return f"{reason}; if they are so while {free} is locked, name it in closing_stops" if free else reason
        for k, name in enumerate(contacts):
            other = partner.get(name, name)
            if np.abs(there.contacts[[*contacts].index(other)] - here.contacts[k]).max() > AGREEMENT * length:
                return f"the contact {name} is not where {other} is after the feet have swapped places"
        if reason := _energy_jump(here, there, scales):
            return reason
    return None


def _energy_jump(before: "Posture", after: "Posture", scales: Scales) -> str | None:
    """Message about springs whose energy changes when the feet swap roles."""
    energies = before.spring_energy, after.spring_energy
    if abs(energies[1] - energies[0]) <= AGREEMENT * max(scales.energy, abs(energies[0])):
        return None
    change = f"from {energies[0]:.6g} J to {energies[1]:.6g} J when the feet swap roles"
    return f"its potential energy jumps {change}: springs must be the same on both legs"


def _never_closed(walker: type[Walker], free: Mapping[str, float]) -> str:
    """Message about legs that do not close in the posture of the class."""
    values = ", ".join(f"{name} = {value:.4g}" for name, value in free.items()) or "the posture after an impact"
    solved = ", ".join(name for name in walker.shape if name not in free)
    return (
        f"no {solved} closes the legs at {values}: touchdown is not zero in any posture near it; "
        "state a posture just after an impact in posture"
    )


def _undefined_after_impact(walker: type[Walker], free: Mapping[str, float], p: Array) -> str | None:
    """Message about a coordinate that is not a number just after the touchdown with section coordinates ``free``."""
    shape, rates = section_posture(walker, free, p)
    values = ", ".join(f"{name} = {value:.4g}" for name, value in free.items())
    at = f"at {values}" if values else "whatever the posture"
    for method, prefix, results in (("after_impact", "", shape), ("rates_after_impact", "d", rates)):
        for name, value in zip(walker.shape, results, strict=True):
            if not np.isfinite(value):
                rest = " and rates of zero" if prefix else ""
                return f"{method} gives {prefix}{name} = {value:g} {at}{rest}, but must give a number"
    return _undefined(walker, shape, p)


def _touchdown_fault(
    walker: type[Walker], legs: tuple[Array, Array], free: Mapping[str, float], rates: Array, scales: Scales
) -> str | None:
    """Message about a contradiction at the touchdown that leads to the section coordinates ``free``.

    Parameters
    ----------
    legs : parameters before and after touchdown; they differ if the legs do.
    """
    p, p_plus = legs
    s_plus, _ = section_posture(walker, free, p_plus)
    if walker.massless_feet:
        before = posture_at(walker, np.array([*s_plus, 0, 0]), np.zeros(s_plus.size + 2), p)
        q_plus = np.array([*before.relabel, *before.foot[0]])
        after = posture_at(walker, q_plus, np.zeros(s_plus.size + 2), p)
        if is_default(walker, "landing"):  # the rates with which the bodies move on must exist
            moves = [
                posture_at(walker, q_plus, np.array([*e, 0, 0]), p).bodies[:, 4:].ravel() for e in np.eye(rates.size)
            ]
            moving = posture_at(walker, np.array([*s_plus, 0, 0]), np.array([*rates, 0, 0]), p).bodies[:, 4:].ravel()
            left = moving - np.transpose(moves) @ np.linalg.lstsq(np.transpose(moves), moving, rcond=None)[0]
            if np.abs(left).max() > AGREEMENT * np.abs(moving).max():
                return "has massless feet, but its bodies cannot move on as they did when a foot lands: define landing"
        return _jump(before.bodies, after.bodies, scales) or _without_inertia(
            walker, before.mass_matrix[: rates.size, : rates.size]
        )
    s_minus = _before_relabelling(walker, s_plus, p)
    if s_minus is None:
        return "relabel cannot be inverted: after the swap of the feet the posture before it is no longer known"
    swing = (_undefined(walker, s_plus + fraction * (s_minus - s_plus), p) for fraction in SWING_FRACTIONS)
    undefined = next((reason for reason in swing if reason is not None), None)
    if undefined is not None:
        return undefined
    J = posture_at(walker, np.array([*s_minus, 0, 0]), np.zeros(rates.size + 2), p).gap_jacobian
    locked = rates - np.linalg.pinv(J) @ J @ rates  # all stops are locked at touchdown
    before = posture_at(walker, np.array([*s_minus, 0, 0]), np.array([*locked, 0, 0]), p)
    q_plus = np.array([*s_plus, *before.foot[0]])
    after = posture_at(walker, q_plus, np.array([*before.relabel_rate, *before.foot[1]]), p_plus)
    if abs(before.guard) > AGREEMENT * before.guard_slope or after.guard > AGREEMENT * after.guard_slope:
        return (
            "after_impact and touchdown contradict each other: a step would begin in the posture "
            f"{_posture_words(walker, s_plus)}, which is not that just after a touchdown "
            f"(guard {before.guard:.3g} before relabelling, {after.guard:.3g} after it)"
        )
    if np.abs([*before.gaps, *after.gaps]).max(initial=0.0) > AGREEMENT:
        return "a stop is not at its end at touchdown, or not just after it: its gap must be zero in both postures"
    if abs(before.foot[0, 1]) > AGREEMENT * scales.length:
        return f"the swing foot is {before.foot[0, 1]:.3g} m above the ground where touchdown is zero"
    if after.upright < FALLEN:
        where = _posture_words(walker, s_plus)
        return f"upright is {after.upright:.3g} just after a touchdown, at {where}: it must be positive while it walks"
    if reason := _jump(before.bodies, after.bodies, scales) or _energy_jump(before, after, scales):
        return reason
    if before.dissipation < 0:
        power = f"{-before.dissipation:.3g} W at a touchdown"
        return f"its dampers give energy, {power}: their coefficients must not be negative"
    return _without_inertia(walker, after.mass_matrix[: rates.size, : rates.size])


def _links_fault(walker: type[Walker], p: Array) -> str | None:
    """Message about links that contradict the mechanism: another inertia, weight or swing foot."""
    random, pairs = np.random.default_rng(0), _links_pairs(walker)
    if pairs is None:
        return None
    names = ("mass matrix", "centre of mass", "swing foot", "angle of a motor that has the name of a joint")
    for _ in range(CHECKED_TOUCHDOWNS):
        shape = random.uniform(-1, 1, len(walker.shape))
        values = list(map(np.asarray, pairs(shape, p)))
        for name, stated, follows in zip(names, values[::2], values[1::2], strict=True):
            if not np.abs(stated - follows).max() <= LINKS_TOLERANCE * np.abs(stated).max():
                where = _posture_words(walker, shape)
                return f"links and mechanism contradict each other: the {name} differs, at {where}"
    return None


@built_once(maxsize=8)
def _links_pairs(walker: type[Walker]) -> Function | None:
    """(shape, p) -> pairs of the mechanism's and the links' mass matrix, mass moment, swing foot, and motors.

    None if both state the same expressions, as in a mechanism that only refines that of the links.
    """
    q, p, mechanism, tree = symbolic_mechanism(walker)
    assert tree is not None  # the caller has asked
    motors = dict(zip(walker.actuators, mechanism.motors, strict=True))
    shared = [name for name in walker.actuators if name in tree.joints]

    def stated(bodies: tuple[Body, ...], swing_foot: SX, motors: Mapping[str, SX]) -> list[SX]:
        of_bodies = (vertcat(body.mass, body.inertia, body.position, body.angle) for body in bodies)
        return [*of_bodies, swing_foot, *(SX(motors[name]) for name in shared)]

    def properties(bodies: tuple[Body, ...], swing_foot: SX, motors: Mapping[str, SX]) -> tuple[SX, ...]:
        moment = sum((body.mass * body.position for body in bodies), SX.zeros(2))
        angles = vertcat(SX(0), *(motors[name] for name in shared))
        return inertia(bodies, q, SX.zeros(q.numel()))[0], moment, swing_foot, angles

    sides = (mechanism.bodies, mechanism.swing_foot, motors), (tree.bodies(), tree.swing_foot, tree.joints)
    ours, theirs = (stated(*side) for side in sides)
    if len(ours) == len(theirs) and all(map(_is_same, ours, theirs)):
        return None
    outputs = [densify(output) for pair in zip(*(properties(*side) for side in sides), strict=True) for output in pair]
    shape = q[: len(walker.shape)]
    at_foot = substitute(vertcat(*map(vec, outputs)), q[len(walker.shape) :], SX.zeros(2))
    sizes = np.cumsum([0, *(output.numel() for output in outputs)])
    return Function("links", [shape, p], [at_foot[a:b] for a, b in pairwise(map(int, sizes))])


def _is_same(one: SX, other: SX) -> bool:
    """Whether two expressions consist of the same operations."""
    return one.shape == other.shape and is_equal(one, other, COMPARISON_DEPTH)


def _before_relabelling(walker: type[Walker], s_plus: Array, p: Array) -> Array | None:
    """The shape coordinates that ``relabel`` maps to ``s_plus``, by Newton's method."""
    s, foot = s_plus.copy(), np.zeros(2)
    for _ in range(NEWTON_STEPS):
        here = posture_at(walker, np.concatenate([s, foot]), np.zeros(s.size + 2), p)
        if not np.isfinite(here.relabel_jacobian).all() or np.linalg.cond(here.relabel_jacobian) > 1 / AGREEMENT:
            return None
        if np.abs(here.relabel - s_plus).max() < AGREEMENT / 10:
            return s
        s = s - np.linalg.solve(here.relabel_jacobian, here.relabel - s_plus)
    return None


def _jump(before: Array, after: Array, scales: Scales) -> str | None:
    """Message about a body without counterpart after the swap of the feet; for the rows see ``Posture.bodies``."""
    before, after = (bodies[(bodies[:, :2] > 0).any(axis=1)] for bodies in (before, after))
    first, second = before[:, None], after[None, :]
    size = np.maximum(np.abs(first[..., :2]), np.abs(second[..., :2]))
    relative = np.abs(first[..., :2] - second[..., :2]) / np.where(size > 0, size, 1.0)
    # the sign of an angle is a convention, which may differ between the legs
    spin = np.where(first[..., 1] > 0, np.abs(np.abs(first[..., 6]) - np.abs(second[..., 6])) * scales.time, 0.0)
    units = np.array([scales.length, scales.length, scales.speed, scales.speed])
    moved = np.abs(first[..., 2:6] - second[..., 2:6]) / units
    distances = np.concatenate([relative, moved, spin[..., None]], axis=-1).max(axis=-1)
    for body, row in zip(before, distances, strict=True):
        partner = int(np.argmin(row))
        if not row[partner] <= AGREEMENT:
            mass, _, x, y = body[:4]
            return (
                f"its masses jump when the feet swap roles: the body of {mass:g} kg at ({x:.4g}, {y:.4g}) m is not "
                "there, or does not move so, just after it; both legs must have the same masses at the same places, "
                "and relabel must describe the same posture and motion from the other foot"
            )
        distances[:, partner] = np.inf  # is the counterpart of no other body
    return None


def _without_inertia(walker: type[Walker], mass_matrix: Array) -> str | None:
    """Message about a mass matrix that is not positive definite."""
    diagonal = np.diag(mass_matrix)
    if not (diagonal > 0).all():
        massless = ", ".join(name for name, value in zip(walker.shape, diagonal, strict=True) if not value > 0)
        return f"nothing has inertia against {massless}: the mass matrix is singular"
    normalised = mass_matrix / np.sqrt(np.outer(diagonal, diagonal))
    if np.linalg.eigvalsh(normalised)[0] > SMALLEST_EIGENVALUE:
        return None
    return f"the mass matrix is not positive definite: {', '.join(walker.shape)} do not move masses independently"


def _undefined(walker: type[Walker], shape: Array, p: Array) -> str | None:
    """Message about an expression that is not a finite number for a walker at rest in a posture."""
    names, function = _definition(walker)
    (values,) = buffered(function)(shape, p)
    bad = np.flatnonzero(~np.isfinite(values))
    if not bad.size:
        return None
    return f"{names[bad[0]]} is {values[bad[0]]:g} at {_posture_words(walker, shape)}, but must be a number"


def _posture_words(walker: type[Walker], shape: Array) -> str:
    """A posture in messages: ``theta1 = 0.2, theta2 = 0.2``."""
    return ", ".join(f"{name} = {value:.4g}" for name, value in zip(walker.shape, shape, strict=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class Posture:
    """A walker at one state, as numbers.

    Attributes
    ----------
    bodies : ndarray, shape (n_bodies, 7) - mass, inertia, position (2), velocity (2), spin.
    foot : ndarray, shape (2, 2) - position and velocity of the swing foot, in rows.
    relabel, relabel_rate : ndarray, shape (n_shape,) - shape coordinates and rates after a swap of the feet.
    relabel_jacobian : ndarray, shape (n_shape, n_shape) - derivative of ``relabel``.
    mass_matrix : ndarray, shape (n_shape + 2, n_shape + 2) - mass matrix for the shape and the base point.
    contacts : ndarray, shape (n_contacts, 2) - positions of the named contacts.
    guard, guard_slope : the guard of touchdown, and the length of its gradient.
    upright : number that is positive unless the walker has fallen.
    spring_energy : potential energy without that of gravity [J]; with named contacts, of all springs whether they act
        or not.
    dissipation : power that the dampers dissipate [W].
    gravity : ndarray, shape (2,) - acceleration of gravity [m/s^2].
    gaps : ndarray, shape (n_stops,) - gaps of the joint stops.
    gap_jacobian : ndarray, shape (n_stops, n_shape) - their derivative.
    """

    bodies: Array
    foot: Array
    relabel: Array
    relabel_jacobian: Array
    relabel_rate: Array
    mass_matrix: Array
    contacts: Array
    guard: float
    guard_slope: float
    upright: float
    spring_energy: float
    dissipation: float
    gravity: Array
    gaps: Array
    gap_jacobian: Array


def posture_at(walker: type[Walker], q: Array, dq: Array, p: Array) -> Posture:
    """The walker at coordinates ``q`` and rates ``dq``, both of shape (n_shape + 2,), and parameters ``p``."""
    function, shapes = _kinematics(walker)
    outputs = zip(shapes.items(), buffered(function)(q, dq, p), strict=True)
    values: dict[str, Any] = {
        name: out.reshape(shape, order="F").copy() if shape else out.item() for (name, shape), out in outputs
    }
    return Posture(**values)


@built_once(maxsize=8)
def _kinematics(walker: type[Walker]) -> tuple[Function, dict[str, tuple[int, ...]]]:
    """(q, dq, p) -> the entries of ``Posture``, and the shape of each by name."""
    n, (q, p, mechanism, _) = len(walker.shape), symbolic_mechanism(walker)
    dq = SX.sym("dq", q.numel())
    bodies = []
    for body in mechanism.bodies:
        velocity, spin = jtimes(body.position, q, dq), jtimes(SX(body.angle), q, dq)
        bodies.append(vertcat(body.mass, body.inertia, body.position, velocity, spin))
    foot, relabel, guard = mechanism.swing_foot, SX(mechanism.relabel), SX(mechanism.touchdown)
    slope, gaps = jacobian(relabel, q[:n]), vertcat(SX(0, 1), *mechanism.stops.values())
    points, sometimes = [contact.position for contact in mechanism.contacts.values()], mechanism.potential_while
    springs = (SX(mechanism.potential), *(sometimes.values() if points else ()))
    losses = (SX(d.coefficient) * jtimes(SX(d.across), q, dq) ** 2 for d in mechanism.dampers)
    outputs = {
        "bodies": horzcat(*bodies).T,
        "foot": horzcat(foot, jtimes(foot, q, dq)).T,
        "relabel": relabel,
        "relabel_jacobian": slope,
        "relabel_rate": slope @ dq[:n],
        "mass_matrix": inertia(mechanism.bodies, q, dq)[0],
        "contacts": horzcat(SX(2, 0), *points).T,
        "guard": guard,
        "guard_slope": norm_2(densify(jacobian(guard, q[:n])).T),
        "upright": mechanism.upright,
        "spring_energy": sum(springs, SX(0)),
        "dissipation": sum(losses, SX(0)),
        "gravity": mechanism.gravity,
        "gaps": gaps,
        "gap_jacobian": jacobian(gaps, q[:n]),
    }
    function = Function("kinematics", [q, dq, p], [*outputs.values()], ["q", "dq", "p"], [*outputs])
    shapes: dict[str, tuple[int, ...]] = {name: function.size_out(name) for name in outputs}
    shapes |= {name: (function.numel_out(name),) for name in ("relabel", "relabel_rate", "gravity", "gaps")}
    return function, shapes | dict.fromkeys(("guard", "guard_slope", "upright", "spring_energy", "dissipation"), ())


@built_once(maxsize=8)
def _definition(walker: type[Walker]) -> tuple[tuple[str, ...], Function]:
    """Names of all expressions that define a walker, and (shape, p) -> their values for the walker at rest.

    The derivatives of the expressions of a mechanism are included, because the equations of motion contain them.
    """
    (coordinates, p, m, tree), n = symbolic_mechanism(walker), len(walker.shape)
    shape, (q, parameters) = coordinates[:n], named_arguments(walker, coordinates, p)
    dq = SimpleNamespace(**{name: SX(0) for name in vars(q)})
    stated = {
        "Mechanism.gravity": m.gravity,
        "Mechanism.swing_foot": m.swing_foot,
        "Mechanism.touchdown": m.touchdown,
        "Mechanism.upright": m.upright,
        "Mechanism.relabel": m.relabel,
        "Mechanism.potential": m.potential,
    }
    for k, body in enumerate(m.bodies):
        entries = {"mass": body.mass, "position": body.position, "inertia": body.inertia, "angle": body.angle}
        stated |= {f"Mechanism.bodies[{k}].{name}": entry for name, entry in entries.items()}
    stated |= {f"Mechanism.motors[{k}]": angle for k, angle in enumerate(m.motors)}
    stated |= {f"Mechanism.dampers[{k}].coefficient": damper.coefficient for k, damper in enumerate(m.dampers)}
    stated |= {f"Mechanism.dampers[{k}].across": damper.across for k, damper in enumerate(m.dampers)}
    stated |= {f"Mechanism.stops[{name!r}]": gap for name, gap in m.stops.items()}
    stated |= {f"Mechanism.potential_while[{state!r}]": energy for state, energy in m.potential_while.items()}
    stated |= {f"the push of {name}": impulse for name, impulse in m.pushes.items()}
    slopes = {f"the derivative of {name}": jacobian(expression, shape) for name, expression in stated.items()}
    stated |= {f"Mechanism.switches[{name!r}]": margin(dq) for name, margin in m.switches.items()}
    if walker.massless_feet and not is_default(walker, "landing"):
        landed = state_landing(walker, q, dq, parameters)
        stated |= {f"{name} after landing": values for name, values in zip(("posture", "rate"), landed, strict=True)}
    lines, contact = state_picture(walker, q, parameters, tree)
    stated |= {f"line {k} of outline": vertcat(*line) for k, line in enumerate(lines)}
    stated |= {"contact": contact} | slopes
    names = tuple(name for name, expression in stated.items() for _ in range(expression.numel()))
    values = substitute(densify(vertcat(*map(vec, stated.values()))), coordinates[n:], SX.zeros(2))
    return names, Function("definition", [shape, p], [values])
