"""The return map of a solution and its derivatives, by implicit differentiation of the equations F(w, p) = 0.

The cycle is opened at its last reset, so that it starts from a given state. A is dF/dw without the dependence of the
last rows on the last node, and R is the derivative of the last reset. V is the response of all unknowns to a deviation
Z of the first state, V_K that of the last node, and M Z the deviation of the state that returns:

    A V = Z,      M Z = R V_K             adjoint of weights G of M:  A' Lambda = R' G

The durations follow the events, so that no saltation formula is needed. Derivatives of M along a direction N in which
F stays zero, and of <G, M> by all unknowns, are

    dM = -Lambda' F''(V, N)               d<G, M> = <G, dR V_K> + <Lambda, dZ - dA V>

Taylor coefficients of the map follow order by order from those of F, with the factors of the one matrix A.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from casadi import MX, Function, dot, gradient, jtimes, vertcat
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.building import BUILT, built_once
from gaitopt.model.buffered import BufferedFunction
from gaitopt.solver.jets import Jets, second_derivatives
from gaitopt.solver.shooting import MultipleShooting
from gaitopt.solver.sparse import ScaledMatrix, SparseMatrix
from gaitopt.threads import cached_property


class OpenedCycle(NamedTuple):
    """A cycle opened at its last reset, by any equations.

    Attributes
    ----------
    solve, solve_transposed : right-hand sides (n, k) -> solutions of A x = b and of A' x = b.
    reset : R, or those of its rows that are of interest, shape (m, n_z).
    rows, last : the rows of the last reset, and the columns of the last state, n_z each.
    n : number of equations.
    """

    solve: Callable[[Array], Array]
    solve_transposed: Callable[[Array], Array]
    reset: Array
    rows: slice | NDArray[np.intp]
    last: slice | NDArray[np.intp]
    n: int

    def response(self, deviations: Array) -> tuple[Array, Array]:
        """Response V (n, k) to deviations (n_z, k) of the first state, and the state that returns, (m, k)."""
        right = np.zeros((self.n, deviations.shape[1]))
        right[self.rows] = deviations
        response = self.solve(right)
        return response, self.reset @ response[self.last]

    def adjoint(self, weights: Array) -> Array:
        """Weights (n, k) of the equations of V from weights (m, k) of the state that returns."""
        end = np.zeros((self.n, weights.shape[1]))
        end[self.last] = self.reset.T @ weights
        return self.solve_transposed(end)


class MapDerivatives:
    """The return map of a solution with its derivatives, computed on use.

    Parameters
    ----------
    equations : the equations of the gait.
    w, p : ndarrays - unknowns and parameters, in SI.
    jacobian : derivative of the equalities by nodes, durations and freed parameters; shape (n, n + n_free).
    scaled : converts a matrix by nodes and durations to natural units.
    """

    def __init__(
        self,
        equations: MultipleShooting,
        w: Array,
        p: Array,
        jacobian: SparseMatrix,
        scaled: Callable[[SparseMatrix], ScaledMatrix],
    ) -> None:
        self._equations, self._w, self._p, self._jacobian, self._scaled = equations, w, p, jacobian, scaled
        self._n_z, self._n = equations.system.n_z, w.size - len(equations.free)
        self._last = slice((equations.n_nodes - 1) * self._n_z, equations.n_nodes * self._n_z)
        self._section = equations.system.section(equations.mesh.cycle)
        self._dynamics = equations.dynamics(p, equations.unpack(w).freed)
        self._units = self._dynamics.state_units

    @cached_property
    def _opened(self) -> OpenedCycle:
        square = self._jacobian.leading(self._n)
        first, pattern = self._n - self._n_z, square.pattern
        reset = -square.dense(self._last.start, self._last.stop)[first:]
        columns, data = slice(*pattern.pointers[[self._last.start, self._last.stop]]), square.data.copy()
        data[columns][pattern.rows[columns] >= first] = 0.0
        A = self._scaled(SparseMatrix(pattern=pattern, data=data))
        return OpenedCycle(A.solve, A.solve_transposed, reset, slice(first, self._n), self._last, self._n)

    @cached_property
    def _on_section(self) -> tuple[Array, Array]:
        """The response to a deviation of every section coordinate, and the derivative of the map in these."""
        response, returned = self._opened.response(self._section.tangent(self._w[: self._n_z], self._dynamics.p))
        return response, returned[self._section.indices]

    @property
    def by_section(self) -> Array:
        """Derivative in the section coordinates, shape (n_xi, n_xi), in SI. Its eigenvalues are the multipliers."""
        return self._on_section[1]

    @cached_property
    def by_parameters(self) -> Array:
        """Derivative by the freed parameters at fixed section coordinates, shape (n_xi, n_free), in SI.

        The parameters act during the whole cycle: on the state that the section coordinates determine, along the
        motion, and in the last reset.
        """
        opened, first = self._opened, self._n - self._n_z
        by_free = self._jacobian.dense(self._n, self._w.size)
        by_lift = self._section.by_parameters(self._w[: self._n_z], self._dynamics.p)
        numbers = {name: k for k, name in enumerate(self._equations.system.parameters)}
        right = -by_free
        right[first:] = 0.0
        for column, name in enumerate(self._equations.free):
            if numbers[name] < by_lift.shape[1]:
                right[first:, column] = by_lift[:, numbers[name]]
        returned = opened.reset @ opened.solve(right)[self._last] - by_free[first:]
        return np.asarray(returned[self._section.indices])

    def gradient(self, weights: Array) -> Array:
        """Gradient of <weights, ``by_section``> by all unknowns, shape (n_w,); w need not solve the equations."""
        every = np.zeros((self._n_z, weights.shape[1]))
        every[self._section.indices] = weights
        matrices = (matrix.ravel(order="F") for matrix in (self._on_section[0], self._opened.adjoint(every), weights))
        return _gradient(self._equations)(self._w, self._p, *matrices)[0].copy()

    @cached_property
    def _everywhere(self) -> tuple[Array, Array]:
        """Response V and map M for deviations of the first state in all its coordinates, by one natural unit each.

        The last reset leads back to the section, so that deviations off the section have multipliers of zero.
        """
        response, returned = self._opened.response(np.eye(self._n_z))
        return response * self._units, returned * self._units / self._units[:, None]

    @property
    def scaled(self) -> Array:
        """Derivative in all coordinates of the state, shape (n_z, n_z), in natural units."""
        return self._everywhere[1]

    def slopes(self, left: Array, right: Array, directions: Array) -> Array:
        """Derivatives of sum_k l_k' M r_k, with M = ``scaled``, along directions; shape (m,).

        Parameters
        ----------
        left, right : ndarrays, shape (n_z, k) - l_k and r_k, in natural units.
        directions : ndarray, shape (m, n_w) - directions of w along which the equations stay zero.
        """
        m, count = len(directions), left.shape[1]
        weights = left / self._units[:, None]
        adjoint = self._opened.adjoint(weights)
        adjoint[-self._n_z :] = weights
        u = np.zeros((count, self._w.size))
        u[:, : self._n] = (self._everywhere[0] @ right).T
        pairs = np.repeat(u, m, axis=0), np.tile(directions, (count, 1))
        bent = second_derivatives(self._equations, self._w, self._p, *pairs)
        return -np.einsum("nk,kmn->m", adjoint, bent.reshape(count, m, -1))

    def taylor(self, directions: Array, highest: int) -> Array:
        """Taylor coefficients along directions (m, n_z) up to an order, shape (highest, m, n_z), in natural units."""
        opened = self._opened
        m, returned = len(directions), list[Array]()
        curves = np.zeros((highest + 1, m, self._w.size))
        curves[0] = self._w
        for order in range(1, highest + 1):
            known = np.zeros((m, self._n))  # equations of this order without its unknowns
            if order > 1:
                known = Jets(self._equations, self._p, curves[: order + 1]).equalities()[order]
            right = -known.T
            right[-self._n_z :] = (directions * self._units).T if order == 1 else 0.0
            curves[order, :, : self._n] = opened.solve(right).T
            # the last rows are z_0 less the reset
            returned.append((curves[order][:, self._last] @ opened.reset.T - known[:, -self._n_z :]) / self._units)
        return np.array(returned)


@built_once(maxsize=8)
def _gradient(t: MultipleShooting) -> BufferedFunction:
    """(w, p, V, Lambda, G) -> gradient of <G, M> by w, cached because searches and tables evaluate it repeatedly."""
    n_z, n, section = t.system.n_z, t.equalities.numel(), t.system.section(t.mesh.cycle)
    indices = section.indices.tolist()
    V, adjoint = MX.sym("V", n, len(indices)), MX.sym("Lambda", n, len(indices))
    G = MX.sym("G", len(indices), len(indices))
    by_freed, nodes = MX.zeros(len(t.free), len(indices)), n_z * t.n_nodes
    changed = jtimes(t.equalities[:-n_z], t.w, vertcat(V, by_freed))
    start = section.tangents(t.Z[:, 0], t.p[: len(t.system.walker.model_fields)])
    before, after = MX.zeros(nodes - n_z, len(indices)), MX.zeros(n - nodes, len(indices))
    last = vertcat(before, V[nodes - n_z : nodes, :], after, by_freed)
    returned = -jtimes(t.equalities[-n_z:], t.w, last)[indices, :]  # the last rows are z_0 less the reset
    product = dot(G, returned) + dot(adjoint[-n_z:, :], start) - dot(adjoint[:-n_z, :], changed)
    function = Function("product", [t.w, t.parameters, V, adjoint, G], [gradient(product, t.w)])
    return BufferedFunction(BUILT.watch(function))
