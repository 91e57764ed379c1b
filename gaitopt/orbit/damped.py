"""Fixed points of the return map from afar: Newton's method with a line search and a bounded step.

xi -> xi - t (DPi - I)^-1 (Pi(xi) - xi),      t = 1, 1/2, ... until the defect falls
"""

from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait import Step
from gaitopt.iteration import iterate
from gaitopt.orbit.return_map import ReturnMap

CLOSE = 1e-9
"""Relative defect of a fixed point that another method polishes."""
LONGEST = 0.5
"""Newton step, relative to the sizes of the coordinates."""
SHORTENED = (1.0, 0.5, 0.25, 0.125, 0.0625)
MAX_STEPS = 25


@dataclass(frozen=True, slots=True, kw_only=True)
class _Defect:
    """Pi(xi) - xi at one point; its size is infinite where the map is not defined."""

    xi: Array
    vector: Array
    size: float
    steps: tuple[Step, ...]


def damped_fixed_point(return_map: ReturnMap, xi: Array, sizes: Array) -> tuple[Step, ...] | None:
    """The steps of a fixed point's cycle, by Newton's method from ``xi``, shape (n_xi,); None where there is none near.

    Parameters
    ----------
    sizes : ndarray, shape (n_xi,) - of the coordinates.
    """

    def following(point: _Defect) -> _Defect | None:
        if not np.isfinite(point.size):
            return None
        slope = return_map.jacobian(point.steps) - np.eye(xi.size)
        if not np.isfinite(slope).all():
            return None
        newton = -np.linalg.lstsq(slope, point.vector, rcond=None)[0]
        newton /= max(1.0, float(np.abs(newton / sizes).max()) / LONGEST)
        candidates = ((t, _defect(return_map, point.xi + t * newton, sizes)) for t in SHORTENED)
        return next((c for t, c in candidates if c.size < (1 - t / 4) * point.size), None)

    first = _defect(return_map, xi, sizes)
    end = iterate(first, following, size=lambda p: p.size, solved=lambda p: p.size < CLOSE, most=MAX_STEPS)
    return end.at.steps if end.solved else None


def _defect(return_map: ReturnMap, xi: Array, sizes: Array) -> _Defect:
    result = return_map(xi)
    if result.xi is None:
        return _Defect(xi=xi, vector=np.zeros_like(xi), size=np.inf, steps=())
    vector = result.xi - xi
    return _Defect(xi=xi, vector=vector, size=float(np.abs(vector / sizes).max()), steps=result.steps)
