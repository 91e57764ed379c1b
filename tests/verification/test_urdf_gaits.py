"""Gaits of robots from files: those of the catalogue's walkers, and optima that keep to the limits of the file."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from abilities import FROM_URDF
from named import named, solved

import gaitopt as go
from gaitopt.problem.statement import Range, problem_data

RABBIT = Path(__file__).resolve().parents[2] / "docs" / "examples" / "rabbit.urdf"
OPTIMAL = """
name: compass-optimal
walker: {urdf: compass.urdf, feet: [stance_leg_foot, swing_leg_foot], gravity: 9.8, slope: 1 deg}
friction: 0.6
control: {type: open_loop, intervals: 4}
gait: {phases: [stick], impact: stick, guess: {step_length: 0.4, duration: 0.7}}
objective: torque_squared
constraints: {speed: 0.6}
"""
FREE = 'type="continuous">\n    <parent link="swing_leg" />'
UNLIMITED = '<limit effort="10000.0" velocity="10000.0" />'


def compass(folder, problem, limit=UNLIMITED):
    """A problem of the compass that ``show --format urdf`` writes, in a folder, with another limit of its hip."""
    text = go.robot_description(go.load_problem("compass-passive-a").walker)
    assert FREE in text
    assert UNLIMITED in text
    text = text.replace(FREE, FREE.replace("continuous", "revolute")) if "lower" in limit else text
    (folder / "compass.urdf").write_text(text.replace(UNLIMITED, limit), encoding="utf-8")
    (folder / "compass.yaml").write_text(problem, encoding="utf-8")
    return go.load_problem(folder / "compass.yaml")


def hip_angles(gait):
    """The angle of the hip along a gait."""
    z = np.vstack([arc.states for arc in gait.arcs])
    return z[:, 0] - z[:, 1]


def test_a_compass_that_was_written_and_read_back_has_the_same_gait(tmp_path):
    gait, same = go.solve(compass(tmp_path, FROM_URDF), progress=False), named("compass-passive-a")
    signs = [1, -1, 1, 1, -1, 1]  # theta2 counts backward
    np.testing.assert_allclose(gait.state, same.state * signs, atol=1e-10)
    np.testing.assert_allclose(np.sort_complex(gait.multipliers), np.sort_complex(same.multipliers), atol=1e-10)
    assert gait.period == pytest.approx(same.period, abs=1e-10)
    assert go.verify(gait).passed
    again = go.load_run(gait.save(tmp_path / "run"))
    assert (tmp_path / "run" / "robot.urdf").read_bytes() == (tmp_path / "compass.urdf").read_bytes()
    assert again.state == pytest.approx(gait.state, abs=0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rabbit-hzd", "rabbit-hzd-slip"])
def test_rabbit_of_the_file_has_the_gait_of_the_class(name):
    data = problem_data(go.load_problem(name))
    data["walker"] = {"urdf": str(RABBIT), "feet": ["stance_foot", "swing_foot"]}
    gait, same = go.solve(go.parse_problem(json.dumps(data)), progress=False), named(name)
    np.testing.assert_allclose(gait.state, same.state, atol=1e-10)
    np.testing.assert_allclose(np.sort_complex(gait.multipliers), np.sort_complex(same.multipliers), atol=1e-10)
    assert gait.message == "solved"  # all joints are within the limits of the file
    assert go.verify(gait).passed


def test_torques_and_joints_of_an_optimum_keep_to_the_limits_of_the_file(tmp_path):
    def limited(limit, text=OPTIMAL):
        return go.solve(compass(tmp_path, text, limit), progress=False)

    free, gait = limited(UNLIMITED), limited('<limit effort="1.1"/>')
    assert free.scalar("peak_torque") > 1.2
    assert gait.scalar("peak_torque") == pytest.approx(1.1, rel=1e-6)
    assert gait.message == "solved"
    wider = limited('<limit effort="1.1"/>', OPTIMAL.replace("intervals: 4", "intervals: 4, bounds: {hip: [-2, 2]}"))
    assert wider.scalar("torque_squared") == pytest.approx(free.scalar("torque_squared"), rel=1e-8)
    assert "hip takes 1.261 N m, more than the effort 1.1 N m of its joint" in wider.message
    problem = compass(tmp_path, OPTIMAL, '<limit effort="10" lower="-0.33" upper="0.302"/>')
    assert problem.constraints["angle.hip"] == Range(minimum=-0.33, maximum=0.302)
    assert problem.replace({"friction": 0.7}).constraints == problem.constraints
    gait = solved(problem)
    assert hip_angles(free).min() < -0.303
    assert hip_angles(gait).max() < 0.302 + 1e-6
    assert problem.replace({"constraints.angle.hip.min": -0.4}).constraints["angle.hip"].minimum == -0.4


def test_a_gait_that_leaves_the_range_of_a_joint_says_so(tmp_path):
    gait = solved(compass(tmp_path, FROM_URDF, '<limit effort="0" lower="-0.2" upper="1"/>'))
    low, high = hip_angles(gait).min(), hip_angles(gait).max()
    told = re.fullmatch(r"solved; hip turns from (\S+) to (\S+) rad, beyond its range from -0.2 to 1", gait.message)
    assert [float(word) for word in told.groups()] == pytest.approx([low, high], abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limit", "changes", "words"),
    [
        ('<limit effort="0.2"/>', {"constraints.speed": 0.8}, r"speed = 0.8 conflicts with the effort of hip: best"),
        pytest.param(
            '<limit effort="10" lower="-0.33" upper="0.33"/>',
            {"constraints.step_length": 0.7},
            r"step_length = 0.7 conflicts with angle.hip: best reached 0.5",
        ),
        pytest.param(UNLIMITED, {"constraints.step_length": 3}, "step_length = 3 conflicts with .*: best reached"),
    ],
)
def test_an_infeasible_task_says_what_is_in_the_way_and_how_far_one_gets(tmp_path, limit, changes, words):
    gait = go.solve(compass(tmp_path, OPTIMAL, limit).replace(changes), progress=False)
    assert gait.status is go.Status.INFEASIBLE
    assert len(gait.message.splitlines()) == 1
    assert re.search(words, gait.message)
