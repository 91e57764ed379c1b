"""A compass whose legs differ, against a walk by hand: equations written out, masses that change legs at every step."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from named import named
from scipy.integrate import solve_ivp

import gaitopt as go
from gaitopt import GaitoptError, check_walker
from gaitopt.errors import SolveError
from gaitopt.model.control import NoControl
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.unequal_compass import UnequalCompass
from gaitopt.solver.assembly import solution_of

L, A, HIP, G, SLOPE = 1.6, 0.8, 2.0, 9.8, np.radians(1)
"""Length of the legs, distance of their masses from the feet and from the hip, hip mass, gravity, slope."""


def positions(q):
    """Stance leg's mass, hip, swing leg's mass, swing foot; q = (theta1, theta2)."""
    up, down = (np.array([np.sin(q[0]), np.cos(q[0])]), np.array([np.sin(q[1]), -np.cos(q[1])]))
    return A * up, L * up, L * up + (L - A) * down, L * up + L * down


def rate(_, z, stance, swing):
    """Lagrange's equations of the sticking compass by hand; z = (theta1, theta2, dtheta1, dtheta2)."""
    (a, b), (da, db), c = z[:2], z[2:], L - A
    coupling = -swing * L * c
    M = np.array([
        [stance * A**2 + (HIP + swing) * L**2, -coupling * np.cos(a + b)],
        [-coupling * np.cos(a + b), swing * c**2],
    ])  # fmt: skip
    h = coupling * np.sin(a + b) * np.array([db**2, da**2])
    lift = G * np.array([
        (stance * A + (HIP + swing) * L) * np.sin(a + SLOPE),
        swing * c * np.sin(b - SLOPE) * -1,
    ])  # fmt: skip
    return [da, db, *np.linalg.solve(M, lift - h)]


def land(z, stance, swing):
    """A sticking impact by two balances of angular momentum: of all about the new foot, of the new swing leg about
    the hip."""
    e = 1e-30
    J = [np.array([positions(z[:2] + 1j * e * d)[k].imag / e for d in np.eye(2)]).T for k in range(4)]
    masses = np.array([stance, HIP, swing])
    before = [j @ z[2:] for j in J[:3]]
    places = positions(z[:2])

    def momenta(velocities):
        cross = [m * (r[0] * v[1] - r[1] * v[0]) for m, r, v in zip(masses, relative, velocities, strict=True)]
        arm = places[0] - places[1]
        return np.array([sum(cross), stance * (arm[0] * velocities[0][1] - arm[1] * velocities[0][0])])

    relative = [r - places[3] for r in places[:3]]
    # afterwards the colliding foot rests: velocities relative to it, from rates of the same angles
    columns = [momenta([J[k][:, i] - J[3][:, i] for k in range(3)]) for i in range(2)]
    rates = np.linalg.solve(np.array(columns).T, momenta(before))
    return np.array([-z[1], -z[0], -rates[1], -rates[0]])


def walk(xi, masses=(4.0, 4.4)):
    """Two steps from (theta1, dtheta1, dtheta2); the section coordinates after them, and the two periods."""

    def touchdown(t, z, *_):
        return z[0] - z[1] if t > 0.3 else -1.0

    touchdown.terminal, touchdown.direction = True, 1
    z, periods = np.array([xi[0], xi[0], *xi[1:]]), []
    for stance, swing in (masses, masses[::-1]):
        motion = solve_ivp(
            rate, (0, 3), z, args=(stance, swing), events=touchdown, rtol=1e-11, atol=1e-12, method="DOP853"
        )
        z = land(motion.y[:, -1], stance, swing)
        periods.append(motion.t[-1])
    return z[[0, 2, 3]], periods


@cache
def derivative():
    gait, h = named("compass-unequal"), 1e-5
    xi = gait.state[[0, 3, 4]]
    return np.array([(walk(xi + h * d)[0] - walk(xi - h * d)[0]) / (2 * h) for d in np.eye(3)]).T


def test_the_limp_is_a_fixed_point_of_the_walk_by_hand():
    gait = named("compass-unequal")
    xi = gait.state[[0, 3, 4]]
    back, periods = walk(xi)
    assert back == pytest.approx(xi, abs=1e-9)
    assert [step.period for step in gait.steps] == pytest.approx(periods, abs=1e-9)
    assert periods == pytest.approx([0.7600, 0.7056], abs=5e-5)


def test_multipliers_of_the_limp_are_those_of_the_walk_by_hand():
    gait = named("compass-unequal")
    by_hand = np.linalg.eigvals(derivative())
    assert sorted(abs(gait.multipliers)) == pytest.approx(sorted(abs(by_hand)), abs=1e-6)
    assert sorted(abs(gait.multipliers)) == pytest.approx([0.149, 0.544, 0.544], abs=5e-4)


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


def test_whichever_leg_stands_first_the_walk_is_the_same():
    gait = named("compass-unequal")
    changed = {"walker.leg_mass": 4.4, "walker.other_leg_mass": 4.0}
    second = dict(zip(gait.system.state_names, map(float, gait.steps[1].arcs[0].states[0]), strict=True))
    other = go.solve(gait.problem.replace({**changed, "gait.guess.state": second}))
    assert [s.period for s in other.steps] == pytest.approx([s.period for s in gait.steps][::-1], abs=1e-10)
    assert sorted(abs(other.multipliers)) == pytest.approx(sorted(abs(gait.multipliers)), abs=1e-8)


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


def test_legs_that_differ_must_be_exchanged():
    class Forgetful(UnequalCompass):
        exchanged = {}  # noqa: RUF012

    with pytest.raises(GaitoptError, match="masses jump"):
        check_walker(Forgetful, named("compass-unequal").problem.walker.model_dump())

    class Misspelt(UnequalCompass):
        exchanged = {"leg_mass": "other_mass"}  # noqa: RUF012

    with pytest.raises(GaitoptError, match="exchanged names other_mass"):
        HybridSystem(Misspelt, NoControl())


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
