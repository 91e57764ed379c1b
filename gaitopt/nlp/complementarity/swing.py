"""The plainest guess of a step: all joints move at constant rates, and the foot does not slip.

Relabelling is affine, s_plus = A s_minus + b, so that the shape just before an impact follows from that just after it.
"""

import numpy as np

from gaitopt.arrays import Array
from gaitopt.mechanics import HybridSystem, Mode


def swing(system: HybridSystem, p: Array, shape: Array, period: float) -> tuple[Array, Array]:
    """States (n_z,) at the two ends of a step without slip in which all joints move at constant rates.

    Parameters
    ----------
    shape : ndarray, shape (n_section,) - the coordinates that are free just after an impact.
    period : [s].
    """
    n = system.n_shape
    start = system.lift_state(np.concatenate([shape, np.zeros(n)]), p)
    end = start.copy()
    end[:n] = shapes_before(system, p, start[None, :n])[0]
    for state in (start, end):
        state[n + 1 : 2 * n + 1] = (end[:n] - start[:n]) / period
    return start, end


def shapes_before(system: HybridSystem, p: Array, shapes: Array) -> Array:
    """The shapes just before an impact that it relabels to ``shapes``, shape (m, n_shape), as relabelling is affine."""
    n, zero = system.n_shape, np.zeros(system.n_z)
    b = np.asarray(system.impact(Mode.STICK)(zero, p)[0]).ravel()[:n]
    A = np.asarray(system.impact_jacobian(Mode.STICK)(zero, p))[:n, :n]
    return np.asarray(np.linalg.solve(A, (shapes - b).T).T)
