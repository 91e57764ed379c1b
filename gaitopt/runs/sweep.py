"""A grid of problems, each solved and verified: what a gait becomes over one or several parameters."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from gaitopt.callbacks import Counted, Stop
from gaitopt.problem import Problem
from gaitopt.runs.grid import Grid, at_point, check_jobs_fit
from gaitopt.runs.solved import problem_job, solve_all
from gaitopt.runs.sweep_table import SWEEP_FILE, TABLE_FILE, Sweep, sweep_record, sweep_table
from gaitopt.store import begin_run, json_file, write_files, writing
from gaitopt.store.files import make_folder
from gaitopt.store.text import csv_text
from gaitopt.workers.jobs import Job, Workers, key_of


@dataclass(frozen=True)
class SweepPlan:
    """What is to be solved, and where it is kept.

    Attributes
    ----------
    problem : the problem of which the grid changes some numbers.
    grid : over dotted keys of parameters.
    warm : whether a job starts from the gait of its neighbour towards the grid's first point; otherwise, and where that
        fails, the result at a point is that of ``solve``.
    folder : of the problem's run.
    from_guess : whether every point is solved from the problem's guess instead.
    """

    problem: Problem
    grid: Grid
    warm: bool
    folder: Path
    from_guess: bool = False

    @cached_property
    def jobs(self) -> list[Job]:
        """One job per point of the grid, in its order."""
        jobs: list[Job] = []
        for number in range(self.grid.size):
            problem = at_point(self.problem, self.point(number))
            problem = problem.from_guess() if self.from_guess else problem
            neighbour = self._neighbour(number) if self.warm else None
            jobs.append(problem_job(problem, None if neighbour is None else jobs[neighbour].key))
        return jobs

    @cached_property
    def place(self) -> Path:
        """Folder of the sweep's table and figures."""
        way = [self.warm, *(["from_guess"] if self.from_guess else [])]
        return self.folder / f"sweep-{key_of([*map(str, self.grid.axes), *way])[:8]}"

    def point(self, number: int) -> dict[str, float]:
        """Values by dotted key at one point of the grid."""
        indices = np.unravel_index(number, self.grid.shape)
        return {axis.key: self._numbers[axis.key][k] for axis, k in zip(self.grid.axes, indices, strict=True)}

    @cached_property
    def _numbers(self) -> dict[str, list[float]]:
        return {axis.key: axis.numbers(self.problem) for axis in self.grid.axes}

    def _neighbour(self, number: int) -> int | None:
        """The point one step towards the first along the first axis that allows it; None for the first point."""
        index = [int(k) for k in np.unravel_index(number, self.grid.shape)]
        axis = next((k for k, value in enumerate(index) if value > 0), None)
        if axis is None:
            return None
        index[axis] -= 1
        return int(np.ravel_multi_index(index, self.grid.shape))


def check_sweep(sweep: SweepPlan) -> None:
    """Refuse a sweep that cannot be made or kept, before it starts; its errors are those of ``gaitopt.sweep``."""
    sweep.grid.check_keys(tuple(sweep.problem.parameters), f"a parameter of {sweep.problem.name}")
    check_jobs_fit(sweep.grid.size, sweep.folder)
    _ = sweep.jobs


def run_sweep(sweep: SweepPlan, workers: Workers, *, progress: Counted = None, should_stop: Stop = None) -> Sweep:
    """Solve and verify what is not on disk yet."""
    with writing(sweep.folder, sweep.problem):
        begin_run(sweep.folder, sweep.problem)
        solved = solve_all(sweep.jobs, sweep.folder, workers, progress=progress, should_stop=should_stop)
        records = [{**solved[job.key], "at": sweep.point(k)} for k, job in enumerate(sweep.jobs)]
        swept = Sweep(problem=sweep.problem, grid=sweep.grid, records=records)
        make_folder(sweep.place, parents=False)
        table, record = csv_text(sweep_table(sweep.grid, records)), json_file(sweep_record(swept))
        own = sweep.place.name
        write_files(sweep.folder, {f"{own}/{TABLE_FILE}": table, f"{own}/{SWEEP_FILE}": record})
    return swept
