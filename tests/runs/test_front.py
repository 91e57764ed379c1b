"""Fronts and multi-start."""

from pathlib import Path

import pytest

from gaitopt import load_problem, load_run
from gaitopt.errors import ProblemError
from gaitopt.runs import jobs as solved
from gaitopt.runs.front import FrontPlan
from gaitopt.runs.grid import Axis
from gaitopt.runs.multistart import StartsPlan
from gaitopt.systems import build_system
from gaitopt.workers.jobs import Workers

AXIS = Axis(key="constraints.speed.min", lower=0.4, upper=0.45, count=2)


def design_problem():
    return load_problem("compass-torque-efficient").replace({"constraints": {"speed": {"min": 0.4}}})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("front")


@pytest.fixture(scope="module")
def front(folder):
    return FrontPlan(problem=design_problem(), axis=AXIS, folder=folder).complete()


def test_every_point_of_a_front_is_verified_and_cost_rises_along_it(front):
    assert [point.value for point in front] == pytest.approx([0.4, 0.45])
    assert all(point.converged and point.gait["verification"]["passed"] for point in front)
    costs = [point.to_record()["objective"] for point in front if point.pareto]
    assert costs == sorted(costs)
    assert len(costs) == 2


def test_front_resumes_where_it_stopped_comes_back_from_its_folder_and_is_drawn_again(
    front, folder, run, tmp_path, monkeypatch
):
    monkeypatch.setattr(solved, "solve_job", None)  # nothing is left to do
    again = FrontPlan(problem=design_problem(), axis=AXIS, folder=folder).complete()
    records = [point.to_record() for point in front]
    assert [point.to_record() for point in again] == [point.to_record() for point in load_run(folder)] == records
    code, out, _ = run("plot", str(folder), "--format", "svg", "-o", str(tmp_path / "drawn"))
    assert (code, out.strip()) == (0, str(tmp_path / "drawn" / "front-constraints.speed.min.svg"))
    code, _, err = run("report", str(folder))
    assert code == 6
    assert "holds a front, but no gait" in err


@pytest.mark.slow
def test_many_starts_find_one_optimum_and_depend_on_the_seed_alone(tmp_path):
    problem = design_problem()
    here = Workers(count=1)
    optima = StartsPlan(problem=problem, starts=2, folder=tmp_path, seed=1, spread=0.1).complete(here)
    again = StartsPlan(problem=problem, starts=2, folder=tmp_path / "again", seed=1, spread=0.1).complete(here)
    assert optima[0].starts == (0, 1)
    assert [optimum.to_record() for optimum in optima] == [optimum.to_record() for optimum in again]
    assert optima[0].objective == pytest.approx(0.00399805, rel=1e-4)
    assert optima[0].verified


def test_samples_of_a_free_curve_change_its_points_within_their_bound():
    problem = load_problem("compass-pd-slippery")
    plan = StartsPlan(problem=problem, starts=3, folder=Path(), seed=3, spread=0.5)
    _, first, second = plan.sampled()
    points = [p.control.reference.curve.points for p in (first, second)]
    assert points[0] != points[1]
    assert set(points[0]) == {"theta1", "theta2"}
    assert all(abs(c) <= 0.6 for p in points for row in p.values() for c in row)
    assert build_system(first).control.reference.motion().points == points[0]
    assert [p.digest for p in plan.sampled()] == [problem.digest, first.digest, second.digest]


def test_control_points_of_other_joints_are_named():
    with pytest.raises(ProblemError, match="are given for theta1; the tracked joints are theta1, theta2"):
        load_problem("compass-pd-slippery").replace({"control.reference.curve.points": {"theta1": [0.0] * 7}})
