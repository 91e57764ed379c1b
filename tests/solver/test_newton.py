"""Newton's method alone finds the gait that IPOPT finds, and fails where the guess is not near one; its predictor."""

from dataclasses import replace

import numpy as np
import pytest

import gaitopt as go
from gaitopt.model.dynamics import Dynamics
from gaitopt.solver.newton import LONGEST_FIRST_STEP, solve_nearby
from gaitopt.solver.rollout import roll_out
from gaitopt.systems import build_system


def prepared(name):
    problem = go.load_problem(name)
    system = build_system(problem)
    p = system.values(problem.parameters)
    state = np.array([problem.guess.state[key] for key in system.state_names])
    return roll_out(Dynamics(system, p), problem.cycle, state).on_mesh()


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
