"""Validation of adapters: motions with closed forms, and a judgement that small errors of an engine do not pass.

A case takes an adapter's class, a time step and settings, and returns the measured and the exact number. The judgement
extrapolates the deviation from a gait before its impact linearly to the time step zero.
"""

import numpy as np

from gaitopt.engines.outcome import run
from gaitopt.engines.plant import Body, Foot, Tree

G = 9.81
ANGLE, SPEED = 2e-5, 5e-6
"""Largest limits of the deviations of the angles [rad], and of the speed of the foot that sticks [natural units]. Those
of the engines at their best settings are 1.2e-5 and 5e-7."""


def block(simulator, dt, settings, mu=0.3, v0=1.0):
    """Distance [m] that a block slides to rest, v0^2 / (2 mu g); it keeps its two feet on the ground."""
    body = Body("block", -1, (0.0, 0.0), 2.0, (0.0, 0.0), 0.1, 0.0)
    tree = Tree(bodies=(body,), feet=(Foot(0, (-0.5, -0.05), 0.0), Foot(0, (0.5, -0.05), 0.0)), gravity=(0.0, -G))
    walk = simulator(tree, mu, dt, settings)
    walk.place(np.array([0.0, 0.05, 0.0]), np.array([v0, 0.0, 0.0]))
    for _ in range(round(1.5 * v0 / (mu * G) / dt)):
        q, _, _ = walk.step(np.zeros(3), (True, True))
    return float(q[0]), v0**2 / (2 * mu * G)


def pendulum(simulator, dt, settings, length=0.5, amplitude=0.01):
    """Angle [rad] of a small pendulum on a heavy stand after a second, a cos(w t)."""
    stand = Body("stand", -1, (0.0, 0.0), 1e4, (0.0, 0.0), 1e3, 0.0)
    bob = Body("bob", 0, (0.0, 1.0), 0.1, (0.0, -length), 1e-3, 0.0)
    tree = Tree(bodies=(stand, bob), feet=(Foot(0, (-0.5, 0.0), 0.0), Foot(0, (0.5, 0.0), 0.0)), gravity=(0.0, -G))
    walk = simulator(tree, 1.0, dt, settings)
    walk.place(np.array([0.0, 0.0, 0.0, amplitude]), np.zeros(4))
    for _ in range(round(1.0 / dt)):
        q, _, _ = walk.step(np.zeros(4), (True, True))
    rate = np.sqrt(0.1 * G * length / (1e-3 + 0.1 * length**2))
    return float(q[3]), amplitude * float(np.cos(rate))


def impact(simulator, dt, settings, lean=0.4, v0=1.0):
    """Rate [rad/s] of a rod after its tip has landed and sticks, m v0 d sin(lean) / (I + m d^2); gravity is off."""
    d, m, inertia = 0.5, 3.0, 0.08
    rod = Body("rod", -1, (0.0, 0.0), m, (0.0, 0.0), inertia, 0.0)
    tree = Tree(bodies=(rod,), feet=(Foot(0, (0.0, -d), 0.0), Foot(0, (0.0, d), 0.0)), gravity=(0.0, 0.0))
    walk = simulator(tree, 2.0, dt, settings)
    height = 2.5 * dt * v0
    walk.place(np.array([d * np.sin(lean), d * np.cos(lean) + height, lean]), np.array([0.0, -v0, 0.0]))
    for _ in range(max(60, round(0.1 / dt))):
        _, v, _ = walk.step(np.zeros(3), (True, True))
    return float(v[2]), m * v0 * d * np.sin(lean) / (inertia + m * d * d)


def limit(reference, simulator, settings, dt=5e-4):
    """Deviation from the gait before its impact at a time step of zero: angles, rates, foot position and foot speed."""
    coarse, fine = (np.array(run(reference, simulator, h, settings).deviation) for h in (dt, dt / 2))
    return 2 * fine - coarse


def is_flagged(reference, simulator, settings):
    """Whether an engine does not converge to the gait."""
    deviation, n = limit(reference, simulator, settings), len(reference.tree.bodies)
    return bool(np.abs(deviation[:n]).max() > ANGLE or abs(deviation[-1]) > SPEED)


PERTURBATIONS = {
    "friction 1 % larger": {"friction": 1.01},
    "friction 1 % smaller": {"friction": 0.99},
    "gravity wrong in the fourth digit": {"gravity": 1.0001},
    "feet of 0.1 mm that roll": {"radius": 1e-4},
}
OF_MUJOCO = {"a pyramid in place of the cone": {"cone": "pyramidal"}}
CASES = {"block slides to rest": block, "pendulum": pendulum, "plastic impact": impact}
