"""``gaitopt solve``: a problem's gait, verified and stored."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from gaitopt.cli.options import OutOption, SchedulerOption, SeedOption, SetOption, WorkersOption
from gaitopt.cli.runs import load, report, solve_verified, verified
from gaitopt.cli.starts import SpreadOption, StartOption, StartsOption, started
from gaitopt.cli.terminal import Terminal

ATTRACTOR = "@attractor."

SolvedArgument = Annotated[
    str,
    typer.Argument(
        metavar="PROBLEM",
        help="A name from `gaitopt list`, a .yaml file, or RUN@attractor.K, the K-th gait in the table of a basin.",
    ),
]


def solve(
    terminal: Terminal,
    problem: SolvedArgument,
    start: StartOption = None,
    starts: StartsOption = 1,
    seed: SeedOption = 0,
    spread: SpreadOption = 0.3,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    changes: SetOption = None,
    output: OutOption = None,
) -> int:
    """Solve for a gait, verify it and store it.

    With --starts the distinct solutions are listed and the best one is kept; what each start has found stays in the
    run folder, so that the same command goes on where it was.
    """
    from gaitopt.store import run_folder, writing
    from gaitopt.workers.jobs import make_workers

    if ATTRACTOR in problem:
        if changes or start or starts > 1:
            raise typer.BadParameter(f"{problem} is a gait as it is: --set, --start and --starts change a problem")
        return _solve_attractor(problem, output, terminal)
    loaded = load(problem, changes, terminal)
    loaded = started(loaded, start, terminal) if start else loaded
    folder = output or run_folder(loaded)
    jobs_at = make_workers(workers, scheduler)
    if starts > 1:
        from gaitopt.library.print_results import print_optima
        from gaitopt.runs.grid import check_jobs_fit
        from gaitopt.runs.multistart import multistart

        check_jobs_fit(starts, folder)
    with writing(folder, loaded):
        best, about = loaded, dict[str, Any]()
        if starts > 1:
            with terminal.working("starts") as (progress, interrupted):
                optima = multistart(
                    loaded, starts, folder, seed=seed, spread=spread, workers=jobs_at,
                    progress=progress, should_stop=interrupted,
                )  # fmt: skip
            best = optima[0].problem if optima else loaded
            about = {"starts": starts, "optima": [optimum.to_record() for optimum in optima]}
            if not terminal.json:
                print_optima(terminal.results, optima, starts)
        gait = solve_verified(best, terminal)
        gait = gait if best is loaded else replace(gait, problem=loaded)
        return report(gait, folder if gait.converged else None, terminal, store=True, about=about)


def _solve_attractor(place: str, output: Path | None, terminal: Terminal) -> int:
    """Solve the gait of RUN@attractor.K, verify it and store it."""
    from gaitopt.runs.basin_tiles import stored_attractor
    from gaitopt.search.solve import solve_attractor
    from gaitopt.store import run_folder, writing

    run, _, index = place.rpartition(ATTRACTOR)
    attractor = stored_attractor(Path(run), index)
    with terminal.solving(place) as (progress, interrupted):
        gait = solve_attractor(attractor, progress=progress, should_stop=interrupted)
    gait = verified(gait, terminal)
    folder = output or run_folder(gait.problem)
    with writing(folder, gait.problem):
        return report(gait, folder if gait.converged else None, terminal, store=True)
