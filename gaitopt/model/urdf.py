"""Robots in URDF: a file as the class of a planar walker, with the links of the file.

All joints that move turn about one horizontal direction n. The robot walks in the plane perpendicular to n: forward is
n x up, so that a rotation about n takes up to forward. The pose of the file, with all joints at zero, determines the
plane's geometry; links that are fixed to each other are one body. The angle of a link is measured forward from that
pose, and its name is a coordinate. If a link of a leg points up in the file's pose, its angle is measured from the
direction down instead, as for RABBIT, whose hip has the angle pi when it stands.

The text of a file is untrusted: entities and document types are refused, and size, depth and numbers are bounded.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from types import SimpleNamespace
from typing import Annotated, Any, ClassVar, NoReturn, cast
from xml.parsers import expat

import numpy as np
from casadi import SX, atan2
from pydantic import Field

from gaitopt.arrays import Array
from gaitopt.errors import ProblemError
from gaitopt.model.declaration import COLUMNS, RESERVED
from gaitopt.model.foreign import FOOT_COORDINATES, NAME, NAME_WORDS
from gaitopt.model.links import SAME, Tree, state_tree
from gaitopt.model.mechanism import Link, Mechanism
from gaitopt.model.units import Inertia, Positive, Slope, parse_number
from gaitopt.model.walker import Walker

MAX_BYTES = 1024 * 1024
"""Largest size of a file: more than any robot has without its meshes, which are files of their own."""
MAX_DEPTH, MAX_ELEMENTS, MAX_MOVING = 20, 5000, 16
"""Largest depth and number of elements, and of moving links: equations of more links would take minutes to compile."""
LARGEST_ENTRY = 1e4
"""Largest length [m], mass [kg], inertia [kg m^2] and angle [rad] of a robot that walks."""
PARALLEL = 1e-4
"""Largest angle between parallel axes [rad]: files write 1.5708 for a right angle."""
SEMIDEFINITE = 1e-9
"""Largest relative size of a negative principal moment of inertia that is rounding."""
SPREAD, BEND = 0.25, 0.3
"""Lean of a leg, and bend of its joints, in the posture near which the closure of the legs is solved [rad]."""
STANCE_LEG = "stance_leg"
"""Phase variable of a robot, unless one of its links or motors has this name."""
GROUND = ("floating", "planar", "prismatic")
"""Joints by which a file may tie the robot to a massless root, the ground."""


@dataclass(slots=True)
class Element:
    """An element of an XML text with its attributes and children, and the line of its start.

    ``owner`` is the tag and name of the link or joint to which it belongs; empty outside of these.
    """

    tag: str
    attributes: dict[str, str]
    line: int
    owner: str = ""
    children: list["Element"] = field(default_factory=list)

    def find(self, tag: str) -> "Element | None":
        """The first child with a tag."""
        return next((child for child in self.children if child.tag == tag), None)


@dataclass(slots=True, eq=False)
class Body:
    """Links that are fixed to each other, in the plane and in the pose of the file.

    ``joint`` connects the body to its parent, and ``origin`` is the position of this joint. ``moment`` is the mass
    times the position of the centre of mass.
    """

    name: str
    parent: "Body | None"
    joint: "Element | None"
    origin: Array
    sign: int = 1
    mass: float = 0.0
    moment: Array = field(default_factory=lambda: np.zeros(2))
    inertia: float = 0.0


class UrdfWalker(Walker):
    """Base of the classes of robots from files; its parameters are those that a URDF file does not state."""

    gravity: Annotated[Positive, Field(description="acceleration of gravity [m/s^2]")] = 9.81
    slope: Annotated[Slope, Field(description="slope, downhill along x [rad]")] = 0.0
    rotor_inertia: Annotated[
        Inertia,
        Field(description="moment of inertia of the rotor in a joint, times its gear ratio squared [kg m^2]"),
    ] = 0.0

    file: ClassVar[str]
    text: ClassVar[str]
    feet: ClassVar[tuple[str, str]]
    bodies: ClassVar[tuple[Link, ...]]
    rebuilt_by: ClassVar[tuple[Any, ...]]

    @classmethod
    def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
        """The links of the file."""
        return tuple(
            replace(link, angle=getattr(q, link.name), rotor_inertia=p.rotor_inertia if link.joint else 0.0)
            for link in cls.bodies
        )

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The mechanism of the links; the phase is the lean of the line from the stance foot to the hip."""
        plain, tree = super().mechanism(q, p), Tree(state_tree(cls, q, p).links, SX.zeros(2))
        hip, entry, _ = tree.path[len(tree.path) // 2]
        line = tree.position(hip, entry) - tree.position(tree.stance, tree.stance.tip)
        return replace(plain, phases={name: atan2(line[0], line[1]) for name in cls.phases})

    @classmethod
    def statement(cls) -> dict[str, Any]:
        """The file by name and text, and the feet."""
        return {"urdf": {"file": cls.file, "text": cls.text}, "feet": list(cls.feet)}


def parse_xml(text: str, file: str) -> Element:
    """The root element of an XML text, which must have no document type and no entities.

    Raises
    ------
    ProblemError
        If the text is not XML or exceeds a bound; the message has file and line.
    """
    parser = expat.ParserCreate("utf-8")  # the text was decoded already, whatever encoding it declares
    root = Element("", {}, 0)
    open_elements, count = [root], 0

    def refuse(message: str) -> Callable[..., None]:
        def handler(*_: object) -> None:
            raise ProblemError(f"{file}:{parser.CurrentLineNumber}: {message}")

        return handler

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MAX_ELEMENTS:
            refuse(f"more than {MAX_ELEMENTS} elements: a robot's file has some hundred")()
        if len(open_elements) > MAX_DEPTH:
            refuse(f"nested deeper than {MAX_DEPTH} levels")()
        owner = f"{tag} {attributes.get('name', '')}".rstrip() if tag in ("link", "joint") else open_elements[-1].owner
        element = Element(tag, attributes, parser.CurrentLineNumber, owner)
        open_elements[-1].children.append(element)
        open_elements.append(element)

    if len(text.encode()) > MAX_BYTES:
        raise ProblemError(
            f"{file}:1: is larger than {MAX_BYTES // 1024} kB: a robot's file usually has a few hundred lines"
        )
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda tag: open_elements.pop()
    parser.StartDoctypeDeclHandler = refuse("a document type (DTD) is not allowed: remove <!DOCTYPE ...>")
    parser.EntityDeclHandler = refuse("an XML entity is not allowed: write its text out")
    parser.SkippedEntityHandler = refuse("an XML entity is not allowed: write its text out")
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        raise ProblemError(f"{file}:{error.lineno}: is not XML: {expat.ErrorString(error.code)}") from error
    return root.children[0]


@cache  # classes are compared by identity
def walker_from_text(text: str, feet: tuple[str, str], file: str) -> type[UrdfWalker]:
    """The class of the robot in a URDF text; equal texts have one class in a process.

    Parameters
    ----------
    feet : names of the links whose origins are the feet; the first one stands in the first step.
    file : name of the file in messages.

    Raises
    ------
    ProblemError
        If the robot is not a planar tree with inertia and point feet, or the file is wrong; with file and line.
    """
    return _Reader(text, feet, file).walker()


def rebuilt(text: str, feet: tuple[str, str], file: str) -> type[UrdfWalker]:
    """The class of a pickled robot, from the content of its file."""
    return walker_from_text(text, feet, file)


class _Reader:
    """Reads one file: its tree in space, its bodies in the plane, its links."""

    def __init__(self, text: str, feet: tuple[str, str], file: str) -> None:
        self.text, self.feet, self.file = text, feet, file
        self.robot = parse_xml(text, file)
        self._links = self._named("link")
        self._joints = self._named("joint")

    def refuse(self, element: Element, message: str) -> NoReturn:
        """Raise the error about an element, with its line and the name of its link or joint."""
        what = element.owner or f"<{element.tag}>"
        tag = "" if element.tag in ("link", "joint") or not element.owner else f"<{element.tag}> "
        raise ProblemError(f"{self.file}:{element.line}: {what}: {tag}{message}")

    def _named(self, tag: str) -> dict[str, Element]:
        """Links or joints by name."""
        if self.robot.tag != "robot":
            self.refuse(self.robot, "is not URDF, whose root is <robot>")
        elements: dict[str, Element] = {}
        for element in self.robot.children:
            if element.tag.startswith("xacro:"):
                self.refuse(element, "xacro is not expanded: run `xacro FILE > robot.urdf` first")
            if element.tag != tag:
                continue
            name = element.attributes.get("name", "")
            if not name:
                self.refuse(element, "has no name")
            if name in elements:
                self.refuse(element, f"is defined twice, first in line {elements[name].line}")
            if tag == "joint" and name in self._links:
                self.refuse(element, f"is also the name of the link in line {self._links[name].line}: rename one")
            elements[name] = element
        return elements

    def walker(self) -> type[UrdfWalker]:
        """The class of the robot."""
        order = self._order()
        poses = self._poses(order)
        normal = self._normal(poses)
        bodies = self._bodies(order, poses, normal)
        links, posture = self._planar(bodies, poses, normal)
        motors = tuple(link.joint for link in links if link.joint and link.effort != 0)
        name = re.sub(r"[^\w.-]+", "_", self.robot.attributes.get("name", "")).strip("_.-") or "robot"
        namespace = {
            "__module__": __name__,
            "__doc__": f"The robot in {self.file}.",
            "model": name,
            "shape": tuple(link.name for link in links),
            "posture": posture,
            "phases": () if STANCE_LEG in (*(link.name for link in links), *motors) else (STANCE_LEG,),
            "actuators": motors,
            "tracked": motors,
            "file": self.file,
            "text": self.text,
            "feet": self.feet,
            "bodies": links,
            "rebuilt_by": (rebuilt, (self.text, self.feet, self.file)),
        }
        made: Any = type(UrdfWalker)
        return cast("type[UrdfWalker]", made("Urdf" + re.sub(r"\W", "", name.title()), (UrdfWalker,), namespace))

    def _order(self) -> list[tuple[str, Element | None]]:
        """Links from the root outwards, each with the joint that carries it."""
        if not self._links:
            self.refuse(self.robot, "has no links")
        carrier: dict[str, Element] = {}
        for joint in self._joints.values():
            ends = {}
            for tag in ("parent", "child"):
                end = joint.find(tag)
                name = "" if end is None else end.attributes.get("link", "")
                if name not in self._links:
                    self.refuse(end or joint, f"the {tag} {name!r} of joint {joint.attributes['name']} is not a link")
                ends[tag] = name
            if ends["child"] in carrier:
                other = carrier[ends["child"]].attributes["name"]
                reason = f"link {ends['child']} is also the child of joint {other}; only trees can be read"
                self.refuse(joint, f"closes a loop: {reason}")
            carrier[ends["child"]] = joint
            joint.attributes |= {"from": ends["parent"], "to": ends["child"]}
        roots = [name for name in self._links if name not in carrier]
        if len(roots) != 1:
            reason = f"links {', '.join(roots)} belong to no joint" if roots else "the joints form a loop"
            self.refuse(self._links[roots[1]] if roots else self.robot, f"is not one tree: {reason}")
        order: list[tuple[str, Element | None]] = [(roots[0], None)]
        for name, _ in order:
            order += [(j.attributes["to"], j) for j in self._joints.values() if j.attributes["from"] == name]
        lost = [name for name in self._links if name not in dict(order)]
        if lost:
            self.refuse(self._links[lost[0]], "closes a loop with its joints: only trees can be read")
        return self._without_ground(order)

    def _without_ground(self, order: list[tuple[str, Element | None]]) -> list[tuple[str, Element | None]]:
        """The tree without the massless links at its root, if their joints tie the robot to the ground."""
        start, sliding = 0, False
        while start + 1 < len(order) and self._links[order[start][0]].find("inertial") is None:
            children = [joint for _, joint in order if joint and joint.attributes["from"] == order[start][0]]
            kind = children[0].attributes.get("type") if len(children) == 1 else None
            sliding = sliding or kind in GROUND
            if kind not in (*GROUND, "revolute", "continuous", "fixed") or order[start][0] in self.feet:
                break
            start += 1
        if not sliding:
            return order
        return [(order[start][0], None), *order[start + 1 :]]

    def _poses(self, order: list[tuple[str, Element | None]]) -> dict[str, tuple[Array, Array]]:
        """Rotation and position of every link's frame in the pose of the file."""
        poses = {order[0][0]: (np.eye(3), np.zeros(3))}
        for name, joint in order[1:]:
            assert joint is not None
            R, t = poses[joint.attributes["from"]]
            turn, shift = self._origin(joint)
            poses[name] = R @ turn, t + R @ shift
            kind = joint.attributes.get("type", "")
            if kind not in ("revolute", "continuous", "fixed"):
                reason = "a planar walker has revolute, continuous and fixed joints" if kind else "it has no type"
                self.refuse(joint, f"is {kind or 'incomplete'}: {reason}")
            mimic, dynamics = joint.find("mimic"), joint.find("dynamics")
            if mimic is not None:
                self.refuse(joint, "mimics another joint, which is not modelled: remove it, or fix it")
            if dynamics is not None and self._number(dynamics, "friction", 0.0) != 0:
                self.refuse(joint, "has dry friction, which is not modelled: set friction to 0, or use damping")
        return poses

    def _normal(self, poses: Mapping[str, tuple[Array, Array]]) -> Array:
        """The common direction of all axes. Its sign is such that forward is x, or y for a robot that walks along y."""
        normal, first = np.zeros(3), ""
        for name, axis, joint in self._axes(poses):
            if not first:
                normal, first = axis, name
            elif np.linalg.norm(np.cross(axis, normal)) > PARALLEL:
                difference = f"its axis {_vector(axis)} is not parallel to {_vector(normal)}, that of {first}"
                self.refuse(joint, f"is not planar: {difference}; fix the joint, or take it out")
        if not first:
            self.refuse(self.robot, "has no joint that moves")
        if abs(normal[2]) > PARALLEL:
            reason = f"the axes {_vector(normal)} are not horizontal (z is up), so it does not walk in a vertical plane"
            self.refuse(self._joints[first], f"is not planar: {reason}")
        forward = np.cross(normal, [0.0, 0.0, 1.0])
        return normal if forward[np.argmax(np.abs(forward))] > 0 else -normal

    def _axes(self, poses: Mapping[str, tuple[Array, Array]]) -> Iterator[tuple[str, Array, Element]]:
        for name, joint in self._joints.items():
            if joint.attributes["to"] not in poses or joint.attributes["from"] not in poses:
                continue
            if joint.attributes["type"] == "fixed":
                continue
            element = joint.find("axis")
            axis = np.array([1.0, 0.0, 0.0]) if element is None else self._triple(element, "xyz")
            if not np.linalg.norm(axis) > PARALLEL:
                self.refuse(joint, f"has the axis {_vector(axis)}, which is not a direction")
            yield name, poses[joint.attributes["to"]][0] @ axis / np.linalg.norm(axis), joint

    def _bodies(
        self, order: list[tuple[str, Element | None]], poses: Mapping[str, tuple[Array, Array]], normal: Array
    ) -> dict[str, Body]:
        """The body of every link."""
        axes = {name: axis for name, axis, _ in self._axes(poses)}
        bodies: dict[str, Body] = {}
        made: list[Body] = []
        for name, joint in order:
            if joint is None or joint.attributes["type"] != "fixed":
                parent = bodies[joint.attributes["from"]] if joint else None
                sign = 1 if joint is None or axes[joint.attributes["name"]] @ normal > 0 else -1
                made.append(Body(name, parent, joint, _plane(normal) @ poses[name][1], sign))
                bodies[name] = made[-1]
            else:
                bodies[name] = bodies[joint.attributes["from"]]
        if len(made) > MAX_MOVING:
            self.refuse(self.robot, f"has {len(made)} links that move; at most {MAX_MOVING} can be handled")
        heaviest = 0.0
        for name, body in bodies.items():
            mass, com, inertia = self._inertial(name, poses[name], normal)
            if body.parent is None and mass > heaviest:  # a root is often an empty frame
                body.name, heaviest = name, mass
            body.mass += mass
            body.moment = body.moment + mass * com
            body.inertia += inertia + mass * float(com @ com)  # about the origin of the plane, so far
        taken = {*FOOT_COORDINATES, *(f"d{name}" for name in (*FOOT_COORDINATES, *(body.name for body in made)))}
        for body in made:
            link = self._links[body.name]
            if not body.mass > 0:
                self.refuse(link, "moves, but has no inertia: give it <inertial> with a mass, or fix its joint")
            body.inertia -= float(body.moment @ body.moment) / body.mass
            body.inertia = max(body.inertia, 0.0)
            if not NAME.fullmatch(body.name):
                self.refuse(link, f"moves, and its name is a coordinate, which must have {NAME_WORDS}: rename it")
            if body.name in taken:
                self.refuse(link, "moves, and has the name of a coordinate of the foot, or of a link's rate: rename it")
            if body.name in COLUMNS:
                self.refuse(link, "moves, and has the name of another column of the table of a motion: rename it")
            if body.joint is not None and body.joint.attributes["name"] in RESERVED:
                self.refuse(body.joint, "has a name with another meaning in problem files: rename it")
            if body.joint is not None and not NAME.fullmatch(body.joint.attributes["name"]):
                self.refuse(body.joint, f"moves, and its name is a motor's, which must have {NAME_WORDS}: rename it")
        return bodies

    def _inertial(self, name: str, pose: tuple[Array, Array], normal: Array) -> tuple[float, Array, float]:
        """Mass, centre of mass in the plane, and moment of inertia about the normal through it."""
        link = self._links[name]
        element = link.find("inertial")
        if element is None:
            return 0.0, np.zeros(2), 0.0
        parts = element.find("mass"), element.find("inertia")
        if parts[0] is None or parts[1] is None:
            self.refuse(link, f"has <inertial> without <{'mass' if parts[0] is None else 'inertia'}>")
        mass = self._number(parts[0], "value")
        if mass < 0:
            self.refuse(link, f"has the mass {mass:g} kg, which must not be negative")
        ixx, ixy, ixz, iyy, iyz, izz = (
            self._number(parts[1], key, None if key[1] == key[2] else 0.0)
            for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        tensor = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        smallest = float(np.linalg.eigvalsh(tensor)[0])
        turn, shift = self._origin(element)
        axis = (pose[0] @ turn).T @ normal
        about = float(axis @ tensor @ axis)
        if about < 0 or (smallest < -SEMIDEFINITE * np.abs(tensor).max(initial=0.0) and about <= 0):
            self.refuse(
                link, f"has the moment of inertia {about:.4g} kg m^2 about the axes, which must not be negative"
            )
        return mass, _plane(normal) @ (pose[1] + pose[0] @ shift), about

    def _planar(
        self, bodies: Mapping[str, Body], poses: Mapping[str, tuple[Array, Array]], normal: Array
    ) -> tuple[tuple[Link, ...], dict[str, float]]:
        """The links in the order of the coordinates, and a posture just after an impact.

        A leg has the bodies from a foot up to the hip. The frame of a leg's body begins at the body's upper joint and
        is turned upside down (``flips`` is -1) if its lower end is above that joint in the pose of the file.
        """
        feet = [self._foot(foot, bodies, poses, normal) for foot in self.feet]
        (stance, first, _), (swing, second, _) = feet
        if self.feet[0] == self.feet[1]:
            self.refuse(self._links[self.feet[0]], "is named twice by feet: name two links")
        if stance is swing:
            self.refuse(self._links[self.feet[1]], f"and {self.feet[0]} are feet of one rigid body, {stance.name}")
        made = list(dict.fromkeys(bodies.values()))
        chains = [_carriers(stance), _carriers(swing)]
        top = next(body for body in chains[0] if body in chains[1])
        chains = [chain[: chain.index(top)] for chain in chains]
        path = [*chains[0], top, *chains[1][::-1]]
        legs = [path[: len(path) // 2], path[::-1][: len(path) // 2]]
        hips, ends, tops = list[Array](), dict[Body, Array](), dict[Body, Array]()
        for leg, end, upwards in zip(legs, (first, second), (path, path[::-1]), strict=True):
            for body, above in zip(leg, upwards[1:], strict=False):
                ends[body], end = end, (body if body.parent is above else above).origin
                tops[body] = end
            hips.append(end)
        flips = dict[Body, float]()
        for body in sorted(made, key=lambda body: len(_carriers(body))):
            flips[body] = 1.0 if body.parent is None else flips[body.parent]
            if body in ends:
                up = float(tops[body][1] - ends[body][1])
                flips[body] = flips[body] if up == 0 else math.copysign(1.0, up)
                body.origin = tops[body] if body.parent is None else body.origin
        radii = {stance: feet[0][2], swing: feet[1][2]}
        self._check_alike(legs, hips, tops, ends, flips, radii)
        others = [body for body in made if body not in ends]
        links = tuple(
            self._link(body, flips, ends.get(body), body in radii, radii.get(body, 0.0))
            for body in (*others, *legs[0][::-1], *legs[1][::-1])
        )
        by_name = {link.name: link for link in links}
        self._check_joints_alike([by_name[body.name] for body in path])
        return links, {**_posture(legs[0], by_name, -SPREAD), **_posture(legs[1], by_name, SPREAD)}

    def _check_alike(
        self,
        legs: list[list[Body]],
        hips: list[Array],
        tops: Mapping[Body, Array],
        ends: Mapping[Body, Array],
        flips: Mapping[Body, float],
        radii: Mapping[Body, float],
    ) -> None:
        """Refuse legs that differ in the plane: links are compared from the foot up, each from its upper joint."""
        for one, other in zip(*legs, strict=True):
            stated = [
                {
                    "mass": body.mass,
                    "inertia": body.inertia,
                    "centre of mass": _point(flips[body] * (body.moment / body.mass - tops[body])),
                    "lower end": _point(flips[body] * (ends[body] - tops[body])),
                    "radius of the foot": radii.get(body, 0.0),
                }
                for body in (other, one)
            ]
            for what, value in stated[0].items():
                if np.abs(np.subtract(value, stated[1][what])).max() > SAME * max(1.0, np.abs(value).max()):
                    reason = f"is unlike link {one.name}: {what} {_text(value)} and {_text(stated[1][what])}"
                    self.refuse(self._links[other.name], f"{reason}; both legs must be alike")
        if np.abs(hips[0] - hips[1]).max() > SAME:
            reason = f"the hip of {legs[1][-1].name} at {_vector(hips[1])} m is not that of {legs[0][-1].name}"
            self.refuse(self._links[self.feet[1]], f"{reason}, {_vector(hips[0])} m: they must be one from the side")

    def _check_joints_alike(self, path: list[Link]) -> None:
        """Refuse legs whose joints differ: torques and limits would change when the feet swap roles.

        A motor in only one leg is not refused: it always drives the stance leg, or always the swing leg.

        Parameters
        ----------
        path : links from the stance foot to the swing foot.
        """
        for k in range(len(path) // 2):
            (one, span), (other, others) = _turn(path[k + 1], path[k]), _turn(path[-k - 2], path[-k - 1])
            efforts = [math.inf if link.effort is None else link.effort for link in (one, other)]
            efforts = efforts if all(efforts) else [0.0, 0.0]
            stated = {"damping": (one.damping, other.damping), "effort": (*efforts,), "range": (span, others)}
            for what, (ours, theirs) in stated.items():
                if one is not other and not np.allclose(ours, theirs, rtol=SAME, atol=SAME):
                    reason = f"is unlike joint {one.joint}: {what} {_text(ours)} and {_text(theirs)}"
                    self.refuse(self._joints[other.joint], f"{reason}; both legs must be alike")

    def _link(self, body: Body, flips: Mapping[Body, float], end: Array | None, foot: bool, radius: float) -> Link:
        """A body as a link. The axes of its frame are forward and up in the pose of the file, or backward and down."""
        flip, joint, com = flips[body], body.joint, body.moment / body.mass
        if end is None:  # the end of a torso or an arm is not known: it is drawn beyond its centre of mass
            end = 2 * com - body.origin
        stated: dict[str, Any] = {}
        if joint is not None and body.parent is not None:
            limit, dynamics = joint.find("limit"), joint.find("dynamics")
            turned = (1 - flip) / 2 - (1 - flips[body.parent]) / 2
            stated = {
                "parent": body.parent.name,
                "joint": joint.attributes["name"],
                "position": _point(flips[body.parent] * (body.origin - body.parent.origin)),
                "sign": body.sign,
                "zero": body.sign * turned * math.pi,
                "damping": 0.0 if dynamics is None else self._number(dynamics, "damping", 0.0),
            }
            if stated["damping"] < 0:
                self.refuse(joint, f"has the damping {stated['damping']:g}, which must not be negative")
            if joint.attributes["type"] == "revolute":
                if limit is None:
                    self.refuse(joint, "is revolute without <limit>: add it, or make the joint continuous")
                span = self._number(limit, "lower", 0.0), self._number(limit, "upper", 0.0)
                if not span[0] < span[1]:
                    self.refuse(joint, f"has the limits {span[0]:g} and {span[1]:g} rad, but lower must be below upper")
                stated["range"] = span
            if limit is not None and "effort" in limit.attributes:
                stated["effort"] = self._number(limit, "effort")
                if stated["effort"] < 0:
                    self.refuse(joint, f"has the effort {stated['effort']:g} N m, which must not be negative")
        return Link(
            name=body.name,
            angle=0.0,
            mass=body.mass,
            com=_point(flip * (com - body.origin)),
            inertia=body.inertia,
            tip=_point(flip * (end - body.origin)),
            foot=foot,
            foot_radius=radius,
            **stated,
        )

    def _foot(
        self, name: str, bodies: Mapping[str, Body], poses: Mapping[str, tuple[Array, Array]], normal: Array
    ) -> tuple[Body, Array, float]:
        """The body of a foot, the position of the foot (the centre of a round one) in the plane, and its radius."""
        if name not in bodies:
            import difflib

            near = difflib.get_close_matches(name, bodies, n=1)
            remedy = f"did you mean {near[0]}?" if near else f"links: {', '.join(bodies)}"
            self.refuse(self.robot, f"has no link {name!r}, which feet names; {remedy}")
        link, (R, t) = self._links[name], poses[name]
        shapes = [child.find("geometry") for child in link.children if child.tag == "collision"]
        kinds = [(shape.children[0] if shape is not None and shape.children else link) for shape in shapes]
        if not shapes:
            return bodies[name], _plane(normal) @ t, 0.0
        if len(shapes) > 1 or kinds[0].tag != "sphere":
            shape = {"mesh": "is only a mesh", "link": "has no shape"}.get(kinds[0].tag, f"is a {kinds[0].tag}")
            self.refuse(
                link,
                f"is a foot, but its collision geometry {shape if len(shapes) == 1 else 'has several shapes'}: give a "
                "sphere, or no collision geometry, for a point foot at the link's origin",
            )
        collision = next(child for child in link.children if child.tag == "collision")
        _, shift = self._origin(collision)
        return bodies[name], _plane(normal) @ (t + R @ shift), self._number(kinds[0], "radius")

    def _origin(self, element: Element) -> tuple[Array, Array]:
        """Rotation and translation of ``<origin>``."""
        origin = element.find("origin")
        if origin is None:
            return np.eye(3), np.zeros(3)
        xyz, (roll, pitch, yaw) = (self._triple(origin, key, np.zeros(3)) for key in ("xyz", "rpy"))
        (a, b, c), (d, e, f) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
        turn_x = np.array([[1, 0, 0], [0, a, -d], [0, d, a]])
        turn_y = np.array([[b, 0, e], [0, 1, 0], [-e, 0, b]])
        turn_z = np.array([[c, -f, 0], [f, c, 0], [0, 0, 1]])
        return turn_z @ turn_y @ turn_x, xyz

    def _triple(self, element: Element, key: str, default: Array | None = None) -> Array:
        if key not in element.attributes and default is not None:
            return default
        numbers = element.attributes.get(key, "").split()
        if len(numbers) != 3:
            self.refuse(element, f"{key} = {_shown(' '.join(numbers))} must be three numbers")
        return np.array([self._value(element, key, word) for word in numbers])

    def _number(self, element: Element, key: str, default: float | None = None) -> float:
        if key not in element.attributes and default is not None:
            return default
        if key not in element.attributes:
            self.refuse(element, f"{key} is missing")
        return self._value(element, key, element.attributes[key])

    def _value(self, element: Element, key: str, word: str) -> float:
        try:
            value = parse_number(word)
        except ValueError:
            self.refuse(element, f"{key} = {_shown(word)} is not a number")
        if not abs(value) <= LARGEST_ENTRY:
            self.refuse(
                element, f"{key} = {_shown(word)} must be a number of at most {LARGEST_ENTRY:g} in size, in SI units"
            )
        return value


def _posture(leg: list[Body], links: Mapping[str, Link], lean: float) -> dict[str, float]:
    """Angles of the links of a leg that leans, with joints bent within their ranges, forward if possible."""
    names = [body.name for body in leg[::-1]]
    angles = [0.0]
    for above, name in pairwise(names):
        _, (lower, upper) = _turn(links[above], links[name])
        bend = BEND if lower <= BEND <= upper else -BEND if lower <= -BEND <= upper else np.clip(0.0, lower, upper)
        angles.append(angles[-1] + float(bend))
    return {name: lean + angle - float(np.mean(angles)) for name, angle in zip(names, angles, strict=True)}


def _turn(above: Link, below: Link) -> tuple[Link, tuple[float, float]]:
    """The link with the joint of two neighbours, and the range of the lower one's angle relative to the upper one."""
    link, side = (below, 1) if below.parent == above.name else (above, -1)
    lower, upper = sorted(side * link.sign * (end - link.zero) for end in link.range or (-np.inf, np.inf))
    return link, (lower, upper)


def _carriers(body: Body) -> list[Body]:
    """A body and the bodies that carry it, up to the root."""
    chain = [body]
    while chain[-1].parent is not None:
        chain.append(chain[-1].parent)
    return chain


def _plane(normal: Array) -> Array:
    """The directions forward and up, as rows."""
    return np.array([np.cross(normal, [0.0, 0.0, 1.0]), [0.0, 0.0, 1.0]])


def _point(values: Array) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _vector(values: Array) -> str:
    return f"({', '.join(f'{value:.4g}' for value in values)})"


def _text(value: Any) -> str:
    return _vector(np.array(value)) if isinstance(value, tuple) else f"{float(value):.6g}"


def _shown(text: str) -> str:
    return repr(text if len(text) <= 40 else f"{text[:37]}...")
