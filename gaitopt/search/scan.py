"""Where a gait of one step can be: the defect of the return map over a whole section of one or two coordinates.

    d(xi) = P(xi) - xi,        a gait is a zero of d

A few milliseconds of walking rule out a place of a sweep that a search would leave after a tenth of a second. A place
is ruled out if d has no zero at any sample, nor between or beyond them as far as its variation there allows.
"""

from collections.abc import Iterator
from itertools import product

import numpy as np

from gaitopt.arrays import Array
from gaitopt.model.modes import Mode
from gaitopt.problem.problem import Problem
from gaitopt.requests import Engine
from gaitopt.search.starts import ANGLE, FASTEST, SLIP
from gaitopt.simulation.engine import choose_engine
from gaitopt.verification.step_map import step_map

SAMPLES = {1: 64, 2: 24}
"""Samples along each coordinate of a section with one or two coordinates."""
ENOUGH, ROUNDS, FINER = 12, 4, 2
"""Samples from which the walker should complete its step; rounds of samples; and the factor by which there are more
samples in the next round, if there is none of these."""
BESIDE = 2
"""Samples on either side of those next to which the defect may vanish, between which the next round looks closer."""
MANY = 10**6
"""Steps of a sweep, for the choice of the engine."""
VARIATION = 3.0
"""The defect may fall by this multiple of its largest difference between neighbouring samples."""
EMPTY = "the return map has no fixed point"
"""Why a problem has no gait."""


def scanned(problem: Problem) -> bool:
    """Whether the section of a problem is small enough to be scanned."""
    if problem.is_open or problem.is_design or problem.walker.steps_per_cycle() > 1:
        return False
    if not problem.map_section.stated:
        return False
    coordinates = len(problem.walker.section_names(slipping=problem.cycle.impact.slips))
    known = coordinates == 1 or (coordinates == 2 and choose_engine(Engine.AUTO, steps=MANY) is Engine.HEYOKA)
    return known and len(problem.cycle.steps) == 1


def possible_gaits(problem: Problem) -> tuple[bool, list[dict[str, float]]]:
    """Whether a problem can have a gait of any mode sequence, and section states next to gaits that it seems to have.

    Parameters
    ----------
    problem : one for which ``scanned`` is true.
    """
    walker, slipping = problem.walker, problem.cycle.impact.slips
    names = walker.section_names(slipping=slipping)
    engine = choose_engine(Engine.AUTO, steps=MANY)
    mapped = step_map(problem, None, engine)
    units = mapped.dynamics.state_units[mapped.dynamics.system.section(Mode.SLIP_FORWARD).indices][: len(names)]
    guess = {} if problem.start is None else problem.start.state
    sizes = {"dx": SLIP} | dict.fromkeys(type(walker).section, ANGLE)
    half = np.array([sizes.get(name, FASTEST) * unit for name, unit in zip(names, units, strict=True)])
    half = np.maximum(half, [2 * abs(guess.get(name, 0.0)) for name in names])
    count, (lower, upper), starts = SAMPLES[len(names)], (-half, half), list[float]()
    for _ in range(ROUNDS):
        axes = [np.linspace(*ends, count) for ends in zip(lower, upper, strict=True)]
        xi = np.array([*product(*axes)])
        if not slipping:
            xi = np.column_stack([xi, np.zeros(len(xi))])
        walked = mapped(xi)
        known = np.flatnonzero(walked.completed)
        defects = np.where(walked.completed[:, None], walked.states - xi, np.nan)[:, : len(names)] / units
        near = _may_vanish(defects.reshape(*map(len, axes), len(names)))
        if len(names) > 1:
            break
        starts, beside = [*_crossings(axes[0], defects[:, 0])], 1
        if known.size >= ENOUGH:
            if starts or not near.any():
                break
            known, beside = np.flatnonzero(near), BESIDE  # the defect is small, but has no zero at this resolution
        if known.size:  # the part of the section that matters
            ends = max(known[0] - beside, 0), min(known[-1] + beside, count - 1)
            lower, upper = xi[[ends[0]], :1].ravel(), xi[[ends[1]], :1].ravel()
        else:
            count *= FINER
    return bool(near.any()), [{names[0]: start} for start in starts]


def _may_vanish(defects: Array) -> Array:
    """Samples next to which the defect may vanish, from its differences to all neighbours; of the grid's shape.

    Parameters
    ----------
    defects : ndarray, shape (*grid, n_xi) - NaN where the walker does not complete its step.
    """
    variation = np.zeros_like(defects)
    for axis in range(defects.ndim - 1):
        along, steps = (np.moveaxis(array, axis, 0) for array in (variation, np.abs(np.diff(defects, axis=axis))))
        padded = np.pad(steps, [(2, 2)] + [(0, 0)] * (steps.ndim - 1), constant_values=np.nan)
        for k in range(4):  # the cells beside a sample, and those beyond
            along[:] = np.fmax(along, padded[k : k + len(along)])
    alone = np.isfinite(defects) & (variation == 0)  # no neighbour says how the defect varies
    return np.asarray(np.all(alone | (np.abs(defects) <= VARIATION * variation), axis=-1))


def _crossings(xi: Array, defects: Array) -> Iterator[float]:
    """Where the defect changes its sign between neighbouring samples."""
    for k in np.flatnonzero(defects[:-1] * defects[1:] <= 0):
        slope = defects[k + 1] - defects[k]
        yield float(xi[k] - defects[k] / slope * (xi[k + 1] - xi[k])) if slope else float(xi[k])
