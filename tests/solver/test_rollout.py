"""First guesses: from a state that may not walk, or from a step's length and time alone."""

import re

import numpy as np
import pytest
from named import named
from refusals import refusal

import gaitopt as go
from gaitopt import Cycle, Mode
from gaitopt.model.control import NoControl
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import MARGINS
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.solver.diagnosis import missing_event
from gaitopt.solver.rollout import roll_out
from gaitopt.systems import solve_sequence


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("compass-passive-stick", {"walker.leg_length": 0.8, "walker.leg_com": 0.4}),
        ("compass-passive-stick", {"walker.leg_length": 1.0, "walker.leg_com": 0.5}),
        ("compass-passive-stick", {"walker.hip_mass": 10}),
        ("compass-passive-b", {"friction": 0.3}),
        ("rimless-wheel-stick", {"gait.guess.state.dtheta": -0.3}),
        ("rimless-wheel-stick", {"gait.guess.state.dtheta": 0.0}),
    ],
)
def test_guess_that_does_not_walk_still_leads_to_a_gait(name, overrides):
    gait = go.solve(go.load_problem(name).replace({"friction": 1.0} | overrides))
    assert gait.converged, gait.message
    assert go.verify(gait).passed


def test_feet_that_stay_together_are_no_step():
    """Zero durations satisfy every equation."""
    guess = {"theta1": -0.001, "dtheta1": 0.01, "dtheta2": -0.01}
    gait = go.solve(go.load_problem("compass-passive-stick").replace({"gait.guess.state": guess}))
    assert not gait.converged or gait.period > 0.1


@pytest.mark.parametrize(
    ("name", "overrides", "words"),
    [
        pytest.param(
            "rimless-wheel-slip",
            {"friction": 1.0},
            r"phase 1 .stick. has no end: from the guess|so it does not take place",
            marks=pytest.mark.slow,
        ),
        ("compass-torque-impact-slip", {"control.hip": -1}, "the swing foot (does not come down|leaves the ground)"),
        pytest.param("compass-torque-slip", {"friction": 0.25}, "so it does not take place", marks=pytest.mark.slow),
        (
            "compass-torque-stick",
            {
                "gait.guess.state": {"theta1": -0.16967, "dtheta1": 0.6479, "dtheta2": -0.36653},
                "gait.guess.durations": [2.1385],
            },
            "the swing foot touches the ground earlier in the step, about 1.0",
        ),
        ("rimless-wheel-stick", {"walker.slope": 0}, "passive walker on level or uphill ground cannot have a"),
    ],
)
def test_failures_are_told_in_words_of_the_walk(name, overrides, words):
    gait = go.solve(go.load_problem(name).replace(overrides).from_guess())
    assert gait.status in (go.Status.INFEASIBLE, go.Status.NOT_CONVERGED)
    assert re.search(words, gait.message)
    assert not re.search(r"t = -", gait.message)


def test_a_phase_of_the_guess_that_does_not_end_is_told_with_what_it_waits_for():
    slip_then_stick = Cycle.of_one_step((Mode.SLIP_FORWARD, Mode.STICK, Mode.SLIP_BACKWARD), Mode.STICK)
    compass = HybridSystem(CompassBiped, NoControl())
    words = [missing_event(compass, slip_then_stick, phase).description for phase in range(3)]
    assert words[0].endswith("phase 1 (slip_forward) has no end: from the guess, " + MARGINS["slip_velocity"].absent)
    assert words[1].endswith("phase 2 (stick) has no end: from the guess, " + MARGINS["cone_backward"].absent)
    assert words[2].endswith("phase 3 (slip_backward) has no end: from the guess, " + MARGINS["touchdown"].absent)


def test_foot_below_the_ground_at_the_landing_of_a_guess_is_the_cause_of_a_failed_search():
    state = {"theta1": -0.3, "torso": 0.2, "dtheta1": 0.9, "dtheta2": -0.1, "dtorso": 0.04}
    problem = go.load_problem("torso-upright").replace({"gait.guess.state": state, "gait.guess.durations": [1.1]})
    gait = solve_sequence(problem)
    (cause,) = gait.causes
    assert cause.what == "touchdown"
    rolled = roll_out(gait.dynamics, problem.cycle, np.array([problem.guess.state[z] for z in gait.system.state_names]))
    assert cause.time == pytest.approx(rolled.period, rel=0.05)  # where it does land
    assert "the swing foot is below the ground" in gait.message
    assert "tried Newton's method and IPOPT" in gait.message


FIRST = "  guess: {step_length: 0.4, duration: 0.8}\n"


def from_nothing(name, guess=FIRST):
    """The named problem with another guess."""
    lines = go.load_problem(name).text.splitlines(keepends=True)
    at = next(k for k, line in enumerate(lines) if line.startswith("  guess:"))
    end = next((k for k in range(at + 1, len(lines)) if not lines[k].startswith("   ")), len(lines))
    return go.parse_problem("".join([*lines[:at], guess, *lines[end:]]))


@pytest.mark.parametrize(
    "name",
    [
        "compass-passive-a",
        "compass-passive-stick",
        "round-feet-passive",
        pytest.param("compass-unequal", marks=pytest.mark.slow),
    ],
)
def test_passive_gaits_are_found_without_a_known_motion(name):
    gait = go.solve(from_nothing(name), progress=False)
    assert gait.converged, gait.message
    assert gait.solver["method"] == "ipopt"
    np.testing.assert_allclose(gait.state, named(name).state, atol=1e-9)
    assert gait.period == pytest.approx(named(name).period, rel=1e-10)


def test_postures_are_a_guess_too():
    first, last = {"theta1": -0.15, "theta2": -0.15}, {"theta1": 0.15, "theta2": 0.15}
    middle = {"theta1": 0.0, "theta2": -0.1}
    guess = f"  guess: {{postures: {[first, middle, last]}, duration: 0.7}}\n".replace("'", "")
    gait = go.solve(from_nothing("compass-passive-stick", guess), progress=False)
    assert gait.converged, gait.message
    assert gait.period == pytest.approx(named("compass-passive-stick").period, rel=1e-10)


def test_the_guess_survives_its_record_and_a_known_state_replaces_it():
    problem = from_nothing("compass-passive-a")
    assert problem.replace({}).digest == problem.digest
    assert problem.guess.first.step_length == 0.4
    known = problem.with_guess(named("compass-passive-a").to_record())
    assert known.guess.first is None
    assert go.solve(known, progress=False).solver["method"] == "newton"
    assert problem.replace({"gait.guess.step_length": 0.5}).guess.first.step_length == 0.5


@pytest.mark.parametrize(
    ("guess", "words"),
    [
        ("{step_length: 4, duration: 0.7}", "step_length: 4 m is too long: the legs of compass_biped reach"),
        ("{step_length: -1, duration: 0.7}", "gait.guess.step_length: -1 must be greater than 0"),
        ("{step_length: 0.4}", "gait.guess.duration: is missing"),
        ("{duration: 0.7}", "gait.guess.step_length: is missing; or give postures, or a state"),
        ("{step_length: 0.4, duration: 0.7, state: {theta1: 0}}", "gait.guess.state: unknown key"),
        ("{step_length: 1, duration: 1, postures: [{theta1: 0, theta2: 0}, {theta1: 0, theta2: 0}]}", "exclude each"),
        ("{duration: 0.7, postures: [{theta1: 0.1, theta2: 0.1}, {theta1: 0, theta2: 0}]}", "have crossed feet"),
        ("{duration: 0.7, postures: [{theta1: 0.1}, {theta1: 0, theta2: 0}]}", "gait.guess.postures[0]: lacks theta2"),
        ("{duration: 1, postures: [{knee: 0, theta1: -1, theta2: -1}, {theta1: 0, theta2: 0}]}", "is not a shape"),
    ],
)  # fmt: skip
def test_each_fault_of_a_guess_is_one_sentence(guess, words):
    assert words in refusal(from_nothing, "compass-passive-stick", f"  guess: {guess}\n")
