"""Pseudo-arclength on curves whose shape is known."""

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from casadi import SX, Function, jacobian, vertcat

from gaitopt.branches.curve import RESIDUAL, Curve, CurvePoint, Metric
from gaitopt.solver.shooting import NaturalUnits
from gaitopt.solver.sparse import Pattern, SparseMatrix


@dataclass
class Planar:
    """F(x, v) = 0 in the place of a step's equations; v is the parameter."""

    residual: Function
    n_phases: int = 0
    w: SX = field(default_factory=lambda: SX.sym("w", 2))
    mesh: SimpleNamespace = field(default_factory=lambda: SimpleNamespace(cycle=SimpleNamespace(impact=None)))
    units: Callable[[np.ndarray], NaturalUnits] = lambda _: NaturalUnits(unknowns=np.ones(2), equalities=np.ones(1))
    system: SimpleNamespace = field(
        default_factory=lambda: SimpleNamespace(section=lambda _: SimpleNamespace(indices=np.array([0])))
    )

    def violation(self, w: np.ndarray, p: np.ndarray) -> np.ndarray:
        return self.linearised(w, p)[0]

    def linearised(self, w: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, SparseMatrix]:
        row = Pattern(shape=(1, 2), pointers=np.arange(3), rows=np.zeros(2, dtype=np.intp))
        value, slopes = (np.asarray(output).ravel() for output in self.residual(w, p))
        return value, SparseMatrix(pattern=row, data=slopes)


def planar(equation: str) -> Planar:
    x, v, p = SX.sym("x"), SX.sym("v"), SX.sym("p")
    expression = {"circle": x**2 + v**2 - 1, "cubic": v - x**3 + x}[equation]
    w = vertcat(x, v)
    return Planar(Function("residual", [w, p], [expression, jacobian(expression, w)]))


def curve_of(equation: str, scales: tuple[float, float]) -> Curve:
    problem, (x, v) = SimpleNamespace(replace=lambda _: None), scales
    return Curve(problem, "v", planar(equation), np.zeros(1), Metric(state=np.array([x]), period=1.0, span=v))


def walked(start: CurvePoint, length: float, count: int) -> list[CurvePoint]:
    points = [start]
    for _ in range(count):
        point = points[-1].step(length)
        assert point is not None
        points.append(point)
    return points


def test_a_circle_is_walked_round_through_both_of_its_folds() -> None:
    curve = curve_of("circle", (1.0, 1.0))
    start = curve.nearest(np.array([0.9, 0.3]), np.array([0.0, 1.0]))
    points = walked(start, 0.05, 130)
    w = np.array([point.at.w for point in points])
    assert np.abs(np.linalg.norm(w, axis=1) - 1).max() < RESIDUAL
    assert np.count_nonzero(np.diff(np.sign([point.tangent[-1] for point in points]))) == 2
    turned = np.unwrap(np.arctan2(w[:, 1], w[:, 0]))
    assert turned[-1] - turned[0] == pytest.approx(130 * np.arctan(0.05), rel=2e-3)


def test_the_tangent_has_unit_length_and_lies_in_the_kernel() -> None:
    curve = curve_of("cubic", (2.0, 0.5))
    for point in walked(curve.nearest(np.array([1.4, 1.4**3 - 1.4]), np.array([0.0, -1.0])), 0.05, 40):
        assert np.linalg.norm(curve.coordinates(point.tangent)) == pytest.approx(1, abs=1e-14)
        assert np.abs(point.at.jacobian @ point.tangent).max() < 1e-12


@pytest.mark.parametrize(("scale", "length", "count"), [(0.3, 0.01, 450), (1.0, 0.01, 150), (10.0, 0.01, 80)])
def test_scales_do_not_decide_where_a_fold_is(scale: float, length: float, count: int) -> None:
    curve = curve_of("cubic", (1.0, scale))
    start = curve.nearest(np.array([1.2, 1.2**3 - 1.2]), np.array([0.0, -1.0]))
    points = walked(start, length, count)
    turn = next(k for k, point in enumerate(points) if point.tangent[-1] > 0)
    assert points[turn].at.w[0] < 1 / np.sqrt(3) < points[turn - 1].at.w[0]
    assert points[turn].at.w[-1] == pytest.approx(-2 / 3**1.5, abs=2e-3)


def test_there_is_no_point_past_the_last_parameter() -> None:
    curve = curve_of("circle", (1.0, 1.0))
    start = curve.nearest(np.array([0.6, 0.8]), np.array([0.0, 1.0]))
    assert start.at_parameter(0.9).at.w == pytest.approx([np.sqrt(0.19), 0.9], abs=1e-12)
    assert start.at_parameter(1.1) is None
