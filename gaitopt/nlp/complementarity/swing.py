"""The plainest guess of a cycle: all joints move at constant rates, and the foot does not slip.

Relabelling is affine, s_plus = A s_minus + b, so that the shape just before an impact follows from that just after it.
"""

import numpy as np

from gaitopt.arrays import Array
from gaitopt.mechanics import Dynamics, Mode


def swing(dynamics: Dynamics, shapes: Array, period: float) -> tuple[Array, Array]:
    """States at the two ends of each step of a cycle without slip in which all joints move at constant rates.

    Parameters
    ----------
    shapes : ndarray, shape (n_steps, n_section) - the coordinates that are free, at the start of each step.
    period : of a step [s].

    Returns
    -------
    starts, ends : ndarrays, shape (n_steps, n_z).
    """
    n = dynamics.system.n_shape
    starts = np.array([dynamics.lift(np.concatenate([shape, np.zeros(n)])) for shape in shapes])
    ends = starts.copy()
    ends[:, :n] = shapes_before(dynamics, np.roll(starts[:, :n], -1, axis=0))
    for states in (starts, ends):
        states[:, n + 1 : 2 * n + 1] = (ends[:, :n] - starts[:, :n]) / period
    return starts, ends


def shapes_before(dynamics: Dynamics, shapes: Array) -> Array:
    """The shapes just before an impact that it relabels to ``shapes``, shape (m, n_shape), as relabelling is affine."""
    n, zero = dynamics.system.n_shape, np.zeros(dynamics.system.n_z)
    b = dynamics.after_impact(Mode.STICK, zero)[:n]
    A = np.asarray(dynamics.system.impact_jacobian(Mode.STICK)(zero, dynamics.p))[:n, :n]
    return np.asarray(np.linalg.solve(A, (shapes - b).T).T)
