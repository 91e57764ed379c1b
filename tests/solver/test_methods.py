"""Newton's method and IPOPT lead to the same gaits; results say who found them."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from named import named

import gaitopt as go
from gaitopt.errors import UnknownNameError
from gaitopt.requests import Method
from gaitopt.search.candidates import cycle_record
from gaitopt.search.find import SearchPlan, gaits_of

SAME = 1e-9
"""Largest difference of states in natural units, and relative one of freed parameters."""
FLAT = {"compass-pd-slippery": 1e-7}
"""A design whose optimum is so flat that the optimality conditions, met to 1e-7, fix its parameters no better."""
QUICK = (
    *("compass-pd-impact-slip", "compass-torque-efficient", "compass-unequal", "heel-toe-slip", "kneed-passive"),
    "slip-run-foot",
)
"""Slip, flight, stops, named contacts, a law that tracks a reference, two steps, and a design."""
FOR_IPOPT = ("compass-passive-static-kinetic", "compass-push-off", "compass-torque-efficient", "hopper")
"""Gaits, one the start of a design, whose guess is too far away for Newton's method."""
FAR_FROM_SQP = ("compass-pd-robust", "compass-pd-slippery")
"""Designs whose guess is too far away for SQP, which ends at a gait that violates a bound; IPOPT finds the optimum."""
OPEN_LOOP = ("rabbit-optimal",)
"""Torques that a collocation finds, of which Newton's method knows nothing."""
PROBLEMS = [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in go.problem_names()]


def assert_same(first, second):
    atol = FLAT.get(first.problem.name, SAME)
    units = first.dynamics.state_units
    durations = ([duration for _, duration in gait.phases] for gait in (first, second))
    np.testing.assert_allclose(first.state / units, second.state / units, rtol=0, atol=atol)
    np.testing.assert_allclose(*durations, rtol=0, atol=atol)
    assert first.freed == pytest.approx(second.freed, rel=0, abs=atol)


@pytest.mark.parametrize("name", PROBLEMS)
def test_ipopt_finds_the_gait_of_every_named_problem(name):
    gait = go.solve(name, method="ipopt", progress=False)
    assert gait.converged, gait.message
    assert gait.solver["method"] == "ipopt"
    assert gait.solver["iterations"] > 0
    assert_same(gait, named(name))


@pytest.mark.slow
@pytest.mark.parametrize("name", [p for p in PROBLEMS if p.values[0] not in (*FOR_IPOPT, *FAR_FROM_SQP, *OPEN_LOOP)])
def test_newton_alone_finds_the_same_gait_and_design(name):
    gait = go.solve(name, method="newton", progress=False)
    assert gait.converged, gait.message
    assert gait.solver["method"] == "newton"
    assert_same(gait, named(name))


@pytest.mark.parametrize("name", [*FOR_IPOPT, *(pytest.param(name, marks=pytest.mark.slow) for name in OPEN_LOOP)])
def test_newton_alone_says_that_it_finds_nothing_and_auto_that_ipopt_does(name):
    gait = go.solve(name, method="newton", progress=False)
    assert gait.status is go.Status.NOT_CONVERGED
    assert gait.message.endswith("the methods auto and ipopt search farther")
    assert named(name).solver["method"] == "ipopt"


def test_newton_follows_the_gait_of_the_file_and_ipopt_begins_at_its_guess():
    problem = go.load_problem("compass-passive-a").replace({"friction": 0.135})
    followed, searched = (go.solve(problem, method=method, progress=False) for method in ("newton", "ipopt"))
    assert [gait.solver["method"] for gait in (followed, searched)] == ["newton", "ipopt"]
    assert_same(followed, searched)


@pytest.mark.parametrize("method", ["newton", "ipopt"])
def test_request_to_stop_ends_every_method(method):
    gait = go.solve("compass-passive-a", method=method, progress=False, should_stop=lambda: True)
    assert gait.status is go.Status.INTERRUPTED


def test_every_verb_refuses_a_wrong_method(tmp_path):
    words = "no method of solution is called 'simplex'; use auto, newton, ipopt"
    for verb in (go.solve, go.find, partial(go.sweep, over={"friction": (0.3, 0.4, 2)}, output=tmp_path)):
        with pytest.raises(UnknownNameError, match=words):
            verb("rimless-wheel-slip", method="simplex")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("method", [Method.NEWTON, Method.IPOPT])
def test_candidates_of_a_search_become_gaits_by_the_method(method):
    known = named("rimless-wheel-slip")
    wheel = known.problem.replace({"gait.phases": "auto"})
    candidate = cycle_record(known.system, known.steps, "known")
    results = [{"method": "simulation", "starts": 1, "candidates": [candidate]}]
    (gait,) = gaits_of(wheel, results, method=method)
    assert gait.solver["method"] == method
    assert_same(gait, known)


@pytest.mark.slow
@pytest.mark.usefixtures("empty_folder")
def test_search_and_open_modes_take_the_method(run):
    found = run("find", "rimless-wheel-slip", "--method", "ipopt", "--starts", "1", "--workers", "1", "--json")[1]
    assert json.loads(found)["gaits"][0]["solver"]["method"] == "ipopt"
    wheel = go.load_problem("rimless-wheel-slip").replace({"gait.phases": "auto"})
    assert go.solve(wheel, method="ipopt", progress=False).solver["method"] == "ipopt"


def test_parts_of_a_search_that_depend_on_the_method_have_keys_of_their_own():
    wheel = go.load_problem("rimless-wheel-slip").replace({"gait.phases": "auto"})
    plans = [SearchPlan(problem=wheel, method=method) for method in Method]
    assert len({plan.job(wheel, "simulation", 0).key for plan in plans}) == 1
    assert len({plan.job(wheel, "families", 0, "friction").key for plan in plans}) == len(plans)


@pytest.mark.usefixtures("empty_folder")
def test_command_takes_the_method_and_prints_who_found_the_gait(run):
    def solve(*options):
        return run("solve", "compass-passive-stick", *options)

    assert json.loads(solve("--method", "ipopt", "--json")[1])["solver"]["method"] == "ipopt"
    assert "found by Newton's method" in solve("--method", "newton")[1]
    code, _, words = solve("--method", "simplex")
    assert (code, "use auto, newton, ipopt" in words) == (2, True)
    code, _, words = solve("--method", "ipopt", "--starts", "2")
    assert (code, "leave out one of them" in words) == (2, True)
    over = ("--method", "ipopt", "--over", "friction=0.4:0.5:2", "--workers", "1")
    folder = Path(json.loads(run("sweep", "rimless-wheel-slip", *over, "--json")[1])["run"]).parent
    jobs = [json.loads(line) for line in (folder / "jobs.jsonl").read_text().splitlines()]
    assert [job["solver"]["method"] for job in jobs] == ["ipopt", "ipopt"]


def test_a_stored_gait_of_another_method_is_not_taken_for_it(tmp_path):
    by_newton = go.solve("compass-passive-stick", method="newton", output=tmp_path, progress=False)
    assert go.solve("compass-passive-stick", output=tmp_path, reuse=True).solver == by_newton.solver
    again = go.solve("compass-passive-stick", method="ipopt", output=tmp_path, reuse=True, progress=False)
    assert again.solver["method"] == "ipopt"
