"""``gaitopt sweep``: a grid of problems, solved and verified on all cores or on a cluster."""

from typing import Annotated

import typer

from gaitopt.cli.figures import save_figures
from gaitopt.cli.options import (
    GuessOption,
    OutOption,
    OverOption,
    ProblemArgument,
    SchedulerOption,
    SetOption,
    WorkersOption,
)
from gaitopt.cli.runs import load
from gaitopt.cli.terminal import Terminal
from gaitopt.cli.values import grid
from gaitopt.errors import UnknownNameError

WarmOption = Annotated[
    bool,
    typer.Option(
        "--warm", help="Start each point from the gait of its neighbour; the result may then depend on the grid."
    ),
]
WhatOption = Annotated[str, typer.Option("--what", metavar="NAME", help="Scalar of the result that is drawn.")]


def sweep(
    terminal: Terminal,
    problem: ProblemArgument,
    over: OverOption,
    warm: WarmOption = False,
    what: WhatOption = "spectral_radius",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    changes: SetOption = None,
    from_guess: GuessOption = False,
    output: OutOption = None,
) -> int:
    """Solve and verify a problem over a grid of its parameters; each point as `solve` does with --set.

    What is done is kept and never done again; the same command resumes where it stopped. A point without a gait is a
    result.
    """
    from gaitopt.figures.catalogue import sweep_figures
    from gaitopt.library.print_results import print_sweep
    from gaitopt.problem import SCALARS
    from gaitopt.runs.sweep import SweepPlan, check_sweep, run_sweep
    from gaitopt.runs.sweep_table import TABLE_FILE, sweep_record
    from gaitopt.store import adding, check_folder, run_folder, writing
    from gaitopt.workers.jobs import make_workers

    if what not in SCALARS:
        raise UnknownNameError(f"--what {what}: no scalar of a sweep; use {', '.join(SCALARS)}")
    points, loaded = grid(over), load(problem, changes, terminal)
    folder = output or run_folder(loaded)
    check_folder(folder, loaded)
    plan = SweepPlan(problem=loaded, grid=points, warm=warm, folder=folder, from_guess=from_guess)
    check_sweep(plan)
    jobs_at = make_workers(workers, scheduler)
    with writing(folder, loaded):
        with terminal.working("jobs") as (progress, interrupted):
            swept = run_sweep(plan, jobs_at, progress=progress, should_stop=interrupted)
        record = sweep_record(swept) | {"table": str(plan.place / TABLE_FILE), "run": str(plan.place)}
        if len(points.axes) <= 2:
            with adding(folder, plan.place) as figures:
                figures += save_figures(sweep_figures(swept), plan.place, [what])
            record["figures"] = [str(path) for path in figures]
    terminal.show(record, print_sweep, "table")
    return 0
