"""The exact problem of a design: scalars and their derivatives, quadratic programs, optima and their neighbours."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from casadi import MX, Function, jacobian
from named import named, solved
from samples import sampled
from scipy.optimize import nnls

from gaitopt import load_problem, solve, verify
from gaitopt.design.exact import EXTREMA, RADIUS
from gaitopt.design.neighbourhood import neighbourhood
from gaitopt.design.sensitivity import DifferentiatedCurve, Sensitivity
from gaitopt.design.spectral_radius import (
    certified_radius,
    circle_inequalities,
    modulus_gradient,
    radius_gradient,
    smoothed_radius,
)
from gaitopt.design.sqp import WorkRemainder, quadratic_program
from gaitopt.gait import curves
from gaitopt.solver.assembly import solution_of
from gaitopt.solver.newton import Solution, polish

SMOOTH = ("period", "step_length", "speed", "work", "absolute_cost_of_transport", "torque_squared", "slip_distance")
SMOOTH += ("torque_cost",)
PIECED = tuple(name for name in EXTREMA if name != RADIUS)


@pytest.fixture(scope="module")
def stable_slip():
    return solve(load_problem("compass-torque-stable-slip"))


def transcribed(gait, free):
    solution = solution_of(gait, free)
    return solution.equations, solution.w


def scalars_at(t, w, p, freed):
    moved = w.copy()
    moved[-len(freed) :] = freed
    return Sensitivity(polish(Solution(t, moved, p)))


def test_three_moduli_meet_at_the_optimum_of_the_stable_slip_that_has_no_better_neighbour(stable_slip):
    assert stable_slip.converged, stable_slip.message
    assert stable_slip.solver["kkt"] < 1e-6
    assert np.sort(np.abs(stable_slip.multipliers))[1:] == pytest.approx(0.5, abs=1e-7)
    assert stable_slip.measures["cost_of_transport"] == pytest.approx(0.019785783, rel=1e-7)
    assert stable_slip.spectral_radius <= 0.5 + 1e-9
    searched = neighbourhood(stable_slip, directions=5, radii=(1e-3,))
    assert searched.feasible > 0
    assert searched.optimal, searched.summary


def test_exact_scalars_are_those_that_every_gait_is_measured_by(stable_slip):
    t, w = transcribed(stable_slip, ("control.ankle", "control.hip"))
    scalars = scalars_at(t, w, stable_slip.p, w[-2:])
    for name in SMOOTH:
        assert scalars.smooth(name)[0] == pytest.approx(stable_slip.measures[name], rel=1e-11)
    for name in PIECED:
        extreme = max(EXTREMA[name] * candidate.value for candidate in scalars.candidates(name))
        assert extreme == pytest.approx(EXTREMA[name] * stable_slip.measures[name], rel=1e-11)


@pytest.mark.parametrize(
    "name", ["compass-torque-slip", pytest.param("compass-pd-impact-slip", marks=pytest.mark.slow)]
)
def test_derivatives_of_exact_scalars_are_those_of_central_differences(name):
    gait = solve(load_problem(name))
    free = tuple(key for key in gait.system.parameters if key == "friction" or key.startswith("control."))[:3]
    t, w = transcribed(gait, free)
    freed = w[-len(free) :]
    direction = np.random.default_rng(1).normal(size=len(free)) * np.maximum(np.abs(freed), 0.1)
    here, h = scalars_at(t, w, gait.p, freed), 1e-4

    around = [[scalars_at(t, w, gait.p, freed + k * s * direction) for k in (1, -1)] for s in (h, h / 2)]

    def difference(value):
        wide, narrow = ((value(a) - value(b)) / (2 * s) for (a, b), s in zip(around, (h, h / 2), strict=True))
        return (4 * narrow - wide) / 3

    for scalar in SMOOTH:
        slope = here.smooth(scalar)[1] @ direction
        assert slope == pytest.approx(difference(lambda s, n=scalar: s.smooth(n)[0]), rel=1e-6, abs=1e-9)
    for scalar in PIECED:
        top = max(here.candidates(scalar), key=lambda candidate, n=scalar: EXTREMA[n] * candidate.value)
        values = difference(lambda s, n=scalar: max(EXTREMA[n] * candidate.value for candidate in s.candidates(n)))
        assert EXTREMA[scalar] * top.gradient @ direction == pytest.approx(values, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("size", [1, 2, 3, 4, 5])
def test_circle_inequalities_are_products_over_the_multipliers(size):
    M = np.random.default_rng(size).normal(size=(size, size))
    e = np.linalg.eigvals(M / 1.3)
    pairs = [1 - e[i] * e[j] for i in range(size) for j in range(i + 1, size)]
    products = [np.prod(1 - e), np.prod(1 + e), np.prod(pairs)]
    for row, product in zip(circle_inequalities(M, 1.3), products, strict=False):
        assert row.value == pytest.approx(product.real, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("size", [2, 3, 4])
def test_gradients_of_the_circle_inequalities_are_those_of_central_differences(size):
    rng, h = np.random.default_rng(7), 1e-6
    M, direction = rng.normal(size=(size, size)), rng.normal(size=(size, size))
    ahead, behind = circle_inequalities(M + h * direction, 1.3), circle_inequalities(M - h * direction, 1.3)
    out, back = circle_inequalities(M, 1.3 + h), circle_inequalities(M, 1.3 - h)
    for k, row in enumerate(circle_inequalities(M, 1.3)):
        assert np.vdot(row.by_matrix, direction) == pytest.approx((ahead[k].value - behind[k].value) / 2 / h, rel=1e-6)
        assert row.by_radius == pytest.approx((out[k].value - back[k].value) / 2 / h, rel=1e-6)
    value, gradient = modulus_gradient(M)
    difference = modulus_gradient(M + h * direction)[0] - modulus_gradient(M - h * direction)[0]
    assert value == pytest.approx(np.abs(np.linalg.eigvals(M)).max(), rel=1e-12)
    assert np.vdot(gradient, direction) == pytest.approx(difference / 2 / h, rel=1e-6)


@pytest.mark.parametrize("coalesced", [np.diag([0.5, 0.5, 0.1]) + np.eye(3, k=1), np.diag([0.5, -0.5, 0.2])])
def test_circle_inequalities_vanish_on_the_circle_and_are_smooth_there(coalesced):
    rows = {row.name: row for row in circle_inequalities(coalesced, 0.5)}
    assert rows["real"].value == pytest.approx(0.0, abs=1e-12)
    assert all(np.isfinite(row.by_matrix).all() for row in rows.values())
    assert np.linalg.norm(rows["real"].by_matrix) > 0.1


@pytest.mark.parametrize("seed", range(20))
def test_projection_on_a_cone_is_that_of_nonnegative_least_squares(seed):
    """min |y - b| s.t. A'y <= 0 is what remains of b by the best A x with x >= 0."""
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(8, 3 + seed)), rng.normal(size=8)
    A[:, 2] = 2 * A[:, 1]  # a constraint that is there twice
    y, x = quadratic_program(np.eye(8), -b, -A.T, np.zeros(3 + seed))
    assert y == pytest.approx(b - A @ x, abs=1e-12)
    assert x.min() >= 0
    assert np.linalg.norm(A @ x - b) == pytest.approx(nnls(A, b)[1], abs=1e-12)
    assert (A.T @ (b - A @ x)).max() < 1e-12


def test_quadratic_program_that_is_almost_linear_meets_its_active_constraints():
    g, A, b = np.array([0.003, 0.98, 2.0]), np.array([[0.1, 0, 0], [-4, 12.6, -39.5], [0.025, -0.105, 0.465]]), 1e-5
    d, weights = quadratic_program(1e-6 * np.eye(3), g, A, np.full(3, b))
    assert weights.min() > 0
    assert pytest.approx(-b, rel=1e-9) == A @ d
    assert weights == pytest.approx(np.linalg.solve(A.T, g), rel=1e-6)


def test_constraints_that_contradict_each_other_have_no_solution_however_flat_the_objective():
    rng = np.random.default_rng(0)
    for _ in range(50):
        axes = np.linalg.qr(rng.standard_normal((4, 4)))[0]
        H = (axes * np.array([1e-6, 1e-6, 1.0, 100.0])) @ axes.T
        a = rng.standard_normal(4)
        A, b = np.vstack([a, -a, rng.standard_normal((4, 4))]), np.array([-0.05, -0.05, 1, 1, 1, 1])
        assert quadratic_program(H, rng.standard_normal(4), A, b) is None


def arc_of(torque, by_torque, rate):
    """An arc of two seconds with one motor whose torque moves with one unknown."""
    ones = np.ones_like(torque)
    u, w = (
        DifferentiatedCurve(values=values, slopes=slopes[:, None], duration=2.0, stretch=np.zeros(1))
        for values, slopes in ((torque, by_torque * ones), (rate, 0 * ones))
    )
    return SimpleNamespace(torque=(u,), rate=(w,), ahead=u)


@pytest.mark.parametrize("d", [-0.3, 1e-3, 0.4])
def test_remainder_where_torque_and_rate_vanish_together_is_a_cube(d):
    s = curves.points(17)
    r = WorkRemainder([arc_of(s, 1.0, s)], np.ones(1)).at(np.array([d]))  # |s (s + d)|
    assert r[0] == pytest.approx(abs(d) ** 3 / 3, abs=1e-14)
    assert r[1] == pytest.approx(d * abs(d), abs=1e-14)
    assert r[2] == pytest.approx(2 * abs(d), rel=1e-9)


@pytest.mark.parametrize("d", [-0.1, 0.049, 0.051, 0.25])
def test_remainder_where_the_power_touches_zero_bends_by_a_root(d):
    s, size, height = curves.points(17), 0.5, 0.05
    arc = arc_of(s**2 + height, -1.0 / size, np.ones_like(s))  # |s^2 + height - d|
    r, deep = WorkRemainder([arc], np.array([size])).at(np.array([d])), max(d - height, 0.0)
    assert r[0] == pytest.approx(8 / 3 * deep**1.5, abs=1e-13)
    assert r[1] == pytest.approx(4 * np.sqrt(deep), abs=1e-11)
    assert r[2] == pytest.approx(2 / np.sqrt(deep) if deep else 0.0, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("depth", [1e-4, 1e-8, 1e-11])
def test_a_dip_through_zero_between_the_points_of_the_grid_is_seen(depth):
    s = curves.points(33)
    values = (s - 0.123456) ** 2 - depth
    assert curves.roots(values) == pytest.approx(0.123456 + np.array([-1, 1]) * np.sqrt(depth), abs=1e-9)
    assert curves.absolute_integral(values, 2.0) == pytest.approx(
        curves.integral(values, 2.0) + 8 / 3 * depth**1.5, abs=1e-14
    )


def test_least_radius_lies_where_multipliers_coalesce():
    gait = solved(load_problem("compass-torque-stable-slip").replace({"objective": "spectral_radius"}))
    assert gait.solver["kkt"] < 1e-9
    assert gait.solver["objective"] == pytest.approx(0.397744938962, rel=1e-9)
    assert gait.spectral_radius == pytest.approx(gait.solver["objective"], abs=1e-4)  # the root of rounding


@pytest.mark.slow
def test_a_point_beside_the_optimum_has_a_better_neighbour(stable_slip):
    beside = load_problem("compass-torque-stable-slip").replace({"constraints.spectral_radius": {"max": 0.499}})
    gait = solve(beside)
    searched = neighbourhood(replace(gait, problem=stable_slip.problem), directions=5, radii=(1e-3,))
    assert not searched.optimal


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "optimum"),
    [
        ("compass-torque-efficient", 0.003998052944),
        ("compass-minimum-friction", 0.111776031413),
        ("compass-torque-stable-slip", 0.019785783188),
        ("compass-torque-stable-slip-cheap", 0.0012905983475),
        ("compass-pd-designed", 0.005467319941),
        ("compass-pd-slippery", -0.460401971834),
    ],
)
def test_shipped_designs_are_optima_of_the_stated_problem(name, optimum):
    gait = solved(load_problem(name))
    assert gait.solver["kkt"] < 1e-6
    assert gait.solver["objective"] == pytest.approx(optimum, rel=1e-8)
    assert verify(gait).passed
    searched = neighbourhood(gait, directions=200)
    assert searched.feasible > 100
    assert searched.optimal, searched.summary


def test_quadratic_programs_of_flat_curvature_and_long_rows_are_solved_to_their_optimality_conditions():
    rng = np.random.default_rng(1)
    for _ in range(200):
        axes = np.linalg.qr(rng.standard_normal((5, 5)))[0]
        H = (axes * 10.0 ** rng.uniform(-6, 2, 5)) @ axes.T
        A = rng.standard_normal((12, 5)) * 10.0 ** rng.uniform(-1, 3, 12)[:, None]
        lengths = np.linalg.norm(A, axis=1)
        b, g = lengths * rng.choice([1e-6, 1e-2], 12) - A @ rng.uniform(-0.02, 0.02, 5), rng.standard_normal(5)
        d, weights = quadratic_program((H + H.T) / 2, g, A, b)  # which is feasible
        assert ((A @ d + b) / lengths).min() > -1e-8
        assert weights.min() >= 0
        assert np.abs(weights * (A @ d + b)).max() < 1e-9
        assert np.abs(H @ d + g - A.T @ weights).max() < 1e-9


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


@pytest.mark.parametrize(
    ("name", "free"),
    sampled(
        [
            ("rimless-wheel-slip", ()),
            ("compass-passive-a", ("friction",)),
            ("compass-torque-impact-slip", ("control.ankle", "walker.slope")),
            ("compass-pd-impact-slip", ("control.kp", "friction")),
        ],
        3,
    ),
)
def test_it_agrees_with_that_of_the_symbols_away_from_solutions_too(name: str, free: tuple[str, ...]) -> None:
    gait = named(name)
    solution = solution_of(gait, free)
    equations, w = solution.equations, solution.w
    w *= 1 + 1e-3 * np.random.default_rng(0).uniform(-1, 1, w.size)
    derivative = jacobian(equations.equalities, equations.w)
    symbolic = np.asarray(Function("J", [equations.w, equations.parameters], [derivative])(w, gait.p))
    values, found = equations.linearised(w, gait.p)
    assert values == pytest.approx(equations.violation(w, gait.p), rel=0, abs=1e-14)
    assert found.pattern.shape == symbolic.shape
    assert found.dense(0, w.size) == pytest.approx(symbolic, rel=0, abs=1e-12 * np.abs(symbolic).max())
