"""A walker as a planar tree of rigid bodies in numbers, and the gait that a physics engine has to reproduce.

The coordinates of an engine are the position (x, z) of the root body's origin, its angle, and for every joint the angle
of its body minus that of the parent. If the bodies of a walker do not turn, the coordinates are the positions (x, z) of
all origins, of a child from that of its parent. Angles turn about y, from z towards x; at zero all frames have the axes
of the ground. Bodies keep their names: when the feet of the gait swap roles, every body takes the role of its partner.

The torques of the control law act on the absolute angles a of the bodies, with a = A shape + c:

    A' tau = E u

The bodies and contacts of a walker that declares no links form a tree if they can be divided into rigid links that are
joined at hinges, each of which is a point of both links, or into bodies that do not turn. Points belong to one link if
their distances do not depend on the posture. If the feet swap roles, the partner of a point is the one that takes its
place in the relabelled posture, and the root is a link that meets its partner in a hinge.

The swing foot of a gait may pass through the ground (scuff), which the gait's guard ignores. The contacts that end a
step by landing are therefore off between two times of the step: when the lowest of them is highest before it scuffs,
and when it is highest afterwards.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from casadi import DM, SX, Function, atan2, horzcat, jacobian, jtimes, substitute, vertcat, vertsplit
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.building import building
from gaitopt.errors import ProblemError
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait
from gaitopt.gait.measures import observe
from gaitopt.gait.trajectory import Arc, swap_indices
from gaitopt.model.buffered import buffered
from gaitopt.model.declaration import has_links, named_arguments, state_mechanism
from gaitopt.model.friction import ImpactLaw
from gaitopt.model.links import state_tree
from gaitopt.model.mechanism import ORIGIN, Link
from gaitopt.model.modes import FOOT, Mode
from gaitopt.model.section import CLOCK, TOUCHDOWN

POINT_RADIUS = 1e-6
"""Radius of the sphere that replaces a point foot [m]: one of 0.1 mm rolls by 17 micrometres per second."""
SAMPLES_PER_ARC = 200
"""Number of heights of the swing foot on every arc, from which scuffing is detected."""
SPREAD, RIGID = 0.1, 1e-9
"""Random changes of the posture [rad, m] at which distances of points are compared, and their relative differences
within a rigid link."""
TURN_DIGITS = 12
"""Decimals to which the turn of the bodies is rounded where the feet swap roles; the rest is rounding error."""
STEP_END = 0.03
"""Fraction of a step at each end in which the swing foot is close to the ground without scuffing."""


class Body(NamedTuple):
    """A rigid body: ``parent`` is an index, -1 for the root; points are in frames, (x, z) [m]."""

    name: str
    parent: int
    position: tuple[float, float]
    mass: float
    com: tuple[float, float]
    inertia: float
    rotor: float


class Foot(NamedTuple):
    """A foot: the body, its tip (the centre of a round foot), radius [m], and share of the coefficient of friction."""

    body: int
    tip: tuple[float, float]
    radius: float
    share: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Tree:
    """Bodies with parents first, the two feet with the stance foot first, or all contacts, and gravity (x, z).

    Attributes
    ----------
    slides : whether no body turns.
    bases : body of the gait's point (x, y), and its position on it, in the first step and in the second one, if the
        walker has named contacts.
    """

    bodies: tuple[Body, ...]
    feet: tuple[Foot, ...]
    gravity: tuple[float, float]
    slides: bool = False
    bases: tuple[tuple[int, tuple[float, float]], ...] = ()

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return 2 * len(self.bodies) if self.slides else 2 + len(self.bodies)

    @property
    def mass(self) -> float:
        """Total mass [kg]."""
        return sum(body.mass for body in self.bodies)

    def angles(self, q: Array) -> Array:
        """Absolute angles of the bodies from the coordinates, or rates from rates; shape (n,)."""
        angles = np.zeros(len(self.bodies))
        for k, body in enumerate(() if self.slides else self.bodies):
            angles[k] = q[2 + k] + (angles[body.parent] if body.parent >= 0 else 0.0)
        return angles

    def relative(self, angles: Array) -> Array:
        """The angles of the root and of the joints, from absolute angles; shape (n,)."""
        return np.array(
            [a - (angles[b.parent] if b.parent >= 0 else 0.0) for a, b in zip(angles, self.bodies, strict=True)]
        )

    def point(self, body: int, within: tuple[float, float], q: Array, v: Array) -> tuple[Array, Array]:
        """Position and velocity of a point of a body, shape (2,) each."""
        a, rates, position, velocity = self.angles(q), self.angles(v), np.array(q[:2]), np.array(v[:2])
        while True:
            x, z = within
            sine, cosine = np.sin(a[body]), np.cos(a[body])
            position = position + np.array([x * cosine + z * sine, z * cosine - x * sine])
            velocity = velocity + rates[body] * np.array([z * cosine - x * sine, -x * cosine - z * sine])
            if self.bodies[body].parent < 0:
                return position, velocity
            within = self.bodies[body].position
            if self.slides:
                within = within[0] + q[2 * body], within[1] + q[2 * body + 1]
                velocity = velocity + v[2 * body : 2 * body + 2]
            body = self.bodies[body].parent

    def foot(self, foot: int, q: Array, v: Array) -> tuple[Array, Array]:
        """The gait's coordinates (x, y) of a foot and their rates: those of its tip, without the path that it rolls."""
        body, tip, R, _ = self.feet[foot]
        position, velocity = self.point(body, tip, q, v)
        return position - (R * self.angles(q)[body], R), velocity - (R * self.angles(v)[body], 0)

    def energy(self, q: Array, v: Array) -> float:
        """Kinetic and potential energy [J]."""
        total = 0.0
        rates = self.angles(v)
        for k, body in enumerate(self.bodies):
            position, velocity = self.point(k, body.com, q, v)
            total += body.mass * (velocity @ velocity / 2 - np.dot(self.gravity, position))
            total += body.inertia * rates[k] ** 2 / 2 + (body.rotor * v[2 + k] ** 2 / 2 if body.rotor else 0.0)
        return float(total)

    def generalised(self, torques: Array) -> Array:
        """Forces on the coordinates from torques on the absolute angles, or forces on slides, shape (n + 2,)."""
        if self.slides:
            return np.concatenate([np.zeros(2), torques])
        total = np.array(torques, dtype=float)
        for k in reversed(range(len(self.bodies))):
            if self.bodies[k].parent >= 0:
                total[self.bodies[k].parent] += total[k]
        return np.concatenate([np.zeros(2), total])


class Reference:
    """A gait in the terms of an engine: its motion in the engine's coordinates, its torques and its contacts.

    Parameters
    ----------
    gait : a converged gait whose walker is a tree of links.

    Attributes
    ----------
    tree : the bodies of the walker.
    contacts : names of the contacts; empty for a walker that stands on one foot at a time.
    clock : whether the cycle ends with the clock of the control law rather than with a landing.
    friction : largest coefficient of friction of a foot.
    starts : times of the impacts [s], from 0 to the period.
    length, time : natural units [m, s].
    turn : angle by which all bodies turn when the feet swap roles, as for a wheel; 0 for other walkers [rad].
    windows : for each step, the first and last time since its impact at which the swing foot may scuff [s].

    Raises
    ------
    ProblemError
        If the adapters cannot model the walker or its friction; the message says why.
    """

    def __init__(self, gait: Gait) -> None:
        _refuse(gait)
        self.gait, self.system = gait, gait.system
        self.contacts = self.system.walker.contacts
        self.clock = gait.problem.cycle_end == CLOCK
        tree = _tree if has_links(self.system.walker) else _tree_of_points
        self.tree, self._poses, slopes, self._offset, self._partners = tree(gait)
        self._inverse = np.linalg.pinv(slopes)
        self._effort, self._springs = _forces(gait)
        self._idle = not self.system.walker.actuators or self.system.control.type == "none"
        self.friction = largest_friction(gait)
        self.length, self.time = gait.dynamics.scales.length, gait.dynamics.scales.time
        self.starts = np.cumsum([0.0, *(step.period for step in gait.steps)])
        self._distances = np.cumsum([0.0, *(step.final_impact.step_length for step in gait.steps)])
        self.windows = [(0.0, 0.0) if self.clock else _window(step.arcs) for step in gait.steps]
        self.turn = 0.0
        ends = (self.coordinates(t)[0] for t in (np.nextafter(self.starts[1], 0.0), self.starts[1]))
        before, after = map(self.tree.angles, ends)
        self.turn = float(np.round(before - after, TURN_DIGITS)[0])

    def contact(self, step: int, foot: int) -> str:
        """The contact of the gait whose role a foot of the tree has in a step."""
        walker, swapped = self.system.walker, step % 2 and not self.clock
        name = walker.landing_points()[foot]
        return walker.partners().get(name, name) if swapped else name

    def lands(self, step: int) -> list[int]:
        """Indices of the feet of the tree whose landing ends a step."""
        ends = self.system.walker.step_ends()
        return [foot for foot in range(len(self.tree.feet)) if self.contact(step, foot) in ends]

    def stance(self, step: int) -> int:
        """Index of the stance foot in a step, or of the first named contact."""
        first = self.system.walker.landing_points()[0]
        return next(foot for foot in range(len(self.tree.feet)) if self.contact(step, foot) == first)

    def standing(self, step: int) -> tuple[int, ...]:
        """Indices of the feet that are compared in a step: the stance foot, or all contacts."""
        return tuple(range(len(self.contacts))) or (self.stance(step),)

    def sticks(self, arc: Arc, step: int, foot: int) -> bool:
        """Whether a foot sticks in an arc of the gait."""
        return bool(arc.mode.contacts[self.contact(step, foot)] == Mode.STICK)

    def step_at(self, t: float) -> tuple[int, float]:
        """Number of the step at a time since the start, and time since its impact; the cycle continues by one step."""
        step = min(int(np.searchsorted(self.starts, t, side="right")) - 1, len(self.gait.steps))
        return step, t - float(self.starts[step])

    def arc(self, step: int, local: float) -> Arc:
        """The gait's arc at a time since the impact before a step."""
        arcs = self.gait.steps[step % len(self.gait.steps)].arcs
        return next((arc for arc in arcs if local < arc.end), arcs[-1])

    def state(self, t: float) -> Array:
        """The gait's state (n_z,) at a time since the start; x counts from where the stance foot landed."""
        step, local = self.step_at(t)
        arc = self.arc(step, local)
        s = 2 * (local - arc.start) / arc.duration - 1
        return np.asarray(chebyshev.chebval(s, curves.coefficients(arc.states)), dtype=float)

    def slip_speed(self, step: int, local: Array, foot: int) -> tuple[Array, NDArray[np.bool_]]:
        """Speed [m/s] of the gait's contact and whether it is closed, at times in a step, shape (m,)."""
        speed, closed, name = np.zeros(local.size), np.zeros(local.size, dtype=bool), self.contact(step, foot)
        arcs = self.gait.steps[step % len(self.gait.steps)].arcs
        for arc in arcs:
            inside = (local >= arc.start) & ((local < arc.end) | (arc is arcs[-1]))
            s = 2 * (local[inside] - arc.start) / arc.duration - 1
            values = observe(arc).slip[:, [self.contacts.index(name)]] if self.contacts else arc.states[:, -1:]
            speed[inside] = chebyshev.chebval(s, curves.coefficients(values)[:, 0])
            closed[inside] = name in arc.mode.touching
        return speed, closed

    def force(self, t: float) -> Array:
        """Force (f_t, f_n) of the ground on the gait's foot that has landed, at a time since the start [N]."""
        step, local = self.step_at(t)
        arc, walker = self.arc(step, local), self.system.walker
        observed = buffered(self.system.observation(arc.mode))
        forces = observed(local, self.state(t), arc.dynamics.p, self.system.data(arc.segment))[0]
        return self._of_landed(forces, {walker.partners().get(name, name) for name in walker.step_ends()})

    @property
    def landing_impulse(self) -> Array:
        """Impulse (F_t, F_n) of the ground on the foot that lands at the end of the gait [N s]."""
        return self._of_landed(self.gait.steps[-1].final_impact.impulse, {*self.system.walker.step_ends()})

    def _of_landed(self, values: Array, landed: set[str]) -> Array:
        """The sum over the contacts of the foot that lands; a stance foot without a name is the only one."""
        pairs = np.reshape(values, (-1, 2))[: len(self.contacts) or 1]
        total: Array = pairs[[name in landed for name in self.contacts] or [True]].sum(axis=0)
        return total

    def coordinates(self, t: float) -> tuple[Array, Array]:
        """Coordinates and rates of an engine, shape (n + 2,) each, at a time since the start."""
        (step, _), number = self.step_at(t), len(self.gait.steps)
        p = self.gait.steps[step % number].arcs[0].dynamics.p[: len(self.system.walker.model_fields)]
        angles, rates, origins, velocities = buffered(self._poses)(self.state(t), p)
        shift = self._distances[step % number] + (self._distances[-1] if step >= number else 0.0)
        if self.tree.slides:
            origins[0] += shift
            return np.concatenate([origins[:2], angles]), np.concatenate([velocities[:2], rates])
        angles, roles = angles + step * self.turn, self._roles(step)
        position, velocity = (values.reshape(-1, 2)[roles[0]] for values in (origins, velocities))
        return (
            np.concatenate([position + np.array([shift, 0.0]), self.tree.relative(angles[roles])]),
            np.concatenate([velocity, self.tree.relative(rates[roles])]),
        )

    def torques(self, step: int, local: float, q: Array, v: Array) -> Array:
        """Forces of control law, springs and dampers on the coordinates of an engine, shape (n + 2,).

        Parameters
        ----------
        step, local : number of the step, and time since its impact in the engine [s].
        """
        arc = self.arc(step, local)
        if self._idle and self._springs is None:
            return np.zeros(q.size)
        roles, z, forces = self._roles(step), self.shape_state(step, q, v), np.zeros(self._effort.shape[0])
        if not self._idle:
            segment = int(np.searchsorted(self.system.control.breakpoints, local, side="right"))
            (u,) = buffered(self.system.torques(arc.mode))(local, z, arc.dynamics.p, self.system.data(segment))
            forces = forces + self._effort @ u
        if self._springs is not None:
            forces = forces - buffered(self._springs)(z, arc.dynamics.p)[1]
        torques = self._inverse.T @ forces
        if not self.tree.slides:
            torques[roles] = torques.copy()
        return self.tree.generalised(torques)

    def shape_state(self, step: int, q: Array, v: Array) -> Array:
        """The gait's state (n_z,) for the coordinates of an engine in a step."""
        roles = self._roles(step)
        angles, speeds = (
            (q[2:], v[2:]) if self.tree.slides else (self.tree.angles(q)[roles], self.tree.angles(v)[roles])
        )
        shape = self._inverse @ (angles - step * self.turn - self._offset)
        rates = self._inverse @ speeds
        if self.contacts:
            bases = self.tree.bases
            position, velocity = self.tree.point(*bases[step % len(bases)], q, v)
            return np.concatenate([shape, position[::-1], rates, velocity[::-1]])
        position, velocity = self.tree.foot(self.stance(step), q, v)
        return np.concatenate([shape, position[:1], rates, velocity[:1]])

    def energy(self, step: int, q: Array, v: Array) -> float:
        """Kinetic and potential energy in an engine, including that of springs [J]."""
        total = self.tree.energy(q, v)
        if self._springs is not None:
            p = self.arc(step, 0.0).dynamics.p
            total += float(buffered(self._springs)(self.shape_state(step, q, v), p)[0][0])
        return total

    def touching(self, step: int, local: float) -> tuple[bool, ...]:
        """Whether the contacts of the feet are on, at a time since the impact before a step in the engine."""
        (first, last), swing = self.windows[step % len(self.windows)], self.lands(step)
        start = {*self.gait.steps[0].arcs[0].mode.touching}

        def is_on(foot: int) -> bool:
            stands = foot not in swing or local >= last
            return stands or (local < first and (step > 0 or self.contact(step, foot) in start))

        return tuple(map(is_on, range(len(self.tree.feet))))

    def _roles(self, step: int) -> Any:
        """For each body of the gait, the body of the tree that has its role in a step."""
        return self._partners if step % 2 and not self.clock else np.arange(len(self.tree.bodies))


def _refuse(gait: Gait) -> None:
    """Refuse a gait that the adapters cannot model; the error names the reason."""
    walker, name, end = gait.system.walker, gait.problem.name, gait.problem.cycle_end
    present = [feature for feature in walker.features() if feature != "several contacts"]
    present += [] if end == CLOCK or gait.system.control.restarts else ["a control law whose clock does not restart"]
    present += [] if end == TOUCHDOWN or (end == CLOCK and walker.contacts) else ["a cycle that ends without a landing"]
    slips = any(step.final_impact.mode.slips for step in gait.steps)
    if present:
        raise ProblemError(f"{name}: {walker.model} has {' and '.join(present)}; the engines cannot model that")
    if gait.system.friction.may_drop and _drops(gait):
        raise ProblemError(f"{name}: static friction above kinetic friction; the engines have one coefficient")
    if any(float(viscous) for _, _, viscous in gait.system.contact_coefficients(gait.dynamics.p).values()):
        raise ProblemError(f"{name}: viscous drag of the ground; the engines only have dry friction")
    if slips and gait.system.law is not ImpactLaw.COULOMB:
        raise ProblemError(f"{name}: a slipping impact without friction; impacts of the engines have friction")


@building
def _tree(gait: Gait) -> tuple[Tree, Function, Array, Array, NDArray[np.intp]]:
    """The tree; (z, p) -> angles, rates, origins and their velocities; a = A shape + c; partners of the bodies."""
    walker = type(gait.problem.walker)
    p = gait.dynamics.p[: len(walker.model_fields)]
    names = (*walker.shape, "x", "y")
    q, dq = SX.sym("q", len(names)), SX.sym("dq", len(names))
    fields = SX.sym("p", len(walker.model_fields))
    named = named_arguments(walker, q, fields)
    links, gravity = state_tree(walker, *named), state_mechanism(walker, *named).gravity
    by_name = {link.name: link for link in links.links}

    def number(value: Any) -> Array:
        return np.asarray(
            Function("number", [fields], [vertcat(*value) if isinstance(value, tuple) else SX(value)])(p)
        ).ravel()

    def carrier(link: Link) -> Link:
        while link.parent is not None and not link.joint:
            link = by_name[link.parent]
        return link

    moving = list[Link]()
    waiting = [link for link in links.links if carrier(link) is link]
    while waiting:
        link = waiting.pop(0)
        ready = link.parent is None or carrier(by_name[link.parent]) in moving
        (moving if ready else waiting).append(link)
    order = {link.name: k for k, link in enumerate(moving)}

    def within(link: Link, point: Any) -> Array:
        """A point of a link in the frame of the body that carries it."""
        position = number(point)
        while link.name not in order:
            turn = number(link.angle - by_name[str(link.parent)].angle)[0]
            c, s = np.cos(turn), np.sin(turn)
            turned = np.array([position[0] * c + position[1] * s, position[1] * c - position[0] * s])
            position = number(link.position) + turned
            link = by_name[str(link.parent)]
        return position

    bodies = []
    for link in moving:
        members = [other for other in links.links if carrier(other) is link]
        masses = np.array([number(other.mass)[0] for other in members])
        coms = np.array([within(other, other.com) for other in members])
        inertia = float(sum(number(other.inertia)[0] for other in members))
        if not masses.sum() > 0:
            raise ProblemError(f"{gait.problem.name}: {link.name} moves, but has no mass; an engine needs one")
        parent = -1 if link.parent is None else order[carrier(by_name[link.parent]).name]
        position = ORIGIN if link.parent is None else within(by_name[link.parent], link.position)
        rotor = float(number(link.rotor_inertia)[0])
        bodies.append(Body(link.name, parent, _point(position), *_combined(masses, coms, inertia), rotor))
    feet = [
        Foot(order[carrier(link).name], _point(within(link, link.tip)), float(number(link.foot_radius)[0]))
        for link in (links.stance, links.swing)
    ]
    angles = vertcat(*(SX(link.angle) for link in moving))
    origins = vertcat(*(links.position(link, ORIGIN) for link in moving))
    moved = [jtimes(value, q, dq) for value in (angles, origins)]
    n = len(walker.shape)
    z = vertcat(q[: n + 1], dq[: n + 1])
    grounded = substitute([angles, moved[0], origins, moved[1]], [q[n + 1 :], dq[n + 1 :]], [SX(0), SX(0)])
    slopes = np.asarray(DM(jacobian(angles, q[:n])))
    offset = number(substitute(angles, q, SX.zeros(q.numel())))
    partners = [order[carrier(by_name[links.partners()[link.name]]).name] for link in moving]
    tree = Tree(bodies=tuple(bodies), feet=(feet[0], feet[1]), gravity=_point(number(gravity)))
    return tree, Function("poses", [z, fields], grounded), slopes, offset, np.array(partners)


def _drops(gait: Gait) -> bool:
    coefficients = gait.system.contact_coefficients(gait.dynamics.p)
    return any(float(static) != float(kinetic) for static, kinetic, _ in coefficients.values())


def largest_friction(gait: Gait) -> float:
    """The largest coefficient of friction of a contact."""
    return max(float(static) for static, _, _ in gait.system.contact_coefficients(gait.dynamics.p).values())


@building
def _tree_of_points(gait: Gait) -> tuple[Tree, Function, Array, Array, NDArray[np.intp]]:
    """``_tree`` of a walker without links; bodies that do not turn have slides, not angles."""
    walker, name, states = type(gait.problem.walker), gait.problem.name, gait.system.state_names
    n, p, names = len(walker.shape), gait.dynamics.p[: len(walker.model_fields)], (*walker.shape, "x", "y")
    q, dq, fields = SX.sym("q", n + 2), SX.sym("dq", n + 2), SX.sym("p", p.size)
    mechanism = state_mechanism(walker, *named_arguments(walker, q, fields))
    swaps, n_bodies = bool(walker.step_ends()), len(mechanism.bodies)
    of_bodies = zip(*((body.mass, body.inertia) for body in mechanism.bodies), strict=True)
    masses, inertias, gravity = (
        np.asarray(Function("numbers", [fields], [vertcat(*map(SX, values))])(p)).ravel()
        for values in (*of_bodies, vertsplit(mechanism.gravity))
    )
    bases = [q[n:], *([mechanism.swing_foot] if swaps else [])]
    touching = [mechanism.contacts[name].position for name in walker.contacts] or bases
    positions, base = [*(body.position for body in mechanism.bodies), *touching, *bases], n_bodies + len(touching)
    columns = Function("points", [q, fields], [horzcat(*positions)])
    random = np.random.default_rng(0)
    state = {"y": 0.0, **dict(zip(states, gait.state.tolist(), strict=True))}
    start = np.array([state[key] for key in names])
    poses = [start + SPREAD * k * random.uniform(-1, 1, n + 2) for k in (0, 1, 1, 1)]

    def points(postures: list[Array]) -> Array:
        return np.array([np.asarray(columns(posture, p)).T for posture in postures])  # (postures, points, 2)

    at = points(poses)
    first, links = _rigid_links(at)
    close = RIGID * np.linalg.norm(at[0, :, None] - at[0], axis=2).max()
    slides = all(np.ptp(at[:, link] - at[:, link[:1]], axis=0).max() < close for link in links)
    partner, root, centre = first, links[0], int(first[base])
    if swaps:
        relabelled = Function("relabelled", [q, fields], [vertcat(mechanism.relabel, mechanism.swing_foot)])
        after = points([np.asarray(relabelled(pose, p)).ravel() for pose in poses])
        partner = first[np.linalg.norm(at[:, :, None] - after[:, None], axis=3).max(axis=0).argmin(axis=1)]
        meeting = [(link, {*link} & {*partner[link]}) for link in links]
        root, centre = next(((link, int(min(ends))) for link, ends in meeting if ends), (root, centre))
    placed, partners = _order(links, root, centre, partner, slides)
    if -1 in partners or {j for link, *_ in placed for j in link} != {*first}:
        raise ProblemError(
            f"{name}: the bodies and contacts of a {walker.model} form neither links that are joined at hinges "
            "nor bodies that do not turn; an engine needs that"
        )
    axes = [] if slides else _axes(placed, partners, partner, at[0])
    frames = [_turned(*(sign * (at[0, far] - at[0, near]))) for near, far, sign in axes] or [np.eye(2)] * len(placed)
    carrier = {j: k for k, (link, *_) in reversed([*enumerate(placed)]) for j in link}  # the first link with the point

    def within(k: int, j: int) -> Array:
        """Point j in the frame of link k."""
        return frames[k] @ (at[0, first[j]] - at[0, placed[k][1]])

    def carried(j: int) -> tuple[int, tuple[float, float]]:
        return carrier[int(first[j])], _point(within(carrier[int(first[j])], j))

    bodies = list[Body]()
    spinning = np.array([carrier[int(k)] for k in first[:n_bodies]])
    for k, (_, hinge, parent) in enumerate(placed):
        own = np.flatnonzero(spinning == k)
        if not masses[own].sum() > 0:
            raise ProblemError(f"{name}: a link of a {walker.model} has no mass; an engine needs one")
        position = ORIGIN if parent < 0 or slides else _point(within(parent, hinge))
        rigid = _combined(masses[own], np.array([within(k, int(j)) for j in own]), inertias[own].sum())
        bodies.append(Body(f"link{k}", parent, position, *rigid, 0.0))
    friction, largest = gait.system.contact_coefficients(gait.dynamics.p), largest_friction(gait) or 1.0
    feet = [
        Foot(*carried(j), 0.0, float(friction[foot][0]) / largest)
        for j, foot in enumerate(walker.contacts or (FOOT, FOOT), start=n_bodies)
    ]
    if slides:
        stacked = vertcat(*(positions[hinge] - positions[base] for _, hinge, _ in placed[1:]))
    else:
        stacked = vertcat(*(atan2(*vertsplit(sign * (positions[far] - positions[near]))) for near, far, sign in axes))
    origins = vertcat(*(positions[hinge] for _, hinge, _ in placed))
    turns = vertcat(*(SX(body.angle) for body in mechanism.bodies))
    slopes = Function("slopes", [q, fields], [jacobian(stacked, q[:n]), stacked, jacobian(turns, q[:n])])
    linear = [[np.asarray(value) for value in slopes(pose, p)] for pose in poses]
    A = linear[0][0]
    if any(np.abs(slope - A).max() > RIGID for slope, *_ in linear):
        raise ProblemError(f"{name}: the motions of its links are no linear functions of the shape")
    expected = np.zeros((len(placed), n)) if slides else A
    if any(np.abs((spins - expected[spinning])[inertias > 0]).max(initial=0.0) > RIGID for *_, spins in linear):
        raise ProblemError(f"{name}: a body of a {walker.model} does not turn with its link; an engine needs that")
    offset = linear[0][1].ravel() - A @ poses[0][:n]
    moved = [jtimes(value, q, dq) for value in (stacked, origins)]
    z = vertcat(*(of[names.index(key)] for of in (q, dq) for key in states[: len(states) // 2]))
    outputs = [stacked, moved[0], origins, moved[1]]
    if walker.keeps_height():
        outputs = substitute(outputs, [q[-1], dq[-1]], [SX(0), SX(0)])
    tree = Tree(
        bodies=tuple(bodies),
        feet=tuple(feet),
        gravity=_point(gravity),
        slides=slides,
        bases=tuple(carried(j) for j in range(base, len(positions))),
    )
    return tree, Function("poses", [z, fields], outputs), A, offset, np.array(partners)


def _order(
    links: list[list[int]], root: list[int], centre: int, partner: NDArray[np.intp], slides: bool
) -> tuple[list[tuple[list[int], int, int]], list[int]]:
    """The links in a tree from its root on, each with its hinge and the index of its parent, and their partners.

    Only links that are joined at one point of the tree, or that do not turn (``slides``), are in it. The partner of a
    link is the one that has the partners of its points and of its hinge; -1 if there is none.
    """
    placed, left, used = [(root, centre, -1)], [link for link in links if link is not root], {*root}
    while found := next((link for link in left if slides or len({*link} & used) == 1), None):
        hinge = max(found) if slides else min({*found} & used)
        parent = 0 if slides else next(k for k, (link, _, _) in enumerate(placed) if hinge in link)
        placed.append((found, hinge, parent))
        left.remove(found)
        used |= {*found}
    of = {(frozenset(link), hinge): k for k, (link, hinge, _) in enumerate(placed) if hinge in link}
    return placed, [of.get((frozenset(partner[link].tolist()), int(partner[hinge])), -1) for link, hinge, _ in placed]


def _axes(
    placed: list[tuple[list[int], int, int]], partners: list[int], partner: NDArray[np.intp], at: Array
) -> list[tuple[int, int, float]]:
    """Hinge of every link, its farthest point, and the sign that lets the axis through both point upwards.

    The axis of a link whose partner comes before it goes through the partners of that link's points, with its sign.
    """
    axes = list[tuple[int, int, float]]()
    for (link, hinge, _), of in zip(placed, partners, strict=True):
        if of < len(axes):
            axes.append((hinge, int(partner[axes[of][1]]), axes[of][2]))
        else:
            far = link[int(np.linalg.norm(at[link] - at[hinge], axis=1).argmax())]
            axes.append((hinge, far, 1.0 if at[far, 1] > at[hinge, 1] else -1.0))
    return axes


def _turned(x: float, z: float) -> Array:
    """The matrix that turns the direction of (x, z) to that of (0, 1)."""
    s, c = np.sin(np.arctan2(x, z)), np.cos(np.arctan2(x, z))
    return np.array([[c, -s], [s, c]])


def _combined(masses: Array, coms: Array, inertia: float) -> tuple[float, tuple[float, float], float]:
    """Mass, centre of mass and inertia of rigid bodies that move together; ``inertia`` is the sum of their own."""
    com = masses @ coms / masses.sum()
    return float(masses.sum()), _point(com), float(inertia + masses @ ((coms - com) ** 2).sum(axis=1))


def _rigid_links(at: Array) -> tuple[NDArray[np.intp], list[list[int]]]:
    """The first of all points with which each one always coincides, and the sets of those whose distances are fixed.

    Parameters
    ----------
    at : points in postures, shape (postures, points, 2).
    """
    distances = np.linalg.norm(at[:, :, None] - at[:, None], axis=3)
    close, links = RIGID * distances.max(), list[list[int]]()
    first = (distances.max(axis=0) < close).argmax(axis=1)
    together = np.ptp(distances, axis=0) < close
    for k in np.unique(first):
        link = [int(j) for j in np.unique(first) if together[k, j]]
        if together[np.ix_(link, link)].all() and link not in links:
            links.append(link)
    return first, links


@building
def _forces(gait: Gait) -> tuple[Array, Function | None]:
    """Forces on the shape per torque, (n_shape, n_u); (z, p) -> energy of springs, force against them and dampers."""
    expressions, n = gait.system.expressions, len(gait.system.walker.shape)
    eom = expressions.eom
    if not eom.E[:n, :].is_constant():
        raise ProblemError(f"{gait.problem.name}: the lever arms of its motors vary; the engines cannot model that")
    potential = SX(eom.mechanism.potential)
    springs = [potential, eom.force_of(potential)[:n] + jacobian(eom.dissipation, eom.dq[:n]).T / 2]
    function = (
        None
        if potential.is_zero() and eom.dissipation.is_zero()
        else Function("springs", [expressions.z, expressions.p], springs)
    )
    return np.asarray(DM(eom.E[:n, :])), function


def _window(arcs: Sequence[Arc]) -> tuple[float, float]:
    """Times at which the lowest contact of the swing foot is highest before it scuffs, and after, in arcs of one swing.

    If it is below the ground at the start or at the end of the arcs, the time is that one.
    """
    heights, times, walker = list[float](), list[float](), arcs[0].dynamics.system.walker
    begin, duration = arcs[0].start, arcs[-1].end - arcs[0].start
    swing = [k for k, name in enumerate(walker.landing_points()) if name in walker.step_ends()]
    fine = np.linspace(-1, 1, SAMPLES_PER_ARC)
    for arc in (arc for arc in arcs if not {*walker.step_ends()} & {*arc.mode.touching}):
        points = buffered(arc.dynamics.system.contact_points)
        states = chebyshev.chebval(fine, curves.coefficients(arc.states)).T
        heights += [float(points(np.ascontiguousarray(z), arc.dynamics.p)[0][swing].min()) for z in states]
        times += (arc.start + (fine + 1) / 2 * arc.duration).tolist()
    h, t = np.array(heights), np.array(times)
    inside = (t > begin + STEP_END * duration) & (t < begin + (1 - STEP_END) * duration)
    scuffs = np.flatnonzero(inside & (h <= 0))
    if not scuffs.size:
        highest = float(t[np.argmax(h)])
        return highest, highest
    before, after = h[: scuffs[0]], h[scuffs[-1] :]
    first = begin if before.max() <= 0 else float(t[np.argmax(before)])
    return first, begin + duration if after.max() <= 0 else float(t[scuffs[-1] + np.argmax(after)])


@building
def tree_record(gait: Gait) -> dict[str, Any] | None:
    """A gait for programs that read the MJCF or URDF file of its walker; None if the walker declares no links.

    Returns
    -------
    record : ``start`` has position and rate of every joint of the MJCF file at the start of the cycle;
        ``swing_contact_off`` has, for each step, the times since its start between which the swing foot may scuff; a
        step in which feet swap roles has more than one such pair.
    """
    walker = type(gait.problem.walker)
    if not has_links(walker):
        return None
    names, n = (*walker.shape, "x", "y"), len(walker.shape)
    q, dq, fields = SX.sym("q", n + 2), SX.sym("dq", n + 2), SX.sym("p", len(walker.model_fields))
    tree = state_tree(walker, *named_arguments(walker, q, fields))
    root = next(link for link in tree.links if link.parent is None)
    x, z = vertsplit(tree.position(root, ORIGIN))
    placed = {"root_x": x, "root_z": z, "root_pitch": root.angle, **tree.joints}
    joints = vertcat(*placed.values())
    start = Function("start", [q, dq, fields], [joints, jtimes(joints, q, dq)])
    state = dict(zip(gait.system.state_names, gait.state, strict=True))
    at = ([state.get(f"{rate}{name}", 0.0) for name in names] for rate in ("", "d"))
    position, rate = (np.asarray(v).ravel().tolist() for v in start(*at, gait.dynamics.p[: fields.numel()]))
    return {
        "start": {name: {"position": a, "rate": b} for name, a, b in zip(placed, position, rate, strict=True)},
        "swing_contact_off": [
            list(_window(step.arcs[first:last]))
            for step in gait.steps
            for first, last in pairwise([0, *swap_indices(step.arcs), len(step.arcs)])
        ],
    }


def _point(values: Any) -> tuple[float, float]:
    return float(values[0]), float(values[1])
