"""Links: a walker as a planar tree of rigid bodies, from which its mechanism, joints and drawing follow.

A link's frame turns with the link. At angle zero its axes are those of the ground, x downhill and y along the normal;
a positive angle turns y towards x, as for a leg. A point r of a frame with angle a is at

    origin + (r_x cos a + r_y sin a,  r_y cos a - r_x sin a)

Positions are summed along the tree from the stance foot, so that they contain no terms that would cancel.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, combinations, pairwise
from types import SimpleNamespace
from typing import Any, ClassVar, Protocol

import numpy as np
from casadi import DM, SX, atan2, cos, densify, is_equal, jacobian, norm_2, sin, sqrt, substitute, sumsqr, vertcat

from gaitopt.errors import ProblemError
from gaitopt.model.foreign import KINDS, NAME_WORDS, Reader, calling, doubles, is_finite, is_list, is_name, shown
from gaitopt.model.mechanism import ORIGIN, Body, Damper, Link, Mechanism, inclined

SAME = 1e-9
"""Two legs are alike if their numbers differ by no more than this, relative to their size; files have fewer digits."""
COMPARISON_DEPTH = 10
"""Depth to which CasADi compares the expression trees of positions and angles."""
COMPARED = ("mass", "inertia", "position", "com", "tip", "rotor_inertia", "damping", "foot_radius")
"""Attributes in which corresponding links of two limbs agree if the limbs are alike."""


def difference(one: Link, other: Link) -> str | None:
    """The first attribute of ``COMPARED`` in which two links differ; None if they are alike."""
    for name in COMPARED:
        a, b = (_column(getattr(link, name)) for link in (one, other))
        gap = densify(a - b)
        size = np.abs(np.asarray(DM(a))).max() if a.is_constant() else 1.0
        if not gap.is_constant() or np.abs(np.asarray(DM(gap))).max() > SAME * max(1.0, size):
            return name
    return None


class Jointed(Protocol):
    """A class of walkers with links."""

    shape: ClassVar[tuple[str, ...]]
    actuators: ClassVar[tuple[str, ...]]

    @classmethod
    def links(cls, q: SimpleNamespace, p: SimpleNamespace) -> tuple[Link, ...]:
        """See ``Walker.links``."""


class Tree:
    """The links of a walker, placed on its stance foot.

    Parameters
    ----------
    links : the links, checked by ``state_tree``.
    foot : SX, shape (2,) - coordinates (x, y) of the stance foot; the centre of a round one is at x + R angle, y + R.

    Attributes
    ----------
    path : the links from the stance foot to the swing foot, each with the two points of its frame at which the path
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
        self._entry = {self.stance.name: (_column(self.stance.tip), centre)}  # a point of each frame, and its position
        before: dict[str, Link] = {}
        visited = [self.stance]
        for link in visited:
            for other in links:
                if other.name not in self._entry and (other.parent == link.name or link.parent == other.name):
                    here, there = _joint(link, other)
                    if is_equal(SX(link.angle), SX(other.angle), COMPARISON_DEPTH):  # fixed: points of one frame
                        entry, position = self._entry[link.name]
                        self._entry[other.name] = entry + there - here, position
                    else:
                        self._entry[other.name] = there, self.position(link, here)
                    before[other.name] = link
                    visited.append(other)
        path = [self.swing]
        while path[0].name in before:
            path.insert(0, before[path[0].name])
        starts = [_column(self.stance.tip), *(_joint(one, other)[1] for one, other in pairwise(path))]
        ends = [*(_joint(one, other)[0] for one, other in pairwise(path)), _column(self.swing.tip)]
        self.path = list(zip(path, starts, ends, strict=True))

    def position(self, link: Link, point: Any) -> SX:
        """Position of a point that is given in a link's frame, shape (2,) [m]."""
        entry, position = self._entry[link.name]
        x, y = (_column(point) - entry)[0], (_column(point) - entry)[1]
        return position + vertcat(x * cos(link.angle) + y * sin(link.angle), y * cos(link.angle) - x * sin(link.angle))

    @property
    def contact(self) -> SX:
        """The lowest point of the stance foot, shape (2,) [m]."""
        return self.position(self.stance, self.stance.tip) - vertcat(0, self.stance.foot_radius)

    @property
    def swing_foot(self) -> SX:
        """Coordinates of the swing foot, defined like those of the stance foot."""
        R = SX(self.swing.foot_radius)
        return self.position(self.swing, self.swing.tip) - vertcat(R * self.swing.angle, R)

    def bodies(self) -> tuple[Body, ...]:
        """The links that have inertia, and the rotors, which turn with the angles of their joints.

        Point masses have no angle. Those at one position, such as the two halves of the mass at a hip, are one body.
        """
        bodies = list[Body]()
        for link in self.links:
            mass, inertia, com = SX(link.mass), SX(link.inertia), self.position(link, link.com)
            if not inertia.is_zero():
                bodies.append(Body(mass=link.mass, position=com, inertia=link.inertia, angle=link.angle))
            elif not mass.is_zero():
                points = (k for k, body in enumerate(bodies) if SX(body.inertia).is_zero())
                same = next((k for k in points if is_equal(com, bodies[k].position, COMPARISON_DEPTH)), None)
                if same is None:
                    bodies.append(Body(mass=link.mass, position=com))
                else:
                    bodies[same] = replace(bodies[same], mass=bodies[same].mass + link.mass, position=com)
        geared = (link for link in self.links if link.joint and not SX(link.rotor_inertia).is_zero())
        return (
            *bodies,
            *(
                Body(mass=0.0, position=self.position(k, ORIGIN), inertia=k.rotor_inertia, angle=self.joints[k.joint])
                for k in geared
            ),
        )

    def partners(self) -> dict[str, str]:
        """For every link the one whose role it takes when the feet swap roles, by name.

        A link on the path between the feet swaps with the link that is as many links away from the other foot. Limbs
        that are alike and hang on such links, as two arms on one torso, swap as well. Any other link keeps its role.
        """
        path = [link.name for link, _, _ in self.path]
        partner = {link.name: link.name for link in self.links} | dict(zip(path, path[::-1], strict=True))
        limbs = [self._limb(link) for link in self.links if link.name not in path and link.parent is not None]
        for one, other in combinations(limbs, 2):
            apart = partner[one[0].name] == one[0].name and partner[other[0].name] == other[0].name
            if apart and partner[str(one[0].parent)] == other[0].parent and len(one) == len(other):
                pairs = list(zip(one, other, strict=True))
                if all(difference(a, b) is None for a, b in pairs):
                    partner |= {a.name: b.name for a, b in pairs} | {b.name: a.name for a, b in pairs}
        return partner

    def _limb(self, link: Link) -> list[Link]:
        """A link and all links that it carries."""
        limb = [link]
        for carrier in limb:
            limb += [other for other in self.links if other.parent == carrier.name]
        return limb

    def lines(self) -> tuple[tuple[SX, ...], ...]:
        """Lines that draw the walker: from every joint to the tip of its link, and to the joints that it carries."""
        return tuple((self.position(link, ORIGIN), self.position(link, end)) for link, end in self._drawn())

    def sides(self) -> tuple[int | None, ...]:
        """The leg to which every line belongs: 0 for the stance leg, 1 for the swing leg, None for neither."""
        path = [link.name for link, _, _ in self.path]
        legs = dict.fromkeys(path[: len(path) // 2], 0) | dict.fromkeys(path[-(len(path) // 2) :], 1)
        return tuple(legs.get(link.name) for link, _ in self._drawn())

    def _drawn(self) -> list[tuple[Link, Any]]:
        """Every link with each point of its frame to which it is drawn."""
        drawn = []
        for link in self.links:
            carried = [other.position for other in self.links if other.parent == link.name]
            ends = {str(_column(end)): end for end in (*carried, link.tip) if not _column(end).is_zero()}
            drawn += [(link, end) for end in ends.values()]
        return drawn


def state_tree(walker: type[Jointed], q: SimpleNamespace, p: SimpleNamespace) -> Tree:
    """The tree of ``Walker.links``, with all entries checked; ``q`` and ``p`` are coordinates and parameters by name.

    Raises
    ------
    ProblemError
        If the method raises, an entry has the wrong type or shape or depends on a forbidden argument, or the links are
        not a tree with two feet.
    """
    with calling(walker, "links"):
        stated = walker.links(q, p)
    if not is_list(stated, Link):
        raise ProblemError(f"{walker.__name__}: links returns {shown(stated)}, but must return a tuple of Link(...)")
    with calling(walker, "reading its links"):
        reason = next(chain(_link_faults(stated), _tree_faults(stated)), None)
    if reason is not None:
        raise ProblemError(f"{walker.__name__}: {reason}")
    read, links = Reader(walker, q, p), []
    for link in stated:
        of = f"of the link {link.name}"
        points: dict[str, Any] = {
            name: read.vector(f"{name} {of}", _point(getattr(link, name)), 2, "parameters")
            for name in ("position", "tip", "com")
        }
        numbers: dict[str, Any] = {
            name: read.scalar(f"{name} {of}", getattr(link, name), "parameters")
            for name in ("foot_radius", "mass", "inertia", "rotor_inertia", "damping")
        }
        angle = read.scalar(f"angle {of}", link.angle, "shape")
        links.append(replace(link, angle=angle, **points, **numbers))
    return Tree(tuple(links), vertcat(q.x, q.y))


def tree_mechanism(walker: type[Jointed], tree: Tree, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
    """The mechanism of a walker that defines only its links.

    Gravity is ``p.gravity``, on a slope ``p.slope`` if there is one. Every actuator is the motor of the joint with its
    name; a class that refines this mechanism may add motors that act elsewhere. If each leg is one link, the swing foot
    lands when the leans of the legs are opposite, as for a compass; otherwise it lands when its height falls to zero.
    The walker is upright while the middle of the path between the feet is above the ground, and the link there has an
    angle below 90 deg.

    Raises
    ------
    ProblemError
        If there is no gravity, or the angles of the links do not determine the shape.
    """
    name = walker.__name__
    if not hasattr(p, "gravity"):
        raise ProblemError(f"{name}: has links but no parameter gravity; define it, or define mechanism")
    shape = vertcat(*(getattr(q, coordinate) for coordinate in walker.shape))
    length = sum(norm_2(end - start) for link, start, end in tree.path) / 2
    middle, start, end = tree.path[len(tree.path) // 2]
    squares = [sumsqr(end - start) for _, start, end in tree.path if not (end - start).is_zero()]
    leg = sqrt(len(squares) * sum(squares)) / 2  # the root of a single square, |l|, has a kink, which no proof covers
    high, tilt = tree.position(middle, start)[1] / leg, SX(1)
    if len(tree.path) % 2:
        high, tilt = (tree.position(middle, start)[1] + tree.position(middle, end)[1]) / (2 * leg), cos(middle.angle)
    swing_foot = tree.swing_foot
    (first, entry, leave), (last, enter, tip) = tree.path[0], tree.path[-1]
    between = [link for link, start, end in tree.path[1:-1] if not (start - end).is_zero()]
    touchdown = -swing_foot[1] / length
    if len(tree.path) in (2, 3) and not between:
        touchdown = first.angle + _lean(entry, leave) + last.angle + _lean(tip, enter)
    damped = [link for link in tree.links if link.joint and not SX(link.damping).is_zero()]
    return Mechanism(
        bodies=tree.bodies(),
        gravity=inclined(p.gravity, getattr(p, "slope", 0.0)),
        swing_foot=swing_foot,
        touchdown=touchdown,
        upright=high * tilt,
        relabel=_relabelled(walker, tree, shape, p),
        motors=tuple(tree.joints[actuator] for actuator in walker.actuators if actuator in tree.joints),
        dampers=tuple(Damper(coefficient=link.damping, across=tree.joints[link.joint]) for link in damped),
    )


def _relabelled(walker: type[Jointed], tree: Tree, shape: SX, p: SimpleNamespace) -> SX:
    """The shape after the feet have swapped roles: every link then has the angle that its partner had."""
    partner, links, symbols = tree.partners(), tree.links, shape
    angles = {link.name: SX(link.angle) for link in links}
    if not shape.is_valid_input():  # the coordinates are expressions, not symbols
        named = {name: SX.sym(name) for name in (*walker.shape, "x", "y")}
        links, symbols = walker.links(SimpleNamespace(**named), p), vertcat(*(named[name] for name in walker.shape))
    of_symbols = {link.name: SX(link.angle) for link in links}
    slope = jacobian(vertcat(*of_symbols.values()), symbols)
    if not slope.is_constant():
        raise ProblemError(f"{walker.__name__}: the angles of its links must be sums of shape coordinates")
    rows, directions = list[int](), np.asarray(DM(slope))
    order = [link.name for link, _, _ in tree.path]
    order += [name for name in angles if name not in order]
    for row in map([*angles].index, order):
        if np.linalg.matrix_rank(directions[[*rows, row]]) > len(rows):
            rows.append(row)
    if len(rows) < len(walker.shape):
        undetermined = ", ".join(walker.shape)
        raise ProblemError(
            f"{walker.__name__}: the angles of its links do not determine {undetermined}; define mechanism"
        )
    chosen = [[*angles][row] for row in rows]
    constant = substitute(vertcat(*(of_symbols[name] for name in chosen)), symbols, SX.zeros(symbols.numel()))
    taken = vertcat(*(angles[partner[name]] for name in chosen)) - constant
    return DM(np.linalg.inv(directions[rows])) @ taken


def _point(value: Any) -> Any:
    """A point as a column if it is given as two numbers; any other value is not changed."""
    numbers = isinstance(value, tuple | list) and len(value) == 2 and all(isinstance(entry, KINDS) for entry in value)
    return vertcat(*value) if numbers else value


def _link_faults(links: Iterable[Link]) -> Iterator[str]:
    """Messages about names and numbers of single links."""
    for link in links:
        for what, value in (("name", link.name), ("joint", link.joint or "fixed")):
            if not is_name(value):
                yield f"links has the {what} {shown(value)}, but must have {NAME_WORDS}"
        if link.sign not in (-1, 1):
            yield f"sign of the link {link.name} is {shown(link.sign)}, but must be 1 or -1"
        if not is_finite(link.zero):
            yield f"zero of the link {link.name} is {shown(link.zero)}, but must be a number"
        span: Any = (-1.0, 1.0) if link.range is None else link.range
        if not (is_list(span, int | float) and len(span) == 2 and all(map(is_finite, span)) and span[0] < span[1]):
            pair = "(smallest, largest) angle in rad"
            yield f"range of the link {link.name} is {shown(link.range)}, but must be the {pair} of its joint"
        if link.effort is not None and not (is_finite(link.effort) and link.effort >= 0):
            yield f"effort of the link {link.name} is {shown(link.effort)}, but must be a torque that is not negative"


def _tree_faults(links: Sequence[Link]) -> Iterator[str]:
    """Messages about names of links that exclude each other, and about links that do not form a tree."""
    names, joints = tuple(link.name for link in links), tuple(link.joint for link in links if link.joint)
    if doubles(names) or doubles(joints):
        yield f"links names {doubles(names) or doubles(joints)} twice"
    if set(names) & set(joints):
        yield f"{', '.join(sorted(set(names) & set(joints)))} is the name of a link and of a joint: rename one"
    roots = [link.name for link in links if link.parent is None]
    if len(roots) != 1:
        yield f"links has the roots {', '.join(roots) or 'none'}, but must be one tree: one link has no parent"
    for link in links:
        if link.parent is not None and link.parent not in names:
            yield f"the link {link.name} has the parent {shown(link.parent)}, which is not a link"
        if link.parent is None and link.joint:
            yield f"the link {link.name} has the joint {link.joint}, but no parent: state it, or leave out joint"
    parents = {link.name: link.parent for link in links}
    for name in names:
        carriers: list[str | None] = [name]
        while carriers[-1] is not None and len(carriers) <= len(names):
            carriers.append(parents[carriers[-1]])
        if carriers[-1] is not None:
            yield f"the link {name} is its own ancestor: links must form a tree"
    feet = [link.name for link in links if link.foot]
    if len(feet) != 2:
        yield f"links has the feet {', '.join(feet) or 'none'}, but must have two: the one that stands, then the other"


def _lean(foot: SX, hip: SX) -> SX:
    """Angle of the line from a foot to a hip in the frame of a leg [rad]: zero along y, positive towards x."""
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
