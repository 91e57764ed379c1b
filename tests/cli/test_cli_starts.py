"""``gaitopt solve`` from known gaits and from sampled guesses."""

import json
from pathlib import Path

import pytest

from gaitopt.problem.problem import Problem, load_problem
from gaitopt.runs import jobs as solved
from gaitopt.runs.multistart import Optimum

WHEEL = "rimless-wheel-slip"

pytestmark = pytest.mark.usefixtures("empty_folder")


def test_starts_are_counted_the_best_gait_is_that_of_the_problem_and_none_is_done_again(run, monkeypatch):
    words = ("solve", WHEEL, "--starts", "4", "--workers", "1", "--spread", "0.05")
    code, out, _ = run(*words, "--json")
    record = json.loads(out)
    assert (code, record["starts"]) == (0, 4)
    assert sum(len(optimum["starts"]) for optimum in record["optima"]) == 4
    assert record["run"] == f"results/{WHEEL}-{load_problem(WHEEL).hash8}"
    assert json.loads((Path(record["run"]) / "gait.json").read_text())["status"] == "converged"
    monkeypatch.setattr(solved, "solve_job", None)
    assert json.loads(run(*words, "--json")[1])["optima"] == record["optima"]
    assert "4 starts: 4 found a gait, 1 of them distinct" in run(*words)[1]


def test_starts_are_sampled_as_they_are_solved(run, monkeypatch):
    sampled = []
    replace = Problem.replace
    monkeypatch.setattr(Problem, "replace", lambda *arguments: sampled.append(arguments) or replace(*arguments))

    def second_is_interrupted(problem, *_):
        if len(sampled) > 1:
            raise KeyboardInterrupt
        return {"status": "not_converged", "message": "", "start": "cold"}

    monkeypatch.setattr(solved, "solve_job", second_is_interrupted)
    assert run("solve", WHEEL, "--starts", "100000", "--workers", "1")[0] == 130
    assert len(sampled) == 2


def test_starts_that_find_nothing_are_not_converged(run):
    code, out, _ = run("solve", "rimless-wheel-stick", "--set", "friction=0.5", "--starts", "2", "--workers", "1")
    assert code == 4
    assert "2 starts: 0 found a gait" in out


def test_gait_of_a_run_or_a_point_of_a_branch_is_the_guess(run):
    folder = json.loads(run("solve", WHEEL, "--json")[1])["run"]
    code, out, _ = run("solve", "rimless-wheel-slope", "--start", folder, "--json")
    assert (code, json.loads(out)["speed"]) == (0, pytest.approx(0.8, abs=1e-9))
    _, out, _ = run(
        "continue", folder, "--param", "walker.slope", "--to", "0.235", "--max-points", "4", "-o", "branch", "--json"
    )
    point = [json.loads(line) for line in out.splitlines()][-2]
    place = f"branch@{point['branch']}.{point['index']}"
    code, out, _ = run("solve", "rimless-wheel-slope", "--start", place, "-o", "other", "--json")
    assert code == 0
    assert json.loads(out)["parameters"]["walker.slope"] == pytest.approx(0.23577, abs=1e-4)
    code, _, err = run("solve", WHEEL, "--start", "branch@7.7")
    assert (code, "the branch has no point 7.7; its points are 0.0 to" in err) == (2, True)


def test_where_the_objective_does_not_decide_stable_gaits_come_first():
    problem = load_problem("rimless-wheel-stick")

    def optimum(objective, radius):
        record = {"solver": {"objective": objective}, "spectral_radius": radius, "verification": {"passed": True}}
        return Optimum(record=record, problem=problem, starts=(0,))

    ranked = sorted(
        [optimum(1.0, 2.44), optimum(1.0 + 1e-9, 0.586), optimum(0.9, 3.0)], key=lambda optimum: optimum.rank
    )
    assert [entry.radius for entry in ranked] == [3.0, 0.586, 2.44]
