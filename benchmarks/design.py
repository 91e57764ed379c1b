"""Designs against their targets, and many starts over cores."""

import os
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from timing import Row

from gaitopt import load_problem, solve
from gaitopt.runs.multistart import StartsPlan
from gaitopt.workers.jobs import Workers

TARGETS = {
    "compass-torque-efficient": 5.0,
    "compass-minimum-friction": 5.0,
    "rimless-wheel-slope": 5.0,
    "compass-torque-stable-slip-cheap": None,
    "compass-torque-stable-slip": 1.3,
    "compass-pd-designed": 6.6,
    "compass-pd-slippery": None,
}
"""Seconds of processor time allowed, one after the other in one process; None where nothing was promised."""
MANY = "compass-torque-stable-slip-cheap"
STARTS = 12


def design_row(name: str) -> Row:
    """One design from its file."""
    began = time.process_time()
    gait = solve(load_problem(name))
    seconds, target = time.process_time() - began, TARGETS[name]
    against = "" if target is None else f"; {'within' if seconds <= target else 'OVER'} its {target:g} s"
    note = f"{gait.status}, {gait.solver['iterations']:.0f} iterations{against}"
    return Row(what=name, way="gaitopt.solve", seconds=seconds, note=note)


def start_rows(cores: int) -> list[Row]:
    """The same starts on one worker and on all cores; the latter includes the start of their processes."""
    rows: list[Row] = []
    for count in dict.fromkeys((1, cores)):
        with TemporaryDirectory() as folder:
            plan = StartsPlan(problem=load_problem(MANY), starts=STARTS, folder=Path(folder))
            began = time.perf_counter()
            found = plan.complete(Workers(count=count))
            seconds = time.perf_counter() - began
        ratio = rows[0].seconds / seconds if rows else 1.0
        note = f"{sum(len(optimum.starts) for optimum in found)} gaits, {len(found)} of them distinct"
        rows.append(
            Row(what=f"{STARTS} starts of {MANY}", way=f"{count} workers", seconds=seconds, ratio=ratio, note=note)
        )
    return rows


def rows() -> list[Row]:
    """All designs, and many starts."""
    return [*map(design_row, TARGETS), *start_rows(os.cpu_count() or 1)]
