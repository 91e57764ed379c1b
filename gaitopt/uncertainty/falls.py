"""The mean number of steps to a fall on random floors, by many walks and from the metastable eigenvalue.

Walks that have not fallen are counted with the steps that they have taken: after a few steps the chance to fall is the
same in every step, and T steps with k falls have the mean T / k, with the interval of a Poisson process.

The eigenvalue is that of the operator that takes the chance h to survive from one step to the next,

    h_(k+1)(xi, mu) = E' [ h_k(xi', mu') ],     xi' the state after a step on a tile mu that ends on a tile mu'

over a grid of states and equally probable tiles. The largest one, lambda, is the share of walks that survive a step once
the start is forgotten: the mean number of steps is 1 / (1 - lambda). Byl & Tedrake (2009), Int. J. Robotics Research
28, 1040-1064. It needs no fall, only chances of falls.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.stats import chi2, norm

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.gait.gait import Gait
from gaitopt.model.modes import Mode
from gaitopt.problem.floor import BOUNDS, RandomFloor, Spread
from gaitopt.requests import Engine
from gaitopt.simulation.outcomes import ENDINGS
from gaitopt.verification.tiled_walks import TiledWalks

CONFIDENCE = 0.99
MOST_COORDINATES = 4
"""Largest number of coordinates of a grid of states."""
NODES = {1: 201, 2: 41, 3: 15, 4: 9}
"""Nodes of the grid along each coordinate, by their number."""
TILES = 5
"""Equally probable tiles that stand for a distribution."""
TRANSIENT = 10
"""Steps after which the start of a walk is forgotten."""
CLOUD = 200, 100
"""Number of walks and of their steps that show which states occur."""
MARGIN = 0.35
"""Room of the grid on both sides, relative to the breadth of these states."""
STILL = 1e-9
"""A coordinate whose breadth is smaller, in natural units, is constant."""
FIRST, ITERATIONS, CONVERGED = 50, 2000, 1e-12
"""Fewest and most powers of the operator: nothing is lost in the first ones, because walks need some steps to fall."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Falls:
    """Falls on random floors.

    Attributes
    ----------
    mean_steps : mean number of completed steps before a fall; None if no walk fell.
    interval : confidence interval of 99 %; its upper end is None if no walk fell.
    eigenvalue : the metastable eigenvalue, which ``mean_steps`` of 1 / (1 - eigenvalue) belongs to; None where it is not
        computed.
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
    """Completed steps of each of some walks, negative where it has not fallen, and numbers of falls by ending.

    Parameters
    ----------
    floor : of the walks; each has the stream of its number.
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
    fell, outside = np.signbit(completed) == 0, (1 - CONFIDENCE) / 2
    total, falls = float(np.abs(completed).sum()), int(fell.sum())
    if falls == completed.size and falls > 1:
        mean = total / falls
        half = float(norm.ppf(1 - outside) * completed.std(ddof=1) / np.sqrt(falls))
        return mean, (max(mean - half, 0.0), mean + half)
    low = 2 * total / float(chi2.ppf(1 - outside, 2 * falls + 2))
    if not falls:
        return None, (low, None)
    return total / falls, (low, 2 * total / float(chi2.ppf(outside, 2 * falls)))


def metastable_eigenvalue(gait: Gait, floor: RandomFloor, engine: Engine, *, should_stop: Stop = None) -> float | None:
    """The share of walks that survive a step once the start is forgotten.

    None for tiles of other heights or slopes, after which a state has more coordinates than the section, for gaits of
    several steps, and for sections of more than four coordinates.
    """
    section = gait.system.section(gait.cycle)
    if {*floor.spreads} != {"friction"} or len(gait.steps) > 1 or not section.stated:
        return None
    section = gait.system.section(Mode.SLIP_FORWARD)
    units = gait.dynamics.state_units[section.indices]
    seen = _cloud(gait, floor, engine, section.indices)
    if len(seen) < 2:
        return None
    low, high = seen.min(axis=0), seen.max(axis=0)
    moves = np.flatnonzero((high - low) / units > STILL)
    if not 1 <= moves.size <= MOST_COORDINATES:
        return None
    room = MARGIN * (high - low)
    low, high, count = low - room, high + room, NODES[moves.size]
    axes = [np.linspace(low[k], high[k], count) for k in moves]
    nodes = np.tile(seen.mean(axis=0), (count**moves.size, 1))
    nodes[:, moves] = np.array(list(product(*axes)))
    states = np.array([section.lift(row, gait.dynamics.p) for row in nodes])
    tiles = equally_probable(floor.spreads["friction"], TILES)
    places, alive = np.empty((TILES, TILES, len(nodes), moves.size)), np.zeros((TILES, TILES, len(nodes)), dtype=bool)
    for j, k in product(range(TILES), repeat=2):
        if should_stop is not None and should_stop():
            raise KeyboardInterrupt
        pair = np.tile([tiles[j], tiles[k]], (len(nodes), 1))
        good = np.flatnonzero(np.isfinite(states).all(axis=1))
        walks = TiledWalks(gait.dynamics, states[good], {"friction": pair[good]}, engine)
        _, outcomes = walks.step()
        alive[j, k, good] = outcomes.completed
        after = outcomes.states[:, section.indices][:, moves]
        places[j, k, good] = (after - low[moves]) / (high - low)[moves] * (count - 1)
    return _largest(places, alive, (count,) * moves.size)


def _largest(places: Array, alive: Array, shape: tuple[int, ...]) -> float:
    """The largest eigenvalue, by powers of the operator on chances to survive."""
    chance, value = np.ones((len(places), *shape)), 1.0
    where = np.nan_to_num(np.clip(places, 0, np.array(shape) - 1))
    for iteration in range(ITERATIONS):
        following = np.zeros((len(places), alive.shape[2]))
        for j, k in product(range(len(places)), repeat=2):
            seen = map_coordinates(chance[k], where[j, k].T, order=1, mode="nearest")
            following[j] += np.where(alive[j, k], seen, 0.0) / len(places)
        largest = float(following.max())
        if not largest > 0:
            return 0.0
        chance = (following / largest).reshape(chance.shape)
        if iteration >= FIRST and abs(largest - value) < CONVERGED:
            break
        value = largest
    return largest


def _cloud(gait: Gait, floor: RandomFloor, engine: Engine, indices: Array) -> Array:
    """Section coordinates of walks on random floors, once their start is forgotten."""
    walks, steps = CLOUD
    rows = [floor.arrays(steps + 1, -1 - walk & 0x7FFFFFFF) for walk in range(walks)]
    floors = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    walking, seen = TiledWalks(gait.dynamics, np.tile(gait.state, (walks, 1)), floors, engine), list[Array]()
    while walking.walking.size and walking.steps < steps:
        walking.step()
        seen.append(walking.states[walking.walking][:, indices])
    late = seen[TRANSIENT:] or seen
    return np.vstack(late)


def equally_probable(spread: Spread, count: int) -> Array:
    """The medians of ``count`` equally probable parts of a distribution; shape (count,)."""
    parts = (np.arange(count) + 0.5) / count
    if not spread.normal:
        return np.asarray(spread.first + (spread.second - spread.first) * parts)
    least = BOUNDS["friction"][0]
    low = max(norm.cdf(-3.0), norm.cdf((least - spread.first) / spread.second)) if spread.second else 0.0
    high = norm.cdf(3.0)
    return np.asarray(spread.first + spread.second * norm.ppf(low + (high - low) * parts))
