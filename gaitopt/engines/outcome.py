"""One run of a gait in a physics engine at one time step, compared with the gait.

The engine starts from the gait's state just after an impact. It walks one cycle and continues for the fraction
``SETTLED`` of a period, because a soft contact needs some time steps to end its impact. There the states are compared.

    state_error   largest difference of angles, rates and the foot's position and speed, in natural units
    error_before_impact   the same difference, the fraction ``SETTLED`` of a period before the last impact
    slip          path of the stance foot forward and backward
    creep         path of the foot while the gait's foot sticks, without the first and last tenth of the phase
    slip_missed, slip_invented   fraction of the cycle in which only the gait slips, or only the engine
    impact_error  difference of the impulse at the landing foot up to the comparison, relative to that of the gait
    energy_error  difference of the energy at the comparison, relative to weight times length
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.engines.plant import Reference, Tree

SETTLED = 0.05
"""Time after the last impact at which states are compared, relative to the period."""
SLIPPING_SPEED = 2.5e-4
"""A foot that is faster counts as slipping, in natural units; for a leg of a metre, about a millimetre per second."""
SHORTEST_MODE = 0.01
"""Duration below which a mode of the engine does not count, relative to the cycle."""
TRIMMED = 0.1
"""Fraction of a sticking phase at each of its ends in which creep is not measured."""
DIVERGED_RATE = 1e3
"""Rate above which a motion has diverged, in natural units."""
LONGEST_REASON = 120
"""Largest number of characters of an engine's error message in an outcome."""
MIDPOINT_INTERVALS = 100
"""Number of intervals of the midpoint rule for the gait's impulse after its impact."""
MOST_SAMPLES = 160
"""Largest number of samples of a motion in an outcome, for pictures."""
COMPLETED = "completed"


class Simulator(Protocol):
    """A walker in an engine; every adapter defines such a class.

    Attributes
    ----------
    name, version : name and version of the engine.
    settings : the engine's settings by name.
    """

    name: ClassVar[str]
    version: ClassVar[str]
    settings: ClassVar[Mapping[str, Mapping[str, Any]]]

    def __init__(self, tree: Tree, friction: float, dt: float, settings: Mapping[str, Any]) -> None:
        """Build the walker on level ground; gravity is inclined."""

    def place(self, q: Array, v: Array) -> None:
        """Set coordinates and rates."""

    def step(self, force: Array, touching: tuple[bool, ...]) -> tuple[Array, Array, Array]:
        """Advance by one time step under forces on the coordinates.

        Parameters
        ----------
        force : ndarray, shape (n + 2,) - forces and torques on the coordinates during the step [N, N m].
        touching : for each foot, whether it can touch the ground.

        Returns
        -------
        q, v : ndarray, shape (n + 2,) each - coordinates and rates after the step.
        forces : ndarray, shape (2, 2) - contact force (f_t, f_n) of each foot during the step [N].
        """


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """One run at one time step; numbers are None if the run ended too early to measure them.

    Attributes
    ----------
    dt : time step [s].
    ending : ``completed``, ``no touchdown``, ``diverged``, ``failed: ERROR``, or ``crashed: SIGNAL``.
    sequence : modes of the engine's stance foot in every step.
    motion : samples of the times [s], of the path of the stance foot [m] and of the shape coordinates, for pictures.
    deviation : difference of the states before the last impact; ``error_before_impact`` is its largest entry.
    """

    dt: float
    ending: str
    state_error: float | None = None
    error_before_impact: float | None = None
    slip: Mapping[str, float] = field(default_factory=dict)
    creep: float | None = None
    slip_missed: float | None = None
    slip_invented: float | None = None
    sequence: tuple[tuple[str, ...], ...] = ()
    sequence_matches: bool = False
    impact_error: float | None = None
    energy_error: float | None = None
    seconds_per_second: float | None = None
    motion: Mapping[str, Sequence[float]] = field(default_factory=dict)
    deviation: tuple[float, ...] = ()


def run(reference: Reference, simulator: type[Simulator], dt: float, settings: Mapping[str, Any]) -> Outcome:
    """Walk one cycle in an engine and measure it.

    Parameters
    ----------
    settings : settings of the adapter. The additional keys ``friction`` and ``gravity`` are factors, for tests.
    """
    changed = dict(settings)
    tree, mu = reference.tree, reference.friction * changed.pop("friction", 1.0)
    factor = changed.pop("gravity", 1.0)
    tree = replace(tree, gravity=(factor * tree.gravity[0], factor * tree.gravity[1]))
    walk, (q, v) = simulator(tree, mu, dt, changed), reference.coordinates(0.0)
    walk.place(q, v)
    cycle = len(reference.gait.steps)
    period = float(reference.starts[-1])
    n = int(np.ceil((1 + SETTLED) * period / dt)) + 1
    times, coordinates, rates, forces = dt * np.arange(n + 1, dtype=float), [q], [v], list[Array]()
    step, began, landings, spent = 0, 0.0, list[float](), 0.0
    for t in times[:-1]:
        local = float(t) - began
        force, touching = reference.torques(step, local, q, v), reference.touching(step, local)
        start = time.perf_counter()
        try:
            q, v, f = walk.step(force, touching)
        except RuntimeError as error:  # raised by compiled code, such as a contact solver that does not converge
            return Outcome(dt=dt, ending=f"failed: {str(error).splitlines()[0][:LONGEST_REASON]}")
        spent += time.perf_counter() - start
        if not np.isfinite(v).all() or np.abs(v).max() * reference.time > DIVERGED_RATE:
            return Outcome(dt=dt, ending="diverged")
        coordinates.append(q.copy())
        rates.append(v.copy())
        forces.append(f)
        if reference.clock:
            ends = local + dt >= period - dt / 2
        else:
            ends = local >= reference.windows[step % cycle][1] and bool((f[reference.lands(step), 1] > 0).any())
        if ends and step < cycle:
            step, began = step + 1, period if reference.clock else float(t)
            landings.append(began)
    if len(landings) < cycle:
        motion = _motion(reference, times, coordinates, rates, [*landings, np.inf])
        return Outcome(dt=dt, ending="no touchdown", motion=motion, seconds_per_second=spent / float(times[-1]))
    padded = np.array([*forces, forces[-1]])
    measured = _measured(reference, times, np.array(coordinates), np.array(rates), padded, landings)
    motion = _motion(reference, times, coordinates, rates, landings)
    return Outcome(dt=dt, ending=COMPLETED, seconds_per_second=spent / float(times[-1]), motion=motion, **measured)


def _measured(
    reference: Reference, times: Array, coordinates: Array, rates: Array, forces: Array, landings: Sequence[float]
) -> dict[str, Any]:
    """The numbers of an outcome from coordinates, rates (m, n + 2) and forces (m, number of feet, 2) at times (m,)."""
    cycle, period, tree = len(reference.gait.steps), float(reference.starts[-1]), reference.tree
    end = (1 + SETTLED) * period

    def at(t: float, values: Array) -> Array:
        k = min(int(np.searchsorted(times, t, side="right")) - 1, len(times) - 2)
        s = (t - times[k]) / (times[k + 1] - times[k])
        return (1 - s) * values[k] + s * values[k + 1]

    deviation = _state(reference, cycle, at(end, coordinates), at(end, rates)) - _state(
        reference, cycle, *reference.coordinates(end)
    )
    before = min((1 - SETTLED) * period, 0.99 * min(landings[-1:]))
    compared = _state(reference, cycle - 1, at(before, coordinates), at(before, rates))
    early = compared - _state(reference, cycle - 1, *reference.coordinates(before))
    energies = [
        reference.energy(cycle, at(end, coordinates), at(end, rates)),
        reference.energy(cycle, *reference.coordinates(end)),
    ]
    weight = tree.mass * float(np.hypot(*tree.gravity)) * reference.length
    slip, sequence, expected = {"slip_forward": 0.0, "slip_backward": 0.0}, list[Any](), list[Any]()
    creep = missed = invented = 0.0
    for step, foot in [(k, foot) for k in range(cycle) for foot in reference.standing(k)]:
        first, last = float(reference.starts[step]), min(float(reference.starts[step + 1]), landings[step])
        first = max(first, landings[step - 1] + SETTLED * period) if step else first
        inside = np.flatnonzero((times >= first) & (times <= last))
        moved = [tree.foot(foot, coordinates[k], rates[k]) for k in inside]
        x, speed = np.array([position[0] for position, _ in moved]), np.array([velocity[0] for _, velocity in moved])
        stated_speed, closed = reference.slip_speed(step, times[inside] - reference.starts[step], foot)
        path = np.diff(x)[closed[1:] & closed[:-1]]
        slip["slip_forward"] += float(path[path > 0].sum())
        slip["slip_backward"] -= float(path[path < 0].sum())
        # a contact may be lost and found again from one time step to the next
        window = max(1, round(SHORTEST_MODE * period / (times[1] - times[0])))
        carried = np.convolve(forces[inside, foot, 1] > 0, np.ones(window), mode="same") > 0
        modes = np.where(carried, _modes(reference, speed), "off")
        stated = np.where(closed, _modes(reference, stated_speed), "off")
        slides, slips = (np.char.startswith(names, "slip") for names in (modes, stated))
        missed += float((slips & ~slides).sum() * (times[1] - times[0]) / period)
        invented += float((slides & ~slips).sum() * (times[1] - times[0]) / period)
        sequence.append(_runs(modes, window))
        expected.append(_runs(stated, window))
        for arc in (arc for arc in reference.gait.steps[step].arcs if reference.sticks(arc, step, foot)):
            margin = TRIMMED * arc.duration
            began, ended = (reference.starts[step] + t for t in (arc.start + margin, arc.end - margin))
            if began < ended < times[inside[-1]]:
                creep += abs(float(np.interp(ended, times[inside], x) - np.interp(began, times[inside], x)))
    return {
        "state_error": float(np.abs(deviation).max()),
        "error_before_impact": float(np.abs(early).max()),
        "slip": slip,
        "creep": creep,
        "slip_missed": missed,
        "slip_invented": invented,
        "sequence": tuple(sequence),
        "sequence_matches": sequence == expected,
        "impact_error": None if reference.clock else _impact_error(reference, times, forces, end),
        "energy_error": (energies[0] - energies[1]) / weight,
        "deviation": tuple(early.tolist()),
    }


def _state(reference: Reference, step: int, q: Array, v: Array) -> Array:
    """Angles, rates, and position and speed of the stance foot in a step, in natural units."""
    position, velocity = reference.tree.foot(reference.stance(step), q, v)
    length, unit = reference.length, reference.time
    angles, rates = reference.tree.angles(q), reference.tree.angles(v)
    if reference.tree.slides:
        angles, rates = q[2:] / length, v[2:] / length
    return np.concatenate([angles, rates * unit, position[:1] / length, velocity[:1] * unit / length])


def _impact_error(reference: Reference, times: Array, forces: Array, end: float) -> float:
    """Relative difference of the impulses at the landing foot, including the forces after the impact.

    The forces count up to the comparison, or until shortly before another contact lands.
    """
    landings = [arc.start for arc in reference.gait.steps[0].arcs[1:] if arc.struck is not None]
    end = min([end, *((1 - SETTLED) * start + float(reference.starts[-1]) for start in landings)])
    cycle, period = len(reference.gait.steps), float(reference.starts[-1])
    spans = np.clip(end - times, 0.0, times[1] - times[0]) * (times > (1 - SETTLED) * period)
    impulse = spans @ forces[:, reference.lands(cycle - 1)].sum(axis=1)
    middles = period + (end - period) * (np.arange(MIDPOINT_INTERVALS) + 0.5) / MIDPOINT_INTERVALS
    stated = reference.landing_impulse
    expected = stated + (end - period) * np.mean([reference.force(float(t)) for t in middles], axis=0)
    return float(np.linalg.norm(impulse - expected) / np.linalg.norm(stated))


def _modes(reference: Reference, speed: Array) -> NDArray[np.str_]:
    """The modes of a foot that has these speeds (m,) [m/s]."""
    slow = SLIPPING_SPEED * reference.length / reference.time
    return np.where(speed >= slow, "slip_forward", np.where(speed <= -slow, "slip_backward", "stick"))


def _runs(modes: NDArray[np.str_], shortest: float) -> tuple[str, ...]:
    """The modes in order, without repetitions and without modes of fewer than ``shortest`` samples."""
    edges = np.flatnonzero(modes[1:] != modes[:-1]) + 1
    pieces = np.split(modes, edges)
    return tuple(mode for mode, _ in groupby(str(piece[0]) for piece in pieces if len(piece) >= shortest))


def _motion(
    reference: Reference, times: Array, coordinates: Sequence[Array], rates: Sequence[Array], landings: Sequence[float]
) -> dict[str, list[float]]:
    """Samples of the times, of the stance foot's path in each step, and of the gait's shape coordinates."""
    shown = np.unique(np.linspace(0, len(times) - 1, MOST_SAMPLES).round().astype(int))
    names, origin, last = reference.system.walker.shape, 0.0, 0
    x = reference.system.state_names.index("x")
    columns: dict[str, list[float]] = {"t": [], "x": [], **{name: [] for name in names}}
    for k in shown:
        step = int(np.searchsorted(landings, times[k], side="right"))
        if step > len(reference.gait.steps) - 1 and times[k] > reference.starts[-1]:
            break
        z = reference.shape_state(step, coordinates[k], rates[k])
        if step != last or k == 0:
            origin, last = float(z[x]), step
        columns["t"].append(float(times[k]))
        columns["x"].append(float(z[x]) - origin)
        for name, value in zip(names, z, strict=False):
            columns[name].append(float(value))
    return columns
