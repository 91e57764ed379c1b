"""Optimal open-loop torques: against designs with constant torques, their neighbours, and what they must meet."""

import casadi as ca
import numpy as np
import pytest
from named import named, solved, verified
from open_loop import COMPASS, solved_by_casadi

import gaitopt as go
from gaitopt.design.neighbourhood import neighbourhood
from gaitopt.solver.collocation import Collocation
from gaitopt.systems import build_system

RICH = COMPASS.partition("objective")[0].replace("friction: 0.12", "friction: {free: [0.1, 0.4], guess: 0.3}")
RICH = RICH.replace("intervals: 1, order: constant", "intervals: 3, rates: {hip: 20}")
RICH += """objective: {absolute_cost_of_transport: 1, peak_torque: 0.01, friction: 0.1}
constraints:
  speed: {min: 0.4}
  required_friction: {max: 0.3}
  min_normal_force: {min: 1}
  impulse_ratio: {max: 2}
  angle.theta1: {min: -30 deg, max: 30 deg}
  state.theta1: {max: -0.05}
  control.hip.0: {max: 1}
"""


@pytest.fixture(scope="module")
def compass():
    return solved(go.parse_problem(COMPASS))


def test_one_constant_interval_is_the_design_with_constant_torques_and_has_no_better_neighbour(compass):
    design = named("compass-torque-efficient")
    assert compass.scalar("cost_of_transport") == pytest.approx(design.scalar("cost_of_transport"), rel=1e-8)
    for name in ("ankle", "hip"):
        assert compass.freed[f"control.{name}.0"] == pytest.approx(design.freed[f"control.{name}"], abs=1e-5)
    np.testing.assert_allclose(compass.state, design.state, atol=1e-5)
    searched = neighbourhood(compass, directions=10)
    assert searched.optimal, searched.summary


def test_the_optimum_is_a_gait_under_torques_that_are_fixed_in_time_and_followed_to_another_friction(compass, tmp_path):
    assert go.verify(compass).passed
    assert compass.problem.control.duration == pytest.approx(compass.period, rel=1e-8)
    assert compass.scalar("speed") == pytest.approx(0.4, rel=1e-7)
    loaded = go.load_run(compass.save(tmp_path / "run"))
    assert loaded.freed == compass.freed
    assert loaded.problem.control == compass.problem.control
    assert go.verify(loaded).passed
    assert loaded.scalar("work") == pytest.approx(compass.scalar("work"), rel=1e-9)
    last = go.continuation(compass, "friction", to=0.125, output=tmp_path / "branch").points[-1]
    assert last.value == pytest.approx(0.125)
    stored = go.load_run(tmp_path / "branch").points[-1].gait
    assert last.gait.problem.control == stored.problem.control == compass.problem.control
    np.testing.assert_array_equal(stored.state, last.gait.state)


def test_a_phase_that_vanishes_at_the_optimum_is_named():
    gait = go.solve(go.parse_problem(COMPASS.replace("cost_of_transport", "torque_squared")), progress=False)
    assert not gait.converged
    assert gait.message == "phase 1 (slip_forward) vanishes: remove it from the mode sequence"


@pytest.mark.slow
def test_more_intervals_are_never_worse():
    costs = []
    for intervals in (1, 2, 4):
        text = COMPASS.replace("intervals: 1", f"intervals: {intervals}").replace("cost_of_transport", "torque_squared")
        text = text.replace("speed: 0.4", "speed: 0.4, state.dx: {min: 0.05}")  # else the slip vanishes
        gait = solved(go.parse_problem(text))
        costs.append(gait.scalar("torque_squared"))
    assert costs[0] > costs[1] * (1 - 1e-9) > costs[2] * (1 - 2e-9)


def test_derivatives_of_the_program_are_those_of_central_differences():
    problem = go.parse_problem(RICH)
    free = {key: (each.lower, each.upper) for key, each in problem.free.items()}
    program = Collocation(
        problem, build_system(problem), np.array([0.1, 0.6]), free=free, degree=2, intervals=4, extra=((1, 0.3),)
    )
    assembled, p, rng = program.program, program.dynamics.p, np.random.default_rng(0)
    value = ca.Function("value", [assembled.x, assembled.p], [assembled.f, assembled.g])
    states = np.tile([-0.1, 0.1, 0.01, 0.5, -0.5, 0.1], (program.n_states, 1))
    n_values = len(program.value_keys)
    x = program.pack(states, np.ones(n_values), np.array([0.1, 0.6]), [0.3]) + 0.02 * rng.normal(size=program.n_x)
    direction, eps, multipliers = rng.normal(size=x.size), 1e-6, rng.normal(size=program.lbg.size)

    def slopes(at):
        gradient = assembled.derivatives["grad_f"](at, p)[1]
        return np.asarray(gradient).ravel(), np.asarray(ca.DM(assembled.derivatives["jac_g"](at, p)[1]))

    (f1, g1), (f0, g0) = (map(np.asarray, value(x + sign * eps * direction, p)) for sign in (1, -1))
    gradient, jacobian = slopes(x)
    assert ((f1 - f0) / (2 * eps)).item() == pytest.approx(gradient @ direction, rel=1e-6, abs=1e-6)
    change, exact = ((g1 - g0) / (2 * eps)).ravel(), jacobian @ direction
    np.testing.assert_allclose(change, exact, rtol=1e-5, atol=1e-6 * np.abs(exact).max())
    upper = np.asarray(ca.DM(assembled.derivatives["hess_lag"](x, p, 1.0, multipliers)))
    hessian = upper + np.triu(upper, 1).T
    total = [
        gradient + jacobian.T @ multipliers for gradient, jacobian in (slopes(x + s * eps * direction) for s in (1, -1))
    ]
    np.testing.assert_allclose(
        (total[0] - total[1]) / (2 * eps), hessian @ direction, rtol=1e-5, atol=1e-5 * np.abs(hessian @ direction).max()
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "objective", ["work", "cost_of_transport", "absolute_cost_of_transport", "torque_squared", "torque_cost"]
)
def test_every_objective_gives_a_verified_optimum(objective):
    text = COMPASS.replace("cost_of_transport", objective).replace("constant", "linear")
    gait = verified(
        go.parse_problem(text.replace("speed: 0.4", "speed: 0.4, step_length: 0.3, state.dx: {min: 0.05}")),
    )
    assert gait.solver["objective"] == pytest.approx(gait.scalar(objective))
    assert gait.solver["kkt"] < 1e-8


def test_absolute_work_is_found_with_bounds_on_power_that_are_tight():
    program = go.nlp(go.parse_problem(COMPASS.replace("cost_of_transport", "absolute_cost_of_transport")))
    w = solved_by_casadi(program)
    nlp = program.casadi()
    rows = np.asarray(ca.Function("rows", [nlp["x"], nlp["p"]], [nlp["g"]])(w, program.p0)).ravel()
    room = rows[[label.name == "absolute_power" for label in program.g_labels]].reshape((-1, 2, 2))
    np.testing.assert_allclose(room.min(axis=1), 0, atol=1e-3)  # of two motors, in W
    np.testing.assert_array_equal(program.pack(program.unpack(w)), w)
    assert (program.x_labels[-1].name, program.x_labels[-1].unit) == ("absolute_power", "W")
    assert go.verify(program.gait(w)).passed


@pytest.mark.slow
def test_an_open_mode_sequence_leads_to_a_verified_optimum():  # not the best: a slip costs 0.4 % less
    gait = verified(go.parse_problem(COMPASS).replace({"gait.phases": "auto"}))
    assert gait.scalar("speed") == pytest.approx(0.4, rel=1e-6)


def test_its_program_in_the_hands_of_a_user_has_the_same_optimum(compass, tmp_path):
    program = go.nlp(go.parse_problem(COMPASS))
    w = solved_by_casadi(program)
    gait = program.gait(w)
    np.testing.assert_allclose(gait.state, compass.state, rtol=0, atol=1e-10)
    assert gait.freed == pytest.approx(compass.freed, rel=1e-8)
    assert go.verify(go.load_run(gait.save(tmp_path / "run"))).passed
    assert program.refined(w) is None
    assert len(program.x_labels) == w.size
    assert len(program.g_labels) == program.lbg.size
    quantities = program.unpack(w)
    assert quantities["control.hip.0"] == pytest.approx(gait.freed["control.hip.0"])
    np.testing.assert_array_equal(program.pack(quantities), w)
    last = max(range(program.n_nodes), key=lambda node: quantities["time"][node])
    assert quantities["time"][last] == pytest.approx(gait.period, rel=1e-9)
    before_impact = gait.steps[0].arcs[-1].states[-1]
    assert quantities["theta1"][last] == pytest.approx(before_impact[0], abs=1e-8)


def test_a_point_that_is_no_motion_or_misses_a_constraint_is_not_a_gait():
    program = go.nlp(go.parse_problem(COMPASS))
    w = solved_by_casadi(program)
    moved = program.gait(program.pack(program.unpack(w) | {"dtheta1": program.unpack(w)["dtheta1"] + 1e-3}))
    assert not moved.converged
    assert "is off by" in moved.message
    faster = go.nlp(go.parse_problem(COMPASS.replace("speed: 0.4", "speed: 0.41"))).gait(w)
    assert faster.message == "speed is 0.4, must be at least 0.41"


@pytest.mark.slow
def test_rabbit_has_the_same_optimum_by_repeated_refinement():
    program = go.nlp("rabbit-optimal")
    while program is not None:
        w, last = solved_by_casadi(program), program
        program = program.refined(w)
    np.testing.assert_allclose(last.gait(w).state, named("rabbit-optimal").state, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_problem_with_every_kind_of_constraint_meets_them():
    gait = verified(go.parse_problem(RICH))
    law = gait.problem.control
    assert gait.scalar("speed") > 0.4 * (1 - 1e-7)
    assert gait.scalar("required_friction") < 0.3 + 1e-7
    assert max(np.abs(np.diff(law.values["hip"]))) < 20 * law.duration / 3 + 1e-6
    assert law.values["hip"][0] < 1 + 1e-7
    assert max(abs(value) for row in law.values.values() for value in row) == pytest.approx(
        gait.scalar("peak_torque"), rel=1e-5
    )


def test_a_speed_beyond_the_torque_limits_says_how_far_one_gets():
    text = COMPASS.replace("0.4}", "2}").replace("[slip_forward, stick]", "[stick]").replace("slip_forward", "stick")
    text = text.replace(", dx: 0.084", "").replace("friction: 0.12", "friction: 1").replace("[-5, 5]", "[-1, 1]")
    gait = go.solve(go.parse_problem(text), progress=False)
    assert gait.status is go.Status.INFEASIBLE
    assert "constraints.speed: speed = 2 conflicts with" in gait.message
    assert "control.bounds.hip" in gait.message
    assert "best reached" in gait.message


@pytest.mark.slow
def test_rabbit_walks_from_nothing_at_the_cost_of_plain_collocation_and_has_no_better_neighbour():
    gait = named("rabbit-optimal")
    assert go.verify(gait).passed
    assert gait.solver["kkt"] < 1e-9
    assert gait.scalar("required_friction") == pytest.approx(0.6, abs=1e-6)
    # plain CasADi without gaitopt: its own Lagrangian, Radau degree 4 on 160 intervals, margins at these points alone;
    # with 20, 40, 80 and 160 intervals it gives 330.81103, 330.84291, 330.84472 and 330.84657
    assert gait.scalar("torque_squared") / 0.4 == pytest.approx(330.84657, rel=1e-6)
    searched = neighbourhood(gait, directions=40)
    assert searched.optimal, searched.summary
    assert searched.feasible > 100
