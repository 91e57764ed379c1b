"""The drawing of a walker: points that move, lines between them, and discs for the masses.

The legs of the named walkers are known. A walker may define the lines that draw it (``Walker.outline``). Any other
walker is drawn from its bodies and feet: two points at a constant distance are joined, and thin lines tie what is left
to its neighbours.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, combinations
from types import SimpleNamespace

import numpy as np
from casadi import SX, Function, horzcat, vertcat

from gaitopt.arrays import Array
from gaitopt.building import built_once
from gaitopt.gait.trajectory import Arc
from gaitopt.model.declaration import state_mechanism, state_picture
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.lagrangian import parameter_namespace
from gaitopt.model.walker import Walker
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.rimless_wheel import RimlessWheel
from gaitopt.show.motion import Motion

RIGID = 1e-9
"""Relative change of a distance below which two points belong to one rigid part."""
COINCIDENT = 1e-9
"""Points so close [m] are one."""
DIGITS = 9
"""Of lengths that are compared: rounding does not decide which of two equal legs comes first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Skeleton:
    """A walker's drawing along a motion.

    Attributes
    ----------
    points : ndarray, shape (m, n, 2) - positions [m] at m times; the first is the stance foot, the second the swing
        foot.
    legs : pairs of indices into the points, stance leg first.
    ties : pairs that are not rigid.
    discs : index and mass fraction of every mass.
    contact : index of the point at which the ground acts.
    """

    points: Array
    legs: tuple[tuple[int, int], ...]
    ties: tuple[tuple[int, int], ...] = ()
    discs: tuple[tuple[int, float], ...] = ()
    contact: int = 0


def skeleton(arcs: Sequence[Arc]) -> Skeleton:
    """The drawing of a walker at all times of its arcs."""
    dynamics = arcs[0].dynamics
    walker, n_q = dynamics.system.walker, dynamics.system.n_shape + 1
    positions, masses, _, lines = _mechanism(walker)
    n_p = len(walker.model_fields)
    places = [np.asarray(positions(arc.states[:, :n_q].T, arc.dynamics.p[:n_p])) for arc in arcs]
    points = np.hstack(places).T.reshape(sum(arc.times.size for arc in arcs), -1, 2)
    mass = np.asarray(masses(dynamics.p[:n_p])).ravel()
    discs = tuple((k, float(share)) for k, share in enumerate(mass / mass.sum(), start=2))
    if lines:
        contact = points.shape[1] - 1
        return Skeleton(points=points, legs=_strokes(lines, 2 + mass.size), discs=discs, contact=contact)
    draw = next((draw for kind, draw in _DRAWINGS.items() if issubclass(walker, kind)), _rigid_parts)
    return draw(Skeleton(points=points[:, :-1], legs=(), discs=discs), dynamics)


def slope(motion: Motion) -> float:
    """Slope of the ground [rad], downhill along x, from the direction of gravity."""
    _, _, gravity, _ = _mechanism(motion.walker)
    along, normal = np.asarray(gravity(motion.dynamics.p[: len(motion.walker.model_fields)])).ravel()
    return float(np.arctan2(along, -normal))


def _strokes(lines: tuple[int, ...], first: int) -> tuple[tuple[int, int], ...]:
    """Pairs of neighbours on lines of so many points each, which follow one another from index ``first``."""
    starts = accumulate(lines[:-1], initial=first)
    return tuple((k, k + 1) for start, n in zip(starts, lines, strict=True) for k in range(start, start + n - 1))


def _wheel(bare: Skeleton, dynamics: Dynamics) -> Skeleton:
    """All spokes, turned about the hub from the stance spoke."""
    spokes = round(dynamics.parameter("walker.spokes"))
    foot, swing, hub = (bare.points[:, k] for k in range(3))
    turns = -2 * np.pi / spokes * np.arange(2, spokes)
    arm = foot - hub
    others = [hub + arm @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) for a in -turns]
    points = np.stack([foot, swing, hub, *others], axis=1)
    return replace(bare, points=points, legs=tuple((2, k) for k in range(points.shape[1]) if k != 2))


_DRAWINGS: dict[type[Walker], Callable[[Skeleton, Dynamics], Skeleton]] = {
    CompassBiped: lambda bare, dynamics: replace(bare, legs=((0, 3), (3, 1))),  # bodies are leg, hip, leg
    RimlessWheel: _wheel,
}


def _rigid_parts(bare: Skeleton, dynamics: Dynamics) -> Skeleton:
    """A shortest tree over the points (Kruskal), rigid pairs first."""
    pairs = []
    for a, b in combinations(range(bare.points.shape[1]), 2):
        distance = np.linalg.norm(bare.points[:, a] - bare.points[:, b], axis=1)
        length = float(f"{distance.mean():.{DIGITS}g}")
        pairs.append((bool(np.ptp(distance) > RIGID * max(length, COINCIDENT)), length, a, b))
    part = list(range(bare.points.shape[1]))
    legs, ties = list[tuple[int, int]](), list[tuple[int, int]]()
    for loose, length, a, b in sorted(pairs):
        if part[a] != part[b]:
            part = [part[a] if x == part[b] else x for x in part]
            if length > COINCIDENT:
                (ties if loose else legs).append((a, b))
    return replace(bare, legs=tuple(legs), ties=tuple(ties))


@built_once(maxsize=8)
def _mechanism(walker: type[Walker]) -> tuple[Function, Function, Function, tuple[int, ...]]:
    """(coordinates, p) -> stance foot, swing foot, bodies, outline, contact in columns; p -> masses; p -> gravity.

    Last come the numbers of points of the lines of the outline.
    """
    p = SX.sym("p", len(walker.model_fields))
    names = walker.coordinates()
    q = SX.sym("q", len(names))
    coordinates = {"y": SX(0)} | {name: q[k] for k, name in enumerate(names)}
    named = SimpleNamespace(**coordinates), parameter_namespace(walker, p)
    mechanism, (lines, contact) = state_mechanism(walker, *named), state_picture(walker, *named)
    drawn = [*(body.position for body in mechanism.bodies), *(point for line in lines for point in line)]
    foot = vertcat(coordinates["x"], coordinates["y"])
    places = horzcat(foot, mechanism.swing_foot, *drawn, contact)
    masses = vertcat(*(SX(body.mass) for body in mechanism.bodies))
    return (
        Function("positions", [q, p], [places]),
        Function("masses", [p], [masses]),
        Function("gravity", [p], [mechanism.gravity]),
        tuple(map(len, lines)),
    )
