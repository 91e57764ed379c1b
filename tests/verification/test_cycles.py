"""Gaits that repeat themselves after several steps: from the file to the multipliers, by both methods."""

import numpy as np
import pytest

import gaitopt as go
from gaitopt import Cycle, Mode, ModeSequence
from gaitopt.errors import ProblemError
from gaitopt.gait.gait import floquet_multipliers, multiplier_distance
from gaitopt.simulation.simulator import Simulator
from gaitopt.verification.return_map import ReturnMap

T, F = Mode.STICK, Mode.SLIP_FORWARD
NAME = "compass-passive-two-step"
ONE = {"phases": ["stick"], "impact": "stick"}
TWICE = {"gait.steps": [ONE, ONE]}


@pytest.fixture(scope="module")
def gait():
    return go.solve(go.load_problem(NAME))


def test_two_steps_differ_and_the_simulator_walks_both(gait):
    assert gait.converged, gait.message
    lengths, periods = [step.impact.step_length for step in gait.steps], [step.period for step in gait.steps]
    assert lengths[0] - lengths[1] > 0.04
    assert gait.measures["period"] == pytest.approx(sum(periods), rel=1e-14)
    assert gait.measures["step_length"] == pytest.approx(sum(lengths), rel=1e-14)
    assert gait.measures["speed"] == pytest.approx(sum(lengths) / sum(periods), rel=1e-14)
    check = go.verify(gait)
    assert check.passed, check
    assert check.figure("multipliers") < 1e-8
    once = ReturnMap(Simulator(gait.dynamics), T)
    halfway = once(gait.state[gait.system.section(T).indices])
    product = once.jacobian(once(halfway.xi).steps) @ once.jacobian(halfway.steps)
    assert multiplier_distance(floquet_multipliers(product), gait.multipliers) < 1e-8


def test_a_one_step_gait_stated_twice_has_its_multipliers_squared():
    problem = go.load_problem("compass-passive-stick")
    once, twice = go.solve(problem), go.solve(problem.replace(TWICE))
    assert go.verify(twice).passed
    np.testing.assert_allclose(twice.state, once.state, atol=1e-11)
    assert multiplier_distance(once.multipliers**2, twice.multipliers) < 1e-10
    assert twice.period == pytest.approx(2 * once.period, abs=1e-11)
    assert twice.message == "solved; the cycle of 2 steps repeats itself after every step"
    assert (once.message, once.repeats_after, twice.repeats_after) == ("solved", 1, 1)
    assert (once.to_record()["n_steps"], "steps" in once.to_record()) == (1, False)


def test_each_step_changes_its_own_modes(gait):
    changes = go.continuation(gait, "friction", 0.0, max_points=22, verify_every=0).special("mode_change")
    assert changes[0].value == pytest.approx(0.3152902774, abs=1e-9)
    assert changes[0].after == Cycle((ModeSequence((T,), T), ModeSequence((F, T), T)))
    assert "step 2, phase 1 (stick)" in changes[0].reason
    required = go.solve(gait.problem.replace({"friction": 0.4})).measures["required_friction"]
    assert required == pytest.approx(changes[0].value, abs=1e-9)


def test_phases_are_counted_through_the_steps():
    cycle = Cycle((ModeSequence((T, F), F), ModeSequence((F, T), T)))
    assert cycle.phases == (T, F, F, T)
    assert [cycle.step_of(k) for k in range(4)] == [0, 0, 1, 1]
    assert [cycle.after(k) for k in range(4)] == [F, None, T, None]
    assert [cycle.impact_before(k) for k in range(4)] == [T, None, F, None]
    assert [cycle.onset_order(k) for k in (1, 2)] == [2, 0]
    assert str(cycle) == "stick, slip_forward; slip_forward | slip_forward, stick; stick"
    with pytest.raises(ValueError, match="the first phase must be slip_forward, not stick"):
        Cycle((ModeSequence((T,), F), ModeSequence((T,), T)))


def test_changing_the_number_of_steps_drops_durations_that_no_longer_fit():
    problem = go.load_problem("compass-passive-stick").replace({"gait.guess.durations": [0.74]})
    assert problem.replace(TWICE).guess.durations is None
    back = problem.replace(TWICE).replace({"gait.phases": ["stick"], "gait.impact": "stick"})
    assert back.cycle == problem.cycle


TRACKING = {"type": "pd", "kp": 15, "kd": 15, "reference": {"gait": NAME, "beyond_end": "hold"}}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gait.steps": []}, r"gait\.steps: has 0 entries"),
        ({"gait.steps": [{"phases": ["stick"]}]}, r"gait\.steps(.|\n)*impact: is missing"),
        (
            {"gait.steps": [ONE | {"impact": "slip_forward"}, ONE]},
            r"gait\.steps(.|\n)*first phase must be slip_forward",
        ),
        ({"gait.steps": [ONE | {"phases": ["stick", "stick"]}]}, r"gait\.steps(.|\n)*phases 1 and 2 are both stick"),
        ({"control": TRACKING}, "has several steps, but its clock restarts at every impact"),
    ],
)
def test_wrong_steps_are_named(changes, message):
    with pytest.raises(ProblemError, match=message):
        go.load_problem("compass-passive-stick").replace(changes)
