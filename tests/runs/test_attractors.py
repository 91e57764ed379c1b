"""What walks settle on: Lyapunov exponents against multipliers and against diverging walks, and folders that resume."""

import json
import re

import numpy as np
import pytest
from named import named

import gaitopt as go
from gaitopt.cli.main import main
from gaitopt.model.modes import Mode
from gaitopt.requests import Engine
from gaitopt.runs.attractors import gaits_on_branch
from gaitopt.runs.grid import Axis
from gaitopt.search.attractors import settled
from gaitopt.show.tables import printed
from gaitopt.verification.step_map import step_map

WHEEL = "rimless-wheel-slip"
CYCLES = ("compass-passive-a", "compass-passive-two-step", "compass-unequal")
FRICTIONS = {"friction": (0.36, 0.44, 2)}
FEW = {"starts": 3, "transient": 40, "keep": 6, "workers": 1, "progress": False}
GOSWAMI = """
name: goswami
walker: {model: compass_biped, leg_length: 1, leg_mass: 5, leg_com: 0.5, hip_mass: 10, gravity: 9.81, slope: 4.3 deg}
friction: 0.7
gait: {phases: [stick], impact: stick, guess: {state: {theta1: -0.29, dtheta1: 1.2, dtheta2: -0.4}}}
"""


def long_runs(gait, keep=20):
    mapped = step_map(gait.problem, None, Engine.SCIPY)
    indices = mapped.dynamics.system.section(Mode.SLIP_FORWARD).indices
    near = gait.state[indices] * (1 + 1e-3 * np.random.default_rng(0).standard_normal((2, 1)))
    near[:, -1] *= gait.problem.cycle.impact.slips
    return settled(mapped, near, transient=100, keep=keep)


@pytest.mark.parametrize(
    ("name", "error"), [(WHEEL, 1e-9), *(pytest.param(name, 1e-8, marks=pytest.mark.slow) for name in CYCLES)]
)
def test_the_exponent_of_a_cycle_is_the_logarithm_of_its_multiplier(name, error):
    """Also of slipping, of two-step and of unequal cycles."""
    gait = named(name)
    (run,), endings = long_runs(gait)
    assert (run.period_steps, run.starts, endings) == (len(gait.steps), 2, {})
    assert run.lyapunov == pytest.approx(np.log(gait.spectral_radius) / len(gait.steps), abs=error)


@pytest.mark.parametrize("engine", ["scipy", "heyoka"])
@pytest.mark.parametrize(
    "name", ["heel-toe", *(pytest.param(name, marks=pytest.mark.slow) for name in ("crawler", "inchworm"))]
)
def test_the_exponent_of_a_walker_with_several_contacts_is_the_logarithm_of_its_multiplier(name, engine):
    if engine == "heyoka":
        pytest.importorskip("heyoka")
    gait = named(name)
    mapped = step_map(gait.problem, None, Engine(engine))
    (run,), endings = settled(mapped, gait.state[None] * (1 + 1e-9), transient=20, keep=4)
    assert (run.period_steps, run.starts, endings) == (1, 1, {})
    assert run.lyapunov == pytest.approx(np.log(gait.spectral_radius), abs=1e-8)


def test_attractors_are_kept_read_back_and_drawn(tmp_path, monkeypatch):
    found = go.attractors(WHEEL, FRICTIONS, output=tmp_path, **FEW)
    for record in found.to_records():
        assert {*record} in ({"value", "states", "period_steps", "lyapunov", "starts"}, {"value", "ending", "starts"})
    assert [r["value"] for r in found.records] == [0.36, 0.44]
    runs = [run for record in found.records for run in record["attractors"]]
    assert {run["period_steps"] for run in runs} == {1}
    for record in found.records:
        gait = go.solve(go.load_problem(WHEEL).replace({"friction": record["value"]}), progress=False)
        (run,) = record["attractors"]
        assert run["lyapunov"] == pytest.approx(np.log(gait.spectral_radius), abs=1e-8)
        assert run["states"][0][0] == pytest.approx(gait.to_record()["state"]["dtheta"], abs=1e-6)
    monkeypatch.setattr("gaitopt.runs.attractors.settle_job", None)  # nothing is left to do
    again = go.attractors(WHEEL, FRICTIONS, output=tmp_path, **FEW)
    assert again.to_records() == found.to_records() == go.load_run(found.folder).to_records()
    assert found.plot("lyapunov").has_data()
    assert len(found.to_frame()) == 2


def test_the_command_prints_one_object_per_attractor_and_draws_over_a_branch(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["--over", "friction=0.36:0.44:2", "--starts", "2", "--transient", "40", "--keep", "4"]
    command = ["attractors", WHEEL, *words, "--workers", "1", "-o", "run", "--quiet"]
    assert main([*command, "--json"]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [record["value"] for record in records if "states" in record] == [0.36, 0.44]
    assert main(command) == 0
    table = capsys.readouterr().out
    assert "cycle of 1 step" in table
    folder = table.split("run: ")[1].strip()
    slopes = ["walker.slope=13deg:13.5deg:2" if word == words[1] else word for word in command]
    assert main(slopes) == 0
    assert re.search(r"walker\.slope \[deg\].*^  13   13\.5   cycle of 1 step", capsys.readouterr().out, re.M | re.S)
    few = ["--max-points", "3", "-o", "b", "--quiet"]
    assert main(["continue", WHEEL, "--param", "friction", "--to", "0.36", "--to", "0.44", *few]) == 0
    capsys.readouterr()
    assert main(["plot", folder, "--over", "b", "--what", "dtheta", "--format", "svg", "--quiet"]) == 0
    assert capsys.readouterr().out.strip() == f"{folder}/dtheta.svg"
    assert main(["plot", folder, "--over", "nosuch", "--quiet"]) == 2
    assert main(["plot", "b", "--over", "b", "--quiet"]) == 2


@pytest.mark.slow
def test_chaos_parts_neighbouring_walks_as_its_exponent_says():
    """Goswami's compass on 5.1 deg: the mean growth of small distances of pairs of walks, which share no derivative."""
    problem = go.parse_problem(GOSWAMI)
    walked = go.attractors(problem, {"walker.slope": ("5 deg", "5.1 deg", 2)}, starts=6, workers=1, progress=False)
    (chaos,) = (run for run in walked.records[-1]["attractors"] if run["period_steps"] is None)
    mapped = step_map(problem.replace({"walker.slope": "5.1 deg"}), None, Engine.SCIPY)
    units = mapped.dynamics.state_units[mapped.dynamics.system.section(Mode.SLIP_FORWARD).indices]
    growth, apart, state = list[float](), 1e-7, np.array(chaos["states"][-1])
    direction = np.random.default_rng(0).standard_normal(3)
    for _ in range(400):
        direction /= np.linalg.norm(direction)
        pair = mapped(np.array([state, state + apart * np.append(direction, 0.0) * units]))
        assert pair.completed.all()
        state, direction = pair.states[0], ((pair.states[1] - pair.states[0]) / units)[:3]
        growth.append(float(np.log(np.linalg.norm(direction) / apart)))
    assert chaos["lyapunov"] > 0.1
    assert np.mean(growth) == pytest.approx(chaos["lyapunov"], abs=0.04)


@pytest.mark.slow
def test_periods_double_where_multipliers_of_the_branch_pass_minus_one():
    """The first doubling of Goswami's compass, bracketed by the lengths of what walks settle on."""
    gait = go.solve(go.parse_problem(GOSWAMI), progress=False)
    branch = go.continuation(gait, "walker.slope", to=np.radians(4.6), progress=False)
    flip = branch.special("period_doubling")[0].value
    places = np.array([-4e-4, -2e-4, 2e-4, 4e-4]) + flip
    for value, steps in zip(places, (1, 1, 2, 2), strict=True):
        at = go.parse_problem(GOSWAMI).replace({"walker.slope": float(value)}).from_guess()
        near = next(p.gait for p in branch.points if p.value > np.radians(4.35))
        start = near.state[gait.system.section(Mode.SLIP_FORWARD).indices]
        runs, _ = settled(step_map(at, None, Engine.SCIPY), start[None], transient=400, keep=8)
        assert [run.period_steps for run in runs] == [steps]


SMALL_BASIN = {"friction": (0.1105, 0.115, 2)}
A = "compass-passive-a"


@pytest.mark.slow
def test_a_stable_gait_with_a_small_basin_is_an_attractor_though_random_walks_fall(tmp_path):
    """Between friction 0.1103 and 0.115 next to all random walks of this compass fall."""
    few = {"starts": 6, "transient": 100, "keep": 32, "workers": 1, "progress": False}
    found = go.attractors(A, SMALL_BASIN, output=tmp_path, **few)
    for record in found.records:
        gait = go.solve(go.load_problem(A).replace({"friction": record["value"]}), progress=False)
        run = record["attractors"][0]
        assert gait.stable
        assert run["period_steps"] == 1
        assert run["lyapunov"] == pytest.approx(np.log(gait.spectral_radius), abs=1e-6)
        assert record["endings"]
        assert sum(record["endings"].values()) + sum(r["starts"] for r in record["attractors"]) == 6
    table = printed(found)
    assert "starts that end" in table
    assert re.search(r"ends: fall \d+", table)


@pytest.mark.slow
def test_a_spiral_that_turns_in_eleven_cycles_is_no_cycle_of_eleven_steps():
    problem = go.load_problem(A).replace({"friction": 0.110583})
    gait = go.solve(problem, progress=False)
    start = gait.state[gait.system.section(Mode.SLIP_FORWARD).indices] * [1.003, 1, 1, 1]
    (run,), _ = settled(step_map(problem, None, Engine.SCIPY), start[None], transient=200, keep=64)
    assert (run.period_steps, run.starts) == (1, 1)
    assert run.lyapunov == pytest.approx(np.log(gait.spectral_radius), abs=1e-8)


@pytest.mark.slow
def test_an_unstable_gait_is_no_attractor_though_its_branch_leads_there():
    """Below friction 0.1103 the gait exists, but its largest multiplier is outside of the unit circle."""
    problem = go.load_problem(A)
    at = problem.replace({"friction": 0.1095})
    assert not go.solve(at, progress=False).stable
    axis = Axis(key="friction", lower=0.1095, upper=0.115, count=2)
    assert not [*gaits_on_branch(problem, axis, at, 0.1095)]
    assert [*gaits_on_branch(problem, axis, problem.replace({"friction": 0.115}), 0.115)]
