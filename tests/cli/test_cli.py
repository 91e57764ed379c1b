"""Every ending of a command has its exit code; results go to stdout, narration and errors to stderr."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gaitopt import Verification, cli, load_problem
from gaitopt.api import verbs
from gaitopt.search import solve as solving
from gaitopt.verification.verify import Claim

PROBLEM = "rimless-wheel-stick"
INFEASIBLE = (PROBLEM, "--set", "friction=0.5")  # it needs 0.914 to stick

pytestmark = pytest.mark.usefixtures("empty_folder")


def files() -> list[str]:
    return sorted(str(path) for path in Path().rglob("*") if path.is_file())


SLOPE = ("--set", "walker.slope=2 deg", "--set", "control.hip=0.75")


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("--help",), 0, ("list", "show", "validate", "schema", "solve", "simulate", "verify")),
        ((), 2, ("Commands:",)),
        (("list", "--json"), 0, (f'"name": "{PROBLEM}"',)),
        (("schema",), 0, ('"walker"',)),
        (("show", "compass-torque-slip", *SLOPE), 0, ("rad (2 deg)", "0.75", "slip_backward")),
        (("show", PROBLEM, "--set", "friction=2", "--json"), 0, ('"friction": 2',)),
        (("validate", PROBLEM), 0, ("valid",)),
        (("solve", PROBLEM, "--quiet"), 0, ("Floquet multipliers",)),
    ],
)
def test_commands_print_what_is_asked_on_stdout_alone(run, arguments, code, words):
    ended, out, err = run(*arguments)
    assert (ended, err) == (code, "")
    assert all(word in out for word in words)
    assert json.loads(out) if {"--json", "schema"} & {*arguments} else out


def test_all_faults_of_a_file_are_named_at_once_without_a_traceback(run):
    Path("bad.yaml").write_text("name: bad\nwalker: {model: rimless_wheel, spokes: 2}\nfriction: -1\n")
    code, out, err = run("validate", "bad.yaml")
    assert code == 3
    assert not out
    assert "bad.yaml:2:" in err
    assert "bad.yaml:3:" in err
    assert "Traceback" not in err
    assert files() == ["bad.yaml"]


def test_solve_prints_and_stores_the_gait_which_is_verified_from_its_files_alone(run, monkeypatch):
    code, out, err = run("solve", PROBLEM, "--json")
    solved = json.loads(out)
    assert (code, solved["status"]) == (0, "converged")
    assert solved["verification"]["passed"]
    assert solved["required_friction"] == pytest.approx(0.9141, abs=5e-5)
    assert json.loads((Path(solved["run"]) / "gait.json").read_text())["state"] == solved["state"]
    assert "iteration" in err
    monkeypatch.setattr(solving, "solve", None)
    for name in (PROBLEM, solved["run"]):
        code, out, err = run("verify", name, "--json")
        verified = json.loads(out)
        assert code == 0
        assert f"taken from {solved['run']}" in err or name != PROBLEM
        assert verified["verification"]["passed"]
        assert verified.keys() == solved.keys()
        assert verified["multipliers"] == solved["multipliers"]
        assert verified["state"] == solved["state"]
        figures = {key: value for key, value in solved.items() if isinstance(value, float)}
        assert {key: verified[key] for key in figures} == pytest.approx(figures, abs=1e-12)
    code, _, err = run("verify", solved["run"], "--set", "friction=2")
    assert (code, "finished run" in err) == (2, True)


def test_a_finished_run_is_verified_into_another_folder(run):
    assert json.loads(run("solve", PROBLEM, "--json", "-o", "deep/er")[1])["run"] == "deep/er"
    stored = Path("deep/er/gait.json").read_bytes()
    code, out, _ = run("verify", "deep/er", "--engine", "scipy", "--json", "-o", "again")
    assert code == 0
    assert json.loads(out)["run"] == "again"
    assert Path("deep/er/gait.json").read_bytes() == stored
    code, out, _ = run("verify", "again", "--json")
    assert code == 0
    assert json.loads(out)["state"] == json.loads(stored)["state"]


def test_infeasible_is_4_with_json_and_stores_nothing(run):
    code, out, _ = run("solve", *INFEASIBLE, "--json")
    record = json.loads(out)
    assert code == 4
    assert record["status"] in {"infeasible", "not_converged"}
    assert record["run"] is None
    assert "friction" in record["message"]
    assert files() == []


def test_disagreement_is_5_with_json(run, monkeypatch):
    claim = Claim(name="mode sequence", figure=1.0, tolerance=0.0, passed=False)
    monkeypatch.setattr(verbs, "verify", lambda gait: Verification(claims=(claim,)))
    code, out, _ = run("solve", PROBLEM, "--json")
    assert code == 5
    assert json.loads(out)["verification"]["passed"] is False
    code, out, _ = run("solve", PROBLEM)
    assert code == 5
    assert "NOT verified" in out


def test_a_foreign_folder_is_6_before_anything_is_solved(run, monkeypatch):
    Path("thesis.tex").write_text("precious")
    monkeypatch.setattr(solving, "solve", None)
    code, _, err = run("solve", PROBLEM, "-o", ".")
    assert code == 6
    assert "not a run of gaitopt" in err
    assert files() == ["thesis.tex"]
    assert run("verify", ".")[0] == 6


def test_a_gait_that_cannot_be_stored_is_still_printed(run, monkeypatch):
    def full(*_, **__):
        raise cli.main.GaitoptError("disk full")

    monkeypatch.setattr("gaitopt.runs.results.write_result", full)
    code, out, err = run("solve", PROBLEM, "--json")
    assert code == 1
    assert json.loads(out)["status"] == "converged"
    assert "disk full" in err


def test_a_named_ending_of_a_simulation_is_a_result(run):
    code, out, _ = run("simulate", PROBLEM, "--state", "dtheta=0.05", "--json")
    record = json.loads(out)
    assert code == 0
    assert record["status"] == "fall"
    assert record["state"]["dtheta"] == 0.05
    code, out, _ = run("simulate", PROBLEM, "--state", "dtheta=0.05", "-o", "fallen")
    assert code == 0
    assert "fall" in out
    assert "fallen/walk.csv" in files()


@pytest.mark.parametrize(
    ("error", "words"), [(ZeroDivisionError("oops"), "ZeroDivisionError: oops"), (TimeoutError(), "TimeoutError")]
)
def test_an_unexpected_error_is_one_line_and_a_traceback_only_on_request(run, monkeypatch, error, words):
    def broken(*_, **__):
        raise error

    monkeypatch.setattr(solving, "solve", broken)
    code, _, err = run("solve", PROBLEM, "--quiet")
    assert code == 1
    (line,) = err.splitlines()
    assert line.startswith(f"gaitopt: internal error: {words} (cli/test_cli.py:")
    assert line.endswith("; rerun with --debug for the traceback")
    code, _, err = run("solve", PROBLEM, "--quiet", "--debug")
    assert code == 1
    assert "Traceback" in err


@pytest.mark.parametrize("delay", [0.1, *(pytest.param(d, marks=pytest.mark.slow) for d in (0.0, 0.3, 0.6))])
def test_an_interrupted_process_ends_with_130_and_nothing_half_written(delay):
    command = [sys.executable, "-m", "gaitopt", "solve", "compass-pd-designed"]  # takes seconds
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    process.stderr.readline()  # it is solving now
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate()
    assert (process.returncode, out) == (130, b"")
    assert err.splitlines()[-1] == b"gaitopt: interrupted"
    assert files() == []


def test_a_reader_that_leaves_is_no_error():
    command = [sys.executable, "-m", "gaitopt", "--help"]
    reader, writer = os.pipe()
    os.close(reader)
    process = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert process.returncode == 141
    assert not process.stderr


def test_the_module_runs_like_the_script_and_its_help_imports_nothing_slow():
    command = [sys.executable, "-X", "importtime", "-m", "gaitopt", "--help"]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    assert process.stdout.startswith("Usage: gaitopt")
    imported = {line.rpartition("|")[2].strip() for line in process.stderr.splitlines()}
    assert "gaitopt.cli.main" in imported
    assert not {"casadi", "numpy", "pydantic", "matplotlib", "rich", "ruamel"} & imported


def test_the_hint_repeats_path_and_overrides_as_typed(run):
    Path("mine.yaml").write_text(load_problem(PROBLEM).text.replace(f"name: {PROBLEM}", "name: my-own"))
    changes = ("--set", "friction=0.5", "--set", "walker.slope=13 deg")
    code, out, _ = run("solve", "mine.yaml", *changes, "--quiet")
    assert code == 4
    assert "`gaitopt explain mine.yaml --set friction=0.5 --set 'walker.slope=13 deg'` says more" in out
