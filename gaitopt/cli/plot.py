"""``gaitopt plot``: figures of a gait, a branch, a basin, a sweep or a front, and the moving walker."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gaitopt.cli.branches import holds_branch, holds_front, holds_walk, stored_branch
from gaitopt.cli.endings import NOT_A_GAIT
from gaitopt.cli.maps import DEFAULT_FORMATS, Format, check_words, draw_again, draw_front, map_in
from gaitopt.cli.options import RunArguments, SetOption
from gaitopt.cli.runs import gaits_of
from gaitopt.cli.terminal import Terminal

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from matplotlib.figure import Figure

    from gaitopt.figures.motion import Motion
    from gaitopt.gait import Gait

FIGURES = "figures"
"""Folder of the figures within a run folder."""
COMPARISON = "comparison"
"""Folder of the figures of several runs, in the working folder."""
ANIMATION = "animation"

WhatOption = Annotated[
    list[str] | None,
    typer.Option(
        "--what", metavar="NAME", help="Which figure; repeat it for several. Without it all that tell something."
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
    from gaitopt.store import adding, check_writable

    if output is not None:
        check_writable(output / FIGURES)
    kind = map_in(runs[0]) if len(runs) == 1 else None
    drawn = formats or DEFAULT_FORMATS
    own = Path(runs[0])
    if kind is not None:
        with adding(own.resolve().parent, output or own) as written:
            written += draw_again(kind, own, what, drawn, output or own)
    elif len(runs) == 1 and (draw := _other_kind(runs[0])):
        with adding(own, output or own / FIGURES) as written:
            written += draw(own, what, drawn, output or own / FIGURES)
    else:
        gaits, folders = gaits_of(runs, changes, terminal)
        if not all(gait.converged for gait in gaits):
            return NOT_A_GAIT
        place = output or (folders[0] / FIGURES if len(gaits) == 1 else Path(COMPARISON))
        with adding(folders[0], place) as written:
            written += _plot_gaits(gaits, what, drawn, place)
    terminal.print_paths(written)
    return 0


def _other_kind(run: str) -> "Callable[[Path, list[str] | None, Sequence[str], Path], list[Path]] | None":
    """What draws a run folder that holds no gait."""
    kinds = {holds_branch: _plot_branch, holds_walk: _plot_walk, holds_front: _plot_fronts}
    return next((draw for holds, draw in kinds.items() if holds(run)), None)


def _plot_gaits(gaits: "Sequence[Gait]", what: list[str] | None, formats: "Sequence[str]", folder: Path) -> list[Path]:
    from gaitopt.figures.catalogue import GAIT_FIGURES, informative
    from gaitopt.figures.motion import motion_of

    words = what or [*informative(gaits), *([ANIMATION] if len(gaits) == 1 else [])]
    check_words(words, (*GAIT_FIGURES, ANIMATION))
    alone = [word for word in words if word in ("roads", ANIMATION) and len(gaits) > 1]
    if alone:
        raise typer.BadParameter(f"--what {alone[0]} shows one gait, not {len(gaits)}")
    draw = {word: partial(figure, gaits) for word, figure in GAIT_FIGURES.items()}
    return _drawn(words, draw, formats, folder, motion_of(gaits[0]), gaits[0].problem.about)


def _plot_walk(run: Path, what: list[str] | None, formats: "Sequence[str]", folder: Path) -> list[Path]:
    from gaitopt.figures.catalogue import USUAL_WALK_FIGURES, WALK_FIGURES
    from gaitopt.figures.motion import motion_of_walk
    from gaitopt.runs.restore import restore_walk

    words = what or [*USUAL_WALK_FIGURES, ANIMATION]
    check_words(words, (*WALK_FIGURES, ANIMATION))
    walk = restore_walk(run)
    draw = {word: partial(figure, walk) for word, figure in WALK_FIGURES.items()}
    return _drawn(words, draw, formats, folder, motion_of_walk(walk), walk.trajectory.message)


def _drawn(
    words: "Sequence[str]",
    draw: "Mapping[str, Callable[[], Figure]]",
    formats: "Sequence[str]",
    folder: Path,
    motion: "Motion",
    about: str,
) -> list[Path]:
    """Write the figures with these names, and the animation of a motion; the files."""
    from gaitopt.figures.animation import animation_page
    from gaitopt.figures.style import save
    from gaitopt.store import write_whole

    written: list[Path] = []
    for word in words:
        if word == ANIMATION:
            written.append(folder / f"{ANIMATION}.html")
            write_whole(written[-1], animation_page(motion, about))
        else:
            written += save(draw[word](), folder / word, formats)
    return written


def _plot_branch(run: Path, what: list[str] | None, formats: "Sequence[str]", folder: Path) -> list[Path]:
    from gaitopt.figures.catalogue import BRANCH_FIGURES, branch_figure, usual_branch_figures
    from gaitopt.figures.style import save

    check_words(what or [], BRANCH_FIGURES)
    problem, parameter, records = stored_branch(str(run))
    words = what or usual_branch_figures(records)
    drawn = [save(branch_figure(word, problem, parameter, records), folder / word, formats) for word in words]
    return [path for paths in drawn for path in paths]


def _plot_fronts(run: Path, what: list[str] | None, formats: "Sequence[str]", folder: Path) -> list[Path]:
    from gaitopt.runs.front import read_fronts

    check_words(what or [], ("front",))
    return [path for front in read_fronts(run) for path in draw_front(front, formats, folder)]
