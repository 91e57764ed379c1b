"""What a user means by RUN: a run folder, or a problem whose gait is in the store or is solved now."""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from gaitopt.cli.options import overrides
from gaitopt.errors import UnknownNameError

if TYPE_CHECKING:
    from rich.console import Console

    from gaitopt.gait import Gait
    from gaitopt.problem import Problem

PROBLEM_SUFFIXES = (".yaml", ".yml")


def load(problem: str, changes: list[str] | None, console: "Console | None" = None) -> "Problem":
    """The problem of a name or a file, with the ``--set`` options applied; what is unusual about it is remarked."""
    from gaitopt.problem import load_problem

    stated = load_problem(problem)
    changed = stated.replace(overrides(changes), label="--set ") if changes else stated
    if console is not None:
        for remark in changed.remarks:
            console.print(f"warning: {remark}", soft_wrap=True)
    return changed


def is_folder(run: str) -> bool:
    """Whether ``run`` is a folder rather than a problem; a name of the catalogue is always the problem.

    Raises
    ------
    UnknownNameError
        If it is a path to nothing, and no problem file.
    """
    from gaitopt.problem import problem_names
    from gaitopt.problem.faults import shown

    path = Path(run)
    if run in problem_names():
        return False
    try:
        exists, is_dir = path.exists(), path.is_dir()
    except OSError as error:  # a name that is too long, for instance
        raise UnknownNameError(f"there is no run folder {shown(run)}: {error.strerror}") from error
    if len(path.parts) > 1 and path.suffix not in PROBLEM_SUFFIXES and not exists:
        raise UnknownNameError(f"there is no run folder {run}; `ls results` shows those that there are")
    return is_dir


def stored_gait(run: str, changes: list[str] | None) -> "tuple[Gait, Path]":
    """The gait in a run folder, and the folder.

    Raises
    ------
    typer.BadParameter
        If ``--set`` is given as well: a run is what it is.
    """
    from gaitopt.runs.restore import restore_gait
    from gaitopt.runs.within import refuse_other_results
    from gaitopt.store import GAIT_FILE, read_run

    if changes:
        raise typer.BadParameter(f"--set changes a problem, but {run} is a finished run; give its problem instead")
    if not (Path(run) / GAIT_FILE).is_file():
        refuse_other_results(Path(run))
    return restore_gait(read_run(Path(run))), Path(run)


def gait_of(run: str, changes: list[str] | None, output: Path | None, console: "Console") -> "tuple[Gait, Path, bool]":
    """A gait, its run folder, and whether it was solved just now (and is verified, but not stored)."""
    from gaitopt.cli.solve import solve_verified
    from gaitopt.store import check_folder, is_complete, run_folder

    if is_folder(run):
        return (*stored_gait(run, changes), False)
    problem = load(run, changes, console)
    folder = output or run_folder(problem)
    check_folder(folder, problem)
    if is_complete(folder):
        console.print(f"taken from {folder}", soft_wrap=True)
        return (*stored_gait(str(folder), None), False)
    return solve_verified(problem, console), folder, True
