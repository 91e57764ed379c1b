"""Scalars of one step: period, speed, cost, forces, slip, clearance, with their units in the docstring of ``measure``.

The NLP and the simulator both provide arcs at Chebyshev points, so both are measured by the same functions.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.trajectory import Arc, Step
from gaitopt.model.buffered import buffered, buffered_map
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.model.units import Scales
from gaitopt.problem.scalars import SCALARS

MEASURES = tuple(name for name in SCALARS if name != "spectral_radius")
"""Names of what ``measure`` finds, in order."""


ENDS = np.array([-1.0, 1.0])
ON_THE_SPOT = 1e-9
"""Length of a step, in leg lengths, below which there is none."""
WITHOUT_FORCE = 1e-9
"""Part of the largest contact force below which it counts as zero, as the force of a massless leg's spring may be."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """Quantities along one arc, all at its times (m points).

    Attributes
    ----------
    force : ndarray, shape (m, 2) - contact force (f_t, f_n) [N].
    torque : ndarray, shape (m, n_u) - [N m].
    power : ndarray, shape (m, n_u) - of each motor [W].
    swing_foot : ndarray, shape (m, 2) - position [m].
    energy : ndarray, shape (m,) - kinetic plus potential [J].
    loss : ndarray, shape (m,) - power that the dampers take [W].
    """

    force: Array
    torque: Array
    power: Array
    swing_foot: Array
    energy: Array
    loss: Array


def observe(dynamics: Dynamics, arc: Arc) -> Observation:
    """Evaluate contact force, torques, power, swing foot and energy along ``arc``."""
    observation = buffered_map(dynamics.system.observation(arc.mode), arc.times.size)
    own, data = dynamics.standing(arc.side).p, dynamics.system.data(arc.segment)
    outputs = observation(arc.times[:, None], arc.states, own, data)
    force, torque, power, foot, energy, _, loss = (value.copy() for value in outputs)
    return Observation(force=force, torque=torque, power=power, swing_foot=foot, energy=energy[:, 0], loss=loss[:, 0])


def measure(dynamics: Dynamics, steps: Sequence[Step]) -> dict[str, float | None]:
    """Scalars of complete steps by the names of the result; lengths and works are sums over all of them.

    ``period`` [s]; ``step_length``, ``slip_distance``, ``foot_clearance`` [m]; ``speed`` [m/s]; ``work``,
    ``damping_loss`` [J]; ``cost_of_transport``, ``absolute_cost_of_transport`` (work per weight and step length, None
    on the spot); ``torque_squared`` (integral of u'u) [N^2 m^2 s]; ``peak_torque`` [N m]; ``required_friction``
    (largest ``|f_t|/f_n`` while sticking, None without sticking), ``impulse_ratio`` (None without an impulse);
    ``min_normal_force`` on the ground [N].

    ``foot_clearance`` is the largest height of the swing foot after mid-swing, when the legs have passed each other; of
    several steps the least of these. The work is that of motors and pushes.

    References
    ----------
    Gamus & Or (2013), eq. (22) for the cost of transport.
    """
    impacts = [step.final_impact for step in steps]
    by_step = [[(arc, observe(dynamics, arc)) for arc in step.arcs] for step in steps]
    observed = [pair for pairs in by_step for pair in pairs]
    driven = [(arc.duration, o.power, o.torque) for arc, o in observed if o.torque.any()]
    pushed = sum(impact.push_work for impact in impacts)
    work = pushed + sum(curves.integral(power.sum(axis=1), duration) for duration, power, _ in driven)
    absolute = abs(pushed) + sum(
        curves.absolute_integral(column, duration) for duration, power, _ in driven for column in power.T
    )
    length, period = sum(impact.step_length for impact in impacts), sum(step.period for step in steps)
    moves = abs(length) > ON_THE_SPOT * dynamics.scales.length
    weighted_length = float(buffered(dynamics.system.weight)(dynamics.p)[0][0]) * length
    sticking = [friction_ratio(o.force) for a, o in observed if a.mode.sticks]
    return {
        "period": period,
        "step_length": length,
        "speed": length / period,
        "work": work,
        "damping_loss": sum(curves.integral(o.loss, a.duration) for a, o in observed),
        "cost_of_transport": work / weighted_length if moves else None,
        "absolute_cost_of_transport": absolute / weighted_length if moves else None,
        "torque_squared": sum(curves.integral((torque**2).sum(axis=1), duration) for duration, _, torque in driven),
        "peak_torque": max((_peak(column) for _, _, torque in driven for column in torque.T), default=0.0),
        "slip_distance": sum(_slip(dynamics.system, a) for a, _ in observed),
        "foot_clearance": min(max(_clearances(pairs), default=0.0) for pairs in by_step),
        "required_friction": max((_peak(ratio) for ratio in sticking), default=None),
        "impulse_ratio": max((r for r in (impact.impulse_ratio for impact in impacts) if r is not None), default=None),
        "min_normal_force": min(-curves.maximum(-o.force[:, 1])[1] for a, o in observed if not a.mode.flies),
    }


def measure_scales(scales: Scales) -> dict[str, float]:
    """Natural unit of every measure by its name; one where it is a ratio."""
    return {name: SCALARS[name].within.size(scales) for name in MEASURES}


def friction_ratio(force: Array) -> Array:
    """f_t / f_n along an arc from its contact force (m, 2); where a spring's force is zero at an end, its limit."""
    nothing, full = WITHOUT_FORCE * np.abs(force).max(), force.copy()
    for end in (0, -1):
        if abs(force[end, 1]) <= nothing:
            full[end] = [curves.slopes(column, ENDS)[end] for column in force.T]
    return np.asarray(full[:, 0] / full[:, 1])


def _peak(values: Array) -> float:
    return max(curves.maximum(values)[1], curves.maximum(-values)[1])


def _slip(system: HybridSystem, arc: Arc) -> float:
    x = arc.states[:, system.n_shape]
    return float(abs(x[-1] - x[0])) if arc.mode.slips else 0.0


def _clearances(observed: list[tuple[Arc, Observation]]) -> Iterator[float]:
    """Largest height of the swing foot in each arc, in flight or where it is ahead of the stance foot."""
    for arc, o in observed:
        if arc.mode.flies:
            yield curves.maximum(o.swing_foot[:, 1])[1]
            continue
        ahead = o.swing_foot[:, 0] - arc.states[:, arc.states.shape[1] // 2 - 1]
        if ahead[-1] > 0:
            passing = curves.roots(ahead)
            yield curves.maximum(o.swing_foot[:, 1], start=passing[-1] if passing.size else -1.0)[1]
