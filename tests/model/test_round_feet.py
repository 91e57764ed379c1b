"""Arc feet against equations in other coordinates, where the contact is stated by constraints; slip at the contact."""

from types import SimpleNamespace

import numpy as np
import pytest
from named import named
from oracles import constrained, jacobian, slope_gravity, up
from scipy.integrate import solve_ivp

from gaitopt import Mode
from gaitopt.gait.measures import observe
from gaitopt.model.control import NoControl
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.round_feet import RoundFeetCompass

L, R, B, M_LEG, I_LEG, M_HIP, SLOPE = 1.0, 0.2, 0.5, 0.5, 0.02, 1.0, 0.01
"""The named walker: leg, radius, centre of mass of a leg above the arc's centre, masses; gravity is 1."""
MASSES = np.array([M_LEG, M_HIP, M_LEG])
INERTIA = np.diag([I_LEG, I_LEG, 0, 0])


def positions(q):
    """Leg, hip, leg and the swing foot's centre, from q = (theta1, theta2, X, Y), (X, Y) the stance foot's centre."""
    centre = np.array([q[2], q[3]])
    hip = centre + L * up(q[0])
    return np.array([centre + B * up(q[0]), hip, hip - (L - B) * up(-q[1]), hip - L * up(-q[1])])


def contact(q, foot):
    """Jacobian of the velocity at the contact of the stance (0) or swing (1) foot, rows tangent and normal."""
    if foot == 0:
        return np.array([[-R, 0, 1, 0], [0, 0, 0, 1.0]])
    J = jacobian(positions, q)[6:]
    J[0, 1] += R  # the swing leg turns with -theta2
    return J


def rates(_, y, s=0, mu=0.0):
    """Rates of (q, dq) of a foot that rolls (s = 0), or slides with the sign s of its velocity at the contact."""
    q, dq = np.split(y, 2)
    stance = contact(q, 0)
    held, pushes = (stance, stance) if s == 0 else (stance[1:], stance[1:] - s * mu * stance[:1])
    gravity = slope_gravity(1.0, SLOPE)
    ddq, force = constrained(lambda q: positions(q)[:3], MASSES, gravity, q, dq, held, pushes, inertia=INERTIA)
    return np.concatenate([dq, ddq]), force


def in_centre_coordinates(z):
    """(q, dq) of this file from a state (theta1, theta2, x, dtheta1, dtheta2, dx)."""
    return np.array([z[0], z[1], z[2] + R * z[0], R, z[3], z[4], z[5] + R * z[3], 0.0])


def test_published_walk_is_a_fixed_point_of_the_walk_by_hand():
    gait = named("round-feet-passive")
    period, step = gait.measures["period"], gait.measures["step_length"]
    assert period == pytest.approx(2.428, abs=5e-4)
    assert step == pytest.approx(0.4524, abs=5e-5)
    y0 = in_centre_coordinates(gait.state)
    y = solve_ivp(lambda t, y: rates(t, y)[0], (0, period), y0, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    q, dq = y[:4], y[4:]
    J = jacobian(positions, q)[:6]
    mass, W = J.T * np.repeat(MASSES, 2) @ J + INERTIA, contact(q, 1)
    response = np.linalg.solve(mass, W.T)
    after = dq - response @ np.linalg.solve(W @ response, W @ dq)
    assert positions(q)[3, 1] == pytest.approx(R, abs=1e-9)
    assert [-q[1], -q[0]] == pytest.approx(gait.state[:2], abs=1e-8)
    assert [-after[1], -after[0]] == pytest.approx(gait.state[3:5], abs=1e-8)
    assert positions(q)[1, 0] - positions(y0[:4])[1, 0] == pytest.approx(step, abs=1e-9)  # the hip's travel


@pytest.mark.parametrize(("mode", "s"), [("stick", 0), ("slip_forward", 1), ("slip_backward", -1)])
def test_motion_and_force_are_those_of_constraints_at_the_contact(mode, s):
    rng, mu = np.random.default_rng(4), 0.12
    system = HybridSystem(RoundFeetCompass, NoControl())
    p = np.array([L, R, M_LEG, B, I_LEG, M_HIP, 1.0, SLOPE, mu])
    for _ in range(5):
        z = np.array([*rng.uniform(-0.3, 0.3, 2), 0.0, *rng.uniform(-0.5, 0.5, 2), s * rng.uniform(0.01, 0.1)])
        by_hand, force = rates(0, in_centre_coordinates(z), s, mu)
        dz = np.asarray(system.flow(Mode(mode))(0, z, p, [])).ravel()
        assert dz[3:5] == pytest.approx(by_hand[4:6], abs=1e-7)
        assert dz[5] == pytest.approx(by_hand[6] - R * by_hand[4], abs=1e-7)
        own = np.asarray(system.observation(Mode(mode))(0, z, p, [])[0]).ravel()
        assert own[1] == pytest.approx(force[-1], abs=1e-7)


def test_arcs_are_drawn_and_touch_the_ground():
    gait = named("round-feet-passive")
    walker = type(gait.problem.walker)
    q = SimpleNamespace(theta1=-0.15, theta2=-0.15, x=0.3, y=0.0)
    *_, stance, swing = walker.outline(q, SimpleNamespace(**dict(gait.problem.walker)))
    lowest = [min(float(point[1]) for point in arc) for arc in (stance, swing)]
    assert lowest == pytest.approx([0, 0], abs=5e-4)
    assert observe(gait.arcs[0]).swing_foot[[0, -1], 1] == pytest.approx([0, 0], abs=1e-12)
