"""Where ``gaitopt solve`` starts: from a known gait instead of the file's guess, or from many sampled guesses."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from gaitopt.cli.branches import stored_branch
from gaitopt.cli.runs import gait_of
from gaitopt.cli.terminal import Terminal
from gaitopt.errors import ProblemError, SolveError, StorageError

if TYPE_CHECKING:
    from gaitopt.problem import Problem

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


def started(problem: "Problem", start: str, terminal: Terminal) -> "Problem":
    """The problem with a known gait as its guess."""
    from gaitopt.study.warm import guessed_from

    source, record, known = _branch_point(start) if "@" in start else _gait(start, terminal)
    if source.walker.model != problem.walker.model:
        raise ProblemError(
            f"--start {start}: a gait of {source.walker.model}, but {problem.name} has {problem.walker.model}"
        )
    return guessed_from(problem, record, known)


def _gait(run: str, terminal: Terminal) -> "tuple[Problem, dict[str, Any], dict[str, float]]":
    gait, _, _ = gait_of(run, None, None, terminal)
    if not gait.converged:
        raise SolveError(f"--start {run}: {gait.status}: {gait.message}")
    return gait.problem, gait.to_record(), gait.dynamics.parameters


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
