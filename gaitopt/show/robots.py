"""A walker's links as a file for other programs: URDF, or MJCF of MuJoCo.

The plane has the axes x and z, with z up. Joints turn about y, by the rotation that takes z to x. In the pose of the
file all joints are at zero. Feet are frames without mass at the tips of their links. A URDF file states neither slope
nor gravity. In an MJCF file the ground is a level plane, and gravity is inclined.
"""

import math
from types import SimpleNamespace
from typing import Any, Literal
from xml.etree import ElementTree as ET
from xml.etree.ElementTree import Element, SubElement

from casadi import DM, SX

from gaitopt.building import building
from gaitopt.errors import ProblemError
from gaitopt.model.declaration import has_links, state_mechanism
from gaitopt.model.links import state_tree
from gaitopt.model.mechanism import Link
from gaitopt.model.walker import Walker

Format = Literal["urdf", "mjcf"]
RADIUS = 0.02
"""Radius of the rods that draw the links, relative to their lengths."""
POINT_RADIUS = 1e-6
"""Radius of the sphere that stands for a point foot [m]: a larger one would roll, and start inside the ground."""
UNLIMITED = 1e4
"""Torque and rate that are written if there is no limit, because URDF requires one [N m, rad/s]."""


def robot_description(walker: Walker, format: Format = "urdf") -> str:  # noqa: A002 - as the option of the command
    """Write the links of a walker, at its parameters, as URDF or MJCF text.

    Parameters
    ----------
    walker : a walker with its parameters, as ``Problem.walker``.
    format : ``urdf``, or ``mjcf`` for MuJoCo.

    Raises
    ------
    ProblemError
        If the walker declares no links, or the format is unknown.
    """
    if format not in ("urdf", "mjcf"):
        raise ProblemError(f"format is {format!r}, but must be urdf or mjcf")
    links, gravity = _links(walker)
    root = _urdf(walker, links) if format == "urdf" else _mjcf(walker, links, gravity)
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


@building
def _links(walker: Walker) -> tuple[list[dict[str, Any]], tuple[float, float]]:
    """Every link with its attributes as numbers, the angle from its parent in the pose of the file, and gravity."""
    model = type(walker)
    if not has_links(model):
        raise ProblemError(f"{model.model} declares no links, so that it cannot be written as a tree of links")
    q = SimpleNamespace(**{name: SX.sym(name) for name in (*model.shape, "x", "y")})
    p = SimpleNamespace(**{name: float(value) for name, value in walker})
    tree, gravity = state_tree(model, q, p), DM(state_mechanism(model, q, p).gravity)
    by_name = {link.name: link for link in tree.links}
    return [_numbers(link, by_name) for link in tree.links], (float(gravity[0]), float(gravity[1]))


def _numbers(link: Link, by_name: dict[str, Link]) -> dict[str, Any]:
    numbers: dict[str, Any] = {name: float(DM(getattr(link, name))) for name in ("mass", "inertia", "foot_radius")}
    numbers |= {name: float(DM(getattr(link, name))) for name in ("rotor_inertia", "damping")}
    points = {name: DM(getattr(link, name)) for name in ("position", "com", "tip")}
    numbers |= {name: (float(point[0]), float(point[1])) for name, point in points.items()}
    turn = -link.sign * link.zero
    if link.parent is not None and not link.joint:
        turn = float(DM(link.angle - by_name[link.parent].angle))
    return numbers | {"link": link, "turn": turn}


def _urdf(walker: Walker, links: list[dict[str, Any]]) -> Element:
    robot = Element("robot", name=type(walker).model)
    for entry in links:
        link: Link = entry["link"]
        element = SubElement(robot, "link", name=link.name)
        _inertial(element, entry["com"], entry["mass"], entry["inertia"])
        x, z = entry["tip"]
        length = math.hypot(x, z)
        if length > 0:
            visual = SubElement(element, "visual")
            SubElement(visual, "origin", xyz=_xyz((x / 2, z / 2)), rpy=f"0 {math.atan2(x, z)!r} 0")
            SubElement(SubElement(visual, "geometry"), "cylinder", radius=repr(RADIUS * length), length=repr(length))
        if link.parent is not None:
            kind = "fixed" if not link.joint else "continuous" if link.range is None else "revolute"
            joint = SubElement(robot, "joint", name=link.joint or f"{link.name}_fixed", type=kind)
            SubElement(joint, "parent", link=link.parent)
            SubElement(joint, "child", link=link.name)
            SubElement(joint, "origin", xyz=_xyz(entry["position"]), rpy=f"0 {entry['turn']!r} 0")
            if link.joint:
                SubElement(joint, "axis", xyz=f"0 {link.sign} 0")
                if entry["damping"]:
                    SubElement(joint, "dynamics", damping=repr(entry["damping"]))
                SubElement(joint, "limit", _limit(walker, link))
        if link.foot:
            foot = SubElement(robot, "link", name=f"{link.name}_foot")
            _inertial(foot, (0.0, 0.0), 0.0, 0.0)
            if entry["foot_radius"]:
                geometry = SubElement(SubElement(foot, "collision"), "geometry")
                SubElement(geometry, "sphere", radius=repr(entry["foot_radius"]))
            joint = SubElement(robot, "joint", name=f"{link.name}_sole", type="fixed")
            SubElement(joint, "parent", link=link.name)
            SubElement(joint, "child", link=f"{link.name}_foot")
            SubElement(joint, "origin", xyz=_xyz(entry["tip"]))
    return robot


def _inertial(link: Element, com: tuple[float, float], mass: float, inertia: float) -> None:
    """Write mass and moment of inertia, even if they are zero: PyBullet gives a link without them a mass of 1 kg."""
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_xyz(com))
    SubElement(inertial, "mass", value=repr(mass))
    moment = repr(inertia)
    SubElement(inertial, "inertia", ixx=moment, ixy="0", ixz="0", iyy=moment, iyz="0", izz=moment)


def _limit(walker: Walker, link: Link) -> dict[str, str]:
    """Range of a joint, largest torque (0 without motor), and a rate, which URDF requires."""
    torque = UNLIMITED if link.effort is None else link.effort
    limit = {"effort": repr(torque if link.joint in walker.actuators else 0.0), "velocity": repr(UNLIMITED)}
    return limit | ({} if link.range is None else {"lower": repr(link.range[0]), "upper": repr(link.range[1])})


def _mjcf(walker: Walker, links: list[dict[str, Any]], gravity: tuple[float, float]) -> Element:
    root = Element("mujoco", model=type(walker).model)
    # MuJoCo refuses a body without inertia: a point mass gets the smallest one that it accepts
    SubElement(root, "compiler", angle="radian", autolimits="true", boundinertia="1e-9")
    SubElement(root, "option", gravity=f"{gravity[0]!r} 0 {gravity[1]!r}")
    world = SubElement(root, "worldbody")
    SubElement(world, "geom", name="ground", type="plane", size="0 0 1")
    bodies: dict[str, Element] = {}
    waiting = sorted(links, key=lambda entry: entry["link"].parent is not None)
    while waiting:
        entry = waiting.pop(0)
        link: Link = entry["link"]
        if link.parent is not None and link.parent not in bodies:
            waiting.append(entry)
            continue
        x, z = entry["position"]
        turn = entry["turn"] / 2
        body = SubElement(
            world if link.parent is None else bodies[link.parent],
            "body",
            name=link.name,
            pos=_xyz((x, z)),
            quat=f"{math.cos(turn)!r} 0 {math.sin(turn)!r} 0",
        )
        bodies[link.name] = body
        if link.parent is None:
            for name, kind, axis in (("x", "slide", "1 0 0"), ("z", "slide", "0 0 1"), ("pitch", "hinge", "0 1 0")):
                SubElement(body, "joint", name=f"root_{name}", type=kind, axis=axis)
        elif link.joint:
            span: dict[str, str] = {} if link.range is None else {"range": f"{link.range[0]!r} {link.range[1]!r}"}
            own = {"armature": repr(entry["rotor_inertia"]), "damping": repr(entry["damping"])}
            hinge = {"name": link.joint, "type": "hinge", "axis": f"0 {link.sign} 0"}
            SubElement(body, "joint", hinge | own | span)
        if entry["mass"] > 0 or entry["inertia"] > 0:
            diagonal = " ".join([repr(entry["inertia"])] * 3)
            SubElement(body, "inertial", pos=_xyz(entry["com"]), mass=repr(entry["mass"]), diaginertia=diagonal)
        x, z = entry["tip"]
        length = math.hypot(x, z)
        if length > 0:
            drawn = {"type": "capsule", "fromto": f"0 0 0 {_xyz((x, z))}", "size": repr(RADIUS * length), "mass": "0"}
            SubElement(body, "geom", drawn | {"contype": "0", "conaffinity": "0", "group": "1"})
        if link.foot:
            SubElement(body, "site", name=f"{link.name}_foot", pos=_xyz((x, z)))
            radius = entry["foot_radius"] or POINT_RADIUS
            sphere = {"name": f"{link.name}_foot", "type": "sphere", "size": repr(radius)}
            SubElement(body, "geom", sphere, pos=_xyz((x, z)), mass="0")
    actuators = SubElement(root, "actuator")
    for entry in links:
        link = entry["link"]
        if link.joint in walker.actuators:
            torques: dict[str, str] = {} if link.effort is None else {"ctrlrange": f"{-link.effort!r} {link.effort!r}"}
            SubElement(actuators, "motor", {"name": link.joint, "joint": link.joint} | torques)
    return root


def _xyz(point: tuple[float, float]) -> str:
    return f"{point[0]!r} 0 {point[1]!r}"
