"""Figures, pages and tables of results, by one function each; the methods of the results call them.

Figures appear in a notebook without any magic: they are displayed here, as PNG, and returned as Matplotlib axes.
"""

import sys
from base64 import b64encode
from collections.abc import Sequence
from functools import singledispatch
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitopt.display import Page
from gaitopt.figures.animation import animation_page
from gaitopt.figures.basin import basin as basin_figure
from gaitopt.figures.catalogue import BRANCH_FIGURES, GAIT_FIGURES, WALK_FIGURES, branch_figure
from gaitopt.figures.front import front_figure
from gaitopt.figures.motion import motion_of, motion_of_walk
from gaitopt.figures.style import STYLE
from gaitopt.figures.sweep import sweep as sweep_figure
from gaitopt.gait import Branch, Gait
from gaitopt.library.printed import printed
from gaitopt.library.stored import load_run, save
from gaitopt.pages import branch_report, comparison_report, walk_report
from gaitopt.problem import SCALARS
from gaitopt.runs.basin_tiles import Basin
from gaitopt.runs.front import Front
from gaitopt.runs.sweep_table import Sweep
from gaitopt.store import write_whole
from gaitopt.study.simulate import Walk

__all__ = ["animate", "draw", "html", "load_run", "plot", "report", "save", "write_page"]

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


@singledispatch
def draw(result: Any, what: str | None = None) -> Figure:
    """The figure that ``plot`` shows."""
    gaits = list(result) if isinstance(result, Sequence) else []
    if not gaits or not all(isinstance(gait, Gait) for gait in gaits):
        raise TypeError(f"a {type(result).__name__} has no figures")
    return GAIT_FIGURES[_known(what, "portrait", tuple(GAIT_FIGURES))]([_converged(gait) for gait in gaits])


@draw.register
def _(result: Gait, what: str | None = None) -> Figure:
    return draw([result], what)


@draw.register
def _(result: Walk, what: str | None = None) -> Figure:
    return WALK_FIGURES[_known(what, "section", tuple(WALK_FIGURES))](result)


@draw.register
def _(result: Branch, what: str | None = None) -> Figure:
    word = _known(what, "spectral_radius", BRANCH_FIGURES)
    if not result.points:
        raise ValueError("a branch without points has no figures")
    return branch_figure(word, result.points[0].gait.problem, result.parameter, result.to_records())


@draw.register
def _(result: Sweep, what: str | None = None) -> Figure:
    scalar = _known(what, "spectral_radius", tuple(SCALARS))
    return sweep_figure(result.grid, result.records, scalar, searched=result.problem.is_open)


@draw.register
def _(result: Basin, what: str | None = None) -> Figure:
    _known(what, "basin", ("basin",))
    return basin_figure(result)


@draw.register
def _(result: Front, what: str | None = None) -> Figure:
    _known(what, "front", ("front",))
    return front_figure(result.problem, result.key, result.to_records())


def animate(result: Gait | Walk) -> Page:
    """The moving walker as a page: a gait repeats itself, a walk is shown from its start to its end."""
    motion = motion_of_walk(result) if isinstance(result, Walk) else motion_of(_converged(result))
    return Page(f"animation of {result.problem.name}", animation_page(motion, result.problem.about))


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


def html(result: Any) -> str:
    """The table that the command line prints and a small picture, for a notebook."""
    try:
        code = b64encode(_png(draw(result), SMALL)).decode()
        picture = f'<img alt="" src="data:image/png;base64,{code}">'
    except (TypeError, ValueError):  # has none
        picture = ""
    title = escape(repr(result).strip("<>"))
    return f"<p><strong>{title}</strong></p>{picture}{printed(result)}"


def write_page(text: str, path: Path) -> Path:
    """Write a page; it appears whole or not at all."""
    write_whole(path, text)
    return path


def _known(what: str | None, usual: str, known: Sequence[str]) -> str:
    if what is not None and what not in known:
        raise ValueError(f"there is no figure {what!r}; choose from {', '.join(known)}")
    return what or usual


def _converged(gait: Gait) -> Gait:
    if not gait.steps:
        raise ValueError(f"{gait.problem.name} is {gait.status}: there is no gait to draw")
    return gait


def _png(figure: Figure, resolution: float) -> bytes:
    drawn = BytesIO()
    with mpl.rc_context(STYLE):
        figure.savefig(drawn, format="png", dpi=resolution)
    return drawn.getvalue()


def _show(figure: Figure) -> None:
    """Display a figure where there is a notebook; nothing is imported for it elsewhere."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is not None and getattr(shell, "kernel", None) is not None:
        from IPython.display import display

        display({"image/png": _png(figure, 100)}, raw=True)
