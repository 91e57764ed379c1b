"""``gaitopt continue`` and ``trace``: what they print, what they keep, how they go on, and what they refuse."""

import contextlib
import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from gaitopt.api.stored import load_curve_start
from gaitopt.branches import continuation as continuer
from gaitopt.branches.continuation import Continuation
from gaitopt.cli.main import main
from gaitopt.runs.branch import BRANCH_FILE
from gaitopt.runs.trace import TRACE_FILE
from gaitopt.store.files import read_lines
from gaitopt.store.run import Run
from gaitopt.verification.verify import Outcome, Verification, confirm

COMMAND = ("continue", "rimless-wheel-stick", "--param", "friction", "--to", "0.8", "-o", "branch", "--quiet")
TRACE = ("trace", "branch@special.0", "--param", "walker.slope", "--to", "12.8 deg", "-o", "trace", "--quiet")

pytestmark = pytest.mark.usefixtures("empty_folder")


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walked")
    with contextlib.chdir(folder):
        assert main([*COMMAND]) == 0
    return folder / "branch"


@pytest.fixture
def branch(walked, empty_folder):
    """The finished branch of the command, in the folder of the test."""
    shutil.copytree(walked, empty_folder / "branch")


def records(out):
    return [json.loads(line) for line in out.splitlines()]


def stored(folder="branch"):
    return list(read_lines(Path(folder) / BRANCH_FILE))


def test_a_branch_is_printed_as_it_is_on_the_disk_and_a_finished_one_is_not_computed_again(run, monkeypatch):
    code, out, _ = run(*COMMAND, "--json")
    assert code == 0
    printed = records(out)
    assert printed == stored()[1:]
    points = [record for record in printed if record["record"] == "point"]
    change, end = (record for record in printed if record["record"] == "special")
    assert change["type"] == "mode_change"
    assert change["status"] == "converged"
    assert change["value"] == pytest.approx(0.914120783896, abs=1e-9)
    assert change["from"] == {"phases": ["stick"], "impact": "stick"}
    assert change["to"] == {"phases": ["stick", "slip_forward"], "impact": "stick"}
    assert change["next"] == [1]
    assert (end["type"], end["value"], end["bound"]) == ("end", pytest.approx(0.8), True)
    assert "bound" not in change
    assert {point["branch"] for point in points} == {0, 1}
    assert points[0]["verification"]["passed"]
    assert all(point["multipliers"] for point in points)
    with (Path("branch") / "branch.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["type"] for row in rows].count("point") == len(points)
    assert (float(rows[0]["value"]), rows[-1]["type"]) == (1.0, "end")
    monkeypatch.setattr(Continuation, "__iter__", lambda *_, **__: pytest.fail("walked again"))
    assert run(*COMMAND, "--json")[1] == out
    _, summary, _ = run(*COMMAND)
    assert all(words in summary for words in ("stick, slip_forward; stick", "0.914120", "mode change -> 1"))


@pytest.mark.parametrize("kept", [11, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 5, 12))])
@pytest.mark.usefixtures("branch")
def test_an_interrupted_branch_resumes_and_is_the_same(run, kept):
    whole = stored()
    path = Path("branch") / BRANCH_FILE
    lines = path.read_text().splitlines(keepends=True)
    path.write_text(lines[0])
    Run(Path("branch")).seal(BRANCH_FILE)  # what the manifest counts of a walk that was killed
    path.write_text("".join(lines[:kept]) + lines[kept][: len(lines[kept]) // 2])
    code, _, _ = run(*COMMAND)
    assert code == 0
    assert stored() == whole


@pytest.mark.parametrize("limit", [("--max-points", "4"), pytest.param(("--max-seconds", "0"), marks=pytest.mark.slow)])
@pytest.mark.usefixtures("branch")
def test_a_limit_of_points_or_time_only_pauses_a_branch(run, limit):
    whole = stored()
    code, out, _ = run(*COMMAND[:-3], "-o", "paused", "--json", *limit)
    assert code == 0
    end = records(out)[-1]
    assert (end["type"], end["open"], end["value"] > 0.9) == ("end", True, True)
    assert run(*COMMAND[:-3], "-o", "paused", *limit)[0] == 0
    code, _, _ = run(*COMMAND[:-3], "-o", "paused")
    assert code == 0
    assert stored("paused") == whole


def test_gait_that_the_simulator_refutes_ends_the_branch_and_the_command_with_5(run, monkeypatch):
    def refuted_in_the_end(gait):
        check = confirm(gait)
        failed = {"passed": False, "outcome": Outcome.FAILS}
        wrong = [replace(claim, **failed) if claim.name == "period" else claim for claim in check.claims]
        return check if gait.dynamics.parameter("friction") > 0.95 else Verification(claims=tuple(wrong))

    monkeypatch.setattr(continuer, "confirm", refuted_in_the_end)
    code, out, _ = run(*COMMAND, "--json", "--verify-every", "1")
    end = records(out)[-1]
    assert (code, end["type"]) == (5, "end")
    assert not end["gait"]["verification"]["passed"]
    assert run(*COMMAND, "--json", "--verify-every", "1")[0] == 5  # also from what is stored


def test_start_that_is_no_gait_ends_with_4(run):
    code, out, _ = run(*COMMAND, "--set", "friction=0.5", "--json")
    assert code == 4
    assert records(out)[0]["status"] == "infeasible"


@pytest.mark.usefixtures("branch")
def test_folder_of_another_branch_is_left_alone(run):
    before = (Path("branch") / BRANCH_FILE).read_bytes()
    code, _, err = run("continue", "rimless-wheel-stick", "--param", "friction", "--to", "0.7", "-o", "branch")
    assert code == 6
    assert "another branch" in err
    assert (Path("branch") / BRANCH_FILE).read_bytes() == before


@pytest.mark.slow
def test_other_branches_through_a_special_point_are_followed(run):
    state = "gait.guess.state={theta1: -0.2637, dtheta1: 0.8969, dtheta2: 0.1533}"
    changes = ("--set", "walker.slope=5.345 deg", "--set", "friction=0.6", "--set", state)
    bounds = ("--param", "walker.slope", "--to", "5.5 deg", "--max-points", "3", "--quiet")
    code, out, _ = run("continue", "compass-passive-stick", *changes, *bounds, "-o", "branch")
    assert code == 0
    assert "0: branch 0, 0.0933125341" in out
    command = ("continue", "branch@special.0", *bounds)
    code, out, _ = run(*command, "--json")
    assert code == 0
    printed = records(out)
    assert {record["n_steps"] for record in printed if record["record"] == "point"} == {2}
    (folder,) = (path for path in Path("results").iterdir() if path.name.endswith("period-doubling"))
    code, again, _ = run(*command, "--json")
    assert again == out
    code, _, err = run(*command, "--set", "friction=0.5")
    assert code == 2
    assert "a point of a finished run" in err
    code, _, _ = run("plot", str(folder), "--what", "step_length", "--format", "svg")
    assert code == 0


@pytest.mark.usefixtures("branch")
def test_special_points_that_lead_nowhere_are_refused(run):
    other = ("--param", "friction", "--to", "0.7", "--quiet")
    code, _, err = run("continue", "branch@special.2", *other)
    assert (code, "the special points of its branch are 0 to 1" in err) == (2, True)
    assert run("prove", "branch@special.2")[0::2] == (2, err)
    code, _, err = run("continue", "branch@special.0", *other)
    assert (code, "no other branch is found at mode_change friction = 0.91412" in err) == (4, True)
    code, _, err = run("continue", "branch@special.1", *other)
    assert (code, "no other branch begins at a special point of type end" in err) == (3, True)
    code, _, err = run(*COMMAND, "--follow", "folds=2")
    assert (code, "doublings=N, branch_points=N, mode_changes=N" in " ".join(err.split())) == (2, True)


@pytest.mark.slow
@pytest.mark.usefixtures("branch")
def test_a_trace_is_printed_as_it_is_on_the_disk_goes_on_with_more_points_and_refuses_other_starts(run):
    code, out, _ = run(*TRACE, "--json", "--max-points", "4")
    printed = records(out)
    assert code == 0
    assert printed == list(read_lines(Path("trace") / TRACE_FILE))[1:]
    *points, end = printed
    assert [point["index"] for point in points] == [0, 1, 2, 3]
    assert [*points[0]["values"]] == ["friction", "walker.slope"]
    assert points[0]["values"]["friction"] == pytest.approx(0.914120783896, abs=1e-9)
    assert points[0]["verification"]["passed"]
    assert (end["record"], end["type"], end["open"], end["codimension"]) == ("special", "end", True, 1)
    more = records(run(*TRACE, "--json", "--max-points", "6")[1])
    assert more[:4] == points
    assert len(more) == 7
    code, out, _ = run(*TRACE, "--max-points", "6")
    assert "friction from" in out
    assert "run: trace" in out
    code, _, err = run("trace", "trace@special.0", "--param", "walker.slope", "--to", "0.2")
    assert (code, "no other curve begins at a special point of type end" in err) == (3, True)
    margin = {"type": "margin", "margin": {"kind": "clearance", "phase": 0, "step": 0}}
    with Run(Path("trace")).appending(TRACE_FILE) as lines:
        lines.append({**end, "type": "margin_period_doubling", "next": [margin, {"type": "period_doubling"}]})
    number = len(more) - 6
    begins = [load_curve_start(f"trace@special.{number}{n}").type for n in ("", ".0", ".1")]
    assert begins == ["margin", "margin", "period_doubling"]
    for wrong in ("2", "-1", "x", ""):
        code, _, err = run("trace", f"trace@special.{number}.{wrong}", "--param", "walker.slope", "--to", "0.2")
        choices = f"has no curve '{wrong}': the curves that begin there are 0 to 1 (margin clearance, period_doubling)"
        assert (code, choices in " ".join(err.split())) == (2, True)
    code, _, err = run("trace", "branch@special.7", "--param", "walker.slope", "--to", "0.2")
    assert (code, "has no special point '7'" in err) == (2, True)
    code, _, err = run(*TRACE[:5], "0.3", *TRACE[6:])
    assert (code, "contains another trace" in err) == (6, True)
