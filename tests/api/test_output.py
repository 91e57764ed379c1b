"""The library keeps what the commands keep, in the same folders, and takes names and paths as they do."""

import json
from pathlib import Path

import numpy as np
import pytest
from named import named

import gaitopt as go
from gaitopt.errors import ProblemError, SolveError, StorageError, UnknownNameError
from gaitopt.gait.branch import SpecialPoint
from gaitopt.store.run import Run

WHEEL = "rimless-wheel-slip"
TARGET = 0.41

pytestmark = pytest.mark.usefixtures("empty_folder")


def test_a_gait_is_verified_and_kept_where_the_command_keeps_it_and_taken_from_there_on_request(run, monkeypatch):
    gait = go.solve(WHEEL, output=True)
    folder = Run.of(gait.problem).folder
    assert gait.verification["passed"]
    assert go.load_run(folder).verification["passed"]
    code, out, err = run("verify", WHEEL, "--json")
    assert (code, json.loads(out)["state"]) == (0, gait.to_record()["state"])
    assert f"taken from {folder}" in err
    walk = go.simulate(WHEEL, {"dtheta": 0.7}, steps=3, output="walk")
    np.testing.assert_allclose(walk.gait_states[0], gait.state, atol=1e-14)  # it is compared with the gait
    assert repr(go.load_run("walk")) == repr(walk)
    monkeypatch.setattr("gaitopt.search.solve.solve", None)
    again = go.solve(WHEEL, output=True, reuse=True)
    np.testing.assert_array_equal(again.state, gait.state)
    assert go.load_records(folder)[0]["state"] == gait.to_record()["state"]


def test_the_best_of_several_starts_becomes_the_gait_of_its_problem_as_the_command_stores_it(run):
    problem = go.load_problem(WHEEL)
    best, *_ = go.multistart(problem, 3, spread=0.05, workers=1, output="starts")
    gait = go.solve(problem, start=best, output="library")
    assert gait.problem == problem
    assert run("solve", WHEEL, "--starts", "3", "--spread", "0.05", "--workers", "1", "-o", "command")[0] == 0
    ours, theirs = (go.load_records(folder)[0] for folder in ("library", "command"))
    assert ours["solver"].pop("seconds") > 0 < theirs["solver"].pop("seconds")
    assert ours == theirs
    assert np.array_equal(go.solve(best.problem).state, gait.state)
    with pytest.raises(ProblemError, match="start: is a solution of another problem, or of other values"):
        go.solve(problem.replace({"friction": 0.43}), start=best)


def test_nothing_is_kept_unless_asked_for_and_no_failed_solve():
    go.solve(WHEEL)
    go.simulate(WHEEL)
    go.continuation(named(WHEEL), "friction", TARGET, max_points=3)
    assert not list(Path().iterdir())
    assert not go.solve(go.load_problem(WHEEL).replace({"walker.slope": 0.01}), output="run").converged
    assert not (Path("run") / "gait.json").exists()


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


def test_records_of_a_branch_come_one_by_one_and_are_read_back_whole_and_by_their_places():
    records = go.continuation_records(named(WHEEL), "friction", TARGET, max_points=3, output="branch")
    head = next(records)
    assert head.items() >= {"record": "continuation", "parameter": "friction", "folder": "branch", "stored": 0}.items()
    first = next(records)
    assert first["record"] == "point"
    assert '"index": 0' in Path("branch/branch.jsonl").read_text()  # on the disk before it is used
    whole = [first, *records]
    again = go.continuation_records(named(WHEEL), "friction", TARGET, max_points=3, output="branch")
    assert next(again)["stored"] == len(whole)
    assert json.dumps([*again]) == json.dumps(whole) == json.dumps(go.load_records("branch")[1:])
    branch = go.load_run("branch")
    assert [point.value for point in branch] == [r["value"] for r in whole if r["record"] == "point"]
    assert go.verify(branch[1].gait).figure("state") < 1e-9
    assert branch[1].gait.problem.friction == branch[1].value
    point, special = go.load_run("branch@0.1"), go.load_run("branch@special.0")
    assert (point.branch, point.index, point.value) == (0, 1, branch[1].value)
    assert (special.type, special.value) == ("end", branch.specials[0].value)
    with pytest.raises(UnknownNameError, match=r"no point 7\.7; its points are 0\.0 to"):
        go.load_run("branch@7.7")
    with pytest.raises(UnknownNameError, match="no special point '9': the special points of its branch are 0 to"):
        go.load_run("branch@special.9")
    with pytest.raises(StorageError, match="contains no branch"):
        go.load_run(f"{'x' * 300}@0.1")
    Path("branch").rename("me@home")
    assert len(go.load_run("me@home")) == len(branch)
    assert go.load_run("me@home@0.1").value == point.value
    legend = go.plot({"one": branch, "two": [head, *whole]}, "speed").figure.legends[0].get_texts()
    assert [text.get_text() for text in legend][:2] == ["one", "two"]
    gaits = {"steep": named(WHEEL), "sticking": named("rimless-wheel-stick")}
    assert "sticking" in [text.get_text() for text in go.plot(gaits, "force").figure.legends[0].get_texts()]
    with pytest.raises(TypeError, match="must be gaits, or branches over one parameter"):
        go.plot({"gait": named(WHEEL), "branch": branch})


def test_every_verb_starts_from_an_element_of_a_stored_result(run):
    branch = go.continuation(named(WHEEL), "friction", TARGET, max_points=3, output="branch")
    code, out, _ = run("solve", "branch@0.2", "--json", "--quiet", "-o", "gait")
    assert code == 0
    assert json.loads(out)["friction"] == pytest.approx(branch[2].value, rel=1e-14)
    gait = go.solve("branch@special.0", progress=False)
    assert gait.state == pytest.approx(branch.specials[0].gait.state, abs=1e-12)
    swept = go.sweep("branch@0.2", {"walker.slope": (0.22, 0.23, 2)}, output="sweep", workers=1, progress=False)
    alone = go.solve(go.load_problem(WHEEL).replace({"friction": branch[2].value, "walker.slope": 0.23}))
    assert swept.column("period")[1] == pytest.approx(alone.scalar("period"), rel=1e-10)
    slopes = {"parameter": "walker.slope", "to": 0.23, "max_points": 2, "progress": False}
    other = go.continuation(go.load_run("branch@special.0"), output="slopes", **slopes)  # of a branch in friction
    assert other[0].gait.state == pytest.approx(branch.specials[0].gait.state, abs=1e-10)
    assert other[1].gait.dynamics.parameter("friction") == branch.specials[0].value


@pytest.mark.slow
def test_special_points_and_attractors_of_a_design_have_its_values():
    wheel = go.load_problem(WHEEL)
    speed, slope = 1.001 * go.solve(wheel).scalar("speed"), wheel.parameters["walker.slope"]
    free = {"walker.slope": {"free": [0.9 * slope, 1.1 * slope], "guess": slope}}
    design = go.solve(wheel.replace(free | {"objective": "period", "constraints.speed": speed}), progress=False)
    found = design.freed["walker.slope"]
    branch = go.continuation(design, "friction", TARGET, output="branch", progress=False)
    special = next(k for k, point in enumerate(branch.specials) if point.gait is not None)
    start = go.load_run(f"branch@special.{special}")
    longer = go.continuation(start, "walker.radius", 1.01, progress=False)[-1].gait
    assert longer.dynamics.parameter("walker.slope") == found
    rate = float(design.state[design.system.state_names.index("dtheta")])
    over = {"dtheta": (0.99 * rate, 1.01 * rate, 2)}
    design.save("basin")  # the basin is a part of the run of the design
    basin = go.basin(design, over, steps=60, workers=1, output="basin", progress=False)
    again = go.solve(go.load_run(basin.folder).attractors[0], progress=False)
    assert again.dynamics.parameter("walker.slope") == found
    assert again.period == pytest.approx(design.period, rel=1e-10)


def test_figures_in_a_run_folder_get_their_checksums_and_stay_theirs():
    folder = named(WHEEL).save("run")
    go.save_figures(named(WHEEL), folder / "figures", ["portrait"], formats=["svg"])
    axes = go.plot(named(WHEEL), "force_over_theta")
    go.save_figures(axes.figure, folder / "figures", ["mine"], formats=["svg"])
    named(WHEEL).report().save(folder / "report.html")
    assert {"figures/portrait.svg", "figures/mine.svg", "report.html"} <= Run(folder).manifest().files.keys()
    assert go.save_figures(axes.figure, "elsewhere", ["mine"], formats=["svg"])[0].read_bytes().startswith(b"<?xml")
    Path("manifest.json").write_text('{"name": "a page of another program"}')
    assert go.save_figures(axes.figure, ".", ["mine"], formats=["svg"]) == [Path("mine.svg")]


def test_calls_in_several_processes_give_their_results_by_number_and_the_error_of_one_that_fails():
    results = dict(go.run_parallel(int, ["1", "two", "3"], workers=2))
    assert (results[0], results[2]) == (1, 3)
    assert "ValueError" in results[1].reason


def test_a_proof_is_kept_and_checked_again():
    pytest.importorskip("flint")
    proof = go.prove(named("rimless-wheel-stick"), output="proof.json", progress=False)
    checked = go.check_proof("proof.json")
    assert proof.proved
    assert checked.to_record() == proof.to_record()
    with pytest.raises(StorageError, match=r"nothing\.json is missing"):
        go.check_proof("nothing.json")


def test_what_cannot_be_kept_or_searched_around_is_refused():
    with pytest.raises(ProblemError, match="give output=True or a folder"):
        go.solve(WHEEL, reuse=True)
    with pytest.raises(ProblemError, match="cannot be stored"):
        go.continuation(named(WHEEL), "friction", TARGET, events={"x": lambda gait: 1.0}, output="branch")
    with pytest.raises(SolveError, match="is not an optimum"):
        go.neighbourhood(named(WHEEL))


def test_a_special_point_is_proved_with_its_parameter_if_its_gait_exists():
    pytest.importorskip("flint")
    branch = go.continuation(named(WHEEL), "friction", TARGET, max_points=2)
    with pytest.raises(ProblemError, match="name the parameter"):
        go.prove(branch.specials[-1])
    with pytest.raises(UnknownNameError, match=r"is of type end; .* can be proved"):
        go.prove(branch.specials[-1], parameter="friction")
    gait = named("rimless-wheel-stick")  # it needs 0.914 to stick
    special = SpecialPoint(branch=0, type="mode_change", value=0.5, status="guess", gait=gait)
    with pytest.raises(SolveError, match="infeasible") as caught:
        go.prove(special, parameter="friction")
    assert not caught.value.result.converged
