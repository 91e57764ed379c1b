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
    long, short = (step.impact.step_length for step in gait.steps)
    assert long - short > 0.04
    check = go.verify(gait)
    assert check.passed, check
    assert check.figure("multipliers") < 1e-8


def test_multipliers_are_those_of_the_return_map_applied_twice(gait):
    once = ReturnMap(Simulator(gait.dynamics), T)
    xi = gait.state[gait.system.section(T).indices]
    halfway = once(xi)
    again = once(halfway.xi)
    product = once.jacobian(again.steps) @ once.jacobian(halfway.steps)
    assert multiplier_distance(floquet_multipliers(product), gait.multipliers) < 1e-8


def test_measures_are_of_the_whole_cycle(gait):
    periods = [step.period for step in gait.steps]
    assert gait.measures["period"] == pytest.approx(sum(periods), rel=1e-14)
    assert gait.measures["step_length"] == pytest.approx(sum(s.impact.step_length for s in gait.steps), rel=1e-14)
    assert gait.measures["speed"] == pytest.approx(gait.measures["step_length"] / sum(periods), rel=1e-14)


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
    changes = [s for s in go.continuation(gait, "friction", 0.3).specials if s.type == "mode_change"]
    assert changes[0].value == pytest.approx(0.3152902774, abs=1e-9)
    assert changes[0].after == Cycle((ModeSequence((T,), T), ModeSequence((F, T), T)))
    assert "step 2, phase 1 (stick)" in changes[0].reason
    required = go.solve(gait.problem.replace({"friction": 0.4})).measures["required_friction"]
    assert required == pytest.approx(changes[0].value, abs=1e-9)


def test_a_slipping_impact_binds_the_first_phase_of_the_next_step():
    Cycle((ModeSequence((T,), F), ModeSequence((F, T), T)))
    with pytest.raises(ValueError, match="the first phase must be slip_forward, not stick"):
        Cycle((ModeSequence((T,), F), ModeSequence((T,), T)))


def test_phases_are_counted_through_the_steps():
    cycle = Cycle((ModeSequence((T, F), F), ModeSequence((F, T), T)))
    assert cycle.phases == (T, F, F, T)
    assert [cycle.step_of(k) for k in range(4)] == [0, 0, 1, 1]
    assert [cycle.after(k) for k in range(4)] == [F, None, T, None]
    assert [cycle.impact_before(k) for k in range(4)] == [T, None, F, None]
    assert [cycle.onset_order(k) for k in (1, 2)] == [2, 0]
    assert str(cycle) == "stick, slip_forward; slip_forward | slip_forward, stick; stick"


def test_changing_the_number_of_steps_drops_durations_that_no_longer_fit():
    problem = go.load_problem("compass-passive-stick").replace({"gait.guess.durations": [0.74]})
    assert problem.replace(TWICE).guess.durations is None
    back = problem.replace(TWICE).replace({"gait.phases": ["stick"], "gait.impact": "stick"})
    assert back.cycle == problem.cycle


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ([], ": has 0 entries"),
        ([{"phases": ["stick"]}], "impact: is missing"),
        ([{"phases": ["stick"], "impact": "slip_forward"}, ONE], "the first phase must be slip_forward"),
        ([{"phases": ["stick", "stick"], "impact": "stick"}], "phases 1 and 2 are both stick"),
    ],
)
def test_wrong_steps_are_named(steps, message):
    with pytest.raises(ProblemError, match=rf"gait\.steps(.|\n)*{message}"):
        go.load_problem("compass-passive-stick").replace({"gait.steps": steps})


def test_what_takes_one_step_refuses_several():
    control = {"type": "pd", "kp": 15, "kd": 15, "reference": {"gait": NAME, "beyond_end": "hold"}}
    with pytest.raises(ProblemError, match="has several steps, but its clock restarts at every impact"):
        go.load_problem("compass-passive-b").replace({"control": control})
