"""Periodic solutions of the equations that no walker can move through: infeasible, with the cause and its time."""

import casadi as ca
import numpy as np
import pytest

import gaitopt as go
from gaitopt.search.solve import solve

COMPASS = """
name: driven-compass
walker: {model: compass_biped, leg_length: 1, leg_mass: 5, leg_com: 0.5, hip_mass: 10, gravity: 9.81, slope: %s}
friction: %s
control: {type: pd, kp: %s, kd: %s, reference: {bezier: {theta1: %s, theta2: %s}, duration: %s, beyond_end: linear}}
gait: {phases: [stick], impact: stick, guess: {state: {theta1: %s, dtheta1: %s, dtheta2: %s}}}
"""
BACKWARD = (
    "0", 4, 1939.39, 105.692, [0.2997, 0.1596, -0.2223, -0.2997], [0.2997, 0.4685, 0.3056, -0.2997], 0.639178,
    0.299703, -0.65762, 0.792037,
)  # fmt: skip
TWICE = (
    "0", 4, 1078.13, 71.1454, [0.3346, 0.2138, -0.2571, -0.3346], [0.3346, 0.5784, -0.0671, -0.3346], 0.768574,
    0.334616, -0.471687, 0.951378,
)  # fmt: skip
FORWARD = (
    "3 deg", 1.5, 1243.03, 53.8358, [-0.2315, 0.2634, -0.1665, 0.2315], [-0.2315, -0.5776, 0.6150, 0.2315], 1.15455,
    -0.231544, 1.28611, -0.899243,
)  # fmt: skip


def driven(numbers: tuple[object, ...]) -> go.Problem:
    return go.parse_problem(COMPASS % numbers)


def test_a_swing_foot_that_comes_up_through_the_ground_does_not_land():
    """In a step backward the legs have opposite angles where the foot rises; the simulator says the same."""
    gait = solve(driven(BACKWARD))
    assert gait.status is go.Status.INFEASIBLE
    (cause,) = gait.causes
    assert cause.what == "landing"
    assert cause.available > 0
    assert cause.time == pytest.approx(0.664, abs=1e-3)
    assert "touches the ground from below, 0.6640 s after the impact" in gait.message


def test_a_foot_that_rises_for_an_instant_lands_when_it_falls_again():
    gait = solve(driven(TWICE))
    assert gait.status is go.Status.INFEASIBLE
    assert gait.causes[0].what == "touchdown"
    assert gait.causes[0].time == pytest.approx(0.00408, abs=1e-4)


def test_friction_that_lacks_between_the_nodes_is_noticed():
    """The largest friction that the gait needs lies between two nodes, each of which needs less than there is."""
    gait = solve(driven(FORWARD))
    needed = gait.measures["required_friction"]
    enough = solve(driven(FORWARD).replace({"friction": needed * (1 + 1e-6)}).from_guess())
    assert enough.converged
    lacking = solve(driven(FORWARD).replace({"friction": needed * (1 - 1e-6)}).from_guess())
    assert lacking.status is go.Status.INFEASIBLE
    assert lacking.causes[0].what == "cone_forward"
    assert lacking.causes[0].time == pytest.approx(0.396, abs=2e-3)


@pytest.mark.parametrize("turned", [np.pi, pytest.param(-np.pi, marks=pytest.mark.slow)])
def test_a_torso_that_hangs_between_the_legs_is_not_upright(turned: float):
    problem = go.load_problem("torso-passive").replace({"walker.hip_stiffness": 0})
    nlp = go.nlp(problem)
    postures = nlp.unpack(nlp.x0)
    hanging = nlp.pack({"torso": 0 * postures["torso"] + turned, "dtorso": 0 * postures["dtorso"]})
    quiet = {"ipopt": {"print_level": 0, "sb": "yes"}, "print_time": False}
    end = ca.nlpsol("solver", "ipopt", nlp.casadi(), quiet)(**nlp.arguments() | {"x0": hanging})
    gait = nlp.gait(end["x"])
    assert gait.status is go.Status.INFEASIBLE
    assert gait.message == "the walker is no longer upright, about 0.0000 s after the impact"
    assert gait.causes[0].time == 0
