"""Gaits of RABBIT, an actuated robot with knees: stable on enough friction, slipping on less, up to where they end."""

import pytest
from named import named, verification

import gaitopt as go
from gaitopt import Mode

NAMES = ("rabbit-optimal", "rabbit-tracked", "rabbit-hzd", "rabbit-hzd-slip")


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("engine", ["scipy", "heyoka"])
def test_every_gait_of_rabbit_is_confirmed_by_both_engines(name, engine):
    assert go.verify(named(name), engine=engine).passed


@pytest.mark.slow
def test_the_multiplier_under_virtual_constraints_is_that_of_the_zero_dynamics():
    gait = named("rabbit-hzd")
    assert verification("rabbit-hzd").passed
    assert gait.constraints.invariant
    assert gait.constraints.delta_squared == pytest.approx(gait.spectral_radius, abs=1e-9)
    assert gait.spectral_radius == pytest.approx(0.66617, abs=1e-5)


@pytest.mark.slow
def test_tracking_over_time_is_unstable_and_tracking_over_the_phase_is_not():
    assert named("rabbit-tracked").spectral_radius > 5
    assert named("rabbit-hzd").spectral_radius < 1


@pytest.mark.slow
def test_less_friction_makes_the_foot_slip_backward_then_forward_too_until_it_lifts_off():
    stick, forward, backward = Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD
    branch = go.continuation(named("rabbit-hzd"), "friction", to=0.3)
    found = [(special.type, special.value) for special in branch.specials]
    assert [kind for kind, _ in found] == ["mode_change", "impact_change", "lift_off"]
    assert [value for _, value in found] == pytest.approx([0.566667, 0.460901, 0.360218], abs=1e-6)
    sequences = [special.after for special in branch.specials[:2]]
    assert [sequence.phases for sequence in sequences] == [(stick, backward), (forward, stick, backward)]
    assert [sequence.impact for sequence in sequences] == [stick, forward]
    assert all(point.gait.spectral_radius < 1 for point in branch.points)


@pytest.mark.slow
def test_tracking_errors_of_motors_are_those_of_their_angles():
    gait, reference = named("rabbit-tracked"), named("rabbit-optimal")
    errors = gait.to_record()["tracking_errors"]
    torso, thigh, shin = (gait.state[k] - reference.state[k] for k in (0, 1, 2))
    assert errors["stance_hip"]["start"] == pytest.approx(thigh - torso, abs=1e-9)
    assert errors["stance_knee"]["start"] == pytest.approx(shin - thigh, abs=1e-9)


def test_the_angles_of_motors_can_be_tracked():
    walker = go.load_problem("rabbit-tracked").walker
    assert walker.tracked == walker.actuators
    assert "stance_leg" in type(walker).phases
