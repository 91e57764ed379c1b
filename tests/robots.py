"""Robots in URDF for tests: planar trees with link frames turned at random in space."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Vector = NDArray[Any]


@dataclass(frozen=True, kw_only=True)
class RobotLink:
    """A link in the zero pose of the file, in the axes of the world: x forward, z up."""

    name: str
    parent: str = ""
    joint: str = ""
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mass: float = 1.0
    inertia: tuple[float, float, float] = (0.1, 0.2, 0.15)
    sign: int = 1
    frame: Rotation = field(default_factory=Rotation.identity)
    foot: tuple[float, float, float] | None = None


def urdf(robot_links: list[RobotLink], extra: str = "") -> str:
    """The text of a file, with every frame turned as its link says."""
    by_name, lines = {link.name: link for link in robot_links}, ['<?xml version="1.0"?>', '<robot name="tree">']
    for link in robot_links:
        inverse = link.frame.inv()
        com = inverse.apply(np.array(link.com) - link.at)
        turned = inverse.as_matrix() @ np.diag(link.inertia) @ inverse.as_matrix().T
        entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
        inertia = " ".join(f'{key}="{float(turned[entry])!r}"' for key, entry in entries.items())
        lines += [
            f'<link name="{link.name}"><inertial><origin xyz="{_text(com)}"/><mass value="{link.mass!r}"/>'
            f"<inertia {inertia}/></inertial></link>"
        ]
        if link.parent:
            parent = by_name[link.parent]
            turn, axis = parent.frame.inv() * link.frame, inverse.apply([0.0, float(link.sign), 0.0])
            shift = parent.frame.inv().apply(np.array(link.at) - parent.at)
            lines += [
                f'<joint name="{link.joint}" type="continuous"><parent link="{parent.name}"/>'
                f'<child link="{link.name}"/><origin xyz="{_text(shift)}" rpy="{_text(turn.as_euler("xyz"))}"/>'
                f'<axis xyz="{_text(axis)}"/></joint>'
            ]
        if link.foot is not None:
            shift = inverse.apply(np.array(link.foot) - link.at)
            lines += [
                f'<link name="{link.name}_foot"/><joint name="{link.name}_sole" type="fixed">'
                f'<parent link="{link.name}"/><child link="{link.name}_foot"/><origin xyz="{_text(shift)}"/></joint>'
            ]
    return "\n".join([*lines, extra, "</robot>"]) + "\n"


def tree(links: int, seed: int = 0) -> list[RobotLink]:
    """A torso with two legs of (links - 1) / 2 links; of 9, two are arms. All frames but the root's are random."""
    random = np.random.default_rng([links, seed])
    arms = links == 9
    per_leg = (links - 1 - 2 * arms) // 2

    def turned() -> Rotation:
        return Rotation.from_rotvec(random.standard_normal(3))

    robot_links = [RobotLink(name="torso", com=(0.05, 0.0, 0.3), mass=10.0, inertia=(1.1, 1.0, 0.5))]
    drops = [0.0, *np.cumsum(random.uniform(0.2, 0.5, per_leg))]
    sides = random.uniform(-0.03, 0.03, per_leg + 1)
    sides[0] = 0.02
    masses, inertias = random.uniform(1, 5, per_leg), random.uniform(0.01, 0.2, per_leg)
    offsets = random.uniform(-0.05, 0.05, (per_leg, 2))
    for side, y in (("left", 0.1), ("right", -0.12)):
        above = "torso"
        for k in range(per_leg):
            x, z = float(sides[k]), -float(drops[k])
            com = (x + float(offsets[k, 0]), y, z - 0.1 + float(offsets[k, 1]))
            robot_links.append(
                RobotLink(
                    name=f"{side}_link{k}",
                    parent=above,
                    joint=f"{side}_joint{k}",
                    at=(x, y, z),
                    com=com,
                    mass=float(masses[k]),
                    inertia=(0.3, float(inertias[k]), 0.2),
                    sign=int(random.choice([-1, 1])),
                    frame=turned(),
                    foot=(float(sides[-1]), y, -float(drops[-1])) if k == per_leg - 1 else None,
                )
            )
            above = f"{side}_link{k}"
    for side, y in (("left", 0.3), ("right", -0.3)) if arms else ():
        arm = {"at": (0.0, y, 0.5), "com": (0.03, y, 0.3), "mass": 1.5, "inertia": (0.1, 0.05, 0.1)}
        robot_links.append(
            RobotLink(name=f"{side}_arm", parent="torso", joint=f"{side}_shoulder", frame=turned(), **arm)
        )
    return robot_links


def feet(links: int) -> tuple[str, str]:
    """Names of the feet of ``tree``."""
    last = (links - 1 - 2 * (links == 9)) // 2 - 1
    return f"left_link{last}_foot", f"right_link{last}_foot"


def _text(values: Vector) -> str:
    return " ".join(repr(float(value)) for value in values)
