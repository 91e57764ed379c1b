"""Pseudo-arclength on curves whose points, folds, cusps and crossings have closed forms."""

from dataclasses import dataclass

import numpy as np
import pytest
from casadi import SX, Function, jacobian, vertcat

from gaitopt.solver.arclength import (
    LONGEST_FIRST_STEP,
    RESIDUAL,
    Fixed,
    Point,
    SolutionCurve,
    corrected,
    extrapolation,
    located,
    next_length,
    predictions,
)
from gaitopt.solver.sparse import Pattern, SparseMatrix

pytestmark = pytest.mark.portable

x, a, v = (SX.sym(name) for name in "xav")
CURVES = {
    "circle": ((x, v), [x**2 + v**2 - 1]),
    "cubic": ((x, v), [v - x**3 + x]),
    "parabola": ((x, v), [v - x**2]),
    "lines": ((x, v), [v**2 - x**2]),
    "pitchfork": ((x, v), [x * (v - x**2)]),
    "folds of a cusp": ((x, a, v), [x**3 - a * x - v, 3 * x**2 - a]),  # both folds of x^3 - a x = v, as a moves
}


@dataclass
class Iterate:
    w: np.ndarray
    residual: np.ndarray
    jacobian: SparseMatrix


class Explicit:
    """Equations of a few unknowns, as the protocol of ``arclength`` demands."""

    def __init__(self, name: str) -> None:
        unknowns, rows = CURVES[name]
        w, values = vertcat(*unknowns), vertcat(*rows)
        self.function = Function("residual", [w], [values, jacobian(values, w)])
        self.unknown_units, self.equality_units = np.ones(w.numel()), np.ones(values.numel())

    def violation(self, w: np.ndarray) -> np.ndarray:
        return self.at(w).residual

    def at(self, w: np.ndarray) -> Iterate:
        values, slopes = (np.asarray(output.full()) for output in self.function(w))
        rows, columns = slopes.shape
        dense = Pattern(
            shape=(rows, columns),
            pointers=rows * np.arange(columns + 1),
            rows=np.tile(np.arange(rows), columns).astype(np.intp),
        )
        return Iterate(w, values.ravel(), SparseMatrix(pattern=dense, data=slopes.ravel(order="F")))


def curve_of(name: str, scales: tuple[float, ...] = (1.0, 1.0)) -> SolutionCurve[Iterate]:
    return SolutionCurve(Explicit(name), np.arange(len(scales)), np.array(scales))


def walked(curve: SolutionCurve[Iterate], start: Point[Iterate], length: float, count: int) -> list[Point[Iterate]]:
    points = [start]
    for _ in range(count):
        point = curve.step(points[-1], length)
        assert point is not None
        points.append(point)
    return points


def test_a_circle_is_walked_round_through_both_of_its_folds() -> None:
    curve = curve_of("circle")
    points = walked(curve, curve.nearest(np.array([0.9, 0.3]), np.array([0.0, 1.0])), 0.05, 130)
    w = np.array([point.at.w for point in points])
    assert np.abs(np.linalg.norm(w, axis=1) - 1).max() < RESIDUAL
    assert np.count_nonzero(np.diff(np.sign([point.tangent[-1] for point in points]))) == 2
    turned = np.unwrap(np.arctan2(w[:, 1], w[:, 0]))
    assert turned[-1] - turned[0] == pytest.approx(130 * np.arctan(0.05), rel=2e-3)


def test_the_tangent_has_unit_length_and_lies_in_the_kernel() -> None:
    curve = curve_of("cubic", (2.0, 0.5))
    start = curve.nearest(np.array([1.4, 1.4**3 - 1.4]), np.array([0.0, -1.0]))
    for point in walked(curve, start, 0.05, 40):
        assert np.linalg.norm(curve.coordinates(point.tangent)) == pytest.approx(1, abs=1e-14)
        assert np.abs(point.at.jacobian @ point.tangent).max() < 1e-12


@pytest.mark.parametrize(
    ("scale", "length", "count"),
    [pytest.param(0.3, 0.01, 450, marks=pytest.mark.slow), (1.0, 0.01, 150), (10.0, 0.01, 80)],
)
def test_scales_do_not_decide_where_a_fold_is(scale: float, length: float, count: int) -> None:
    curve = curve_of("cubic", (1.0, scale))
    points = walked(curve, curve.nearest(np.array([1.2, 1.2**3 - 1.2]), np.array([0.0, -1.0])), length, count)
    turn = next(k for k, point in enumerate(points) if point.tangent[-1] > 0)
    before = points[turn - 1]
    fold = located(
        before, points[turn], length, lambda part: curve.step(before, part), lambda point: float(point.tangent[-1])
    )
    assert fold.status == "converged"
    assert fold.point.at.w == pytest.approx([1 / np.sqrt(3), -2 / 3**1.5], abs=1e-11)


def test_there_is_no_point_past_the_last_parameter() -> None:
    curve = curve_of("circle")
    start = curve.nearest(np.array([0.6, 0.8]), np.array([0.0, 1.0]))
    assert curve.at_parameter(start, 0.9).at.w == pytest.approx([np.sqrt(0.19), 0.9], abs=1e-12)
    assert curve.at_parameter(start, 1.1) is None


def test_folds_in_two_parameters_go_through_their_cusp_where_the_second_one_turns_back() -> None:
    curve = curve_of("folds of a cusp", (1.0, 1.0, 1.0))
    start = curve.nearest(np.array([-0.8, 3 * 0.8**2, 2 * 0.8**3]), np.array([0.0, 0.0, -1.0]))
    points = walked(curve, start, 0.02, 200)
    for point in points:
        s = point.at.w[0]
        assert point.at.w == pytest.approx([s, 3 * s**2, -2 * s**3], abs=1e-12)
    k = next(k for k, point in enumerate(points) if point.at.w[0] > 0)
    before = points[k - 1]
    cusp = located(
        before, points[k], 0.02, lambda part: curve.step(before, part), lambda point: float(point.tangent[1])
    )
    assert cusp.point.at.w == pytest.approx(np.zeros(3), abs=1e-11)


@pytest.mark.parametrize(
    ("name", "along", "across"), [("lines", (1.0, 1.0), (1.0, -1.0)), ("pitchfork", (0.0, 1.0), (1.0, 0.0))]
)
def test_the_other_branch_through_a_crossing_is_found_on_both_sides(name, along, across):
    curve = curve_of(name)
    located_point = np.full(2, 1e-10)  # at the crossing itself the bordered matrix is singular
    direction = curve.crossing(located_point, np.array(along) / np.linalg.norm(along))
    assert direction / np.sign(direction[0]) == pytest.approx(np.array(across) / np.linalg.norm(across), abs=1e-9)
    for sign in (-1.0, 1.0):
        begun = curve.beside(np.zeros(2), direction, sign * 1e-2)
        s = begun.at.w[0]
        assert begun.at.w == pytest.approx([s, -s if name == "lines" else s**2], abs=1e-14)
        assert s * direction[0] * sign == pytest.approx(1e-2 * direction[0] ** 2, rel=1e-3)


def test_no_branch_crosses_at_a_regular_point() -> None:
    curve = curve_of("circle")
    assert curve.crossing(np.array([0.6, 0.8]), np.array([-0.8, 0.6])) is None


def test_a_correction_with_fixed_parameters_is_near_only_if_its_steps_halve() -> None:
    system = Fixed(Explicit("parabola"))
    for start, is_near in ((1.1, True), (0.7, False), (20.0, False)):  # roots 1 and -1 of v = 1
        end = corrected(system, np.array([start, 1.0]), slow=0.0)
        assert end.at.w == pytest.approx([1.0, 1.0], abs=1e-15)
        assert end.is_near is is_near
    assert LONGEST_FIRST_STEP < (1.0 - 0.7**2) / (2 * 0.7)
    assert corrected(system, np.array([0.3, -1.0])) is None  # no root


def test_a_chord_that_contracts_slowly_is_replaced() -> None:
    equations = Explicit("parabola")
    system = Fixed(equations)
    start, counts = np.array([1.001, 1.0]), []
    for at in (1.0, 1.1, 3.0):
        end = corrected(system, start, system.matrix(equations.at(np.array([at, 1.0]))))
        assert end.at.w[0] == pytest.approx(1.0, abs=1e-13)
        counts.append(end.iterations)
    exact, chord, replaced = counts
    assert exact < replaced < chord  # quadratic convergence after a slow step, linear convergence with a fair chord


class EndingAtOne(Explicit):
    """Equations without a derivative at x = 1, as a condition has none where the return map is not finite."""

    error: type[Exception]

    def violation(self, w: np.ndarray) -> np.ndarray:
        return super().at(w).residual

    def at(self, w: np.ndarray) -> Iterate:
        if w[0] == pytest.approx(1.0, abs=1e-9):
            raise self.error("not finite")
        return super().at(w)


@pytest.mark.parametrize("error", [RuntimeError, np.linalg.LinAlgError])
def test_a_solution_without_a_derivative_is_no_correction(error, monkeypatch) -> None:
    monkeypatch.setattr(EndingAtOne, "error", error, raising=False)
    system, there, before = Fixed(EndingAtOne("parabola")), np.array([1.001, 1.0]), np.array([0.501, 0.25])
    assert corrected(system, there) is None
    assert corrected(system, before).at.w[0] == pytest.approx(0.5, abs=1e-13)


def test_where_a_step_fails_the_last_point_before_the_zero_is_a_guess() -> None:
    found = located(0.0, 1.0, 1.0, lambda part: part if part < 0.4 else None, lambda point: 0.5 - point)
    assert (found.length, found.point, found.status) == (0.0, 0.0, "guess")
    found = located(0.0, 1.0, 1.0, lambda part: part, lambda point: 0.5 - point**3)
    assert found.point == pytest.approx(0.5 ** (1 / 3), abs=1e-12)
    assert found.status == "converged"


def test_a_step_grows_after_few_iterations_and_shrinks_after_many() -> None:
    assert [next_length(1.0, iterations) for iterations in (1, 5, 6, 8, 9)] == [2.0, 2.0, 1.0, 1.0, 0.5]


@pytest.mark.parametrize("slopes", [False, True])
@pytest.mark.parametrize("places", [[0.0], [0.0, -0.1], [0.0, -1e-5, -3e-5], [0.0, -2.0, 1.5]])
def test_polynomials_are_continued_exactly(places: list[float], slopes: bool) -> None:
    degree = len(places) * (1 + slopes) - 1
    unit = np.abs(places).max() or 1e-3
    coefficients = np.random.default_rng(3).standard_normal(degree + 1)
    curve = np.polynomial.Polynomial(coefficients, window=[-1, 1], domain=[-unit, unit])
    ahead = 0.3 * unit if len(places) > 1 else unit
    values, rates = ([np.array([function(place)]) for place in places] for function in (curve, curve.deriv()))
    first = next(predictions(places, values, ahead, rates if slopes else ()))
    assert first == pytest.approx([curve(ahead)], rel=1e-9)


def test_too_far_ahead_there_is_no_extrapolation() -> None:
    assert extrapolation([0.0, -1e-3, -2e-3], 1.0) is None
    assert extrapolation([0.0, 0.0], 1.0) is None
    values = [np.array([1.0]), np.array([2.0]), np.array([5.0])]
    assert list(predictions([0.0, -1e-3, -2e-3], values, 1.0)) == [values[0]]  # the last solution itself
