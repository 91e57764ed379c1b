"""The mean number of steps to a fall on random floors, by many walks and from the metastable eigenvalue.

Walks that have not fallen are counted with the steps that they have taken: after a few steps the chance to fall is the
same in every step, and T steps with k falls have the mean T / k, with the interval of a Poisson process.

Once its start is forgotten, a walk that has not fallen yet has a distribution of states that no longer changes, the
metastable one. The share of walks that survive a step is then the largest eigenvalue of the operator of one step in
which falls are removed, and the mean number of steps is 1 / (1 - eigenvalue). Byl & Tedrake (2009), Int. J. Robotics
Research 28, 1040-1064, find it on a mesh of states. Here many walks stand for the distribution: one that falls goes on
as a copy of another one. Burdzy, Holyst & March (2000), Commun. Math. Phys. 214, 679-703. A mesh of the compass's
three coordinates that resolves its metastable distribution would need far more steps.
"""

from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.gait.gait import Gait
from gaitopt.problem.floor import RandomFloor
from gaitopt.requests import Engine
from gaitopt.simulation.outcomes import ENDINGS
from gaitopt.verification.tiled_walks import TiledWalks

CONFIDENCE = 0.99
"""Level of the confidence intervals."""
OTHER_WALKS = 1 << 40
"""Number of the first walk for the eigenvalue; these floors are independent of those on which falls are counted."""
PARTICLES, TRANSIENT, COUNTED = 1000, 50, 200
"""Number of walks for the eigenvalue, of the steps after which their start is forgotten, and of those that count."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Falls:
    """Statistics of the falls on random floors.

    Attributes
    ----------
    mean_steps : mean number of completed steps before a fall; None if no walk fell.
    interval : confidence interval of 99 %; its upper end is None if no walk fell.
    eigenvalue : the metastable eigenvalue, from which 1 / (1 - eigenvalue) steps follow; None where it is not known.
    walks, steps : number of walks, and of all their steps.
    falls : number of falls by ending.
    """

    mean_steps: float | None
    interval: tuple[float, float | None]
    eigenvalue: float | None
    walks: int
    steps: int
    falls: dict[str, int]


def count_falls(
    gait: Gait, floor: RandomFloor, *, walks: int, steps: int, engine: Engine, first: int = 0, should_stop: Stop = None
) -> tuple[Array, dict[str, int]]:
    """The number of completed steps of each walk, negative if it has not fallen, and the number of falls by ending.

    Parameters
    ----------
    floor : random floor; each walk has the random stream of its number.
    steps : largest number of steps of a walk.
    first : number of the first walk.
    """
    rows = [floor.arrays(steps + 1, walk) for walk in range(first, first + walks)]
    floors = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    walking = TiledWalks(gait.dynamics, np.tile(gait.state, (walks, 1)), floors, engine)
    completed, endings = np.full(walks, -float(steps)), dict[str, int]()
    while walking.walking.size and walking.steps < steps:
        if should_stop is not None and should_stop():
            raise KeyboardInterrupt
        tried, outcomes = walking.step()
        fallen = ~outcomes.completed
        completed[tried[fallen]] = walking.steps - 1
        for code in outcomes.endings[fallen]:
            name = str(ENDINGS[code])
            endings[name] = endings.get(name, 0) + 1
    return completed, endings


def mean_steps(completed: Array) -> tuple[float | None, tuple[float, float | None]]:
    """The mean number of steps before a fall, and its confidence interval, from ``count_falls``."""
    from scipy.special import chdtri, ndtri  # the command line reads this module, and starts without SciPy

    fell, outside = np.signbit(completed) == 0, (1 - CONFIDENCE) / 2
    total, falls = float(np.abs(completed).sum()), int(fell.sum())
    if falls == completed.size and falls > 1:
        mean = total / falls
        half = float(ndtri(1 - outside) * completed.std(ddof=1) / np.sqrt(falls))
        return mean, (max(mean - half, 0.0), mean + half)
    low = 2 * total / float(chdtri(2 * falls + 2, outside))
    if not falls:
        return None, (low, None)
    return total / falls, (low, 2 * total / float(chdtri(2 * falls, 1 - outside)))


def metastable_eigenvalue(gait: Gait, floor: RandomFloor, engine: Engine, *, should_stop: Stop = None) -> float | None:
    """The share of walks that survive a step once the start is forgotten.

    It is None if no walk falls, if all have fallen, or without batches, which need heyoka and a walker on one foot.
    """
    steps = TRANSIENT + COUNTED
    rows = [floor.arrays(steps + 1, OTHER_WALKS + walk) for walk in range(PARTICLES)]
    floors = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    walks = TiledWalks(gait.dynamics, np.tile(gait.state, (PARTICLES, 1)), floors, engine)
    random, falls = np.random.default_rng([floor.seed, OTHER_WALKS]), 0
    if not walks.in_batches:
        return None
    for n in range(steps):
        if should_stop is not None and should_stop():
            raise KeyboardInterrupt
        tried, outcomes = walks.step()
        fallen = tried[~outcomes.completed]
        falls += fallen.size * (n >= TRANSIENT)
        if not walks.walking.size:
            return None
        walks.restart(fallen, random.choice(walks.walking, fallen.size))
    return 1 - falls / (PARTICLES * COUNTED) if falls else None
