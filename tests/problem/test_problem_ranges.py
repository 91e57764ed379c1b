"""Numbers that no walker can have are refused with their range, unusual ones are remarked and solved all the same."""

import math
import re
from itertools import islice

import pytest

import gaitopt as go
from gaitopt import parse_problem, problem_schema
from gaitopt.errors import ProblemError

TORQUE, PASSIVE, PD, CURVE = (
    "compass-torque-efficient",
    "compass-passive-stick",
    "compass-pd-impact-slip",
    "compass-pd-designed",
)
WHEEL = "rimless-wheel-stick"
IMPOSSIBLE = [
    (TORQUE, "constraints.period", -1, "from 4.04061e-07 to 404.061 (from 1e-06 sqrt(l/g) to 1000 sqrt(l/g))"),
    (TORQUE, "constraints.step_length", 10, "at most 6.4 in size (at most 4 l in size)"),
    (TORQUE, "constraints.speed", 1e6, "at most 395.98 in size"),
    (TORQUE, "constraints.peak_torque", {"max": -1}, "at least 0"),
    (TORQUE, "constraints.torque_squared", -1, "at least 0"),
    (TORQUE, "constraints.absolute_cost_of_transport", {"max": -1e-9}, "from 0 to 1e+06"),
    (TORQUE, "constraints.min_normal_force", {"min": 99}, "from 0 to 98 (from 0 to 1 m g)"),
    (TORQUE, "constraints.foot_clearance", 5, "at most 3.2 in size"),
    (TORQUE, "constraints.state.theta1", 5, "at most 1.5708 in size"),
    (TORQUE, "constraints.state.dtheta1", 1e3, "at most 247.487 in size (at most 100 sqrt(g/l) in size)"),
    (TORQUE, "control.hip", {"free": [-1, 1e9], "guess": 0}, "at most 156800 in size (at most 1000 m g l in size)"),
    (PASSIVE, "friction", 1e300, "at least 0 and at most 1000"),
    (PASSIVE, "walker.slope", "89.99 deg", "at least -1.39626 and at most 1.39626"),
    (PASSIVE, "walker.leg_mass", 1e-300, "greater than 0, and at least 1e-30"),
    (PASSIVE, "walker.gravity", 1e300, "at most 1e+30"),
    (PASSIVE, "gait.guess.state.theta1", 1e10, "at least -1.5708 and at most 1.5708"),
    (PASSIVE, "gait.guess.state.theta1", 0, "a step begins with the feet apart"),
    (PASSIVE, "gait.guess.state.dtheta1", 1e200, "at most 247.487 in size"),
    (PASSIVE, "gait.guess.durations", [1e300], "from 0 to 404.061"),
    (PASSIVE, "gait.phases", ["stick", "slip_forward"] * 33, "has 66 entries, must have at most 64"),
    (WHEEL, "walker.spokes", 10**9, "at least 3 and at most 1000"),
    (WHEEL, "gait.guess.state.dtheta", 1e10, "at most 100 in size"),
    (PD, "control.kp", 1e300, "from 0 to 156800 (from 0 to 1000 m g l)"),
    (PD, "control.reference.gait", "", "must not be empty"),
    (CURVE, "control.reference.curve.start", "", "must not be empty"),
    (CURVE, "control.reference.curve.duration", 1e6, "from 0 to 404.061"),
    (CURVE, "control.reference.curve.within", 4, "at most 3.14159"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "key", "value", "words"), IMPOSSIBLE)
def test_what_no_walker_can_have_is_refused_with_its_range(name, key, value, words):
    with pytest.raises(ProblemError) as caught:
        go.load_problem(name).replace({key: value})
    (line,) = str(caught.value).splitlines()
    assert line.startswith(f"{key}")
    assert words in line


@pytest.mark.parametrize(
    ("name", "key", "value", "words"),
    [
        (PASSIVE, "friction", 5, "5 is unusual; usually from 0 to 3"),
        (PASSIVE, "friction", 0.01, "0.01 is less than tan(slope) = 0.01746: no steady gait"),
        (PASSIVE, "walker.slope", 0, "no source of energy: a passive walker on level or uphill ground"),
        (PASSIVE, "walker.slope", "-1 deg", "no source of energy"),
        (PASSIVE, "walker.leg_mass", 1e-8, "5e-09 of the total mass"),
        (PASSIVE, "gait.guess.state.dtheta1", 20, "20, that is 8.08 sqrt(g/l) is unusual"),
        (WHEEL, "walker.spokes", 200, "200 is unusual; usually from 3 to 100"),
        (WHEEL, "walker.slope", "40 deg", "0.698132, that is 0.698 rad is unusual; usually at most 0.523599 rad in"),
        (WHEEL, "walker.slope", 1, "1 rad is 57.3 deg; did you mean 1 deg?"),
        (PASSIVE, "walker.leg_length", 1600, "1600 m is unusual; did you mean 1600 mm, which is 1.6?"),
        (PD, "control.kp", 1e4, "10000, that is 63.8 m g l is unusual"),
        (TORQUE, "constraints.speed", 10, "10, that is 2.53 sqrt(g l) is unusual"),
        (PASSIVE, "gait.phases", ["stick", "slip_forward"] * 32, "64 phases in one step are many: a solution may take"),
    ],
)
def test_what_is_merely_unusual_is_remarked(name, key, value, words):
    problem = go.load_problem(name)
    assert not problem.remarks
    changed = problem.replace({key: value})
    assert any(line.startswith(f"{key}") and words in line for line in changed.remarks)


def test_a_remark_names_the_value_it_is_about_wherever_that_was_given_last():
    text = go.load_problem(PASSIVE).text.replace("friction: 0.2", "friction: 20")
    stated, in_file = parse_problem(text), f"problem:{text.splitlines().index('friction: 20') + 1}:1 friction: 20 is"
    for changes in ({}, {"walker.hip_mass": 2.5}, {"walker.hip_mass": 2.5, "gait.guess.state.theta1": -0.21}):
        (remark,) = stated.replace(changes).remarks
        assert remark.startswith(in_file)
    (remark,) = stated.replace({"friction": 30}).replace({"walker.hip_mass": 2.5}).remarks
    assert remark.startswith("friction: 30 is unusual")
    assert not stated.replace({"friction": 0.2}).remarks


def test_ranges_in_natural_units_follow_the_walker():
    giant = {"walker.leg_length": 160.0, "walker.leg_com": 80.0}
    go.load_problem(TORQUE).replace({"constraints.step_length": 10, **giant})


def test_the_range_of_a_limit_is_that_of_what_it_leaves_over():
    problem = go.load_problem(TORQUE)
    problem.replace({"constraints.spectral_radius": {"min": -1, "max": 0.5}})  # the lower limit says nothing
    problem.replace({"constraints.period": {"min": -1}})


def test_every_range_is_in_the_schema():
    schema = problem_schema()["properties"]
    scalars = schema["constraints"]["properties"]
    assert "from 1e-06 sqrt(l/g) to 1000 sqrt(l/g)" in scalars["period"]["description"]
    assert scalars["spectral_radius"]["anyOf"][0]["minimum"] == 0
    assert schema["friction"]["anyOf"][0]["maximum"] == 1000
    assert schema["gait"]["oneOf"][0]["properties"]["phases"]["maxItems"] == 64


NO_NUMBERS = [math.nan, math.inf, -math.inf, 10**400, 1e300, -1e300, True, False, "abc", "", None, [], [1.0], {}, 1j]
YAML_NO_NUMBERS = [".nan", ".inf", "-.inf", "1e400", "1e300", "true", "abc", "''", "null", "[]", "[1]", "{}", "9" * 400]
HUGE_IS_A_UNIT = ("mass", "gravity")
SIGNED = ("slope", "hip_rest", "front_angle", "back_angle")


def numbers_of_walkers():
    """A problem and a key for every parameter of every walker, every control value and every kind of friction."""
    seen = set()
    for name in go.problem_names():
        problem = go.load_problem(name)
        for key in problem.parameters:
            group = problem.walker.model if key.startswith("walker") else ""
            kind = re.sub(r"\.[a-z_]+\.[1-9]\d*$", ".N", key)  # one value of a torque or curve stands for the others
            if key not in problem.free and (group, kind) not in seen:
                seen.add((group, kind))
                yield problem, key


def accepts(problem, key, value):
    try:
        problem.replace({key: value})
    except ProblemError:
        return False
    return True


@pytest.mark.parametrize("every", [5, pytest.param(1, marks=pytest.mark.slow)])
def test_no_number_takes_nonsense(every):
    count = 0
    for problem, key in islice(numbers_of_walkers(), 0, None, every):
        signed = key.endswith(SIGNED) or (key.startswith("control") and not key.startswith("control.k"))
        nonsense = [*NO_NUMBERS, *([] if signed else [-1.0, -1e-9])]
        nonsense += [] if any(word in key for word in HUGE_IS_A_UNIT) else [1e30, -1e30]
        assert [value for value in nonsense if accepts(problem, key, value)] == [], (problem, key)
        tiny = {accepts(problem, key, value) for value in (1e-320, 1e-300, 1e-31)}
        assert tiny == {accepts(problem, key, 0.0)}, (problem, key)  # what is below the smallest number counts as zero
        count += 1
    assert count > 150 / every


@pytest.mark.parametrize("text", YAML_NO_NUMBERS)
@pytest.mark.parametrize("key", ["leg_mass", "slope", "friction", "ankle", "theta1"])
def test_a_file_takes_no_nonsense_either(key, text):
    before = go.load_problem("compass-torque-stick").text or ""
    changed = re.sub(rf"\b{key}: [^,}}#\n]+", f"{key}: {text}", before)
    assert changed != before
    with pytest.raises(ProblemError):
        parse_problem(changed)


def test_a_remark_is_located_after_any_number_of_changes():
    """A branch changes one value at every point; places of values that are set again are dropped."""
    problem = go.load_problem(PASSIVE).replace({"walker.slope": "80 deg"}, label="--set ")
    for k in range(1100):  # above Python's limit of recursion
        problem = problem.replace({"friction": 6 + 1e-4 * k})
    assert {line.partition(":")[0] for line in problem.remarks} == {"friction", "--set walker.slope"}
    assert problem.replace({"walker.slope": "79 deg", "friction": 6.0}).remarks[0].startswith("walker.slope:")
