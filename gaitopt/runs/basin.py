"""Basins of attraction: every state of a grid walks until it settles on a gait or fails.

    xi -> Pi(xi) -> Pi(Pi(xi)) -> ...     settled after m steps if Pi^m(xi) = Pi^(m-k)(xi) for a period k

A basin is stored in a subfolder of a run, as tiles of states. Each tile is stored as soon as it is finished, so that an
interrupted run resumes.
"""

import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.callbacks import Stop, raise_if_stopped
from gaitopt.display import Plotted
from gaitopt.errors import SolveError, StorageError
from gaitopt.gait.frames import data_set
from gaitopt.gait.gait import Attractor, Gait
from gaitopt.gait.records import BasinRecord
from gaitopt.problem.floor import Floor
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import state_unit
from gaitopt.requests import BasinRequest, Engine
from gaitopt.runs.grid import Grid, check_known, check_room
from gaitopt.runs.jobs import Plan, Stored
from gaitopt.simulation.engine import choose_engine
from gaitopt.simulation.ground import check_floor
from gaitopt.simulation.outcomes import ENDINGS, StepOutcomes, phase_names
from gaitopt.store.files import read_bytes, write_whole
from gaitopt.store.formats import check_agrees, json_file, validated
from gaitopt.store.run import Run
from gaitopt.systems import problem_dynamics
from gaitopt.verification.step_map import section_coordinates, step_map
from gaitopt.verification.tiled_walks import Rows
from gaitopt.workers.jobs import FailedJob, Job, ResumableJobs, key_of

if TYPE_CHECKING:
    from xarray import Dataset


Codes = NDArray[np.int64]

UNDECIDED = -1
"""Code of the ending of a walk that has not settled within the allowed steps."""
MAX_PERIOD = 4
"""Longest cycle that is recognised as a gait [steps]."""
SETTLED = 1e-6
"""Distance within which a settled state returns to itself [rad, rad/s, m/s]; its distance to the gait has this size
too."""
SAME_GAIT = 1e-3
"""Distance below which settled states are on the same gait [rad, rad/s, m/s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcomes:
    """Outcomes of walks from n states.

    Attributes
    ----------
    periods : ndarray, shape (n,) - steps per cycle of the gait that a state settled on; 0 if it did not settle.
    endings : ndarray, shape (n,) - index in ``Ending`` of a failed walk, ``UNDECIDED``, or 0 if the walk settled.
    steps : ndarray, shape (n,) - number of completed steps until then.
    states : ndarray, shape (n, k) - final section coordinates; with several contacts, the whole state. On a cycle, the
        state that comes first in lexical order.
    phases, impacts : ndarray, shape (n,) - codes of the modes of the step that led to this state, see ``StepOutcomes``.
    """

    periods: Codes
    endings: Codes
    steps: Codes
    states: Array
    phases: Codes
    impacts: Codes


def follow(
    step_map: Callable[[Array, Rows], StepOutcomes],
    xi: Array,
    max_steps: int,
    *,
    unsettled: int = 0,
    should_stop: Stop = None,
) -> Outcomes:
    """Walk from every state until it settles, fails, or has made ``max_steps`` steps.

    Parameters
    ----------
    step_map : the return map of section coordinates, or of whole states; it is also given the rows of these states.
    xi : ndarray, shape (n, k) - section coordinates just after an impact, including ``dx``; or whole states.
    unsettled : number of steps after which the floor does not change any more; no walk settles earlier.
    should_stop : polled before every step.
    """
    n = len(xi)
    # the last states, the latest first, and the modes of the steps that led to them
    past = np.full((MAX_PERIOD, *xi.shape), np.nan)
    past_steps = np.zeros((MAX_PERIOD, n, 2), dtype=np.int64)
    past[0] = xi
    periods, steps, endings = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), np.full(n, UNDECIDED)
    walking = np.arange(n)
    for step in range(1, max_steps + 1):
        if not walking.size:
            break
        raise_if_stopped(should_stop)
        walked = step_map(past[0, walking], walking)
        completed = walked.completed
        back = _returns(np.abs(walked.states - past[:, walking]).max(axis=2)) & completed
        back &= (step - np.arange(1, MAX_PERIOD + 1) >= unsettled)[:, None]
        for row in (past, past_steps):
            row[1:, walking] = row[:-1, walking]
        past[0, walking] = walked.states
        past_steps[0, walking] = np.column_stack([walked.phases, walked.impacts])
        steps[walking] += completed
        settled = back.any(axis=0)
        periods[walking] = np.where(settled, np.argmax(back, axis=0) + 1, 0)
        endings[walking] = np.where(settled, 0, np.where(completed, UNDECIDED, walked.endings))
        walking = walking[completed & ~settled]
    first = _first_of_cycle(past, periods)
    rows = np.arange(n)
    phases, impacts = past_steps[first, rows].T
    return Outcomes(
        periods=periods, endings=endings, steps=steps, states=past[first, rows], phases=phases, impacts=impacts
    )


def _returns(distances: Array) -> NDArray[np.bool_]:
    """Whether a state returned to the one 1, 2, ... steps before, from the distances to these; shape (periods, n).

    For a period above 1, the states between have to differ: a walk that converges to a fixed point also comes close to
    its earlier states.
    """
    apart = np.vstack([np.full((1, distances.shape[1]), True), distances[:-1] > SAME_GAIT])
    return (distances < SETTLED) & np.logical_and.accumulate(apart, axis=0)


def _first_of_cycle(past: Array, periods: Codes) -> Codes:
    """Number of steps since the state of the cycle that comes first in lexical order; shape (n,)."""
    first = np.zeros(len(periods), dtype=np.int64)
    for row in np.flatnonzero(periods > 1):
        cycle = np.round(past[: periods[row], row], -int(np.log10(SAME_GAIT)))
        first[row] = min(range(periods[row]), key=lambda k: tuple(cycle[k]))
    return first


def assign_gaits(outcomes: Outcomes, gaits: list[Attractor], problem: Problem) -> Codes:
    """The index of the gait of every outcome, or -1, shape (n,); new gaits are appended to ``gaits``.

    The list depends on the order of the states, but not on their division into tiles.
    """
    labels, unassigned, index = np.full(len(outcomes.periods), -1), np.flatnonzero(outcomes.periods > 0), 0
    modes, impacts = problem.walker.modes(), problem.walker.foot_modes()
    while unassigned.size:
        if index == len(gaits):
            row = unassigned[0]
            gaits.append(
                Attractor(
                    problem=problem,
                    state=outcomes.states[row],
                    period=int(outcomes.periods[row]),
                    phases=phase_names(int(outcomes.phases[row]), modes),
                    impact=impacts[outcomes.impacts[row]],
                    count=0,
                )
            )
        gait = gaits[index]
        near = np.abs(outcomes.states[unassigned] - gait.state).max(axis=1) < SAME_GAIT
        on_it = near & (outcomes.periods[unassigned] == gait.period)
        labels[unassigned[on_it]] = index
        gaits[index] = replace(gait, count=gait.count + int(on_it.sum()))
        unassigned, index = unassigned[~on_it], index + 1
    return labels


def ending_name(code: int) -> str:
    """Name of an ending; ``undecided`` if the walk neither settled nor failed."""
    return "undecided" if code == UNDECIDED else str(ENDINGS[code])


Labels = NDArray[np.int32]

STATE_BYTES_MEMORY = 16
"""Memory of one state [bytes]; labels, endings and steps of the whole grid are in memory at the same time."""
BASIN_FILE, TILE_FILE = "basin.json", "tile-{:06d}.npz"
ARCHIVE_ERRORS = (
    OSError,
    ValueError,
    KeyError,
    EOFError,
    NotImplementedError,
    TypeError,
    zipfile.BadZipFile,
    zlib.error,
)
"""Errors that NumPy and zipfile raise for damaged archives."""
NUMBER = "number"
"""Name of the array with a tile's number in its file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Basin(Plotted, ReadOnlyArrays):
    """The basins of attraction on a grid of states.

    Attributes
    ----------
    problem, grid : the problem, and the grid of states.
    base : the section coordinates that the grid does not vary.
    floor : the tiles on which every walk began; None for the nominal floor.
    freed : values of the free parameters of a design, by dotted key; the problems of ``attractors`` have them.
    attractors : the gaits on which states settle; ``labels`` are indices into them.
    labels : ndarray, grid's shape - index of the gait that a state settles on, or -1.
    endings : ndarray, grid's shape - code of the ending if it does not settle, see ``Outcomes``.
    steps : ndarray, grid's shape - number of steps until it settles or fails.
    folder : folder of its tiles.
    """

    problem: Problem
    grid: Grid
    base: dict[str, float]
    attractors: tuple[Attractor, ...]
    labels: Labels
    endings: Labels
    steps: Labels
    floor: Floor | None = None
    freed: Mapping[str, float] = field(default_factory=dict)
    folder: Path | None = None

    def __repr__(self) -> str:
        shares = [f"{gait.count / self.grid.size:.1%} {gait}" for gait in self.attractors]
        axes = ", ".join(axis.key for axis in self.grid.axes)
        return f"<Basin {self.problem.name} over {axes}: {self.grid.size} states, {', '.join(shares) or 'no gait'}>"

    def to_xarray(self) -> "Dataset":
        """The result of every state over the coordinates: ``gait``, ``steps`` and ``ending``.

        ``gait`` is an index into ``attractors``, or -1. ``ending`` says why a walk failed; it is empty if the state
        settles on a gait.
        """
        keys = tuple(axis.key for axis in self.grid.axes)
        names = {code: ending_name(int(code)) for code in np.unique(self.endings)}
        failed = np.array([names[code] for code in self.endings.ravel()]).reshape(self.grid.shape)
        endings = np.where(self.labels < 0, failed, "")
        variables = {"gait": (keys, self.labels), "steps": (keys, self.steps), "ending": (keys, endings)}
        coordinates = {axis.key: ((axis.key,), axis.values) for axis in self.grid.axes}
        return data_set(
            variables, coordinates, {key: state_unit(key, self.problem) for key in keys}, problem=self.problem.name
        )

    def to_record(self) -> dict[str, Any]:
        """One JSON object: the gaits with their shares, and the failures by name."""
        codes, counts = np.unique(self.endings[self.endings != 0], return_counts=True)
        gaits = [
            {
                "kind": str(gait),
                "period": gait.period,
                "phases": [mode.brief for mode in gait.phases],
                "impact": gait.impact.brief,
                "state": gait.named_state,
                "states": gait.count,
                "share": gait.count / self.grid.size,
            }
            for gait in self.attractors
        ]
        return {
            "problem": self.problem.name,
            "over": [asdict(axis) for axis in self.grid.axes],
            "base": self.base,
            **({} if self.floor is None else {"floor": self.floor.to_record()}),
            **({"parameters": dict(self.freed)} if self.freed else {}),
            "states": self.grid.size,
            "gaits": gaits,
            "failures": {ending_name(int(v)): int(n) for v, n in zip(codes, counts, strict=True)},
        }


def read_basin(folder: Path) -> Basin:
    """The basin in a subfolder of the run of its problem."""
    run = Run.at(folder)
    stored = run.read_record(BASIN_FILE, BasinRecord)
    grid = validated(Grid, {"axes": stored["over"]}, folder / BASIN_FILE)
    check_room(grid.size, folder, disk=0, memory=STATE_BYTES_MEMORY)
    floor = Floor.from_record(stored["floor"]) if "floor" in stored else None
    problem, freed = run.problem(), stored.get("parameters", {})
    if freed and freed.keys() != problem.free.keys():
        raise StorageError(f"{folder / BASIN_FILE}: parameters are not those that {problem.name} frees")
    basin = assemble_basin(run, problem, grid, stored["base"], floor, freed)
    check_agrees(folder / BASIN_FILE, stored, basin.to_record(), "the grid of tiles")
    return basin


def assemble_basin(
    run: Run, problem: Problem, grid: Grid, base: dict[str, float], floor: Floor | None, freed: Mapping[str, float]
) -> Basin:
    """The basin assembled from its tiles."""
    gaits, walked = list[Attractor](), problem.with_fixed(freed) if freed else problem
    labels, endings, steps = np.zeros((3, grid.size), dtype=np.int32)
    done, tile = 0, 0
    while done < grid.size:
        outcomes = _read_tile(run, tile, grid.size - done)
        rows = slice(done, done + len(outcomes.steps))
        labels[rows] = assign_gaits(outcomes, gaits, walked)
        endings[rows], steps[rows] = outcomes.endings, outcomes.steps
        done, tile = rows.stop, tile + 1
    return Basin(
        problem=problem, grid=grid, base=base, attractors=tuple(gaits),
        labels=labels.reshape(grid.shape), endings=endings.reshape(grid.shape), steps=steps.reshape(grid.shape),
        floor=floor, freed=freed, folder=run.result_folder,
    )  # fmt: skip


def _read_tile(run: Run, tile: int, most: int) -> Outcomes:
    """The outcomes of one tile, which has at most ``most`` states; a tile of a finished basin must be unchanged."""
    name = TILE_FILE.format(tile)
    path = run.path(name)
    try:
        with np.load(BytesIO(read_bytes(path)), allow_pickle=False) as archive:
            arrays = dict(archive)
    except ARCHIVE_ERRORS as error:
        raise StorageError(f"{path} is damaged ({error}): delete it to compute its states again") from error
    if run.holds(name):
        run.read(name)  # checks it against the manifest
    number, names = arrays.pop(NUMBER, None), {f.name for f in fields(Outcomes)}
    counts = {len(np.atleast_1d(array)) for array in arrays.values()}
    if number != tile or arrays.keys() != names or len(counts) != 1 or not 0 < min(counts) <= most:
        raise StorageError(f"{path} is not tile {tile}: delete it to compute its states again")
    return Outcomes(**arrays)


TILE, STATES_PER_SCIPY_TILE = 4096, 64
"""Number of states in one tile with heyoka and with scipy. A tile takes a few seconds; a kill loses no more work than
that."""
STEPS_OF_A_STATE = 10
"""Typical number of steps until a state settles or fails."""
STATE_BYTES_DISK = 48
"""Size of the compressed outcome of one state [bytes]."""


def check_keys(problem: Problem, keys: Iterable[str]) -> None:
    """Refuse keys of a grid that are not section coordinates; nothing is checked while these follow from open modes.

    Raises
    ------
    UnknownNameError
        If there is no such coordinate.
    """
    if problem.section is not None:
        check_known(keys, problem.map_section.names, "a coordinate just after an impact")


@dataclass(frozen=True, kw_only=True)
class BasinPlan(Plan[Basin], BasinRequest):
    """A basin to be computed.

    Attributes
    ----------
    problem : the problem of the walker.
    p : parameters of the walker, if they differ from those of the problem.
    base : the section coordinates that the grid does not vary.
    floor : the tiles on which every walk begins; None for the nominal floor.
    freed : values of the free parameters of a design, by dotted key.
    """

    p: tuple[float, ...] | None
    base: dict[str, float]
    grid: Grid
    floor: Floor | None = None
    freed: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def around(
        cls, start: Problem | Gait, grid: Grid, request: BasinRequest, folder: Path, floor: Floor | None = None
    ) -> Self:
        """The basin of a grid around the state of a gait, or around a problem's guess."""
        if isinstance(start, Gait):
            problem, p, freed = start.problem, tuple(start.p.tolist()), start.freed
            state = dict(zip(start.system.state_names, start.state.tolist(), strict=True))
        else:
            problem, p, freed, state = start, None, dict[str, float](), dict(start.guess.state)
        varied = {axis.key for axis in grid.axes}
        names = (name for name in problem.map_section.names if name not in varied)
        base = {name: float(state[name]) for name in names}
        return cls(
            problem=problem, p=p, base=base, grid=grid, floor=floor, freed=freed, folder=folder, **vars(request)
        )  # fmt: skip

    @property
    def run(self) -> Run:
        """The run, with the subfolder of the basin's tiles and figures."""
        return Run(self.folder, f"basin-{self.key}")

    def check(self) -> None:
        """Refuse a grid that is not over section coordinates, an unknown engine, too many states, or a wrong floor."""
        check_keys(self.problem, [axis.key for axis in self.grid.axes])
        _ = self.chosen_engine
        if self.floor is not None:
            check_floor(problem_dynamics(self.problem).system, self.floor)
        check_room(self.grid.size, self.folder, disk=STATE_BYTES_DISK, memory=STATE_BYTES_MEMORY)

    @contextmanager
    def stored(self) -> Iterator[Stored]:
        """The tiles on the disk by the keys of their jobs. Their content is read later, when all tiles exist."""
        files = {self._tile_key(tile): self.run.path(TILE_FILE.format(tile)) for tile in self.tiles}

        def store(key: str, outcomes: Outcomes) -> None:
            arrays, packed = {f.name: getattr(outcomes, f.name) for f in fields(outcomes)}, BytesIO()
            np.savez_compressed(packed, **{NUMBER: int(key.rpartition("-")[2]), **arrays})
            write_whole(files[key], packed.getvalue())

        yield dict.fromkeys(key for key, path in files.items() if path.is_file()), store

    def result(self, jobs: ResumableJobs) -> Basin:
        """The basin of all tiles.

        Raises
        ------
        SolveError
            If a tile failed because it kills its workers; the others are stored.
        """
        fixed = replace(self, engine=self.chosen_engine)  # on its own, a worker might choose another engine
        tile_jobs = [Job(key=self._tile_key(tile), argument=(fixed, tile)) for tile in self.tiles]
        for tile, result in enumerate(jobs.complete(walk_tile, tile_jobs, len(tile_jobs))):
            if isinstance(result, FailedJob):
                raise SolveError(f"tile {tile} of the basin failed: {result.reason}; the others are stored")
        basin = assemble_basin(self.run, self.problem, self.grid, self.base, self.floor, self.freed)
        self.run.seal(*map(TILE_FILE.format, self.tiles))
        self.run.write({BASIN_FILE: json_file(basin.to_record())})
        return basin

    def _tile_key(self, tile: int) -> str:
        return f"{self.key}-{tile}"

    @property
    def key(self) -> str:
        """Hash of all values that the tiles depend on."""
        identity: dict[str, Any] = {"grid": [*map(str, self.grid.axes)], "base": self.base, "steps": self.steps}
        if self.floor is not None:
            identity["floor"] = self.floor.to_record()
        return key_of(identity | {"engine": str(self.chosen_engine), "tile": self.tile_size})[:8]

    @property
    def chosen_engine(self) -> Engine:
        """The engine; ``auto`` is resolved by the number of states."""
        return choose_engine(self.engine, steps=self.grid.size * STEPS_OF_A_STATE)

    @property
    def tile_size(self) -> int:
        """Number of states in one tile."""
        return TILE if self.chosen_engine is Engine.HEYOKA else min(TILE, STATES_PER_SCIPY_TILE)

    @property
    def tiles(self) -> range:
        """Numbers of the tiles."""
        return range(-(-self.grid.size // self.tile_size))


def walk_tile(argument: tuple[BasinPlan, int], _: None = None, should_stop: Stop = None) -> Outcomes:
    """The job of one tile, in any process; returns the outcomes of its states."""
    plan, tile = argument
    numbers = np.arange(tile * plan.tile_size, min((tile + 1) * plan.tile_size, plan.grid.size))
    values = dict(zip([axis.key for axis in plan.grid.axes], plan.grid.points(numbers).T, strict=True))
    names = plan.problem.map_section.names
    xi = np.column_stack([values.get(name, np.full(len(numbers), plan.base.get(name))) for name in names])
    mapped = step_map(plan.problem, plan.p, plan.chosen_engine, plan.floor)
    walk, states = mapped.closed(section_coordinates(plan.problem, xi))
    unsettled = 0 if plan.floor is None else len(plan.floor) - 1
    found = follow(walk, states, plan.steps, unsettled=unsettled, should_stop=should_stop)
    if mapped.is_stated and plan.floor is not None:
        return replace(found, states=found.states[:, mapped.indices])
    return found
