"""A named gait stays itself when its parameters change."""

from dataclasses import replace

import pytest

from gaitopt import solve
from gaitopt.problem import load_problem, parse_problem
from gaitopt.search.own import follow, own_problem, solve_as_own


def test_the_long_gait_stays_long_on_a_steeper_slope():
    problem = load_problem("compass-passive-stick").replace({"walker.slope": "3deg", "friction": 0.4})
    assert solve(problem).spectral_radius > 1  # the short, unstable gait of another family
    gait = solve_as_own(problem)
    assert gait.measures["period"] == pytest.approx(0.7878093885, abs=1e-9)
    assert gait.spectral_radius < 1
    assert "followed from the gait of the problem's file" in gait.message


def test_where_the_family_ends_on_the_way_place_and_reason_are_stated():
    gait = solve_as_own(load_problem("compass-passive-stick").replace({"friction": 0.16}))
    assert not gait.converged
    assert "ends near friction = 0.1749" in gait.message
    assert "needs friction 0.1749" in gait.message


def test_a_direct_solution_that_is_close_is_taken_as_it_is():
    problem = load_problem("rimless-wheel-stick").replace({"walker.slope": "13.1deg"})
    assert solve_as_own(problem).message == "solved"


def test_following_arrives_at_the_gait_that_is_solved_directly():
    problem = load_problem("rimless-wheel-stick").replace({"walker.slope": "12deg"})
    gait, s, _ = follow(solve(load_problem("rimless-wheel-stick")), problem)
    assert s == 1
    assert gait.state == pytest.approx(solve(problem).state, abs=1e-10)


@pytest.mark.parametrize(
    "overrides",
    [{}, {"gait.phases": "auto"}, {"gait.phases": ["slip_forward", "stick"]}, {"impact_law": "frictionless"}],
)
def test_only_other_values_of_parameters_leave_the_file_its_own_gait(overrides):
    problem = load_problem("compass-passive-a")
    assert own_problem(problem.replace(overrides) if overrides else problem) is None


def test_a_problem_without_a_text_has_no_file_of_its_own():
    text = load_problem("compass-passive-a").text
    problem = parse_problem(text).replace({"friction": 0.13})
    assert own_problem(problem).friction == 0.14
    assert own_problem(replace(problem, text="")) is None
