"""Links: a walker as a planar tree of rigid bodies, from which its mechanism, joints and drawing follow.

A link's frame turns with the link. At angle zero its axes are those of the ground, x downhill and y along the normal;
a positive angle turns y towards x, as that of a leg does. A point r of a frame with angle a is at

    origin + (r_x cos a + r_y sin a,  r_y cos a - r_x sin a)

Positions are summed along the tree from the stance foot, so that no term enters that would cancel again.
"""

from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
from casadi import DM, SX, atan2, cos, densify, is_equal, jacobian, norm_2, sin, sqrt, substitute, sumsqr, vertcat

from gaitopt.errors import ProblemError
from gaitopt.model.walker import Body, Damper, Mechanism, Walker, inclined

ORIGIN = (0.0, 0.0)
SAME = 1e-9
"""Relative difference below which numbers of two legs agree, above the digits of a file."""
SAME_DEPTH = 10
"""Operations up to which expressions of places and angles are compared."""
COMPARED = ("mass", "inertia", "position", "com", "tip", "rotor_inertia", "damping", "foot_radius")


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """A rigid link of a planar tree; points are in the frame of a link, shape (2,) [m].

    Attributes
    ----------
    name : name of the link.
    angle : SX - absolute angle of the frame, from the slope's normal towards downhill [rad].
    parent : name of the link that carries it; None for the root of the tree.
    joint : name of the joint with the parent; empty for the root, and for a link that is fixed to its parent.
    position : the joint, or the origin of a fixed link, in the frame of the parent; it is the origin of this frame.
    sign : 1, or -1 for a joint whose angle counts the other way.
    zero : the joint's angle is ``sign`` times (the angle of this link minus that of its parent), plus ``zero`` [rad].
    tip : the other end of the link in drawings; the foot, if there is one.
    foot : whether the tip is a foot. The first link with a foot belongs to the stance leg, the second one swings.
    foot_radius : radius of a round foot, whose centre is the tip [m].
    mass : [kg]
    com : centre of mass.
    inertia : moment of inertia about the centre of mass [kg m^2].
    rotor_inertia : that of the joint's motor, times the square of the gear ratio [kg m^2].
    damping : coefficient of a viscous damper in the joint [N m s/rad].
    range : smallest and largest angle of the joint; None if it has none [rad].
    effort : largest torque of the joint's motor; None if it has no limit [N m].
    """

    name: str
    angle: Any
    parent: str | None = None
    joint: str = ""
    position: Any = ORIGIN
    sign: int = 1
    zero: float = 0.0
    tip: Any = ORIGIN
    foot: bool = False
    foot_radius: Any = 0.0
    mass: Any = 0.0
    com: Any = ORIGIN
    inertia: Any = 0.0
    rotor_inertia: Any = 0.0
    damping: Any = 0.0
    range: tuple[float, float] | None = None
    effort: float | None = None


def difference(one: Link, other: Link) -> str | None:
    """The first attribute of ``COMPARED`` in which two links differ; None if they are alike."""
    for name in COMPARED:
        a, b = (_column(getattr(link, name)) for link in (one, other))
        gap = densify(a - b)
        size = np.abs(np.asarray(DM(a))).max() if a.is_constant() else 1.0
        if not gap.is_constant() or np.abs(np.asarray(DM(gap))).max() > SAME * max(1.0, size):
            return name
    return None


class Tree:
    """The links of a walker, placed on its stance foot.

    Parameters
    ----------
    links : as ``declaration.state_links`` returns them.
    foot : SX, shape (2,) - coordinates (x, y) of the stance foot; the centre of a round one is at x + R angle, y + R.

    Attributes
    ----------
    way : the links from the stance foot to the swing foot, each with the two points of its frame at which the way
        enters and leaves it.
    joints : angle of every joint by name, SX [rad].
    """

    def __init__(self, links: tuple[Link, ...], foot: SX) -> None:
        self.links = links
        by_name = {link.name: link for link in links}
        self.stance, self.swing = (link for link in links if link.foot)
        moving = (link for link in links if link.joint)
        self.joints = {
            link.joint: SX(link.sign * (link.angle - by_name[str(link.parent)].angle) + link.zero) for link in moving
        }
        R = SX(self.stance.foot_radius)
        centre = foot + vertcat(R * self.stance.angle, R)
        self._entry = {self.stance.name: (_column(self.stance.tip), centre)}  # a point of each frame, and its place
        before: dict[str, Link] = {}
        reached = [self.stance]
        for link in reached:
            for other in links:
                if other.name not in self._entry and (other.parent == link.name or link.parent == other.name):
                    here, there = _joint(link, other)
                    if is_equal(SX(link.angle), SX(other.angle), SAME_DEPTH):  # fixed: points of one frame
                        entry, place = self._entry[link.name]
                        self._entry[other.name] = entry + there - here, place
                    else:
                        self._entry[other.name] = there, self.place(link, here)
                    before[other.name] = link
                    reached.append(other)
        way = [self.swing]
        while way[0].name in before:
            way.insert(0, before[way[0].name])
        starts = [_column(self.stance.tip), *(_joint(one, other)[1] for one, other in pairwise(way))]
        ends = [*(_joint(one, other)[0] for one, other in pairwise(way)), _column(self.swing.tip)]
        self.way = list(zip(way, starts, ends, strict=True))

    def place(self, link: Link, within: Any) -> SX:
        """Position of a point of a link's frame, shape (2,) [m]."""
        entry, place = self._entry[link.name]
        x, y = (_column(within) - entry)[0], (_column(within) - entry)[1]
        return place + vertcat(x * cos(link.angle) + y * sin(link.angle), y * cos(link.angle) - x * sin(link.angle))

    @property
    def contact(self) -> SX:
        """The lowest point of the stance foot, shape (2,) [m]."""
        return self.place(self.stance, self.stance.tip) - vertcat(0, self.stance.foot_radius)

    @property
    def swing_foot(self) -> SX:
        """Coordinates of the swing foot, as those of the stance foot."""
        R = SX(self.swing.foot_radius)
        return self.place(self.swing, self.swing.tip) - vertcat(R * self.swing.angle, R)

    def bodies(self) -> tuple[Body, ...]:
        """The links that have inertia, and the rotors, which turn with the angles of their joints.

        Point masses have no angle, and those in one place are one body, as the halves of the mass at a hip.
        """
        bodies = list[Body]()
        for link in self.links:
            mass, inertia, place = SX(link.mass), SX(link.inertia), self.place(link, link.com)
            if not inertia.is_zero():
                bodies.append(Body(mass=link.mass, position=place, inertia=link.inertia, angle=link.angle))
            elif not mass.is_zero():
                points = (k for k, body in enumerate(bodies) if SX(body.inertia).is_zero())
                same = next((k for k in points if is_equal(place, bodies[k].position, SAME_DEPTH)), None)
                if same is None:
                    bodies.append(Body(mass=link.mass, position=place))
                else:
                    bodies[same] = replace(bodies[same], mass=bodies[same].mass + link.mass, position=place)
        geared = (link for link in self.links if link.joint and not SX(link.rotor_inertia).is_zero())
        return (
            *bodies,
            *(
                Body(mass=0.0, position=self.place(k, ORIGIN), inertia=k.rotor_inertia, angle=self.joints[k.joint])
                for k in geared
            ),
        )

    def partners(self) -> dict[str, str]:
        """For every link the one whose place it takes when the feet swap roles.

        The links on the way between the feet change places with those as far from the other foot. Limbs that are alike
        and hang on such links, as two arms on one torso, change places too. Any other link keeps its place.
        """
        way = [link.name for link, _, _ in self.way]
        partner = {link.name: link.name for link in self.links} | dict(zip(way, way[::-1], strict=True))
        limbs = [self._limb(link) for link in self.links if link.name not in way and link.parent is not None]
        for one, other in combinations(limbs, 2):
            apart = partner[one[0].name] == one[0].name and partner[other[0].name] == other[0].name
            if apart and partner[str(one[0].parent)] == other[0].parent and len(one) == len(other):
                pairs = list(zip(one, other, strict=True))
                if all(difference(a, b) is None for a, b in pairs):
                    partner |= {a.name: b.name for a, b in pairs} | {b.name: a.name for a, b in pairs}
        return partner

    def _limb(self, link: Link) -> list[Link]:
        """A link and all that it carries."""
        limb = [link]
        for carrier in limb:
            limb += [other for other in self.links if other.parent == carrier.name]
        return limb

    def lines(self) -> tuple[tuple[SX, ...], ...]:
        """Lines that draw the walker: from every joint to the tip of its link, and to the joints that it carries."""
        return tuple((self.place(link, ORIGIN), self.place(link, end)) for link, end in self._drawn())

    def sides(self) -> tuple[int | None, ...]:
        """The leg to which every line belongs: 0 the one that stands, 1 the one that swings, None neither."""
        way = [link.name for link, _, _ in self.way]
        legs = dict.fromkeys(way[: len(way) // 2], 0) | dict.fromkeys(way[-(len(way) // 2) :], 1)
        return tuple(legs.get(link.name) for link, _ in self._drawn())

    def _drawn(self) -> list[tuple[Link, Any]]:
        """Every link with each point of its frame to which it is drawn."""
        drawn = []
        for link in self.links:
            carried = [other.position for other in self.links if other.parent == link.name]
            ends = {str(_column(end)): end for end in (*carried, link.tip) if not _column(end).is_zero()}
            drawn += [(link, end) for end in ends.values()]
        return drawn


def tree_mechanism(walker: type[Walker], tree: Tree, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
    """The mechanism of a walker that defines its links alone.

    Gravity is ``p.gravity``, on a slope ``p.slope`` if there is one. Every actuator is the motor of the joint of its
    name; a class that refines this mechanism may add motors that act elsewhere. Legs of one link each land where their
    leans are opposite, as those of a compass; any other swing foot lands where it comes down to the ground. The walker
    is upright while the middle of the way between the feet is above the ground, and the link there has an angle below
    90 deg.

    Raises
    ------
    ProblemError
        If there is no gravity, an actuator is not a joint, or the angles of the links do not determine the shape.
    """
    name = walker.__name__
    if not hasattr(p, "gravity"):
        raise ProblemError(f"{name}: has links but no parameter gravity; define it, or define mechanism")
    lost = [actuator for actuator in walker.actuators if actuator not in tree.joints]
    if lost and walker.mechanism.__func__ is Walker.mechanism.__func__:  # type: ignore[attr-defined]
        words = f"{', '.join(lost)}, which is not a joint of its links ({', '.join(tree.joints) or 'none'})"
        raise ProblemError(f"{name}: actuators names {words}; define mechanism if it is another motor")
    shape = vertcat(*(getattr(q, coordinate) for coordinate in walker.shape))
    length = sum(norm_2(end - start) for link, start, end in tree.way) / 2
    middle, start, end = tree.way[len(tree.way) // 2]
    parts = [sumsqr(end - start) for _, start, end in tree.way if not (end - start).is_zero()]
    leg = sqrt(len(parts) * sum(parts)) / 2  # a single square would have a kink, |l|, which no proof covers
    high, tilt = tree.place(middle, start)[1] / leg, SX(1)
    if len(tree.way) % 2:
        high, tilt = (tree.place(middle, start)[1] + tree.place(middle, end)[1]) / (2 * leg), cos(middle.angle)
    swing_foot = tree.swing_foot
    (first, entry, leave), (last, enter, tip) = tree.way[0], tree.way[-1]
    meet = [link for link, start, end in tree.way[1:-1] if not (start - end).is_zero()]
    touchdown = -swing_foot[1] / length
    if len(tree.way) in (2, 3) and not meet:
        touchdown = first.angle + _lean(entry, leave) + last.angle + _lean(tip, enter)
    damped = [link for link in tree.links if link.joint and not SX(link.damping).is_zero()]
    return Mechanism(
        bodies=tree.bodies(),
        gravity=inclined(p.gravity, getattr(p, "slope", 0.0)),
        swing_foot=swing_foot,
        touchdown=touchdown,
        upright=high * tilt,
        relabel=_relabelled(walker, tree, shape, p),
        motors=tuple(tree.joints[actuator] for actuator in walker.actuators if actuator not in lost),
        dampers=tuple(Damper(coefficient=link.damping, across=tree.joints[link.joint]) for link in damped),
    )


def _relabelled(walker: type[Walker], tree: Tree, shape: SX, p: SimpleNamespace) -> SX:
    """The shape after the feet have swapped roles: every link then has the angle that its partner had."""
    partner, links, symbols = tree.partners(), tree.links, shape
    angles = {link.name: SX(link.angle) for link in links}
    if not shape.is_valid_input():  # the coordinates are expressions of others
        named = {name: SX.sym(name) for name in (*walker.shape, "x", "y")}
        links, symbols = walker.links(SimpleNamespace(**named), p), vertcat(*(named[name] for name in walker.shape))
    of_symbols = {link.name: SX(link.angle) for link in links}
    slope = jacobian(vertcat(*of_symbols.values()), symbols)
    if not slope.is_constant():
        raise ProblemError(f"{walker.__name__}: the angles of its links must be sums of shape coordinates")
    rows, ways = list[int](), np.asarray(DM(slope))
    order = [link.name for link, _, _ in tree.way]
    order += [name for name in angles if name not in order]
    for row in map([*angles].index, order):
        if np.linalg.matrix_rank(ways[[*rows, row]]) > len(rows):
            rows.append(row)
    if len(rows) < len(walker.shape):
        words = f"the angles of its links do not determine {', '.join(walker.shape)}"
        raise ProblemError(f"{walker.__name__}: {words}; define mechanism")
    chosen = [[*angles][row] for row in rows]
    constant = substitute(vertcat(*(of_symbols[name] for name in chosen)), symbols, SX.zeros(symbols.numel()))
    taken = vertcat(*(angles[partner[name]] for name in chosen)) - constant
    return DM(np.linalg.inv(ways[rows])) @ taken


def _lean(foot: SX, hip: SX) -> SX:
    """Angle of the line from a foot to a hip in the frame of a leg, from the frame's y towards its x [rad].

    A leg along the frame's y hangs down at angle zero.
    """
    aside, up = hip[0] - foot[0], hip[1] - foot[1]
    return SX(0) if aside.is_zero() and not up.is_constant() else atan2(aside, up)


def _joint(link: Link, other: Link) -> tuple[SX, SX]:
    """The joint of two neighbours in the frame of each."""
    if other.parent == link.name:
        return _column(other.position), SX.zeros(2)
    return SX.zeros(2), _column(link.position)


def _column(value: Any) -> SX:
    """A number or a point as a column."""
    return vertcat(*map(SX, value)) if isinstance(value, tuple | list) else SX(value)
