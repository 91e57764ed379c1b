"""``gaitopt basin``: which states walk, and on which gait they end."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gaitopt.cli.grids import OverOption, SchedulerOption, WorkersOption, grid
from gaitopt.cli.maps import DEFAULT_FORMATS, draw_basin
from gaitopt.cli.options import DebugOption, EngineOption, JsonOption, OutOption, QuietOption, RunArgument, SetOption

if TYPE_CHECKING:
    from rich.console import Console

    from gaitopt.gait import Gait
    from gaitopt.problem import Problem

MaxStepsOption = Annotated[int, typer.Option("--steps", min=1, help="Steps after which a state is undecided.")]


def basin(
    run: RunArgument,
    over: OverOption,
    steps: MaxStepsOption = 100,
    engine: EngineOption = "auto",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    changes: SetOption = None,
    output: OutOption = None,
    json: JsonOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Walk from every state of a grid until it settles on a gait or fails.

    The other coordinates are those of RUN's gait. Finished tiles are kept; the same command goes on where it was.
    `gaitopt solve RUN@attractor.K` makes a gait of the K-th one, RUN being the folder that is printed.
    """
    from gaitopt.cli.console import narration, print_json, results
    from gaitopt.cli.signals import interruptible
    from gaitopt.library.progress import job_progress
    from gaitopt.runs.basin_run import BasinPlan, check_basin, walk_basin
    from gaitopt.simulation.engine import INSTALL, Engine, choose_engine, is_installed
    from gaitopt.store import adding, writing
    from gaitopt.workers.jobs import make_workers

    points, console = grid(over), narration(quiet=quiet)
    choose_engine(engine)
    tiles_at = make_workers(workers, scheduler)
    start, folder = _start(run, changes, output, console)
    plan = BasinPlan(start=start, grid=points, max_steps=steps, engine=engine, folder=folder)
    check_basin(plan)
    if engine == Engine.AUTO and not is_installed():
        console.print(f"walking on scipy; heyoka walks several times as fast: {INSTALL}")
    with writing(folder, plan.problem):
        with interruptible() as interrupted, job_progress(console, "tiles") as progress:
            result = walk_basin(plan, tiles_at, progress=progress, should_stop=interrupted)
        record = {**result.to_record(), "run": str(plan.place)}
        if len(points.axes) <= 2:
            with adding(folder, plan.place) as figures:
                figures += draw_basin(result, DEFAULT_FORMATS, plan.place)
            record["figures"] = [str(path) for path in figures]
    if json:
        print_json(record)
    else:
        _print(results(), record)
    return 0


def _start(
    run: str, changes: list[str] | None, output: Path | None, console: "Console"
) -> "tuple[Gait | Problem, Path]":
    """The gait that the grid lies around, or the problem with its guess where there is none; and the run folder."""
    from gaitopt.cli.runs import gait_of
    from gaitopt.library.stored import save
    from gaitopt.store import begin_run

    gait, folder, fresh = gait_of(run, changes, output, console)
    if gait.converged and fresh:
        save(gait, folder)
    elif fresh:
        console.print(f"{gait.problem.name} is {gait.status}; the grid lies around its guess")
        begin_run(folder, gait.problem)
    return (gait if gait.converged else gait.problem), folder


def _print(console: "Console", record: dict[str, Any]) -> None:
    from rich.table import Table

    table = Table(title=f"{record['problem']}: {record['states']:,} states", box=None, title_justify="left")
    for name, justify in (
        ("", "right"),
        ("ends on", "left"),
        ("states", "right"),
        ("share", "right"),
        ("modes; impact", "left"),
    ):
        table.add_column(name, justify=justify, overflow="fold")  # type: ignore[arg-type]
    for number, gait in enumerate(record["gaits"]):
        modes = f"{', '.join(gait['phases'])}; {gait['impact']}"
        table.add_row(str(number), gait["kind"], f"{gait['states']:,}", f"{gait['share']:.2%}", modes)
    for name, count in sorted(record["failures"].items(), key=lambda item: -item[1]):
        table.add_row("", name.replace("_", " "), f"{count:,}", f"{count / record['states']:.2%}", "")
    console.print(table)
    console.print(f"run: {record['run']}", soft_wrap=True)
