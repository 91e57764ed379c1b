"""Equations of robots from URDF against Pinocchio, which reads the same files, and against a class of the package.

Our coordinates are the angles of the links, and x and y of the stance foot.
"""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from casadi import Function
from numpy.typing import NDArray
from robots import feet, tree, urdf
from samples import sampled

from gaitopt import check_walker, equations_of_motion
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


class Pinocchio:
    """Pinocchio's model with a free base, restricted to the plane."""

    def __init__(self, walker: type[UrdfWalker], text: str) -> None:
        """RABBIT's legs point up in the pose of its file."""
        up = walker.model == "rabbit"
        self.walker, self.hanging = walker, {name: np.pi * (up and name != "torso") for name in walker.shape}
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


@pytest.mark.parametrize("which", sampled(ROBOTS, 3))
@pytest.mark.skipif(pin is None, reason="Pinocchio is not installed")
def test_mass_matrix_gravity_and_velocity_terms_are_those_of_another_program(which: str | int) -> None:
    walker, text = robot(which)
    eom, other, random = equations_of_motion(walker), Pinocchio(walker, text), np.random.default_rng(7)
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
