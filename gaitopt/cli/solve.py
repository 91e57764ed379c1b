"""``gaitopt solve``: a problem's gait, verified and stored; and the same for commands that need a gait."""

from pathlib import Path
from typing import TYPE_CHECKING

from gaitopt.cli.options import (
    DebugOption,
    JsonOption,
    OutOption,
    ProblemArgument,
    QuietOption,
    SetOption,
)

if TYPE_CHECKING:
    from rich.console import Console

    from gaitopt.gait import Gait
    from gaitopt.problem import Problem

NOT_A_GAIT = 4
NOT_VERIFIED = 5


def solve(
    problem: ProblemArgument,
    changes: SetOption = None,
    output: OutOption = None,
    json: JsonOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Solve for a gait, verify it and store it."""
    from gaitopt.cli.console import narration
    from gaitopt.cli.runs import asked
    from gaitopt.store import check_folder, run_folder

    found = asked(problem, changes)
    folder = output or run_folder(found)
    check_folder(folder, found)
    gait = solve_verified(found, narration(quiet=quiet))
    return report(gait, folder if gait.converged else None, json=json, store=True)


def solve_verified(problem: "Problem", console: "Console") -> "Gait":
    """The gait of a problem with its verification, or the failed attempt.

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C was pressed, even if the solver swallowed it.
    """
    from gaitopt import study
    from gaitopt.cli.progress import interruptible, solver_progress
    from gaitopt.errors import SolveError

    with interruptible() as interrupted:
        try:
            with solver_progress(console, f"solving {problem.name}") as progress:
                gait = study.solve(problem, progress=progress, should_stop=interrupted)
        except SolveError:
            if interrupted():  # a reference whose solution was interrupted
                raise KeyboardInterrupt from None
            raise
        if interrupted():
            raise KeyboardInterrupt
        if not gait.converged:
            return gait
        console.print("verifying by forward simulation")
        return gait.verified(study.verify(gait).to_record())


def report(gait: "Gait", folder: Path | None, *, json: bool, store: bool = False) -> int:
    """Store if asked to, print a gait or what became of the attempt, and return the exit code."""
    from gaitopt.cli.console import print_json, results
    from gaitopt.cli.tables import print_gait

    record = {**gait.to_record(), "run": None if folder is None else str(folder)}
    try:
        if store and folder is not None:
            store_gait(gait, folder)
    finally:  # what was computed is printed even where it cannot be kept
        if json:
            print_json(record)
        elif gait.converged:
            print_gait(results(), record)
        else:
            results().print(f"{gait.problem.name}: {gait.status}: {gait.message}")
    if not gait.converged:
        return NOT_A_GAIT
    if folder is not None and not json:
        results().print(f"run: {folder}", soft_wrap=True)
    return 0 if gait.verification is None or gait.verification["passed"] else NOT_VERIFIED


def store_gait(gait: "Gait", folder: Path) -> None:
    """Write the run of a gait."""
    from gaitopt.cli.runs import motion_table
    from gaitopt.store import write_run

    assert gait.step is not None, "only a gait is stored"
    table = motion_table(gait.system, gait.p, [gait.step])
    write_run(folder, problem=gait.problem, gait=gait.to_record(), trajectory=table)
