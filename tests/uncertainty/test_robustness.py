"""Every figure of the robustness of a gait is what plain simulation, or a closed form, says."""

import json
from itertools import chain, product, repeat
from math import asin, cos, pi, sin, sqrt
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from named import named
from samples import sampled
from scipy.optimize import brentq

import gaitopt as go
from gaitopt import Floor, load_problem, load_run, robustness, simulate, solve, verify
from gaitopt.cli.main import main
from gaitopt.errors import GaitoptError, ProblemError
from gaitopt.gait.measures import measure
from gaitopt.problem.floor import QUANTITIES, RandomFloor
from gaitopt.simulation.engine import choose_engine, is_installed
from gaitopt.simulation.simulator import Simulator
from gaitopt.uncertainty import falls as falls_module
from gaitopt.uncertainty import limits
from gaitopt.uncertainty.derivatives import OUTPUTS
from gaitopt.uncertainty.falls import count_falls, mean_steps, metastable
from gaitopt.uncertainty.interval import stable_interval
from gaitopt.uncertainty.limits import limit, nearest_failure, patch_limit, push_limit
from gaitopt.uncertainty.norm import norm_of_walks, sensitivity_norm
from gaitopt.verification.tiled_walks import TiledWalks

needs_heyoka = pytest.mark.skipif(not is_installed(), reason="many walks need heyoka")
ENGINE = choose_engine("auto", steps=1_000_000)


def comes_back(gait, floor=None, state=None, steps=400):
    """Whether a plain simulation returns to the gait."""
    walk = simulate(gait, state, steps=steps, floor=floor, dense=False)
    at = gait.system.section(gait.cycle).indices
    distance = np.abs(walk.trajectory.section_states - gait.state)[:, at] / gait.dynamics.state_units[at]
    return bool((distance[8:].max(axis=1) < 1e-6).any())


def patch(nominal, length, value):
    return Floor(friction=[nominal, *[value] * length, nominal])


@pytest.mark.parametrize("value", [0.1234, 0.9934])
def test_a_limit_is_the_last_value_before_the_first_failure(value):
    found = limit(lambda values: values < value, 0.0, 0.01, 1.0)
    assert 0 <= value - found.value < 1e-9
    assert limit(lambda values: np.abs(values - value) > 1e-4, 0.0, 0.01, 1.0).value is None


@pytest.mark.slow
@pytest.mark.parametrize(("length", "about"), [(1, 0.1328), (4, 0.1366)])
@needs_heyoka
def test_a_patch_of_ice_survives_at_its_limit_and_fails_below(length, about):
    gait, nominal = named("compass-passive-stick"), 0.2
    found = patch_limit(gait, "friction_low", length, ENGINE).value
    assert found == pytest.approx(about, abs=5e-5)
    assert comes_back(gait, patch(nominal, length, found), steps=150)
    assert not comes_back(gait, patch(nominal, length, found - 1e-6), steps=150)


def wheel(slope=0.1):
    """A wheel on ground that it cannot slip on, its half angle, inertia about the foot and 2 g / (r ratio)."""
    gait = solve(load_problem("rimless-wheel-stick").replace({"friction": 3.0, "walker.slope": slope}))
    p = gait.problem.walker
    ratio = 1 + p.inertia_ratio
    return gait, p, pi / p.spokes, ratio, 2 * p.gravity / (p.radius * ratio)


def test_a_wheel_is_pushed_back_as_far_as_it_still_passes_the_top():
    gait, p, a, _, pull = wheel()
    least = sqrt(pull * (1 - cos(a - p.slope)))
    found = push_limit(gait, "dtheta", -1, ENGINE).value
    assert found == pytest.approx(least - gait.state[2], abs=2e-9)


def test_a_wheel_climbs_the_step_after_which_it_still_passes_the_top():
    gait, p, a, ratio, pull = wheel()

    def excess(rise):
        landing = a - asin(rise / (2 * p.radius * sin(a)))
        square = gait.state[2] ** 2 + pull * (cos(a - p.slope) - cos(landing + p.slope))
        after = square * ((cos(2 * a) + p.inertia_ratio) / ratio) ** 2
        return after - pull * (1 - cos(landing - 2 * a + p.slope))

    highest = brentq(excess, 0.0, 0.2, xtol=1e-14)
    assert patch_limit(gait, "step_up", 1, ENGINE).value == pytest.approx(highest, abs=2e-9)


@needs_heyoka
@pytest.mark.slow
def test_the_nearest_state_does_not_return_and_one_a_little_nearer_does():
    gait = named("compass-passive-a")
    distance, state = nearest_failure(gait, ENGINE)
    section = gait.system.section(gait.cycle)
    at = {name: gait.state[k] for name, k in zip(section.names, section.indices, strict=True)}
    nearer = {name: at[name] + (value - at[name]) * (1 - 1e-6) for name, value in state.items()}
    units = gait.dynamics.state_units[section.indices]
    assert np.linalg.norm([state[name] - at[name] for name in at] / units) == pytest.approx(distance)
    assert not comes_back(gait, state=state)
    assert comes_back(gait, state=nearer)


@pytest.mark.parametrize(
    ("name", "quantity"),
    sampled(product(["compass-passive-stick", "compass-passive-a", "compass-unequal"], QUANTITIES), every=4),
)
def test_the_sensitivity_norm_is_that_of_differences_of_walks(name, quantity):
    """One tile under each step of the cycle differs; the sums are over 40 steps, after which no deviation is left."""
    gait, h = named(name), {"friction": 1e-6, "height": 2e-8, "slope": 1e-6}[quantity]
    n, squares = len(gait.steps), list[np.ndarray]()
    known = [k for k, key in enumerate(OUTPUTS) if key != "cone_distance"]

    def outputs(change, tile):
        nominal = gait.dynamics.static_friction if quantity == "friction" else 0.0
        values = [nominal] * tile + [nominal + change, nominal]
        steps = Simulator(gait.dynamics, floor=Floor(**{quantity: values})).run(gait.state, steps=40, dense=True).steps
        return np.array([[measure([step])[OUTPUTS[k]] for k in known] for step in steps])

    for tile in range(n, 2 * n):
        changes = (outputs(h, tile) - outputs(-h, tile)) / (2 * h)
        squares.append((changes**2).sum(axis=0))
    norms = [sensitivity_norm(gait)[quantity][OUTPUTS[k]] for k in known]
    assert norms == pytest.approx(np.sqrt(np.mean(squares, axis=0)), rel=1e-3, abs=1e-5)


@pytest.mark.parametrize(
    ("name", "quantity"),
    [
        ("rimless-wheel-stick", "height"),
        pytest.param("compass-passive-a", "friction", marks=pytest.mark.slow),
        pytest.param("compass-unequal", "slope", marks=pytest.mark.slow),
    ],
)
def test_the_norm_from_differences_of_walks_has_the_exact_derivatives(name, quantity):
    """The norm of walkers with several contacts, of walkers on one foot, whose derivatives are exact."""
    exact, from_walks = sensitivity_norm(named(name))[quantity], norm_of_walks(named(name), quantity)
    for output in OUTPUTS:
        assert (exact[output] is None) == (from_walks[output] is None)
        assert exact[output] is None or from_walks[output] == pytest.approx(exact[output], rel=1e-6, abs=1e-6)


@pytest.mark.slow
def test_a_walker_with_heels_and_toes_has_a_sensitivity_norm():
    """The norm of height is that of a plain simulation of a walk over one tile that is a little higher."""
    gait, h = named("heel-toe"), 1e-6
    periods = [
        [step.period for step in simulate(gait, steps=40, floor=Floor(height=[0, rise, 0])).trajectory.steps]
        for rise in (h, -h)
    ]
    change = np.subtract(*periods) / (2 * h)
    assert sensitivity_norm(gait)["height"]["period"] == pytest.approx(np.sqrt((change**2).sum()), rel=1e-5)


def test_the_distance_to_the_cone_of_a_wheel_has_its_closed_form():
    """It is least just after the impact, where neither the force nor the state depends on the friction of a tile."""
    gait = named("rimless-wheel-stick")
    arc = gait.steps[0].arcs[0]
    distance = gait.dynamics.margins(arc.mode, 0, arc.times, arc.states)
    names = gait.system.transitions.margin_names(arc.mode)
    forces = distance[:, names.index("normal_force")]
    least = int(np.argmin(np.minimum(*(distance[:, names.index(k)] for k in ("cone_forward", "cone_backward")))))
    assert sensitivity_norm(gait)["friction"]["cone_distance"] == pytest.approx(forces[least], rel=1e-6)
    assert sensitivity_norm(gait)["friction"]["period"] == 0


@needs_heyoka
@pytest.mark.slow
@pytest.mark.parametrize(("quantity", "size"), [("friction", 2e-5), ("height", 1e-7), ("slope", 2e-5)])
def test_small_random_floors_change_period_and_step_length_by_the_norm(quantity, size):
    """A million steps; the state of a walk forgets its floor within some tens of steps."""
    gait, walks, steps = named("compass-passive-a"), 1000, 1050
    center = gait.dynamics.static_friction if quantity == "friction" else 0.0
    noise = np.random.default_rng(1).standard_normal((walks, steps + 1)) * size + center
    walking = TiledWalks(gait.dynamics, np.tile(gait.state, (walks, 1)), {quantity: noise}, ENGINE)
    seen = []
    while walking.steps < steps:
        _, outcomes = walking.step()
        seen.append([outcomes.times, outcomes.step_lengths])
    spread = np.array(seen[50:]).transpose(1, 0, 2).reshape(2, -1).std(axis=1) / size
    norms = sensitivity_norm(gait)[quantity]
    assert spread == pytest.approx([norms["period"], norms["step_length"]], rel=0.02)


def test_the_mean_of_walks_that_do_not_all_fall_is_that_of_a_constant_chance():
    random = np.random.default_rng(3)
    true = random.geometric(1 / 200, 4000) - 1.0
    completed = np.where(true < 300, true, -300.0)
    mean, (low, high) = mean_steps(completed)
    assert low < 199 < high
    assert mean == pytest.approx(199, rel=0.05)
    assert mean_steps(np.full(10, -50.0))[0] is None
    assert mean_steps(np.full(10, -50.0))[1][1] is None


@needs_heyoka
@pytest.mark.slow
def test_falls_of_two_seeds_and_the_metastable_eigenvalue_agree(tmp_path):
    gait, intervals = named("compass-passive-a"), []
    record = robustness(gait, what="falls", walks=20, workers=1, output=tmp_path, progress=False).to_record()["falls"]
    assert {*record} >= {"mean_steps", "interval", "eigenvalue", "floor", "seed"}
    assert record["floor"] == "friction=0.112:0.168"
    for seed in (1, 2):
        floor = RandomFloor.parse("friction=0.136:0.144", seed)
        completed, _ = count_falls(gait, floor, walks=400, steps=1000, engine=ENGINE)
        intervals.append(mean_steps(completed)[1])
        known = metastable(gait, floor, ENGINE)
        assert 1 / (1 - known["eigenvalue"]) == pytest.approx(known["mean_steps"], rel=1e-6)
        low, high = known["interval"]
        assert 1 < high / low < 1.6
        assert high > intervals[-1][0]
        assert low < intervals[-1][1]
    assert intervals[0][0] < intervals[1][1]
    assert intervals[1][0] < intervals[0][1]


@needs_heyoka
@pytest.mark.slow
def test_weighted_walks_are_precise_where_plain_walks_seldom_fall():
    """The test takes two minutes of one core."""
    floor = RandomFloor.parse("friction=0.1372:0.1428", 1)
    low, high = metastable(named("compass-passive-a"), floor, ENGINE)["interval"]
    assert 1 < high / low < 2.5
    assert low < 18_390  # the interval of plain walks, with 74 falls in 987,935 steps
    assert high > 9_960


class WheelOnSteps:
    """Steps of a wheel over tiles of other heights in closed form, in place of those of the simulator.

    The square of its rate at the top, T, falls below 0 where it does not pass the top.
    """

    def __init__(self, slope):
        self.gait, self.p, self.a, self.ratio, self.pull = wheel(slope)
        self.kept = ((cos(2 * self.a) + self.p.inertia_ratio) / self.ratio) ** 2

    def __call__(self, dynamics, **_):
        return self

    def landing(self, rise):
        return self.a - np.arcsin(rise / (2 * self.p.radius * sin(self.a)))

    def lost(self, angle):
        return self.pull * (1 - np.cos(angle + self.p.slope))

    def step(self, n, states, under, ahead, first):
        top, landing = states[:, 2] ** 2 - self.lost(states[:, 0]), self.landing(ahead["height"] - under["height"])
        after = states.copy()
        after[:, 0] = landing - 2 * self.a
        after[:, 2] = np.sqrt(self.kept * np.maximum(top + self.lost(landing), 0.0))
        return SimpleNamespace(states=after, completed=top >= 0)

    def falling_share(self, most, nodes=1001, tiles=24):
        """1 - the metastable eigenvalue on tiles of height -most to most, where T' = kept T + b(tile, next)."""
        points, weights = np.polynomial.legendre.leggauss(tiles)
        landing = self.landing(most * (points[None, :] - points[:, None]))
        b = self.kept * self.lost(landing) - self.lost(landing - 2 * self.a)
        top = np.linspace(0, b.max() / (1 - self.kept), nodes)
        after = (self.kept * top + b[:, :, None]) / top[1]  # in nodes; axes: tile, next tile, node
        at = np.clip(np.floor(after).astype(int), 0, nodes - 2)
        part, survives = np.clip(after - at, 0, 1), after >= 0
        density = np.ones((tiles, nodes)) / (tiles * nodes)
        for _ in range(150):
            flow = density[:, None, :] * weights[None, :, None] / 2 * survives
            new = np.array([
                np.bincount(at[:, k].ravel(), (flow * (1 - part))[:, k].ravel(), nodes)
                + np.bincount(at[:, k].ravel() + 1, (flow * part)[:, k].ravel(), nodes)
                for k in range(tiles)
            ])  # fmt: skip
            share, density = (
                float((density[:, None, :] * weights[None, :, None] / 2 * ~survives).sum()),
                new / new.sum(),
            )
        return share


@pytest.mark.slow
@pytest.mark.parametrize(("most", "mean"), [(0.05, 1.7e4), (0.045, 1.8e7)])
def test_the_metastable_eigenvalue_of_a_wheel_is_that_by_quadrature(most, mean, monkeypatch):
    """Also where no plain walk falls, and on a mesh with cells of twice the size."""
    closed_form = WheelOnSteps(slope=0.06)
    monkeypatch.setattr(falls_module, "TiledSteps", closed_form)
    share = closed_form.falling_share(most)
    assert 1 / share == pytest.approx(mean, rel=0.1)
    for cell in (0.6, 0.3):
        monkeypatch.setattr(falls_module, "CELL", cell)
        found = metastable(closed_form.gait, RandomFloor.parse(f"height=-{most}:{most}"), ENGINE)
        low, high = found["interval"]
        assert low < 1 / share < high
        assert low < found["mean_steps"] < high
    assert high / low < 4  # with cells of the size that is used


@pytest.mark.parametrize(("coordinates", "quantities"), [(2, 1), (4, 2), (4, 3)])
def test_a_mesh_has_at_most_the_allowed_number_of_cells(coordinates, quantities):
    """Also where the tiles, which are divided into eight parts per quantity, would have more cells of their own."""
    random, walks = np.random.default_rng(1), 2 * falls_module.WALKS
    states, tiles = random.standard_normal((walks, coordinates)), random.random((walks, quantities))
    cells = falls_module._cells(states, tiles, np.full(walks, 1 / walks), falls_module.MOST_CELLS)
    assert falls_module.MOST_CELLS / 4 < cells.max() + 1 <= falls_module.MOST_CELLS


def test_resampling_keeps_the_weight_of_each_cell_and_no_walk_has_much_of_it():
    random, walks = np.random.default_rng(1), falls_module.WALKS
    cells, weights = np.arange(walks) // 4, 10 ** random.uniform(-20, 0, walks)
    weights /= weights.sum()
    chosen, shares, of = falls_module._resampled(cells, weights, random)
    assert (cells[chosen] == of).all()
    assert np.bincount(of, shares) == pytest.approx(np.bincount(cells, weights), rel=1e-12)
    assert np.bincount(of).min() >= falls_module.FEWEST_WALKS
    assert shares.max() < 2 / walks
    strata = falls_module._strata(of, random.random(of.size), np.lexsort((random.random(of.size), of)))
    sizes = np.bincount(of)
    intervals = np.floor(strata * sizes[of]) + (np.cumsum(sizes) - sizes)[of]
    assert np.unique(intervals).size == of.size


@needs_heyoka
def test_an_eigenvalue_that_is_not_known_has_a_reason(monkeypatch):
    for name, value in {"WALKS": 500, "MOST_CELLS": 250, "HEAVY": 0.4 / 500, "BLOCK": 20}.items():
        monkeypatch.setattr(falls_module, name, value)
    monkeypatch.setattr(falls_module, "TRANSIENT", 0)
    closed_form = WheelOnSteps(slope=0.06)
    monkeypatch.setattr(falls_module, "TiledSteps", closed_form)
    found = metastable(closed_form.gait, RandomFloor.parse("height=-0.001:0.001"), ENGINE)
    assert found["eigenvalue"] is None
    assert "falls are impossible or extremely rare; none of 500 walks over 100 tiles at the ends" in found["reason"]
    monkeypatch.setattr(falls_module, "TRANSIENT", 10)
    monkeypatch.setattr(falls_module, "MOST_CELLS", 1)  # by which falls are missed that are one of 1e7
    found = metastable(closed_form.gait, RandomFloor.parse("height=-0.045:0.045"), ENGINE)
    assert "falls are extremely rare; " in found["reason"]
    stumbling, falls = WheelOnSteps(slope=0.06), chain([1], repeat(0))  # one walk falls, in the first step
    stumbling.step = lambda n, z, *_: SimpleNamespace(states=z, completed=np.arange(len(z)) >= next(falls))
    monkeypatch.setattr(falls_module, "TiledSteps", stumbling)
    found = metastable(stumbling.gait, RandomFloor.parse("height=-0.001:0.001"), ENGINE)
    assert found["reason"].startswith("no walk fell in the last 80 steps, although")
    assert "falls are extremely rare; none of 500" in found["reason"]
    monkeypatch.setattr(falls_module, "MOST_COORDINATES", 0)
    found = metastable(closed_form.gait, RandomFloor.parse("height=-0.001:0.001"), ENGINE)
    assert found["reason"] == "the section has 1 coordinate, but a mesh fills at most 0"
    assert (
        "1 coordinate,"
        in go.Robustness(
            problem=closed_form.gait.problem,
            figures={
                "falls:0": {"completed": [-5.0], "endings": {}, "floor": "height=-0.001:0.001", "seed": 0},
                "eigenvalue": found,
            },
        )
        .report()
        .text
    )


@pytest.mark.parametrize("text", ["friction=0.1:0.2", "friction=normal(0.02, 0.02)"])
def test_quantiles_are_those_of_the_numbers_that_are_drawn(text):
    spread = RandomFloor.parse(text).spreads["friction"]
    drawn = np.sort(spread.draw(np.random.default_rng(0), 20_000, 0.0))
    shares = np.linspace(0.0, 1.0, drawn.size)
    assert spread.quantiles(shares, 0.0) == pytest.approx(drawn, abs=0.03 * np.ptp(drawn))


@pytest.mark.slow
def test_the_range_has_a_stable_gait_everywhere_inside_and_none_just_outside():
    start = named("compass-passive-a")
    found = stable_interval(start, "friction")
    assert (found.high, found.high_end, found.low_end) == (None, "none", "neimark_sacker")
    points = [*go.continuation(start, "friction", to=0.1).points, *go.continuation(start, "friction", to=0.3).points]

    def gait_at(friction):
        """The gait of the family, with the modes of a neighbour."""
        for point in sorted(points, key=lambda point: abs(point.value - friction))[:12]:
            problem = start.problem.with_gait(point.gait.to_record()).replace({"friction": float(friction)})
            gait = solve(problem, progress=False)
            if gait.converged:
                return gait
        return None

    for friction in np.linspace(found.low + 1e-6, 0.3, 50):
        gait = gait_at(friction)
        assert gait.stable
        assert verify(gait).passed
    outside = gait_at(found.low - 1e-6)
    assert outside is None or not outside.stable


@needs_heyoka
def test_the_command_prints_the_stated_keys_and_resumes(run, empty_folder, monkeypatch):
    for name, value in {"PUSH_STEP": 0.05, "GROWTH": 4.0, "WIDTH": 1e-3, "DISTANCE": 1e-3}.items():
        monkeypatch.setattr(limits, name, value)
    arguments = ["robustness", "rimless-wheel-stick", "--what", "push,sensitivity", "--random", "friction=0.3:2",
                 "--walks", "20", "--steps", "50", "--workers", "1", "-o", "run", "--json", "--quiet"]  # fmt: skip
    code, out, _ = run(*arguments)
    record = json.loads(out)
    assert code == 0
    assert {"problem", "push", "nearest", "sensitivity", "run"} == {*record}
    assert {*record["push"]} == {"dtheta"}
    assert {*record["sensitivity"]["height"]} == {*OUTPUTS}
    code, again, _ = run(*arguments)
    assert (code, json.loads(again)) == (0, record)
    assert run("report", record["run"])[0] == 0
    text = (Path(record["run"]) / "report.html").read_text()
    assert "norm from height to period" in text
    assert "data:image/svg+xml" in text
    result = load_run(record["run"])
    assert result.to_record() == {key: value for key, value in record.items() if key != "run"}
    assert len(result.to_frame()) > 15


@pytest.mark.parametrize(
    ("make", "words", "code"),
    [
        (lambda: robustness(named("compass-torque-impact-slip"), progress=False), "is unstable", 4),
        (lambda: robustness(named("compass-passive-a"), what="ice", progress=False), "what is 'ice'", 2),
        (lambda: robustness(named("compass-torque-impact-slip"), what="ice", progress=False), "what is 'ice'", 2),
        (lambda: robustness(named("compass-passive-a"), what=5, progress=False), "what is 5, but must be a text", 2),
        (lambda: robustness(named("crawler"), what="sensitivity", progress=False), "no landing ends a step", 3),
        (lambda: robustness(named("compass-passive-a"), random="friction=1", progress=False), "no distribution", 3),
        (lambda: robustness(named("compass-passive-a"), walks=1, progress=False), "walks is 1", 2),
        (lambda: robustness(named("compass-passive-a"), over="ice", what="range", progress=False), "ice", 2),
    ],
)
def test_wrong_questions_are_refused(make, words, code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(GaitoptError) as error:
        make()
    assert words in str(error.value)
    assert error.value.exit_code == code


def test_falls_that_an_earlier_version_stored_as_one_figure_are_read():
    falls = {"mean_steps": 34.0, "interval": [4.6, 6783.0], "eigenvalue": 0.925, "floor": "friction=0.1:0.2", "seed": 0}
    result = go.Robustness(problem=go.load_problem("compass-passive-a"), figures={"falls": falls})
    assert result.to_record()["falls"] == falls
    assert "6783" in result.report().text
    with pytest.raises(ProblemError, match="only patches and pushes have figures"):
        result.plot()


@needs_heyoka
@pytest.mark.slow
def test_a_dask_scheduler_computes_the_same_figures(tmp_path):
    asked = {
        "what": "push,sensitivity,falls",
        "random": "height=-0.1:0.1",
        "walks": 600,
        "steps": 60,
        "progress": False,
    }
    gait, _, _, _, _ = wheel()
    serial = robustness(gait, workers=1, output=tmp_path / "serial", **asked)
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        far = robustness(gait, scheduler=cluster.scheduler_address, output=tmp_path / "far", **asked)
    assert far.to_record() == serial.to_record()
    assert far.to_record()["falls"]["mean_steps"] is not None


def test_the_table_says_how_a_norm_was_found():
    sensitivity = {"height": dict.fromkeys(OUTPUTS, 1.0)}
    for name, words in (("compass-passive-a", "derivatives of the walk"), ("heel-toe", "differences of walks")):
        result = go.Robustness(problem=go.load_problem(name), figures={"sensitivity": sensitivity})
        assert words in result.report().text


def test_an_unstable_gait_is_printed_as_json_before_exit_code_4(tmp_path, capsys):
    named("compass-torque-impact-slip").save(tmp_path / "run")
    assert main(["robustness", str(tmp_path / "run"), "--json", "--quiet"]) == 4
    printed = capsys.readouterr()
    record = json.loads(printed.out)
    assert record["spectral_radius"] == pytest.approx(1.157, abs=1e-3)
    assert record["message"] in printed.err
    assert "is unstable, its spectral radius is 1.156" in printed.err


def test_the_norm_of_a_gait_with_feedback_from_step_to_step_is_that_of_differences():
    text = "{type: constant_torque, ankle: 0.45, hip: 0.12, step_feedback: {design: {lqr: {}}}}"
    source = load_problem("compass-torque-impact-slip").text
    stated = "{type: constant_torque, ankle: 0.45, hip: 0.12}"
    assert stated in source
    gait, h = solve(go.parse_problem(source.replace(stated, text))), 1e-6
    nominal = gait.dynamics.static_friction

    def outputs(change):
        walk = Simulator(gait.dynamics, floor=Floor(friction=[nominal, nominal + change, nominal]))
        return np.array([[step.period, step.final_impact.step_length] for step in walk.run(gait.state, steps=60).steps])

    changes = (outputs(h) - outputs(-h)) / (2 * h)
    norms = sensitivity_norm(gait)["friction"]
    assert [norms["period"], norms["step_length"]] == pytest.approx(np.sqrt((changes**2).sum(axis=0)), rel=1e-5)
