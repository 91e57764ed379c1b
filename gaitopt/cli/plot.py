"""``gaitopt plot``: figures of a gait, a branch, a basin, a sweep or a front, and the moving walker."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gaitopt.cli.maps import DEFAULT_FORMATS, Format, check_words, draw_again, draw_front, map_in
from gaitopt.cli.options import DebugOption, QuietOption, SetOption
from gaitopt.cli.solve import NOT_A_GAIT

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from gaitopt.gait import Gait

FIGURES = "figures"
"""Folder of the figures within a run folder."""
COMPARISON = "comparison"
"""Folder of the figures of several runs, in the working folder."""
ANIMATION = "animation"

RunArguments = Annotated[list[str], typer.Argument(metavar="RUN...", help="Run folders, or PROBLEMs.")]
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
    runs: RunArguments,
    what: WhatOption = None,
    formats: FormatOption = None,
    changes: SetOption = None,
    output: FolderOption = None,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Draw figures of a gait, of several gaits in one picture, of a walk, a branch, a basin, a sweep or a front.

    Of a gait: portrait, force, slip, torques, multipliers, roads (NLP and simulation) and animation (an HTML page).
    Of a walk that `simulate -o` has stored: section (states step by step), portrait, force, slip, torques, animation.
    Of a branch: multipliers, or any scalar of the result, spectral_radius for instance. Of a sweep, whose own folder
    is given as RUN: any scalar of the result. Of a front: front.
    """
    from gaitopt.cli.console import narration, results
    from gaitopt.cli.gaits import stored_gaits
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
        gaits, folders = stored_gaits(runs, changes, narration(quiet=quiet))
        if not all(gait.converged for gait in gaits):
            return NOT_A_GAIT
        place = output or (folders[0] / FIGURES if len(gaits) == 1 else Path(COMPARISON))
        with adding(folders[0], place) as written:
            written += _plot_gaits(gaits, what, drawn, place)
    for path in written:
        results().print(str(path), soft_wrap=True)
    return 0


def _other_kind(run: str) -> "Callable[[Path, list[str] | None, Sequence[str], Path], list[Path]] | None":
    """What draws a run folder that holds no gait."""
    from gaitopt.cli.branches import holds_branch, holds_front, holds_walk

    kinds = {holds_branch: _plot_branch, holds_walk: _plot_walk, holds_front: _plot_fronts}
    return next((draw for holds, draw in kinds.items() if holds(run)), None)


def _plot_gaits(gaits: "Sequence[Gait]", what: list[str] | None, formats: "Sequence[str]", folder: Path) -> list[Path]:
    from gaitopt.figures.animation import animation_page
    from gaitopt.figures.catalogue import GAIT_FIGURES, informative
    from gaitopt.figures.motion import motion_of
    from gaitopt.figures.style import save
    from gaitopt.store import write_whole

    words = what or [*informative(gaits), *([ANIMATION] if len(gaits) == 1 else [])]
    check_words(words, (*GAIT_FIGURES, ANIMATION))
    alone = [word for word in words if word in ("roads", ANIMATION) and len(gaits) > 1]
    if alone:
        raise typer.BadParameter(f"--what {alone[0]} shows one gait, not {len(gaits)}")
    written: list[Path] = []
    for word in words:
        if word == ANIMATION:
            written.append(folder / f"{ANIMATION}.html")
            write_whole(written[-1], animation_page(motion_of(gaits[0]), gaits[0].problem.about))
        else:
            written += save(GAIT_FIGURES[word](gaits), folder / word, formats)
    return written


def _plot_walk(run: Path, what: list[str] | None, formats: "Sequence[str]", folder: Path) -> list[Path]:
    from gaitopt.figures.animation import animation_page
    from gaitopt.figures.catalogue import USUAL_WALK_FIGURES, WALK_FIGURES
    from gaitopt.figures.motion import motion_of_walk
    from gaitopt.figures.style import save
    from gaitopt.runs.restore_walk import restore_walk
    from gaitopt.store import write_whole

    words = what or [*USUAL_WALK_FIGURES, ANIMATION]
    check_words(words, (*WALK_FIGURES, ANIMATION))
    walk, written = restore_walk(run), list[Path]()
    for word in words:
        if word == ANIMATION:
            written.append(folder / f"{ANIMATION}.html")
            write_whole(written[-1], animation_page(motion_of_walk(walk), walk.trajectory.message))
        else:
            written += save(WALK_FIGURES[word](walk), folder / word, formats)
    return written


def _plot_branch(run: Path, what: list[str] | None, formats: "Sequence[str]", folder: Path) -> list[Path]:
    from gaitopt.cli.branches import stored_branch
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
    drawn = [draw_front(front.problem, front.key, front.to_records(), formats, folder) for front in read_fronts(run)]
    return [path for paths in drawn for path in paths]
