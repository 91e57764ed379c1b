"""Solving, simulating, and the references of PD laws, as a user calls them."""

import json
import math
from functools import cache

import numpy as np
import pytest
from named import named

import gaitopt as go
from gaitopt import Gait, Walk
from gaitopt.errors import ProblemError, SolveError, UnknownNameError
from gaitopt.model.curve import BeyondEnd
from gaitopt.model.transitions import Ending
from gaitopt.problem.scalars import MEASURES
from gaitopt.systems import build_system, gait_curve

SIMULATED = {"problem", "status", "friction", "phases", "impact", "state", *MEASURES}
RESULT = {
    "problem", "status", "friction", "phases", "impact", "state", "period", "step_length", "speed", "work",
    "damping_loss", "cost_of_transport", "absolute_cost_of_transport", "torque_squared", "peak_torque", "slip_distance",
    "foot_clearance", "multipliers", "spectral_radius", "required_friction", "impulse_ratio", "min_normal_force",
    "parameters", "verification",
}  # fmt: skip


PASSIVE = "compass-passive-a"


@cache
def failure() -> Gait:
    return go.solve(go.load_problem("rimless-wheel-stick").replace({"friction": 0.5}))


# records


@pytest.mark.parametrize("result", [lambda: named(PASSIVE), failure], ids=["gait", "failure"])
def test_record_has_every_key_and_is_json(result) -> None:
    record = result().to_record()
    assert set(record) >= RESULT
    assert json.loads(json.dumps(record, allow_nan=False)) == record


def test_record_of_a_failure_has_no_figures_but_the_request() -> None:
    record = failure().to_record()
    assert record["status"] == "infeasible"
    assert all(record[name] is None for name in (*MEASURES, "state", "spectral_radius"))
    assert record["phases"] == [{"mode": "stick", "duration": None}]
    assert record["friction"] == 0.5


def test_record_of_a_walk_has_the_same_keys_and_figures_even_without_a_complete_step() -> None:
    walk = go.simulate(named(PASSIVE), steps=3)
    record, ours = walk.to_record(), named(PASSIVE).to_record()
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert (record["status"], record["steps"]) == ("completed", 3)
    for name in MEASURES:
        assert record[name] == (None if ours[name] is None else pytest.approx(ours[name], rel=1e-8, abs=1e-9)), name
    assert [phase["mode"] for phase in record["phases"]] == ["slip_forward", "stick", "slip_backward"]
    fall = go.simulate(named("rimless-wheel-stick"), {"dtheta": 0.05}).to_record()
    assert record.keys() & fall.keys() >= SIMULATED
    assert (fall["status"], fall["steps"], fall["period"]) == ("fall", 0, None)
    assert fall["state"]["dtheta"] == 0.05


def test_walk_of_constant_torques_that_is_sampled_at_the_ends_of_arcs_has_a_record() -> None:
    walk = go.simulate(go.load_problem("compass-torque-stick"), dense=False)
    largest = max(abs(walk.dynamics.parameters[f"control.{name}"]) for name in walk.system.walker.actuators)
    assert walk.to_record()["peak_torque"] == pytest.approx(largest, rel=1e-15)


# simulation


def test_stable_walk_forgets_where_it_began() -> None:
    walk = go.simulate(named("rimless-wheel-stick"), {"dtheta": 0.9}, steps=100, dense=False)
    assert walk.trajectory.ending is Ending.COMPLETED
    assert walk.trajectory.section_states[-1] == pytest.approx(named("rimless-wheel-stick").state, abs=1e-12)


def test_state_by_name_replaces_part_of_the_start_and_the_section_completes_it() -> None:
    start = go.simulate(named(PASSIVE), {"theta1": -0.15, "dx": 0.01}).trajectory.start
    given, ours = (
        dict(zip(named(PASSIVE).system.state_names, state, strict=True)) for state in (start, named(PASSIVE).state)
    )
    expected = {"theta1": -0.15, "theta2": -0.15, "x": 0, "dx": 0.01}
    assert given == expected | {name: ours[name] for name in ("dtheta1", "dtheta2")}
    problem = go.load_problem("compass-passive-stick")
    walk = go.simulate(problem)
    assert dict(zip(walk.system.state_names, walk.trajectory.start, strict=True)) == dict(problem.guess.state)


@pytest.mark.parametrize(
    ("start", "state", "error", "words"),
    [
        (lambda: named(PASSIVE), {"theta3": 0.1}, UnknownNameError, "theta3.*section is theta1, dtheta1, dtheta2, dx"),
        (failure, {}, SolveError, "give the whole state to start from: dtheta, dx"),
        *(
            (lambda: go.load_problem("slip-run"), state, ProblemError, r"start with d(shortening|x) = nan, which is")
            for state in ({"dtheta": 1e6}, {"dtheta": -30.0}, {"dtheta": 1e200}, {"dx": math.nan})
        ),
    ],
)
def test_a_walk_does_not_start_from_a_state_that_is_none(start, state, error, words) -> None:
    with pytest.raises(error, match=words):
        go.simulate(start(), state)
    assert isinstance(go.simulate(failure(), {"dtheta": 0.75, "dx": 0.0}), Walk)


def test_long_walk_keeps_only_the_ends_of_its_arcs_and_ends_at_the_requested_step() -> None:
    sparse, dense = (go.simulate(named(PASSIVE), steps=2, dense=flag) for flag in (False, True))
    assert {arc.times.size for step in sparse.trajectory.steps for arc in step.arcs} == {2}
    assert min(arc.times.size for step in dense.trajectory.steps for arc in step.arcs) > 30
    np.testing.assert_array_equal(sparse.trajectory.section_states, dense.trajectory.section_states)
    polls = iter([False, False, True])
    walk = go.simulate(named(PASSIVE), steps=10, should_stop=lambda: next(polls))
    assert len(walk.complete_steps) == 2
    assert "stopped on request" in walk.trajectory.message


# references

SAME_JOINTS = {"theta1": "theta1", "theta2": "theta2"}


@pytest.mark.parametrize("beyond_end", list(BeyondEnd))
def test_reference_is_the_gait_up_to_its_end_and_then_flows_on_continues_straight_or_stands_still(beyond_end) -> None:
    source = named("compass-passive-b")
    reference = gait_curve(source, beyond_end, SAME_JOINTS)
    for arc in source.arcs:
        inside = arc.times[1:-1]
        angles, rates = reference(inside)
        np.testing.assert_allclose(angles.T, arc.states[1:-1, :2], rtol=0, atol=1e-12)
        np.testing.assert_allclose(rates.T, arc.states[1:-1, 3:5], rtol=0, atol=1e-11)
    assert source.period == pytest.approx(reference.breakpoints[1], abs=1e-15)
    kept, last = {BeyondEnd.LINEAR: 1.0, BeyondEnd.HOLD: 0.0}.get(beyond_end), source.arcs[-1].states[-1]
    if kept is not None:
        angles, rates = reference([source.period + 0.2])
        assert rates[:, 0] == pytest.approx(kept * last[3:5], abs=1e-12)
        assert angles[:, 0] == pytest.approx(last[:2] + 0.2 * kept * last[3:5], abs=1e-12)


def test_reference_that_flows_on_is_the_motion_of_its_last_mode() -> None:
    """Its rates are those of its angles, and they obey the equations of motion."""
    source = named("compass-passive-b")
    reference, end = gait_curve(source, BeyondEnd.FLOW, SAME_JOINTS), source.period
    t, h = end + 0.3, 1e-5
    (angles, rates), (before, rates_before), (after, rates_after) = (reference([s]) for s in (t, t - h, t + h))
    z = np.concatenate([angles[:, 0], [0.0], rates[:, 0], [0.0]])
    flow = np.asarray(source.system.flow(source.arcs[-1].mode)(t, z, source.p, [])).ravel()
    assert (after - before)[:, 0] / (2 * h) == pytest.approx(flow[:2], abs=1e-8)
    assert (rates_after - rates_before)[:, 0] / (2 * h) == pytest.approx(flow[3:5], abs=1e-7)
    assert reference.horizon >= 3 * end


def test_reference_that_is_no_gait_is_an_error_that_says_why(tmp_path) -> None:
    source = go.load_problem("compass-passive-b").text.replace("slope: 1 deg", "slope: -1 deg")
    (tmp_path / "source.yaml").write_text(source)
    tracking = go.load_problem("compass-pd-impact-slip").text.replace("gait: compass-passive-b", "gait: source.yaml")
    (tmp_path / "tracking.yaml").write_text(tracking)
    with pytest.raises(SolveError, match=r"its reference compass-passive-b is (infeasible|not_converged): "):
        build_system(go.load_problem(tmp_path / "tracking.yaml"))


@pytest.mark.parametrize("engine", ["scipy", "heyoka"])
def test_section_coordinates_of_no_state_end_numerically_and_leave_the_others_alone(engine):
    pytest.importorskip(engine)
    problem = go.load_problem("slip-run")  # a rate that takes more than its energy
    returns = go.return_map(problem, [[1.1], [1e6], [-30.0], [1e200]], engine=engine)
    assert returns.endings.tolist() == [0, *[list(Ending).index(Ending.NUMERICAL)] * 3]
