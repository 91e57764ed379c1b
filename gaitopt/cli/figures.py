"""Figures as files: of what a command has just computed, and of what is stored in a folder."""

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from gaitopt.cli.branches import stored_branch

if TYPE_CHECKING:
    from gaitopt.figures.catalogue import Figures

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
    from gaitopt.figures.style import save
    from gaitopt.store import write_whole

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
    from gaitopt.figures.catalogue import branch_figures, front_figures, walk_figures
    from gaitopt.runs.front import read_fronts
    from gaitopt.runs.restore import restore_walk
    from gaitopt.runs.within import kind_of

    kind = kind_of(Path(run))
    if kind == "branch":
        return [branch_figures(*stored_branch(run))]
    if kind == "walk":
        return [walk_figures(restore_walk(Path(run)))]
    return [front_figures(front) for front in read_fronts(Path(run))] if kind == "front" else []


def map_in(run: str) -> str | None:
    """Whether ``run`` is the folder of a ``basin`` or of a ``sweep``, by the word that its name begins with."""
    from gaitopt.store.manifest import MANIFEST_FILE

    folder = Path(run)
    kind = folder.name.partition("-")[0]
    own = kind in ("basin", "sweep") and folder.is_dir() and not (folder / MANIFEST_FILE).exists()
    return kind if own else None


def map_figures(kind: str, folder: Path) -> "Figures":
    """The figures of the finished ``basin`` or ``sweep`` in its own folder."""
    from gaitopt.figures.catalogue import basin_figures, sweep_figures
    from gaitopt.runs.basin_tiles import read_basin
    from gaitopt.runs.sweep_table import Sweep, read_sweep

    result = read_basin(folder) if kind == "basin" else read_sweep(folder)
    if len(result.grid.axes) > DRAWN_AXES:
        raise typer.BadParameter(f"{folder} is over {len(result.grid.axes)} keys; pictures are drawn over one or two")
    return sweep_figures(result) if isinstance(result, Sweep) else basin_figures(result)
