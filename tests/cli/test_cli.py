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
from gaitopt.api import progress as cli_progress
from gaitopt.api import verbs
from gaitopt.search import solve as solving
from gaitopt.store.run import Run
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


def test_list_has_every_problem_with_a_line_about_it(run):
    _, out, _ = run("list", "--json")
    problems = json.loads(out)["problems"]
    assert PROBLEM in {problem["name"] for problem in problems}
    assert all(problem["about"] for problem in problems)


def test_schema_is_json(run):
    code, out, _ = run("schema")
    assert code == 0
    assert "walker" in json.loads(out)["properties"]


def test_all_faults_of_a_file_are_named_at_once_without_a_traceback(run):
    Path("bad.yaml").write_text("name: bad\nwalker: {model: rimless_wheel, spokes: 2}\nfriction: -1\n")
    code, out, err = run("validate", "bad.yaml")
    assert code == 3
    assert not out
    assert "bad.yaml:2:" in err
    assert "bad.yaml:3:" in err
    assert "Traceback" not in err
    assert files() == ["bad.yaml"]


def test_solve_prints_the_gait_verified_and_stores_it(run):
    code, out, err = run("solve", PROBLEM, "--json")
    record = json.loads(out)
    assert code == 0
    assert record["status"] == "converged"
    assert record["verification"]["passed"]
    assert record["required_friction"] == pytest.approx(0.9141, abs=5e-5)
    assert json.loads((Path(record["run"]) / "gait.json").read_text())["state"] == record["state"]
    assert "iteration" in err


def test_a_finished_run_is_verified_from_its_files_alone(run, monkeypatch):
    _, out, _ = run("solve", PROBLEM, "--json")
    solved = json.loads(out)
    monkeypatch.setattr(solving, "solve", None)
    for name in (PROBLEM, solved["run"]):
        code, out, _ = run("verify", name, "--json")
        verified = json.loads(out)
        assert code == 0
        assert verified["verification"]["passed"]
        assert verified.keys() == solved.keys()
        assert verified["multipliers"] == solved["multipliers"]
        assert verified["state"] == solved["state"]
        figures = {key: value for key, value in solved.items() if isinstance(value, float)}
        assert {key: verified[key] for key in figures} == pytest.approx(figures, abs=1e-12)


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


def test_a_spoiled_run_does_not_pass_verification(run):
    _, out, _ = run("solve", PROBLEM, "--json")
    path = Path(json.loads(out)["run"]) / "trajectory.csv"
    header, first, *rest = path.read_text().splitlines()
    cells = first.split(",")
    cells[header.split(",").index("dtheta")] = "0.8"
    path.write_text("\n".join([header, ",".join(cells), *rest]) + "\n")
    code, out, err = run("verify", str(path.parent), "--json")
    assert (code, out) == (6, "")
    assert "trajectory.csv:2: altered since it was written" in err
    Run(path.parent).seal(path.name)
    code, out, err = run("verify", str(path.parent), "--json")
    assert (code, out) == (6, "")
    assert "trajectory.csv:2 f_t is" in err  # which the new state does not give


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


@pytest.mark.parametrize(
    ("argv", "code", "words"),
    [
        (("sovle", PROBLEM), 2, "sovle"),
        (("solve",), 2, "PROBLEM"),
        (("solve", PROBLEM, "--nope"), 2, "--nope"),
        (("solve", "rimless-wheel-stik"), 2, "rimless-wheel-stick"),
        (("verify", "results/nothing"), 2, "no run folder results/nothing"),
        (("solve", PROBLEM, "--set", "friction"), 2, "--set friction=VALUE"),
        (("simulate", PROBLEM, "--state", "phi=1"), 2, "phi"),
        (("simulate", PROBLEM, "--state", "dtheta"), 2, "--state dtheta=VALUE"),
        (("simulate", PROBLEM, "--state", "dtheta=.inf"), 2, "not a finite number"),
        (("simulate", PROBLEM, "--state", "dtheta=fast"), 2, "write a number, or an angle"),
        (("simulate", PROBLEM, "--state", "dtheta=true"), 2, "write a number, or an angle"),
        (("simulate", PROBLEM, "--steps", "0"), 2, "--steps"),
        (
            ("continue", PROBLEM, "--param", "walker.spokes", "--to", "12"),
            2,
            "--param walker.spokes: is a whole number",
        ),
        (("solve", PROBLEM, "--set", "friction=-1"), 3, "--set friction: "),
        (("solve", PROBLEM, "--set", "fricton=1"), 3, "--set fricton: unknown key; did you mean friction?"),
        (("solve", PROBLEM, "--set", "walker.slope={"), 3, "--set walker.slope: "),
        (("solve", PROBLEM, "--set", "friction=.nan"), 3, "--set friction: "),
        (("solve", PROBLEM, "--set", "gait.guess.state.dtheta=1e200"), 3, "--set gait.guess.state.dtheta: 1e+200 is"),
        (("solve", PROBLEM, "--starts", "1000000000000"), 6, "starts need about 6.0 PB on disk"),
        (("solve", PROBLEM, "--starts", "3", "--spread", "1e300"), 2, "--spread"),
        (("sweep", PROBLEM, "--over", f"friction=1:2:{'9' * 50}"), 2, "values; at most 1,000,000,000 are possible"),
        (("sweep", PROBLEM, "--over", f"friction=1:2:{'9' * 5000}"), 2, "write --over friction=LO:HI:N"),
        (("front", "compass-torque-efficient", "--over", "constraints.speed=0.3:0.4:50000000"), 6, "about 600.0 GB"),
        (("plot", PROBLEM, "--format", "avi"), 2, "Invalid value for '--format': 'avi' is not one of"),
    ],
)
def test_what_is_unknown_or_wrong_or_too_large_is_named_with_its_exit_code(run, argv, code, words):
    ended, out, err = run(*argv)
    assert (ended, out) == (code, "")
    assert words in err
    assert "Traceback" not in err
    assert files() == []


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


def test_overrides_cannot_change_a_finished_run(run):
    _, out, _ = run("solve", PROBLEM, "--json")
    code, _, err = run("verify", json.loads(out)["run"], "--set", "friction=2")
    assert code == 2
    assert "finished run" in err


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


def test_an_interrupt_that_the_solver_swallows_is_still_130(run, monkeypatch):
    def press(console, what):
        yield lambda iteration, violation: signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(cli_progress, "solver_progress", cli_progress.contextmanager(press))
    before = signal.getsignal(signal.SIGINT)
    code, out, err = run("solve", PROBLEM, "--json")
    assert code == 130
    assert not out
    assert "interrupted" in err
    assert files() == []
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("delay", [0.1, *(pytest.param(d, marks=pytest.mark.slow) for d in (0.0, 0.3, 0.6))])
def test_an_interrupted_process_ends_with_130_and_nothing_half_written(tmp_path, delay):
    command = [sys.executable, "-m", "gaitopt", "solve", "compass-pd-designed"]  # takes seconds
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
    process.stderr.readline()  # it is solving now
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    assert process.returncode == 130
    assert err.splitlines()[-1] == b"gaitopt: interrupted"
    assert not [name for name in files() if name.endswith(".tmp")]


def test_a_reader_that_leaves_is_no_error():
    command = [sys.executable, "-m", "gaitopt", "schema"]
    reader, writer = os.pipe()
    os.close(reader)
    process = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert process.returncode == 141
    assert not process.stderr


def test_the_module_runs_like_the_script():
    process = subprocess.run([sys.executable, "-m", "gaitopt", "--help"], capture_output=True, text=True, check=True)
    assert process.stdout.startswith("Usage: gaitopt")


def test_a_narrow_terminal_loses_no_words(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "50")
    _, out, _ = run("show", "compass-pd-impact-slip")
    assert max(map(len, out.splitlines())) <= 50
    for word in ("leg_length", "dtheta1", "slip_forward", "compass-passive-b"):
        assert word in out


@pytest.mark.parametrize("module", ["casadi", "numpy", "pydantic", "matplotlib", "rich", "ruamel"])
def test_help_imports_nothing_slow(module):
    program = f"import sys; from gaitopt.cli.main import main; main(['--help']); sys.exit({module!r} in sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True, stdout=subprocess.DEVNULL)


def test_the_hint_repeats_path_and_overrides_as_typed(run):
    Path("mine.yaml").write_text(load_problem(PROBLEM).text.replace(f"name: {PROBLEM}", "name: my-own"))
    changes = ("--set", "friction=0.5", "--set", "walker.slope=13 deg")
    code, out, _ = run("solve", "mine.yaml", *changes, "--quiet")
    assert code == 4
    assert "`gaitopt explain mine.yaml --set friction=0.5 --set 'walker.slope=13 deg'` says more" in out
