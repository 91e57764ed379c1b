"""Gaits of feedback laws: controlled symmetries, and a torso held upright; by gaitopt and by Newton's law by hand."""

import re
from collections.abc import Callable
from functools import cache
from math import cos, radians, sin

import numpy as np
import pytest
from named import named, solved, verification
from numpy.typing import NDArray
from oracles import Oracle, compass_oracle, torso_oracle
from scipy.interpolate import CubicSpline

import gaitopt as go
from gaitopt import Mode
from gaitopt.errors import ProblemError
from gaitopt.gait.gait import multiplier_distance
from gaitopt.systems import build_system, problem_dynamics

Array = NDArray[np.float64]
STICK = Mode.STICK
VIRTUAL = radians(3)
NAMES = ("compass-shaped", "torso-upright", "compass-table")
TABLE = np.radians([-6, -4, 0, 5, 9, 11, 11, 9, 8])
SPLINE = CubicSpline(np.arange(9) / 10, TABLE)


@pytest.mark.portable
def test_the_shaped_gait_is_the_passive_one() -> None:
    """The motors add to each coordinate of the shape what virtual gravity would: Spong and Bullo (2005).

    The impact takes from both gaits the same energy, so that the cost of transport is the virtual inclination.
    """
    shaped = named("compass-shaped")
    passive = go.solve(shaped.problem.replace({"control": {"type": "none"}, "walker.slope": VIRTUAL}))
    assert [mode for mode, _ in shaped.phases] == [STICK]
    assert shaped.period == pytest.approx(passive.period, abs=1e-9)
    assert shaped.state == pytest.approx(passive.state, abs=1e-9)
    assert multiplier_distance(shaped.multipliers, passive.multipliers) < 1e-9
    assert shaped.measures["cost_of_transport"] == pytest.approx(sin(VIRTUAL), abs=1e-10)


def shaped_motors(oracle: Oracle) -> Callable[[Array, Array, float], Array]:
    """Generalised forces of controlled symmetries: what virtual gravity does beyond gravity."""
    angle = VIRTUAL
    virtual = np.linalg.norm(oracle.gravity) * np.array([sin(angle), -cos(angle)])

    def forces(q: Array, dq: Array, t: float) -> Array:
        return sum(m.mass * m.point.jacobian(q).T @ (virtual - oracle.gravity) for m in oracle.masses)

    return forces


def hip_motor(q: Array, dq: Array, t: float) -> Array:
    """PD torque of ``compass-table`` between the legs; theta2 is measured in the opposite direction."""
    hip = -30 * (q[1] - SPLINE(t)) - 5 * (dq[1] - SPLINE(t, 1))
    return np.array([hip, hip, 0, 0])


def upright_motors(q: Array, dq: Array, t: float) -> Array:
    """PD torques of ``torso-upright``: the first turns the torso against the stance leg, the second the swing leg."""
    stance_hip = -80 * q[2] - 5 * dq[2]
    swing_hip = -80 * (q[1] - radians(10)) - 5 * dq[1]
    return np.array([-stance_hip, swing_hip, stance_hip + swing_hip, 0, 0])


def oracle_of(name: str) -> tuple[Oracle, Callable[[Array, Array, float], Array]]:
    walker = dict(named(name).problem.walker)
    if name == "compass-shaped":
        oracle = compass_oracle(**walker)
        return oracle, shaped_motors(oracle)
    if name == "compass-table":
        return compass_oracle(**walker), hip_motor
    assert walker.pop("hip_stiffness") == walker.pop("hip_damping") == 0
    return torso_oracle(**walker, stiffness=0.0), upright_motors


@cache
def step_by_hand(name: str) -> tuple[Array, float, float, float]:
    """State after one sticking step, impulse ratio, length and period; motors act on the shape alone."""
    gait, (oracle, motors) = named(name), oracle_of(name)
    n = len(gait.problem.walker.shape)
    start = [*gait.state[:n], 0, 0], [*gait.state[n + 1 : -1], 0, 0]
    q, dq, period = oracle.swing(*start, lambda q, dq, t: motors(q, dq, t) * (np.arange(n + 2) < n))
    impulse, dq = oracle.impulse(q, dq, 0, 0.0)
    length, height = oracle.swing_foot.position(q)
    assert height == pytest.approx(0, abs=1e-9)
    state = np.concatenate([[-q[1], -q[0]], q[2:n], [-dq[1], -dq[0]], dq[2:n]])
    return state, impulse[0] / impulse[1], length, period


@pytest.mark.portable
@pytest.mark.parametrize("name", NAMES)
def test_the_gait_is_confirmed_and_repeats_itself_under_newtons_law_by_hand(name: str) -> None:
    gait, (state, ratio, length, period) = named(name), step_by_hand(name)
    assert gait.spectral_radius < 0.75
    assert [claim for claim in verification(name).claims if not claim.passed] == []
    n = len(gait.problem.walker.shape)
    assert state == pytest.approx(np.concatenate([gait.state[:n], gait.state[n + 1 : -1]]), abs=1e-9)
    assert abs(ratio) == pytest.approx(gait.measures["impulse_ratio"], abs=1e-9)
    assert [length, period] == pytest.approx([gait.measures["step_length"], gait.period], abs=1e-9)


# controlled symmetries


# set-points


CONSTANT = "{torso: 0, theta2: 10 deg}"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (CONSTANT, "{}", r"21:15 control.reference.constant: has 0 entries, must have at least 1"),
        (CONSTANT, "3", r"21:15 control.reference.constant: 3 is not a mapping"),
        (CONSTANT, "{hip: 0}", r"constant.hip: is not a tracked joint of driven_torso; .* torso, theta2"),
        (CONSTANT, "{torso: 200 deg}", r"constant.torso: 3.49066 is impossible: .* at most 1.5708 rad"),
        (CONSTANT, "{torso: x}", r"constant.torso: write an angle as a number in rad, or with its unit"),
        (CONSTANT, "{torso: .nan}", r"constant.torso: nan is not a finite number"),
        (
            "(?s)control:.*(?=gait:)",
            "control: {type: controlled_symmetry, virtual_slope: 3 deg}\n",
            r"controlled_symmetry.*one motor for each.*theta1, theta2, torso",
        ),
    ],
)
def test_wrong_set_points_and_symmetries_with_a_motor_too_few_are_named(old: str, new: str, message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        go.parse_problem(re.sub(old, new, go.load_problem("torso-upright").text, count=1))


def test_set_points_are_parameters_of_one_system() -> None:
    problem = go.load_problem("torso-upright")
    assert problem.parameters["control.reference.constant.theta2"] == radians(10)
    systems, lengths = set(), []
    for angle in ("10 deg", "11 deg", "12 deg"):
        changed = problem.replace({"control.reference.constant.theta2": angle})
        systems.add(build_system(changed))
        gait = solved(changed)
        lengths.append(gait.measures["step_length"])
    assert lengths[2] > 1.1 * lengths[0]
    assert len(systems) == 1


def test_the_motor_of_a_joint_without_a_set_point_is_off() -> None:
    text = go.load_problem("torso-upright").text.replace("theta2: 10 deg", "").replace("0, }", "0}")
    dynamics = problem_dynamics(go.parse_problem(text))
    z = np.array([0.1, -0.2, 0.3, 0.0, 0.5, -0.4, 0.6, 0.0])
    torque = dynamics.system.observation(STICK)(0.1, z, dynamics.p, dynamics.system.data(0))[1]
    assert np.asarray(torque).ravel() == pytest.approx([-80 * 0.3 - 5 * 0.6, 0])
