"""The linearised return map under parameters as inputs, and gains of feedback from step to step, u = K x, for it.

    x = xi_n - xi*,  u = u_n - u*,  x+ = A x + B u      A = dPi/dxi,  B = dPi/du

The parameters u, of control, walker or friction, act during one whole cycle: also in the lift of the section
coordinates to a state and in the last impact.

    lqr               K = -(R + B' P B)^-1 B' P A     with the solution P of the discrete Riccati equation
    deadbeat          (A + B K)^n = 0                 by the subspaces from which k steps lead to zero
    minimum_radius    min max |eig(A + B K)|          subject to |K_ij| <= max_gain; by seeded local searches

For deadbeat control let S_0 = {0}, and let S_(k+1) be the states from which some input leads into S_k. If the
largest of these subspaces is not the whole space, a nonzero multiplier cannot be moved. Otherwise K is chosen such that
A + B K maps every S_(k+1) into S_k.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.errors import ProblemError, SolveError, UnknownNameError
from gaitopt.gait.gait import Gait, require_gait
from gaitopt.model.step_feedback import FeedbackDesign, Lqr, MinimumRadius
from gaitopt.problem.faults import nearest_keys
from gaitopt.solver.assembly import solution_of

NEGLIGIBLE = 1e-9
"""A direction belongs to a subspace if its singular value exceeds this fraction of the largest one."""
NILPOTENT = 1e-6
"""Deadbeat control may leave entries of (A + B K)^n of this size, relative to those of A, by rounding."""
STARTS, SEED = 24, 1
"""Number of starting gains that the search for the smallest radius compares, and its random seed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReturnMapDerivatives(ReadOnlyArrays):
    """The linearised return map of a gait, in SI.

    Attributes
    ----------
    A : ndarray, shape (n, n) - derivative by the section coordinates.
    B : ndarray, shape (n, m) - derivative by the parameters, at fixed section coordinates.
    names : names of the n section coordinates.
    keys : dotted keys of the m parameters.
    """

    A: Array
    B: Array
    names: tuple[str, ...]
    keys: tuple[str, ...]


def return_map_derivatives(gait: Gait, keys: Sequence[str] = ()) -> ReturnMapDerivatives:
    """Exact derivatives of a gait's return map by the state just after the impact and by parameters.

    Parameters
    ----------
    gait : a gait; the return map is that of its whole cycle.
    keys : dotted keys of continuous parameters of control, walker or friction. They act during the whole cycle.

    Returns
    -------
    derivatives : ``A`` (n, n) and ``B`` (n, m) in SI, ``names`` of the section coordinates and ``keys``.

    Raises
    ------
    ProblemError
        If the name of a problem is given instead of its gait, or a key twice.
    SolveError
        If the gait is a failed solve, or comes from a file, where its nodes are not kept.
    UnknownNameError
        If a key is not that of a continuous parameter.
    """
    require_gait(gait, "return_map_derivatives")
    name, keys = gait.problem.name, (keys,) if isinstance(keys, str) else tuple(keys)
    if not gait.converged:
        raise SolveError(f"{name} is {gait.status}: {gait.message}")
    if gait.shooting is None:
        raise SolveError(f"{name}: a gait from a file has no shooting nodes; solve its problem again")
    for k, key in enumerate(keys):
        if key not in gait.system.parameters:
            raise UnknownNameError(f"{key} is not a parameter of {name}{nearest_keys(key, gait.system.parameters)}")
        if isinstance(gait.problem.parameters.get(key), int):
            raise UnknownNameError(f"{key} is a whole number, by which the return map has no derivative")
        if key in keys[:k]:
            raise ProblemError(f"{key} is given twice")
    at = solution_of(gait, keys)
    section = gait.system.section(gait.cycle)
    return ReturnMapDerivatives(
        A=at.return_map.by_section, B=at.return_map.by_parameters, names=section.names, keys=keys
    )


def designed_gains(name: str, map_: ReturnMapDerivatives, units: Array, design: FeedbackDesign) -> Array:
    """The gains K of a design, shape (m, n), in SI.

    Parameters
    ----------
    name : name of the problem, for messages.
    units : ndarray, shape (n,) - natural units of the section coordinates.

    Raises
    ------
    SolveError
        If the parameters do not stabilise the gait, or there is no deadbeat control.
    """
    if design.lqr is not None:
        return lqr_gains(name, map_, design.lqr)
    scale = np.diag(units)
    A, B = np.asarray(np.linalg.solve(scale, map_.A @ scale), dtype=float), map_.B / units[:, None]
    if design.minimum_radius is not None:
        return smallest_radius_gains(map_.A, map_.B, units, design.minimum_radius)
    return deadbeat_gains(name, A, B) / units


def lqr_gains(name: str, map_: ReturnMapDerivatives, weights: Lqr) -> Array:
    """The gains of the linear-quadratic regulator."""
    unknown = [key for key in weights.Q if key not in map_.names] + [key for key in weights.R if key not in map_.keys]
    if unknown:
        known = f"{', '.join(map_.names)} and {', '.join(map_.keys)}"
        raise SolveError(f"{name}: step_feedback.design.lqr: no weight of {unknown[0]}; there are those of {known}")
    Q = np.diag([weights.Q.get(key, 1.0) for key in map_.names])
    R = np.diag([weights.R.get(key, 1.0) for key in map_.keys])
    A, B = map_.A, map_.B
    try:
        return _regulator(A, B, Q, R)
    except np.linalg.LinAlgError:
        fixed = _fixed_multiplier(A, B)
        reason = f"the multiplier {fixed:.4g} cannot be moved by {', '.join(map_.keys)}"
        raise SolveError(f"{name}: step_feedback.design.lqr finds no stabilising gains: {reason}") from None


def _regulator(A: Array, B: Array, Q: Array, R: Array) -> Array:
    from scipy.linalg import solve_discrete_are  # takes a fifth of a second to import

    P = solve_discrete_are(A, B, Q, R)
    return np.asarray(-np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A), dtype=float)


def deadbeat_gains(name: str, A: Array, B: Array) -> Array:
    """The gains with which every deviation vanishes; A, B and the gains are in natural units."""
    n, m = B.shape
    S, X, U = np.zeros((n, 0)), np.zeros((n, 0)), np.zeros((m, 0))
    while S.shape[1] < n:
        target = _orthonormal(np.hstack([S, B]))
        outside = A - target @ (target.T @ A)
        following = _null_space(outside, float(np.linalg.norm(A, 2)))
        new = _orthonormal(following - S @ (S.T @ following))
        if not new.shape[1]:
            raise SolveError(
                f"{name}: step_feedback.design.deadbeat: the multiplier {_fixed_multiplier(A, B):.4g} cannot be moved "
                "by these parameters; name others with corrects"
            )
        # inputs that lead from the new states into S_k
        off = np.eye(n) - S @ S.T
        inputs = -np.linalg.lstsq(off @ B, off @ A @ new, rcond=NEGLIGIBLE)[0]
        X, U, S = np.hstack([X, new]), np.hstack([U, inputs]), np.hstack([S, new])
    K = np.asarray(U @ np.linalg.inv(X), dtype=float)
    left = np.abs(np.linalg.matrix_power(A + B @ K, n)).max()
    if not left <= NILPOTENT * max(1.0, np.abs(A).max()):
        raise SolveError(f"{name}: step_feedback.design.deadbeat: (A + B K)^{n} is {left:.2g} instead of zero")
    return K


def smallest_radius_gains(A: Array, B: Array, units: Array, design: MinimumRadius) -> Array:
    """The gains of the smallest spectral radius that seeded local searches find, with |K_ij| <= max_gain."""
    from scipy.optimize import minimize

    (n, m), bound, random = B.shape, design.max_gain, np.random.default_rng(SEED)

    def radius(entries: Array) -> float:
        return float(np.abs(np.linalg.eigvals(A + B @ entries.reshape(m, n))).max())

    def clipped(K: Array) -> Array:
        return np.clip(K, -bound, bound).ravel()

    starts = [np.zeros(m * n)]
    for weight in 10.0 ** np.arange(-6.0, 3.0, 2.0):
        with suppress(np.linalg.LinAlgError):
            starts.append(clipped(_regulator(A, B, np.eye(n), weight * np.eye(m))))
    with suppress(SolveError):
        starts.append(clipped(deadbeat_gains("", np.diag(1 / units) @ A @ np.diag(units), B / units[:, None]) / units))
    while len(starts) < STARTS:
        best = min(starts, key=radius)
        starts.append(clipped(best * random.uniform(0.3, 2.0, m * n) + random.normal(0, 0.05, m * n)))
    bounds = [(-bound, bound)] * (m * n)
    found = []
    for start in sorted(starts, key=radius)[: STARTS // 4]:
        end = start
        for _ in range(3):  # a simplex that has shrunk at a kink starts anew
            end = minimize(radius, end, method="Nelder-Mead", bounds=bounds, options={"maxfev": 400 * m * n}).x
        found.append(end)
    return np.asarray(min(found, key=radius).reshape(m, n), dtype=float)


def _fixed_multiplier(A: Array, B: Array) -> complex | float:
    """The largest multiplier that no input changes: a value lambda at which (A - lambda, B) loses rank."""
    n, size = len(A), np.linalg.norm(np.hstack([A, B]), 2)
    values = np.linalg.eigvals(A)
    lost = [np.linalg.svd(np.hstack([A - v * np.eye(n), B]), compute_uv=False)[-1] for v in values]
    fixed = values[[each < 1e-6 * size for each in lost]]
    chosen = max(fixed if fixed.size else values[[int(np.argmin(lost))]], key=abs)
    return float(chosen.real) if abs(chosen.imag) < 1e-12 else complex(chosen)


def _orthonormal(columns: Array) -> Array:
    """An orthonormal basis of the span of some columns."""
    if not columns.shape[1]:
        return columns
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(U[:, s > NEGLIGIBLE * max(1.0, s[0])])


def _null_space(M: Array, size: float) -> Array:
    """An orthonormal basis of the null space of a matrix whose rounding errors are proportional to ``size``."""
    _, s, Vt = np.linalg.svd(M)
    return np.asarray(Vt[int((s > NEGLIGIBLE * size).sum()) :].T)
