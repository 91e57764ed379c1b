"""Feet that friction wedges in between body and ground: sticking and lifting off satisfy the laws of rigid bodies.

A braking torque would lift the foot just after its impact, C_tt f_n < C_nt f_t, but the force that holds it is in the
cone. Ground that yields a little decides, because its force is a function of its deformation:

    f_n = k d + c d',      f_t = -k e - c e',      abs(f_t) <= mu f_n

with the depth d, and the stretch e of the contact, which grows with the velocity of the foot while it sticks. Its
damping makes the impact plastic.
"""

import numpy as np
import pytest
from numpy.typing import NDArray
from oracles import compass_oracle
from scipy.integrate import solve_ivp

import gaitopt as go
from gaitopt import Mode
from gaitopt.simulation.contact_resolver import ContactResolver
from gaitopt.simulation.simulator import Simulator

Array = NDArray[np.float64]

NUMBERS = {"leg_length": 1.6, "leg_mass": 0.5, "leg_com": 1.2, "hip_mass": 8.0, "gravity": 9.8}
SLOPE, BRAKE, FRICTION = 6.0, -7.5, 1.0
MOTOR = np.array([[1, 1], [0, 1], [0, 0], [0, 0]])
"""Generalised forces of the torques of ankle and hip in (theta1, theta2, x, y)."""


def braked() -> go.Gait:
    changes = {f"walker.{name}": value for name, value in NUMBERS.items()} | {"walker.slope": f"{SLOPE} deg"}
    torques = {"control.ankle": BRAKE, "control.hip": 0.0}
    return go.solve(go.load_problem("compass-torque-stick").replace({"friction": FRICTION, **changes, **torques}))


def landed(q: Array, dq: Array, stiffness: float, time: float) -> tuple[Array, Array]:
    """Coordinates (theta1, theta2, x, y) and rates of a compass some time after its foot lands on yielding ground."""
    oracle, damping = compass_oracle(**NUMBERS, slope=np.radians(SLOPE)), 30 * stiffness**0.5

    def rates(_: float, y: Array) -> Array:
        q, dq, stretch = y[:4], y[4:8], y[8]
        f_n = max(0.0, -stiffness * q[3] - damping * dq[3]) if q[3] <= 0 else 0.0
        held, slope = -stiffness * stretch - damping * dq[2], dq[2]
        f_t = float(np.clip(held, -FRICTION * f_n, FRICTION * f_n))
        if f_t != held:  # it slips, and the stretch follows the force
            slope = -(f_t + stiffness * stretch) / damping
        force = MOTOR @ [BRAKE, 0.0] + [0.0, 0.0, f_t, f_n]
        return np.array([*dq, *np.linalg.solve(oracle.M(q), force - oracle.B(q, dq) - oracle.G(q)), slope])

    end = solve_ivp(rates, (0.0, time), [*q, *dq, 0.0], method="Radau", rtol=1e-6, atol=1e-11).y[:, -1]
    return end[:4], end[4:8]


@pytest.fixture(scope="module")
def gait() -> go.Gait:
    found = braked()
    assert found.converged, found.message
    return found


def test_a_wedged_foot_could_lift_off(gait: go.Gait) -> None:
    """A foot that is let go accelerates with minus f_n (C_tt + mu s C_nt) of a slip, times a positive number."""
    table = gait.system.transitions
    for slip in (Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD):
        names, values = table.margin_names(slip), gait.system.margins(slip)(0, gait.state, gait.p, [])
        margins = dict(zip(names, np.asarray(values).ravel(), strict=True))
        assert margins["normal_force"] * margins["painleve"] < 0
    assert gait.scalar("required_friction") < FRICTION / 2


def test_a_wedged_foot_sticks_and_the_gait_is_verified(gait: go.Gait) -> None:
    candidates = gait.system.transitions.at_rest(Mode.STICK)
    assert ContactResolver(gait.dynamics).mode_at_rest(candidates, 0.0, gait.state, 0) is Mode.STICK
    assert go.verify(gait).passed


def test_a_wedged_foot_sticks_to_ground_that_yields(gait: go.Gait) -> None:
    """The harder the ground, the nearer is its motion to that of the foot that sticks."""
    time, stepper = 0.02, Simulator(gait.dynamics).stepper
    rigid = stepper.sample(Mode.STICK, 0, gait.state, np.array([0.0, time]))[-1]
    theta1, theta2, _, rate1, rate2, _ = gait.steps[0].arcs[-1].states[-1]
    oracle = compass_oracle(**NUMBERS, slope=np.radians(SLOPE))
    falling = oracle.swing_foot.velocity(np.array([theta1, theta2, 0, 0]), np.array([rate1, rate2, 0, 0]))
    q, dq = np.array([-theta2, -theta1, 0, 0]), np.array([-rate2, -rate1, *falling])
    errors = []
    for stiffness in (1e6, 1e8):
        position, velocity = landed(q, dq, stiffness, time)
        assert position[3] < 0
        errors.append(np.abs(np.array([*position[:3], *velocity[:3]]) - rigid).max())
    assert errors[1] < errors[0] / 5
    assert errors[1] < 1e-3
