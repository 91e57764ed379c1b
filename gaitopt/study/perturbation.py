"""A gait on the simulator's return map: fixed point, multipliers, and walks that start slightly off it."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.gait import Ending, Gait, floquet_multipliers
from gaitopt.gait.multipliers import multiplier_distance
from gaitopt.orbit import ReturnMap
from gaitopt.orbit.return_map import FixedPoint, Return
from gaitopt.study.claims import Claim, claim, failed_claim
from gaitopt.study.comparison import AGREEMENT

MULTIPLIER_AGREEMENT = 1e-7
PERTURBATION = 1e-6
LINEAR_RANGE = (1e-9, 4e-4)
"""Below it rounding rules, above it the curvature of the return map; in natural units, as the perturbation."""
PERTURBED_STEPS = 50
LINEARITY = 1e-3
"""Rounding of a step, 1e-12, over the smallest deviation; third-order terms, 6000 times (4e-4)^2, in the largest.

Opposite perturbations are followed together: the map's curvature drops out of half their difference, so that one
tolerance serves all walkers; the gaits of the paper stay below 1e-5.
"""


def return_map_claims(gait: Gait, return_map: ReturnMap) -> Iterator[Claim]:
    """Fixed point, multipliers and a perturbation, all on the simulator's return map."""
    section = gait.system.section(gait.problem.cycle.impact)
    xi, unit = gait.state[section], gait.dynamics.state_units[section]
    point = return_map.fixed_point(xi)
    if point.jacobian is None:
        yield failed_claim("state", AGREEMENT, f"no fixed point of the simulated return map: {point.message}")
        return
    distance = np.abs((point.xi - xi) / unit).max() + _remaining(point, section, unit)
    yield claim("state", distance, AGREEMENT, "distance to the fixed point of the simulator")
    disagreement = multiplier_distance(floquet_multipliers(point.jacobian), gait.multipliers)
    yield claim("multipliers", disagreement, MULTIPLIER_AGREEMENT, "saltation against implicit differentiation")
    yield perturbation_claim(return_map, point, unit)


def _remaining(point: FixedPoint, section: NDArray[np.intp], unit: Array) -> float:
    """Distance to the fixed point where rounding stops Newton's method short of it: its next correction."""
    if point.converged:
        return 0.0
    impact = point.steps[-1].impact
    if point.jacobian is None or impact is None:
        return np.inf
    defect = impact.state[section] - point.xi
    correction = np.linalg.lstsq(_scaled(point.jacobian, unit) - np.eye(unit.size), defect / unit, rcond=None)[0]
    return float(np.abs(correction).max())


def _scaled(jacobian: Array, unit: Array) -> Array:
    """The derivative of the return map between section coordinates in natural units."""
    return jacobian * unit / unit[:, None]


def perturbation_claim(return_map: ReturnMap, point: FixedPoint, unit: Array) -> Claim:
    """Two small opposite perturbations follow the powers of the return map's derivative.

    ``unit``, shape (n_xi,), are the natural units of the section coordinates.
    """
    if point.jacobian is None:
        return failed_claim("perturbation", LINEARITY, point.message)
    jacobian = _scaled(point.jacobian, unit)
    predicted = np.full(unit.size, PERTURBATION / np.sqrt(unit.size))
    pair, worst, steps = [predicted, -predicted], 0.0, 0
    lowest, highest = LINEAR_RANGE
    for step in range(1, PERTURBED_STEPS + 1):
        predicted = jacobian @ predicted
        size = float(np.linalg.norm(predicted))
        if not lowest < size < highest:
            break
        pair, lost = _both_return(return_map, point.xi, pair, unit)
        if lost is not None and steps == 0 and lost.ending is Ending.COMPLETED:
            return _edge_claim(return_map, point, unit)
        if lost is not None and lost.ending is not Ending.COMPLETED:
            return failed_claim("perturbation", LINEARITY, f"step {step} of a perturbed walk: {lost.message}")
        if lost is not None:  # the gait lies so close to another kind of impact
            break
        worst = max(worst, float(np.linalg.norm((pair[0] - pair[1]) / 2 - predicted)) / size)
        steps = step
    return claim("perturbation", worst, LINEARITY, f"relative to powers of the Jacobian, {steps} steps")


def _edge_claim(return_map: ReturnMap, point: FixedPoint, unit: Array) -> Claim:
    """At the edge of its kind of impact a gait has no linear neighbourhood; perturbed walks must still come back.

    A design whose optimum is limited by friction lies there.
    """
    simulator, dynamics, worst = return_map.simulator, return_map.simulator.dynamics, 0.0
    deviation = unit * PERTURBATION / np.sqrt(unit.size)
    target = dynamics.lift(point.xi)
    for sign in (1, -1):
        start = dynamics.lift(point.xi + sign * deviation)
        walk = simulator.run(start, steps=PERTURBED_STEPS * return_map.n_steps)
        distance = float(np.linalg.norm((walk.section_states[-1] - target) / dynamics.state_units)) / PERTURBATION
        worst = max(worst, distance if walk.ending is Ending.COMPLETED else np.inf)
    return claim("perturbation", worst, 1.0, f"left of it after {PERTURBED_STEPS} steps, at an edge")


def _both_return(return_map: ReturnMap, xi: Array, pair: list[Array], unit: Array) -> tuple[list[Array], Return | None]:
    """Deviations, in ``unit``, of two walks from ``xi`` one step later, or the walk that did not return."""
    deviations = []
    for deviation in pair:
        result = return_map(xi + deviation * unit)
        if result.xi is None:
            return pair, result
        deviations.append((result.xi - xi) / unit)
    return deviations, None
