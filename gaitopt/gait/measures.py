"""Scalars of one step: period, speed, cost, forces, slip, clearance, with their units in the docstring of ``measure``.

The NLP and the simulator both provide arcs at Chebyshev points, so both are measured by the same functions.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.trajectory import Arc, Step
from gaitopt.mechanics import HybridSystem, Scales
from gaitopt.mechanics.buffered import buffered_map
from gaitopt.problem.scalars import SCALARS

MEASURES = tuple(name for name in SCALARS if name != "spectral_radius")
"""Names of what ``measure`` finds, in order."""


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
    """

    force: Array
    torque: Array
    power: Array
    swing_foot: Array
    energy: Array


def observe(system: HybridSystem, p: Array, arc: Arc) -> Observation:
    """Evaluate contact force, torques, power, swing foot and energy along ``arc``."""
    observation = buffered_map(system.observation(arc.mode), arc.times.size)
    outputs = observation(arc.times[:, None], arc.states, p, system.data(arc.segment))
    force, torque, power, foot, energy, _ = (value.copy() for value in outputs)
    return Observation(force=force, torque=torque, power=power, swing_foot=foot, energy=energy[:, 0])


def measure(system: HybridSystem, p: Array, steps: Sequence[Step]) -> dict[str, float | None]:
    """Scalars of complete steps by the names of the result; lengths and works are sums over all of them.

    ``period`` [s]; ``step_length``, ``slip_distance``, ``foot_clearance`` [m]; ``speed`` [m/s]; ``work`` [J];
    ``cost_of_transport``, ``absolute_cost_of_transport`` (work per weight and step length); ``torque_squared``
    (integral of u'u) [N^2 m^2 s]; ``peak_torque`` [N m]; ``required_friction`` (largest ``|f_t|/f_n`` while sticking,
    None without sticking), ``impulse_ratio``; ``min_normal_force`` [N].

    ``foot_clearance`` is the largest height of the swing foot after mid-swing, when the legs have passed each other; of
    several steps the least of these.

    References
    ----------
    Gamus & Or (2013), eq. (22) for the cost of transport.
    """
    impacts = [step.final_impact for step in steps]
    by_step = [[(arc, observe(system, p, arc)) for arc in step.arcs] for step in steps]
    observed = [pair for pairs in by_step for pair in pairs]
    work = sum(curves.integral(o.power.sum(axis=1), a.duration) for a, o in observed)
    absolute = sum(curves.absolute_integral(column, a.duration) for a, o in observed for column in o.power.T)
    length, period = sum(impact.step_length for impact in impacts), sum(step.period for step in steps)
    weighted_length = float(system.weight(p)) * length
    sticking = [o.force[:, 0] / o.force[:, 1] for a, o in observed if a.mode.sticks]
    return {
        "period": period,
        "step_length": length,
        "speed": length / period,
        "work": work,
        "cost_of_transport": work / weighted_length,
        "absolute_cost_of_transport": absolute / weighted_length,
        "torque_squared": sum(curves.integral((o.torque**2).sum(axis=1), a.duration) for a, o in observed),
        "peak_torque": max((_peak(column) for _, o in observed for column in o.torque.T), default=0.0),
        "slip_distance": sum(_slip(system, a) for a, _ in observed),
        "foot_clearance": min(max(_clearances(pairs), default=0.0) for pairs in by_step),
        "required_friction": max((_peak(ratio) for ratio in sticking), default=None),
        "impulse_ratio": max(impact.impulse_ratio for impact in impacts),
        "min_normal_force": min(-curves.maximum(-o.force[:, 1])[1] for _, o in observed),
    }


def measure_scales(scales: Scales) -> dict[str, float]:
    """Natural unit of every measure by its name; one where it is a ratio."""
    return {name: SCALARS[name].within.size(scales) for name in MEASURES}


def _peak(values: Array) -> float:
    return max(curves.maximum(values)[1], curves.maximum(-values)[1])


def _slip(system: HybridSystem, arc: Arc) -> float:
    x = arc.states[:, system.n_shape]
    return 0.0 if arc.mode.sticks else float(abs(x[-1] - x[0]))


def _clearances(observed: list[tuple[Arc, Observation]]) -> Iterator[float]:
    """Largest height of the swing foot in each arc, counted where the swing foot is ahead of the stance foot."""
    for arc, o in observed:
        ahead = o.swing_foot[:, 0] - arc.states[:, arc.states.shape[1] // 2 - 1]
        if ahead[-1] > 0:
            passing = curves.roots(ahead)
            yield curves.maximum(o.swing_foot[:, 1], start=passing[-1] if passing.size else -1.0)[1]
