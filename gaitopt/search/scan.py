"""A scan for gaits: the defect of the return map over a whole section of one or two coordinates.

    d(xi) = P(xi) - xi,        a gait is a zero of d

P maps a state of the section to the state after a whole cycle, by simulation. A scan takes a few milliseconds, or half
a second for a walker with several contacts, and rules out points of a sweep on which a search would spend seconds. A
point is ruled out if d has no zero at any sample and, judging by its variation, none between or beyond the samples.

A section with more coordinates is not scanned: a grid that shows how d varies needs some tens of samples along each of
them. Nor is a design, whose gaits form a family over its free numbers instead of isolated zeros of d, and nor is an
open mode sequence of a walker whose section depends on the contacts that touch, because each sequence may have another
section.
"""

from collections.abc import Iterable, Iterator
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.model.section import Section
from gaitopt.problem.problem import Problem
from gaitopt.requests import Engine
from gaitopt.search.candidate import SAME
from gaitopt.search.find import longest_cycle
from gaitopt.search.starts import natural_limits
from gaitopt.simulation.engine import choose_engine
from gaitopt.simulation.outcomes import phase_names
from gaitopt.simulation.simulator import Simulator, stepper_class
from gaitopt.verification.return_map import ReturnMap
from gaitopt.verification.step_map import StepMap, section_coordinates, step_map

SAMPLES, MOST_SAMPLES = {1: 64, 2: 16}, {1: 512, 2: 32}
"""Number of samples along each coordinate of a section with one or two of them, and the largest number where nothing is
known about the defect."""
ENOUGH_SAMPLES, MOST_ROUNDS, REFINEMENT = {1: 12, 2: 36}, {1: 4, 2: 3}, 2
"""Number of samples from which the walker has to complete its cycle; largest number of rounds; and factor of the number
of samples along each coordinate in the next round, if it does not cover a smaller part of the section."""
SAMPLES_BESIDE = 2
"""The next round covers the samples near which the defect may vanish, and this many samples on either side."""
SHRINKS = 0.5
"""The next round must cover a smaller fraction of the section than this; else it would only repeat the last one."""
SWEEP_STEPS = 10**6
"""Number of steps for which the engine of a sweep is chosen."""
VARIATION = 3.0
"""The defect may change by this multiple of its largest difference between neighbouring samples."""
ROUNDED = 1e-9
"""A zero on the boundary of a simplex may lie outside of it by this fraction of its size."""
NO_FIXED_POINT = "the return map has no fixed point"
"""The message about a problem without a gait."""


def scanned(problem: Problem) -> bool:
    """Whether the section of a problem is small enough to be scanned."""
    section = None if problem.is_design else _section(problem)
    if section is None:
        return False
    count = section.indices.size
    return count == 1 or (count == 2 and choose_engine(Engine.AUTO, steps=SWEEP_STEPS) is Engine.HEYOKA)


def _section(problem: Problem) -> Section | None:
    """The section that is scanned, that of every impact if the modes are open; None if it follows from the modes."""
    section = problem.section
    if section is None or not problem.is_open:
        return section
    slips = any(mode.slips for mode in problem.walker.foot_modes())
    return section.every_step if slips else section


def possible_gaits(problem: Problem) -> tuple[bool, list[dict[str, float]]]:
    """Whether a problem can have a gait of any mode sequence, and states near the gaits that the scan suggests.

    The states are section coordinates, or whole states if these are not enough. If the section depends on the contacts
    that touch, only gaits with the section of the problem count.

    Parameters
    ----------
    problem : a problem for which ``scanned`` is true.
    """
    section = _section(problem)
    assert section is not None
    mapped = step_map(problem, None, choose_engine(Engine.AUTO, steps=SWEEP_STEPS))
    dynamics, size = mapped.dynamics, section.indices.size
    steps = longest_cycle(problem) if problem.is_open else len(problem.cycle.steps)
    cycles, units = max(steps // dynamics.steps_per_cycle, 1), dynamics.state_units[section.indices]
    guess = {} if problem.start is None else problem.start.state
    half = np.maximum(natural_limits(dynamics, section), [2 * abs(guess.get(name, 0.0)) for name in section.names])
    count, box = SAMPLES[size], np.array([-half, half])
    for _ in range(MOST_ROUNDS[size]):  # states of a given energy, for example, exist in a part of the section
        axes = np.linspace(box[0], box[1], count, axis=1)
        states = mapped.lift(section_coordinates(problem, np.array([*product(*axes)])))
        exist = np.asarray(np.isfinite(states).all(axis=1)).reshape([count] * size)
        smaller = _box_around(axes, exist, beside=1)
        if smaller is None:
            break
        box = smaller
    evaluated = np.ones([count] * size, dtype=np.bool_)
    for _ in range(MOST_ROUNDS[size]):
        axes = np.linspace(box[0], box[1], count, axis=1)
        xi, defects = np.array([*product(*axes)]), np.full((*evaluated.shape, size), np.nan)
        xi = section_coordinates(problem, xi[evaluated.ravel()])
        defects[evaluated] = (_after_cycles(mapped, section, xi, cycles) - xi[:, :size]) / units
        known = np.asarray(np.isfinite(defects).all(axis=-1))
        near, starts = _may_vanish(defects), [*_zeros(axes, defects)]
        is_shown = int(known.sum()) >= ENOUGH_SAMPLES[size]
        if is_shown and (starts or not near.any()):
            break
        # the defect is small, but has no zero at this resolution; or only a few samples complete their cycle
        smaller = _box_around(axes, near, SAMPLES_BESIDE) if is_shown else _box_around(axes, known, beside=1)
        if smaller is not None:
            box, evaluated = smaller, np.ones([count] * size, dtype=np.bool_)
        elif is_shown:
            evaluated, count = _finer(near), count * REFINEMENT
        elif count < MOST_SAMPLES[size]:
            count *= REFINEMENT
            evaluated = np.ones([count] * size, dtype=np.bool_)
        else:
            break
    is_possible = bool(near.any()) or (size > 1 and not is_shown)
    if size > 1 and not problem.is_open:  # the defect is far from linear between such distant samples
        starts = _polished(mapped, section, starts, cycles * dynamics.steps_per_cycle)
    if not section.stated:
        starts = [*mapped.lift(np.array(starts).reshape(-1, size))]
    return is_possible, [dict(zip(section.defining_names, start.tolist(), strict=True)) for start in starts]


def _after_cycles(mapped: StepMap, section: Section, xi: Array, cycles: int) -> Array:
    """Coordinates of a section after some cycles from all coordinates ``xi`` of a map; NaN if a walk does not return.

    A walk does not return to a section of several contacts if other contacts touch in the end.
    """
    walk, states = mapped.closed(xi)
    rows, after = np.arange(len(xi)), np.full((len(xi), section.indices.size), np.nan)
    for _ in range(cycles):
        if not rows.size:
            return after
        walked = walk(states)
        rows, states = rows[walked.completed], walked.states[walked.completed]
    if mapped.is_stated:
        after[rows] = states[:, : section.indices.size]
        return after
    ends = np.column_stack([walked.phases, walked.impacts])[walked.completed]
    impacts = mapped.dynamics.system.walker.foot_modes()
    for phases, impact in np.unique(ends, axis=0).tolist():
        of = (ends == (phases, impact)).all(axis=1)
        modes = phase_names(phases, walked.modes)  # none if a step has too many
        if not modes or section.holds(modes[-1], impacts[impact]):
            after[rows[of]] = states[of][:, section.indices]
    return after


def _polished(mapped: StepMap, section: Section, starts: Iterable[Array], steps: int) -> list[Array]:
    """The fixed points of the map of some steps to which Newton's method leads from section coordinates.

    Coordinates from which it leads to no fixed point, or to that of earlier ones, are not changed.
    """
    dynamics, points = mapped.dynamics, list[Array]()
    simulator, units = Simulator(dynamics, stepper_class(mapped.engine)), dynamics.state_units[section.indices]
    for start in starts:
        near = section.lift(start, dynamics.p, mapped.near)
        walked = ReturnMap(simulator, section, steps, near).damped_fixed_point(start, units)
        point = start if walked is None else walked[0].arcs[0].states[0][section.indices]
        is_new = all(np.abs((point - other) / units).max() > SAME for other in points)
        points.append(point if is_new else start)
    return points


def _box_around(axes: Array, shown: NDArray[np.bool_], beside: int) -> Array | None:
    """The box (2, n_xi) around samples on the grid of ``axes`` (n_xi, count); None if it is hardly smaller or empty.

    Parameters
    ----------
    shown : ndarray, shape (count, ..., count) - the samples.
    beside : number of further samples on either side.
    """
    ends, last = list[tuple[int, int]](), axes.shape[1] - 1
    for axis in range(len(axes)):
        along = np.flatnonzero(shown.any(axis=tuple(other for other in range(len(axes)) if other != axis)))
        if not along.size:
            return None
        ends.append((max(along[0] - beside, 0), min(along[-1] + beside, last)))
    if np.prod([(upper - lower) / last for lower, upper in ends]) > SHRINKS:
        return None
    return np.array([axis[list(of)] for axis, of in zip(axes, ends, strict=True)]).T


def _finer(near: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The samples of the next finer grid on which, or beside which, the coarse one has marked samples."""
    for axis, count in enumerate(near.shape):
        padded = np.pad(near, [(1, 1) if other == axis else (0, 0) for other in range(near.ndim)])
        beside = [np.take(padded, np.arange(count) + k, axis=axis) for k in range(3)]
        fine = np.rint(np.arange(REFINEMENT * count) * (count - 1) / (REFINEMENT * count - 1)).astype(int)
        near = np.take(np.logical_or.reduce(beside), fine, axis=axis)
    return near


def _may_vanish(defects: Array) -> NDArray[np.bool_]:
    """Samples near which the defect may vanish, judged by its differences to all neighbours; shape of the grid.

    Parameters
    ----------
    defects : ndarray, shape (*grid, n_xi) - NaN if the walker does not complete its cycle.
    """
    variation = np.zeros_like(defects)
    for axis in range(defects.ndim - 1):
        along, steps = (np.moveaxis(array, axis, 0) for array in (variation, np.abs(np.diff(defects, axis=axis))))
        padded = np.pad(steps, [(2, 2)] + [(0, 0)] * (steps.ndim - 1), constant_values=np.nan)
        for k in range(4):  # the two cells beside a sample, and the next one on either side
            along[:] = np.fmax(along, padded[k : k + len(along)])
    alone = np.isfinite(defects) & (variation == 0)  # there is no neighbour that shows how the defect varies
    return np.asarray(np.all(alone | (np.abs(defects) <= VARIATION * variation), axis=-1))


def _zeros(axes: Array, defects: Array) -> Iterator[Array]:
    """Zeros of the defect, shape (n_xi,), if it is linear in every simplex of the grid.

    A cell is cut into one simplex for every order of its axes: the path along these axes from its first corner to its
    last one has the corners of the simplex.
    """
    size, found = len(axes), list[Array]()
    grid, unit = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1), axes[:, 1] - axes[:, 0]
    for order in permutations(range(size)):
        corners = [np.isin(np.arange(size), order[:k]).astype(int) for k in range(size + 1)]
        cells = [tuple(slice(k, n - 1 + k) for k, n in zip(corner, grid.shape, strict=False)) for corner in corners]
        values = np.stack([defects[cell] for cell in cells], axis=-1).reshape(-1, size, size + 1)
        points = np.stack([grid[cell] for cell in cells], axis=-1).reshape(-1, size, size + 1)
        system = np.concatenate([values, np.ones((len(values), 1, size + 1))], axis=1)
        regular = np.asarray(np.isfinite(values).all(axis=(1, 2)))
        regular[regular] = np.linalg.det(system[regular]) != 0
        weights = np.linalg.solve(system[regular], np.eye(size + 1)[:, -1:])[..., 0]
        inside = (weights >= -ROUNDED).all(axis=1)
        for zero in np.einsum("nik,nk->ni", points[regular][inside], weights[inside]):
            if not any(np.all(np.abs(zero - other) <= ROUNDED * unit) for other in found):  # on a common face
                found.append(zero)
    yield from sorted(found, key=tuple)
