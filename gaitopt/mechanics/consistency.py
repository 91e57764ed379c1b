"""Whether a walker is made of numbers, and is the same body just before and just after its feet swap roles.

An impact changes velocities by impulses at the feet and renames the coordinates; it moves no mass and stores no energy.
With s_plus = relabel(s_minus) and the stance foot at the former swing foot, at every touchdown

    bodies_plus = bodies_minus      mass, inertia, position, velocity and spin, in any order
    V_plus = V_minus                potential energy of springs; dampers store none, and take some
    s_minus lies on the guard       for every s_plus out of ``after_impact``, and all stops are locked there

(of walkers with massless feet the positions alone).

Everything else (return map, multipliers, costs) stands on that, so a walker that breaks it is refused.
"""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from gaitopt.arrays import Array
from gaitopt.errors import ProblemError
from gaitopt.mechanics.declaration import calling, check_class, shown
from gaitopt.mechanics.posture import Posture, not_a_number, posture, posture_words, section_posture
from gaitopt.mechanics.scales import Scales
from gaitopt.mechanics.units import LARGEST
from gaitopt.mechanics.walker import Walker

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
    for k in range(TOUCHDOWNS):
        legs = walker.standing(p, walker.side(k)), walker.standing(p, walker.side(k + 1))
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
