"""Bounds on the multipliers of a gait under open-loop torques, as rows of its collocation program.

With the duration T of the law fixed, the collocation equations F in the states and the durations of the phases give the
derivative M of the return map, as in ``solver.return_map``:

    A V = B,      M = R V_K             A = dF/d(states, durations) without the last impact, R that of the impact

The multipliers lie within a radius if the ``circle_inequalities`` of M hold. Derivatives of M are products with the
Hessian H of the program's Lagrangian; Lambda is the adjoint of V, and G are the weights of M:

    A' Lambda = R' G,      d <G, M> = <Lambda, dB> + sum_k H(mu_k) V_k,      mu_k = -Lambda_k, and -G_k at the impact

The curvature of the rows by torques and freed parameters, along the solutions of the motion's equations, is computed by
differences.
"""

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from casadi import DM, MX, Function, Sparsity, dot, gradient, vertcat
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.building import BUILT, building
from gaitopt.design.spectral_radius import RADIUS, CircleInequality, circle_inequalities
from gaitopt.model.buffered import BufferedFunction, NumericFunction
from gaitopt.model.modes import Mode
from gaitopt.solver.collocation import Collocation
from gaitopt.solver.collocation_rows import DURATION
from gaitopt.solver.return_map import OpenedCycle

DIFFERENCE = 1e-5
"""Step of the differences for the curvature, in the unknown that changes most."""


class ReturnMap:
    """The derivative M of the return map of a collocation's motion, while its law is fixed in time."""

    @building
    def __init__(self, collocation: Collocation) -> None:
        system, program, n_z = collocation.system, collocation.program, collocation.system.n_z
        self.section = system.section(collocation.cycle)
        self.controls = np.sort(np.concatenate([collocation.columns("values"), collocation.columns("freed")]))
        self._first = n_z * collocation.phase_starts[0] + np.arange(n_z)
        self._free = [system.parameters.index(key) for key in collocation.free]
        self._freed = collocation.columns("freed")
        self._columns, self._rows, closing = collocation.motion
        last = n_z * collocation.phase_ends[len(collocation.cycle.phases) - 1] + np.arange(n_z)
        self._closing, self._last = np.searchsorted(self._rows, closing), np.searchsorted(self._columns, last)
        self._n_rows = program.g.numel()
        slope, bent = program.derivatives["jac_g"], program.derivatives["hess_lag"]
        self._slope, self._bent = (BufferedFunction(BUILT.watch(each), nonzeros=True) for each in (slope, bent))
        self._jacobian, self._hessian = _pattern(slope.sparsity_out(1)), _pattern(bent.sparsity_out(0))
        period = np.flatnonzero([name == DURATION for name in collocation.row_names])
        self._all_rows = np.append(self._rows, period)
        self._all_columns = np.append(self._columns, collocation.columns("law_duration"))
        z, p = MX.sym("z", n_z), MX.sym("p", len(system.parameters))
        weights = MX.sym("W", n_z, self.section.indices.size)
        start = system.lift_jacobian(z[system.section(Mode.SLIP_FORWARD).indices], p)[:, : weights.size2()]
        self._start = BufferedFunction(
            BUILT.watch(Function("start", [z, p, weights], [gradient(dot(weights, start), vertcat(z, p))]))
        )

    def _parameters(self, x: Array, p: Array) -> Array:
        full = p.copy()
        full[self._free] = x[self._freed]
        return full

    def _jacobian_at(self, x: Array, p: Array) -> csc_array:
        self._jacobian.data[:] = self._slope(x, p)[1]
        return self._jacobian

    def response(self, x: Array, p: Array) -> tuple[Array, Array, Callable[[Array], Array]]:
        """V, M, and the function that maps weights of M to the adjoint of V.

        Raises
        ------
        RuntimeError
            If the equations are singular.
        """
        A = self._jacobian_at(x, p)[self._rows][:, self._columns].tocoo()
        impact = np.isin(A.row, self._closing) & np.isin(A.col, self._last)
        R = np.zeros((self._closing.size, self._last.size))
        R[np.searchsorted(self._closing, A.row[impact]), np.searchsorted(self._last, A.col[impact])] = -A.data[impact]
        A.data[impact] = 0.0
        factors = splu(A.tocsc())
        transposed, reset = partial(factors.solve, trans="T"), R[self.section.indices]
        opened = OpenedCycle(factors.solve, transposed, reset, self._closing, self._last, self._rows.size)
        V, M = opened.response(self.section.tangent(x[self._first], self._parameters(x, p)))
        return V, M, opened.adjoint

    def gradient(self, x: Array, p: Array, V: Array, adjoint: Array, G: Array) -> Array:
        """Gradient of <G, M>, shape (n_x,); ``adjoint`` is that of the weights G."""
        weights, slope = -adjoint, np.zeros(x.size)
        weights[self._closing] = 0.0
        weights[self._closing[self.section.indices]] = -G
        multipliers, deviation, H = np.zeros(self._n_rows), np.zeros(x.size), self._hessian
        for column, weight in zip(V.T, weights.T, strict=True):
            multipliers[self._rows], deviation[self._columns] = weight, column
            H.data[:] = self._bent(x, p, 0.0, multipliers)[0]
            slope += H @ deviation + H.T @ deviation - H.diagonal() * deviation
        start = adjoint[self._closing].ravel(order="F")
        (bent,) = self._start(x[self._first], self._parameters(x, p), start)
        slope[self._first] += bent[: self._first.size]
        slope[self._freed] += bent[self._first.size :][self._free]
        return slope

    def along_motion(self, x: Array, p: Array) -> Array:
        """Derivatives by the unknowns ``controls`` while the equations of motion hold; shape (n_x, n_controls)."""
        J = self._jacobian_at(x, p)[self._all_rows]
        slopes = np.zeros((x.size, self.controls.size))
        slopes[self._all_columns] = -splu(J[:, self._all_columns].tocsc()).solve(J[:, self.controls].toarray())
        slopes[self.controls, np.arange(self.controls.size)] = 1.0
        return slopes


def _pattern(sparsity: Sparsity) -> csc_array:
    """A matrix of SciPy with this sparsity, filled with zeros."""
    return csc_array((np.zeros(sparsity.nnz()), sparsity.row(), sparsity.colind()), shape=sparsity.shape)


class _Point(NamedTuple):
    """Response V, adjoint of V, and the rows at a point."""

    V: Array
    adjoint: Callable[[Array], Array]
    rows: list[CircleInequality]


class CircleRows:
    """The circle inequalities of the multipliers for a radius; NaN where there is no return map.

    Attributes
    ----------
    returned : the return map.
    rows : (x, p) -> the inequalities, with a Jacobian. It must be kept as long as a program uses it, as ``bent``.
    bent : (x, p, multipliers) -> curvature of the rows by torques and freed parameters.
    """

    @building
    def __init__(self, collocation: Collocation, radius: float) -> None:
        self.returned, self._radius = ReturnMap(collocation), radius
        n_x, n_p, count = collocation.n_x, len(collocation.dynamics.p), 2 + (self.returned.section.indices.size > 1)
        self._key: tuple[bytes, bytes] | None = None
        self._point: _Point | None = None

        def rows(x: Array, p: Array) -> tuple[Any]:
            point = self.at(x, p)
            return (np.full(count, np.nan) if point is None else [row.value for row in point.rows],)

        def slopes(x: Array, p: Array, _: Array) -> tuple[Array, DM]:
            """Derivatives of the rows by x, and zero for those by p, which are never used."""
            return np.array([self.gradient(x, p, weights) for weights in np.eye(count)]), DM(count, p.size)

        derivatives = (Sparsity.dense(count, n_x), Sparsity(count, n_p)), slopes
        self.rows = NumericFunction("circle", (n_x, n_p), (Sparsity.dense(count, 1),), rows, derivatives=derivatives)
        n = self.returned.controls.size
        self.bent = NumericFunction(
            "curvature", (n_x, n_p, count), (Sparsity.dense(n, n),), lambda *at: (self.curvature(*at),)
        )

    @overflow_allowed()
    def at(self, x: Array, p: Array) -> _Point | None:
        """The rows at a point; None if the return map has no finite derivative. The last point is kept."""
        key = x.tobytes(), p.tobytes()
        if key != self._key:
            self._key, self._point = key, None
            with suppress(RuntimeError, np.linalg.LinAlgError):  # singular
                V, M, adjoint = self.returned.response(x, p)
                if np.isfinite(M).all():
                    self._point = _Point(V, adjoint, circle_inequalities(M, self._radius))
        return self._point

    def gradient(self, x: Array, p: Array, weights: Array) -> Array:
        """Gradient of the weighted sum of the rows, shape (n_x,)."""
        point = self.at(x, p)
        if point is None:
            return np.full(x.size, np.nan)
        G = sum(weight * row.by_matrix for weight, row in zip(weights.tolist(), point.rows, strict=True))
        return self.returned.gradient(x, p, point.V, point.adjoint(np.asarray(G)), np.asarray(G))

    @overflow_allowed()
    def curvature(self, x: Array, p: Array, weights: Array) -> Array:
        """Second derivatives of the weighted sum along the motion, shape (n_controls, n_controls)."""
        n = self.returned.controls.size
        curvature = np.zeros((n, n))
        if not weights.any() or self.at(x, p) is None:
            return curvature
        slopes = self.returned.along_motion(x, p)
        for k, direction in enumerate(slopes.T):
            step = DIFFERENCE / max(1.0, float(np.abs(direction).max()))
            ends = [self.gradient(x + sign * step * direction, p, weights) for sign in (1.0, -1.0)]
            curvature[:, k] = slopes.T @ (ends[0] - ends[1]) / (2 * step)
        return (curvature + curvature.T) / 2 if np.isfinite(curvature).all() else np.zeros((n, n))


@building
def bound_radius(collocation: Collocation, radius: float) -> None:
    """Add the rows that keep the multipliers within a radius."""
    circle = CircleRows(collocation, radius)
    collocation.add_rows(RADIUS, circle.rows, circle.bent, circle.returned.controls)


def largest_modulus(collocation: Collocation, x: Array) -> float:
    """Largest modulus of the multipliers of a solution; infinite if there is no return map."""
    with suppress(RuntimeError):  # singular
        M = ReturnMap(collocation).response(x, collocation.dynamics.p)[1]
        if np.isfinite(M).all():
            return float(np.abs(np.linalg.eigvals(M)).max())
    return np.inf
