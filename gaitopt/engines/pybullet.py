"""Adapter of PyBullet (pybullet.org): Featherstone's algorithm, contacts as velocity constraints, Gauss-Seidel."""

import tempfile
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from gaitopt.arrays import Array
from gaitopt.engines.plant import POINT_RADIUS, Body, Foot, Tree
from gaitopt.errors import ProblemError
from gaitopt.model.mechanism import ORIGIN

SETTINGS: dict[str, dict[str, Any]] = {
    "default": {"damping": 0.04, "engine": {}},
    "best": {
        "damping": 0.0,
        "engine": {
            "numSolverIterations": 500,
            "solverResidualThreshold": 1e-20,
            "contactSlop": 0.0,
            "enableConeFriction": 1,
        },
    },
}
"""``best`` has no artificial damping of the bodies (0.04 /s by default), no slop, a round cone and a converged
iteration."""


class Simulator:
    """A walker in PyBullet; the parameters are those of ``gaitopt.engines.mujoco.Simulator``."""

    name: ClassVar[str] = "pybullet"
    version: ClassVar[str] = version("pybullet")
    settings: ClassVar[Mapping[str, Mapping[str, Any]]] = SETTINGS

    def __init__(self, tree: Tree, friction: float, dt: float, settings: Mapping[str, Any]) -> None:
        if any(body.rotor for body in tree.bodies):
            raise ProblemError("PyBullet has no inertia of rotors")
        import pybullet  # its import prints a line, which the process of the runs discards
        from pybullet_utils.bullet_client import BulletClient

        self._client = client = BulletClient(pybullet.DIRECT)
        radius = settings.get("radius", POINT_RADIUS)
        client.setGravity(tree.gravity[0], 0, tree.gravity[1])
        client.setPhysicsEngineParameter(fixedTimeStep=dt, numSubSteps=0, **settings["engine"])
        low = 0.0 if tree.feet[0].radius else -radius
        plane = client.createCollisionShape(client.GEOM_PLANE)
        self._ground = client.createMultiBody(0, plane, basePosition=[0, 0, low])
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "walker.urdf"
            file.write_text(_urdf(tree, radius))
            flags = client.URDF_USE_INERTIA_FROM_FILE
            self._walker = client.loadURDF(str(file), useFixedBase=True, flags=flags)
        client.changeDynamics(self._ground, -1, lateralFriction=1.0, restitution=0.0)
        names = {client.getJointInfo(self._walker, j)[1].decode(): j for j in range(client.getNumJoints(self._walker))}
        self._joints = [names[f"joint{k}"] for k in range(tree.n)]
        last = [2 * k + 1 if tree.slides else 2 + k for k in range(len(tree.bodies))]
        self._tree, self._feet = tree, [names[f"joint{last[foot.body]}"] for foot in tree.feet]
        damping = {"linearDamping": settings["damping"], "angularDamping": settings["damping"], "jointDamping": 0.0}
        for joint in range(-1, client.getNumJoints(self._walker)):
            client.changeDynamics(self._walker, joint, lateralFriction=friction, restitution=0.0, **damping)
        for foot, link in zip(tree.feet, self._feet, strict=True):
            client.changeDynamics(self._walker, link, lateralFriction=friction * foot.share)
        client.setJointMotorControlArray(
            self._walker, self._joints, client.VELOCITY_CONTROL, forces=[0.0] * len(self._joints)
        )

    def place(self, q: Array, v: Array) -> None:
        """Set coordinates and rates."""
        for joint, angle, rate in zip(self._joints, q, v, strict=True):
            self._client.resetJointState(self._walker, joint, angle, rate)

    def step(self, force: Array, touching: tuple[bool, ...]) -> tuple[Array, Array, Array]:
        """Advance by one time step under forces on the coordinates; see ``outcome.Simulator``."""
        client, forces = self._client, np.zeros((len(self._feet), 2))
        for foot in self._feet:  # both feet of a wheel are on one link, so their contacts are switched together
            on = any(touching[k] for k, other in enumerate(self._feet) if other == foot)
            client.setCollisionFilterPair(self._walker, self._ground, foot, -1, int(on))
        client.setJointMotorControlArray(self._walker, self._joints, client.TORQUE_CONTROL, forces=list(force))
        client.stepSimulation()
        states = client.getJointStates(self._walker, self._joints)
        q, v = (np.array([state[k] for state in states]) for k in range(2))
        feet_x = [self._tree.foot(k, q, v)[0][0] for k in range(len(self._feet))]
        for point in client.getContactPoints(self._walker, self._ground):
            normal, first, second = (np.array(point[k]) for k in (7, 11, 13))
            world = point[9] * normal + point[10] * first + point[12] * second
            on_link = [k for k, foot in enumerate(self._feet) if foot == point[3]]
            forces[min(on_link, key=lambda k: abs(feet_x[k] - point[5][0]))] += world[0], world[2]
        return q, v, forces


def _urdf(tree: Tree, radius: float) -> str:
    """The walker in URDF; a massless link lies between the two sliding joints of a body."""
    root = Element("robot", name="walker")
    _link(root, "base", None, ())
    for k, body in enumerate(tree.bodies):
        parent = "base" if body.parent < 0 else f"body{body.parent}"
        slides, feet = tree.slides or body.parent < 0, tuple(foot for foot in tree.feet if foot.body == k)
        axes = [("prismatic", "1 0 0"), ("prismatic", "0 0 1")] if slides else []
        axes += [] if tree.slides else [("continuous", "0 1 0")]
        first = 2 * k if tree.slides else 0 if body.parent < 0 else 2 + k
        for j, (kind, axis) in enumerate(axes, start=first):
            is_last = j == first + len(axes) - 1
            child = f"body{k}" if is_last else f"across{j}"
            _link(root, child, body if is_last else None, feet if is_last else (), radius)
            _joint(root, j, kind, parent, child, body.position if j == first else ORIGIN, axis)
            parent = child
    return tostring(root, encoding="unicode")


def _link(root: Element, name: str, body: Body | None, feet: tuple[Foot, ...], radius: float = 0.0) -> None:
    link = SubElement(root, "link", name=name)
    x, z = (0.0, 0.0) if body is None else body.com
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=f"{x!r} 0 {z!r}")
    SubElement(inertial, "mass", value=repr(0.0 if body is None else body.mass))
    inertia = repr(0.0 if body is None else max(body.inertia, 1e-12))
    SubElement(inertial, "inertia", ixx=inertia, ixy="0", ixz="0", iyy=inertia, iyz="0", izz=inertia)
    for foot in feet:
        collision = SubElement(link, "collision")
        SubElement(collision, "origin", xyz=f"{foot.tip[0]!r} 0 {foot.tip[1]!r}")
        SubElement(SubElement(collision, "geometry"), "sphere", radius=repr(foot.radius or radius))


def _joint(root: Element, k: int, kind: str, parent: str, child: str, origin: tuple[float, float], axis: str) -> None:
    joint = SubElement(root, "joint", name=f"joint{k}", type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    SubElement(joint, "origin", xyz=f"{origin[0]!r} 0 {origin[1]!r}")
    SubElement(joint, "axis", xyz=axis)
    SubElement(joint, "limit", lower="-1e9", upper="1e9", effort="1e9", velocity="1e9")
