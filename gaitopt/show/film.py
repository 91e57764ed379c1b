"""The drawing of a walker, and its motion packed for a page: drawing, forces, states and torques at some tens of times.

    value = low + step * code,      code = 0 ... 8191

A walker is drawn as points that move, lines between them, and discs for the masses. The legs of the named walkers are
known. A walker may define the lines that draw it (``Walker.outline``). Any other walker is drawn from its bodies and
feet: two points at a constant distance are joined, and thin lines tie the other points to their neighbours.

Columns of numbers are packed as base64 with 13 bits per number; a constant needs none. The low bytes of a column come
before the high ones, which differ so little that the page compresses well.
"""

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, combinations, groupby, pairwise
from types import SimpleNamespace
from typing import NotRequired, TypeAlias

import numpy as np
from casadi import SX, Function, horzcat, vertcat, vertsplit
from numpy.typing import ArrayLike
from typing_extensions import TypedDict

from gaitopt.arrays import Array
from gaitopt.building import built_once
from gaitopt.gait import curves
from gaitopt.gait.measures import observe
from gaitopt.gait.trajectory import Arc
from gaitopt.model.contacts import undetermined
from gaitopt.model.declaration import has_links, is_default, parameter_namespace, state_mechanism, state_picture
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.links import state_tree
from gaitopt.model.mechanism import Mechanism
from gaitopt.model.modes import FOOT, Mode
from gaitopt.model.section import cycle_end, cycle_start
from gaitopt.model.system import FLOOR
from gaitopt.model.walker import Walker
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.rimless_wheel import RimlessWheel
from gaitopt.show.motion import Motion, cycle_sentence, motor_label, time_label, with_start_times
from gaitopt.show.style import MODE_NAMES

FRAMES = 72
"""Largest number of frames of a cycle; a page draws smooth curves through them."""
FRAMES_OF_WALK = 240
"""Number of frames that a walk may have even if it has few steps."""
REPEATS = 4
"""Number of cycles that the page plays before it starts again."""
FEWEST_FRAMES = 5
"""Smallest number of frames of a phase."""
VISIBLE_CHANGE, SMALLEST_RANGE = 3e-4, 1e-6
"""Smallest change of a state that is visible, relative to its range; and the smallest range [rad, m; per s] that
matters."""
CODES = 8191
"""Largest code of a packed number; a chart on a page is some 300 pixels high."""
RIGID = 1e-9
"""Relative change of the distance of two points below which they belong to one rigid body."""
COINCIDENT = 1e-9
"""Distance below which two points coincide [m]."""
ROUNDING = 1e-9
"""Largest distance of two points that differ by rounding only [m]."""
MAGNIFICATIONS = (100, 50, 20, 10, 5, 2)
"""Magnifications of the magnifier; the largest one is chosen in which the longest slip fits."""
FITS = 0.3
"""Longest slip that fits into the magnifier, in heights of the walker as drawn outside it."""
FAR = 100.0
"""Length of the ground beyond the first and the last foot of a floor [m]."""
DIGITS = 9
"""Number of digits of lengths that are compared, so that rounding does not decide which of two equal legs comes
first."""


class PackedRecord(TypedDict):
    """Columns of ``rows`` numbers by name, each as its smallest number, the step of its codes, and the codes."""

    rows: int
    columns: dict[str, tuple[float, float, str]]


class FilmContactRecord(TypedDict):
    """A contact: its name, the point at which the ground acts, the point that leaves its mark, its friction."""

    name: str
    point: int
    mark: int
    friction: float


FilmTile: TypeAlias = tuple[float, float, float, float, float]
"""A tile of the ground: x [m] and then y [m] of its two ends, and its friction relative to the nominal one, minus 1."""


class FilmPhaseRecord(TypedDict):
    """A phase: ``mode`` determines its colour, ``label`` describes the contacts, ``contacts`` are their modes.

    ``undetermined`` says for each contact whether its share of a force is undetermined: the page then draws no force. A
    phase lasts from ``start`` to ``end`` [s] and from frame ``first`` to ``last``, in a ``step`` with its ``origin``
    [m]. ``closeup`` is the number of the contact under the magnifier and the x [m] at its middle; None if there is
    none. On a floor, ``ground`` is the friction and the slope [rad] of the tile under every contact.
    """

    mode: str
    label: str
    contacts: list[str | None]
    undetermined: list[bool]
    start: float
    end: float
    step: int
    origin: float
    first: int
    last: int
    closeup: tuple[int, float] | None
    ground: NotRequired[list[tuple[float, float]]]


class FilmRecord(TypedDict):
    """The data of a motion on a page, in SI units. ``film`` writes them and the scripts of pages read them.

    Frames are Chebyshev points of each phase, as many as a smooth curve needs; their columns are the coordinates ``xK``
    and ``yK`` of the points, the force ``f_tN`` and ``f_nN`` at each contact, the shape with its rates, and
    ``torque ACTUATOR``. Point 0 is the stance foot. All x count from the stance foot at the start of its step, which is
    ``origin`` in the cycle. The picture follows the walker between the times and positions of ``path``, and on a floor
    also its heights; ``magnification`` is that of the magnifier of the feet, 0 if none of them slips. ``tiles`` are
    those of a floor.
    """

    name: str
    slope: float
    contacts: list[FilmContactRecord]
    weight: float
    period: float
    steps: int
    repeats: int
    cycle: str
    cycle_start: str
    cycle_end: str
    time_label: str
    motor_label: str
    step_length: float
    path: list[tuple[float, ...]]
    tiles: list[FilmTile]
    magnification: int
    impacts: list[str]
    impulse_ratios: list[float | None]
    shape: list[str]
    lengths: bool
    actuators: list[str]
    phases: list[FilmPhaseRecord]
    legs: Sequence[tuple[int, int]]
    sides: Sequence[int | None]
    ties: Sequence[tuple[int, int]]
    discs: Sequence[tuple[int, float]]
    frames: PackedRecord


@dataclass(frozen=True, slots=True, kw_only=True)
class Skeleton:
    """A walker's drawing along a motion.

    Attributes
    ----------
    points : ndarray, shape (m, n, 2) - positions [m] at m times; the first is the stance foot, the second the swing
        foot.
    legs : pairs of indices into the points, stance leg first.
    sides : for every pair, 0 if it belongs to the stance leg, 1 for the swing leg, None for neither; () if not known.
    ties : pairs of points that are not rigid.
    discs : for every mass, the index of its point and its fraction of the total mass.
    contacts : index of the point of every contact, in the order of ``Walker.contact_names``.
    marks : index of the point of every contact that leaves its mark on the ground; the stance foot of an only contact.
    """

    points: Array
    legs: tuple[tuple[int, int], ...]
    sides: tuple[int | None, ...] = ()
    ties: tuple[tuple[int, int], ...] = ()
    discs: tuple[tuple[int, float], ...] = ()
    contacts: tuple[int, ...] = (0,)
    marks: tuple[int, ...] = (0,)


def skeleton(arcs: Sequence[Arc]) -> Skeleton:
    """The drawing of a walker at all times of its arcs."""
    dynamics = arcs[0].dynamics
    walker = dynamics.system.walker
    positions, masses, _, lines, landings, sides = _mechanism(walker)
    n_p = len(walker.model_fields)
    columns = []
    for arc in arcs:
        q = arc.states[:, : len(walker.coordinates())].T
        for name in {*landings} - {*arc.mode.touching}:  # it is drawn where it is going to land
            q = np.asarray(landings[name](q, arc.dynamics.p[:n_p]))
        columns.append(np.asarray(positions(q, arc.dynamics.p[:n_p])))
    points = np.hstack(columns).T.reshape(sum(arc.times.size for arc in arcs), -1, 2)
    mass = np.asarray(masses(dynamics.p[:n_p])).ravel()
    discs = tuple((k, float(share)) for k, share in enumerate(mass / mass.sum(), start=2))
    n_contacts, n_points = len(walker.contact_names()), points.shape[1]
    contacts = tuple(range(n_points - n_contacts, n_points))
    marks = tuple(k if walker.label(name) else 0 for name, k in zip(walker.contact_names(), contacts, strict=True))
    if lines:  # neighbours on each line of the outline, whose points follow those of the bodies
        starts = accumulate(lines[:-1], initial=2 + mass.size)
        legs = [(k, k + 1) for start, n in zip(starts, lines, strict=True) for k in range(start, start + n - 1)]
        return Skeleton(points=points, legs=tuple(legs), sides=sides, discs=discs, contacts=contacts, marks=marks)
    draw = next((draw for kind, draw in _DRAWINGS.items() if issubclass(walker, kind)), _shortest_tree)
    if not walker.labels():  # its contact is drawn as the stance foot, the first point
        points, contacts = points[:, :-1], (0,)
    return draw(Skeleton(points=points, legs=(), discs=discs, contacts=contacts, marks=marks), dynamics)


def slope(motion: Motion) -> float:
    """Slope of the ground [rad], downhill along x, from the direction of gravity."""
    _, _, gravity, *_ = _mechanism(motion.walker)
    along, normal = np.asarray(gravity(motion.dynamics.p[: len(motion.walker.model_fields)])).ravel()
    return float(np.arctan2(along, -normal))


def rise(motion: Motion, step: int) -> float:
    """Height over the nominal ground [m] from which y counts in a step of a walk on a floor; zero on level ground."""
    if motion.floor is None:
        return 0.0
    return motion.floor.tile(step if motion.walker.base_contact() else 0).height


def ground_tiles(motion: Motion) -> list[FilmTile]:
    """The tiles of a floor, from halfway to the foot before to halfway to the next foot; none on level ground.

    The first and the last tile extend by ``FAR``.
    """
    if motion.floor is None:
        return []
    names, feet, origin = motion.walker.contact_names(), list[float](), 0.0
    for step in motion.steps:
        arc = step.arcs[0]
        drawing = skeleton([replace(arc, times=arc.times[:1], states=arc.states[:1])])
        under = [drawing.points[0, drawing.marks[n], 0] for n, name in enumerate(names) if name in arc.mode.touching]
        feet.append(origin + float(np.mean(under or [0.0])))
        origin += 0.0 if step.impact is None else step.impact.step_length
    if motion.steps[-1].impact is not None:
        feet.append(feet[-1] + motion.steps[-1].impact.step_length)
    ends = [feet[0] - FAR, *((a + b) / 2 for a, b in pairwise(feet)), feet[-1] + FAR]
    nominal, tiles = motion.dynamics.static_friction, list[FilmTile]()
    for n, (foot, left, right) in enumerate(zip(feet, ends, ends[1:], strict=False)):
        tile = motion.floor.tile(n)
        low, high = (tile.height - float(np.tan(tile.slope)) * (x - foot) for x in (left, right))
        friction = nominal if tile.friction is None else tile.friction[0]
        tiles.append((left, right, low, high, friction / nominal - 1 if nominal else np.sign(friction)))
    return tiles


def _ground_under(arc: Arc, names: Sequence[str]) -> list[tuple[float, float]]:
    """Friction and slope [rad] of the tile under every contact."""
    system, p = arc.dynamics.system, arc.dynamics.p
    coefficients, indices = system.contact_coefficients(p), {key: k for k, key in enumerate(system.parameters)}
    of = {name: name if name in coefficients else FOOT for name in names}
    slopes = {name: indices.get(f"{FLOOR}.{of[name]}.slope") for name in names}
    return [
        (short(float(coefficients[of[name]][0])), 0.0 if (k := slopes[name]) is None else short(float(p[k])))
        for name in names
    ]


def magnifier(motion: Motion) -> tuple[int, list[tuple[int, float] | None]]:
    """Magnification with which every slip of a contact is seen whole, and the magnified contact in every arc.

    A contact is magnified while it stays on the ground, if it slips during this time. If there are several, it is the
    one that slips, or else the one that was magnified before.

    Returns
    -------
    magnification : one of ``MAGNIFICATIONS``; 0 if no contact slips, or if slips are too long to be magnified.
    closeups : for every arc the number of the contact and the x [m] in the middle of its trace; or None.
    """
    names = motion.walker.contact_names()
    arcs, steps, origins, origin = list[Arc](), list[int](), list[float](), 0.0
    for number, step in enumerate(motion.steps):
        arcs, steps = [*arcs, *step.arcs], [*steps, *[number] * len(step.arcs)]
        origins += [origin] * len(step.arcs)
        origin += step.impact.step_length if step.impact is not None else 0.0
    drawing = skeleton(arcs)
    rows = [slice(end - len(arc.times), end) for arc, end in zip(arcs, accumulate(map(_count, arcs)), strict=True)]
    stays, longest = list[dict[int, float]]({} for _ in arcs), 0.0
    for n, name in enumerate(names):
        x = drawing.points[:, drawing.marks[n], 0]
        touching = [k if name in arc.mode.touching else None for k, arc in enumerate(arcs)]
        for _, run in groupby(
            (k for k in touching if k is not None), key=lambda k: (steps[k], touching[:k].count(None))
        ):
            stay = list(run)
            if not any(Mode(arcs[k].mode.contacts[name]).slips for k in stay):
                continue
            trace = np.concatenate([origins[k] + x[rows[k]] for k in stay])
            longest = max(longest, float(np.ptp(trace)))
            for k in stay:
                stays[k][n] = float(trace.min() + trace.max()) / 2
    height = float(drawing.points[:, :, 1].max())
    fitting = [one for one in MAGNIFICATIONS if one * longest <= FITS * height]
    if not longest or not fitting:
        return 0, [None] * len(arcs)
    closeups, last = list[tuple[int, float] | None](), -1
    for arc, middles in zip(arcs, stays, strict=True):
        slipping = [n for n in middles if Mode(arc.mode.contacts[names[n]]).slips]
        last = next(
            (n for n in (last, *slipping) if n in slipping), last if last in middles else next(iter(middles), -1)
        )
        closeups.append((last, middles[last]) if last in middles else None)
    return fitting[0], closeups


def _count(arc: Arc) -> int:
    return len(arc.times)


def _wheel(bare: Skeleton, dynamics: Dynamics) -> Skeleton:
    """The drawing of a wheel: all spokes, turned about the hub from the stance spoke."""
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


def _shortest_tree(bare: Skeleton, dynamics: Dynamics) -> Skeleton:
    """The drawing as a shortest tree over the points (Kruskal), with rigid pairs first."""
    pairs = []
    for a, b in combinations(range(bare.points.shape[1]), 2):
        distance = np.linalg.norm(bare.points[:, a] - bare.points[:, b], axis=1)
        length = float(f"{distance.mean():.{DIGITS}g}")
        pairs.append((bool(np.ptp(distance) > RIGID * max(length, COINCIDENT)), length, a, b))
    tree = list(range(bare.points.shape[1]))  # number of the tree of every point
    legs, ties = list[tuple[int, int]](), list[tuple[int, int]]()
    for loose, length, a, b in sorted(pairs):
        if tree[a] != tree[b]:
            tree = [tree[a] if number == tree[b] else number for number in tree]
            if length > COINCIDENT:
                (ties if loose else legs).append((a, b))
    return replace(bare, legs=tuple(legs), ties=tuple(ties))


@built_once(maxsize=8)
def _mechanism(
    walker: type[Walker],
) -> tuple[Function, Function, Function, tuple[int, ...], Mapping[str, Function], tuple[int | None, ...]]:
    """(coordinates, p) -> stance foot, swing foot, bodies, outline, contacts in columns; p -> masses; p -> gravity.

    Then come the numbers of points of the lines of the outline, by the name of each massless contact
    (coordinates, p) -> coordinates with the contact where it will land, and the sides of the lines.
    """
    p = SX.sym("p", len(walker.model_fields))
    names = walker.coordinates()
    q = SX.sym("q", len(names))
    coordinates = {"y": SX(0)} | {name: q[k] for k, name in enumerate(names)}
    named = SimpleNamespace(**coordinates), parameter_namespace(walker, p)
    mechanism, (lines, contact) = state_mechanism(walker, *named), state_picture(walker, *named)
    drawn = [*(body.position for body in mechanism.bodies), *(point for line in lines for point in line)]
    foot = vertcat(coordinates["x"], coordinates["y"])
    stated = mechanism.contacts
    contacts = [stated[name].position if name in stated else contact for name in walker.contact_names()]
    points = horzcat(foot, mechanism.swing_foot, *drawn, *contacts)
    masses = vertcat(*(SX(body.mass) for body in mechanism.bodies))
    return (
        Function("positions", [q, p], [points]),
        Function("masses", [p], [masses]),
        Function("gravity", [p], [mechanism.gravity]),
        tuple(map(len, lines)),
        {
            name: Function(name, [q, p], [vertcat(*(massless.places.get(k, q[n]) for n, k in enumerate(names)))])
            for name, massless in stated.items()
            if massless.places
        },
        state_tree(walker, *named).sides()
        if has_links(walker) and is_default(walker, "outline")
        else _exchanged(walker, mechanism, lines, q, p),
    )


def _exchanged(
    walker: type[Walker], mechanism: Mechanism, lines: Sequence[Sequence[SX]], q: SX, p: SX
) -> tuple[int | None, ...]:
    """The sides of the pieces of an outline. The pieces of the two legs are exchanged when the feet swap roles.

    Returns
    -------
    sides : side of every piece; () if no piece is exchanged with another.
    """
    pieces = [horzcat(*pair) for line in lines for pair in pairwise(line)]
    if mechanism.relabel.numel() == 0 or not pieces:
        return ()
    base = {"x": mechanism.swing_foot[0], "y": mechanism.swing_foot[1]}
    shape = dict(zip(walker.shape, vertsplit(SX(mechanism.relabel)), strict=True))
    swapped = vertcat(*((shape | base)[name] for name in walker.coordinates()))
    random = np.random.default_rng(0)
    pose = random.uniform(-0.3, 0.3, q.numel()), random.uniform(0.5, 1.5, p.numel())
    drawn, after = Function("pieces", [q, p], [vertcat(*pieces)]), Function("swapped", [q, p], [swapped, base["y"]])
    exchanged, height = after(*pose)
    here, there = (np.asarray(drawn(at, pose[1])).reshape(-1, 2, 2) for at in (pose[0], exchanged))
    if "y" not in walker.coordinates():
        there = there + np.array([[0.0], [float(height)]])
    gaps = [[min(np.abs(one - other).max(), np.abs(one - other[:, ::-1]).max()) for other in there] for one in here]
    partners = [int(np.argmin(row)) if min(row) < ROUNDING else k for k, row in enumerate(gaps)]
    partners = [partner if partners[partner] == k else k for k, partner in enumerate(partners)]
    if all(partner == k for k, partner in enumerate(partners)):
        return ()
    return tuple(None if partner == k else int(partner < k) for k, partner in enumerate(partners))


def film(motion: Motion, frames: int = FRAMES) -> FilmRecord:
    """A cycle or a walk for a page, with at most ``frames`` frames of a cycle."""
    frames = frames if motion.periodic else max(FRAMES_OF_WALK, frames * len(motion.steps))
    arcs, phases, first, names = list[Arc](), list[FilmPhaseRecord](), 0, motion.walker.contact_names()
    tiled, rows, path = motion.floor is not None, list[int](), [(0.0, 0.0, rise(motion, 0))]
    magnification, closeups = magnifier(motion)
    for index, (began, step) in enumerate(with_start_times(motion.steps)):
        time, travelled, lift = path[-1]
        for whole in step.arcs:
            arc = _at_frames(whole, max(FEWEST_FRAMES, round(frames * whole.duration / motion.period)))
            arcs.append(arc)
            phases.append(
                {
                    "mode": _overall(arc.mode),
                    "label": describe_contacts(arc.mode),
                    "contacts": [arc.mode.contacts[name] if name in arc.mode.touching else None for name in names],
                    "undetermined": [name in undetermined(motion.walker, arc.mode) for name in names],
                    "start": short(began + arc.start),
                    "end": short(began + arc.end),
                    "step": index,
                    "origin": short(travelled),
                    "first": first,
                    "last": first + len(arc.times) - 1,
                    "closeup": closeups[len(phases)],
                }
            )
            if tiled:
                phases[-1]["ground"] = _ground_under(arc, names)
            first += len(arc.times)
            rows += [index] * len(arc.times)
        pace = travelled / time if time else 0.0  # a walk may end within a step, without an impact
        length = step.impact.step_length if step.impact is not None else pace * step.period
        path.append((time + step.period, travelled + length, lift if step.impact is None else rise(motion, index + 1)))
    drawing = skeleton(arcs)
    heights = drawing.points[:, :, 1] + np.array([[rise(motion, step)] for step in rows])
    observed, states = [observe(arc) for arc in arcs], np.vstack([arc.states for arc in arcs])
    force, torque = np.vstack([o.force for o in observed]), np.vstack([o.torque for o in observed])
    if tiled:  # the forces are those along and normal to the tiles
        for phase in phases:
            for n, (_, tilt) in enumerate(phase["ground"]):
                of = slice(phase["first"], phase["last"] + 1), slice(2 * n, 2 * n + 2)
                turn = np.array([[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]])
                force[of] = force[of] @ turn
    columns = {f"f_{kind}{k}": force[:, 2 * k + row] for k in range(len(names)) for row, kind in enumerate("tn")}
    for name in motion.walker.shape:
        columns |= {key: states[:, motion.state_index(key)] for key in (name, f"d{name}")}
    columns |= {f"torque {name}": torque[:, k] for k, name in enumerate(motion.walker.actuators)}
    for k in range(drawing.points.shape[1]):
        columns |= {f"x{k}": drawing.points[:, k, 0], f"y{k}": heights[:, k]}
    impacts = [step.impact for step in motion.steps if step.impact is not None]
    coefficients = motion.dynamics.system.contact_coefficients(motion.dynamics.p)
    impulses = [impact.stick_impulse.tolist() for impact in impacts]
    return {
        "name": motion.name,
        "slope": slope(motion),
        "contacts": [
            {"name": name, "point": point, "mark": mark, "friction": float(static)}
            for (name, (static, *_)), point, mark in zip(
                coefficients.items(), drawing.contacts, drawing.marks, strict=True
            )
        ],
        "weight": float(motion.dynamics.system.weight(motion.dynamics.p)),
        "period": short(motion.period),
        "steps": len(motion.steps),
        "repeats": REPEATS if motion.periodic else 1,
        "cycle": cycle_sentence(motion) if motion.periodic else "",
        "cycle_start": cycle_start(motion.dynamics.system),
        "cycle_end": cycle_end(motion.dynamics.system),
        "time_label": time_label([motion]),
        "motor_label": motor_label([motion]),
        "step_length": short(path[-1][1]),
        "path": [tuple(map(short, point if tiled else point[:2])) for point in path],
        "tiles": ground_tiles(motion),
        "magnification": magnification,
        "impacts": [describe_contacts(impact.mode) for impact in impacts],
        "impulse_ratios": [tangential / normal if normal else None for tangential, normal in impulses],
        "shape": list(motion.walker.shape),
        "lengths": bool(motion.walker.lengths),
        "actuators": list(motion.walker.actuators),
        "phases": phases,
        "legs": drawing.legs,
        "sides": drawing.sides or ((0, 1) if len(drawing.legs) == 2 else ()),
        "ties": drawing.ties,
        "discs": drawing.discs,
        "frames": pack(columns),
    }


def _overall(mode: Mode) -> str:
    """The mode that determines the colour of a phase, one for all contacts."""
    states = [state for state in mode.contacts.values() if state in MODE_NAMES]
    return next((state for state in states if state != Mode.STICK), states[0] if states else str(Mode.FLIGHT))


def describe_contacts(mode: Mode) -> str:
    """Describe the mode of every contact on the ground: ``heel slip forward, toe stick``."""
    return mode.contact.brief.replace("_", " ").replace(" + ", ", ")


def _at_frames(arc: Arc, limit: int) -> Arc:
    """The arc at as few Chebyshev points as resolve it for the eye, but no more than ``limit``."""
    if len(arc.times) == 2:  # so short that it is straight
        return arc
    fitted = curves.coefficients(arc.states)
    scale = np.maximum(np.ptp(arc.states, axis=0), SMALLEST_RANGE)
    lost = (np.abs(fitted[::-1]).cumsum(axis=0)[::-1] / scale).max(axis=1)  # error of a series that ends before a term
    enough = int(np.argmax(np.append(lost, 0.0) < VISIBLE_CHANGE))
    s = curves.points(min(max(enough, FEWEST_FRAMES), max(limit, FEWEST_FRAMES)))
    states = np.asarray(curves.evaluate(fitted, s))
    return replace(arc, times=arc.start + arc.duration * (s + 1) / 2, states=states)


def short(value: float) -> float:
    """The value with as many digits as a page can show."""
    return float(f"{value:.7g}")


def pack(columns: Mapping[str, ArrayLike]) -> PackedRecord:
    """Pack columns of equal length; ``columns.js`` unpacks them to within 7e-5 of their range."""
    packed, rows = dict[str, tuple[float, float, str]](), 0
    for name, values in columns.items():
        numbers = np.asarray(values, dtype=float)
        rows, low = len(numbers), float(numbers.min())
        step = float(np.ptp(numbers)) / CODES
        codes = np.round((numbers - low) / step).astype("<u2") if step > 0 else np.empty(0, "<u2")
        planes = codes.view(np.uint8).reshape(-1, 2).T.tobytes()
        packed[name] = float(f"{low:.7g}"), float(f"{step:.5g}"), base64.b64encode(planes).decode()
    return {"rows": rows, "columns": packed}
