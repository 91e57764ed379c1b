"""The library keeps what the commands keep, in the same folders, and takes names and paths as they do."""

import json
from pathlib import Path

import numpy as np
import pytest
from named import named

import gaitopt as go
from gaitopt.errors import GaitoptError, ProblemError, SolveError, StorageError, UnknownNameError
from gaitopt.gait.branch import SpecialPoint
from gaitopt.store.run import Run

WHEEL = "rimless-wheel-slip"
TARGET = 0.41

pytestmark = pytest.mark.usefixtures("empty_folder")


def test_a_gait_is_verified_and_kept_where_the_command_keeps_it(run):
    gait = go.solve(WHEEL, output=True)
    folder = Run.of(gait.problem).folder
    assert gait.verification["passed"]
    assert go.load_run(folder).verification["passed"]
    code, out, err = run("verify", WHEEL, "--json")
    assert (code, json.loads(out)["state"]) == (0, gait.to_record()["state"])
    assert f"taken from {folder}" in err


def test_nothing_is_kept_unless_asked_for():
    go.solve(WHEEL)
    go.simulate(WHEEL)
    go.continuation(named(WHEEL), "friction", TARGET, max_points=3)
    assert not list(Path().iterdir())


def test_a_failed_solve_is_not_kept():
    gait = go.solve(go.load_problem(WHEEL).replace({"walker.slope": 0.01}), output="run")
    assert not gait.converged
    assert not (Path("run") / "gait.json").exists()


def test_a_foreign_folder_is_refused_before_anything_is_solved(monkeypatch):
    Path("thesis.tex").write_text("precious")
    monkeypatch.setattr("gaitopt.search.solve.solve", None)
    with pytest.raises(StorageError, match="not a run of gaitopt"):
        go.solve(WHEEL, output=".")


def test_a_result_that_cannot_be_stored_goes_with_the_error(monkeypatch):
    def full(*_, **__):
        raise GaitoptError("disk full")

    monkeypatch.setattr("gaitopt.runs.results.write_result", full)
    with pytest.raises(GaitoptError, match="disk full") as caught:
        go.solve(WHEEL, output="run")
    assert caught.value.result.converged


def test_a_walk_is_kept_and_compared_with_the_gait_of_its_problem():
    gait = go.solve(WHEEL, output=True)
    walk = go.simulate(WHEEL, {"dtheta": 0.7}, steps=3, output="walk")
    np.testing.assert_allclose(walk.gait_states[0], gait.state, atol=1e-14)
    assert repr(go.load_run("walk")) == repr(walk)


def test_a_branch_is_kept_and_resumed_across_library_and_command(run):
    command = ("continue", WHEEL, "--param", "friction", "--to", str(TARGET), "--quiet", "--json")
    counts = []
    paused = go.continuation(named(WHEEL), "friction", TARGET, max_points=2, output="branch")
    assert paused.specials[-1].open
    code, out, _ = run(*command, "-o", "branch")
    assert code == 0
    printed = [json.loads(line) for line in out.splitlines()]
    again = go.continuation(
        named(WHEEL), "friction", TARGET, output="branch", progress=lambda n, value: counts.append((n, value))
    )
    assert not counts  # the branch was complete
    assert [point.value for point in again] == [r["value"] for r in printed if r["record"] == "point"]
    memory = go.continuation(named(WHEEL), "friction", TARGET)
    np.testing.assert_allclose(again.values, memory.values, rtol=1e-9)


def test_events_cannot_be_kept():
    with pytest.raises(ProblemError, match="no folder can keep"):
        go.continuation(named(WHEEL), "friction", TARGET, events={"x": lambda gait: 1.0}, output="branch")


def test_parts_of_a_search_are_kept():
    problem = go.load_problem(WHEEL).replace({"gait.phases": "auto"})
    counts = []
    first = go.find(problem, starts=1, output="found")
    again = go.find(problem, starts=1, output="found", progress=lambda done, total: counts.append(done))
    assert not counts
    assert [gait.state.tolist() for gait in first] == [gait.state.tolist() for gait in again]


def test_a_proof_is_kept_and_checked_again():
    pytest.importorskip("flint")
    proof = go.prove(named("rimless-wheel-stick"), output="proof.json", progress=False)
    checked = go.check_proof("proof.json")
    assert proof.proved
    assert checked.to_record() == proof.to_record()
    with pytest.raises(StorageError, match=r"nothing\.json is missing"):
        go.check_proof("nothing.json")


def test_a_special_point_needs_its_parameter_and_a_gait():
    pytest.importorskip("flint")
    branch = go.continuation(named(WHEEL), "friction", TARGET, max_points=2)
    with pytest.raises(ProblemError, match="name the parameter"):
        go.prove(branch.specials[-1])
    with pytest.raises(UnknownNameError, match=r"is of type end; .* can be proved"):
        go.prove(branch.specials[-1], parameter="friction")


def test_a_special_point_whose_gait_does_not_exist_is_an_error_with_the_failed_solve():
    pytest.importorskip("flint")
    gait = named("rimless-wheel-stick")
    special = SpecialPoint(
        branch=0, type="mode_change", value=0.5, status="guess", gait=gait
    )  # it needs 0.914 to stick
    with pytest.raises(SolveError, match="infeasible") as caught:
        go.prove(special, parameter="friction")
    assert not caught.value.result.converged


def test_results_know_their_folders_and_figures_are_saved():
    swept = go.sweep(WHEEL, {"friction": (0.4, 0.42, 2)}, workers=1, output="run", progress=False)
    assert (swept.folder / "table.csv").is_file()
    assert go.load_run(swept.folder).folder == swept.folder
    (path,) = go.save_figures(swept, "figures", ["speed"], formats=["svg"])
    assert path.read_bytes().startswith(b"<?xml")
    with pytest.raises(UnknownNameError, match="landscape: choose from"):
        go.save_figures(swept, "figures", ["landscape"])


def test_only_a_design_has_a_neighbourhood():
    with pytest.raises(SolveError, match="is no optimum"):
        go.neighbourhood(named(WHEEL))
