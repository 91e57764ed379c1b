"""Adapter of MuJoCo (mujoco.org): joint coordinates, soft contacts by convex optimisation in every time step."""

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any, ClassVar
from xml.etree.ElementTree import Element, SubElement, tostring

import mujoco
import numpy as np

from gaitopt.arrays import Array
from gaitopt.engines.plant import POINT_RADIUS, Tree

SETTINGS: dict[str, dict[str, Any]] = {
    "default": {"integrator": "Euler", "cone": "pyramidal", "impratio": 1.0, "solref": "0.02 1", "tolerance": 1e-8},
    "best": {
        "integrator": "implicitfast",
        "cone": "elliptic",
        "impratio": 100.0,
        "solref": "2dt 1",
        "solimp": "0.99 0.99 0.001 0.5 2",
        "tolerance": 1e-14,
    },
}
"""With ``best`` a contact is as stiff as the time step allows: its time constant is twice the step, at all depths
(``solimp``). The cone is round, and friction is a hundred times stiffer than the normal direction, so that a sticking
foot creeps less."""


class Simulator:
    """A walker in MuJoCo.

    Parameters
    ----------
    tree, friction : the walker, and the coefficient of friction.
    dt : time step [s].
    settings : values for the keys of ``SETTINGS``; ``2dt`` in ``solref`` stands for two time steps. The key ``radius``
        is the radius of the spheres that replace point feet [m].
    """

    name: ClassVar[str] = "mujoco"
    version: ClassVar[str] = version("mujoco")
    settings: ClassVar[Mapping[str, Mapping[str, Any]]] = SETTINGS

    def __init__(self, tree: Tree, friction: float, dt: float, settings: Mapping[str, Any]) -> None:
        self._model = mujoco.MjModel.from_xml_string(_xml(tree, friction, dt, settings))
        self._data = mujoco.MjData(self._model)
        joints = [self._model.joint(f"joint{k}") for k in range(tree.n)]
        self._q, self._v = ([int(j.qposadr[0]) for j in joints], [int(j.dofadr[0]) for j in joints])
        self._feet = [self._model.geom(f"foot{k}").id for k in range(len(tree.feet))]

    def place(self, q: Array, v: Array) -> None:
        """Set coordinates and rates."""
        self._data.qpos[self._q], self._data.qvel[self._v] = q, v

    def step(self, force: Array, touching: tuple[bool, ...]) -> tuple[Array, Array, Array]:
        """Advance by one time step under forces on the coordinates; see ``outcome.Simulator``."""
        data, forces, wrench = self._data, np.zeros((len(self._feet), 2)), np.zeros(6)
        for foot, on in zip(self._feet, touching, strict=True):
            self._model.geom_contype[foot] = int(on)
        data.qfrc_applied[self._v] = force
        mujoco.mj_step(self._model, data)
        for k, contact in enumerate(data.contact):
            mujoco.mj_contactForce(self._model, data, k, wrench)
            world = contact.frame.reshape(3, 3).T @ wrench[:3]
            forces[self._feet.index(contact.geom2)] += world[0], world[2]
        return data.qpos[self._q], data.qvel[self._v], forces


def _xml(tree: Tree, friction: float, dt: float, settings: Mapping[str, Any]) -> str:
    """The model in MJCF. The ground lies so low that the sphere of a point foot touches it when the tip is at zero."""
    radius = settings.get("radius", POINT_RADIUS)
    root = Element("mujoco")
    SubElement(root, "compiler", angle="radian", boundinertia="1e-12")
    option = {key: str(settings[key]) for key in ("integrator", "cone", "impratio", "tolerance")}
    SubElement(root, "option", option, timestep=repr(dt), gravity=f"{tree.gravity[0]!r} 0 {tree.gravity[1]!r}",
               iterations="200", ls_iterations="100", ls_tolerance="1e-6")  # fmt: skip
    contact = {
        "condim": "3",
        "solref": settings["solref"].replace("2dt", repr(2 * dt)),
    }
    contact |= {"solimp": settings["solimp"]} if "solimp" in settings else {}
    world = SubElement(root, "worldbody")
    low = 0.0 if tree.feet[0].radius else -radius
    ground = {"type": "plane", "size": "0 0 1", "pos": f"0 0 {low!r}", "contype": "0", "conaffinity": "1"}
    SubElement(world, "geom", ground | contact, friction="0 0 0")  # the larger coefficient of a pair counts
    elements: list[Element] = []
    for k, body in enumerate(tree.bodies):
        parent = world if body.parent < 0 else elements[body.parent]
        x, z = body.position
        element = SubElement(parent, "body", pos=f"{x!r} 0 {z!r}")
        elements.append(element)
        slides, hinge = [("slide", "1 0 0"), ("slide", "0 0 1")], [("hinge", "0 1 0")]
        joints = slides if tree.slides else slides + hinge if body.parent < 0 else hinge
        first = 2 * k if tree.slides else 0 if body.parent < 0 else 2 + k
        for j, (kind, axis) in enumerate(joints):
            armature = repr(body.rotor if k else 0.0)
            SubElement(element, "joint", name=f"joint{first + j}", type=kind, axis=axis, armature=armature)
        inertia = max(body.inertia, 1e-12)
        com = f"{body.com[0]!r} 0 {body.com[1]!r}"
        SubElement(element, "inertial", pos=com, mass=repr(body.mass), diaginertia=" ".join([repr(inertia)] * 3))
        for number, foot in enumerate(tree.feet):
            if foot.body == k:
                shape = {"type": "sphere", "size": repr(foot.radius or radius), "contype": "1", "conaffinity": "0"}
                of_foot = {"pos": f"{foot.tip[0]!r} 0 {foot.tip[1]!r}", "friction": f"{friction * foot.share!r} 0 0"}
                SubElement(element, "geom", shape | contact | of_foot, name=f"foot{number}")
    return tostring(root, encoding="unicode")
