"""Where ``gaitopt solve`` starts: a known gait instead of the file's guess, and many sampled guesses around it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from gaitopt.problem import Problem
    from gaitopt.runs.multistart import Optimum
    from gaitopt.workers.jobs import Workers

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
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Of the sampled guesses.")]
SpreadOption = Annotated[
    float,
    typer.Option(
        "--spread", min=0.0, max=LARGEST_SPREAD, help="How far samples go from the first guess, relative to it."
    ),
]


def started(problem: "Problem", start: str, console: "Console") -> "Problem":
    """The problem with a known gait as its guess.

    Raises
    ------
    ProblemError
        If it is a gait of another walker.
    SolveError
        If what is named is no gait.
    StorageError
        If there is no such point.
    """
    from gaitopt.errors import ProblemError
    from gaitopt.study.warm import guessed_from

    source, record, known = _branch_point(start) if "@" in start else _gait(start, console)
    if source.walker.model != problem.walker.model:
        raise ProblemError(
            f"--start {start}: a gait of {source.walker.model}, but {problem.name} has {problem.walker.model}"
        )
    return guessed_from(problem, record, known)


def sampled_optima(
    problem: "Problem", starts: int, folder: Path, seed: int, spread: float, workers: "Workers", console: "Console"
) -> "list[Optimum]":
    """What the starts have found; each is kept in the run folder as soon as it is there.

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C was pressed.
    """
    from gaitopt.cli.signals import interruptible
    from gaitopt.library.progress import job_progress
    from gaitopt.runs.multistart import multistart

    with interruptible() as interrupted, job_progress(console, "starts") as progress:
        return multistart(
            problem,
            starts,
            folder,
            seed=seed,
            spread=spread,
            workers=workers,
            progress=progress,
            should_stop=interrupted,
        )


def print_optima(console: "Console", optima: "list[Optimum]", starts: int) -> None:
    """One line per distinct solution."""
    converged = sum(len(optimum.starts) for optimum in optima)
    console.print(f"{starts} starts: {converged} found a gait, {len(optima)} of them distinct")
    for optimum in optima:
        times = f"{len(optimum.starts)} start{'s' if len(optimum.starts) > 1 else ''}"
        checked = "verified" if optimum.verified else "REFUTED"
        gait = f"period {optimum.record['period']:.6g} s, radius {optimum.radius:.4g}"
        console.print(f"  objective {optimum.objective:.9g}, {gait}, {times}, {checked}")


def _gait(run: str, console: "Console") -> "tuple[Problem, dict[str, Any], dict[str, float]]":
    from gaitopt.cli.runs import gait_of
    from gaitopt.errors import SolveError

    gait, _, _ = gait_of(run, None, None, console)
    if not gait.converged:
        raise SolveError(f"--start {run}: {gait.status}: {gait.message}")
    return gait.problem, gait.to_record(), gait.dynamics.parameters


def _branch_point(start: str) -> "tuple[Problem, dict[str, Any], dict[str, float]]":
    from gaitopt.cli.branches import holds_branch, stored_branch
    from gaitopt.errors import StorageError

    run, _, place = start.rpartition("@")
    if not holds_branch(run):
        raise StorageError(f"--start {start}: {run} holds no branch; `gaitopt continue` writes one")
    problem, parameter, records = stored_branch(run)
    points = {f"{r['branch']}.{r['index']}": r for r in records if r.get("record") == "point"}
    if place not in points:
        raise StorageError(
            f"--start {start}: the branch has no point {place}; its points are {next(iter(points))} to "
            f"{list(points)[-1]}, in columns branch and index of branch.csv"
        )
    record = points[place]
    return problem, record, problem.parameters | record["parameters"] | {parameter: record["value"]}
