"""Push-off against momentum balances of its own, and designs; friction under it is tested in ``test_combinations``."""

from math import cos, sin

import numpy as np
import pytest
from named import named
from oracles import compass_oracle

import gaitopt as go

NAME = "compass-push-off"


def one_step(xi):
    """Section coordinates after one step from (theta1, dtheta1, dtheta2), length, period and the work of the push."""
    walker = dict(named(NAME).problem.walker)
    P, oracle = walker.pop("push"), compass_oracle(**walker)
    q, dq, period = oracle.swing([xi[0], xi[0], 0, 0], [*xi[1:], 0, 0])
    M = oracle.M(q)
    pushed = dq + np.linalg.solve(M, [0, 0, P * sin(q[0]), P * cos(q[0])])
    _, after = oracle.impulse(q, pushed, 0, 0.0)
    work = (pushed @ M @ pushed - dq @ M @ dq) / 2
    return np.array([-q[1], -after[1], -after[0]]), oracle.swing_foot.position(q)[0], period, work


def test_the_gait_is_a_fixed_point_of_the_step_by_hand():
    gait = named(NAME)
    xi = gait.state[[0, 3, 4]]
    back, length, period, work = one_step(xi)
    assert back == pytest.approx(xi, abs=1e-8)
    assert gait.measures["step_length"] == pytest.approx(length, abs=1e-9)
    assert gait.measures["period"] == pytest.approx(period, abs=1e-9)
    assert (period, length) == pytest.approx((0.6933, 0.4004), abs=5e-5)
    assert gait.measures["work"] == pytest.approx(work, rel=1e-7)
    weight = 20 * 9.81
    assert gait.measures["cost_of_transport"] == pytest.approx(work / (weight * length), rel=1e-7)
    h = 1e-5
    J = np.array([(one_step(xi + h * e)[0] - one_step(xi - h * e)[0]) / (2 * h) for e in np.eye(3)]).T
    assert np.poly(gait.multipliers) == pytest.approx(np.poly(J), abs=1e-6)


def test_a_push_is_designed_for_speed_and_for_cost():
    problem = named(NAME).problem
    free = {"walker.push": {"free": [1, 8], "guess": 4}}
    fast = go.solve(problem.replace({**free, "constraints": {"speed": 0.62}, "friction": 1}))
    assert fast.converged, fast.message
    assert fast.measures["speed"] == pytest.approx(0.62, abs=1e-8)
    assert go.verify(fast).passed
    changes = {**free, "constraints": {"speed": {"min": 0.6}}, "objective": "cost_of_transport", "friction": 1}
    cheap = go.solve(problem.replace(changes))
    assert cheap.converged, cheap.message
    assert cheap.measures["speed"] == pytest.approx(0.6, abs=1e-6)
    assert cheap.measures["cost_of_transport"] > named(NAME).measures["cost_of_transport"]


def test_without_a_push_nothing_replaces_what_the_impact_takes():
    failed = go.solve(named(NAME).problem.replace({"walker.push": 0}))
    assert not failed.converged
    assert "no source of energy" in failed.message
