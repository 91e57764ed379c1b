"""A compass whose legs differ, against a walk by hand, with masses that change legs at every step."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from named import named
from oracles import compass_oracle

import gaitopt as go
from gaitopt import GaitoptError
from gaitopt.errors import SolveError
from gaitopt.solver.assembly import solution_of


def walk(xi):
    """Two steps from (theta1, dtheta1, dtheta2); the section coordinates after them, and the two periods."""
    numbers, periods = dict(named("compass-unequal").problem.walker), []
    q, dq = [xi[0], xi[0], 0, 0], [*xi[1:], 0, 0]
    for _ in range(2):
        oracle = compass_oracle(**numbers)
        q, dq, period = oracle.swing(q, dq)
        _, after = oracle.impulse(q, dq, 0, 0.0)
        q, dq = [-q[1], -q[0], 0, 0], [-after[1], -after[0], 0, 0]
        periods.append(period)
        for name in ("leg_mass", "leg_com"):
            numbers[name], numbers[f"other_{name}"] = numbers[f"other_{name}"], numbers[name]
    return np.array([q[0], *dq[:2]]), periods


def test_the_limp_is_a_fixed_point_of_the_walk_by_hand_and_has_its_multipliers():
    gait, h = named("compass-unequal"), 1e-5
    xi = gait.state[[0, 3, 4]]
    back, periods = walk(xi)
    assert back == pytest.approx(xi, abs=1e-9)
    assert [step.period for step in gait.steps] == pytest.approx(periods, abs=1e-9)
    assert periods == pytest.approx([0.7600, 0.7056], abs=5e-5)
    derivative = np.array([(walk(xi + h * d)[0] - walk(xi - h * d)[0]) / (2 * h) for d in np.eye(3)]).T
    sizes = sorted(abs(gait.multipliers))
    assert sizes == pytest.approx(sorted(abs(np.linalg.eigvals(derivative))), abs=1e-6)
    assert sizes == pytest.approx([0.149, 0.544, 0.544], abs=5e-4)


@cache
def slippery():
    """The family of limps down to friction 0.19."""
    return go.continuation(named("compass-unequal"), "friction", 0.19)


def test_one_impact_slides_where_friction_is_short():
    branch = slippery()
    (change,) = branch.special("impact_change")
    assert change.value == pytest.approx(named("compass-unequal").measures["impulse_ratio"], abs=1e-9)
    gait = min((point.gait for point in branch.points), key=lambda gait: gait.p[-1])
    assert gait.p[-1] == pytest.approx(0.19)
    assert sorted(step.impact.mode for step in gait.steps) == ["slip_forward", "stick"]
    assert go.verify(gait).passed


def test_where_an_impact_begins_to_slide_no_third_family_begins():
    """The cycles of both sequences in turn are among those that are tried."""
    (change,) = slippery().special("impact_change")
    with pytest.raises(SolveError, match="no other branch"):
        go.continuation(change, "friction", 0.199)


@pytest.mark.slow
def test_the_family_of_limps_starts_from_the_symmetric_gait_walked_twice():
    symmetric = named("compass-passive-stick")
    twice = go.solve(named("compass-unequal").problem.replace({"walker.other_leg_mass": 4.0}))
    for step in twice.steps:
        assert step.arcs[0].states[0] == pytest.approx(symmetric.state, abs=1e-9)
    assert np.poly(twice.multipliers) == pytest.approx(np.poly(symmetric.multipliers**2), abs=1e-8)
    branch = go.continuation(twice, "walker.other_leg_mass", 4.4)
    end = max((point.gait for point in branch.points), key=lambda gait: gait.problem.walker.other_leg_mass)
    assert end.state == pytest.approx(named("compass-unequal").state, abs=1e-8)


@pytest.mark.parametrize(
    "gait",
    [
        {"phases": ["stick"], "impact": "stick", "guess": {"state": {"theta1": -0.1, "dtheta1": 0.7, "dtheta2": -0.5}}},
        {"phases": "auto", "steps": 1},
    ],
)
def test_a_cycle_of_an_odd_number_of_steps_is_refused(gait):
    with pytest.raises(GaitoptError, match=r"where the legs differ, a cycle has 2, 4"):
        named("compass-unequal").problem.replace({"gait": gait})


@pytest.mark.parametrize("key", ["walker.leg_mass", "walker.other_leg_com", "walker.hip_mass"])
def test_the_equations_know_that_a_free_parameter_belongs_to_the_other_leg_in_the_next_step(key):
    at = solution_of(named("compass-unequal"), (key,))
    values, jacobian = at.equations.linearised(at.w, at.p)
    np.testing.assert_allclose(values, at.equations.violation(at.w, at.p), atol=1e-12)
    column, step = jacobian.dense(at.w.size - 1, at.w.size).ravel(), 1e-5
    change = step * np.eye(at.w.size)[-1]
    ahead, behind = (at.equations.violation(at.w + sign * change, at.p) for sign in (1, -1))
    np.testing.assert_allclose(column, (ahead - behind) / (2 * step), rtol=1e-5, atol=1e-8)
    first, second = np.split(np.abs(column[: at.equations.mesh.intervals * 6]), 2)
    assert first.max() > 1e-4
    assert second.max() > 1e-4


def test_every_arc_has_the_dynamics_of_its_step():
    """The leg masses change places at touchdown, by the solver, the simulator and under other dynamics alike."""
    gait = named("compass-unequal")
    moved = gait.dynamics.at({"walker.leg_com": 0.7})
    masses = [gait.dynamics.parameter(f"walker.{name}") for name in ("leg_mass", "other_leg_mass")]
    for steps in (gait.steps, go.simulate(gait, steps=4).trajectory.steps):
        assert [[arc.dynamics.parameter("walker.leg_mass") for arc in step.arcs[:1]] for step in steps] == [
            [masses[k % 2]] for k in range(len(steps))
        ]
    for arc, own in zip(replace(gait, dynamics=moved).arcs, gait.problem.cycle.per_phase(moved.steps), strict=True):
        assert arc.dynamics is own
    assert moved.steps[1].parameter("walker.other_leg_com") == 0.7
    np.testing.assert_array_equal(moved.steps[1].steps[1].p, moved.p)
