"""Many walks, each on a floor of its own; heyoka advances them in batches, scipy one after the other.

The floors of m walks are arrays of friction, height and slope with a row per walk and a column per tile; the last tile
repeats, and friction may have a third axis for its static and its kinetic coefficient. Once all floors are nominal from
a tile on, the nominal system is simulated there, because it takes less time.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.gait.gait import Gait
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import FOOT, SWING_FOOT
from gaitopt.problem.floor import QUANTITIES, Floor
from gaitopt.requests import Engine
from gaitopt.simulation.ground import OnTiles, Tiles, check_floor
from gaitopt.simulation.outcomes import ARRAYS, UNDEFINED_STATE, StepOutcomes, stack_outcomes
from gaitopt.simulation.simulator import Simulator, stepper_class

Rows = NDArray[np.intp]
Floors = Mapping[str, Array]
"""Friction, height and slope of the tiles of m walks by name, shape (m, tiles) each, or (m, tiles, 2) for friction. A
quantity that is left out is nominal."""


def repeated(floor: Floor, walks: int) -> Floors:
    """The same floor for some walks."""
    stated, tiles = floor.to_record(), [floor.tile(n) for n in range(len(floor))]
    arrays = {name: np.array([getattr(tile, name) for tile in tiles], dtype=float) for name in stated}
    return {name: np.broadcast_to(values, (walks, *values.shape)) for name, values in arrays.items()}


def floor_of(floors: Floors, row: int) -> Floor:
    """The floor of one walk.

    Raises
    ------
    ProblemError
        If a value is out of its range.
    """
    return Floor(**{name: values[row].tolist() for name, values in floors.items()})


class TiledWalks:
    """Walks on tiles from given states, step by step.

    Parameters
    ----------
    dynamics : the walker on the nominal floor, in its first step.
    states : ndarray, shape (m, n_z) - states just after an impact.
    floors : the floors of the walks; None for the nominal floor.
    engine : ``scipy`` or ``heyoka``.

    Attributes
    ----------
    states : ndarray, shape (m, n_z) - the latest states of the walks.
    walking : indices of the walks that have not ended.
    steps : number of steps that each of these walks has completed.
    in_batches : whether heyoka advances them together.

    Raises
    ------
    ProblemError
        If the walker cannot walk on these floors.
    """

    def __init__(self, dynamics: Dynamics, states: Array, floors: Floors | None, engine: Engine) -> None:
        self.states, self.walking, self.steps = states.copy(), np.arange(len(states)), 0
        self._first = self.states.copy()
        self._dynamics, self._floors, walker = dynamics, floors or {}, dynamics.system.walker
        self.in_batches = engine is Engine.HEYOKA and walker.stands_on_one()
        self._one_by_one = list[Iterator[StepOutcomes]]()
        if self._floors and len(states):
            check_floor(dynamics.system, floor_of(self._floors, 0))
        if self.in_batches:
            self._batches = _Batches(dynamics, self._floors)
        else:
            self._one_by_one = [self._walk(state, row, stepper_class(engine)) for row, state in enumerate(states)]

    def step(self) -> tuple[Rows, StepOutcomes]:
        """Advance the walks that have not ended by one step; return their indices and how their steps ended."""
        rows = self.walking
        if self.in_batches:
            if not self.steps % self._dynamics.steps_per_cycle:
                self._first[rows] = self.states[rows]
            outcomes = self._batches.step(self.steps, rows, self.states[rows], self._first[rows])
        else:
            outcomes = _joined([next(self._one_by_one[row]) for row in rows])
        self.states[rows], self.steps = outcomes.states, self.steps + 1
        self.walking = rows[outcomes.completed]
        return rows, outcomes

    def cycle(self, rows: Rows | None = None) -> StepOutcomes:
        """Advance walks by ``Dynamics.steps_per_cycle`` steps, and return how they ended.

        Parameters
        ----------
        rows : indices of the walks to be advanced; the others end. By default all are advanced.
        """
        if rows is not None:
            self.leave(np.setdiff1d(self.walking, rows))
        rows, walked = self.step()
        for _ in range(1, self._dynamics.steps_per_cycle):
            if self.walking.size:
                after, step = self.step()
                walked = walked.followed_by(step, np.searchsorted(rows, after))
        return walked

    def leave(self, rows: Rows) -> None:
        """End some walks."""
        self.walking = np.setdiff1d(self.walking, rows)

    def _walk(self, state: Array, row: int, stepper: type) -> Iterator[StepOutcomes]:
        if not np.isfinite(state).all():
            yield stack_outcomes([UNDEFINED_STATE], state[None], self._dynamics.system)
            return
        floor = floor_of(self._floors, row) if self._floors else None
        simulator = Simulator(self._dynamics, stepper, floor=floor)
        start = state
        for outcome in simulator.each_step(state):
            found = stack_outcomes([outcome], start[None], simulator.system)
            start = found.states[0]
            yield found


def _joined(blocks: list[StepOutcomes]) -> StepOutcomes:
    joined: dict[str, Any] = {name: np.concatenate([getattr(block, name) for block in blocks]) for name in ARRAYS}
    return replace(blocks[0], **joined)


class TiledSteps:
    """Steps of many walks of a walker on one foot, each between two tiles of its own, integrated together by heyoka.

    Parameters
    ----------
    dynamics : the walker on the nominal floor, in its first step.
    drops, uneven : see ``ground.floor_system``.
    """

    def __init__(self, dynamics: Dynamics, *, drops: bool, uneven: bool) -> None:
        from gaitopt.simulation.heyoka_batch import BatchSimulator  # needs heyoka, which is optional

        self.on_tiles = OnTiles(dynamics, drops=drops, uneven=uneven)
        level = self.on_tiles.parameters(0, {}, np.zeros((1, dynamics.system.n_z)))[0]
        self._simulator = BatchSimulator(Dynamics(self.on_tiles.system, level))

    def step(self, n: int, states: Array, under: Floors, ahead: Floors, first: Array) -> StepOutcomes:
        """Step ``n`` from states, shape (m, n_z), on tiles ``under`` the foot to those ``ahead``, shape (m, ...).

        Parameters
        ----------
        first : ndarray, shape (m, n_z) - states in which the cycles began.
        """
        zero, height = np.zeros(len(states)), "height"
        rise = ahead[height] - under[height] if height in under else zero
        tiles = {
            name: Tiles(friction=_pairs(of.get("friction")), height=up, slope=of.get("slope", zero))
            for name, of, up in ((FOOT, under, zero), (SWING_FOOT, ahead, rise))
        }
        return self._simulator.step(states, self.on_tiles.parameters(n, tiles, states), first, n)


def _pairs(friction: Array | None) -> Array | None:
    return friction if friction is None or friction.ndim > 1 else np.stack([friction, friction], axis=1)


class _Batches:
    """Steps of many walks of a walker that stands on one foot on their floors."""

    def __init__(self, dynamics: Dynamics, floors: Floors) -> None:
        from gaitopt.simulation.heyoka_batch import BatchSimulator  # needs heyoka, which is optional

        self._nominal = [BatchSimulator(each) for each in dynamics.steps]
        self._floors = {name: np.asarray(floors[name], dtype=float) for name in QUANTITIES if name in floors}
        self._tiles = max((values.shape[1] for values in self._floors.values()), default=0)
        if (friction := self._floors.get("friction")) is not None and friction.ndim == 2:
            self._floors["friction"] = np.stack([friction, friction], axis=2)
        drops = "friction" in self._floors and bool(np.ptp(self._floors["friction"], axis=2).any())
        uneven = any(self._floors[name].any() for name in ("height", "slope") if name in self._floors)
        self._tiled = TiledSteps(dynamics, drops=drops, uneven=uneven) if self._floors else None
        self._last = self._last_special()

    def step(self, n: int, rows: Rows, states: Array, first: Array) -> StepOutcomes:
        if self._tiled is None or n > self._last:
            return self._nominal[n % len(self._nominal)].step(states, first=first, n=n)
        return self._tiled.step(n, states, self._tile(n, rows), self._tile(n + 1, rows), first)

    def _tile(self, n: int, rows: Rows) -> Floors:
        return {name: values[rows, min(n, values.shape[1] - 1)] for name, values in self._floors.items()}

    def _last_special(self) -> float:
        """Number of the last step that needs the system on tiles; infinite if all steps need it, -1 if none does.

        A step needs it if it begins or ends on a tile that is not nominal, or begins on a tile whose height differs
        from that of the tile before it.
        """
        special = np.zeros(self._tiles, dtype=bool)
        for name, values in self._floors.items():
            full = values[:, np.minimum(np.arange(self._tiles), values.shape[1] - 1)]
            assert self._tiled is not None
            nominal = {"friction": self._tiled.on_tiles.nominal_friction, "height": full[:, -1:]}.get(name, 0.0)
            changed = np.reshape(full != nominal, (len(full), self._tiles, -1))
            special |= changed.any(axis=(0, 2))
        if not special.any():
            return -1.0
        return float("inf") if special[-1] else float(np.flatnonzero(special)[-1] + 1)


def returning(
    gait: Gait, states: Array, floors: Floors | None, engine: Engine, *, steps: int, distance: float
) -> NDArray[np.bool_]:
    """Whether each walk returns to a gait: its section coordinates come close to those of the gait.

    Parameters
    ----------
    states : ndarray, shape (m, n_z) - states just after an impact.
    floors : see ``TiledWalks``.
    steps : largest number of steps.
    distance : largest difference of a coordinate, in natural units, at which a walk has returned.
    """
    section, units = gait.system.section(gait.cycle), gait.dynamics.state_units
    names, at = gait.system.state_names, section.indices
    known = np.array([step.arcs[0].states[0][at] for step in gait.steps]) / units[at]
    tiles = 0 if not floors else max(values.shape[1] for values in floors.values())
    assert len(names) == states.shape[1]
    walks, back = TiledWalks(gait.dynamics, states, floors, engine), np.zeros(len(states), dtype=bool)
    while walks.walking.size and walks.steps < steps:
        walks.step()
        rows = walks.walking
        if walks.steps < tiles:  # the floor is not yet behind the walker
            continue
        near = np.abs(walks.states[rows][:, None, at] / units[at] - known).max(axis=2).min(axis=1) <= distance
        back[rows[near]] = True
        walks.leave(rows[near])
    return back
