"""Figures, animations, pages and tables of results; the methods ``plot``, ``animate`` and ``report`` call these.

In a notebook ``plot`` displays its figure as PNG without any magic command, and returns its Matplotlib axes.
"""

import sys
from base64 import b64encode
from collections.abc import Sequence
from functools import singledispatch
from html import escape
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitopt.api.stored import save
from gaitopt.display import Page
from gaitopt.errors import UnknownNameError
from gaitopt.gait.branch import Branch
from gaitopt.gait.gait import Gait
from gaitopt.runs.basin import Basin, read_basin
from gaitopt.runs.branch import stored_branch
from gaitopt.runs.front import Front, read_fronts
from gaitopt.runs.results import kind_of, restore_walk
from gaitopt.runs.sweep import Sweep, read_sweep
from gaitopt.show.catalogue import (
    Figures,
    basin_figures,
    branch_figures,
    front_figures,
    gait_figures,
    sweep_figures,
    walk_figures,
)
from gaitopt.show.pages import branch_report, comparison_report, walk_report
from gaitopt.show.style import drawn
from gaitopt.show.style import save as save_figure
from gaitopt.show.tables import printed
from gaitopt.store.files import make_folder, write_whole
from gaitopt.store.run import MANIFEST_FILE
from gaitopt.verification.walk import Walk

__all__ = ["animate", "draw", "figures_in", "html", "page_in", "plot", "report", "save", "save_figures", "write_page"]

ANIMATION = "animation"
"""Name of the page of the moving walker, beside the names of figures."""
DRAWN_AXES = 2
"""Maps are drawn over one or two keys."""
SMALL = 60
"""Resolution of the picture beside a table [dots per inch]; figures are six inches wide."""


def plot(result: Any, what: str | None = None) -> Axes:
    """Draw one figure of a result, and show it in a notebook.

    Parameters
    ----------
    result : a gait, several gaits, a walk, a branch, a sweep, a front or a basin.
    what : of gaits ``portrait`` (if not given), ``force``, ``slip``, ``torques``, ``multipliers`` or ``roads``; of a
        walk ``section`` or any of these but the last two; of a branch ``multipliers``, or a scalar of the result; of a
        sweep a scalar. A scalar that is not given is ``spectral_radius``.

    Returns
    -------
    axes : of the figure's largest panel; ``axes.figure.savefig(path)`` writes it.

    Raises
    ------
    ValueError
        If there is no such figure, or nothing to draw.
    """
    figure = draw(result, what)
    _show(figure)
    return max(figure.axes, key=lambda axes: axes.get_position().width * axes.get_position().height)


def draw(result: Any, what: str | None = None) -> Figure:
    """The figure that ``plot`` shows."""
    figures = figures_of(result)
    if what is not None and what not in figures.names:
        raise ValueError(f"there is no figure {what!r}; choose from {', '.join(figures.names)}")
    return figures.draw(what or figures.usual[0])


@singledispatch
def figures_of(result: Any) -> Figures:
    """The figures of a result."""
    gaits = list(result) if isinstance(result, Sequence) else []
    if not gaits or not all(isinstance(gait, Gait) for gait in gaits):
        raise TypeError(f"a {type(result).__name__} has no figures")
    return gait_figures([_converged(gait) for gait in gaits])


@figures_of.register
def _(result: Branch) -> Figures:
    if not result.points:
        raise ValueError("a branch without points has no figures")
    return branch_figures(result.points[0].gait.problem, result.parameter, result.to_records())


figures_of.register(Gait, lambda gait: gait_figures([_converged(gait)]))
figures_of.register(Walk, walk_figures)
figures_of.register(Sweep, sweep_figures)
figures_of.register(Basin, basin_figures)
figures_of.register(Front, front_figures)


def save_figures(
    result: Any, folder: str | Path, what: Sequence[str] = (), formats: Sequence[str] = ("svg", "png")
) -> list[Path]:
    """Draw figures of a result into a folder.

    Parameters
    ----------
    result : as for ``plot``, or what ``figures_in`` returns.
    folder : made if it is missing.
    what : names of figures as for ``plot``, and ``animation`` of a gait or a walk; by default all that show something.
    formats : of ``svg``, ``png``, ``pdf``.

    Returns
    -------
    paths : of the files.

    Raises
    ------
    UnknownNameError
        If there is no such figure.
    """
    figures, place = result if isinstance(result, Figures) else figures_of(result), Path(folder)
    moving = [] if figures.animation is None else [ANIMATION]
    known, written = (*figures.names, *moving), list[Path]()
    unknown = [word for word in what if word not in known]
    if unknown:
        raise UnknownNameError(f"{unknown[0]}: choose from {', '.join(known)}").concerning("what")
    make_folder(place)
    for word in what or (*figures.usual, *moving):
        if word == ANIMATION and figures.animation is not None:
            written.append(write_page(figures.animation(), place / f"{ANIMATION}.html"))
        else:
            written += save_figure(figures.draw(word), place / (figures.stem or word), formats)
    return written


def figures_in(folder: Path) -> list[Figures]:
    """The figures of the branch, walk, sweep or basin in a folder, or of its fronts; empty where it holds a gait.

    Those of a branch are drawn from its records, without restoring the gaits of its points.

    Raises
    ------
    StorageError
        If the folder is broken or unfinished.
    UnknownNameError
        If a sweep or basin is over more than two keys.
    """
    kind = map_kind(folder) or kind_of(folder)
    if kind in ("basin", "sweep"):
        result = read_basin(folder) if kind == "basin" else read_sweep(folder)
        if len(result.grid.axes) > DRAWN_AXES:
            words = f"{folder} is over {len(result.grid.axes)} keys; pictures are drawn over one or two"
            raise UnknownNameError(words)
        return [figures_of(result)]
    if kind == "branch":
        return [branch_figures(*stored_branch(folder))]
    if kind == "walk":
        return [walk_figures(restore_walk(folder))]
    return [front_figures(front) for front in read_fronts(folder)] if kind == "front" else []


def map_kind(folder: Path) -> str:
    """``basin`` or ``sweep`` if the folder is that of one, finished or not, within a run folder; else empty."""
    kind = folder.name.partition("-")[0]
    is_map = kind in ("basin", "sweep") and folder.is_dir() and not (folder / MANIFEST_FILE).exists()
    return kind if is_map else ""


def animate(result: Gait | Walk) -> Page:
    """The moving walker as a page: a gait repeats itself, a walk is shown from its start to its end."""
    page = figures_of(result).animation
    if page is None:
        raise TypeError(f"a {type(result).__name__} does not move")
    return Page(f"animation of {result.problem.name}", page())


def report(*results: Any) -> Page:
    """Everything about a gait, a walk or a branch as one page, or several gaits side by side."""
    first = results[0]
    if isinstance(first, Branch):
        if not first.points:
            raise ValueError("a branch without points has no report")
        problem = first.points[0].gait.problem
        return Page(f"report of {problem.name}", branch_report(problem, first.parameter, first.to_records()))
    if isinstance(first, Walk):
        return Page(f"report of {first.problem.name}", walk_report(first))
    gaits = list(results) if isinstance(first, Gait) else list(first)
    return Page(f"report of {gaits[0].problem.name}", comparison_report(gaits))


def page_in(folder: Path) -> Page | None:
    """The page about the branch or walk in a run folder; None if it holds something else."""
    kind = kind_of(folder)
    if kind == "branch":
        problem, parameter, records = stored_branch(folder)
        return Page(f"report of {problem.name}", branch_report(problem, parameter, records))
    return report(restore_walk(folder)) if kind == "walk" else None


def html(result: Any) -> str:
    """The table that the command line prints and a small picture, for a notebook."""
    try:
        code = b64encode(drawn(draw(result), "png", SMALL)).decode()
        picture = f'<img alt="" src="data:image/png;base64,{code}">'
    except (TypeError, ValueError):  # has none
        picture = ""
    title = escape(repr(result).strip("<>"))
    return f"<p><strong>{title}</strong></p>{picture}{printed(result)}"


def write_page(text: str, path: Path) -> Path:
    """Write a page; it appears whole or not at all."""
    write_whole(path, text)
    return path


def _converged(gait: Gait) -> Gait:
    if not gait.steps:
        raise ValueError(f"{gait.problem.name} is {gait.status}: there is no gait to draw")
    return gait


def _show(figure: Figure) -> None:
    """Display a figure where there is a notebook; nothing is imported for it elsewhere."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is not None and getattr(shell, "kernel", None) is not None:
        from IPython.display import display

        display({"image/png": drawn(figure, "png", 100)}, raw=True)
