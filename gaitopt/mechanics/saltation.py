"""How a small deviation passes an event: saltation of the variational equations.

    S = R_z + (f_plus - R_z f_minus) grad g' / (dg/dt)

with R the reset and g the guard. At the last event of a step the deviation is only projected along the flow onto
the guard and reset, because the return map compares states on the section and not at equal times.
"""

import numpy as np

from gaitopt.arrays import Array


def saltation(
    f_minus: Array, f_plus: Array, guard_gradient: Array, guard_rate: float, reset: Array | None = None
) -> Array:
    """Saltation matrix of a transition in mid-step; shape (n_z, n_z).

    Parameters
    ----------
    f_minus, f_plus : ndarray, shape (n_z,) - flow just before and just after the switch.
    guard_gradient : ndarray, shape (n_z,) - gradient of the guard in the state.
    guard_rate : total time derivative of the guard along ``f_minus``.
    reset : ndarray, shape (n_z, n_z) - derivative of the reset; the identity unless given.
    """
    R_z = np.eye(f_minus.size) if reset is None else reset
    return np.asarray(R_z + np.outer(f_plus - R_z @ f_minus, guard_gradient) / guard_rate)


def projection(f_minus: Array, guard_gradient: Array, guard_rate: float) -> Array:
    """Projection of a deviation along the flow onto the guard; shape (n_z, n_z)."""
    return np.eye(f_minus.size) - np.outer(f_minus, guard_gradient) / guard_rate
