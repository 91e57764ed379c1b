"""A simulator in numpy as a template of an adapter: time stepping by Moreau, contacts by Gauss-Seidel."""

from importlib.metadata import version

import numpy as np


class Simulator:
    """A walker; ``tree`` has the bodies, feet and gravity, ``settings`` is one of the entries of ``settings`` below."""

    name = "numpy-engine"
    version = version("numpy")
    settings = {"default": {"sweeps": 5}, "best": {"sweeps": 200}}  # noqa: RUF012

    def __init__(self, tree, friction, dt, settings):
        self.tree, self.friction, self.dt, self.sweeps = tree, friction, dt, settings["sweeps"]
        self.units = np.eye(tree.n)  # rates of one coordinate at a time
        self.turning = np.array([tree.angles(unit) for unit in self.units]).T

    def place(self, q, v):
        """Set coordinates and rates: x, z and angle of the root, and the angles of the joints."""
        self.q, self.v = np.array(q), np.array(v)

    def step(self, force, touching):
        """One time step: coordinates and rates at its end, and the force (f_t, f_n) on each foot during it."""
        tree, dt = self.tree, self.dt
        q, v = self.q + dt / 2 * self.v, self.v  # midpoint
        M, h = np.zeros((len(v), len(v))), np.array(force, dtype=float)
        for k, body in enumerate(tree.bodies):
            J = self.jacobian(lambda u, k=k, body=body: tree.point(k, body.com, q, u)[1])
            drift = tree.point(k, body.com, q + 1e-6 * v, v)[1] - tree.point(k, body.com, q - 1e-6 * v, v)[1]
            M += body.mass * J.T @ J + body.inertia * np.outer(self.turning[k], self.turning[k])
            h += body.mass * J.T @ (np.array(tree.gravity) - drift / 2e-6)
        v = v + dt * np.linalg.solve(M, h)
        contacts = [k for k in range(len(tree.feet)) if touching[k] and tree.foot(k, q, v)[0][1] <= 0]
        Js = [self.jacobian(lambda u, k=k: tree.foot(k, q, u)[1]) for k in contacts]
        responses = [np.linalg.solve(M, J.T) for J in Js]
        impulses = np.zeros((len(tree.feet), 2))
        for _ in range(self.sweeps):
            before = impulses.copy()
            for k, J, R in zip(contacts, Js, responses, strict=True):
                normal = max(impulses[k, 1] - J[1] @ v / (J[1] @ R[:, 1]), 0.0)
                v = v + R[:, 1] * (normal - impulses[k, 1])
                bound = self.friction * tree.feet[k].share * normal
                tangential = float(np.clip(impulses[k, 0] - J[0] @ v / (J[0] @ R[:, 0]), -bound, bound))
                v = v + R[:, 0] * (tangential - impulses[k, 0])
                impulses[k] = tangential, normal
            if np.abs(impulses - before).max() <= 1e-15 * np.abs(impulses).max():
                break
        self.q, self.v = q + dt / 2 * v, v
        return self.q, self.v, impulses / dt

    def jacobian(self, velocity):
        """The matrix from rates to the velocity of a point."""
        return np.array([velocity(unit) for unit in self.units]).T
