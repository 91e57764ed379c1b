"""Fronts and multi-start."""

import pytest

from gaitopt.errors import ProblemError
from gaitopt.problem import load_problem
from gaitopt.study.front import design_front
from gaitopt.study.grid import Axis
from gaitopt.study.jobs import Workers
from gaitopt.study.multistart import multistart


@pytest.fixture(scope="module")
def front():
    problem = load_problem("compass-torque-efficient").replace({"constraints": {"speed": {"min": 0.4}}})
    return design_front(problem, Axis(key="constraints.speed.min", lower=0.35, upper=0.45, count=3))


def test_every_point_of_a_front_is_verified(front):
    assert [point.value for point in front] == pytest.approx([0.35, 0.4, 0.45])
    assert all(point.gait.converged and point.gait.verification["passed"] for point in front)


def test_cost_rises_along_the_pareto_front(front):
    costs = [point.gait.solver["objective"] for point in front if point.pareto]
    assert costs == sorted(costs)
    assert len(costs) == 3


def test_front_without_objective_is_refused():
    with pytest.raises(ProblemError, match="needs an objective"):
        design_front(load_problem("rimless-wheel-slope"), Axis(key="friction", lower=0.3, upper=0.4, count=2))


def test_many_starts_find_one_optimum_and_depend_on_the_seed_alone():
    problem = load_problem("compass-torque-efficient")
    optima = multistart(problem, 3, seed=1, spread=0.1, workers=Workers(count=1))
    again = multistart(problem, 3, seed=1, spread=0.1, workers=Workers(count=1))
    assert len(optima[0].starts) >= 2
    assert [optimum.starts for optimum in optima] == [optimum.starts for optimum in again]
    assert optima[0].record["cost_of_transport"] == pytest.approx(0.00399805, rel=1e-4)
    assert optima[0].record["verification"]["passed"]
