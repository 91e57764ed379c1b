"""Adapter of Siconos (nonsmooth.gricad-pages.univ-grenoble-alpes.fr): time stepping by Moreau and Jean, rigid contacts.

The coordinates of every body are the position (x, z) of its centre of mass and its angle; joints are equations between
rates.
Siconos is in Debian (``python3-siconos``), not on PyPI.
"""

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any, ClassVar

import numpy as np
from siconos import kernel, numerics

from gaitopt.arrays import Array
from gaitopt.engines.plant import Tree
from gaitopt.errors import ProblemError

SETTINGS: dict[str, dict[str, Any]] = {
    "default": {"theta": 0.5, "ahead": 0.0, "tolerance": 1e-4},
    "best": {"theta": 1.0, "ahead": 0.5, "tolerance": 1e-14},
}
"""With ``best`` the coordinates advance with the rates after the step. These satisfy the equations of joints and
contacts in mid-step (``ahead`` by half a step), so that joints do not drift apart. The solver iterates until it
converges."""
SLIMMEST = 1e-6
"""Moment of inertia per mass below which the solver of joints and contacts fails [m^2]."""
OFF = 1.0
"""Gap that is added to a contact to switch it off [m]."""


class Simulator:
    """A walker in Siconos; the parameters are those of ``gaitopt.engines.mujoco.Simulator``."""

    name: ClassVar[str] = "siconos"
    version: ClassVar[str] = version("siconos")
    settings: ClassVar[Mapping[str, Mapping[str, Any]]] = SETTINGS

    def __init__(self, tree: Tree, friction: float, dt: float, settings: Mapping[str, Any]) -> None:
        slim = [body.name for body in tree.bodies if body.inertia < SLIMMEST * body.mass]
        if slim and not tree.slides:
            raise ProblemError(f"Siconos needs a moment of inertia, but {slim[0]} is a point mass")
        self._tree, self._dt, self._ahead, n = tree, dt, settings["ahead"], 3 * len(tree.bodies)
        self._radii = [foot.radius or settings.get("radius", 0.0) for foot in tree.feet]
        self._joints = [k for k, body in enumerate(tree.bodies) if body.parent >= 0 and not tree.slides]
        M = np.zeros((n, n))
        for k, body in enumerate(tree.bodies):
            M[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += np.diag([body.mass, body.mass, body.inertia or body.mass])
            if body.parent >= 0:
                turning = [3 * body.parent + 2, 3 * k + 2]
                M[np.ix_(turning, turning)] += body.rotor * np.array([[1.0, -1.0], [-1.0, 1.0]])
        self._weight = np.concatenate([[b.mass * tree.gravity[0], b.mass * tree.gravity[1], 0.0] for b in tree.bodies])
        self._force = self._weight.copy()  # Siconos keeps a pointer to it, as to the matrices below
        self._bodies = kernel.LagrangianLinearTIDS(np.zeros(n), np.zeros(n), M)
        self._bodies.setFExtPtr(self._force)
        self._joint_law = kernel.EqualityConditionNSL(2)
        self._laws = [kernel.NewtonImpactFrictionNSL(0.0, 0.0, friction * foot.share, 2) for foot in tree.feet]
        self._integrator, self._problem = kernel.MoreauJeanOSI(settings["theta"]), kernel.GenericMechanical()
        self._problem.numericsSolverOptions().dparam[numerics.SICONOS_DPARAM_TOL] = settings["tolerance"]

    def place(self, q: Array, v: Array) -> None:
        """Set coordinates and rates."""
        tree, n = self._tree, len(self._tree.bodies)
        points = [tree.point(k, body.com, q, v) for k, body in enumerate(tree.bodies)]
        state = [np.column_stack([[point[j] for point in points], tree.angles((q, v)[j])]).ravel() for j in range(2)]
        for values, copies in zip(state, (("q0", "q"), ("velocity0", "velocity")), strict=True):
            for copy in copies:
                getattr(self._bodies, copy)()[:] = values
        self._rows = [(np.zeros((2, 3 * n), order="F"), np.zeros(2)) for _ in (*self._joints, *tree.feet)]
        self._relations = [kernel.LagrangianLinearTIR(*rows) for rows in self._rows]
        self._linearise((True,) * len(tree.feet))
        laws = [*(self._joint_law for _ in self._joints), *self._laws]
        interactions = [kernel.Interaction(*pair) for pair in zip(laws, self._relations, strict=True)]
        self._contacts, self._model = interactions[-len(tree.feet) :], kernel.NonSmoothDynamicalSystem(0.0, 1e6)
        self._model.insertDynamicalSystem(self._bodies)
        for interaction in interactions:
            self._model.link(interaction, self._bodies)
        times = kernel.TimeDiscretisation(0.0, self._dt)
        self._simulation = kernel.TimeStepping(self._model, times, self._integrator, self._problem)

    def step(self, force: Array, touching: tuple[bool, ...]) -> tuple[Array, Array, Array]:
        """Advance by one time step under forces on the coordinates; see ``outcome.Simulator``."""
        tree, per_body = self._tree, (force.reshape(-1, 2) if self._tree.slides else force[2:, None])
        self._force[:] = self._weight
        for k, (body, own) in enumerate(zip(tree.bodies, per_body, strict=True)):
            first = 0 if tree.slides else 2
            self._force[3 * k + first : 3 * k + first + own.size] += own
            if body.parent >= 0:
                self._force[3 * body.parent + first : 3 * body.parent + first + own.size] -= own
        self._bodies.setFExtPtr(self._force)
        self._linearise(touching)
        self._simulation.computeOneStep()
        forces = np.array([contact.lambda_(1)[::-1] for contact in self._contacts]) / self._dt
        self._simulation.nextStep()
        q, v = (values().reshape(-1, 3).copy() for values in (self._bodies.q, self._bodies.velocity))
        if tree.slides:
            absolute = [q[:, :2] - [body.com for body in tree.bodies], v[:, :2]]
            parents = [body.parent for body in tree.bodies]
            return *((x - x[parents] * (np.array(parents) >= 0)[:, None]).ravel() for x in absolute), forces
        arm, turning = _turned(q[0, 2], tree.bodies[0].com)
        coordinates = np.concatenate([q[0, :2] - arm, tree.relative(q[:, 2])])
        rates = np.concatenate([v[0, :2] - turning * v[0, 2], tree.relative(v[:, 2])])
        return coordinates, rates, forces

    def _linearise(self, touching: tuple[bool, ...]) -> None:
        """Write gaps of joints (x, z) and contacts (normal, tangential) as linear functions of the coordinates."""
        q, bodies = self._bodies.q().copy(), self._tree.bodies
        ahead = q + self._ahead * self._dt * self._bodies.velocity()
        ends = [[(k, -1.0, (0.0, 0.0)), (bodies[k].parent, 1.0, bodies[k].position)] for k in self._joints]
        ends += [[(foot.body, 1.0, foot.tip)] for foot in self._tree.feet]
        for number, (relation, (C, e)) in enumerate(zip(self._relations, self._rows, strict=True)):
            foot = number - len(self._joints)
            gap, slopes = np.zeros(2), np.zeros_like(C)
            for k, sign, point in ends[number]:
                arm = np.subtract(point, bodies[k].com)
                gap += sign * (q[3 * k : 3 * k + 2] + _turned(q[3 * k + 2], arm)[0])
                slopes[:, 3 * k : 3 * k + 2] += sign * np.eye(2)
                slopes[:, 3 * k + 2] += (not self._tree.slides) * sign * _turned(ahead[3 * k + 2], arm)[1]
                if foot >= 0:
                    R = self._radii[foot]  # a point foot with a radius touches lower ground
                    slopes[0, 3 * k + 2] -= R
                    gap -= R * q[3 * k + 2], self._tree.feet[foot].radius - (0.0 if touching[foot] else OFF)
                    gap, slopes = gap[::-1], slopes[::-1]
            C[:], e[:] = slopes, gap - slopes @ q
            relation.setCPtr(C)
            relation.setJachqPtr(C)
            relation.setEPtr(e)
        self._problem.setHasBeenUpdated(False)


def _turned(angle: float, point: Any) -> tuple[Array, Array]:
    """A point of a body in the axes of the ground, and its derivative with respect to the angle."""
    x, z = point
    s, c = np.sin(angle), np.cos(angle)
    return np.array([x * c + z * s, z * c - x * s]), np.array([z * c - x * s, -x * c - z * s])
