"""The step with open modes: finds the mode sequences of known gaits from legs that swing linearly, without slip."""

import numpy as np
import pytest
from foot_impacts import foot_impact

from gaitopt import Mode, Status, load_problem, solve
from gaitopt.model.dynamics import Dynamics
from gaitopt.solver.open_modes import Complementarity, Proposal, shapes_before, swing
from gaitopt.systems import build_system

FORWARD, STICK, BACKWARD = Mode.SLIP_FORWARD, Mode.STICK, Mode.SLIP_BACKWARD
GAIT_A = ((FORWARD, STICK, BACKWARD), STICK)
GAIT_B = ((FORWARD, STICK), FORWARD)


def program(name, overrides=None, should_stop=None):
    problem = load_problem(name).replace(overrides or {})
    system = build_system(problem)
    p = system.values(problem.parameters)
    time = Dynamics(system, p).scales.time
    return system, p, time, Complementarity(Dynamics(system, p), 1.7 * time, should_stop=should_stop)


def found(proposal):
    assert isinstance(proposal, Proposal), proposal
    return proposal.cycle.phases, proposal.cycle.impact


def test_the_passive_compass_has_gaits_a_and_b():
    system, p, time, steps = program("compass-passive-a")
    proposals = [steps.solve(*swing(Dynamics(system, p), np.array([[-a]]), 1.5 * time), 1.5 * time) for a in (0.2, 0.3)]
    assert {found(proposal) for proposal in proposals} == {GAIT_A, GAIT_B}


def test_a_proposal_is_close_to_the_gait_that_is_solved_with_its_sequence():
    gait = solve(load_problem("compass-passive-a"))
    system, p, time, steps = program("compass-passive-a")
    proposal = steps.solve(*swing(Dynamics(system, p), np.array([[-0.2]]), 1.5 * time), 1.5 * time)
    assert found(proposal) == GAIT_A
    np.testing.assert_allclose(proposal.states[0], gait.state, atol=2e-3)
    assert sum(proposal.durations[0]) == pytest.approx(gait.measures["period"], abs=1e-3)


def test_the_torque_driven_compass_has_gait_i():
    system, p, time, steps = program("compass-torque-slip")
    assert found(steps.solve(*swing(Dynamics(system, p), np.array([[-0.2]]), 2 * time), 2 * time)) == GAIT_A


@pytest.mark.parametrize(
    ("friction", "sequence"),
    [
        (0.4, ((STICK, FORWARD), STICK)),
        (0.26, ((FORWARD, STICK, FORWARD), STICK)),
        (0.24, ((FORWARD, STICK, FORWARD), FORWARD)),
    ],
)
def test_the_wheel_slips_the_more_the_less_friction_there_is(friction, sequence):
    """Found from one of three periods: from which of them IPOPT gets there is a matter of rounding."""
    system, p, time, steps = program("rimless-wheel-slip", {"friction": friction})
    periods = (time, 0.7 * time, 1.1 * time)
    proposals = (steps.solve(*swing(Dynamics(system, p), np.zeros((1, 0)), period), period) for period in periods)
    assert found(next(proposal for proposal in proposals if isinstance(proposal, Proposal))) == sequence


@pytest.mark.slow
def test_a_cycle_of_two_steps_is_found_from_two_unlike_swings():
    """On 5.4 deg, where the period of the sticking gait has doubled."""
    overrides = {"friction": 0.6, "walker.slope": "5.4deg"}
    system, p, time, _ = program("compass-passive-stick", overrides)
    cycles = Complementarity(Dynamics(system, p), 1.7 * time, n_steps=2)
    period = 2.88 * time
    pairs = [(-0.035, -0.286), (-0.03, -0.3), (-0.2, -0.3), (-0.15, -0.35)]  # some lead to the gait of one step, twice
    guesses = [swing(Dynamics(system, p), np.array(pair)[:, None], period) for pair in pairs]
    proposals = [found for guess in guesses if isinstance(found := cycles.solve(*guess, period), Proposal)]
    assert {str(proposal.cycle) for proposal in proposals} == {"stick; stick | stick; stick"}
    expected = sorted(step.period for step in solve(load_problem("compass-passive-two-step")).steps)
    assert any(sorted(map(sum, found.durations)) == pytest.approx(expected, abs=1e-3) for found in proposals)


def test_a_swing_ends_in_the_shape_that_the_impact_relabels_to_its_start():
    problem = load_problem("compass-passive-a")
    system = build_system(problem)
    p = system.values(problem.parameters)
    (start,), (end,) = swing(Dynamics(system, p), np.array([[-0.2]]), 0.7)
    after = np.asarray(foot_impact(system, STICK)(end, p)[0]).ravel()
    n = system.n_shape
    np.testing.assert_allclose(after[:n], start[:n], atol=1e-14)
    np.testing.assert_allclose(end[:n] - start[:n], 0.7 * start[n + 1 : 2 * n + 1], atol=1e-14)
    np.testing.assert_allclose(shapes_before(Dynamics(system, p), start[None, :n])[0], end[:n])


def test_a_stop_on_request_is_told_from_a_failure():
    system, p, time, steps = program("rimless-wheel-slip", should_stop=lambda: True)
    assert steps.solve(*swing(Dynamics(system, p), np.zeros((1, 0)), time), time) is Status.INTERRUPTED


@pytest.mark.parametrize("direction", [1, -1])
def test_at_full_friction_the_open_flow_is_that_of_a_slip(direction):
    problem = load_problem("compass-torque-slip")
    system = build_system(problem)
    p, mode = system.values(problem.parameters), Mode.slip(direction)
    z = np.array([-0.1, 0.05, 0.0, 0.7, -0.4, 0.3 * direction])
    rate, force, guard, guard_rate = (np.asarray(v).ravel() for v in system.open_flow(0.1, z, direction, p, []))
    margins, rates = (np.asarray(v).ravel() for v in system.events(mode)(0.1, z, p, []))
    np.testing.assert_allclose(rate, np.asarray(system.flow(mode)(0.1, z, p, [])).ravel(), rtol=1e-13)
    assert -force[0] == pytest.approx(direction * 0.14 * force[1])
    assert (guard[0], guard_rate[0]) == pytest.approx((-margins[0], -rates[0]))


def test_at_the_friction_that_sticking_needs_the_open_flow_holds_the_foot():
    problem = load_problem("compass-passive-a")
    system = build_system(problem)
    p, z = system.values(problem.parameters), np.array([-0.1, 0.05, 0.0, 0.7, -0.4, 0.0])
    f_t, f_n = np.asarray(system.observation(STICK)(0.0, z, p, [])[0]).ravel()
    rate, force, _, _ = (np.asarray(v).ravel() for v in system.open_flow(0.0, z, -f_t / f_n / 0.14, p, []))
    np.testing.assert_allclose(force, (f_t, f_n), rtol=1e-12)
    assert rate[-1] == pytest.approx(0.0, abs=1e-13)


@pytest.mark.parametrize("mode", [FORWARD, BACKWARD])
def test_at_full_friction_the_open_impact_is_that_of_a_slip(mode):
    problem = load_problem("compass-passive-b")
    system = build_system(problem)
    p, z = system.values(problem.parameters), np.array([0.1, 0.1, 0.0, 0.9, 0.2, 0.0])
    for ours, theirs in zip(system.open_impact(z, mode.direction, p), foot_impact(system, mode)(z, p), strict=False):
        np.testing.assert_allclose(np.asarray(ours), np.asarray(theirs), rtol=1e-13, atol=1e-15)
