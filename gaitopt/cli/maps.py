"""Pictures of basins, sweeps and fronts: as soon as they are finished, and once more from their folders."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from gaitopt.runs.basin_tiles import Basin
    from gaitopt.runs.front import Front
    from gaitopt.runs.grid import Grid
    from gaitopt.runs.sweep_table import Sweep

BASIN = "basin"
DRAWN_AXES = 2
USUAL_SCALAR = "spectral_radius"
"""What is drawn of a sweep unless the user says otherwise."""


class Format(StrEnum):
    """Formats of a figure."""

    SVG = "svg"
    PNG = "png"
    PDF = "pdf"


DEFAULT_FORMATS = (Format.SVG, Format.PNG)


def draw_basin(result: "Basin", formats: "Sequence[str]", folder: Path) -> list[Path]:
    """Draw a basin over one or two coordinates into a folder; the files."""
    from gaitopt.figures.basin import basin
    from gaitopt.figures.style import save

    return save(basin(result), folder / BASIN, formats)


def draw_sweep(result: "Sweep", scalars: "Sequence[str]", formats: "Sequence[str]", folder: Path) -> list[Path]:
    """Draw scalars of a sweep over one or two parameters into a folder; the files."""
    from gaitopt.figures.style import save
    from gaitopt.figures.sweep import sweep

    drawn = [
        save(sweep(result.grid, result.records, scalar, searched=result.problem.is_open), folder / scalar, formats)
        for scalar in scalars
    ]
    return [path for paths in drawn for path in paths]


def draw_front(result: "Front", formats: "Sequence[str]", folder: Path) -> list[Path]:
    """Draw a front into a folder, beside its file; the files."""
    from gaitopt.figures.front import front_figure
    from gaitopt.figures.style import save
    from gaitopt.runs.front import front_file

    figure = front_figure(result.problem, result.key, result.to_records())
    return save(figure, folder / Path(front_file(result.key)).stem, formats)


def map_in(run: str) -> str | None:
    """Whether ``run`` is the folder of a ``basin`` or of a ``sweep``, by the word that its name begins with."""
    from gaitopt.store.manifest import MANIFEST_FILE

    folder = Path(run)
    kind = folder.name.partition("-")[0]
    own = kind in (BASIN, "sweep") and folder.is_dir() and not (folder / MANIFEST_FILE).exists()
    return kind if own else None


def draw_again(kind: str, folder: Path, what: list[str] | None, formats: "Sequence[str]", output: Path) -> list[Path]:
    """Draw what a finished basin or sweep has left in its folder; the files.

    Raises
    ------
    StorageError
        If it is not finished, or broken.
    typer.BadParameter
        If it has no such figure.
    """
    from gaitopt.problem import SCALARS
    from gaitopt.runs.basin_tiles import read_basin
    from gaitopt.runs.sweep_table import read_sweep

    if kind == BASIN:
        check_words(what or [], (BASIN,))
        basin = read_basin(folder)
        _check_axes(basin.grid, folder)
        return draw_basin(basin, formats, output)
    check_words(what or [], tuple(SCALARS))
    result = read_sweep(folder)
    _check_axes(result.grid, folder)
    return draw_sweep(result, what or [USUAL_SCALAR], formats, output)


def check_words(words: list[str], known: "Sequence[str]") -> None:
    """Refuse a ``--what`` that is none of ``known``."""
    unknown = [word for word in words if word not in known]
    if unknown:
        raise typer.BadParameter(f"--what {unknown[0]}: choose from {', '.join(known)}")


def _check_axes(grid: "Grid", folder: Path) -> None:
    if len(grid.axes) > DRAWN_AXES:
        raise typer.BadParameter(f"{folder} is over {len(grid.axes)} keys; pictures are drawn over one or two")
