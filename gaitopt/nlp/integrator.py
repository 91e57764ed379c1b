"""One shooting interval: an explicit Runge-Kutta step of order 8, written out in symbols.

    k_i = f(t + c_i h, z + h sum_j a_ij k_j),        z_next = z + h sum_i b_i k_i

The tableau is that of Dormand and Prince (DOP853, 12 stages), as scipy publishes it.
"""

from functools import lru_cache
from itertools import pairwise

import numpy as np
from casadi import SX, Function, cse, vertcat
from numpy.typing import NDArray
from scipy.integrate import DOP853

from gaitopt.mechanics import HybridSystem, Mode

Array = NDArray[np.float64]

ORDER = 8


@lru_cache(maxsize=64)
def shooting_step(system: HybridSystem, mode: Mode) -> Function:
    """(z, t, h, p, r) -> z at t + h.

    In stick the slip velocity is the factor that the mode sets to zero: it is zero at every node, not integrated.
    """
    z, t, h = SX.sym("z", system.n_z), SX.sym("t"), SX.sym("h")
    p, r = SX.sym("p", len(system.parameters)), SX.sym("r", system.n_r)
    flow = system.flow(mode)
    stages: list[SX] = []
    for a, c in zip(DOP853.A, DOP853.C, strict=True):
        increment = sum((float(a_j) * k for a_j, k in zip(a, stages, strict=False) if a_j), SX.zeros(system.n_z))
        stages.append(flow(t + c * h, z + h * increment, p, r))
    z_next = z + h * sum((float(b) * k for b, k in zip(DOP853.B, stages, strict=True) if b), SX.zeros(system.n_z))
    if mode is Mode.STICK:
        z_next = vertcat(z_next[:-1], 0)
    return Function(f"step_{mode}", [z, t, h, p, r], cse([z_next]))


def integrate_to(system: HybridSystem, mode: Mode, z: Array, times: Array, p: Array, r: Array) -> Array:
    """States (n, n_z) at ascending times (n,) from ``z`` at the first, one shooting step between each two."""
    step = shooting_step(system, mode)
    states = [z]
    for start, end in pairwise(times):
        states.append(np.asarray(step(states[-1], start, end - start, p, r)).ravel())
    return np.array(states)
