"""Nonlinear programs that are sums of small functions, with exact sparse derivatives.

    min f(x)   s.t.   g(x) = A x + sum_e g_e(x[columns_e], p, c_e),      f likewise

Each element is one expression that is applied to many groups of unknowns. Its derivatives are built once, for a few
unknowns, and the Jacobian and the Hessian of the whole are assembled from theirs: CasADi alone would differentiate the
whole graph. This is the assembly of finite elements.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from casadi import DM, MX, SX, Function, Sparsity, dot, gradient, hessian, jacobian, mtimes, reshape, vec, vertcat
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array

from gaitopt.arrays import Array
from gaitopt.building import building, built_once

Positions: TypeAlias = tuple[NDArray[np.intp], NDArray[np.intp]]
"""Rows and columns of the entries of a matrix."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Elements:
    """Copies of one function that depend on different unknowns.

    Attributes
    ----------
    function : (y, c, p) -> (f, g); y are local unknowns, c constants of the copy, p parameters that all copies share.
    columns : ndarray, shape (K, n_y) - indices of the local unknowns of each copy in x.
    rows : ndarray, shape (K, n_g) - rows of g to which the values are added.
    constants : ndarray, shape (K, n_c) - constants of each copy.
    """

    function: Function
    columns: NDArray[np.intp]
    rows: NDArray[np.intp]
    constants: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class AssembledProgram:
    """A sum of elements as expressions of the symbols x and p, with its derivatives for ``casadi.nlpsol``."""

    x: MX
    p: MX
    f: MX
    g: MX
    derivatives: dict[str, Function]


@built_once(maxsize=256)
def _derivatives(function: Function) -> tuple[Function | None, Function, Function, Sparsity, Sparsity]:
    """Derivatives of an element.

    Returns
    -------
    slope : (y, c, p) -> gradient of f; None if f is zero, as in most elements.
    first : (y, c, p) -> nonzero entries of the Jacobian of g.
    second : (y, c, p, w, l) -> nonzero entries of the Hessian.
    patterns : sparsities of the Jacobian and of the Hessian.
    """
    y, c, p = (SX.sym(name, function.size1_in(k)) for k, name in enumerate("ycp"))
    f, g = function(y, c, p)
    slope = None if f.is_zero() else Function("slope", [y, c, p], [gradient(f, y)])
    jac = jacobian(g, y)
    first = Function("first", [y, c, p], [SX(jac.nz[:])])
    w, multipliers = SX.sym("w"), SX.sym("l", g.numel())
    bent = hessian(w * f + dot(multipliers, g), y)[0]
    second = Function("second", [y, c, p, w, multipliers], [SX(bent.nz[:])])
    return slope, first, second, jac.sparsity(), bent.sparsity()


@building
def assembled(elements: Sequence[Elements], linear: csc_array, n_p: int) -> AssembledProgram:
    """The program of a sum of elements; ``linear`` is A, shape (n_g, n_x), and ``n_p`` the number of parameters."""
    n_g, n_x = linear.shape
    x, p, weight, multipliers = MX.sym("x", n_x), MX.sym("p", n_p), MX.sym("w"), MX.sym("l", n_g)
    f, g = MX(0), mtimes(_matrix(linear), x)
    gradients = MX.zeros(n_x)  # dense, because IPOPT reads n_x entries whatever the sparsity
    entries, bent = list[MX](), list[MX]()
    known = linear.tocoo()
    positions, bent_positions = [(known.row, known.col)], [(np.zeros(0, int), np.zeros(0, int))]
    entries.append(MX(DM(known.data)))
    for each in elements:
        count = len(each.columns)
        gradient_of_f, first, second, jac, hess = _derivatives(each.function)
        y, c = reshape(x[each.columns.ravel().tolist()], -1, count), DM(each.constants.T)
        values, added = each.function.map("values", "serial", count, [2], [])(y, c, p)
        slopes = first.map("first", "serial", count, [2], [])(y, c, p)
        own = reshape(multipliers[each.rows.ravel().tolist()], -1, count)
        curvature = second.map("second", "serial", count, [2, 3], [])(y, c, p, weight, own)
        if gradient_of_f is not None:
            f += mtimes(values, MX.ones(count, 1))
            slope = gradient_of_f.map("slope", "serial", count, [2], [])(y, c, p)
            gradients += mtimes(_sum(each.columns, n_x), vec(slope))
        g += mtimes(_sum(each.rows, n_g), vec(added))
        entries.append(vec(slopes))
        bent.append(vec(curvature))
        positions.append(_global(each.rows, each.columns, jac))
        bent_positions.append(_global(each.columns, each.columns, hess))
    slopes_sparsity, slopes_sum = _pattern(positions, (n_g, n_x))
    hess_sparsity, hess_sum = _pattern(bent_positions, (n_x, n_x), upper=True)
    slope = MX(slopes_sparsity, mtimes(slopes_sum, vertcat(*entries)))
    curvature = MX(hess_sparsity, mtimes(hess_sum, vertcat(MX(0, 1), *bent)))
    return AssembledProgram(
        x=x,
        p=p,
        f=f,
        g=g,
        derivatives={
            "grad_f": Function("grad_f", [x, p], [f, gradients], ["x", "p"], ["f", "grad_f_x"]),
            "jac_g": Function("jac_g", [x, p], [g, slope], ["x", "p"], ["g", "jac_g_x"]),
            "hess_lag": Function(
                "hess_lag",
                [x, p, weight, multipliers],
                [curvature],
                ["x", "p", "lam_f", "lam_g"],
                ["triu_hess_gamma_x_x"],
            ),
        },
    )


def _matrix(matrix: csc_array) -> DM:
    """A matrix of SciPy; CasADi itself takes ten times as long to convert it."""
    n_rows, n_columns = matrix.shape
    return DM(Sparsity(n_rows, n_columns, matrix.indptr.tolist(), matrix.indices.tolist()), matrix.data)


def _sum(indices: NDArray[np.intp], n: int) -> DM:
    """The matrix that adds entries, in the order of the rows of ``indices``, to the entries of a vector."""
    flat = indices.ravel()
    return _matrix(csc_array((np.ones(flat.size), (flat, np.arange(flat.size))), shape=(n, flat.size)))


def _global(rows: NDArray[np.intp], columns: NDArray[np.intp], sparsity: Sparsity) -> Positions:
    """Global positions of the local entries of all copies."""
    local_rows, local_columns = np.array(sparsity.row(), int), np.array(sparsity.get_col(), int)
    return rows[:, local_rows].ravel(), columns[:, local_columns].ravel()


def _pattern(positions: Sequence[Positions], shape: tuple[int, int], *, upper: bool = False) -> tuple[Sparsity, DM]:
    """The sparsity of a sum of entries at these positions, and the matrix that adds them to its nonzeros."""
    rows, columns = (np.concatenate(each) for each in zip(*positions, strict=True))
    chosen = np.flatnonzero(columns >= rows) if upper else np.arange(rows.size)
    keys, inverse = np.unique(columns[chosen] * shape[0] + rows[chosen], return_inverse=True)
    sparsity = Sparsity.triplet(*shape, (keys % shape[0]).tolist(), (keys // shape[0]).tolist())
    summing = coo_array((np.ones(chosen.size), (inverse.ravel(), chosen)), shape=(keys.size, rows.size))
    return sparsity, _matrix(csc_array(summing))
