"""Programs that are sums of small functions."""

import casadi as ca
import numpy as np
from scipy.sparse import csc_array

from gaitopt.solver.elements import Elements, assembled


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
