"""Bad input on the command line: an exit code and a sentence for each, never an internal error."""

import json
import shlex
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


@pytest.mark.parametrize(
    ("command", "code", "words"),
    [
        ("sovle WHEEL", 2, "sovle"),
        ("solve", 2, "PROBLEM"),
        ("solve WHEEL --nope", 2, "--nope"),
        ("solve rimless-wheel-stik", 2, "rimless-wheel-stick"),
        ("verify results/nothing", 2, "no run folder results/nothing"),
        ("reproduce gamus-or-2014", 2, "gamus-or-2013"),
        ("reproduce gamus-or-2013 --only fig5", 2, "fig4"),
        ("plot WHEEL --format avi", 2, "Invalid value for '--format': 'avi' is not one of"),
        ("replay WHEEL --engine gazebo", 2, "--engine 'gazebo': no such engine; use mujoco, drake, pybullet, siconos"),
        ("trace WHEEL --param walker.slope --to 0.2", 2, "write RUN@special.K"),
        # overrides
        ("solve WHEEL --set friction", 2, "--set friction=VALUE"),
        ("solve WHEEL --set friction=-1", 3, "--set friction: "),
        ("solve WHEEL --set fricton=1", 3, "--set fricton: unknown key; did you mean friction?"),
        ("solve WHEEL --set walker.slope={", 3, "--set walker.slope: "),
        ("solve WHEEL --set friction=.nan", 3, "--set friction: "),
        ("solve WHEEL --set gait.guess.state.dtheta=1e200", 3, "--set gait.guess.state.dtheta: 1e+200 is"),
        ("show WHEEL --format yaml --set friction=0.2", 2, "--set"),
        # starts and states
        ("solve WHEEL --start compass-passive-stick", 3, "a gait of compass_biped, but rimless-wheel-stick has"),
        ("solve WHEEL --start no-such-problem", 2, "no-such-problem"),
        ("solve WHEEL --start nowhere@0.1", 6, "nowhere contains no branch"),
        ("continue elsewhere@special.0 --param friction --to 0.7", 6, "contains no branch"),
        ("simulate WHEEL --state phi=1", 2, "phi"),
        ("simulate WHEEL --state dtheta", 2, "--state dtheta=VALUE"),
        ("simulate WHEEL --state dtheta=.inf", 2, "not a finite number"),
        ("simulate WHEEL --state dtheta=fast", 2, "write a number, or an angle"),
        ("simulate WHEEL --state dtheta=true", 2, "write a number, or an angle"),
        ("find WHEEL --within phi=0:1", 2, "within phi: not a coordinate just after an impact"),
        ("find WHEEL --within dtheta=1", 2, "--within dtheta"),
        ("find WHEEL --within dtheta=1:0", 2, "--within dtheta"),
        ("find WHEEL --within dtheta=a:b", 2, "--within dtheta"),
        # numbers
        ("simulate WHEEL --steps 0", 2, "--steps"),
        ("simulate WHEEL --steps 10000000000", 6, "10,000,000,000 steps need about 400.0 TB of memory"),
        ("simulate WHEEL --time nan", 2, "--time is nan, but must be a finite number"),
        ("simulate WHEEL --events 0", 2, "--events is 0, but must be a whole number, at least 1"),
        ("simulate WHEEL --seed 3", 2, "--seed: only a floor of --random has a seed"),
        ("solve WHEEL --starts 3 --spread 1e300", 2, "--spread"),
        ("solve WHEEL --starts 50000000", 6, "50,000,000 starts need about"),
        ("solve WHEEL --starts 2 --workers 1000000000", 2, "--workers is 1000000000, but must be a whole"),
        ("find WHEEL --seed -1", 2, "--seed is -1, but must be a whole number, at least 0"),
        ("find WHEEL --starts many", 2, "--starts is 'many', but must be a whole number, from 1 to 1,000,000"),
        ("find WHEEL --starts=2.5", 2, "--starts is '2.5', but must be a whole number"),
        (f"find WHEEL --starts {'9' * 5000}", 2, "999..., but must be a whole number"),
        ("find WHEEL --starts 10000000000", 2, "--starts is 10000000000, but must be a whole"),
        ("find WHEEL --steps 1000000000", 3, "gait.steps: 1000000000 must be at least 1 and at most 64"),
        ("explain WHEEL --starts 10000000000", 2, "--starts is 10000000000, but must be a whole"),
        ("replay WHEEL --engine mujoco --dt 0", 2, "--dt is 0.0, but must be a finite number, from 1e-06 to 0.1 s"),
        # families
        ("continue WHEEL --param walker.spokes --to 12", 2, "--param walker.spokes: is a whole number"),
        ("continue WHEEL --param fricton --to 0.5", 2, "did you mean friction"),
        ("continue WHEEL --param friction --to half", 2, "write a number"),
        ("continue WHEEL --param friction --to 1.0", 3, "another finite value"),
        ("continue WHEEL --param friction --to 0.5 --lower 0.6", 3, "below the bound"),
        # ranges
        ("sweep WHEEL --over friction=1:2:50000000", 6, "50,000,000 points need about"),
        (f"sweep WHEEL --over friction=1:2:{'9' * 50}", 2, "values; at most 1,000,000,000 are possible"),
        (f"sweep WHEEL --over friction=1:2:{'9' * 5000}", 2, "write --over friction=LO:HI:N"),
        ("sweep WHEEL --over friction=1:2:2 --workers 0", 2, "--workers is 0, but must be a whole"),
        ("sweep WHEEL --over walker.spokes=6:7:3", 3, "6.5 is not an integer"),
        ("sweep WHEEL --over friction=-0.1:0.4:3", 3, "--over friction: -0.1 must be at least 0"),
        ("sweep WHEEL --over walker.weight=1:2:2", 2, "walker.weight: not a parameter of WHEEL; did you mean"),
        ("sweep WHEEL --over slope=0.1:0.2:2", 2, "did you mean walker.slope"),
        ("sweep WHEEL --over friction", 2, "write --over friction=VALUE"),
        ("sweep WHEEL --over friction=0.1:0.2", 2, "write --over friction=LO:HI:N"),
        ("sweep WHEEL --over friction=0.1:0.2:0", 2, "0 values from 0.1 to 0.2 are not a range"),
        ("sweep WHEEL --over friction=0.1:0.1:5", 2, "not a range"),
        ("sweep WHEEL --over friction=0.1:inf:5", 2, "not a finite range"),
        ("sweep WHEEL --over friction=a:b:5", 2, "friction: 'a' is not a number or an angle such as 2 deg"),
        ("front compass-torque-efficient --over constraints.speed=0.3:0.4:50000000", 6, "100,000,000 points need"),
        ("front compass-torque-efficient --over constraints.speed=0.3:1e9:2", 3, "constraints.speed"),
        ("front compass-torque-efficient --over speed=0.4:0.5:2", 2, "did you mean constraints.speed"),
        ("front compass-torque-slip --over friction=0.1:0.2:2", 3, "needs an objective"),
        ("attractors WHEEL --over friction=1:2:2 --over walker.slope=0.1:0.2:2", 2, "--over has 2 keys, but must"),
        ("attractors WHEEL --over walker.slop=0.1:0.2:2", 2, "walker.slop: not a parameter of WHEEL; did you mean"),
        ("attractors WHEEL --over friction=1:2:2 --keep 1", 2, "--keep is 1, but must be a whole number, at least 2"),
        ("atlas WHEEL --over friction=0.1:0.2", 2, "--over has 1 key, but an atlas needs two parameters"),
        ("atlas WHEEL --over friktion=0.1:0.2 --over walker.slope=0.1:0.2", 2, "friktion: not a parameter of WHEEL"),
        ("atlas WHEEL --over friction=-1:0.2 --over walker.slope=0.1:0.2", 3, "friction: -1.0 must be at least 0"),
        ("atlas WHEEL --over walker.spokes=8:12 --over walker.slope=0.1:0.2", 2, "walker.spokes is a whole number"),
        ("atlas compass-minimum-friction --over friction=1:2 --over walker.slope=0:0.1", 3, "no free parameters"),
    ],
)  # fmt: skip
def test_a_wrong_command_is_refused_at_once_with_its_exit_code_and_leaves_no_folder(run, command, code, words):
    began = time.monotonic()
    ended, out, err = run(*shlex.split(command.replace("WHEEL", WHEEL)))
    assert (ended, out) == (code, ""), err
    assert words.replace("WHEEL", WHEEL) in err
    assert "internal error" not in err
    assert "Traceback" not in err
    assert time.monotonic() - began < 10
    assert not any(Path().iterdir())


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
