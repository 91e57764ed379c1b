"""``gaitopt sweep``: a grid of problems, solved and verified on all cores or on a cluster."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from gaitopt.cli.grids import OverOption, SchedulerOption, WorkersOption, grid
from gaitopt.cli.maps import DEFAULT_FORMATS, draw_sweep
from gaitopt.cli.options import DebugOption, JsonOption, OutOption, ProblemArgument, QuietOption, SetOption

if TYPE_CHECKING:
    from rich.console import Console

WarmOption = Annotated[
    bool, typer.Option("--warm", help="Start from the neighbour's gait; from the guess where that fails.")
]
WhatOption = Annotated[str, typer.Option("--what", metavar="NAME", help="Scalar of the result that is drawn.")]


def sweep(
    problem: ProblemArgument,
    over: OverOption,
    warm: WarmOption = False,
    what: WhatOption = "spectral_radius",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    changes: SetOption = None,
    output: OutOption = None,
    json: JsonOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Solve and verify a problem over a grid of its parameters.

    What is done is kept and never done again; the same command goes on where it was. A point without a gait is a
    result.
    """
    from gaitopt.cli.console import narration, print_json, results
    from gaitopt.cli.runs import load
    from gaitopt.cli.signals import interruptible
    from gaitopt.errors import UnknownNameError
    from gaitopt.library.progress import job_progress
    from gaitopt.problem import SCALARS
    from gaitopt.runs.sweep import SweepPlan, check_sweep, run_sweep, sweep_record
    from gaitopt.runs.sweep_table import TABLE_FILE, Sweep
    from gaitopt.store import adding, check_folder, run_folder, writing
    from gaitopt.workers.jobs import make_workers

    if what not in SCALARS:
        raise UnknownNameError(f"--what {what}: no scalar of a sweep; use {', '.join(SCALARS)}")
    console = narration(quiet=quiet)
    points, loaded = grid(over), load(problem, changes, console)
    folder = output or run_folder(loaded)
    check_folder(folder, loaded)
    plan = SweepPlan(problem=loaded, grid=points, warm=warm, folder=folder)
    check_sweep(plan)
    jobs_at = make_workers(workers, scheduler)
    with writing(folder, loaded):
        with interruptible() as interrupted, job_progress(console, "jobs") as progress:
            records = run_sweep(plan, jobs_at, progress=progress, should_stop=interrupted)
        place = plan.place
        record = sweep_record(plan, records) | {"table": str(place / TABLE_FILE), "run": str(place)}
        if len(points.axes) <= 2:
            with adding(folder, place) as figures:
                swept = Sweep(problem=loaded, grid=points, records=records)
                figures += draw_sweep(swept, [what], DEFAULT_FORMATS, place)
            record["figures"] = [str(path) for path in figures]
    if json:
        print_json(record)
    else:
        _print(results(), record)
    return 0


def _print(console: "Console", record: dict[str, Any]) -> None:
    statuses = ", ".join(f"{count} {status.replace('_', ' ')}" for status, count in record["statuses"].items())
    console.print(f"{record['problem']}: {record['jobs']} jobs, {statuses}")
    console.print(f"verified: {record['verified']}" + (f", REFUTED: {record['refuted']}" if record["refuted"] else ""))
    for job in record["set_aside"]:
        place = ", ".join(f"{key} = {value:g}" for key, value in job["at"].items())
        console.print(f"set aside: {place}: {job['reason']}")
    console.print(f"table: {record['table']}", soft_wrap=True)
