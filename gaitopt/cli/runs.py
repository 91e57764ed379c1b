"""What a user means by RUN: a run folder, or a problem whose gait is in the store or is solved now."""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from gaitopt.cli.endings import NOT_A_GAIT, NOT_VERIFIED
from gaitopt.cli.terminal import Terminal
from gaitopt.cli.values import overrides
from gaitopt.errors import UnknownNameError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from gaitopt.gait import Gait
    from gaitopt.problem import Problem

PROBLEM_SUFFIXES = (".yaml", ".yml")


def load(problem: str, changes: list[str] | None, terminal: Terminal | None = None) -> "Problem":
    """The problem of a name or a file, with the ``--set`` options applied; what is unusual about it is remarked."""
    from gaitopt.problem import load_problem

    stated = load_problem(problem)
    changed = stated.replace(overrides(changes), label="--set ") if changes else stated
    if terminal is not None:
        for remark in changed.remarks:
            terminal.say(f"warning: {remark}")
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
    """The gait in a run folder, and the folder; with ``--set`` that is an error, as a run is what it is."""
    from gaitopt.runs.restore import restore_gait
    from gaitopt.runs.within import refuse_other_results
    from gaitopt.store import GAIT_FILE

    if changes:
        raise typer.BadParameter(f"--set changes a problem, but {run} is a finished run; give its problem instead")
    folder = Path(run)
    if not (folder / GAIT_FILE).is_file():
        refuse_other_results(folder)
    return restore_gait(folder), folder


def gait_of(run: str, changes: list[str] | None, output: Path | None, terminal: Terminal) -> "tuple[Gait, Path, bool]":
    """A gait, its run folder, and whether it was solved just now (and is verified, but not stored)."""
    from gaitopt.store import check_folder, is_complete, run_folder

    if is_folder(run):
        return (*stored_gait(run, changes), False)
    problem = load(run, changes, terminal)
    folder = output or run_folder(problem)
    check_folder(folder, problem)
    if is_complete(folder):
        terminal.say(f"taken from {folder}")
        return (*stored_gait(str(folder), None), False)
    return solve_verified(problem, terminal), folder, True


def gaits_of(runs: "Sequence[str]", changes: list[str] | None, terminal: Terminal) -> "tuple[list[Gait], list[Path]]":
    """Gaits and their run folders; what was solved just now is stored, and a failed attempt is reported.

    A gait that was stored is read back: times in a run folder are rounded sums, and the same command shall give the
    same figures to the last byte when it is repeated.
    """
    from gaitopt.library.stored import save
    from gaitopt.runs.restore import restore_gait

    gaits, folders = list["Gait"](), list[Path]()
    for run in runs:
        gait, folder, fresh = gait_of(run, changes, None, terminal)
        if not gait.converged:
            report(gait, None, terminal)
        elif fresh:
            gait = restore_gait(save(gait, folder))
        gaits.append(gait)
        folders.append(folder)
    return gaits, folders


def solve_verified(problem: "Problem", terminal: Terminal) -> "Gait":
    """The gait of a problem with its verification, or the failed attempt."""
    from gaitopt.search import solve as solving

    with terminal.solving(problem.name) as (progress, interrupted):
        gait = solving.solve(problem, progress=progress, should_stop=interrupted)
    return verified(gait, terminal)


def verified(gait: "Gait", terminal: Terminal) -> "Gait":
    """A gait with its verification; a failed attempt as it is."""
    from gaitopt import study

    if not gait.converged:
        return gait
    if gait.message != "solved":
        terminal.say(gait.message)
    terminal.say("verifying by forward simulation")
    return gait.verified(study.verify(gait).to_record())


def report(
    gait: "Gait",
    folder: Path | None,
    terminal: Terminal,
    *,
    store: bool = False,
    about: "Mapping[str, Any] | None" = None,
) -> int:
    """Print a gait (and what else is known about it) or its failure, store it if ``store``; returns the exit code."""
    from gaitopt.library.print_gait import print_gait
    from gaitopt.library.stored import save

    def print_attempt(console: "Any", record: "Mapping[str, Any]") -> None:
        if gait.converged:
            print_gait(console, record)
            return
        console.print(f"{gait.problem.name}: {gait.status}: {gait.message}")
        console.print(f"`gaitopt explain {gait.problem.name}` says more")

    record = {**gait.to_record(), "run": None if folder is None else str(folder), **(about or {})}
    try:
        if store and folder is not None:
            save(gait, folder)
    finally:  # what was computed is printed even where it cannot be kept
        terminal.show(record, print_attempt, *(["run"] if gait.converged and folder is not None else []))
    if not gait.converged:
        return NOT_A_GAIT
    return 0 if gait.verification is None or gait.verification["passed"] else NOT_VERIFIED
