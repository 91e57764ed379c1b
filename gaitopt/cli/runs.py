"""The argument RUN: a run folder, or a problem whose gait is read from its run folder or solved now."""

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

import gaitopt as go
from gaitopt.cli.options import overrides
from gaitopt.cli.terminal import NOT_A_GAIT, NOT_VERIFIED, Terminal
from gaitopt.errors import GaitoptError, UnknownNameError
from gaitopt.requests import DEFAULT_LIMITS, SearchLimits

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from gaitopt.api.verbs import Output
    from gaitopt.gait.gait import Attractor, Gait
    from gaitopt.problem.problem import Problem
    from gaitopt.runs.multistart import Optimum


PROBLEM_SUFFIXES = (".yaml", ".yml")


def load(problem: str, changes: list[str] | None, terminal: Terminal | None = None) -> "Problem":
    """Load a problem by name, path or element of a run, and apply the ``--set`` options.

    Unusual values are warnings on the terminal.
    """
    from gaitopt.api.stored import is_element, problem_of_element

    stated = problem_of_element(problem) if is_element(problem) else go.load_problem(problem)
    changed = stated.replace(overrides(changes), label="--set ") if changes else stated
    if terminal is not None:
        options = [argument for text in changes or () for argument in ("--set", text)]
        terminal.typed.setdefault(stated.name, [problem, *options])
        for remark in changed.remarks:
            terminal.say(f"warning: {remark}")
    return changed


def is_folder(run: str) -> bool:
    """Whether ``run`` is a folder rather than a problem; a name of the catalogue is always the problem.

    Raises
    ------
    UnknownNameError
        If it is a path that does not exist, and not the name of a problem file.
    """
    from gaitopt.api.stored import is_element
    from gaitopt.problem.faults import shown

    path = Path(run)
    if run in go.problem_names():
        return False
    try:
        exists, is_dir = path.exists(), path.is_dir()
    except OSError as error:  # a name that is too long, for instance
        raise UnknownNameError(f"there is no run folder {shown(run)}: {error.strerror}") from error
    if is_element(run):
        return False
    if len(path.parts) > 1 and path.suffix not in PROBLEM_SUFFIXES and not exists:
        raise UnknownNameError(f"there is no run folder {run}; `ls results` lists the existing runs")
    return is_dir


def stored_gait(run: str, changes: list[str] | None) -> "Gait":
    """The gait in a run folder; ``--set`` is an error, because a finished run cannot change."""
    from gaitopt.runs.results import refuse_other_results, restore_gait
    from gaitopt.store.run import GAIT_FILE

    if changes:
        raise typer.BadParameter(f"--set changes a problem, but {run} is a finished run; give its problem instead")
    folder = Path(run)
    if not (folder / GAIT_FILE).is_file():
        refuse_other_results(folder)
    return restore_gait(folder)


def gait_of(
    run: str,
    changes: list[str] | None,
    output: Path | None,
    terminal: Terminal,
    *,
    keep: bool = True,
    required: bool = False,
    check: "Callable[[Problem], object] | None" = None,
) -> "tuple[Gait, Path, bool]":
    """A gait, its run folder, and whether it was solved just now.

    Parameters
    ----------
    keep : whether a new gait, which is verified, is stored.
    required : whether a failed solve is reported and ends the command.
    check : called with the problem before its gait is solved; refuses other arguments that are wrong for it.
    """
    from gaitopt.api import stored
    from gaitopt.store.run import Run

    if is_folder(run):
        return stored_gait(run, changes), Path(run), False
    problem = load(run, changes, terminal)
    if check is not None:
        check(problem)
    folder = Run.of(problem, output).folder
    gait = stored.stored_gait(problem, folder)
    if gait is not None:
        terminal.say(f"taken from {folder}")
        return gait, folder, False
    gait = solve_verified(problem, terminal, folder if keep else False)
    if required and not gait.converged:
        raise typer.Exit(report(gait, None, terminal))
    return gait, folder, True


def gaits_of(
    runs: "Sequence[str]",
    changes: list[str] | None,
    terminal: Terminal,
    check: "Callable[[Problem], object] | None" = None,
) -> "tuple[list[Gait], list[Path]]":
    """Gaits and their run folders, see ``gait_of``; failed solves are reported.

    A new gait is read back from its folder, where times are rounded sums, so that a repeated command writes the same
    figures to the last byte.
    """
    from gaitopt.runs.results import restore_gait

    gaits, folders = list["Gait"](), list[Path]()
    for run in runs:
        gait, folder, fresh = gait_of(run, changes, None, terminal, check=check)
        if not gait.converged:
            report(gait, None, terminal)
        elif fresh:
            gait = restore_gait(folder)
        gaits.append(gait)
        folders.append(folder)
    return gaits, folders


def solve_verified(
    question: "Problem | Attractor",
    terminal: Terminal,
    output: "Output",
    method: str = "auto",
    start: "Optimum | None" = None,
    *,
    limits: SearchLimits = DEFAULT_LIMITS,
) -> "Gait":
    """The verified gait of a problem or an attractor, stored as ``output`` says; or the failed solve."""
    from gaitopt.gait.gait import Attractor

    name = question.problem.name if isinstance(question, Attractor) else question.name
    with terminal.solving(name) as (progress, interrupted):
        gait = go.solve(
            question, start=start, method=method, newton_steps=limits.newton_steps,
            ipopt_iterations=limits.ipopt_iterations, intervals=limits.intervals, output=output,
            progress=progress, should_stop=interrupted,
        )  # fmt: skip
        if isinstance(output, Path) and not gait.converged and gait.best is not None and interrupted():
            terminal.say(_where_it_ended(output))
    if not gait.converged:
        return gait
    return gait if gait.verification is not None else gait.verified(go.verify(gait).to_record())


def report(gait: "Gait", folder: Path | None, terminal: Terminal, more: "Mapping[str, Any] | None" = None) -> int:
    """Print a gait with the entries of ``more``, or its failure; returns the exit code."""
    from gaitopt.show.tables import print_gait

    def print_attempt(console: "Any", record: "Mapping[str, Any]") -> None:
        if gait.converged:
            print_gait(console, record, gait.problem, every=terminal.every)
            return
        console.print(f"{gait.problem.name}: {gait.status}: {gait.message}")
        if folder is not None:
            console.print(_where_it_ended(folder), soft_wrap=True)
        arguments = terminal.typed.get(gait.problem.name, [gait.problem.name])
        console.print(f"`gaitopt explain {shlex.join(arguments)}` says more", soft_wrap=True)

    folder = folder if gait.converged or gait.best is not None else None
    record = {**gait.to_record(), "run": None if folder is None else str(folder), **(more or {})}
    terminal.show(record, print_attempt, *([] if folder is None else ["run"]))
    if not gait.converged:
        return NOT_A_GAIT
    return 0 if gait.verification is None or gait.verification["passed"] else NOT_VERIFIED


def _where_it_ended(folder: Path) -> str:
    return f"the point where it ended is in {folder}; `--start {folder}` goes on from it"


@contextmanager
def shown_result(show: "Callable[[Any], object]") -> Iterator[None]:
    """Show the result that an error in the block carries, if any; such a result could not be stored or used."""
    try:
        yield
    except GaitoptError as error:
        if error.result is not None:
            show(error.result)
        raise
