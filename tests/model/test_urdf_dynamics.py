"""Equations of robots from URDF against two programs that read the same files: Newton-Euler recursions, and Pinocchio.

Our coordinates are the angles of the links, and x and y of the stance foot.
"""

from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from casadi import Function
from foot_impacts import foot_impact
from numpy.typing import NDArray
from robots import feet, tree, urdf
from samples import sampled
from scipy.spatial.transform import Rotation

from gaitopt import Mode, check_walker, equations_of_motion
from gaitopt.model.control import NoControl
from gaitopt.model.system import HybridSystem
from gaitopt.model.urdf import UrdfWalker, walker_from_text
from gaitopt.model.walkers.rabbit import Rabbit

try:
    import pinocchio as pin
except ImportError:
    pin = None
RABBIT = Path(__file__).resolve().parents[2] / "docs" / "examples" / "rabbit.urdf"
ROBOTS = ("rabbit", 3, 7, 9)
Array = NDArray[Any]


@cache
def robot(which: str | int) -> tuple[type[UrdfWalker], str]:
    """The class and the text of a robot."""
    text = RABBIT.read_text() if isinstance(which, str) else urdf(tree(which))
    names = ("stance_foot", "swing_foot") if isinstance(which, str) else feet(which)
    return walker_from_text(text, names, "tree.urdf"), text


def hanging(walker: type[UrdfWalker]) -> dict[str, float]:
    """Angle of every link in the pose of the file when its coordinate is zero: RABBIT's legs point up in its file."""
    return {name: np.pi if walker.model == "rabbit" and name != "torso" else 0.0 for name in walker.shape}


class NewtonEuler:
    """Newton's and Euler's equations of every link in space: motion outwards from the root, forces inwards to it."""

    def __init__(self, walker: type[UrdfWalker], text: str) -> None:
        robot = ET.fromstring(text)
        self.walker, self.inertials, self.joints = walker, {}, {}
        self.links = [link.attrib["name"] for link in robot.iter("link")]
        for link in robot.iter("link"):
            entry = link.find("inertial")
            if entry is not None:
                R, r = self._origin(entry)
                ixx, ixy, ixz, iyy, iyz, izz = (
                    float(entry.find("inertia").attrib[key]) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
                )
                tensor = R @ np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]) @ R.T
                self.inertials[link.attrib["name"]] = float(entry.find("mass").attrib["value"]), r, tensor
        for joint in robot.iter("joint"):
            axis = joint.find("axis")
            turns = joint.attrib["type"] != "fixed"
            along = np.array(axis.attrib["xyz"].split(), dtype=float) if turns and axis is not None else np.zeros(3)
            child, parent = joint.find("child").attrib["link"], joint.find("parent").attrib["link"]
            self.joints[child] = parent, *self._origin(joint), along, turns
        self.order = [name for name in self.links if name not in self.joints]
        for name in self.order:
            self.order += [child for child, joint in self.joints.items() if joint[0] == name]

    @staticmethod
    def _origin(element: ET.Element) -> tuple[Array, Array]:
        origin = element.find("origin")
        stated = {} if origin is None else origin.attrib
        xyz, rpy = (np.array(stated.get(key, "0 0 0").split(), dtype=float) for key in ("xyz", "rpy"))
        return Rotation.from_euler("xyz", rpy).as_matrix(), xyz

    def _forces(self, s: Array, ds: Array, dds: Array, g: float) -> tuple[Array, Array]:
        """Generalised forces of a motion in our coordinates, and the derivative of the swing foot."""
        n, root, rest = len(self.walker.shape), self.order[0], hanging(self.walker)
        turn = {name: s[k] + rest[name] for k, name in enumerate(self.walker.shape)}
        unit = dict(zip(self.walker.shape, np.eye(n + 2), strict=False))
        body, y = {root: root}, np.array([0.0, 1.0, 0.0])
        R, r = {root: Rotation.from_rotvec(turn[root] * y).as_matrix()}, {root: np.zeros(3)}
        spin = {root: np.outer(y, unit[root])}  # columns: angular velocity and velocity for a unit rate
        move = {root: np.zeros((3, n + 2))}
        axes = {}
        for name in self.order[1:]:
            parent, turned, shift, axis, turns = self.joints[name]
            body[name] = name if turns else body[parent]
            r[name] = r[parent] + R[parent] @ shift
            move[name] = move[parent] + np.cross(spin[parent], r[name] - r[parent], axis=0)
            R[name], spin[name] = R[parent] @ turned, spin[parent]
            if turns:
                axes[name] = R[name] @ axis / np.linalg.norm(axis)
                sign = np.sign(axes[name][1])
                rate = sign * (unit[name] - unit[body[parent]])
                angle = sign * (turn[name] - turn[body[parent]])
                R[name] = Rotation.from_rotvec(angle * axes[name]).as_matrix() @ R[name]
                spin[name] = spin[parent] + np.outer(axes[name], rate)
        stance, swing = self.walker.feet
        on_foot = np.zeros((3, n + 2))
        on_foot[[0, 2], [n, n + 1]] = 1.0
        shift = on_foot - move[stance]  # the root moves so that the stance foot does what x and y say
        omega = {name: spin[name] @ ds for name in self.order}
        alpha = {name: spin[name] @ dds for name in self.order}  # the axes keep their direction
        a = {root: np.zeros(3)}
        for name in self.order[1:]:
            parent = self.joints[name][0]
            arm = r[name] - r[parent]
            a[name] = a[parent] + np.cross(alpha[parent], arm) + np.cross(omega[parent], np.cross(omega[parent], arm))
        start = np.array([dds[n], 0.0, dds[n + 1]]) - a[stance]
        force = {name: np.zeros(3) for name in self.order}
        moment = {name: np.zeros(3) for name in self.order}  # about the link's origin
        Q = np.zeros(n + 2)
        for name in reversed(self.order):
            if name in self.inertials:
                mass, com, tensor = self.inertials[name]
                arm, inertia = R[name] @ com, R[name] @ tensor @ R[name].T
                w = omega[name]
                at_com = a[name] + start + np.cross(alpha[name], arm) + np.cross(w, np.cross(w, arm))
                pull = mass * (at_com + np.array([0.0, 0.0, g]))
                force[name] = force[name] + pull
                moment[name] = moment[name] + inertia @ alpha[name] + np.cross(w, inertia @ w) + np.cross(arm, pull)
            if name in self.joints:
                parent = self.joints[name][0]
                if name in axes:
                    Q += (axes[name] @ moment[name]) * (axes[name] @ (spin[name] - spin[parent]))
                force[parent] = force[parent] + force[name]
                moment[parent] = moment[parent] + moment[name] + np.cross(r[name] - r[parent], force[name])
        Q += moment[root] @ spin[root] + force[root] @ shift
        return Q, (move[swing] + shift)[[0, 2]]

    def at(self, s: Array, ds: Array) -> tuple[Array, Array, Array, Array]:
        """Mass matrix, velocity terms with gravity, gravity, and Jacobian of the swing foot."""
        rest = np.zeros(ds.size)
        M = np.array([self._forces(s, rest, column, 0.0)[0] for column in np.eye(ds.size)]).T
        gravity, jacobian = self._forces(s, rest, rest, 9.81)
        return M, self._forces(s, ds, rest, 9.81)[0], gravity, jacobian


class Pinocchio:
    """Pinocchio's model with a free base, restricted to the plane."""

    def __init__(self, walker: type[UrdfWalker], text: str) -> None:
        self.walker, self.hanging = walker, hanging(walker)
        self.model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
        self.data = self.model.createData()
        self.stance, self.swing = (self.model.getFrameId(foot) for foot in walker.feet)

    def at(self, s: Array, ds: Array) -> tuple[Array, Array, Array, Array]:
        """Mass matrix, velocity terms with gravity, gravity, and Jacobian of the swing foot."""
        model, data, walker = self.model, self.data, self.walker
        angles = {name: s[k] + self.hanging[name] for k, name in enumerate(walker.shape)}
        n = len(walker.shape)
        q, P = pin.neutral(model), np.zeros((model.nv, n + 2))
        root = next(link.name for link in walker.bodies if link.parent is None)
        turn = angles[root]
        q[3:7] = [0.0, np.sin(turn / 2), 0.0, np.cos(turn / 2)]
        P[4, walker.shape.index(root)] = 1.0
        for link in walker.bodies:
            if link.joint:
                joint = model.joints[model.getJointId(link.joint)]
                angle = link.sign * (angles[link.name] - angles[link.parent])
                column = np.zeros(n + 2)
                column[walker.shape.index(link.name)] += link.sign
                column[walker.shape.index(link.parent)] -= link.sign
                P[joint.idx_v] = column
                q[joint.idx_q : joint.idx_q + joint.nq] = [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]

        def jacobian(frame: int) -> Array:
            return np.asarray(pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED))[[0, 2]]

        # the base moves so that the stance foot does what x and y say
        move = np.linalg.inv(jacobian(self.stance)[:, [0, 2]])
        foot = jacobian(self.stance) @ P
        P[[0, 2]] = move @ (np.eye(n + 2)[n:] - foot)
        v = P @ ds
        rest = np.zeros(model.nv)
        pin.forwardKinematics(model, data, q, v, rest)
        drift = pin.getFrameClassicalAcceleration(model, data, self.stance, pin.LOCAL_WORLD_ALIGNED).linear[[0, 2]]
        rest[[0, 2]] = -move @ drift
        M = pin.crba(model, data, q)
        M = np.triu(M) + np.triu(M, 1).T
        bias = pin.rnea(model, data, q, v, rest)
        gravity = pin.computeGeneralizedGravity(model, data, q)
        return P.T @ M @ P, P.T @ bias, P.T @ gravity, jacobian(self.swing) @ P


@pytest.fixture(params=[NewtonEuler, Pinocchio])
def oracle(request: pytest.FixtureRequest) -> Any:
    """Another program that reads a file."""
    if request.param is Pinocchio and pin is None:
        pytest.skip("Pinocchio is not installed")
    return request.param


@pytest.mark.parametrize("which", sampled(ROBOTS, 3))
def test_mass_matrix_gravity_and_velocity_terms_are_those_of_another_program(which: str | int, oracle: Any) -> None:
    walker, text = robot(which)
    eom, other, random = equations_of_motion(walker), oracle(walker, text), np.random.default_rng(7)
    function = Function("eom", [eom.z, eom.p], [eom.M, eom.B, eom.G, eom.W_swing])
    n = len(walker.shape)
    p = [float(value) for _, value in walker()]
    for _ in range(10):
        s, ds = random.uniform(-1, 1, n), np.append(random.uniform(-2, 2, n + 1), 0.0)
        M, B, G, W = (np.asarray(value) for value in function([*s, 0.3, *ds[:-1]], p))
        expected_M, bias, gravity, jacobian = other.at(s, ds)
        scale = np.abs(expected_M).max()
        np.testing.assert_allclose(M, expected_M, atol=1e-12 * scale)
        np.testing.assert_allclose(G.ravel(), gravity, atol=1e-12 * np.abs(gravity).max())
        np.testing.assert_allclose((B + G).ravel(), bias, atol=1e-12 * np.abs(bias).max())
        np.testing.assert_allclose(W, jacobian, atol=1e-12)


@pytest.mark.parametrize("which", sampled(ROBOTS, 3))
def test_the_impact_is_the_one_of_the_other_programs_matrices(which: str | int, oracle: Any) -> None:
    walker, text = robot(which)
    system, other, random = HybridSystem(walker, NoControl()), oracle(walker, text), np.random.default_rng(8)
    n = len(walker.shape)
    p = system.values({f"walker.{name}": value for name, value in walker()} | {"friction": 0.6})
    relabel = Function("relabel", [equations_of_motion(walker).z], [equations_of_motion(walker).mechanism.relabel])
    for _ in range(10):
        s, ds = random.uniform(-1, 1, n), np.append(random.uniform(-2, 2, n + 1), 0.0)
        M, _, _, W = other.at(s, ds)
        impulse = np.linalg.solve(W @ np.linalg.solve(M, W.T), -W @ ds)
        after = ds + np.linalg.solve(M, W.T @ impulse)
        np.testing.assert_allclose(W @ after, 0.0, atol=1e-12 * np.abs(after).max())
        outputs = foot_impact(system, Mode.STICK)([*s, 0.0, *ds[:-1]], p)
        found, stated = (np.asarray(outputs[k]).ravel() for k in (0, 1))
        swapped = np.asarray(relabel([*after[:n], *np.zeros(n + 2)])).ravel()  # a permutation, of rates as of angles
        np.testing.assert_allclose(found[n + 1 : 2 * n + 1], swapped, atol=1e-12 * np.abs(swapped).max())
        np.testing.assert_allclose(stated, impulse, atol=1e-12 * np.abs(impulse).max())


def test_rabbit_of_the_file_has_the_equations_of_the_class() -> None:
    walker, _ = robot("rabbit")
    assert walker.shape == Rabbit.shape
    assert walker.actuators == Rabbit.actuators
    assert walker.section == Rabbit.section
    random = np.random.default_rng(1)

    def equations(kind: type[Any]) -> Function:
        eom = equations_of_motion(kind)
        m = eom.mechanism
        return Function(
            "eom", [eom.z, eom.p], [eom.M, eom.B, eom.G, eom.E, m.swing_foot, m.touchdown, m.relabel, m.upright]
        )

    for rotor in (0.0, 0.83):
        values = {"rotor_inertia": rotor, "slope": 0.1}
        for _ in range(10):
            z = random.uniform(-1, 1, 12)
            ours, theirs = (
                equations(kind)(z, [float(value) for _, value in kind(**values)]) for kind in (walker, Rabbit)
            )
            for one, other in zip(ours, theirs, strict=True):
                np.testing.assert_allclose(np.asarray(one), np.asarray(other), atol=1e-12 * 100, rtol=1e-12)


@pytest.mark.parametrize("which", ROBOTS)
def test_robots_from_files_are_consistent_where_their_feet_swap_roles(which: str | int) -> None:
    check_walker(robot(which)[0]())
