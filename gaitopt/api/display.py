"""Figures, pages and tables of results, by one function each; the methods of the results call them.

Figures appear in a notebook without any magic: they are displayed here, as PNG, and returned as Matplotlib axes.
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

from gaitopt.api.stored import load_run, save
from gaitopt.display import Page
from gaitopt.gait.branch import Branch
from gaitopt.gait.gait import Gait
from gaitopt.runs.basin import Basin
from gaitopt.runs.front import Front
from gaitopt.runs.sweep import Sweep
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
from gaitopt.show.tables import printed
from gaitopt.store.files import write_whole
from gaitopt.verification.walk import Walk

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
