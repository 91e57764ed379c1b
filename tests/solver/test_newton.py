"""Newton's method alone finds the gait that IPOPT finds, and fails where the guess is not near one; its predictor."""

from dataclasses import replace

import numpy as np
import pytest

import gaitopt as go
from gaitopt.model.dynamics import Dynamics
from gaitopt.solver import newton, solve
from gaitopt.solver.newton import LONGEST_FIRST_STEP, solve_nearby
from gaitopt.solver.rollout import roll_out
from gaitopt.solver.solve import solve_gait
from gaitopt.systems import build_system

NAMES = (
    "compass-passive-a",
    "compass-passive-two-step",
    "compass-torque-slip",
    "compass-pd-impact-slip",
    "rimless-wheel-slip",
)


def prepared(name):
    problem = go.load_problem(name)
    system = build_system(problem)
    p = system.values(problem.parameters)
    state = np.array([problem.guess.state[key] for key in system.state_names])
    return roll_out(Dynamics(system, p), problem.cycle, state).on_mesh()


@pytest.mark.portable
@pytest.mark.parametrize("name", NAMES)
def test_gait_is_that_of_ipopt_without_ipopt(name, monkeypatch):
    problem = go.load_problem(name)
    system = build_system(problem)
    with monkeypatch.context() as patched:
        patched.setattr(solve, "solved", None)
        near = solve_gait(problem, system)
    monkeypatch.setattr(newton, "LONGEST_FIRST_STEP", 0.0)
    searched = solve_gait(problem, system)
    assert near.converged
    assert searched.converged
    np.testing.assert_allclose(near.state, searched.state, rtol=0, atol=1e-11)
    np.testing.assert_allclose(near.period, searched.period, rtol=0, atol=1e-11)


def test_solution_is_within_twice_the_longest_first_step():
    start = prepared("compass-passive-a")
    found = solve_nearby(start)
    assert found.converged
    assert np.abs((found.w - start.w) / start.units.unknowns).max() <= 2 * LONGEST_FIRST_STEP
    assert found.size < 1e-12


@pytest.mark.parametrize("scale", [0.3, 3.0, 1e3])
def test_start_that_is_not_near_a_gait_is_left_to_ipopt(scale):
    start = prepared("compass-passive-a")
    away = np.random.default_rng(3).normal(scale=scale, size=start.w.size)
    assert not solve_nearby(replace(start, w=start.w + away)).converged


def test_feet_that_stay_together_are_no_solution_nearby():
    start = prepared("rimless-wheel-stick")
    short = start.w.copy()
    short[-1] *= 1e-3
    assert not solve_nearby(replace(start, w=short)).converged


def test_gait_that_violates_a_margin_is_searched_by_ipopt():
    problem = go.load_problem("compass-passive-stick").replace({"friction": 0.05})
    gait = solve_gait(problem, build_system(problem))
    assert not gait.converged
    assert "friction" in {cause.what for cause in gait.causes}


def test_request_to_stop_ends_it_at_once():
    assert not solve_nearby(prepared("compass-passive-a"), should_stop=lambda: True).converged


def test_problems_that_differ_in_values_share_their_system():
    problem = go.load_problem("compass-torque-slip")
    other = problem.replace({"friction": 0.2, "control.hip": 0.5})
    assert build_system(other) is build_system(problem)
    assert build_system(problem.replace({"impact_law": "frictionless"})) is not build_system(problem)
