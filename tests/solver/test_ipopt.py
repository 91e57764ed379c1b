"""A small nonlinear program with a known optimum: blocks and bounds, sizes, multipliers, and requests to stop."""

import numpy as np
import pytest
from casadi import MX, sumsqr, vertcat

from gaitopt.gait.gait import Status
from gaitopt.solver.ipopt import Block, Ipopt


def nearest_point(**options):
    """The point of x + y <= p, y >= 0 that is nearest to (2, 1)."""
    x, y, p = MX.sym("x"), MX.sym("y"), MX.sym("p")
    unknowns = [Block(name="x", expression=x), Block(name="y", expression=y, lower=0.0)]
    rows = [Block(name="sum", expression=x + y - p, upper=0.0)]
    objective = sumsqr(vertcat(x, y) - np.array([2.0, 1.0]))
    return Ipopt(unknowns, rows, p, objective, options={"tol": 1e-10}, **options)


@pytest.mark.portable
@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize(
    ("p", "optimum", "multiplier", "of_bound"),
    [(2.0, [1.5, 0.5], 1.0, 0.0), (0.0, [0.0, 0.0], 4.0, -2.0), (5.0, [2.0, 1.0], 0.0, 0.0)],
)
def test_optimum_and_multipliers_are_those_of_the_closed_form(exact, p, optimum, multiplier, of_bound):
    end = nearest_point(exact=exact).solve(np.array([0.3, 0.2]), np.array([p]))
    assert end.status is Status.CONVERGED
    np.testing.assert_allclose(end.w, optimum, rtol=0, atol=1e-6)
    np.testing.assert_allclose(end.multipliers, [multiplier], rtol=0, atol=1e-5)
    np.testing.assert_allclose(end.bound_multipliers, [0.0, of_bound], rtol=0, atol=1e-5)
    assert end.objective == pytest.approx((optimum[0] - 2) ** 2 + (optimum[1] - 1) ** 2, abs=1e-5)


def test_sizes_of_unknowns_and_rows_change_neither_optimum_nor_multipliers():
    sizes = np.array([100.0, 0.01]), np.array([30.0])
    end = nearest_point().solve(np.array([0.3, 0.2]), np.array([2.0]), *sizes)
    np.testing.assert_allclose(end.w, [1.5, 0.5], rtol=0, atol=1e-5)
    np.testing.assert_allclose(end.multipliers, [1.0], rtol=0, atol=1e-4)


def test_progress_reports_the_violation_of_the_rows_and_a_request_stops_it():
    seen = []
    watched = nearest_point(progress=lambda *report: seen.append(report), should_stop=lambda: len(seen) >= 3)
    end = watched.solve(np.array([3.0, 2.0]), np.array([2.0]))
    assert end.status is Status.INTERRUPTED
    assert [iteration for iteration, _ in seen] == [0, 1, 2]
    assert seen[0][1] == pytest.approx(3.0)
