"""``gaitopt solve``: a problem's gait, verified and stored; and the same for commands that need a gait."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gaitopt.cli.grids import SchedulerOption, WorkersOption
from gaitopt.cli.options import (
    DebugOption,
    JsonOption,
    OutOption,
    QuietOption,
    SetOption,
)
from gaitopt.cli.starts import SeedOption, SpreadOption, StartOption, StartsOption

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import Console

    from gaitopt.gait import Gait
    from gaitopt.problem import Problem

ATTRACTOR = "@attractor."
NOT_A_GAIT = 4
NOT_VERIFIED = 5


SolvedArgument = Annotated[
    str,
    typer.Argument(
        metavar="PROBLEM",
        help="A name from `gaitopt list`, a .yaml file, or RUN@attractor.K, the K-th gait in the table of a basin.",
    ),
]


def solve(
    problem: SolvedArgument,
    start: StartOption = None,
    starts: StartsOption = 1,
    seed: SeedOption = 0,
    spread: SpreadOption = 0.3,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    changes: SetOption = None,
    output: OutOption = None,
    json: JsonOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Solve for a gait, verify it and store it.

    With --starts the distinct solutions are listed and the best one is kept; what each start has found stays in the
    run folder, so that the same command goes on where it was.
    """
    from gaitopt.cli.console import narration, results
    from gaitopt.cli.runs import load
    from gaitopt.cli.starts import print_optima, sampled_optima, started
    from gaitopt.runs.grid import check_jobs_fit
    from gaitopt.store import run_folder, writing
    from gaitopt.workers.jobs import make_workers

    console = narration(quiet=quiet)
    if ATTRACTOR in problem:
        if changes or start or starts > 1:
            raise typer.BadParameter(f"{problem} is a gait as it is: --set, --start and --starts change a problem")
        return _solve_attractor(problem, output, console, json=json)
    loaded = load(problem, changes, console)
    loaded = started(loaded, start, console) if start else loaded
    folder = output or run_folder(loaded)
    jobs_at = make_workers(workers, scheduler)
    check_jobs_fit(starts, folder)
    with writing(folder, loaded):
        best, about = loaded, dict[str, Any]()
        if starts > 1:
            optima = sampled_optima(loaded, starts, folder, seed, spread, jobs_at, console)
            best = optima[0].problem if optima else loaded
            about = {"starts": starts, "optima": [optimum.to_record() for optimum in optima]}
            if not json:
                print_optima(results(), optima, starts)
        gait = solve_verified(best, console)
        gait = gait if best is loaded else replace(gait, problem=loaded)
        return report(gait, folder if gait.converged else None, json=json, store=True, about=about)


def _solve_attractor(place: str, output: Path | None, console: "Console", *, json: bool) -> int:
    """Solve the gait of RUN@attractor.K, verify it and store it."""
    from gaitopt.cli.signals import interruptible
    from gaitopt.library.progress import solver_progress
    from gaitopt.runs.basin_tiles import stored_attractor
    from gaitopt.search.attractor import solve_attractor
    from gaitopt.store import run_folder, writing

    run, _, index = place.rpartition(ATTRACTOR)
    attractor = stored_attractor(Path(run), index)
    with interruptible() as interrupted, solver_progress(console, f"solving {place}") as progress:
        gait = solve_attractor(attractor, progress=progress, should_stop=interrupted)
        if interrupted():
            raise KeyboardInterrupt
    gait = verified(gait, console)
    folder = output or run_folder(gait.problem)
    with writing(folder, gait.problem):
        return report(gait, folder if gait.converged else None, json=json, store=True)


def solve_verified(problem: "Problem", console: "Console") -> "Gait":
    """The gait of a problem with its verification, or the failed attempt.

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C was pressed, even if the solver swallowed it.
    """
    from gaitopt.cli.signals import interruptible
    from gaitopt.errors import SolveError
    from gaitopt.library.progress import solver_progress
    from gaitopt.search.own import solve_as_own

    with interruptible() as interrupted:
        try:
            with solver_progress(console, f"solving {problem.name}") as progress:
                gait = solve_as_own(problem, progress=progress, should_stop=interrupted)
        except SolveError:
            if interrupted():  # a reference whose solution was interrupted
                raise KeyboardInterrupt from None
            raise
        if interrupted():
            raise KeyboardInterrupt
        return verified(gait, console)


def verified(gait: "Gait", console: "Console") -> "Gait":
    """A gait with its verification; a failed attempt as it is."""
    from gaitopt import study

    if not gait.converged:
        return gait
    if gait.message != "solved":
        console.print(gait.message)
    console.print("verifying by forward simulation")
    return gait.verified(study.verify(gait).to_record())


def report(
    gait: "Gait", folder: Path | None, *, json: bool, store: bool = False, about: "Mapping[str, Any] | None" = None
) -> int:
    """Store if asked to, print a gait (and what else is known about it) or the failure, and return the exit code."""
    from gaitopt.cli.console import print_json, results
    from gaitopt.library.stored import save
    from gaitopt.library.tables import print_gait

    record = {**gait.to_record(), "run": None if folder is None else str(folder), **(about or {})}
    try:
        if store and folder is not None:
            save(gait, folder)
    finally:  # what was computed is printed even where it cannot be kept
        if json:
            print_json(record)
        elif gait.converged:
            print_gait(results(), record)
        else:
            results().print(f"{gait.problem.name}: {gait.status}: {gait.message}")
            results().print(f"`gaitopt explain {gait.problem.name}` says more")
    if not gait.converged:
        return NOT_A_GAIT
    if folder is not None and not json:
        results().print(f"run: {folder}", soft_wrap=True)
    return 0 if gait.verification is None or gait.verification["passed"] else NOT_VERIFIED
