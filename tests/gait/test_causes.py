"""The first cause of a failure is the true one, with its phase, time, and what is needed and available."""

import pytest

from gaitopt import load_problem, solve
from gaitopt.errors import GaitoptWarning
from gaitopt.gait.gait import Cause, describe_causes

STICK_NEEDS = 0.17491849133
"""Friction that sticking needs just after the impact, see test_continuation_specials."""

FRICTION = [
    ("rimless-wheel-stick", {"friction": 0.9}, 1, 0.91412),
    pytest.param("rimless-wheel-stick", {"friction": 0.2}, 1, 0.91412, marks=pytest.mark.slow),
    ("rimless-wheel-slip", {"friction": 0.24}, 1, 0.26736),
    ("compass-passive-stick", {"friction": 0.174}, 1, STICK_NEEDS),
    pytest.param("compass-passive-stick", {"friction": 0.05}, 1, STICK_NEEDS, marks=pytest.mark.slow),
    ("compass-passive-a", {"gait.phases": ["stick"]}, 1, STICK_NEEDS),
    pytest.param("compass-passive-a", {"gait.phases": ["slip_forward", "stick"]}, 2, 0.16717, marks=pytest.mark.slow),
    ("compass-passive-a", {"gait.phases": ["stick", "slip_backward"]}, 1, 0.17115),
    ("compass-torque-stick", {"friction": 0.1}, 1, 0.19456),
]
WALKERS = [
    ("rimless-wheel-stick", {"walker.inertia_ratio": 0.1, "friction": 0.2}),
    ("rimless-wheel-stick", {"walker.mass": 5, "walker.gravity": 1.6, "friction": 0.3}),
    ("compass-passive-stick", {"walker.slope": "2 deg", "friction": 0.15}),
    ("compass-passive-stick", {"walker.leg_com": 1.0, "friction": 0.1}),
    ("compass-passive-stick", {"walker.leg_length": 1.7, "friction": 0.1}),
    ("compass-passive-two-step", {"friction": 0.2}),
    ("compass-torque-stick", {"control.ankle": 1.7, "friction": 0.1}),
]
OTHERS = [
    ("rimless-wheel-stick", {"walker.slope": "30deg"}, "normal_force"),
    ("compass-passive-stick", {"walker.slope": "-1deg"}, "energy"),
    ("rimless-wheel-slip", {"gait.phases": ["stick", "slip_backward"]}, "cone_backward"),
    pytest.param(
        "rimless-wheel-stick", {"gait.phases": ["stick", "slip_forward"]}, "cone_forward", marks=pytest.mark.slow
    ),
    pytest.param("compass-passive-a", {"friction": 0.2}, "duration", marks=pytest.mark.slow),
    pytest.param("compass-passive-static-kinetic", {"friction.static": 0.17}, "duration", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("name", "overrides", "phase", "needed"), FRICTION)
def test_too_little_friction_is_named_with_what_sticking_needs(name, overrides, phase, needed):
    problem = load_problem(name).replace(overrides)
    record = solve(problem).causes[0].to_record()
    assert (record["what"], record["phase"]) == ("friction", phase)
    assert record["needed"] == pytest.approx(needed, rel=1e-4)
    assert record["available"] == pytest.approx(problem.friction)
    assert record["time"] is not None


@pytest.mark.slow
@pytest.mark.parametrize(("name", "overrides"), WALKERS)
def test_with_the_friction_that_the_causes_name_the_gait_exists_and_with_less_it_does_not(name, overrides):
    problem = load_problem(name).replace(overrides)
    causes = solve(problem).causes
    assert causes[0].what == "friction"
    needed = max(cause.needed for cause in causes if cause.what == "friction")
    assert solve(problem.replace({"friction": needed * (1 + 1e-4)})).converged
    assert not solve(problem.replace({"friction": needed * (1 - 1e-4)})).converged


def test_an_ankle_that_brakes_needs_more_friction_at_the_impact():
    cause = solve(load_problem("compass-torque-stick").replace({"control.ankle": -0.2})).causes[0].to_record()
    assert (cause["what"], cause["phase"]) == ("friction", None)


@pytest.mark.parametrize(("name", "overrides", "what"), OTHERS)
def test_other_causes_are_named_for_what_they_are(name, overrides, what):
    gait = solve(load_problem(name).replace(overrides))
    assert gait.causes[0].what == what
    assert describe_causes(gait.causes) in gait.message


@pytest.mark.parametrize("beyond_end", ["hold", pytest.param("off", marks=pytest.mark.slow)])
def test_on_the_moon_the_reference_is_too_short_for_the_step(beyond_end):
    overrides = {"walker.gravity": 1.6, "control.reference.beyond_end": beyond_end}
    cause = solve(load_problem("compass-pd-impact-slip").replace(overrides)).causes[0]
    assert cause.what == "reference"
    assert cause.available == pytest.approx(solve(load_problem("compass-passive-b")).period, abs=1e-9)
    assert "the reference is too short" in cause.description


def test_sticking_and_a_sticking_impact_may_both_lack_friction():
    causes = solve(load_problem("rimless-wheel-stick").replace({"friction": 0.2})).causes
    impact = causes[1].to_record()
    assert (impact["what"], impact["phase"]) == ("friction", None)
    assert impact["needed"] == pytest.approx(0.2374, abs=1e-4)
    assert solve(load_problem("rimless-wheel-stick")).causes == ()
    record = Cause(what="search", description="nothing").to_record()
    assert {key for key, value in record.items() if value is None} == {"phase", "time", "needed", "available"}


def test_the_former_name_of_the_description_warns():
    with pytest.warns(GaitoptWarning, match=r"Cause\.description"):
        assert Cause(what="search", description="nothing").words == "nothing"


@pytest.mark.slow
def test_a_constraint_in_conflict_is_named_with_the_best_that_is_reached():
    gait = solve(load_problem("compass-torque-stable-slip").replace({"constraints.speed.min": 2}))
    assert (gait.causes[0].what, gait.causes[0].needed) == ("speed", 2.0)
    assert 0.6 < gait.causes[0].available < 0.8
