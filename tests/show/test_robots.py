"""Walkers written as URDF and MJCF: read back, by gaitopt and by MuJoCo, they are the same."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from casadi import DM, SX, Function, jacobian, vertcat

import gaitopt as go
from gaitopt.errors import ProblemError
from gaitopt.model.lagrangian import equations_of_motion, parameter_namespace
from gaitopt.model.links import state_tree
from gaitopt.model.urdf import walker_from_text
from gaitopt.model.walker import Walker
from gaitopt.model.walkers.rabbit import Rabbit
from gaitopt.problem.problem import load_problem
from gaitopt.show.robots import robot_description

ALIKE = ("compass-passive-a", "compass-push-off", "round-feet-passive", "torso-passive", "rabbit")
"""Walkers that are trees with legs that are alike: those of named problems, and one with other numbers."""
DIFFERENT = ("kneed-passive", "compass-unequal")
"""Walkers that are trees whose legs differ: MJCF may have them, but a URDF file with them is not read back."""


@pytest.fixture
def walker(request: pytest.FixtureRequest) -> Walker:
    """The walker of a name."""
    return (
        Rabbit(rotor_inertia=0.83, thigh_com=0.13) if request.param == "rabbit" else load_problem(request.param).walker
    )


def feet_of(walker: Walker) -> tuple[str, str]:
    """Names of the feet in a file that is written."""
    leg = "shin" if isinstance(walker, Rabbit) else "leg"
    return f"stance_{leg}_foot", f"swing_{leg}_foot"


@pytest.mark.parametrize("walker", ALIKE, indirect=True)
def test_a_urdf_file_that_is_written_is_read_back_as_the_same_robot(walker: Walker) -> None:
    """Mass matrix, weight and swing foot at random places, in the angles of the links."""
    model = type(walker)
    read = walker_from_text(robot_description(walker), feet_of(walker), "written.urdf")
    stated: dict[str, Any] = {"gravity": walker.gravity, "slope": walker.slope}  # type: ignore[attr-defined]
    back = read(**stated, rotor_inertia=getattr(walker, "rotor_inertia", 0.0))
    ours, theirs = equations_of_motion(model), equations_of_motion(read)
    q = SX.sym("q", len(model.shape) + 2)
    by_name = SimpleNamespace(**{name: q[k] for k, name in enumerate((*model.shape, "x", "y"))})
    tree = state_tree(model, by_name, parameter_namespace(model, SX([float(v) for _, v in walker])))
    angle = {link.name: SX(link.angle) for link in tree.links}
    coordinates = vertcat(*(angle[name] for name in read.shape), q[-2:])
    change = np.asarray(DM(jacobian(coordinates, q)))
    at = Function("at", [q], [coordinates])
    functions = [
        Function("eom", [eom.z, eom.p], [eom.M, eom.G, eom.mechanism.swing_foot, eom.W_swing]) for eom in (ours, theirs)
    ]
    springless = [float(value) if "stiffness" not in name else 0.0 for name, value in walker]
    random, n = np.random.default_rng(2), len(model.shape)
    for _ in range(10):
        s = np.append(random.uniform(-1, 1, n + 1), 0.0)
        theta = np.asarray(at(s)).ravel()
        M, G, foot, W = (np.asarray(v) for v in functions[0]([*s[:-1], *np.zeros(n + 1)], springless))
        values = [float(value) for _, value in back]
        M2, G2, foot2, W2 = (np.asarray(v) for v in functions[1]([*theta[:-1], *np.zeros(len(theta) - 1)], values))
        np.testing.assert_allclose(change.T @ M2 @ change, M, atol=1e-12 * np.abs(M).max())
        np.testing.assert_allclose(change.T @ G2, G, atol=1e-12 * max(1.0, np.abs(G).max()))
        np.testing.assert_allclose(foot2, foot, atol=1e-12)
        np.testing.assert_allclose(W2 @ change, W, atol=1e-12)


def test_joints_and_motors_of_a_written_file_are_those_of_the_walker() -> None:
    read = walker_from_text(robot_description(Rabbit()), feet_of(Rabbit()), "written.urdf")
    assert read.shape == Rabbit.shape
    assert read.actuators == Rabbit.actuators
    ours, theirs = equations_of_motion(Rabbit), equations_of_motion(read)
    assert DM(ours.E - theirs.E).is_zero()
    compass = load_problem("compass-passive-a").walker
    assert walker_from_text(robot_description(compass), feet_of(compass), "compass.urdf").actuators == ("hip",)


def test_a_walker_from_a_file_is_written_with_its_limits() -> None:
    rabbit = Path(__file__).resolve().parents[2] / "docs" / "examples" / "rabbit.urdf"
    read = go.walker_from_urdf(rabbit, feet=("stance_foot", "swing_foot"))
    again = walker_from_text(robot_description(read()), feet_of(Rabbit()), "again.urdf")
    limits = [{link.joint: (link.range, link.effort) for link in robot.bodies} for robot in (read, again)]
    assert limits[0] == limits[1]
    assert limits[1]["stance_knee"] == ((0.0, 2.4), 150.0)


def test_every_link_of_a_urdf_file_states_its_mass() -> None:
    """PyBullet gives a link without <inertial> a mass of 1 kg, and MuJoCo the mass of its drawing."""
    root = ET.fromstring(robot_description(load_problem("compass-passive-a").walker))
    masses = [float(link.find("inertial/mass").get("value")) for link in root.iter("link")]  # type: ignore[union-attr, arg-type]
    assert sorted(masses) == [0.0, 0.0, 1.0, 1.0, 4.0, 4.0]


@pytest.mark.parametrize("walker", [*ALIKE, *DIFFERENT], indirect=True)
def test_mujoco_has_the_mass_matrix_of_the_walker(walker: Walker) -> None:
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is the oracle of this test")
    model = mujoco.MjModel.from_xml_string(robot_description(walker, "mjcf"))
    data, kind = mujoco.MjData(model), type(walker)
    joints = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, k) for k in range(model.njnt)]
    values = [float(value) for _, value in walker]
    q, p = SX.sym("q", len(kind.shape) + 2), SX(values)
    by_name = SimpleNamespace(**{name: q[k] for k, name in enumerate((*kind.shape, "x", "y"))})
    tree = state_tree(kind, by_name, parameter_namespace(kind, p))
    root = next(link for link in tree.links if link.parent is None)
    origin = tree.position(root, (0, 0))
    placed = {"root_x": origin[0], "root_z": origin[1], "root_pitch": root.angle, **tree.joints}
    coordinates = vertcat(*(placed[joint] for joint in joints))
    eom = equations_of_motion(kind)
    mass_matrix = Function("M", [eom.z, eom.p], [eom.M])
    change = Function("change", [q], [coordinates, jacobian(coordinates, q)])
    random = np.random.default_rng(3)
    for _ in range(5):
        s = np.append(random.uniform(-1, 1, len(kind.shape) + 1), 0.0)
        place, J = (np.asarray(value) for value in change(s))
        data.qpos[:] = place.ravel()
        mujoco.mj_forward(model, data)
        M = np.zeros((model.nv, model.nv))
        for row, unit in zip(M, np.eye(model.nv), strict=True):  # mj_fullM differs between versions of MuJoCo
            mujoco.mj_mulM(model, data, row, unit)
        expected = np.asarray(mass_matrix([*s[:-1], *np.zeros(len(s) - 1)], values))
        np.testing.assert_allclose(J.T @ M @ J, expected, atol=1e-7)  # a point mass has the inertia 1e-9 there


@pytest.mark.parametrize("walker", DIFFERENT, indirect=True)
def test_a_robot_whose_legs_differ_is_written_but_not_read_back(walker: Walker) -> None:
    leg = "shank" if walker.model == "kneed_walker" else "leg"
    feet = f"stance_{leg}_foot", f"swing_{leg}_foot"
    with pytest.raises(ProblemError, match=r"is unlike link stance_\w+: mass .* both legs must be alike"):
        walker_from_text(robot_description(walker), feet, "written.urdf")


def test_a_walker_without_links_is_refused_by_name(run: Any) -> None:
    with pytest.raises(ProblemError, match="hopper declares no links, so that it cannot be written as a tree of links"):
        robot_description(load_problem("hopper").walker)
    code, out, err = run("show", "hopper", "--format", "urdf")
    assert (code, out) == (3, "")
    assert "hopper declares no links" in err


@pytest.mark.parametrize("form", ["urdf", "mjcf"])
def test_the_command_prints_what_the_library_returns(run: Any, form: Any) -> None:
    code, out, _ = run("show", "compass-passive-a", "--format", form)
    assert code == 0
    assert out == go.robot_description(load_problem("compass-passive-a").walker, form)
    with pytest.raises(ProblemError, match="format is 'sdf', but must be urdf or mjcf"):
        go.robot_description(load_problem("compass-passive-a").walker, "sdf")  # type: ignore[arg-type]
