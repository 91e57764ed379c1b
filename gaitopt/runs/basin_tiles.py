"""A basin in its folder: tiles of states, and where every state of the grid goes."""

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import ReadOnlyArrays
from gaitopt.display import Plotted
from gaitopt.errors import StorageError
from gaitopt.gait.attractor import Attractor
from gaitopt.gait.frames import data_set
from gaitopt.gait.records import BasinRecord, differing
from gaitopt.problem import Problem
from gaitopt.problem.scalars import state_unit
from gaitopt.runs.basin import Outcomes, claim, ending_name, outcome_counts
from gaitopt.runs.grid import Grid, check_room
from gaitopt.store import read_object, read_problem, read_sealed
from gaitopt.store.manifest import read_manifest
from gaitopt.store.records import damaged, validated
from gaitopt.store.tiles import TILE_FILE, read_tile

if TYPE_CHECKING:
    from xarray import Dataset

Labels = NDArray[np.int32]

STATE_BYTES_MEMORY = 16
"""Of the labels and step counts that are held of the whole grid at once."""
BASIN_FILE = "basin.json"
NUMBER = "number"
"""Key of a tile's own number in its file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Basin(Plotted, ReadOnlyArrays):
    """Where every state of a grid goes.

    Attributes
    ----------
    problem, grid : of the request.
    base : the section coordinates that the grid does not vary.
    attractors : the gaits on which states settle; ``labels`` are indices into them.
    labels : ndarray, grid's shape - index of the gait that a state settles on, or -1.
    endings : ndarray, grid's shape - code of the ending where it does not settle, see ``Outcomes``.
    steps : ndarray, grid's shape - steps until it settled or failed.
    """

    problem: Problem
    grid: Grid
    base: dict[str, float]
    attractors: tuple[Attractor, ...]
    labels: Labels
    endings: Labels
    steps: Labels

    def __repr__(self) -> str:
        shares = [f"{gait.count / self.grid.size:.1%} {gait}" for gait in self.attractors]
        axes = ", ".join(axis.key for axis in self.grid.axes)
        return f"<Basin {self.problem.name} over {axes}: {self.grid.size} states, {', '.join(shares) or 'no gait'}>"

    def to_xarray(self) -> "Dataset":
        """Where each state goes, over the coordinates: ``gait`` (index in ``attractors``, or -1) and ``steps``.

        ``ending`` names why a walk failed; it is empty where the state settled on a gait.
        """
        keys = tuple(axis.key for axis in self.grid.axes)
        names = {code: ending_name(int(code)) for code in np.unique(self.endings)}
        failed = np.array([names[code] for code in self.endings.ravel()]).reshape(self.grid.shape)
        endings = np.where(self.labels < 0, failed, "")
        variables = {"gait": (keys, self.labels), "steps": (keys, self.steps), "ending": (keys, endings)}
        places = {axis.key: ((axis.key,), axis.values) for axis in self.grid.axes}
        return data_set(variables, places, {key: state_unit(key) for key in keys}, problem=self.problem.name)

    def to_record(self) -> dict[str, Any]:
        """One JSON object: the gaits with their shares, and the failures by name."""
        names = self.problem.walker.section_names(slipping=True)
        gaits = [
            {
                "kind": str(gait),
                "period": gait.period,
                "phases": [str(mode) for mode in gait.phases],
                "impact": str(gait.impact),
                "state": dict(zip(names, gait.state.tolist(), strict=True)),
                "states": gait.count,
                "share": gait.count / self.grid.size,
            }
            for gait in self.attractors
        ]
        return {
            "problem": self.problem.name,
            "over": [asdict(axis) for axis in self.grid.axes],
            "base": self.base,
            "states": self.grid.size,
            "gaits": gaits,
            "failures": outcome_counts(self.endings),
        }


def read_basin(place: Path) -> Basin:
    """The basin in its own folder, which lies in the run folder of its problem."""
    run, own = place.resolve().parent, place.resolve().name
    record = read_object(run, f"{own}/{BASIN_FILE}")
    stored = validated(BasinRecord, record, place / BASIN_FILE)
    grid = validated(Grid, {"axes": stored["over"]}, place / BASIN_FILE)
    check_room(grid.size, place, disk=0, memory=STATE_BYTES_MEMORY)
    basin = assembled(place, read_problem(run), grid, stored["base"])
    key = differing(record, basin.to_record())
    if key:
        raise damaged(place / BASIN_FILE, f"{key}: is not what its tiles give")
    return basin


def stored_attractor(place: Path, index: str) -> Attractor:
    """The attractor with a number, counted from 0 in the order of the table, of the basin in a folder."""
    attractors = read_basin(place).attractors
    if not index.isdecimal() or int(index) >= len(attractors):
        known = f"0 to {len(attractors) - 1}" if attractors else "none"
        raise StorageError(f"{place}@attractor.{index}: the attractors of this basin are {known}")
    return attractors[int(index)]


def assembled(place: Path, problem: Problem, grid: Grid, base: dict[str, float]) -> Basin:
    """The whole basin from its tiles, one after the other."""
    gaits = list[Attractor]()
    labels, endings, steps = np.zeros((3, grid.size), dtype=np.int32)
    done, tile = 0, 0
    while done < grid.size:
        outcomes = _tile_outcomes(place, tile, grid.size - done)
        rows = slice(done, done + len(outcomes.steps))
        labels[rows], endings[rows], steps[rows] = claim(outcomes, gaits, problem), outcomes.endings, outcomes.steps
        done, tile = rows.stop, tile + 1
    return Basin(
        problem=problem, grid=grid, base=base, attractors=tuple(gaits),
        labels=labels.reshape(grid.shape), endings=endings.reshape(grid.shape), steps=steps.reshape(grid.shape),
    )  # fmt: skip


def _tile_outcomes(place: Path, tile: int, most: int) -> Outcomes:
    """The outcomes of one tile, of no more than ``most`` states."""
    arrays = read_tile(place, tile)
    run, own = place.resolve().parent, place.resolve().name
    name = TILE_FILE.format(tile)
    if f"{own}/{name}" in read_manifest(run).files:
        read_sealed(run, f"{own}/{name}")
    number, names = arrays.pop(NUMBER, None), {f.name for f in fields(Outcomes)}
    counts = {len(np.atleast_1d(array)) for array in arrays.values()}
    if number != tile or arrays.keys() != names or len(counts) != 1 or not 0 < min(counts) <= most:
        raise StorageError(f"{place / name} is not tile {tile}: delete it, and its states are walked again")
    return Outcomes(**arrays)
