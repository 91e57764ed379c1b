"""A gait on the simulator's return map: fixed point, multipliers, and walks that start slightly off it.

The return map P is differenced along directions v, from deviations of several sizes h, and extrapolated to h = 0:

    (P(xi + h v) - P(xi - h v)) / 2h = J v + c_2 h^2 + c_4 h^4 + ...        Ridders (1982), Adv. Eng. Software 4, 75-76

Only walks through the gait's own modes are used. Where one side of the gait has none (a gait at the limit of friction),
the difference is one-sided and all powers of h are eliminated.
"""

from collections.abc import Callable, Iterator
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.gait import Gait, Step, floquet_multipliers
from gaitopt.gait.multipliers import multiplier_distance
from gaitopt.mechanics import Mode
from gaitopt.orbit import ReturnMap
from gaitopt.orbit.return_map import ROUNDING, FixedPoint
from gaitopt.study.claims import Claim, Outcome, claim, failed_claim
from gaitopt.study.comparison import AGREEMENT, magnification

MULTIPLIER_AGREEMENT = 1e-9
"""Relative where a multiplier exceeds one. An unstable cycle magnifies the errors of both methods by its radius: of 900
random gaits the worst is a tenth of this times the radius."""
DISCERNIBLE = 2e-6
"""Largest tolerance of the multipliers: an error of 1e-5 must stand out, however unstable or sensitive they are."""
ROUNDING_SAMPLES = 4
LARGEST, SIZES = 2.0**-12, 16
"""Largest deviation, in natural units, and number of sizes, each half of the one before; at the smallest, 7e-9, the
rounding of a step is 1e-6 to 1e-5 of the deviation."""
LINEARITY = 2e-6
"""Of the norm of the Jacobian: a Jacobian with a relative error of 1e-5 exceeds it along at least one of up to 25
directions. Named gaits stay below 1e-8."""
RESOLVED = LINEARITY / 4
"""Largest estimated error of an extrapolated difference that can decide the claim."""
SETTLED = RESOLVED / 100
"""Estimated error below which no smaller deviation is tried."""
SPARE_DIRECTIONS = 8
"""Random directions per coordinate that are tried where some coordinate direction leaves the gait's modes on both
sides, as next to two limits at once."""
INDEPENDENT = 0.1
"""Least part of a unit vector that must be orthogonal to the directions before it."""

Quotient = Callable[[float], Array | None]


def return_map_claims(gait: Gait, return_map: ReturnMap) -> Iterator[Claim]:
    """Fixed point, multipliers and perturbations, all on the simulator's return map."""
    section = gait.system.section(gait.problem.cycle.impact)
    xi, unit = gait.state[section], gait.dynamics.state_units[section]
    point = return_map.fixed_point(xi)
    if point.jacobian is None:
        yield failed_claim("state", AGREEMENT, f"no fixed point of the simulated return map: {point.message}")
        return
    distance = np.abs((point.xi - xi) / unit).max() + _remaining(point, section, unit)
    yield claim("state", distance, AGREEMENT, "distance to the fixed point of the simulator")
    distance = multiplier_distance(gait.multipliers, floquet_multipliers(point.jacobian), relative=True)
    tolerance = min(max(magnification(gait) * MULTIPLIER_AGREEMENT, _sensitivity(point, unit)), DISCERNIBLE)
    yield claim("multipliers", distance, tolerance, "saltation against implicit differentiation")
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


def _sensitivity(point: FixedPoint, unit: Array) -> float:
    """By how much the multipliers move where rounding changes the derivative: next to a double one, by its root."""
    if point.jacobian is None:
        return 0.0
    jacobian, random = _scaled(point.jacobian, unit), np.random.default_rng(0)
    multipliers, size = floquet_multipliers(jacobian), ROUNDING * np.linalg.norm(jacobian, 2)
    changes = (size * random.standard_normal(jacobian.shape) / unit.size for _ in range(ROUNDING_SAMPLES))
    moved = (floquet_multipliers(jacobian + change) for change in changes)
    return max(multiplier_distance(changed, multipliers, relative=True) for changed in moved)


def _scaled(jacobian: Array, unit: Array) -> Array:
    """The derivative of the return map between section coordinates in natural units."""
    return jacobian * unit / unit[:, None]


def perturbation_claim(return_map: ReturnMap, point: FixedPoint, unit: Array) -> Claim:
    """Small perturbations return as the derivative of the return map says, along a basis of the section.

    The figure is the largest error of a direction, relative to the norm of the derivative. Where rounding and
    curvature leave no size of deviation at which the returns can be judged, the outcome is ``no_linear_range``.

    Parameters
    ----------
    return_map : of the simulator, over one cycle.
    point : its fixed point, with the derivative to be judged.
    unit : ndarray, shape (n_xi,) - natural units of the section coordinates.
    """
    if point.jacobian is None:
        return failed_claim("perturbation", LINEARITY, point.message)
    jacobian = _scaled(point.jacobian, unit)
    size = float(np.linalg.norm(jacobian, 2)) or 1.0
    differenced = _Differenced(return_map, point, unit)
    judged: list[Array] = []
    figure, doubt = 0.0, 0.0
    for v in _directions(unit.size):
        if not _is_independent(v, judged):
            continue
        derivative, error = differenced.along(v, goal=SETTLED * size)
        if derivative is None:
            continue
        if not error <= RESOLVED * size:
            words = f"differences of the return map are uncertain by {error / size:.1g} at every size of deviation"
            return failed_claim("perturbation", LINEARITY, words, Outcome.NO_LINEAR_RANGE)
        figure = max(figure, float(np.linalg.norm(derivative - jacobian @ v)) / size)
        doubt, judged = max(doubt, error / size), [*judged, v]
        if len(judged) == unit.size:
            note = f"extrapolated differences of the return map against the Jacobian, known to {doubt:.1g}"
            return claim("perturbation", figure, LINEARITY, note)
    words = f"{differenced.lost}: only {len(judged)} of {unit.size} directions keep the modes of the gait"
    return failed_claim("perturbation", LINEARITY, words, Outcome.NO_LINEAR_RANGE)


def _directions(n: int) -> Iterator[Array]:
    """The coordinate directions, then random ones; unit vectors of shape (n,)."""
    yield from np.eye(n)
    random = np.random.default_rng(0)
    for _ in range(SPARE_DIRECTIONS * n if n > 1 else 0):
        v = random.standard_normal(n)
        yield v / np.linalg.norm(v)


def _is_independent(v: Array, others: list[Array]) -> bool:
    if not others:
        return True
    basis = np.linalg.qr(np.array(others).T)[0]
    return float(np.linalg.norm(v - basis @ (basis.T @ v))) > INDEPENDENT


class _Differenced:
    """Directional derivatives of a return map at its fixed point, in natural units."""

    def __init__(self, return_map: ReturnMap, point: FixedPoint, unit: Array) -> None:
        self._map, self._point, self._unit = return_map, point, unit
        section = return_map.simulator.system.section(return_map.section_mode)
        self._returned = point.steps[-1].final_impact.state[section]
        self._modes = _modes(point.steps)
        self.lost = ""

    def along(self, v: Array, goal: float) -> tuple[Array | None, float]:
        """The derivative along ``v`` and its estimated error; None if no perturbed walk keeps the gait's modes.

        Central differences come first, then those of either side alone.
        """
        known: dict[float, Array | None] = {}

        def ahead(h: float) -> Array | None:
            """(P(xi + h v) - P(xi)) / h."""
            if h not in known:
                known[h] = self._return(h * v)
            returned = known[h]
            return None if returned is None else returned / h

        def behind(h: float) -> Array | None:
            return ahead(-h)

        def central(h: float) -> Array | None:
            one, other = ahead(h), ahead(-h)
            return None if one is None or other is None else (one + other) / 2

        best, error = extrapolated(central, power=2, goal=goal)
        for one_sided in (ahead, behind):
            if error > RESOLVED / SETTLED * goal:
                candidate = extrapolated(one_sided, power=1, goal=goal)
                best, error = min((best, error), candidate, key=itemgetter(1))
        return best, error

    def _return(self, deviation: Array) -> Array | None:
        """By how much the return of a deviation differs from that of the gait; None if it takes other modes."""
        result = self._map(self._point.xi + deviation * self._unit)
        if result.xi is None or _modes(result.steps) != self._modes:
            self.lost = result.message if result.xi is None else "a perturbed walk goes through other modes"
            return None
        return np.asarray((result.xi - self._returned) / self._unit)


def _modes(steps: tuple[Step, ...]) -> list[tuple[tuple[Mode, ...], Mode]]:
    return [(tuple(mode for mode, _ in step.phases), step.final_impact.mode) for step in steps]


def extrapolated(quotient: Quotient, *, power: int, goal: float) -> tuple[Array | None, float]:
    """The limit of a difference quotient at h = 0, from a tableau of halved sizes, and its estimated error.

    Parameters
    ----------
    quotient : of a size h; None where it is not defined.
    power : difference of the exponents of its error: 2 of central differences, 1 of one-sided ones.
    goal : estimated error at which to stop.

    References
    ----------
    Ridders (1982), Advances in Engineering Software 4, 75-76.
    """
    best, error = None, np.inf
    row: list[Array] = []
    for k in range(SIZES):
        value = quotient(LARGEST / 2**k)
        if value is None:
            row = []
            continue
        previous, row = row, [value]
        for j, above in enumerate(previous, start=1):
            row.append(row[-1] + (row[-1] - above) / (2 ** (power * j) - 1))
            estimate = max(float(np.abs(row[j] - row[j - 1]).max()), float(np.abs(row[j] - above).max()))
            if estimate < error:
                best, error = row[j], estimate
        if error <= goal:
            break
    return best, error
