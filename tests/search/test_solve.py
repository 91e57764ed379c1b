"""One ``solve``: a named gait stays itself when its parameters change, whoever asks for it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from samples import sampled

from gaitopt import Gait, Problem, load_problem, parse_problem, solve, sweep
from gaitopt.api.stored import save
from gaitopt.problem.problem import restore_problem
from gaitopt.runs.jobs import solve_job
from gaitopt.runs.results import restore_gait
from gaitopt.solver import newton
from gaitopt.solver.following import follow
from gaitopt.solver.solve import solve_gait
from gaitopt.systems import build_system

PASSIVE, FREE_SLOPE = "compass-passive-a", {"free": [0.01, 0.03], "guess": 0.02}
CHANGED = {
    "two values, and another gait near the guess": ("compass-passive-stick", {"friction": 0.6, "walker.slope": 0.07}),
    "a slope of 3 deg": ("compass-passive-a", {"walker.slope": 0.05235987755982989}),
    "another mass": ("compass-passive-b", {"walker.hip_mass": 2.5}),
    "torques": ("compass-torque-slip", {"control.hip": 0.7, "friction": 0.13}),
    "a law that tracks a reference": ("compass-pd-impact-slip", {"friction": 0.14}),
    "a wheel": ("rimless-wheel-slip", {"friction": 0.38}),
    "two steps": ("compass-passive-two-step", {"walker.slope": 0.085}),
    "the end of the family": ("compass-passive-stick", {"friction": 0.16}),
    "not enough energy": ("rimless-wheel-stick", {"walker.slope": 0.01}),
}
"""Problems with other values than in their files."""


def digits(record: dict) -> dict:
    """What must not depend on the caller: everything but where and how long it was computed."""
    kept = {key: value for key, value in record.items() if key not in ("run", "start", "at", "job", "verification")}
    return json.loads(json.dumps(kept | {"solver": record["solver"].get("iterations")}))


QUICK = "a law that tracks a reference"


@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n == QUICK else pytest.mark.slow) for n in CHANGED])
@pytest.mark.usefixtures("empty_folder")
def test_command_library_sweep_and_worker_agree_to_the_last_digit(name, run):
    file, changes = CHANGED[name]
    problem = load_problem(file).replace(changes)
    expected = digits(solve(problem, progress=False).to_record())
    options = [part for key, value in changes.items() for part in ("--set", f"{key}={value!r}")]
    code, out, _ = run("solve", file, *options, "--json")
    assert code == (0 if expected["status"] == "converged" else 4)
    assert digits(json.loads(out)) == expected
    assert digits(solve_job(problem)) == expected
    axis, value = next(reversed(changes.items()))
    others = {key: v for key, v in changes.items() if key != axis}
    base = load_problem(file).replace(others) if others else load_problem(file)
    middle = (load_problem(file).parameters[axis] + value) / 2
    for workers in (1, 2):
        swept = sweep(base, {axis: (middle, value, 2)}, workers=workers, output=f"s{workers}", progress=False)
        last = swept.records[-1]
        if last["start"] == "scan":  # which finds at once that a place has no gait
            assert last["status"] == expected["status"] == "infeasible"
        else:
            assert digits(last) == expected


@pytest.mark.parametrize("name", sampled(CHANGED, 7))
def test_the_last_bits_of_a_changed_value_do_not_decide_the_outcome(name):
    file, changes = CHANGED[name]
    gaits = list[Gait]()
    for bits in (-2, -1, 0, 1, 2):
        moved = {key: value + bits * float(np.spacing(value)) for key, value in changes.items()}
        gaits.append(solve(load_problem(file).replace(moved), progress=False))
    first = gaits[0]
    for gait in gaits:
        assert gait.status == first.status
        assert [cause.what for cause in gait.causes] == [cause.what for cause in first.causes]
        if first.converged:
            assert gait.state == pytest.approx(first.state, abs=1e-10)
            assert gait.spectral_radius == pytest.approx(first.spectral_radius, abs=1e-8)


def test_the_long_gait_stays_long_on_a_steeper_slope_until_its_family_ends_at_a_place_for_a_reason():
    problem = load_problem("compass-passive-stick").replace({"walker.slope": "3deg", "friction": 0.4})
    assert solve(problem.from_guess()).spectral_radius > 1  # the short, unstable gait of another family
    gait = solve(problem)
    assert gait.measures["period"] == pytest.approx(0.7878093885, abs=1e-9)
    assert gait.spectral_radius < 1
    assert "followed from the gait of the problem's file" in gait.message
    assert solve(load_problem("rimless-wheel-stick").replace({"walker.slope": "13.1deg"})).message == "solved"
    gait = solve(load_problem("compass-passive-stick").replace({"friction": 0.16}))
    assert not gait.converged
    assert "ends near friction = 0.1749" in gait.message
    assert "needs friction 0.1749" in gait.message
    assert gait.causes


def test_a_long_step_to_another_solution_of_the_equations_is_no_end_of_the_family(monkeypatch):
    """From a coarse mesh it ends where the first slip has no length; the gait slips for 84 ms."""
    monkeypatch.setattr(newton, "REFINEMENT_RESERVE", 4.0)
    first = solve_gait(load_problem("compass-torque-slip"), build_system(load_problem("compass-torque-slip")))
    gait = follow(first, first.problem.replace({"friction": 0.106}))
    assert gait.converged, gait.message
    assert gait.phases[0][1] == pytest.approx(0.08359469, abs=1e-8)


def test_the_result_does_not_depend_on_what_was_solved_or_interrupted_before():
    problem = load_problem("compass-passive-a").replace({"friction": 0.13})
    first = solve(problem)
    solve(load_problem("compass-passive-a").replace({"friction": 0.16}))
    assert solve(problem, should_stop=lambda: True).status == "interrupted"
    assert np.array_equal(solve(problem).state, first.state)


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        (PASSIVE, {"gait.phases": "auto"}),
        (PASSIVE, {"gait.phases": ["slip_forward", "stick"]}),
        (PASSIVE, {"impact_law": "frictionless"}),
        (PASSIVE, {"gait.guess.state.theta1": -0.14, "friction": 0.16}),
        (PASSIVE, {"friction": {"static": 0.15, "kinetic": 0.14}}),
        (PASSIVE, {"walker.slope": FREE_SLOPE, "friction": 0.15, "constraints": {"speed": 0.4}}),
        ("rimless-wheel-stick", {"walker.spokes": 9}),
        ("crawler", {"friction": 0.5}),  # one for all contacts
    ],
)
def test_only_other_values_of_parameters_keep_the_gait_of_the_file(name, overrides):
    problem = load_problem(name).replace(overrides)
    assert problem.followed_from is None
    assert problem.from_guess().digest == problem.digest != load_problem(name).digest


def test_changes_one_after_the_other_are_followed_from_the_file():
    first = load_problem(PASSIVE)
    assert first.replace({"friction": first.friction}) == first
    changed = first.replace({"friction": 0.13}).replace({"walker.slope": 0.02})
    assert changed.followed_from == first
    assert changed.replace({"friction": 0.14, "walker.slope": first.parameters["walker.slope"]}) == first


def test_the_digest_covers_where_a_gait_is_followed_from():
    text = load_problem(PASSIVE).text
    here = parse_problem(text).replace({"friction": 0.13})
    elsewhere = parse_problem(text.replace("friction: 0.14", "friction: 0.15")).replace({"friction": 0.13})
    alone = parse_problem(text.replace("friction: 0.14", "friction: 0.13"))
    assert here.parameters == elsewhere.parameters == alone.parameters
    assert len({here.digest, elsewhere.digest, alone.digest}) == 3
    assert here.from_guess().digest == alone.digest


def test_a_restored_problem_is_followed_from_the_same_place_and_one_of_an_earlier_version_from_none(tmp_path):
    problem = load_problem("compass-passive-stick").replace({"friction": 0.4, "walker.slope": "3deg"})
    restored = restore_problem(problem.resolved())
    assert restored.digest == problem.digest
    assert restored.followed_from.parameters == load_problem("compass-passive-stick").parameters
    gait = solve(problem)
    save(gait, tmp_path / "run")
    again: Problem = restore_gait(tmp_path / "run").problem
    assert again.digest == problem.digest
    assert np.array_equal(solve(again).state, gait.state)
    record = problem.resolved()
    del record["followed_from"]
    restored = restore_problem(record)
    assert restored.followed_from is None
    assert replace(restored, text="").digest == restored.digest
