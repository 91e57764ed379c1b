"""Candidates of a search, counted once: cycles without repetitions, from one of their states, and gaits behind them."""

from io import StringIO

import pytest
from named import named, verification
from rich.console import Console

from gaitopt.search.candidates import cycle_record
from gaitopt.search.find import gaits_of
from gaitopt.show.tables import print_gaits


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


def test_a_gait_that_the_simulator_refutes_is_rejected_with_the_claims_that_do_not_hold_and_their_outcomes(gait):
    changes = {
        "period": {"figure": 2e-7, "passed": False, "outcome": "fails"},
        "multipliers": {"figure": None, "passed": False, "outcome": "not_examined", "note": "the wheel falls"},
        "perturbation": {"figure": None, "passed": False, "outcome": "no_linear_range", "note": "too bent"},
    }
    claims = [claim | changes.get(claim["name"], {}) for claim in gait.verification["claims"]]
    refuted = gait.verified({**gait.verification, "passed": False, "claims": claims})
    open_problem = gait.problem.replace({"gait.phases": "auto"})
    gaits = gaits_of(open_problem, [part([cycle_record(gait.system, gait.steps, "a")])], known=[refuted])
    assert not gaits
    (rejected,) = gaits.searched["rejected"]
    assert rejected["reason"].startswith("the simulator does not confirm it: period: fails (2e-07, limit 1e-09)")
    assert "; multipliers: not examined, the wheel falls" in rejected["reason"]
    assert rejected["reason"].endswith("; perturbation: no linear range, too bent")
    console = Console(file=StringIO(), width=1000)
    print_gaits(console, gaits.to_record())
    assert rejected["reason"] in console.file.getvalue()
