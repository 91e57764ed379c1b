"""What a user means by RUN: a run folder, or a problem whose gait is in the store or is solved now.

The branch in a run folder, as the continuation wrote it, and its special points ``RUN@special.K``.

Figures as files: of what a command has just computed, and of what is stored in a folder.
"""

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from gaitopt.cli.terminal import NOT_A_GAIT, NOT_VERIFIED, Terminal
from gaitopt.cli.values import overrides
from gaitopt.errors import StorageError, UnknownNameError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from gaitopt.gait.gait import Gait
    from gaitopt.problem.problem import Problem
    from gaitopt.show.catalogue import Figures


PROBLEM_SUFFIXES = (".yaml", ".yml")


def load(problem: str, changes: list[str] | None, terminal: Terminal | None = None) -> "Problem":
    """The problem of a name or a file, with the ``--set`` options applied; what is unusual about it is remarked."""
    from gaitopt.problem.problem import load_problem

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
    from gaitopt.problem.faults import shown
    from gaitopt.problem.source import problem_names

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
    from gaitopt.runs.results import refuse_other_results, restore_gait
    from gaitopt.store.run import GAIT_FILE

    if changes:
        raise typer.BadParameter(f"--set changes a problem, but {run} is a finished run; give its problem instead")
    folder = Path(run)
    if not (folder / GAIT_FILE).is_file():
        refuse_other_results(folder)
    return restore_gait(folder), folder


def gait_of(run: str, changes: list[str] | None, output: Path | None, terminal: Terminal) -> "tuple[Gait, Path, bool]":
    """A gait, its run folder, and whether it was solved just now (and is verified, but not stored)."""
    from gaitopt.store.run import GAIT_FILES, Run

    if is_folder(run):
        return (*stored_gait(run, changes), False)
    problem = load(run, changes, terminal)
    stored = Run.of(problem, output)
    folder = stored.folder
    stored.check(problem)
    if stored.holds(*GAIT_FILES):
        terminal.say(f"taken from {folder}")
        return (*stored_gait(str(folder), None), False)
    return solve_verified(problem, terminal), folder, True


def gaits_of(runs: "Sequence[str]", changes: list[str] | None, terminal: Terminal) -> "tuple[list[Gait], list[Path]]":
    """Gaits and their run folders; what was solved just now is stored, and a failed attempt is reported.

    A gait that was stored is read back: times in a run folder are rounded sums, and the same command shall give the
    same figures to the last byte when it is repeated.
    """
    from gaitopt.api.stored import save
    from gaitopt.runs.results import restore_gait

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
    from gaitopt.verification import verify as verification

    if not gait.converged:
        return gait
    if gait.message != "solved":
        terminal.say(gait.message)
    terminal.say("verifying by forward simulation")
    return gait.verified(verification.verify(gait).to_record())


def report(
    gait: "Gait",
    folder: Path | None,
    terminal: Terminal,
    *,
    store: bool = False,
    about: "Mapping[str, Any] | None" = None,
) -> int:
    """Print a gait (and what else is known about it) or its failure, store it if ``store``; returns the exit code."""
    from gaitopt.api.stored import save
    from gaitopt.show.tables import print_gait

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


SPECIAL = "@special."


def stored_branch(run: str, label: str = "") -> "tuple[Problem, str, list[dict[str, Any]]]":
    """Problem, parameter and records of the branch in a run folder; ``label`` begins the words of an error."""
    from gaitopt.runs import branch
    from gaitopt.runs.results import kind_of

    if kind_of(Path(run)) != "branch":
        raise StorageError(f"{label}{run} holds no branch; `gaitopt continue` writes one")
    return branch.stored_branch(Path(run))


def special_records(run: str, label: str = "") -> "tuple[Problem, str, list[dict[str, Any]]]":
    """Problem and parameter of a branch, and the records of its special points in the order of the table."""
    problem, parameter, records = stored_branch(run, label)
    return problem, parameter, [record for record in records if record.get("record") == "special"]


DRAWN_AXES = 2
ANIMATION = "animation"


class Format(StrEnum):
    """Formats of a figure."""

    SVG = "svg"
    PNG = "png"
    PDF = "pdf"


DEFAULT_FORMATS = (Format.SVG, Format.PNG)


def save_figures(
    figures: "Figures", folder: Path, what: Sequence[str] | None = None, formats: Sequence[str] = DEFAULT_FORMATS
) -> list[Path]:
    """Draw figures into a folder, those that show something if ``what`` names none; the files."""
    from gaitopt.show.style import save
    from gaitopt.store.files import write_whole

    moving = [] if figures.animation is None else [ANIMATION]
    known, written = (*figures.names, *moving), list[Path]()
    unknown = [word for word in what or () if word not in known]
    if unknown:
        raise typer.BadParameter(f"--what {unknown[0]}: choose from {', '.join(known)}")
    for word in what or (*figures.usual, *moving):
        if word == ANIMATION and figures.animation is not None:
            written.append(folder / f"{ANIMATION}.html")
            write_whole(written[-1], figures.animation())
        else:
            written += save(figures.draw(word), folder / (figures.stem or word), formats)
    return written


def stored_figures(run: str) -> "list[Figures]":
    """The figures of a run folder that holds a branch, a walk or fronts, and no gait; none of any other."""
    from gaitopt.runs.front import read_fronts
    from gaitopt.runs.results import kind_of, restore_walk
    from gaitopt.show.catalogue import branch_figures, front_figures, walk_figures

    kind = kind_of(Path(run))
    if kind == "branch":
        return [branch_figures(*stored_branch(run))]
    if kind == "walk":
        return [walk_figures(restore_walk(Path(run)))]
    return [front_figures(front) for front in read_fronts(Path(run))] if kind == "front" else []


def map_in(run: str) -> str | None:
    """Whether ``run`` is the folder of a ``basin`` or of a ``sweep``, by the word that its name begins with."""
    from gaitopt.store.run import MANIFEST_FILE

    folder = Path(run)
    kind = folder.name.partition("-")[0]
    own = kind in ("basin", "sweep") and folder.is_dir() and not (folder / MANIFEST_FILE).exists()
    return kind if own else None


def map_figures(kind: str, folder: Path) -> "Figures":
    """The figures of the finished ``basin`` or ``sweep`` in its own folder."""
    from gaitopt.runs.basin import read_basin
    from gaitopt.runs.sweep import Sweep, read_sweep
    from gaitopt.show.catalogue import basin_figures, sweep_figures

    result = read_basin(folder) if kind == "basin" else read_sweep(folder)
    if len(result.grid.axes) > DRAWN_AXES:
        raise typer.BadParameter(f"{folder} is over {len(result.grid.axes)} keys; pictures are drawn over one or two")
    return sweep_figures(result) if isinstance(result, Sweep) else basin_figures(result)
