"""The certified radius of the multipliers and its gradient."""

import numpy as np
import pytest
from casadi import MX, Function, jacobian
from named import named

from gaitopt import load_problem, solve
from gaitopt.design.spectral_radius import certified_radius, radius_gradient, smoothed_radius
from gaitopt.solver.assembly import solution_of

MATRICES = {
    "real": np.diag([0.9, 0.3, -0.2]),
    "complex pair": np.array([[0.4, -0.5, 0.1], [0.5, 0.4, 0.0], [0.0, 0.2, 0.1]]),
    "defective": np.array([[0.7, 1.0, 0.0], [0.0, 0.7, 0.0], [0.0, 0.0, 0.1]]),
    "zero multiplier": np.array([[0.8, 30.0, 0.0], [0.0, 0.0, 0.0], [5.0, 1.0, 0.2]]),
    "nilpotent": np.array([[0.0, 40.0, 1.0], [0.0, 0.0, 3.0], [0.0, 0.0, 0.0]]),
}


@pytest.mark.parametrize("name", MATRICES)
def test_certificate_bounds_the_spectral_radius_from_above_and_its_gradient_is_that_of_differences(name):
    M = MATRICES[name]
    (radius, P), largest = smoothed_radius(M), np.abs(np.linalg.eigvals(M)).max()
    assert radius > largest
    if name in ("real", "complex pair"):  # the certificate is tight where multipliers are apart
        assert radius == pytest.approx(largest, rel=1e-5)
    assert np.linalg.eigvalsh(P).min() > 0
    assert np.linalg.eigvalsh(radius**2 * P - M.T @ P @ M).min() > 0
    exact = radius_gradient(M, radius, P)
    direction = np.random.default_rng(0).normal(size=M.shape)
    step = 1e-6
    difference = smoothed_radius(M + step * direction)[0] - smoothed_radius(M - step * direction)[0]
    assert np.vdot(exact, direction) == pytest.approx(difference / (2 * step), rel=1e-3)


@pytest.mark.parametrize("size", [1.0, 1e3, 1e6, 1e20])
def test_radius_of_a_very_large_nilpotent_matrix_is_found_although_rounding_makes_its_equations_singular(size):
    radius, P = smoothed_radius(size * np.array([[1.0, 1.0], [-1.0, -1.0]]))
    assert radius == pytest.approx(0.002 * size, rel=1e-4)
    assert np.trace(P) == pytest.approx(1, rel=0.1)


@pytest.mark.parametrize("name", ["compass-torque-slip", "compass-torque-impact-slip", "rimless-wheel-stick"])
def test_gradient_in_the_unknowns_is_that_of_central_differences(name):
    gait = named(name)
    free = tuple(key for key in gait.system.parameters if key == "friction" or key.startswith("control."))
    solution = solution_of(gait, free)
    t, w = solution.equations, solution.w
    radius = certified_radius(t)
    symbol = MX.sym("w", w.size)
    slope = Function("slope", [symbol], [jacobian(radius(symbol, gait.p), symbol)])
    direction = np.random.default_rng(3).normal(size=w.size)
    step = 1e-7
    difference = float(radius(w + step * direction, gait.p)) - float(radius(w - step * direction, gait.p))
    assert float(slope(w) @ direction) == pytest.approx(difference / (2 * step), rel=1e-4)


def test_least_radius_is_found():
    problem = load_problem("compass-torque-stable-slip-cheap").replace(
        {"friction": 0.16, "objective": "spectral_radius", "constraints": {"state.dx": {"min": 0.02}}}
    )
    gait = solve(problem)
    assert gait.converged
    assert gait.spectral_radius == pytest.approx(0.70128, abs=1e-4)
