"""A design over a range of a parameter is a stable gait that meets its constraints at every value."""

import json
import signal
import subprocess
import sys

import numpy as np
import pytest
from named import named, solved

import gaitopt as go
from gaitopt.cli.main import main
from gaitopt.cli.terminal import STOPPING
from gaitopt.design.design import design_scenarios
from gaitopt.gait.ranges import DesignRange
from gaitopt.show.tables import printed

NAME, COST = "compass-torque-robust", "absolute_cost_of_transport"
TILES = 1000


def on_floor(gait, friction):
    """The gait of the same control on a floor of another friction, by continuation."""
    if friction == gait.dynamics.parameter("friction"):
        return gait
    last = go.continuation(gait, "friction", to=friction, verify_every=0, progress=False).points[-1]
    assert last.value == pytest.approx(friction, abs=1e-5)  # a change of modes may lie just before the target
    return last.gait


def by_solve(freed, friction, near):
    """The gait of a control on a floor, by ``solve`` from the motion of a known gait."""
    problem = go.load_problem(NAME).at_own_value().with_fixed(freed).replace({"friction": friction})
    return go.solve(problem.with_gait(near).from_guess(), progress=False)


def test_two_scenarios_of_one_gait_have_its_optimum():
    problem = go.load_problem(NAME).at_own_value()
    gait = go.solve(problem, progress=False)
    for worst, shares in ((True, [0.0, 0.0]), (False, [0.25, 0.75])):
        both = design_scenarios(problem, [gait, gait], shares, worst=worst)
        assert both.shortcoming is None
        assert both.own.freed == pytest.approx(gait.freed, rel=1e-7)
        assert both.objective == pytest.approx(gait.scalar(COST), rel=1e-10)


@pytest.fixture(scope="module")
def sticking():
    """A design over a range on which the foot sticks."""
    return go.solve(go.load_problem(NAME).replace({"over.friction": [0.16, 0.165]}), progress=False)


def test_a_range_on_which_the_foot_sticks_costs_nothing(sticking):
    assert sticking.converged, sticking.message
    over = sticking.over
    assert over.objective == pytest.approx(over.single, rel=1e-8)
    assert over.binding.keys() == {"speed"}
    assert {point.sequence for point in over.points} == {"stick; stick"}
    assert (over.points[0].value, over.points[-1].value) == (0.16, 0.165)


def test_the_range_of_a_design_is_printed_drawn_and_recorded(sticking):
    text = printed(sticking)
    assert "over friction from 0.16 to 0.165" in text
    assert "the same of the design for one value" in text
    assert len(go.plot(sticking, "range").figure.axes) == 2
    record = json.loads(json.dumps(sticking.to_record()))["over"]
    assert DesignRange.from_record(record) == sticking.over


@pytest.mark.slow
def test_a_design_over_a_range_is_stored_with_its_problem(tmp_path):
    problem = go.load_problem(NAME).replace({"over.friction": [0.16, 0.165]})
    gait = go.solve(problem, output=tmp_path / "run", progress=False)
    again = go.load_run(tmp_path / "run")
    assert again.over == gait.over
    assert again.problem.digest == problem.digest
    assert go.verify(again).passed
    assert on_floor(again, 0.17).converged  # beyond the range


@pytest.mark.slow
def test_the_robust_compass_is_a_gait_at_41_frictions_by_solve_and_by_continuation():
    gait = named(NAME)
    over = gait.over
    assert (over.points[0].value, over.points[-1].value) == (0.12, 0.2)
    assert over.binding == {"speed": 0.12}
    for friction in np.linspace(0.12, 0.2, 41).tolist():
        continued = on_floor(gait, friction)
        other = by_solve(gait.freed, friction, continued)
        assert other.converged, f"{friction}: {other.message}"
        assert go.verify(other).passed
        assert other.spectral_radius <= 0.85
        assert other.scalar("speed") >= 0.48 - 1e-9
        assert other.scalar(COST) <= over.objective * (1 + 1e-6)
        assert other.spectral_radius == pytest.approx(continued.spectral_radius, abs=1e-7)
        assert str(other.cycle) in {point.sequence for point in over.points}


@pytest.mark.slow
def test_the_robust_reference_is_a_gait_over_its_range_and_costs_little_more_than_that_for_one_friction():
    gait = named("compass-pd-robust")
    over = gait.over
    assert over.binding["speed"] == 0.15
    assert over.single < over.objective < 1.05 * over.single
    for friction in np.linspace(0.15, 0.35, 9).tolist():
        other = on_floor(gait, friction)
        assert go.verify(other).passed
        assert other.spectral_radius < 0.8
        assert min(other.scalar("speed") / 0.6, other.scalar("step_length") / 0.35) > 1 - 1e-6
        assert other.scalar(COST) <= over.objective * (1 + 1e-6)


@pytest.mark.slow
def test_free_gains_of_the_robot_hold_over_a_range_of_friction():
    gait = named("rabbit-hzd-feedback")
    over = gait.over
    assert over.single < over.objective < named("rabbit-hzd").spectral_radius
    for friction in (0.5, 0.55, 0.6):
        other = on_floor(gait, friction)
        assert go.verify(other).passed
        assert other.spectral_radius <= over.objective * (1 + 1e-6)


@pytest.mark.slow
def test_gait_a_falls_on_a_thousand_random_tiles_and_the_robust_compass_does_not():
    floor = go.Floor.random("friction=0.12:0.2", TILES, seed=1)
    robust, passive = (go.simulate(named(name), steps=TILES, floor=floor) for name in (NAME, "compass-passive-a"))
    assert robust.completed
    assert len(robust.trajectory.steps) == TILES
    assert passive.trajectory.ending == "fall"


@pytest.mark.slow
def test_no_neighbour_of_the_robust_compass_is_better():
    gait, frictions = named(NAME), (0.12, 0.1391, 0.16, 0.2)
    known = [on_floor(gait, friction) for friction in frictions]
    random, better, feasible = np.random.default_rng(0), 0, 0
    for _ in range(40):
        changes = 1 + 1e-3 * random.normal(size=2)
        freed = {key: value * part for (key, value), part in zip(gait.freed.items(), changes.tolist(), strict=True)}
        gaits = [by_solve(freed, friction, near) for friction, near in zip(frictions, known, strict=True)]
        if all(each.converged for each in gaits) and min(each.scalar("speed") for each in gaits) >= 0.48:
            feasible += 1
            better += max(each.scalar(COST) for each in gaits) < gait.over.objective * (1 - 1e-8)
    assert feasible > 5
    assert not better


@pytest.mark.slow
@pytest.mark.parametrize("objective", [{"mean": COST}, COST])
def test_the_objective_is_the_mean_of_nine_gaits_or_that_of_one_which_costs_less_than_in_the_worst_case(objective):
    changes = {"objective": objective} | ({} if isinstance(objective, dict) else {"at": {"friction": 0.13}})
    gait, worst = go.solve(go.load_problem(NAME).replace(changes), progress=False), named(NAME)
    assert gait.converged, gait.message
    values = np.linspace(0.12, 0.2, 9).tolist() if isinstance(objective, dict) else [0.13]
    costs = [[on_floor(one, value).scalar(COST) for value in values] for one in (gait, worst)]
    weights = np.array([1, *[2] * 7, 1]) / 16 if len(values) > 1 else np.ones(1)
    ours, theirs = costs @ weights
    assert gait.over.objective == pytest.approx(ours, rel=1e-6)
    if len(values) == 1:  # the mean is a local optimum, at a floor on which the foot begins to slip
        assert ours <= theirs * (1 + 1e-6)


@pytest.mark.slow
def test_too_wide_a_range_is_exit_4_with_the_widest_one(tmp_path, capsys):
    changes = ["--set", "over.friction=[0.1, 0.22]", "--set", "constraints.speed.min=0.52"]
    assert main(["solve", NAME, *changes, "--json", "--quiet", "-o", str(tmp_path / "run")]) == 4
    record = json.loads(capsys.readouterr().out)
    assert record["status"] == "infeasible"
    low, high = record["widest"]
    assert 0.1 < low < 0.16 < high < 0.22
    narrower = {"over.friction": [low, high], "constraints.speed.min": 0.52}
    assert go.solve(go.load_problem(NAME).replace(narrower), progress=False).converged


@pytest.mark.slow
def test_an_interrupted_design_goes_on_from_where_it_ended():
    calls = []

    def stop():
        calls.append(0)
        return len(calls) > 60

    stopped = go.solve(NAME, progress=False, should_stop=stop)
    assert stopped.status == "interrupted"
    assert stopped.best is not None
    gait = solved(NAME, start=stopped)
    assert gait.over.objective == pytest.approx(named(NAME).over.objective, rel=1e-8)


@pytest.mark.slow
def test_ctrl_c_keeps_the_point_that_a_design_over_a_range_has_reached(tmp_path):
    command = [sys.executable, "-m", "gaitopt", "solve", NAME, "-o"]
    process = subprocess.Popen([*command, "run"], stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    lines = list[str]()
    while len(lines) < 10:  # the design for the own value alone is found, and scenarios are designed together
        lines.append(process.stderr.readline())
        assert lines[-1], lines
    process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    assert process.returncode == 130
    assert STOPPING in err.splitlines()
    assert err.splitlines()[-2:] == [
        "the point where it ended is in run; `--start run` goes on from it",
        "gaitopt: interrupted",
    ]
    resumed = subprocess.run(
        [*command, "resumed", "--start", "run", "--json"], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert json.loads(resumed.stdout)["over"]["objective"] == pytest.approx(named(NAME).over.objective, rel=1e-8)
