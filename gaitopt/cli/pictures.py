"""Commands that draw: ``plot``, ``report`` and ``reproduce``."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from gaitopt.cli.options import RunArguments, SetOption
from gaitopt.cli.runs import gaits_of
from gaitopt.cli.terminal import NOT_A_GAIT, Terminal

FIGURES = "figures"
"""Folder of the figures within a run folder."""
COMPARISON = "comparison"
"""Folder of the figures of several runs, in the working folder."""
REPORT, COMPARISON_REPORT = "report.html", "comparison.html"


class Format(StrEnum):
    """Formats of a figure."""

    SVG = "svg"
    PNG = "png"
    PDF = "pdf"


WhatOption = Annotated[
    list[str] | None,
    typer.Option(
        "--what", metavar="NAME", help="Name of a figure; repeat it for several. By default all that show something."
    ),
]
FormatOption = Annotated[list[Format] | None, typer.Option("--format", help="By default svg and png.")]
FolderOption = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--output",
        metavar="DIR",
        help="Folder of the figures; by default RUN/figures, of several runs ./comparison, of a basin or a sweep its "
        "own folder.",
        show_default=False,
    ),
]


def plot(
    terminal: Terminal,
    runs: RunArguments,
    what: WhatOption = None,
    formats: FormatOption = None,
    changes: SetOption = None,
    output: FolderOption = None,
) -> int:
    """Draw figures of a gait, of several gaits in one picture, of a walk, a branch, a basin, a sweep or a front.

    Of a gait: portrait, force, slip, torques, multipliers, roads (NLP and simulation) and animation (an HTML page).
    Of a walk that `simulate -o` has stored: section (states step by step), portrait, force, slip, torques, animation.
    Of a branch: multipliers, or any scalar of the result, for instance spectral_radius. Of a sweep, whose own folder
    is given as RUN: any scalar of the result. Of a front: front.
    """
    from gaitopt.api.pictures import ANIMATION, figures_in, figures_of, map_kind, save_figures
    from gaitopt.store.files import check_writable
    from gaitopt.store.run import Run

    if output is not None:
        check_writable(output / FIGURES)
    folder, alone = Path(runs[0]), len(runs) == 1
    figures = figures_in(folder) if alone else []
    if figures and map_kind(folder):
        folder, place = folder.resolve().parent, output or folder
    elif figures:
        place = output or folder / FIGURES
    else:
        gaits, folders = gaits_of(runs, changes, terminal)
        if not all(gait.converged for gait in gaits):
            return NOT_A_GAIT
        if not alone and {"roads", ANIMATION} & {*(what or ())}:
            raise typer.BadParameter(f"--what roads and animation show one gait, not {len(gaits)}")
        folder, place = folders[0], output or (folders[0] / FIGURES if alone else Path(COMPARISON))
        figures = [figures_of(gaits)]
    with Run(folder).adding(place) as written:
        for drawn in figures:
            written += save_figures(drawn, place, what or (), formats or (Format.SVG, Format.PNG))
    terminal.print_paths(written)
    return 0


FileOption = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="FILE", help="The page; by default RUN/report.html.", show_default=False),
]


def report(terminal: Terminal, runs: RunArguments, changes: SetOption = None, output: FileOption = None) -> int:
    """Write a page about a gait, a walk or a branch, or about several gaits side by side.

    The page is one file that needs no network. Several gaits go to comparison.html in this folder unless -o says
    otherwise.
    """
    from gaitopt.api.pictures import page_in
    from gaitopt.api.pictures import report as page_about
    from gaitopt.store.files import check_writable
    from gaitopt.store.run import Run

    if output is not None and (not output.name or output.is_dir()):
        raise typer.BadParameter(f"-o {output}: is a folder; give the name of the page, for instance page.html")
    if output is not None:
        check_writable(output)
    folder = Path(runs[0])
    page = page_in(folder) if len(runs) == 1 else None
    if page is None:
        gaits, folders = gaits_of(runs, changes, terminal)
        if not all(gait.converged for gait in gaits):
            return NOT_A_GAIT
        page, folder = page_about(*gaits), folders[0]
    path = output or (folder / REPORT if len(runs) == 1 else Path(COMPARISON_REPORT))
    with Run(folder).adding(path.parent) as written:
        written.append(page.save(path))
    terminal.print_paths([path])
    return 0


PaperArgument = Annotated[str, typer.Argument(metavar="PAPER", help="gamus-or-2013.")]
OnlyOption = Annotated[
    list[str] | None,
    typer.Option("--only", metavar="NAME", help="A figure, for instance fig9, or table; repeat it for several."),
]
ReproduceFolderOption = Annotated[
    Path | None, typer.Option("-o", "--output", metavar="DIR", help="By default results/PAPER.", show_default=False)
]


def reproduce(
    terminal: Terminal, paper: PaperArgument, only: OnlyOption = None, output: ReproduceFolderOption = None
) -> int:
    """Write the figures of a paper, and a table of its printed numbers beside the computed ones.

    Gaits and families are taken from the run folders in results/, or computed on all cores and kept there.
    """
    from gaitopt.paper.gaits import Archive
    from gaitopt.paper.reproduction import check_names
    from gaitopt.paper.reproduction import reproduce as write
    from gaitopt.store.run import RESULTS
    from gaitopt.workers.jobs import Workers

    check_names(paper, only or ())
    with terminal.working("percent") as (progress, interrupted):
        archive = Archive(narrate=terminal.say, should_stop=interrupted)
        written = write(archive, output or RESULTS / paper, only or (), progress, Workers())
    terminal.print_paths(written)
    return 0
