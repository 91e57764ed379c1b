"""Feedback from step to step: designs of its gains, closed-loop multipliers by three methods, walks, families."""

from functools import cache

import numpy as np
import pytest
from named import named, solved
from orbit_files import changed, differing, written
from samples import sampled

import gaitopt as go
from gaitopt.gait.gait import floquet_multipliers, multiplier_distance
from gaitopt.problem.floor import RandomFloor
from gaitopt.problem.problem import restore_problem
from gaitopt.requests import Engine
from gaitopt.simulation.engine import is_installed
from gaitopt.simulation.simulator import Simulator
from gaitopt.systems import build_system
from gaitopt.uncertainty.falls import count_falls
from gaitopt.uncertainty.norm import sensitivity_norm
from gaitopt.verification.return_map import ReturnMap

NAME = "compass-torque-impact-slip"
"""Unstable: its spectral radius is 1.157."""


def with_feedback(feedback, name=NAME, **changes):
    return go.load_problem(name).replace({"control.step_feedback": feedback, **changes})


@cache
def closed(design):
    return solved(with_feedback({"design": design}))


@pytest.mark.parametrize(("design", "radius"), sampled([("lqr", 0.786), ("deadbeat", 0.0), ("minimum_radius", 0.3)], 2))
def test_closed_loop_multipliers_are_those_of_the_linearised_map_and_of_the_saltation_product(design, radius):
    opened, gait = named(NAME), closed(design)
    known = gait.system.control.step_feedback.known
    linear = go.return_map_derivatives(opened, known.keys)
    by_gains = floquet_multipliers(linear.A + linear.B @ known.gains)
    section = gait.system.section(gait.cycle)
    mapped = ReturnMap(Simulator(gait.dynamics), section)
    by_saltation = floquet_multipliers(mapped.jacobian(mapped(gait.state[section.indices]).steps))
    tolerance = 1e-9 if design == "lqr" else 1e-5  # a multiple multiplier is the root of its rounding
    assert multiplier_distance(gait.multipliers, by_gains) < tolerance
    assert multiplier_distance(gait.multipliers, by_saltation) < tolerance
    assert opened.spectral_radius == pytest.approx(1.157, abs=1e-3)
    if design == "lqr":
        assert gait.spectral_radius == pytest.approx(radius, abs=1e-3)
    else:
        assert gait.spectral_radius < max(radius, 1e-5)
    np.testing.assert_allclose(gait.state, opened.state, atol=1e-11)


def test_the_orbit_file_states_the_correction_and_its_multipliers():
    data = written(closed("lqr"))
    assert differing(data) == []
    assert differing(changed(data, "statement/control/feedback", lambda _: {})) == ["multipliers"]


def test_a_gait_with_feedback_is_verified_and_walks_from_beside_it():
    gait = closed("lqr")
    assert go.verify(gait).passed
    beside = {"theta1": 1.02 * gait.state[0]}
    for start, returns in ((gait, True), (named(NAME), False)):
        walk = go.simulate(start, beside, steps=60)
        near = len(walk.trajectory.steps) == 60
        near = near and bool(np.abs(walk.trajectory.section_states[-1] - gait.state).max() < 1e-6)
        assert near is returns


def corrected(walk, key):
    """The values of a parameter in the steps of a walk."""
    return [step.arcs[0].dynamics.parameter(key) for step in walk.trajectory.steps]


def test_limits_bound_the_corrected_parameters():
    gait, key = closed("lqr"), "control.hip"
    hip = gait.dynamics.parameter(key)
    limits = {"design": "lqr", "limits": {key: [hip - 0.01, hip + 0.02]}}
    limited = go.solve(with_feedback(limits), progress=False)
    for each, bounded in ((limited, True), (gait, False)):
        used = corrected(go.simulate(each, {"theta1": 1.02 * gait.state[0]}, steps=5), key)
        assert all(hip - 0.01 - 1e-12 <= value <= hip + 0.02 + 1e-12 for value in used) is bounded
    with pytest.raises(go.GaitoptError, match="must contain the nominal value"):
        go.solve(with_feedback({"design": "lqr", "limits": {key: [hip + 1, hip + 2]}}), progress=False)


@pytest.mark.parametrize("engine", ["scipy", "heyoka"])
def test_the_correction_of_a_walk_is_the_stated_one(engine):
    pytest.importorskip(engine)
    gait = closed("lqr")
    known, indices = gait.system.control.step_feedback.known, gait.system.section(gait.cycle).indices
    walk = go.simulate(gait, {"theta1": 1.01 * gait.state[0]}, steps=3, engine=engine)
    deviations = np.array([step.arcs[0].states[0][indices] for step in walk.trajectory.steps]) - known.state
    for key, row in zip(known.keys, known.gains, strict=True):
        assert corrected(walk, key) == pytest.approx(gait.dynamics.parameter(key) + deviations @ row, abs=1e-12)


def test_many_states_at_once_are_corrected_like_one():
    pytest.importorskip("heyoka")
    gait = closed("lqr")
    xi = gait.state[gait.system.section(gait.cycle).indices]
    starts = xi + 0.003 * np.random.default_rng(0).normal(size=(20, xi.size)) * np.abs(xi)
    one, many = (go.return_map(gait, starts, engine=engine) for engine in ("scipy", "heyoka"))
    assert one.completed.all()
    assert many.completed.all()
    np.testing.assert_allclose(one.states, many.states, atol=1e-11)


def test_gains_and_state_keep_their_values_along_a_family():
    gait, key = closed("lqr"), "control.hip"
    known = gait.system.control.step_feedback.known
    end = go.continuation(gait, "friction", to=0.19, progress=False).points[-1].gait
    deviation = end.state[gait.system.section(gait.cycle).indices] - known.state
    assert np.abs(deviation).max() > 1e-5
    stated = gait.dynamics.parameter(key) + known.gains[known.keys.index(key)] @ deviation
    assert end.arcs[0].dynamics.parameter(key) == pytest.approx(stated, abs=1e-10)
    assert go.verify(end).passed
    followed = go.solve(gait.problem.replace({"friction": 0.19}), progress=False)
    np.testing.assert_allclose(followed.state, end.state, atol=1e-9)
    assert followed.problem.nominal.digest == gait.problem.nominal.digest
    assert build_system(followed.problem) is build_system(gait.problem)
    from_file = gait.problem.from_guess()  # as if a file stated it
    assert from_file.replace({"friction": 0.19}).followed_from == from_file


def test_a_design_finds_the_least_gain_for_a_spectral_radius():
    entries, key = {"theta1": {"free": [0, 80], "guess": 20}}, "control.step_feedback.gains.control.hip.theta1"
    asked = {"objective": {key: 1.0}, "constraints": {"spectral_radius": {"max": 0.9}}}
    gait = solved(with_feedback({"gains": {"control.hip": entries}}, **asked))
    assert gait.spectral_radius == pytest.approx(0.9, abs=1e-8)
    linear = go.return_map_derivatives(named(NAME), ["control.hip"])
    gains = np.zeros((1, len(linear.names)))
    gains[0, 0] = gait.freed[key]
    assert np.abs(np.linalg.eigvals(linear.A + linear.B @ gains)).max() == pytest.approx(0.9, abs=1e-7)


def test_a_problem_with_feedback_is_stored_and_restored(tmp_path):
    gait = closed("lqr")
    again = restore_problem(gait.problem.resolved())
    assert again.digest == gait.problem.digest
    slippery = restore_problem(gait.problem.replace({"friction": 0.19}).resolved())
    assert slippery.nominal.digest == gait.problem.nominal.digest
    gait.save(tmp_path / "run")
    loaded = go.load_run(tmp_path / "run")
    assert loaded.spectral_radius == pytest.approx(gait.spectral_radius, abs=1e-12)
    np.testing.assert_allclose(loaded.state, gait.state, atol=1e-12)


@pytest.mark.parametrize(
    ("feedback", "words"),
    [
        ({"gains": {"control.knee": {"theta1": 1}}}, "control.knee is no parameter of the law"),
        ({"gains": {"control.hip": {"theta3": 1}}}, "theta3 is no coordinate of the section, which has theta1"),
        ({"gains": {"control.hip": {"theta1": "much"}}}, "gains.control.hip.theta1: 'much' is not a number"),
        ({"gains": {"control.hip": {"theta1": -2e9}}}, "hip.theta1: -2000000000.0 must be at least -1e\\+09"),
        ({"gains": {"control.hip": {"theta1": {"free": [0, 1], "guess": 2}}}}, "theta1.guess: 2 is outside of its"),
        (
            {"gains": {"control.hip": {"theta1": {"free": [0, 2e9], "guess": 2}}}},
            "theta1.free\\[1\\]: 2000000000.0 must be",
        ),
        ({"gains": {"control.hip": 1}}, "give the gains of a parameter by coordinate"),
        ({"gains": {}}, "has no entry"),
        ({"design": "lqr", "corrects": []}, "names no parameter"),
        ({"gains": {"control.hip": {"theta1": 1}}, "limits": {"control.ankle": [0, 1]}}, "ankle is not corrected"),
        ({"design": "lqr", "gains": {"control.hip": {"theta1": 1}}}, "give either gains"),
        ({"design": "lqr", "limits": {"control.hip": [1, 0]}}, "is empty: the lower limit comes first"),
        ({"design": {"lqr": {"Q": {"theta3": 1}}}}, "no weight of theta3"),
        ({"design": {"best": {}}}, "unknown key"),
        ({"design": "deadbeat", "corrects": ["control.ankle", "control.knee"]}, "control.knee is no parameter"),
    ],
)
def test_bad_feedback_is_refused_in_one_sentence(feedback, words):
    with pytest.raises(go.GaitoptError, match=words):
        go.solve(with_feedback(feedback), progress=False)


def test_what_does_not_know_the_feedback_says_so():
    curves = {"curve": {"degree": 3, "start": "compass-passive-stick"}, "beyond_end": "hold"}
    changes = {"control.reference": curves, "control.step_feedback": {"design": "lqr"}}
    with pytest.raises(go.GaitoptError, match="some are unknowns of a design"):
        go.load_problem("compass-pd-designed").replace(changes)
    pytest.importorskip("flint")
    proof = go.prove(closed("lqr"), progress=False)
    assert not proof.proved
    assert "feedback from step to step is not covered" in proof.to_record()["claims"][0]["words"]


def assert_mapped_alike(gait, walk, engines=("scipy", "heyoka"), floor=None, tolerance=1e-11):
    """Assert that the return map in other engines leads to where a walk of one cycle has come."""
    indices = gait.system.section(gait.cycle).indices
    for engine in engines[: 1 + is_installed()]:
        mapped = go.return_map(gait, [walk.start[indices]], engine=engine, floor=floor)
        np.testing.assert_allclose(mapped.states[0, :-1], walk.section_states[-1][indices], atol=tolerance)
        assert mapped.times[0] == pytest.approx(walk.duration, abs=tolerance)


def test_a_cycle_of_two_steps_is_corrected_once():
    problem = go.load_problem("compass-torque-stick")
    state = {name: problem.guess.state[name] for name in ("theta1", "dtheta1", "dtheta2")}
    steps = {"steps": [{"phases": ["stick"], "impact": "stick"}] * 2, "guess": {"state": state}}
    opened = go.solve(problem.replace({"gait": steps}), progress=False)
    gait = go.solve(opened.problem.replace({"control.step_feedback": {"design": "lqr"}}), progress=False)
    known = gait.system.control.step_feedback.known
    linear = go.return_map_derivatives(opened, known.keys)
    assert multiplier_distance(gait.multipliers, floquet_multipliers(linear.A + linear.B @ known.gains)) < 1e-9
    assert go.verify(gait).passed
    hips = corrected(go.simulate(gait, {"theta1": 1.01 * gait.state[0]}, steps=3), "control.hip")
    assert hips[0] == hips[1] != hips[2]
    for floor in (None, go.Floor(height=[0, 1e-4, -1e-4, 0])):
        walk = go.simulate(gait, {"theta1": 1.001 * gait.state[0]}, steps=2, floor=floor).trajectory
        assert_mapped_alike(gait, walk, floor=floor)


TWO_REFERENCES = """
name: two-references
walker: {model: compass_biped, leg_length: 1.6, leg_mass: 4, leg_com: 0.8, hip_mass: 2, gravity: 9.8, slope: 1 deg}
friction: 0.6
control:
  type: pd
  kp: 0.5
  kd: 0.1
  reference: {bezier: {theta2: [0, 0.1]}, duration: 0.7, beyond_end: hold}
  other_reference: {bezier: {theta2: [0, 0.12]}, duration: 0.7, beyond_end: hold}
  step_feedback: {gains: {control.reference.theta2.0: {theta1: 5}, control.other_reference.theta2.1: {dtheta1: 0.2}}}
gait:
  steps: [{phases: [stick], impact: stick}, {phases: [stick], impact: stick}]
  guess: {state: {theta1: -0.147, dtheta1: 0.739, dtheta2: -0.525}}
"""


@cache
def with_two_references():
    return go.solve(go.parse_problem(TWO_REFERENCES), progress=False)


@pytest.mark.slow
def test_the_orbit_file_exchanges_the_parameters_that_feedback_corrects():
    data = written(with_two_references())
    assert differing(data) == []
    assert differing(changed(data, "statement/exchanged", lambda _: {}))


@pytest.mark.parametrize(
    ("engines", "floor", "tolerance"),
    [
        (("scipy",), None, 1e-11),
        *(
            pytest.param(("scipy", "heyoka"), floor, 1e-7, marks=pytest.mark.slow)
            for floor in (None, go.Floor(height=[0, 1e-9, 0]))
        ),
    ],
)
def test_parameters_that_are_exchanged_within_the_cycle_are_corrected_in_both_steps(engines, floor, tolerance):
    """A walk corrects them and then exchanges them; a return map corrects entries that are exchanged already."""
    gait = with_two_references()
    assert go.verify(gait).passed
    walk = go.simulate(gait, {"theta1": 1.003 * gait.state[0]}, steps=2).trajectory
    assert_mapped_alike(gait, walk, engines, floor, tolerance)


@pytest.mark.slow
def test_exchanged_parameters_are_corrected_in_the_norm():
    gait, change = with_two_references(), 1e-5
    periods = [step.period for step in gait.steps]
    squares = list[float]()
    for tile in (3, 4):
        walk = go.simulate(gait, floor=go.Floor(height=[0.0] * tile + [change] + [0.0] * 40), steps=40).trajectory
        squares.append(sum((step.period - periods[n % 2]) ** 2 for n, step in enumerate(walk.steps)))
    norm = sensitivity_norm(gait)["height"]["period"]
    assert np.sqrt(np.mean(squares)) / change == pytest.approx(norm, rel=1e-3)


def test_the_sensitivity_norm_is_that_of_the_closed_loop():
    gait, change = closed("lqr"), 1e-5
    norm = go.robustness(gait, what="sensitivity", progress=False).to_record()["sensitivity"]["friction"]["period"]
    friction = gait.dynamics.parameter("friction")
    tiles = [friction] * 3 + [friction + change] + [friction] * 60
    walk = go.simulate(gait, floor=go.Floor(friction=tiles), steps=60)
    periods = np.array([step.period for step in walk.trajectory.steps])
    assert np.sqrt(((periods - gait.period) ** 2).sum()) / change == pytest.approx(norm, rel=1e-3)


@pytest.mark.slow
def test_the_optimum_of_the_robot_is_stabilised_and_verified():
    """Without feedback the radius is 492, and deviations grow 4,000-fold in a step: the gains cancel this."""
    made = go.stabilise("rabbit-optimal", law="step_feedback", progress=False)
    assert made.gait.spectral_radius < 0.9
    assert go.verify(made.gait).passed


@pytest.mark.slow
@pytest.mark.parametrize(("spread", "falls"), [("friction=0.53:0.6", {}), ("friction=0.4:0.6", {"lift_off": 1000})])
def test_the_robot_walks_a_hundred_steps_on_a_thousand_random_floors(spread, falls):
    """Its impact sticks above friction 0.4713; with less the landing foot slips forward, and then lifts off."""
    pytest.importorskip("heyoka")
    keys = ["control.reference.swing_hip.3", "control.reference.swing_knee.3"]
    gait = go.solve(with_feedback({"design": "lqr", "corrects": keys}, "rabbit-hzd"), progress=False)
    completed, endings = count_falls(
        gait, RandomFloor.parse(spread, seed=1), walks=1000, steps=100, engine=Engine.HEYOKA
    )
    assert endings == falls
    assert (completed == -100).all() == (not falls)
