"""``gaitopt plot``: figures of a gait, a branch, a basin, a sweep or a front, and the moving walker."""

from pathlib import Path
from typing import Annotated

import typer

from gaitopt.cli.endings import NOT_A_GAIT
from gaitopt.cli.figures import (
    ANIMATION,
    DEFAULT_FORMATS,
    Format,
    map_figures,
    map_in,
    save_figures,
    stored_figures,
)
from gaitopt.cli.options import RunArguments, SetOption
from gaitopt.cli.runs import gaits_of
from gaitopt.cli.terminal import Terminal

FIGURES = "figures"
"""Folder of the figures within a run folder."""
COMPARISON = "comparison"
"""Folder of the figures of several runs, in the working folder."""

WhatOption = Annotated[
    list[str] | None,
    typer.Option(
        "--what", metavar="NAME", help="Which figure; repeat it for several. Without it all that show something."
    ),
]
FormatOption = Annotated[list[Format] | None, typer.Option("--format", help="svg and png if not given.")]
FolderOption = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--output",
        metavar="DIR",
        help="Where to; by default RUN/figures, of several runs ./comparison, of a basin or a sweep its own folder.",
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
    Of a branch: multipliers, or any scalar of the result, spectral_radius for instance. Of a sweep, whose own folder
    is given as RUN: any scalar of the result. Of a front: front.
    """
    from gaitopt.figures.catalogue import gait_figures
    from gaitopt.store import adding, check_writable

    if output is not None:
        check_writable(output / FIGURES)
    own, alone = Path(runs[0]), len(runs) == 1
    kind = map_in(runs[0]) if alone else None
    if kind is not None:
        folder, place = own.resolve().parent, output or own
        figures = [map_figures(kind, own)]
    elif alone and (figures := stored_figures(runs[0])):
        folder, place = own, output or own / FIGURES
    else:
        gaits, folders = gaits_of(runs, changes, terminal)
        if not all(gait.converged for gait in gaits):
            return NOT_A_GAIT
        if not alone and {"roads", ANIMATION} & {*(what or ())}:
            raise typer.BadParameter(f"--what roads and animation show one gait, not {len(gaits)}")
        folder, place = folders[0], output or (folders[0] / FIGURES if alone else Path(COMPARISON))
        figures = [gait_figures(gaits)]
    with adding(folder, place) as written:
        for drawn in figures:
            written += save_figures(drawn, place, what, formats or DEFAULT_FORMATS)
    terminal.print_paths(written)
    return 0
