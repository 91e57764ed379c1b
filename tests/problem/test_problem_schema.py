"""The schema of a problem file tells an editor every key, with its unit and range, and no other."""

import json
from functools import cache

import pytest

pytest.importorskip("jsonschema")

from jsonschema.validators import validator_for
from samples import sampled

import gaitopt
from gaitopt import load_problem, problem_names
from gaitopt.model.registry import registered_walkers
from gaitopt.problem.source import parse_source


@cache
def validator():
    schema = gaitopt.problem_schema()
    assert json.loads(json.dumps(schema, allow_nan=False)) == schema
    kind = validator_for(schema)
    kind.check_schema(schema)
    return kind(schema)


@cache
def data_of(name):
    return parse_source(load_problem(name).text, name).data


@pytest.mark.parametrize("name", sampled(problem_names(), 17))
def test_the_schema_accepts_every_named_problem(name):
    assert validator().is_valid(data_of(name))


FREE_CURVE = {"curve": {"degree": 5, "start": "compass-passive-b"}, "beyond_end": "off"}


@pytest.mark.parametrize(
    "change",
    [
        {"friction": {"free": [0.1, 0.2], "guess": 0.14}},
        {"objective": {"speed": -1, "work": 0.1}},
        {"objective": "speed"},
        {"constraints": {"speed": 0.4, "state.theta1": {"min": "-8 deg"}}},
        {"control": {"type": "constant_torque", "ankle": {"free": [0, 1], "guess": 0.5}, "hip": 1}},
        {"control": {"type": "pd", "kp": {"free": [0, 100], "guess": 15}, "kd": 1, "reference": FREE_CURVE}},
        {"impact_law": "frictionless"},
    ],
)
def test_the_schema_accepts_whatever_a_file_may_say(change):
    assert validator().is_valid({**data_of("compass-passive-a"), **change})


@pytest.mark.parametrize(
    "change",
    [
        {"frction": 0.1},
        {"friction": -0.1},
        {"friction": True},
        {"name": "a/b"},
        {"walker": {"model": "compass_biped"}},
        {"control": {"type": "none", "ankle": 1}},
        {"control": {"ankle": 1, "hip": 1}},
        {"control": {"type": "pd", "kp": 1, "kd": 1, "reference": {"gait": "x", "beyond_end": "stop"}}},
        {"constraints": {"speed": {}}},
        {"gait": {"phases": ["slide"], "impact": "stick", "guess": {"state": {}}}},
    ],
)
def test_the_schema_refuses_what_a_file_may_not_say(change):
    assert not validator().is_valid({**data_of("compass-passive-a"), **change})


def test_every_parameter_of_every_walker_is_described():
    *walkers, robot = validator().schema["properties"]["walker"]["oneOf"]
    assert robot["required"] == ["urdf", "feet"]
    assert [walker["properties"]["model"]["const"] for walker in walkers] == list(registered_walkers())
    for walker in (*walkers, robot):
        assert all(entry["description"] for key, entry in walker["properties"].items() if key != "model")


def test_the_integer_spokes_cannot_be_free_and_the_slope_takes_degrees():
    wheel = data_of("rimless-wheel-stick")
    schema = validator()
    assert not schema.is_valid(wheel | {"walker": wheel["walker"] | {"spokes": {"free": [3, 9], "guess": 5}}})
    assert schema.is_valid(wheel | {"walker": wheel["walker"] | {"slope": {"free": ["1 deg", 0.3], "guess": "5deg"}}})
    assert not schema.is_valid(wheel | {"walker": wheel["walker"] | {"slope": 1.6}})


@pytest.mark.parametrize(
    "control",
    sampled(
        [
            {"type": "open_loop", "intervals": 1, "bounds": {"left_hip": [-1, 1]}, "left_hip": [0, 0]},
            {"type": "constant_torque", "left_hip": {"free": [0, 1], "guess": 0.5}},
            {"type": "pd", "kp": 1, "kd": 1, "reference": {"constant": {"left_hip": 1}}},
        ],
        3,
    ),
)
def test_a_robot_from_a_file_has_links_and_motors_of_any_names_and_no_other_walker_has(control):
    robot = {
        **data_of("compass-torque-stick"),
        "walker": {"urdf": "robot.urdf", "feet": ["left_foot", "right_foot"]},
        "control": control,
        "gait": {"phases": ["stick"], "impact": "stick", "guess": {"state": {"left_leg": "3 deg", "dleft_leg": 1}}},
    }
    assert validator().is_valid(robot)
    assert not validator().is_valid(robot | {"walker": data_of("compass-torque-stick")["walker"]})
    assert not validator().is_valid(robot | {"control": {"type": "constant_torque", "left_hip": "much"}})
