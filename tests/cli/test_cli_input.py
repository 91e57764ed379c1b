"""Bad input on the command line: an exit code and a sentence for each, never an internal error."""

import json
import time
from pathlib import Path

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
