"""Designs: free parameters, objectives, constraints; each optimum against an independent road."""

import json
from dataclasses import replace

import numpy as np
import pytest
from named import named, solved, verified
from samples import sampled

from gaitopt import simulate, solve, verify
from gaitopt.errors import ProblemError
from gaitopt.gait.gait import Status
from gaitopt.model.curve import BeyondEnd, control_points
from gaitopt.model.transitions import Ending
from gaitopt.problem.problem import load_problem, parse_problem
from gaitopt.systems import build_system

FREE_TORQUES = {"control.ankle": {"free": [-5, 5], "guess": 1.0}, "control.hip": {"free": [-5, 5], "guess": 0.27}}
CHEAPEST = {"objective": "cost_of_transport", "constraints": {"speed": 0.55}}


def sticking(asked, **changes):
    return load_problem("compass-torque-stick").replace({**FREE_TORQUES, **asked, **changes})


@pytest.fixture(scope="module")
def cheapest():
    return solve(sticking(CHEAPEST))


def test_a_design_is_a_verified_gait_that_meets_its_constraint_to_rounding_and_has_no_cheaper_neighbour(cheapest):
    assert cheapest.converged, cheapest.message
    assert cheapest.measures["speed"] == pytest.approx(0.55, abs=1e-9)
    assert cheapest.shooting.residual < 1e-13
    assert cheapest.shooting.errors.max() < 1e-12
    assert set(cheapest.freed) == set(FREE_TORQUES)
    assert verify(cheapest).passed
    for hip in (0.27, 0.29):
        other = solved(sticking({"constraints": {"speed": 0.55}, "control.hip": hip}))
        assert other.measures["cost_of_transport"] > cheapest.measures["cost_of_transport"]


@pytest.mark.parametrize("guess", [0.7, 1.2, 1.5])
def test_optimum_does_not_depend_on_the_guess(cheapest, guess):
    guesses = {
        f"control.{motor}": {"free": [-5, 5], "guess": value}
        for motor, value in (("ankle", guess), ("hip", 0.3 * guess))
    }
    again = solve(sticking(CHEAPEST, **guesses))
    assert again.solver["objective"] == pytest.approx(cheapest.solver["objective"], rel=1e-7)


@pytest.mark.parametrize(
    ("objective", "scalar", "sense"),
    sampled(
        [
            ("peak_torque", "peak_torque", 1),
            ("torque_squared", "torque_squared", 1),
            ({"foot_clearance": -1}, "foot_clearance", -1),
            ({"min_normal_force": -1}, "min_normal_force", -1),
            ("absolute_cost_of_transport", "absolute_cost_of_transport", 1),
            ("impulse_ratio", "impulse_ratio", 1),
            ("required_friction", "required_friction", 1),
            ("period", "period", 1),
            ({"step_length": -1}, "step_length", -1),
            ("work", "work", 1),
        ],
        3,
    ),
)
def test_objective_is_the_scalar_that_is_reported(objective, scalar, sense):
    gait = solved(sticking({"objective": objective, "constraints": {"speed": {"min": 0.5, "max": 0.6}}}))
    assert sense * gait.solver["objective"] == pytest.approx(gait.measures[scalar], rel=1e-6, abs=1e-10)


@pytest.mark.slow
def test_a_design_at_the_edge_of_a_sticking_impact_slips_in_the_simulator_too():
    gait = verified(load_problem("compass-pd-slippery").replace({"impact_law": "frictionless"}))
    ratio, friction = gait.measures["impulse_ratio"], gait.dynamics.static_friction
    assert friction < ratio < friction * (1 + 1e-8)  # with less an impact sticks, which takes precedence
    assert "an impact that sticks, which takes precedence" in gait.message


@pytest.mark.parametrize("speed", [0.45, 0.46])
def test_design_at_the_edge_of_the_cone_is_walked_by_the_simulator(speed):
    gait = solved(load_problem("compass-torque-efficient").replace({"constraints": {"speed": {"min": speed}}}))
    assert gait.measures["required_friction"] == pytest.approx(0.12, abs=1e-8)
    assert verify(gait).passed


def test_gains_of_a_reference_are_unknowns_like_any_other():
    free = {f"control.{key}": {"free": [1, 100], "guess": 15} for key in ("kp", "kd")}
    asked = {"objective": "absolute_cost_of_transport", "constraints": {"state.dx": {"min": 0.2}}}
    gait = solved(load_problem("compass-pd-impact-slip").replace(free | asked))
    assert gait.measures["absolute_cost_of_transport"] < 0.01085  # gait III: 0.01475
    assert verify(gait).passed


def test_slope_for_a_given_speed_has_it_and_least_friction_is_what_the_sticking_gait_requires():
    slope = named("rimless-wheel-slope").freed["walker.slope"]
    fixed = solve(load_problem("rimless-wheel-slip").replace({"walker.slope": slope}))
    assert fixed.measures["speed"] == pytest.approx(0.8, abs=1e-9)
    gait = named("compass-minimum-friction")
    required = max(gait.measures["required_friction"], gait.measures["impulse_ratio"])
    assert gait.freed["friction"] == pytest.approx(required, abs=1e-8)


def test_infeasible_design_names_constraint_obstacle_and_best_reached():
    bounded = {"control.ankle": {"free": [-5, 1], "guess": 0.9}}
    gait = solve(sticking({"objective": "cost_of_transport", "constraints": {"speed": {"min": 0.8}}}, **bounded))
    assert gait.status is Status.INFEASIBLE
    assert not gait.steps
    assert "speed >= 0.8 conflicts with" in gait.message
    assert "control.ankle <= 1" in gait.message
    assert "best reached 0.55" in gait.message


def test_warm_start_finds_the_same_optimum_but_an_attempt_without_a_point_is_no_start(cheapest):
    asked = CHEAPEST | {"constraints": {"speed": 0.56}}
    warm, cold = solve(sticking(asked), start=cheapest), solve(sticking(asked))
    assert warm.solver["objective"] == pytest.approx(cold.solver["objective"], rel=1e-8)
    lost = replace(cheapest, status=Status.NOT_CONVERGED, message="lost", steps=())
    with pytest.raises(ProblemError, match="start: compass-torque-stick is not_converged: lost"):
        solve(cheapest.problem, start=lost)


@pytest.mark.parametrize("beyond_end", [BeyondEnd.LINEAR, BeyondEnd.HOLD, BeyondEnd.OFF])
def test_every_control_point_of_a_free_curve_is_an_unknown(beyond_end):
    text = load_problem("compass-pd-designed").text.replace("beyond_end: linear", f"beyond_end: {beyond_end}")
    head, _, _ = text.partition("objective:")
    system = build_system(parse_problem(head + "objective: torque_squared\nconstraints: {speed: {min: 0.3}}\n"))
    assert [*map(len, system.control.reference.motion().points.values())] == [7, 7]
    assert len(system.control.unknowns(system.walker)) == 14


def test_bezier_fit_reproduces_a_polynomial_of_its_degree():
    phases = np.linspace(0, 1, 30)
    points, errors = control_points(phases, np.vstack([phases**3 - phases, 2 * phases]), 4)
    assert errors.max() < 1e-13
    assert np.allclose(points[1], np.linspace(0, 2, 5))
    assert np.allclose(points[:, [0, -1]], [[0, 0], [0, 2]])


@pytest.mark.slow
def test_designed_reference_answers_the_open_problem():
    gait = named("compass-pd-designed")
    assert gait.state[-1] >= 0.1 - 1e-8
    assert gait.measures["step_length"] >= 0.311 - 1e-8
    assert gait.measures["speed"] >= 0.40
    assert gait.measures["cost_of_transport"] <= 0.00565 + 1e-8
    assert gait.spectral_radius <= 0.5 + 1e-7
    assert max(abs(v) for k, v in gait.freed.items() if "reference" in k) <= 0.6 + 1e-9
    rng, section, returned = np.random.default_rng(0), gait.system.section(gait.cycle), 0
    for _ in range(100):  # from states perturbed by up to 5 %
        state = gait.state[section.indices] * (1 + 0.05 * rng.uniform(-1, 1, len(section.names)))
        walk = simulate(gait, dict(zip(section.names, state, strict=True)), steps=40).trajectory
        back = walk.ending is Ending.COMPLETED
        returned += back and np.abs(walk.section_states[-1] - gait.state)[section.indices].max() < 1e-6
    assert returned >= 95


@pytest.mark.slow
@pytest.mark.parametrize(
    ("objective", "numbers", "least"),
    [
        ("peak_torque", (0.442, 0.152, 0.0066), 0.477464872643),
        ("required_friction", (0.351, 0.268, 0.0034), 0.0926491062422),
        ("torque_squared", (0.488, 0.598, 0.0063), 0.379408927456),
        ("required_friction", (0.44, 0.419, 0.0005), 0.112401970918),
    ],
)
def test_an_optimum_is_reached_although_gaits_end_on_the_way(objective, numbers, least):
    """From these guesses the smoothed problem is solved next to a fold, where the gaits of the family end."""
    speed, friction, clearance = numbers
    guesses = {"control.ankle": {"free": [-2, 3], "guess": 0.76}, "control.hip": {"free": [-2, 3], "guess": 0.2}}
    constraints = {"speed": speed, "foot_clearance": {"min": clearance}}
    gait = solved(sticking({"objective": objective, "constraints": constraints}, friction=friction, **guesses))
    assert gait.measures[objective] == pytest.approx(least, rel=1e-10)


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """A design that was stopped after a few iterations, and its run folder."""
    polls, folder = iter(range(100)), tmp_path_factory.mktemp("stopped") / "run"
    gait = solve("compass-torque-efficient", output=folder, should_stop=lambda: next(polls) > 10)
    assert gait.status is Status.INTERRUPTED
    return gait, folder


@pytest.mark.slow
def test_a_design_that_fails_keeps_the_point_where_it_ended_and_goes_on_from_it(stopped):
    gait, _ = stopped
    assert {*gait.best["parameters"]} == {"control.ankle", "control.hip"}
    goes_on = solved(gait.problem.replace({"constraints.speed": 0.41}), start=gait)
    assert goes_on.measures["speed"] == pytest.approx(0.41)
    guess = gait.problem.with_guess(gait.best)
    assert guess.free["control.hip"].guess == gait.best["parameters"]["control.hip"]


def test_the_point_is_in_the_run_folder_and_start_names_it(stopped, monkeypatch, run):
    folder = stopped[1]
    monkeypatch.chdir(folder.parent)
    code, out, err = run("solve", "compass-torque-efficient", "--start", str(folder), "-o", "after", "--json")
    assert code == 0
    assert "where the design ended" in err
    assert json.loads(out)["status"] == "converged"
