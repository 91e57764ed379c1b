"""Gaits from nothing: only the length and the time of the step, or some postures, are known."""

import numpy as np
import pytest
from named import named

import gaitopt as go
from gaitopt.errors import ProblemError

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
        ("{step_length: 0.4, duration: 0.7, postures: [{theta1: 0}, {theta1: 0}]}", "exclude each other"),
        ("{duration: 0.7, postures: [{theta1: 0.1, theta2: 0.1}, {theta1: 0, theta2: 0}]}", "have crossed feet"),
        ("{duration: 0.7, postures: [{theta1: 0.1}, {theta1: 0, theta2: 0}]}", "gait.guess.postures[0]: lacks theta2"),
        ("{duration: 1, postures: [{knee: 0, theta1: -1, theta2: -1}, {theta1: 0, theta2: 0}]}", "is not a shape"),
    ],
)  # fmt: skip
def test_each_fault_of_a_guess_is_one_sentence(guess, words):
    with pytest.raises(ProblemError) as caught:
        from_nothing("compass-passive-stick", f"  guess: {guess}\n")
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
