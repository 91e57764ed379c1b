"""``gaitopt basin``: which states walk, and on which gait they end."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gaitopt.cli.figures import save_figures
from gaitopt.cli.options import (
    EngineOption,
    OutOption,
    OverOption,
    RunArgument,
    SchedulerOption,
    SetOption,
    WorkersOption,
)
from gaitopt.cli.runs import gait_of
from gaitopt.cli.terminal import Terminal
from gaitopt.cli.values import grid

if TYPE_CHECKING:
    from gaitopt.gait import Gait
    from gaitopt.problem import Problem

StepsOption = Annotated[int, typer.Option("--steps", min=1, help="Steps after which a state is undecided.")]


def basin(
    terminal: Terminal,
    run: RunArgument,
    over: OverOption,
    steps: StepsOption = 100,
    engine: EngineOption = "auto",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    changes: SetOption = None,
    output: OutOption = None,
) -> int:
    """Walk from every state of a grid until it settles on a gait or fails.

    The other coordinates are those of RUN's gait. Finished tiles are kept; the same command resumes where it stopped.
    `gaitopt solve RUN@attractor.K` makes a gait of the K-th one, RUN being the folder that is printed.
    """
    from gaitopt.figures.catalogue import basin_figures
    from gaitopt.library.print_results import print_basin
    from gaitopt.runs.basin_run import BasinPlan, check_basin, walk_basin
    from gaitopt.simulation.engine import INSTALL, Engine, choose_engine, is_installed
    from gaitopt.store import adding, writing
    from gaitopt.workers.jobs import make_workers

    points = grid(over)
    choose_engine(engine)
    tiles_at = make_workers(workers, scheduler)
    start, folder = _start(run, changes, output, terminal)
    plan = BasinPlan.around(start, points, max_steps=steps, engine=engine, folder=folder)
    check_basin(plan)
    if engine == Engine.AUTO and not is_installed():
        terminal.say(f"walking on scipy; heyoka walks several times as fast: {INSTALL}")
    with writing(folder, plan.problem):
        with terminal.working("tiles") as (progress, interrupted):
            result = walk_basin(plan, tiles_at, progress=progress, should_stop=interrupted)
        record = {**result.to_record(), "run": str(plan.place)}
        if len(points.axes) <= 2:
            with adding(folder, plan.place) as figures:
                figures += save_figures(basin_figures(result), plan.place)
            record["figures"] = [str(path) for path in figures]
    terminal.show(record, print_basin, "run")
    return 0


def _start(
    run: str, changes: list[str] | None, output: Path | None, terminal: Terminal
) -> "tuple[Gait | Problem, Path]":
    """The gait that the grid lies around, or the problem with its guess where there is none; and the run folder."""
    from gaitopt.library.stored import save
    from gaitopt.store import begin_run

    gait, folder, fresh = gait_of(run, changes, output, terminal)
    if gait.converged and fresh:
        save(gait, folder)
    elif fresh:
        terminal.say(f"{gait.problem.name} is {gait.status}; the grid lies around its guess")
        begin_run(folder, gait.problem)
    return (gait if gait.converged else gait.problem), folder
