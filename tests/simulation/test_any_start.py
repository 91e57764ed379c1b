"""Simulations from any state until a time: bodies without a gait, states between samples, impulses of all impacts."""

import json

import numpy as np
import pytest
from casadi import Function
from contact_walkers import Frame
from named import named

import gaitopt as go
from gaitopt import equations_of_motion
from gaitopt.cli.main import main
from gaitopt.errors import ProblemError, UnknownNameError
from gaitopt.model.transitions import Ending

B, H, MASS, LEAN = 0.1, 0.4, 2.0, 0.1
INERTIA = MASS * (B**2 + H**2) / 3
BLOCK = f"""
name: block
walker: {{model: frame, half: {B}, height: {H}, mass: {MASS}, inertia: {INERTIA}, gravity: 9.81,
  slope: 0}}
friction: 0.8
"""
LEANING = {
    "theta": LEAN, "x": 0.3, "y": H * np.cos(LEAN) + B * np.sin(LEAN), "dtheta": 0.0, "dx": 0.0, "dy": 0.0
}  # fmt: skip
FREE = """
name: free-wheel
walker: {model: rimless_wheel, spokes: 8, radius: 1, mass: 1, inertia_ratio: 0.5, gravity: 9.8, slope: 0.1}
friction: 0.5
state: {dtheta: 0.8}
until: {time: 3}
"""


@pytest.fixture(scope="module")
def block():
    return go.parse_problem(BLOCK, walkers=[Frame])


@pytest.fixture(scope="module")
def rocking(block):
    return go.simulate(block, LEANING, until=go.Until(time=0.8))


def end_of(walk):
    """The state at the end by name."""
    return dict(zip(walk.trajectory.names, walk.trajectory.final_state.tolist(), strict=True))


def apart(one, other, without=()):
    return max(abs(one[name] - other[name]) for name in one if name not in without)


def test_a_body_needs_walker_friction_and_state_alone(rocking):
    assert rocking.trajectory.ending is Ending.COMPLETED
    assert rocking.trajectory.duration == pytest.approx(0.8, abs=1e-15)
    assert [mode.brief for mode, _ in rocking.trajectory.steps[0].phases] == [
        "right stick",
        "left stick",
        "right stick",
    ]
    assert rocking.trajectory.at(0.0) == LEANING  # x as given
    assert rocking.to_record()["final_state"] == end_of(rocking)


@pytest.mark.parametrize("name", ["kneed-passive", "hopper", "heel-toe"])
def test_impulses_of_strikes_within_a_step_balance_momentum(name):
    """M (dq_plus - dq_minus) in x and y is the impulse of the ground: stops act between bodies."""
    walk = go.simulate(named(name), steps=2)
    walker, p = walk.system.walker, walk.p[: len(walk.system.walker.model_fields)]
    eom, n = equations_of_motion(walker), len(walker.shape)
    inertia = Function("M", [eom.z, eom.p], [eom.M])
    coordinates, order = walker.coordinates(), (*walker.shape, "x", "y")
    within = [impact for impact in walk.to_record()["impacts"] if impact["of"] != ["swing_foot"]]
    checked = 0
    began = np.cumsum([0.0, *(step.period for step in walk.trajectory.steps)])
    for impact in within:
        step = walk.trajectory.steps[impact["step"] - 1]
        start = impact["time"] - began[impact["step"] - 1]
        after = [arc for arc in step.arcs if abs(arc.start - start) < 1e-12 and arc.start > 0]
        before = [arc for arc in step.arcs if abs(arc.end - start) < 1e-12]
        if not after or not before:
            continue  # it ends the step, and the feet swap
        z = before[-1].states[-1]
        rates = (after[0].states[0] - z)[len(coordinates) :]
        change = np.array([rates[coordinates.index(key)] if key in coordinates else 0.0 for key in order])
        ground = np.asarray(inertia(z, p) @ change).ravel()[n:]
        impulses = impact["impulse"]
        pairs = [impulses] if "F_t" in impulses else impulses.values()
        total = [sum(pair[key] for pair in pairs) for key in ("F_t", "F_n")]
        assert ground == pytest.approx(total, abs=1e-12)
        checked += 1
    assert checked


@pytest.mark.parametrize("name", ["compass-passive-a", "hopper", "kneed-passive", "slip-run", "heel-toe", "bounding"])
@pytest.mark.parametrize("fraction", [0.2, 0.8, 1.3])
def test_a_state_at_any_time_is_that_of_a_simulation_to_that_time_and_starts_the_rest(name, fraction):
    gait = named(name)
    period = gait.measures["period"]
    walk, t = go.simulate(gait, until=go.Until(time=2.3 * period)), fraction * period
    state = walk.trajectory.at(t)
    assert apart(state, end_of(go.simulate(gait, until=go.Until(time=t)))) < 1e-11
    rest = go.simulate(gait, state, until=go.Until(time=2.3 * period - t))
    assert rest.trajectory.ending is Ending.COMPLETED
    assert apart(end_of(rest), end_of(walk)) < 1e-10


def test_a_long_motion_is_resolved_at_any_time(block):
    """A block that slides to rest: x = v t - mu g t^2 / 2."""
    sliding = {"theta": 0, "y": H, "dtheta": 0, "dx": 1.0, "dy": 0}
    walk = go.simulate(block.replace({"friction": 0.02}), sliding, until=go.Until(time=20))
    for t in (0.1, 1.7, 3.0, 4.9):
        assert walk.trajectory.at(t)["x"] == pytest.approx(t - 0.02 * 9.81 * t**2 / 2, abs=1e-12)
    stop = 1 / (0.02 * 9.81)
    assert walk.trajectory.at(15)["x"] == pytest.approx(stop / 2, abs=1e-10)
    assert [round(duration, 6) for _, duration in walk.trajectory.steps[0].phases] == [
        round(stop, 6), round(20 - stop, 6)
    ]  # fmt: skip


def test_both_engines_end_at_the_same_state(block):
    pytest.importorskip("heyoka", reason="needs pip install '.[fast]'")
    one, other = (go.simulate(block, LEANING, until=go.Until(time=np.float64(1.5)), engine=engine)
                  for engine in ("scipy", "heyoka"))  # fmt: skip
    assert apart(end_of(one), end_of(other)) < 1e-11
    assert len(one.to_record()["impacts"]) == len(other.to_record()["impacts"]) == 4


def test_a_number_of_events_ends_a_motion_before_the_next_one(rocking, block):
    walk = go.simulate(block, LEANING, until=go.Until(events=1))
    assert walk.trajectory.duration == rocking.to_record()["impacts"][0]["time"]
    steps = go.simulate("compass-passive-a", until=go.Until(events=4)).trajectory
    assert len(steps.steps) == 2
    assert [len(step.phases) for step in steps.steps] == [3, 1]
    both = go.simulate("compass-passive-a", until=go.Until(steps=1, time=100.0))
    assert (len(both.complete_steps), both.completed) == (1, True)


def test_a_file_without_a_gait_is_simulated_and_nothing_else(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "free.yaml").write_text(FREE)
    assert main(["simulate", "free.yaml", "--json", "-o", "run"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["status"], record["steps"], record["time"]) == ("completed", 2, pytest.approx(3, abs=1e-12))
    stored = go.load_run("run").to_record()
    assert stored["impacts"] == record["impacts"]
    assert main(["simulate", "free.yaml", "--events", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["steps"] == 2
    assert main(["simulate", "free.yaml", "--state", "theta=0.1,dtheta=0.5,dx=0", "--time", "0.1"]) == 0
    assert "state at the end" in capsys.readouterr().out
    for command in ("solve free.yaml", "verify free.yaml", "find free.yaml", "explain free.yaml"):
        assert main([*command.split(), "--quiet"]) == 3
        assert "free-wheel: gait: is missing; only simulate works without one" in capsys.readouterr().err
    for command in ("validate free.yaml", "show free.yaml"):
        assert main(command.split()) == 0


def test_a_walk_with_strikes_within_its_steps_is_read_as_it_was_written(rocking, tmp_path):
    go.simulate(rocking.problem, LEANING, until=go.Until(time=0.8), output=tmp_path / "run")
    again = go.load_run(tmp_path / "run", walkers=[Frame])
    assert again.to_record() == rocking.to_record()
    problem = rocking.problem
    assert go.Problem is type(problem)
    assert not problem.has_gait
    assert problem.replace({"until": {"time": 2}}).until == go.Until(time=2.0)


@pytest.mark.parametrize(
    ("state", "options", "words"),
    [
        (LEANING, {}, "a step of the frame never ends, since it has no landing contacts; end the simulation"),
        ({"theta": 0.1}, {"until": go.Until(time=1)}, "state: y, dtheta, dy, dx is missing; without the modes"),
        (LEANING | {"y": np.nan}, {"until": go.Until(time=1)}, "state y = nan: is not a number"),
        (LEANING, {"until": go.Until(time=1), "steps": 2}, "steps = 2 and until = .*: give one of them"),
        (LEANING, {"until": 2.0}, r"until is 2.0, but must be Until\(time=SECONDS\)"),
    ],
)  # fmt: skip
def test_a_start_or_an_end_that_does_not_suffice_is_named(block, state, options, words):
    with pytest.raises(ProblemError, match=words):
        go.simulate(block, state, **options)


def test_an_impossible_state_of_a_walker_on_one_foot_is_named():
    gait = named("slip-run-foot")
    whole = dict(zip(gait.system.state_names, gait.state.tolist(), strict=True))
    for change in ({"y": -0.1}, {"y": 0.0, "dy": -1.0}):
        with pytest.raises(ProblemError, match="the foot is below the ground or moves into it"):
            go.simulate(gait, whole | change, until=go.Until(time=0.1))
    with pytest.raises(ProblemError, match=r"state y = 0\.1: the compass_biped has no flight phase"):
        go.simulate("compass-passive-a", {"y": 0.1})
    with pytest.raises(UnknownNameError, match="state knee: no coordinate of this walker; the section is theta1"):
        go.simulate("compass-passive-a", {"knee": 0.1})
    with pytest.raises(ProblemError, match=r"time 9 s is outside of the motion, which lasts from 0 to 0\.77"):
        go.simulate("compass-passive-a").trajectory.at(9)
    with pytest.raises(ProblemError, match="stored without samples; simulate it with dense=True"):
        go.simulate("compass-passive-a", dense=False).trajectory.at(0.3)


@pytest.mark.parametrize("limits", [{}, {"time": 0.0}, {"events": 0}, {"steps": 1.5}, {"time": "1"}, {"time": np.inf}])
def test_a_wrong_limit_is_named(limits):
    with pytest.raises(ProblemError, match=f"until{'.' + next(iter(limits)) if limits else ''}: "):
        go.Until(**limits)


def test_shares_of_an_impulse_that_are_open_are_null_and_an_impact_at_the_start_counts(block, tmp_path):
    flat = {"theta": 0, "y": H + 0.05, "dtheta": 0, "dx": 0.0, "dy": 0}
    (landing,) = go.simulate(block, flat, until=go.Until(time=0.3)).to_record()["impacts"]
    assert landing["of"] == ["left", "right"]
    assert landing["time"] == pytest.approx(np.sqrt(2 * 0.05 / 9.81), rel=1e-12)
    assert [impulse["F_t"] for impulse in landing["impulse"].values()] == [None, None]
    assert [impulse["F_n"] for impulse in landing["impulse"].values()] == pytest.approx(
        [MASS * np.sqrt(2 * 0.05 * 9.81) / 2] * 2
    )
    walk = go.simulate(block, LEANING | {"dy": -0.5}, until=go.Until(time=0.3), output=tmp_path / "run")
    first, _ = walk.to_record()["impacts"]
    assert (first["time"], first["of"], [*first["impulse"]]) == (0.0, ["right"], ["right"])
    assert go.load_run(tmp_path / "run", walkers=[Frame]).to_record() == walk.to_record()
