"""Bad input on the command line: an exit code and a sentence for each, never an internal error."""

import json
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

WHEEL = "rimless-wheel-stick"
LONG = "a" * 5000

pytestmark = pytest.mark.usefixtures("empty_folder")


@pytest.mark.parametrize(
    "name", ["", LONG, f"{LONG}.yaml", f"x/{LONG}", "/".join(["b" * 200] * 30), ".", "/", "\udcff"]
)
@pytest.mark.parametrize(
    "command",
    [
        ("show",), ("validate",), ("solve",), ("simulate",), ("verify",), ("plot",), ("report",),
        ("continue", "--param", "friction", "--to", "1"), ("basin", "--over", "dtheta=1:2:2"),
        ("sweep", "--over", "friction=1:2:2"), ("front", "--over", "friction=1:2:2"), ("reproduce",),
    ],
)  # fmt: skip
def test_no_name_of_a_problem_or_run_is_an_internal_error(run, command, name):
    code, out, err = run(command[0], name, *command[1:])
    assert code in (2, 3, 6)
    assert not out
    assert err.startswith("gaitopt: ")
    assert "internal error" not in err


@pytest.mark.parametrize("output", [".", "/", ""])
def test_a_report_is_no_folder(run, output):
    code, _, err = run("report", WHEEL, "-o", output)
    assert code == 2
    assert "is a folder; give the name of the page" in err
    assert not list(Path().iterdir())


def test_a_working_directory_that_is_deleted_is_named(run):
    here = Path.cwd()
    here.rmdir()
    try:
        code, _, err = run("solve", WHEEL)
    finally:
        here.mkdir()
    assert code == 6
    assert "the working directory has been deleted" in err


@pytest.mark.parametrize(
    "command",
    [
        ("find", WHEEL, "--starts", "10000000000"), ("explain", WHEEL, "--starts", "10000000000"),
        ("find", WHEEL, "--steps", "1000000000"), ("simulate", WHEEL, "--steps", "10000000000"),
        ("solve", WHEEL, "--starts", "10000000000"), ("sweep", WHEEL, "--over", "friction=1:2:1000000000"),
        ("front", "compass-torque-efficient", "--over", "walker.slope=0.1:0.2:1000000000"),
        *((*command, "--workers", "1000000000") for command in (
            ("find", WHEEL), ("sweep", WHEEL, "--over", "friction=1:2:2"), ("solve", WHEEL, "--starts", "2"),
        )),
    ],
)  # fmt: skip
def test_no_count_makes_a_command_grow_without_bound(run, command):
    began = time.monotonic()
    code, _, err = run(*command)
    assert code in (2, 3, 6)
    assert "internal error" not in err
    assert time.monotonic() - began < 10
    assert not [path for path in Path().rglob("*") if path.is_file()]


def test_remarks_go_to_stderr_and_json_stays_clean(run):
    code, out, err = run("validate", WHEEL, "--set", "friction=50", "--json")
    assert code == 0
    assert json.loads(out)["valid"]
    assert err == "warning: --set friction: 50 is unusual; usually from 0 to 3\n"
    code, _, err = run("solve", WHEEL, "--set", "friction=50", "--quiet", "--json")
    assert (code, err) == (0, "")


def test_a_level_wheel_lacks_energy(run):
    code, out, _ = run("solve", WHEEL, "--set", "walker.slope=0", "--json", "--quiet")
    assert code == 4
    assert "a passive walker on level or uphill ground cannot have a periodic gait" in json.loads(out)["message"]


COMPASS, SLOPE = "compass-torque-stick", "walker.slope=0.1:0.2"


@pytest.mark.parametrize(
    ("command", "code", "words"),
    [
        (("solve", WHEEL, "--method", "nonsense"), 2, "no method of solution is called 'nonsense'"),
        (("simulate", WHEEL, "--engine", "nonsense"), 2, "no engine is called 'nonsense'"),
        (("simulate", WHEEL, "--random", "friction=nonsense"), 3, "is no distribution"),
        (("verify", WHEEL, "--engine", "nonsense"), 2, "no engine is called 'nonsense'"),
        (("verify", WHEEL, "--optimum"), 4, "is not an optimum: it needs freed parameters and an objective"),
        (("robustness", WHEEL, "--what", "falls,nonsense"), 2, "--what is 'falls,nonsense', but must be some of range"),
        (("robustness", WHEEL, "--what", ","), 2, "--what is ',', but must be some of range"),
        (("robustness", WHEEL, "--over", "nonsense"), 2, "nonsense is not a parameter of"),
        (("robustness", WHEEL, "--random", "friction=nonsense"), 3, "is no distribution"),
        (("robustness", WHEEL, "--engine", "nonsense"), 2, "no engine is called 'nonsense'"),
        (("robustness", WHEEL, "--scheduler", "nonsense"), 2, "write tcp://HOST:PORT"),
        (("stabilise", COMPASS, "--law", "nonsense"), 2, "no feedback law is called 'nonsense'"),
        (
            ("stabilise", COMPASS, "--phase", "nonsense"),
            3,
            "'nonsense' is no phase variable of the",
        ),
        (("find", WHEEL, "--method", "nonsense"), 2, "no method of solution is called 'nonsense'"),
        (("find", WHEEL, "--within", "nonsense=0:1"), 2, "nonsense"),
        (("continue", WHEEL, "--param", "nonsense", "--to", "1"), 2, "nonsense is not a parameter of"),
        (("continue", WHEEL, "--param", "walker.spokes", "--to", "9"), 2, "--param walker.spokes: is a whole number"),
        (
            ("continue", WHEEL, "--param", "friction", "--to", "1", "--follow", "nonsense=1"),
            2,
            "write --follow with one of",
        ),
        (("basin", WHEEL, "--over", "nonsense=0:1:3"), 2, "--over nonsense: not a coordinate just after an impact"),
        (("basin", WHEEL, "--over", "dtheta=0:1:3", "--engine", "nonsense"), 2, "no engine is called 'nonsense'"),
        (("basin", WHEEL, "--over", "dtheta=0:1:3", "--scheduler", "nonsense"), 2, "write tcp://HOST:PORT"),
        (("sweep", WHEEL, "--over", "nonsense=0:1:3"), 2, "--over nonsense: not a parameter of"),
        (("sweep", WHEEL, "--over", f"{SLOPE}:3", "--what", "nonsense"), 2, "no scalar of a sweep"),
        (("sweep", WHEEL, "--over", f"{SLOPE}:3", "--method", "nonsense"), 2, "no method of solution"),
        (("atlas", WHEEL, "--over", SLOPE, "--over", "nonsense=0:1"), 2, "--over nonsense: not a parameter of"),
        (("atlas", WHEEL, "--over", SLOPE, "--over", "friction=0.1:1", "--what", "nonsense"), 2, "no scalar of a gait"),
        (("attractors", WHEEL, "--over", "nonsense=0:1:3"), 2, "--over nonsense: not a parameter of"),
        (("attractors", WHEEL, "--over", f"{SLOPE}:3", "--engine", "nonsense"), 2, "no engine is called 'nonsense'"),
        (("front", "compass-torque-efficient", "--over", "nonsense=0:1:3"), 2, "--over nonsense: no number of"),
        (("prove", WHEEL, "--set", "nonsense=1..2"), 3, "nonsense"),
        (("replay", WHEEL, "--engine", "nonsense"), 2, "--engine 'nonsense': no such engine"),
        (("plot", WHEEL, "--what", "nonsense"), 2, "--what nonsense: choose from portrait, force,"),
        (("plot", WHEEL, COMPASS, "--what", "animation"), 2, "--what methods and animation show one gait, not 2"),
        (("reproduce", "gamus-or-2013", "--only", "nonsense"), 2, "nonsense"),
    ],
)
def test_a_wrong_choice_is_refused_before_a_gait_is_solved(run, monkeypatch, command, code, words):
    monkeypatch.setattr("gaitopt.search.solve.solve", None)
    ended, _, err = run(*command)
    assert ended == code
    assert words in err
    assert not any(Path().iterdir())


def test_a_wrong_setting_of_an_engine_is_refused_before_a_gait_is_solved(run, monkeypatch):
    engine = SimpleNamespace(name="mujoco", settings={"default": {}, "best": {}})
    monkeypatch.setattr("gaitopt.engines.replay.adapter", lambda name: engine)
    monkeypatch.setattr("gaitopt.search.solve.solve", None)
    code, _, err = run("replay", WHEEL, "--engine", "mujoco", "--setting", "nonsense")
    assert code == 2
    assert "--setting 'nonsense': mujoco has no setting of this name; use default, best" in err
