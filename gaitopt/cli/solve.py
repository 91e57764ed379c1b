"""``gaitopt solve``: a problem's gait, verified and stored."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gaitopt.cli.branches import stored_branch
from gaitopt.cli.options import GuessOption, OutOption, SchedulerOption, SeedOption, SetOption, WorkersOption
from gaitopt.cli.runs import gait_of, load, report, solve_verified, verified
from gaitopt.cli.terminal import Terminal
from gaitopt.errors import ProblemError, SolveError, StorageError

if TYPE_CHECKING:
    from gaitopt.gait import Gait
    from gaitopt.problem import Problem
    from gaitopt.runs.multistart import Optimum
    from gaitopt.workers.jobs import Workers

ATTRACTOR = "@attractor."
LARGEST_SPREAD = 0.99
"""Below one, no coordinate of a sample changes its sign."""
StartOption = Annotated[
    str | None,
    typer.Option(
        "--start",
        metavar="RUN[@BRANCH.INDEX]",
        help="Guess the gait of a run, or a point of its branch (columns branch and index of branch.csv).",
        show_default=False,
    ),
]
StartsOption = Annotated[
    int, typer.Option("--starts", min=1, help="Solve from so many guesses, sampled around the first; keep the best.")
]
SpreadOption = Annotated[
    float,
    typer.Option(
        "--spread", min=0.0, max=LARGEST_SPREAD, help="How far samples go from the first guess, relative to it."
    ),
]

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
    from_guess: GuessOption = False,
    output: OutOption = None,
) -> int:
    """Solve for a gait, verify it and store it.

    With --set KEY=VALUE the file's own gait is followed to the new values; if its family ends on the way, the message
    says where and why. --from-guess looks for a gait near the guess of the file instead.

    With --starts the distinct solutions are listed and the best one is kept; what each start has found stays in the
    run folder, so that the same command resumes where it stopped.
    """
    from gaitopt.store import run_folder, writing
    from gaitopt.workers.jobs import make_workers

    if ATTRACTOR in problem:
        if changes or start or starts > 1 or from_guess:
            raise typer.BadParameter(
                f"{problem} is a gait as it is: --set, --start, --starts and --from-guess change a problem"
            )
        return _solve_attractor(problem, output, terminal)
    loaded = load(problem, changes, terminal)
    loaded = loaded.from_guess() if from_guess else loaded
    loaded = _started(loaded, start, terminal) if start else loaded
    folder = output or run_folder(loaded)
    jobs_at = make_workers(workers, scheduler)
    with writing(folder, loaded):
        if starts == 1:
            return _report_solved(solve_verified(loaded, terminal), folder, terminal)
        optima = _optima(loaded, starts, seed, spread, folder, jobs_at, terminal)
        about = {"starts": starts, "optima": [optimum.to_record() for optimum in optima]}
        gait = solve_verified(optima[0].problem if optima else loaded, terminal)
        return _report_solved(replace(gait, problem=loaded), folder, terminal, about)


def _report_solved(gait: "Gait", folder: Path, terminal: Terminal, about: dict[str, Any] | None = None) -> int:
    return report(gait, folder if gait.converged else None, terminal, store=True, about=about)


def _optima(
    problem: "Problem", starts: int, seed: int, spread: float, folder: Path, workers: "Workers", terminal: Terminal
) -> "list[Optimum]":
    """The distinct solutions from many starts, printed."""
    from gaitopt.library.print_results import print_optima
    from gaitopt.runs.multistart import multistart

    with terminal.working("starts") as (progress, interrupted):
        optima = multistart(
            problem, starts, folder, seed=seed, spread=spread, workers=workers,
            progress=progress, should_stop=interrupted,
        )  # fmt: skip
    if not terminal.json:
        print_optima(terminal.results, optima, starts)
    return optima


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
        return _report_solved(gait, folder, terminal)


def _started(problem: "Problem", start: str, terminal: Terminal) -> "Problem":
    """The problem with a known gait as its guess."""
    from gaitopt.study.warm import guessed_from

    if "@" in start:
        source, record, known = _branch_point(start)
    else:
        gait, _, _ = gait_of(start, None, None, terminal)
        if not gait.converged:
            raise SolveError(f"--start {start}: {gait.status}: {gait.message}")
        source, record, known = gait.problem, gait.to_record(), gait.dynamics.parameters
    if source.walker.model != problem.walker.model:
        raise ProblemError(
            f"--start {start}: a gait of {source.walker.model}, but {problem.name} has {problem.walker.model}"
        )
    return guessed_from(problem, record, known)


def _branch_point(start: str) -> "tuple[Problem, dict[str, Any], dict[str, float]]":
    run, _, place = start.rpartition("@")
    problem, parameter, records = stored_branch(run, f"--start {start}: ")
    points = {f"{r['branch']}.{r['index']}": r for r in records if r.get("record") == "point"}
    if place not in points:
        raise StorageError(
            f"--start {start}: the branch has no point {place}; its points are {next(iter(points))} to "
            f"{list(points)[-1]}, in columns branch and index of branch.csv"
        )
    record = points[place]
    return problem, record, problem.parameters | record["parameters"] | {parameter: record["value"]}
