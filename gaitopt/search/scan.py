"""A scan for gaits of one step: the defect of the return map over a whole section of one or two coordinates.

    d(xi) = P(xi) - xi,        a gait is a zero of d

A scan takes a few milliseconds and rules out points of a sweep on which a search would spend a tenth of a second. A
point is ruled out if d has no zero at any sample and, judging by its variation, none between or beyond the samples.
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
"""Number of samples along each coordinate, for sections with one or two coordinates."""
ENOUGH_SAMPLES, MOST_ROUNDS, REFINEMENT = 12, 4, 2
"""Number of samples from which the walker has to complete its step; largest number of rounds; and factor of the number
of samples in the next round if no sample completes its step."""
SAMPLES_BESIDE = 2
"""The next round covers the samples near which the defect may vanish, and this many samples on either side."""
SWEEP_STEPS = 10**6
"""Number of steps for which the engine of a sweep is chosen."""
VARIATION = 3.0
"""The defect may change by this multiple of its largest difference between neighbouring samples."""
NO_FIXED_POINT = "the return map has no fixed point"
"""The message about a problem without a gait."""


def scanned(problem: Problem) -> bool:
    """Whether the section of a problem is small enough to be scanned."""
    if problem.is_open or problem.is_design or problem.walker.steps_per_cycle() > 1:
        return False
    if not problem.map_section.stated:
        return False
    coordinates = len(problem.walker.section_names(slipping=problem.cycle.impact.slips))
    known = coordinates == 1 or (coordinates == 2 and choose_engine(Engine.AUTO, steps=SWEEP_STEPS) is Engine.HEYOKA)
    return known and len(problem.cycle.steps) == 1


def possible_gaits(problem: Problem) -> tuple[bool, list[dict[str, float]]]:
    """Whether a problem can have a gait of any mode sequence, and section states near the gaits that the scan suggests.

    Parameters
    ----------
    problem : a problem for which ``scanned`` is true.
    """
    walker, slipping = problem.walker, problem.cycle.impact.slips
    names = walker.section_names(slipping=slipping)
    engine = choose_engine(Engine.AUTO, steps=SWEEP_STEPS)
    mapped = step_map(problem, None, engine)
    units = mapped.dynamics.state_units[mapped.dynamics.system.section(Mode.SLIP_FORWARD).indices][: len(names)]
    guess = {} if problem.start is None else problem.start.state
    sizes = {"dx": SLIP} | dict.fromkeys(type(walker).section, ANGLE)
    half = np.array([sizes.get(name, FASTEST) * unit for name, unit in zip(names, units, strict=True)])
    half = np.maximum(half, [2 * abs(guess.get(name, 0.0)) for name in names])
    count, (lower, upper), starts = SAMPLES[len(names)], (-half, half), list[float]()
    for _ in range(MOST_ROUNDS):
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
        if known.size >= ENOUGH_SAMPLES:
            if starts or not near.any():
                break
            known, beside = (
                np.flatnonzero(near),
                SAMPLES_BESIDE,
            )  # the defect is small, but has no zero at this resolution
        if known.size:  # look closer at the range in which steps are completed, or the defect may vanish
            ends = max(known[0] - beside, 0), min(known[-1] + beside, count - 1)
            lower, upper = xi[[ends[0]], :1].ravel(), xi[[ends[1]], :1].ravel()
        else:
            count *= REFINEMENT
    return bool(near.any()), [{names[0]: start} for start in starts]


def _may_vanish(defects: Array) -> Array:
    """Samples near which the defect may vanish, judged by its differences to all neighbours; shape of the grid.

    Parameters
    ----------
    defects : ndarray, shape (*grid, n_xi) - NaN if the walker does not complete its step.
    """
    variation = np.zeros_like(defects)
    for axis in range(defects.ndim - 1):
        along, steps = (np.moveaxis(array, axis, 0) for array in (variation, np.abs(np.diff(defects, axis=axis))))
        padded = np.pad(steps, [(2, 2)] + [(0, 0)] * (steps.ndim - 1), constant_values=np.nan)
        for k in range(4):  # the two cells beside a sample, and the next one on either side
            along[:] = np.fmax(along, padded[k : k + len(along)])
    alone = np.isfinite(defects) & (variation == 0)  # there is no neighbour that shows how the defect varies
    return np.asarray(np.all(alone | (np.abs(defects) <= VARIATION * variation), axis=-1))


def _crossings(xi: Array, defects: Array) -> Iterator[float]:
    """Points at which the defect changes its sign between neighbouring samples."""
    for k in np.flatnonzero(defects[:-1] * defects[1:] <= 0):
        slope = defects[k + 1] - defects[k]
        yield float(xi[k] - defects[k] / slope * (xi[k + 1] - xi[k])) if slope else float(xi[k])
