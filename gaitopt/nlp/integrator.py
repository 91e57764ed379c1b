"""One shooting interval: an explicit Runge-Kutta step of order 8, written out in symbols.

    k_i = f(t + c_i h, z + h sum_j a_ij k_j),        z_next = z + h sum_i b_i k_i

The tableau is that of Dormand and Prince (DOP853, 12 stages, 3 more for states inside the step).
The flow has no repeated subexpressions; looking for more among its stages takes longer than it saves.
"""

from functools import lru_cache
from itertools import pairwise

import numpy as np
from casadi import SX, Function, horzcat, vertcat

from gaitopt.arrays import Array
from gaitopt.integration.dop853 import combined
from gaitopt.integration.tableau import A_INSIDE, C_INSIDE, N_STAGES, A, B, C, D
from gaitopt.mechanics import HybridSystem, Mode

ORDER = 8
LOBATTO_POINTS = (1 + np.array([-1.0, -np.sqrt(3 / 7), 0.0, np.sqrt(3 / 7), 1.0])) / 2
LOBATTO_WEIGHTS = np.array([9, 49, 64, 49, 9]) / 180
"""Quadrature on [0, 1] with both ends and positive weights, of the same order as the steps."""


@lru_cache(maxsize=64)
def shooting_step(system: HybridSystem, mode: Mode) -> Function:
    """(z, t, h, p, r) -> z at t + h.

    In stick the slip velocity is the factor that the mode sets to zero: it is zero at every node, not integrated.
    """
    z, t, h, p, r = _symbols(system)
    z_next = _end(mode, z, h, _stages(system, mode, z, t, h, p, r))
    return Function(f"step_{mode.key}", [z, t, h, p, r], [z_next])


@lru_cache(maxsize=64)
def sampled_step(system: HybridSystem, mode: Mode) -> Function:
    """(z, t, h, p, r) -> z at t + c h for the Lobatto points c; shape (n_z, n_points).

    Inside the step by the continuous extension of order 7: y = z + s (F_0 + (1 - s) (F_1 + s (F_2 + ...))).
    """
    z, t, h, p, r = _symbols(system)
    stages = _stages(system, mode, z, t, h, p, r)
    z_next = _end(mode, z, h, stages)
    stages.append(system.flow(mode)(t + h, z_next, p, r))
    for a, c in zip(A_INSIDE, C_INSIDE, strict=True):
        stages.append(system.flow(mode)(t + c * h, z + h * combined(a, stages), p, r))
    first, last, move = stages[0], stages[N_STAGES], z_next - z
    series = [move, h * first - move, 2 * move - h * (last + first), *(h * combined(d, stages) for d in D)]
    samples = [z, *(z + _extension(series, float(c)) for c in LOBATTO_POINTS[1:-1]), z_next]
    return Function(f"sampled_step_{mode.key}", [z, t, h, p, r], [horzcat(*samples)])


def integrate_to(system: HybridSystem, mode: Mode, z: Array, times: Array, p: Array, r: Array) -> Array:
    """States (n, n_z) at ascending times (n,) from ``z`` at the first, one shooting step between each two."""
    step = shooting_step(system, mode)
    states = [z]
    for start, end in pairwise(times):
        states.append(np.asarray(step(states[-1], start, end - start, p, r)).ravel())
    return np.array(states)


def _symbols(system: HybridSystem) -> tuple[SX, SX, SX, SX, SX]:
    z, t, h = SX.sym("z", system.n_z), SX.sym("t"), SX.sym("h")
    return z, t, h, SX.sym("p", len(system.parameters)), SX.sym("r", system.n_r)


def _stages(system: HybridSystem, mode: Mode, z: SX, t: SX, h: SX, p: SX, r: SX) -> list[SX]:
    flow, stages = system.flow(mode), list[SX]()
    for a, c in zip(A, C, strict=True):
        stages.append(flow(t + c * h, z + h * combined(a, stages), p, r))
    return stages


def _end(mode: Mode, z: SX, h: SX, stages: list[SX]) -> SX:
    z_next = z + h * combined(B, stages)
    return vertcat(z_next[:-1], 0) if mode.sticks else z_next


def _extension(series: list[SX], s: float) -> SX:
    """F_0 s + F_1 s (1 - s) + F_2 s^2 (1 - s) + ..., from the innermost bracket outwards."""
    value = SX(0)
    for k in reversed(range(len(series))):
        value = (value + series[k]) * (s if k % 2 == 0 else 1 - s)
    return value
