"""Sparse systems are solved as dense ones are, in whatever units and however stiff their rows."""

import casadi as ca
import numpy as np
import pytest
from scipy.sparse import csc_array

from gaitopt.solver.elements import Elements, assembled
from gaitopt.solver.sparse import Pattern, ScaledMatrix, SparseMatrix

pytestmark = pytest.mark.portable

N = 30


@pytest.fixture
def dense() -> np.ndarray:
    rng = np.random.default_rng(1)
    return np.where(rng.random((N, N)) < 0.2, rng.standard_normal((N, N)), 0.0) + np.diag(3 * rng.standard_normal(N))


def sparse(dense: np.ndarray) -> SparseMatrix:
    columns, rows = np.nonzero(dense.T)
    pointers = np.searchsorted(columns, np.arange(dense.shape[1] + 1))
    pattern = Pattern(shape=dense.shape, pointers=pointers, rows=rows)
    return SparseMatrix(pattern=pattern, data=dense.T[columns, rows])


def test_product_columns_and_further_row_are_those_of_the_dense_matrix(dense: np.ndarray) -> None:
    matrix, vector = sparse(dense), np.linspace(-1, 1, N)
    assert matrix @ vector == pytest.approx(dense @ vector, abs=1e-13)
    assert np.array_equal(matrix.dense(3, 9), dense[:, 3:9])
    assert np.array_equal(matrix.leading(7).dense(0, 7), dense[:, :7])
    at, values = np.array([2, 5, N - 1]), np.array([1.0, -2.0, 3.0])
    row = np.zeros(N)
    row[at] = values
    assert np.array_equal(matrix.with_row(at, values).dense(0, N), np.vstack([dense, row]))


@pytest.mark.parametrize("stiff", [1.0, 1e18])
@pytest.mark.parametrize("count", [1, 3])
def test_solutions_are_right_whatever_the_units_and_the_stiffest_row(dense, stiff, count):
    rng = np.random.default_rng(2)
    rows, columns, x = (
        10 ** rng.uniform(-6, 6, (N, 1)),
        10 ** rng.uniform(-6, 6, (N, 1)),
        rng.standard_normal((N, count)),
    )
    dense[4] *= stiff
    matrix = ScaledMatrix(sparse(dense * rows / columns.T), rows.ravel(), columns.ravel())
    assert matrix.solve(dense @ x * rows) / columns == pytest.approx(x, abs=1e-11)
    x[4] /= stiff
    assert matrix.solve_transposed(dense.T @ x / columns) * rows == pytest.approx(x, abs=1e-11)
    assert matrix.solve((dense @ x * rows)[:, 0]) == pytest.approx((x * columns)[:, 0], rel=1e-9)


def test_singular_matrix_has_no_solution(dense: np.ndarray) -> None:
    full = sparse(np.ones((N, N))).pattern
    dense[:, 3] = 0.0
    matrix = ScaledMatrix(SparseMatrix(pattern=full, data=dense.T.ravel()), np.ones(N), np.ones(N))
    with pytest.raises(RuntimeError, match="singular"):
        matrix.solve(np.ones(N))


def test_the_gradient_has_an_entry_for_each_unknown():
    """IPOPT reads one for each, beyond the end of a sparse gradient."""
    y, c, p = ca.SX.sym("y"), ca.SX.sym("c", 0), ca.SX.sym("p")
    square = Elements(
        function=ca.Function("square", [y, c, p], [p * y**2, ca.vertcat(ca.sin(y))]),
        columns=np.array([[1]]),
        rows=np.array([[0]]),
        constants=np.zeros((1, 0)),
    )
    program = assembled([square], csc_array(np.array([[1.0, 0.0, 2.0]])), 1)
    at = [0.3, 0.5, 0.7]
    gradient = program.derivatives["grad_f"](at, 4.0)[1]
    assert gradient.sparsity().is_dense()
    np.testing.assert_allclose(np.asarray(gradient).ravel(), [0.0, 4.0, 0.0])
    jacobian = program.derivatives["jac_g"](at, 4.0)[1]
    np.testing.assert_allclose(np.asarray(ca.DM(jacobian)), [[1.0, np.cos(0.5), 2.0]])
