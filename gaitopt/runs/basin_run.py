"""A basin on disk: tiles of states, stored as they finish, so that a run that was killed resumes where it stopped."""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Self

import numpy as np

from gaitopt.callbacks import Counted, Stop
from gaitopt.errors import SolveError
from gaitopt.gait import Gait
from gaitopt.problem import Problem
from gaitopt.runs.basin import Outcomes, follow
from gaitopt.runs.basin_tiles import BASIN_FILE, NUMBER, STATE_BYTES_MEMORY, Basin, assembled
from gaitopt.runs.grid import Grid, check_room
from gaitopt.simulation import Engine, choose_engine
from gaitopt.store import begin_run, json_file, write_files, writing
from gaitopt.store.files import make_folder
from gaitopt.store.manifest import MANIFEST_FILE, seal
from gaitopt.store.tiles import TILE_FILE, has_tile, write_tile
from gaitopt.study.return_map import section_states, step_map
from gaitopt.workers.jobs import FailedJob, Job, Workers, key_of, run_jobs

TILE, SCIPY_TILE = 4096, 64
"""States of one tile on heyoka and on scipy: some seconds of walking, and what is lost by a kill."""
STEPS_OF_A_STATE = 10
"""About so many steps a state takes until it settles or fails."""
STATE_BYTES_DISK = 48
"""Of the outcome of one state, compressed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BasinPlan:
    """What is to be walked, and where it is kept.

    Attributes
    ----------
    problem : whose walker walks.
    p : its parameters, where they are not those of the problem.
    base : the section coordinates that the grid does not vary.
    max_steps : steps after which a state is undecided.
    folder : of the run; the basin has a folder of its own in it.
    """

    problem: Problem
    p: tuple[float, ...] | None
    base: dict[str, float]
    grid: Grid
    max_steps: int
    engine: str
    folder: Path

    @classmethod
    def around(cls, start: Problem | Gait, grid: Grid, *, max_steps: int, engine: str, folder: Path) -> Self:
        """The basin of a grid around the state of a gait, or around a problem's guess."""
        if isinstance(start, Gait):
            problem, p = start.problem, tuple(start.p.tolist())
            state = dict(zip(start.system.state_names, start.state.tolist(), strict=True))
        else:
            problem, p, state = start, None, dict(start.guess.state)
        varied = {axis.key for axis in grid.axes}
        names = (name for name in problem.walker.section_names(slipping=True) if name not in varied)
        base = {name: float(state[name]) for name in names}
        return cls(problem=problem, p=p, base=base, grid=grid, max_steps=max_steps, engine=engine, folder=folder)

    @property
    def key(self) -> str:
        """Names the basin by all that its tiles depend on."""
        identity = {"grid": [*map(str, self.grid.axes)], "base": self.base, "steps": self.max_steps}
        return key_of(identity | {"engine": str(self.chosen_engine), "tile": self.tile_size})[:8]

    @property
    def chosen_engine(self) -> Engine:
        """What ``engine`` means for so many states."""
        return choose_engine(self.engine, steps=self.grid.size * STEPS_OF_A_STATE)

    @property
    def tile_size(self) -> int:
        """States of one tile."""
        return TILE if self.chosen_engine is Engine.HEYOKA else min(TILE, SCIPY_TILE)

    @property
    def place(self) -> Path:
        """The basin's own folder."""
        return self.folder / f"basin-{self.key}"

    @property
    def tiles(self) -> range:
        """Numbers of the tiles."""
        return range(-(-self.grid.size // self.tile_size))


def check_basin(plan: BasinPlan) -> None:
    """Refuse a basin that cannot be walked or kept, before it starts; its errors are those of ``gaitopt.basin``."""
    plan.grid.check_keys(plan.problem.walker.section_names(slipping=True), "a coordinate just after an impact")
    choose_engine(plan.engine)
    check_room(plan.grid.size, plan.folder, disk=STATE_BYTES_DISK, memory=STATE_BYTES_MEMORY)


def walk_basin(plan: BasinPlan, workers: Workers, *, progress: Counted = None, should_stop: Stop = None) -> Basin:
    """Walk what is not yet on disk, and say where every state goes; a tile that kills its workers is a SolveError."""
    with writing(plan.folder, plan.problem):
        if not (plan.folder / MANIFEST_FILE).exists():
            begin_run(plan.folder, plan.problem)
        make_folder(plan.place, parents=False)
        _walk_tiles(plan, workers, progress, should_stop)
        basin = assembled(plan.place, plan.problem, plan.grid, plan.base)
        own = plan.place.name
        seal(plan.folder, *(f"{own}/{TILE_FILE.format(tile)}" for tile in plan.tiles))
        write_files(plan.folder, {f"{own}/{BASIN_FILE}": json_file(basin.to_record())})
    return basin


def _walk_tiles(plan: BasinPlan, workers: Workers, progress: Counted, should_stop: Stop) -> None:
    """Walk the tiles that are not on disk, each written as soon as it is finished."""
    missing = [tile for tile in plan.tiles if not has_tile(plan.place, tile)]
    done, total = len(plan.tiles) - len(missing), len(plan.tiles)
    fixed = replace(plan, engine=plan.chosen_engine)  # a worker might choose another one
    jobs = [Job(key=f"{plan.key}-{tile}", argument=(fixed, tile)) for tile in missing]
    for key, outcomes in run_jobs(walk_tile, jobs, workers, should_stop=should_stop):
        tile = int(key.rpartition("-")[2])
        if isinstance(outcomes, FailedJob):
            raise SolveError(f"tile {tile} of the basin was given up: {outcomes.reason}; the others are kept")
        write_tile(plan.place, tile, {NUMBER: tile, **{f.name: getattr(outcomes, f.name) for f in fields(outcomes)}})
        done += 1
        if progress is not None:
            progress(done, total)
    if done < total:
        raise KeyboardInterrupt


def walk_tile(argument: tuple[BasinPlan, int], _: None = None, should_stop: Stop = None) -> Outcomes:
    """Outcomes of the states of one tile; runs in any process."""
    plan, tile = argument
    numbers = np.arange(tile * plan.tile_size, min((tile + 1) * plan.tile_size, plan.grid.size))
    values = dict(zip([axis.key for axis in plan.grid.axes], plan.grid.points(numbers).T, strict=True))
    names = plan.problem.walker.section_names(slipping=True)
    xi = np.column_stack([values.get(name, np.full(len(numbers), plan.base.get(name))) for name in names])
    walk = step_map(plan.problem, plan.p, plan.chosen_engine)
    return follow(walk, section_states(plan.problem, xi), plan.max_steps, should_stop=should_stop)
