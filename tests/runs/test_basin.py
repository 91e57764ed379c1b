"""Basins: every state goes somewhere, the same whatever happens while they walk."""

import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("heyoka")

from named import named

import gaitopt as go
from gaitopt.cli.main import main
from gaitopt.errors import StorageError, UnknownNameError
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.transitions import Ending
from gaitopt.problem.problem import load_problem
from gaitopt.requests import BasinRequest, Engine
from gaitopt.runs import basin as basin_run
from gaitopt.runs.basin import MAX_PERIOD, SETTLED, UNDECIDED, BasinPlan, assign_gaits, follow
from gaitopt.runs.grid import Axis, Grid
from gaitopt.show.grids import basin as basin_figure
from gaitopt.simulation.heyoka_stepper import HeyokaStepper
from gaitopt.simulation.outcomes import ENDINGS, StepOutcomes
from gaitopt.simulation.simulator import Simulator
from gaitopt.verification.step_map import step_map
from gaitopt.workers.jobs import Workers

HERE = Workers(count=1)
GRID = Grid(
    (Axis(key="dtheta1", lower=0.6, upper=0.75, count=12), Axis(key="dtheta2", lower=-0.6, upper=0.0, count=10))
)


@pytest.fixture(scope="module")
def gait():
    return named("compass-passive-a")


def plan_in(folder, gait, **changes):
    grid = changes.pop("grid", GRID)
    return BasinPlan.around(gait, grid, BasinRequest(**{"engine": "heyoka", **changes}), folder)


@pytest.fixture(scope="module")
def basin(gait, tmp_path_factory):
    return plan_in(tmp_path_factory.mktemp("basin"), gait).complete(HERE)


def test_states_near_the_gait_settle_on_it(gait, basin):
    (attractor,) = basin.attractors
    section = gait.system.section(Mode.SLIP_FORWARD).indices
    np.testing.assert_allclose(attractor.state, gait.state[section], rtol=0, atol=100 * SETTLED)
    assert (attractor.phases, attractor.impact, attractor.period) == (
        gait.problem.cycle.phases, gait.problem.cycle.impact, 1,
    )  # fmt: skip
    assert 0 < attractor.count == (basin.labels == 0).sum()


def test_fate_of_every_state_is_that_of_the_simulator(gait, basin):
    simulator = Simulator(gait.dynamics, HeyokaStepper)
    numbers = np.arange(0, GRID.size, 7)
    for number, (rate1, rate2) in zip(numbers, GRID.points(numbers), strict=True):
        index = np.unravel_index(number, GRID.shape)
        start = Dynamics(gait.system, gait.p).lift(np.array([gait.state[0], rate1, rate2]))
        walk = simulator.run(start, steps=int(basin.steps[index]) + 1)
        if basin.labels[index] >= 0:
            assert walk.ending is Ending.COMPLETED
            np.testing.assert_allclose(walk.section_states[-1], gait.state, rtol=0, atol=100 * SETTLED)
        else:
            assert walk.ending is ENDINGS[basin.endings[index]]


def test_a_stopped_basin_resumes_where_it_stopped(gait, basin, tmp_path, monkeypatch):
    monkeypatch.setattr(basin_run, "TILE", 32)
    done = []
    plan = plan_in(tmp_path, gait)
    with pytest.raises(KeyboardInterrupt):
        plan.complete(HERE, progress=lambda k, n: done.append(k), should_stop=lambda: len(done) == 2)
    resumed = []
    whole = plan.complete(HERE, progress=lambda k, n: resumed.append((k, n)))
    assert resumed == [(3, 4), (4, 4)]
    for name in ("labels", "endings", "steps"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(basin, name))


@pytest.mark.slow
def test_basin_on_scipy_is_that_on_heyoka_in_tiles_for_every_core(gait, basin, tmp_path):
    plan = plan_in(tmp_path, gait, engine="scipy")
    assert len(plan.tiles) == 2
    walked = plan.complete(HERE)
    for name in ("labels", "endings", "steps"):
        np.testing.assert_array_equal(getattr(walked, name), getattr(basin, name))


def test_basin_without_heyoka_says_what_is_faster(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("gaitopt.simulation.engine.find_spec", lambda name: None)
    grid = ("--over", "dtheta=0.9:1:2", "--workers", "1", "-o", str(tmp_path / "run"))
    assert main(["basin", "rimless-wheel-stick", *grid]) == 0
    assert "pip install 'gaitopt[fast]'" in capsys.readouterr().err


def test_tile_that_is_broken_is_named(gait, tmp_path):
    plan = plan_in(tmp_path, gait, grid=Grid((Axis(key="dtheta1", lower=0.7, upper=0.72, count=3),)))
    plan.complete(HERE)
    (tile,) = plan.run.result_folder.glob("tile-*.npz")
    tile.write_bytes(b"not an archive")
    with pytest.raises(StorageError, match=r"tile-000000.npz is damaged .* delete it"):
        plan.complete(HERE)


def test_tiles_of_another_basin_are_not_used_and_a_small_one_walks_on_heyoka_too(gait, tmp_path):
    assert plan_in(tmp_path, gait).run != plan_in(tmp_path, gait, steps=10).run
    assert plan_in(tmp_path, gait, engine="auto").chosen_engine is Engine.HEYOKA


class Map:
    """A return map of two numbers given by a formula; a state beyond 5 falls."""

    def __init__(self, formula):
        self.formula = formula

    def __call__(self, xi, rows=None):
        states = self.formula(xi)
        fallen = np.abs(states).max(axis=1) > 5
        n = len(xi)
        return StepOutcomes(
            names=("a", "b"), states=states, endings=np.where(fallen, ENDINGS.index(Ending.FALL), 0), times=np.ones(n),
            step_lengths=np.ones(n), phases=np.ones(n, dtype=np.int64), impacts=np.zeros(n, dtype=np.int64),
            modes=(Mode.STICK,),
        )  # fmt: skip


def rotation(angle, factor):
    c, s = np.cos(angle), np.sin(angle)
    return lambda xi: factor * xi @ np.array([[c, s], [-s, c]])


@pytest.mark.parametrize("period", range(1, MAX_PERIOD + 1))
def test_cycle_has_its_period_and_one_name_wherever_it_is_entered(period):
    angle = 2 * np.pi / period
    cycle = (
        np.array([[np.cos(k * angle), np.sin(k * angle)] for k in range(period)]) if period > 1 else np.zeros((1, 2))
    )
    outcomes = follow(Map(rotation(angle, 1.0) if period > 1 else rotation(0, 0.5)), cycle, 200)
    assert set(outcomes.periods) == {period}
    gaits = []
    assert set(assign_gaits(outcomes, gaits, load_problem("compass-passive-a"))) == {0}
    assert gaits[0].count == len(cycle)


def test_a_spiral_is_no_cycle_a_walk_that_never_settles_is_undecided_and_one_that_falls_is_not():
    outcomes = follow(Map(rotation(2 * np.pi / 3, 0.8)), np.array([[1.0, 0.0], [0.3, 0.4]]), 200)
    assert outcomes.periods.tolist() == [1, 1]
    outcomes = follow(Map(rotation(1.0, 1.0)), np.array([[1.0, 0.0], [9.0, 0.0]]), 30)
    assert outcomes.endings.tolist() == [UNDECIDED, ENDINGS.index(Ending.FALL)]
    assert outcomes.steps.tolist() == [30, 0]


@pytest.mark.parametrize(("slope", "period"), [("3 deg", 1), ("4.6 deg", 2), ("4.95 deg", 4)])
def test_compass_doubles_its_period_as_the_slope_grows(slope, period):
    """Goswami, Thuilot & Espiau (1998): period 1 up to 4.37 deg, 2 up to 4.9 deg, then 4."""
    legs = {"leg_length": 1, "leg_com": 0.5, "leg_mass": 5, "hip_mass": 10, "slope": slope}
    walker = {f"walker.{key}": value for key, value in legs.items()}
    problem = load_problem("compass-passive-stick").replace({"friction": 3, **walker})
    rates = np.linspace(1.0, 1.3, 12)
    xi = np.column_stack([np.full(12, -0.31), rates, np.full(12, -0.15), np.zeros(12)])
    outcomes = follow(step_map(problem, None, Engine.HEYOKA), xi, 400)
    assert set(outcomes.periods) <= {0, period}
    gaits = []
    assign_gaits(outcomes, gaits, problem)
    (attractor,) = gaits
    assert str(attractor).startswith("sticking")
    gait = go.solve(attractor)
    assert len(gait.steps) == period
    assert gait.shooting.residual < 1e-10
    assert gait.spectral_radius < 1
    assert go.verify(gait).passed


def test_grid_over_something_else_or_that_does_not_fit_is_refused_before_it_starts(gait, tmp_path):
    with pytest.raises(UnknownNameError, match="friction: not a coordinate just after an impact; use theta1"):
        plan_in(tmp_path, gait, grid=Grid((Axis(key="friction", lower=0.1, upper=0.2, count=2),))).check()
    huge = Grid((Axis(key="dtheta1", lower=0.1, upper=1, count=10**7), Axis(key="dx", lower=0, upper=1, count=10**6)))
    with pytest.raises(StorageError, match=r"10,000,000,000,000 points need about .* TB on disk"):
        plan_in(tmp_path, gait, grid=huge).check()


def test_command_prints_one_object_and_draws_now_and_later(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    over = ["--over", "dtheta1=0.69:0.73:4", "--over", "dtheta2=-0.55:-0.48:3"]
    assert main(["basin", "compass-passive-a", *over, "--workers", "1", "--json", "--quiet"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["states"] == 12
    assert record["gaits"][0]["kind"] == "stick-slip"
    assert all((tmp_path / figure).stat().st_size > 1000 for figure in record["figures"])
    drawn = [(tmp_path / figure).read_bytes() for figure in record["figures"]]
    assert main(["plot", record["run"], "-o", "again"]) == 0
    assert [(tmp_path / "again" / figure.rpartition("/")[2]).read_bytes() for figure in record["figures"]] == drawn
    assert main(["plot", record["run"], "--what", "speed"]) == 2
    assert main(["solve", f"{record['run']}@attractor.0", "--json", "--quiet"]) == 0
    gait = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert gait["verification"]["passed"]
    assert gait["period"] == pytest.approx(named("compass-passive-a").period, rel=1e-9)
    assert main(["solve", f"{record['run']}@attractor.1"]) == 2
    assert main(["solve", f"{record['run']}@attractor.0", "--set", "friction=0.2"]) == 2


def test_basin_over_one_coordinate_is_a_strip_in_the_colour_of_each_state(basin):
    (first, _), labels = basin.grid.axes, basin.labels
    column = replace(basin, grid=Grid((first,)), labels=labels[:, 0], endings=basin.endings[:, 0])
    (axes,) = basin_figure(column).axes
    drawn = axes.collections[0].get_array()
    assert drawn.shape == (2, first.count)
    np.testing.assert_array_equal(drawn[0] == 0, labels[:, 0] == 0)
    assert axes.get_yticks().size == 0


@pytest.mark.parametrize(
    ("name", "over", "share"),
    [
        ("heel-toe", {"dtheta1": (1.13, 1.17, 2)}, 1.0),
        ("crawler", {"gap": (0.3, 0.6, 2)}, 1.0),
        ("slip-walk", {"dy": (-0.4, -0.39, 2)}, 0.0),  # unstable
    ],
)
def test_walkers_with_several_contacts_have_basins(name, over, share, tmp_path):
    """Walks go on from whole states: an impact may leave the section of the gait."""
    gait = named(name)
    result = go.basin(gait, over, steps=40, output=tmp_path, workers=1)
    (run, *others) = result.attractors or (None,)
    assert not others
    if run is None:
        assert share == 0
        assert sum(result.to_record()["failures"].values()) == result.grid.size
        return
    assert run.count / result.grid.size == share
    assert run.phases == gait.cycle.phases
    assert run.state == pytest.approx(gait.state, abs=1e-5)
    assert go.solve(run).state == pytest.approx(gait.state, abs=1e-10)


@pytest.mark.parametrize("engine", ["scipy", pytest.param("heyoka", marks=pytest.mark.slow)])
def test_a_basin_on_a_floor_holds_the_walks_over_its_tiles(engine, tmp_path):
    pytest.importorskip(engine)
    gait, floor = named("compass-passive-stick"), go.Floor(friction=[0.2, 0.134, 0.2])
    over = {"dtheta1": (gait.state[2] - 0.05, gait.state[2] + 0.05, 3)}
    result = go.basin(gait, over, floor=floor, engine=engine, workers=1, output=tmp_path, progress=False)
    stored = go.load_run(result.folder)
    assert (stored.floor, stored.to_record()) == (floor, result.to_record())
    plain = go.basin(gait, over, engine=engine, workers=1, output=tmp_path, progress=False)
    assert plain.floor is None
    assert plain.folder != result.folder
    for value, label, steps in zip(result.grid.axes[0].values, result.labels, result.steps, strict=True):
        walk = go.simulate(gait, {"dtheta1": float(value)}, steps=100, floor=floor)
        assert walk.completed == (label == 0)
        assert walk.completed or len(walk.complete_steps) == steps
