"""One shooting interval: an explicit Runge-Kutta step of order 8 as a function, states inside it and its derivatives.

    k_i = f(t + c_i h, z_i),      z_i = z + h sum_j a_ij k_j,      z_next = z + h sum_i b_i k_i
    dk_i = f_z dz_i + f_t dt_i + f_p dp,      dz_i = dz + h sum_j a_ij dk_j + dh sum_j a_ij k_j

The tableau is that of Dormand and Prince, with 12 stages and 3 more for states inside the step. E. Hairer, S. P.
Norsett, G. Wanner (1993), Solving Ordinary Differential Equations I, sections II.5 and II.6.

The flow has no repeated subexpressions; searching for more among the stages takes longer than it saves. The derivatives
of f at all stages are one compiled function, and the recursion for dk_i is linear algebra on all intervals at once:
about five times as fast as differentiating the step symbolically.
"""

from itertools import pairwise

import numpy as np
from casadi import SX, Function, cse, densify, horzcat, jacobian, vertcat

from gaitopt.arrays import Array
from gaitopt.building import built_once
from gaitopt.integration import A_INSIDE, C_INSIDE, N_STAGES, A, B, C, D, combined
from gaitopt.model.buffered import buffered, buffered_map
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem

ORDER = 8
LOBATTO_POINTS = (1 + np.array([-1.0, -np.sqrt(3 / 7), 0.0, np.sqrt(3 / 7), 1.0])) / 2
STEP_ERROR, MAX_HALVINGS = 1e-13, 10
"""A step is accurate if it differs from two half steps by less than this, in natural units. ``MAX_HALVINGS``
limits how often it is halved."""
LOBATTO_WEIGHTS = np.array([9, 49, 64, 49, 9]) / 180
"""Weights of a quadrature on [0, 1] that includes both ends. They are positive, and its order is that of the step."""


@built_once(maxsize=64)
def shooting_step(system: HybridSystem, mode: Mode) -> Function:
    """(z, t, h, p, r) -> z at t + h.

    A sticking foot has no slip velocity: the last entry of z is set to zero at every node, not integrated.
    """
    inputs = _inputs(system)
    return Function(f"step_{mode.key}", inputs, [_end(mode, inputs, _stages(system, mode, inputs))])


@built_once(maxsize=64)
def sampled_step(system: HybridSystem, mode: Mode) -> Function:
    """(z, t, h, p, r) -> z at t + c h for the Lobatto points c; shape (n_z, n_points).

    States inside the step come from the continuous extension of order 7,
    y = z + s (F_0 + (1 - s) (F_1 + s (F_2 + ...))).
    """
    z, t, h, p, r = inputs = _inputs(system)
    stages = _stages(system, mode, inputs)
    z_next = _end(mode, inputs, stages)
    stages.append(system.flow(mode)(t + h, z_next, p, r))
    for a, c in zip(A_INSIDE, C_INSIDE, strict=True):
        stages.append(system.flow(mode)(t + c * h, z + h * combined(a, stages), p, r))
    first, last, move = stages[0], stages[N_STAGES], z_next - z
    F = [move, h * first - move, 2 * move - h * (last + first), *(h * combined(d, stages) for d in D)]

    def inside(s: float) -> SX:
        value = SX(0)
        for k in reversed(range(len(F))):  # from the innermost bracket outwards
            value = (value + F[k]) * (s if k % 2 == 0 else 1 - s)
        return z + value

    samples = [z, *(inside(float(c)) for c in LOBATTO_POINTS[1:-1]), z_next]
    return Function(f"sampled_step_{mode.key}", inputs, [horzcat(*samples)])


def integrate_to(
    system: HybridSystem, mode: Mode, z: Array, times: Array, p: Array, r: Array, units: Array | None = None
) -> Array:
    """States (n, n_z) at ascending times (n,) of the motion that starts from ``z`` at the first time.

    Parameters
    ----------
    units : ndarray, shape (n_z,) - natural units of the states; every step is halved until its error in these units is
        rounding. None for one step between neighbouring times.
    """
    step = buffered(shooting_step(system.shared, mode))

    def moved(z: Array, t: float, h: float) -> Array:
        return step(z, t, h, p, r)[0].copy()

    def halved(z: Array, whole: Array, t: float, h: float, depth: int) -> Array:
        if units is None:
            return whole
        middle = moved(z, t, h / 2)
        end = moved(middle, t + h / 2, h / 2)
        error = np.abs((end - whole) / units).max()
        if depth == 0 or not error > STEP_ERROR * max(1.0, np.abs(end / units).max()):  # or not a number
            return end
        first = halved(z, middle, t, h / 2, depth - 1)
        return halved(first, moved(first, t + h / 2, h / 2), t + h / 2, h / 2, depth - 1)

    states = [z]
    for t, end in pairwise(times):
        whole = moved(states[-1], t, end - t)
        states.append(halved(states[-1], whole, t, end - t, MAX_HALVINGS))
    return np.array(states)


@built_once(maxsize=64)
def stage_derivatives(system: HybridSystem, mode: Mode, free: tuple[str, ...]) -> Function:
    """(z, t, h, p, r) -> f at every stage, and its derivatives by z, t and the free parameters, in columns."""
    z, t, h, p, r = inputs = _inputs(system)
    by = vertcat(z, t, *(p[system.parameters.index(name)] for name in free))
    f = system.flow(mode)(t, z, p, r)
    both = Function("flow_and_derivatives", [z, t, p, r], cse([f, jacobian(f, by)]))
    stages: list[SX] = []
    columns: list[SX] = []
    for a, c in zip(A, C, strict=True):
        rate, derivative = both(z + h * combined(a, stages), t + float(c) * h, p, r)
        stages.append(rate)
        columns += [rate, derivative]
    return Function(f"stage_derivatives_{mode.key}", inputs, [densify(horzcat(*columns))])


def stages_of(columns: Array, n_z: int) -> Array:
    """The results of ``stage_derivatives`` at K intervals, sorted by stage; shape (12, K, n_z, n_z + 2 + n_free)."""
    return columns.reshape(len(columns), N_STAGES, -1, n_z).transpose(1, 0, 3, 2)


def differentiated_steps(nodes: Array, stages: Array, lengths: Array) -> tuple[Array, Array]:
    """Ends of K steps, shape (K, n_z), and their derivatives by (z, t, h, free parameters), (K, n_z, n_z + 2 + n_free).

    Parameters
    ----------
    nodes : states at which the steps start, shape (K, n_z).
    stages : result of ``stages_of``: f, followed by its derivatives by all inputs except h.
    lengths : lengths of the steps, shape (K,) [s].
    """
    rates, derivatives = stages[..., 0], stages[..., 1:] * lengths[:, None, None]
    n, n_z, n_in = derivatives.shape[1:]
    base = np.zeros((n, n_in, n_in + 1))  # derivative of (z_i, t_i, p) by (z, t, h, p) before the stages move z_i
    base[:, : n_z + 1, : n_z + 1] = np.eye(n_z + 1)
    base[:, n_z + 1 :, n_z + 2 :] = np.eye(n_in - n_z - 1)
    moved = np.empty((N_STAGES, n, n_z, n_in + 1))  # derivative of h k_i: h dk_i, and k_i added in the column of h
    flat = moved.reshape(N_STAGES, -1)
    for i, (a, c) in enumerate(zip(A, C, strict=True)):
        inner = base.copy()
        inner[:, n_z, n_z + 1] = c
        inner[:, :n_z] += (a[:i] @ flat[:i]).reshape(n, n_z, -1)
        np.matmul(derivatives[i], inner, out=moved[i])
        moved[i, :, :, n_z + 1] += rates[i]
    ends = nodes + lengths[:, None] * np.tensordot(B, rates, 1)
    return ends, np.asarray(base[:, :n_z] + (B @ flat).reshape(n, n_z, -1))


def step_derivatives(
    system: HybridSystem,
    mode: Mode,
    free: tuple[str, ...],
    nodes: Array,
    times: Array,
    lengths: Array,
    p: Array,
    r: Array,
) -> Array:
    """Derivatives of K steps by (z, t, h, free parameters); shape (K, n_z, n_z + 2 + n_free).

    Parameters
    ----------
    nodes, times, lengths : states at which the steps start, shape (n_z, K), their times and their lengths, (K,) [s].
    p, r : all parameters, and the segment data of the control.
    """
    (columns,) = buffered_map(stage_derivatives(system.shared, mode, free), times.size)(
        nodes.T, times[:, None], lengths[:, None], p, r
    )
    _, by = differentiated_steps(nodes.T, stages_of(columns, system.n_z), lengths)
    if mode.fixes_x:
        by[:, -1] = 0.0
    return by


def _inputs(system: HybridSystem) -> list[SX]:
    """Symbols (z, t, h, p, r)."""
    sizes = {"z": system.n_z, "t": 1, "h": 1, "p": len(system.parameters), "r": system.n_r}
    return [SX.sym(name, size) for name, size in sizes.items()]


def _stages(system: HybridSystem, mode: Mode, inputs: list[SX]) -> list[SX]:
    z, t, h, p, r = inputs
    stages: list[SX] = []
    for a, c in zip(A, C, strict=True):
        stages.append(system.flow(mode)(t + c * h, z + h * combined(a, stages), p, r))
    return stages


def _end(mode: Mode, inputs: list[SX], stages: list[SX]) -> SX:
    z, _, h, _, _ = inputs
    z_next = z + h * combined(B, stages)
    return vertcat(z_next[:-1], 0) if mode.fixes_x else z_next
