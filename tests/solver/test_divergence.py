"""Attempts that diverge end as data; as warnings are errors here, they do so in silence."""

from functools import cache

import numpy as np
import pytest
from named import named
from numpy.typing import NDArray

from gaitopt import Family, Gait
from gaitopt.branches.curve import Curve, Metric
from gaitopt.design.spectral_radius import certified_radius
from gaitopt.solver.assembly import solution_of
from gaitopt.solver.newton import Solution, polish, refine, solve_nearby
from gaitopt.solver.shooting import MultipleShooting
from gaitopt.solver.sparse import Pattern, ScaledMatrix, SparseMatrix

pytestmark = pytest.mark.portable

FAR = [1e30, 1e100, 1e160, 1e300]


@cache
def gait() -> Gait:
    return named("rimless-wheel-slip")


@cache
def unknowns(free: tuple[str, ...] = ()) -> tuple[MultipleShooting, NDArray[np.float64]]:
    """The gait's equations, and the solution."""
    solution = solution_of(gait(), free)
    return solution.equations, solution.w


@pytest.mark.parametrize("far", FAR)
def test_no_step_along_a_curve_ends_far_from_it(far: float) -> None:
    equations, w = unknowns(("friction",))
    metric = Metric(state=np.ones(gait().system.n_z), period=1.0, span=1.0)
    curve = Curve(gait().problem, "friction", equations, gait().p, metric)
    point = curve.start(w, curve.solutions.ahead(1.0))
    assert point is not None
    assert point.step(far) is None
    assert curve.start(w + far, point.direction) is None


@pytest.mark.parametrize("far", FAR)
def test_what_is_polished_far_from_a_gait_is_none(far: float) -> None:
    equations, w = unknowns()
    refined = refine(polish(Solution(equations, w * far, gait().p)))
    assert not refined.size < 1
    assert not refined.accurate


@pytest.mark.parametrize("far", FAR)
def test_newtons_method_finds_nothing_from_far_away(far: float) -> None:
    equations, w = unknowns()
    assert not solve_nearby(Solution(equations, w * far, gait().p)).converged


@pytest.mark.parametrize("far", FAR)
def test_radius_of_a_motion_that_diverges_is_undefined(far: float) -> None:
    equations, w = unknowns()
    radius = certified_radius(equations)
    assert not float(radius(w * far, gait().p)) < 1
    assert float(radius(w, gait().p)) < 1


def test_family_says_that_there_is_no_gait_where_its_chords_diverge() -> None:
    problem = gait().problem.replace({"walker.gravity": 1e12})
    assert not Family(gait()).solve(problem).converged


@pytest.mark.parametrize("entry", [np.inf, np.nan, 0.0])
def test_matrix_without_factors_is_refused(entry: float) -> None:
    diagonal = Pattern(shape=(2, 2), pointers=np.arange(3), rows=np.arange(2))
    matrix = ScaledMatrix(SparseMatrix(pattern=diagonal, data=np.array([1.0, entry])), np.ones(2), np.ones(2))
    with pytest.raises(RuntimeError):
        matrix.solve(np.ones(2))
