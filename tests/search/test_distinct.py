"""Candidates of a search, counted once: cycles without repetitions, from one of their states, and gaits behind them."""

from dataclasses import replace

import pytest
from named import named, verification

from gaitopt.search.candidates import cycle_record
from gaitopt.search.find import gaits_of


@pytest.fixture(scope="module")
def gait():
    return named("rimless-wheel-stick").verified(verification("rimless-wheel-stick").to_record())


def part(candidates, method="simulation"):
    return {"method": method, "starts": len(candidates), "candidates": candidates}


def test_a_gait_walked_several_times_is_the_candidate_of_one_step(gait):
    once = cycle_record(gait.system, gait.steps, "a")
    assert cycle_record(gait.system, gait.steps * 3, "a") == once
    assert len(once["steps"]) == 1


def test_a_candidate_closes_the_problem_with_its_motion(gait):
    problem = gait.problem.with_gait(cycle_record(gait.system, gait.steps, "a"))
    assert problem.cycle == gait.problem.cycle
    assert problem.guess.durations == pytest.approx([duration for _, duration in gait.phases])


def test_starts_that_lead_to_a_known_gait_are_counted_with_it(gait):
    candidates = [cycle_record(gait.system, gait.steps, name) for name in "ab"]
    open_problem = gait.problem.replace({"gait.phases": "auto"})
    gaits = gaits_of(open_problem, [part(candidates)], known=[gait])
    assert gaits.starts == (("a", "b"),)
    assert gaits.searched["starts"] == {"simulation": 2}


def test_a_gait_that_the_simulator_refutes_is_rejected(gait):
    refuted = replace(gait, verification={"passed": False})
    open_problem = gait.problem.replace({"gait.phases": "auto"})
    gaits = gaits_of(open_problem, [part([cycle_record(gait.system, gait.steps, "a")])], known=[refuted])
    assert not gaits
    assert gaits.searched["rejected"][0]["reason"] == "the simulator does not confirm it"
