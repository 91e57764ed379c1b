"""The mean number of steps to a fall on random floors, by many walks and from the metastable eigenvalue.

**By many walks.** Walks that have not fallen count with the steps that they have taken: after a few steps the
probability of a fall is the same in every step, so that k falls in T steps give the mean T / k, with the interval of a
Poisson process.

**From the eigenvalue.** After many steps, the states of the walks that have not fallen have a distribution that no
longer changes, the metastable one. The share of walks that survive a step is then the largest eigenvalue of the
operator of one step in which falls are removed, and the mean number of steps is 1 / (1 - eigenvalue). Byl & Tedrake
(2009), Int. J. Robotics Research 28, 1040-1064, compute the eigenvalue on a mesh of states. Interpolation on a mesh
spreads the states by about a cell in every step, which would change the probability of rare falls. Here the cells of
the mesh contain weighted walks instead, so that a cell may represent one walk of 1e20:

    step         each walk takes a step, and lands on a tile of its own
    fall         1 - eigenvalue = the weight of the walks that fall; they are removed, and the rest is scaled to one
    resampling   in each cell, walks are drawn from its walks, and share the weight of the cell equally

With many walks the result is right for every mesh; a good one only makes it precise. Huber & Kim (1996), Biophysical
J. 70, 97-110; Zhang, Jasnow & Zuckerman (2010), J. Chem. Phys. 132, 054107. A cell with much weight has more walks, so
that no walk has much of it. Walks with little weight land more often on tiles near the ends of their distribution, and
lose weight by it. The others do not: resampling would replace walks by copies of others in every step, and after the
steps in which a fall develops many walks would have one ancestor, and fall together.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop, raise_if_stopped
from gaitopt.display import counted
from gaitopt.gait.gait import Gait
from gaitopt.problem.floor import BOUNDS, RandomFloor
from gaitopt.requests import Engine
from gaitopt.simulation.outcomes import ENDINGS, StepOutcomes
from gaitopt.verification.tiled_walks import TiledSteps, TiledWalks

CONFIDENCE = 0.99
"""Level of the confidence intervals."""
SKEWED = 0.995
"""Level of Student's quantile for the means of blocks. As these are skewed, intervals with the quantile of
``CONFIDENCE`` contain the mean with only 98.1 to 98.6 %, and those with this one with 99.0 to 99.4 %, measured on a
rimless wheel."""
TRANSIENT, BLOCK, MOST_BLOCKS = 60, 40, 20
"""Number of steps after which the weighted walks no longer depend on their start, number of steps in a block, over
which the falls are averaged, and largest number of blocks."""
FEWEST_BLOCKS, EMPTY_BLOCKS, PRECISE = 4, 8, 0.15
"""After the first number of blocks, the search ends as soon as the logarithm of the mean is known to the precision
``PRECISE``, or continues with a mesh if falls are rare. It ends after the second number of blocks without a fall."""
WALKS, FEWEST_WALKS, MOST_CELLS = 2000, 4, 1000
"""Number of weighted walks, smallest number of walks in a cell, and largest number of cells."""
FEWEST_FALLS = 50
"""Number of falls that walks of equal weight must be expected to see in all blocks; if they see fewer, the search
continues with a mesh."""
HEAVY = 0.4 / WALKS
"""Walks with more weight land on tiles as often as these occur. The blocks of a rimless wheel that falls once in 1.8e7
steps then have a standard deviation of 0.8 times their mean; with a limit of 5e-5 it is 1.0 times, and with one of 1e-6
2.6 times."""
WORST_STEPS = 100
"""If no walk falls, walks take this number of steps over tiles at the ends of their distributions."""
CELL, WIDER, WIDE, LEVELS = 0.3, 1.1, 4.0, 8
"""Size of a cell in standard deviations of the states, and the factor by which it grows while there are too many cells.
The distribution of each quantity of a tile is divided into ``LEVELS`` intervals, or into fewer if cells are larger than
``WIDE``."""
SMALLEST_VARIANCE, SMALLEST_WEIGHT = 1e-16, 1e-150
"""Directions with a smaller variance, in natural units, are not divided into cells; walks with a smaller weight are
left out."""
MOST_COORDINATES = 4
"""Largest number of section coordinates: the walks would not fill a mesh in more dimensions."""


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
        raise_if_stopped(should_stop)
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


def metastable(gait: Gait, floor: RandomFloor, engine: Engine, *, should_stop: Stop = None) -> dict[str, Any]:
    """The metastable eigenvalue by weighted walks, with the mean number of steps to a fall and its interval of 99 %.

    All three are None, with a ``reason``, if no walk falls, if all fall at once, for a section with more than four
    coordinates, and without batches, which need heyoka and a walker on one foot.
    """
    n_xi, names = len(gait.system.section(gait.cycle).names), tuple(floor.spreads)
    if n_xi > MOST_COORDINATES:
        return _unknown(f"the section has {counted(n_xi, 'coordinate')}, but a mesh fills at most {MOST_COORDINATES}")
    if engine is not Engine.HEYOKA or not gait.system.walker.stands_on_one():
        return _unknown("weighted walks need heyoka, and a walker that stands on one foot")
    random, steps = np.random.default_rng(floor.seed), TiledSteps(gait.dynamics, drops=False, uneven=not floor.is_even)
    walks = _Walks(gait, floor, steps, _as_they_occur(random.random((WALKS, len(names)))))
    w, cells, has_fallen = np.full(WALKS, 1 / WALKS), np.zeros(WALKS, dtype=np.intp), False
    for most_cells in (1, MOST_CELLS):  # unless falls are rare, equal weights give the smallest error
        falls, start = list[float](), walks.n + TRANSIENT
        while not _is_enough(falls, most_cells == 1):
            raise_if_stopped(should_stop)
            # step
            orders = [np.lexsort((random.random(w.size), cells)) for _ in names]
            ahead = np.stack([_strata(cells, random.random(w.size), order) for order in orders], axis=1)
            heavy = w > HEAVY
            ahead[heavy] = _as_they_occur(ahead[heavy])
            outcomes = walks.step(ahead)
            w = np.where(heavy, w, w * _tile_weights(ahead))
            # fall
            has_fallen = has_fallen or not outcomes.completed.all()
            falls += [float(w[~outcomes.completed].sum())] if walks.n > start else []
            on = outcomes.completed & (w > SMALLEST_WEIGHT)
            if not on.any():
                return _unknown("all walks fall at once")
            walks.keep(on)
            w = w[on] / w[on].sum()
            # resampling
            y = walks.z / gait.dynamics.state_units
            at, w, cells = _resampled(_cells(y, walks.under, w, most_cells), w, random)
            walks.keep(at)
        share, error = _share(falls)
        if not _are_rare(falls):
            break
    if share:
        ends = [float(np.exp(sign * error)) / share for sign in (-1, 1)]
        return {"eigenvalue": 1 - share, "mean_steps": 1 / share, "interval": ends, "reason": None}
    fell = _falls_at_ends(gait, floor, steps, random, should_stop)
    rare = "extremely rare" if has_fallen or fell else "impossible or extremely rare"
    rarest = f"although the rarest of {w.size} walks stood for one of {1 / w.min():.0e}"
    return _unknown(
        f"no walk fell in the last {len(falls)} steps, {rarest}: falls are {rare}; {fell or 'none'} of {WALKS} walks "
        f"over {WORST_STEPS} tiles at the ends of the distributions fell"
    )


def _unknown(reason: str) -> dict[str, Any]:
    return {"eigenvalue": None, "mean_steps": None, "interval": None, "reason": reason}


class _Walks:
    """Walks of a gait on random tiles, all in the same step.

    A tile is stated by a number s from 0 to 1 for each of its quantities: the share s^3 (10 - 15 s + 6 s^2) of the
    distribution is below it. Uniform numbers are at the ends of the distribution more often than the tiles of a floor.

    Attributes
    ----------
    n : number of completed steps.
    z : ndarray, shape (m, n_z) - states just after the last impact.
    under : ndarray, shape (m, n_quantities) - the tiles under the stance feet.
    """

    def __init__(self, gait: Gait, floor: RandomFloor, steps: TiledSteps, under: Array) -> None:
        self.n, self.z, self.under = 0, np.tile(gait.state, (len(under), 1)), under
        self._floor, self._steps, self._cycle = floor, steps, gait.dynamics.steps_per_cycle
        self._first = self.z

    def step(self, ahead: Array) -> StepOutcomes:
        """Take a step onto the tiles ``ahead``, shape (m, n_quantities). The caller then leaves out walks that fell."""
        self._first = self._first if self.n % self._cycle else self.z
        tiles = self._tiles(self.under), self._tiles(ahead)
        outcomes = self._steps.step(self.n, self.z, *tiles, self._first)
        self.n, self.z, self.under = self.n + 1, outcomes.states, ahead
        return outcomes

    def keep(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> None:
        """Continue with some walks, of which one may occur more than once."""
        self.z, self.under, self._first = self.z[rows], self.under[rows], self._first[rows]

    def _tiles(self, s: Array) -> dict[str, Array]:
        """The quantities of tiles by name, shape (m,) each."""
        shares = s**3 * (10 + s * (6 * s - 15))
        spreads = zip(self._floor.spreads.items(), shares.T, strict=True)
        return {name: spread.quantiles(share, BOUNDS[name][0]) for (name, spread), share in spreads}


def _as_they_occur(shares: Array) -> Array:
    """The numbers of tiles with these shares of their distributions below them; uniform shares give random tiles."""
    from scipy.special import betaincinv  # the inverse of the shares of ``_Walks``

    return np.asarray(betaincinv(3, 3, shares))


def _is_enough(falls: list[float], has_mesh_left: bool) -> bool:
    """Whether the blocks suffice, or walks of equal weight would see too few falls."""
    blocks = len(falls) // BLOCK
    if len(falls) % BLOCK or blocks < FEWEST_BLOCKS:
        return False
    share, error = _share(falls)
    most = MOST_BLOCKS if share else EMPTY_BLOCKS
    return error <= PRECISE or blocks >= most or (has_mesh_left and _are_rare(falls))


def _are_rare(falls: list[float]) -> bool:
    """Whether walks of equal weight would see few falls in all blocks, by the first of their blocks."""
    return float(np.mean(falls[: FEWEST_BLOCKS * BLOCK])) * WALKS * BLOCK * MOST_BLOCKS < FEWEST_FALLS


def _share(falls: list[float]) -> tuple[float, float]:
    """The mean share of walks that fall in a step, and the error of its logarithm at ``CONFIDENCE``.

    The means of blocks are independent, but skewed, because few walks with much weight bring most of the falls.
    """
    from scipy.special import stdtrit

    means = np.reshape(falls, (-1, BLOCK)).mean(axis=1)
    t, share = float(stdtrit(means.size - 1, (1 + SKEWED) / 2)), float(means.mean())
    return share, t * float(means.std(ddof=1)) / (np.sqrt(means.size) * share) if share else np.inf


def _strata(cells: NDArray[np.intp], within: Array, order: NDArray[np.intp]) -> Array:
    """Numbers from 0 to 1, one in each of as many equal intervals as a cell has walks, for the sorted ``cells``.

    Parameters
    ----------
    within : ndarray, shape (m,) - position of the number of a walk in its interval, from 0 to 1.
    order : the walks cell by cell, in the order of their intervals.
    """
    sizes, rank = np.bincount(cells), np.empty(cells.size)
    rank[order] = np.arange(cells.size)
    return np.asarray((rank - (np.cumsum(sizes) - sizes)[cells] + within) / sizes[cells])


def _tile_weights(s: Array) -> Array:
    """The density of the tiles of a floor at uniform numbers, shape (m,): the derivative of the shares by s."""
    return np.asarray(np.prod(30 * s**2 * (1 - s) ** 2, axis=1))


def _cells(y: Array, s: Array, w: Array, most: int) -> NDArray[np.intp]:
    """The cell of each walk: in the principal directions of the states ``y``, and by the tile under its foot."""
    if most == 1:
        return np.zeros(len(w), dtype=np.intp)
    deviations = y - w @ y
    variances, directions = np.linalg.eigh(deviations.T * w @ deviations)
    varied = variances > SMALLEST_VARIANCE
    along, size = deviations @ directions[:, varied] / np.sqrt(variances[varied]), CELL
    while True:
        rows = np.floor(np.hstack([along / size, s * LEVELS * min(1.0, WIDE / size)])).astype(np.intp)
        _, cells = np.unique(rows, axis=0, return_inverse=True)
        if cells.max() < most:
            return cells.ravel()
        size *= WIDER


def _resampled(
    cells: NDArray[np.intp], w: Array, random: np.random.Generator
) -> tuple[NDArray[np.intp], Array, NDArray[np.intp]]:
    """The walks that continue, cell by cell, their weights, and their cells.

    A cell has more walks if it has much weight, so that no walk has much of it.
    """
    totals = np.bincount(cells, w)
    count, order = totals.size, np.argsort(cells, kind="stable")
    more = WALKS / 2 if count > 1 else 0
    sizes = max(FEWEST_WALKS, WALKS // count) + np.rint(more * totals).astype(np.intp)
    up_to = np.cumsum(w[order] / totals[cells[order]])
    last = np.cumsum(np.bincount(cells)) - 1
    up_to[last] = np.arange(1, count + 1)  # without rounding
    of = np.repeat(np.arange(count), sizes)
    at = of + _strata(of, random.random(count)[of], np.arange(of.size))
    chosen = order[np.searchsorted(up_to, at, side="right").clip(max=w.size - 1)]
    return chosen, (totals / sizes)[of], of


def _falls_at_ends(
    gait: Gait, floor: RandomFloor, steps: TiledSteps, random: np.random.Generator, should_stop: Stop
) -> int:
    """The number of walks that fall over tiles at the ends of the distributions, from the median tile."""
    walks = _Walks(gait, floor, steps, np.full((WALKS, len(floor.spreads)), 0.5))
    while len(walks.z) and walks.n < WORST_STEPS:
        raise_if_stopped(should_stop)
        walks.keep(walks.step(random.integers(2, size=walks.under.shape).astype(float)).completed)
    return WALKS - len(walks.z)
