"""Figures, animations, pages and tables of results; the methods ``plot``, ``animate`` and ``report`` call these.

In a notebook ``plot`` displays its figure as PNG without any magic command, and returns its Matplotlib axes.
"""

import sys
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitopt.api.stored import save
from gaitopt.display import Page
from gaitopt.errors import StorageError, UnknownNameError
from gaitopt.gait.branch import Branch
from gaitopt.gait.gait import Gait, require_gait
from gaitopt.gait.trajectory import Trajectory
from gaitopt.runs.atlas import Atlas
from gaitopt.runs.branch import stored_branch
from gaitopt.runs.results import KINDS, kind_of
from gaitopt.runs.robustness import Robustness
from gaitopt.show.catalogue import ANIMATION, PAGE, Figures, check_names, figures_of
from gaitopt.show.movie import MOVIES
from gaitopt.show.pages import atlas_report, branch_report, comparison_report, robustness_report, walk_report
from gaitopt.show.style import STILL, drawing_into, encoded
from gaitopt.show.style import save as save_figure
from gaitopt.show.tables import printed
from gaitopt.solver.program import NonlinearProgram
from gaitopt.store.files import check_file, check_writable, clear_leftovers, make_folder, write_whole
from gaitopt.store.run import MANIFEST_FILE, Run
from gaitopt.verification.walk import Walk

__all__ = ["animate", "draw", "html", "page_in", "plot", "report", "save", "save_figures", "write_page"]

UNTITLED = (Branch, Trajectory, NonlinearProgram)
"""Types of results whose tables have no title of their own."""
PICTURE_RESOLUTION = 80
"""Resolution of the small picture beside a table [dots per inch]; figures are six inches wide."""


def plot(result: Any, what: str | None = None, *, ax: Axes | Sequence[Axes] | None = None) -> Axes:
    """Draw one figure of a result, and show it in a notebook.

    Settings of your Matplotlib style sheet take precedence.

    Parameters
    ----------
    result : a gait, several gaits, a walk, a branch, a sweep, a front, a basin or a nonlinear program; or a mapping
        from names in the legend to gaits, or to branches over one parameter, each a ``Branch`` or the records from
        ``load_records`` or ``continuation_records``.
    what : for gaits ``portrait`` (default), ``force``, ``force_over_COORDINATE``, ``slip``, ``torques``,
        ``postures``, ``multipliers`` or ``methods``; for a walk ``section``, ``portrait``, ``force``, ``slip``,
        ``torques`` or ``postures``; for a branch ``multipliers`` or a scalar of the result; for a sweep or several
        branches a scalar. The default scalar is ``spectral_radius``.
    ax : axes to draw into, one for each panel of the figure; by default a new figure.

    Returns
    -------
    axes : the axes of the largest panel, or ``ax``; ``axes.figure.savefig(path)`` writes the figure.

    Raises
    ------
    ValueError
        If there is no such figure or nothing to draw, or if ``ax`` does not have one axes for each panel.
    """
    if ax is not None:
        with drawing_into(ax):
            draw(result, what)
        return ax if isinstance(ax, Axes) else next(np.array(ax, dtype=object).flat)
    figure = draw(result, what)
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None  # not imported otherwise
    if shell is not None and getattr(shell, "kernel", None) is not None:  # the caller is a notebook
        from IPython.display import display

        display({"image/png": encoded(figure, "png", 100)}, raw=True)
    return max(figure.axes, key=lambda axes: axes.get_position().width * axes.get_position().height)


def draw(result: Any, what: str | None = None) -> Figure:
    """The figure that ``plot`` shows."""
    figures = figures_of(result)
    if what is not None and what not in figures.names:
        raise ValueError(f"there is no figure {what!r}; choose from {', '.join(figures.names)}")
    return figures.draw(what or figures.usual[0])


def save_figures(
    result: Any, folder: str | Path, what: Sequence[str] = (), formats: Sequence[str] = ("svg", "png")
) -> list[Path]:
    """Draw figures of a result into a folder.

    Equal figures give equal bytes. In a run folder, checksums of the files are added to the manifest.

    Parameters
    ----------
    result : see ``plot``; or a Matplotlib figure, whose name is then the only entry of ``what``.
    folder : folder of the files, made if necessary.
    what : names of figures, see ``plot``, and ``animation`` for a gait or a walk; by default all figures that apply.
    formats : ``svg``, ``png``, ``pdf`` for figures; ``html`` (default), ``gif``, ``mp4`` for the animation. If only
        formats of the animation are given, no figures are drawn.

    Returns
    -------
    paths : paths of the files.

    Raises
    ------
    UnknownNameError
        If there is no such figure or format, or an MP4 is to be written without ffmpeg.
    StorageError
        If the folder cannot be written.
    """
    folder, unknown_formats = Path(folder), [name for name in formats if name not in (*STILL, PAGE, *MOVIES)]
    if unknown_formats:
        raise UnknownNameError(f"format {unknown_formats[0]}: choose from {', '.join((*STILL, PAGE, *MOVIES))}")
    check_writable(folder)
    still, moving_formats = [f for f in formats if f in STILL], [f for f in formats if f not in STILL] or [PAGE]
    if isinstance(result, Figure):
        (name,) = what
        with adding(folder) as written:
            written += save_figure(result, folder / name, formats)
        return written
    figures = result if isinstance(result, Figures) else figures_of(result)
    moving = [] if figures.animation is None else [ANIMATION]
    known = (*figures.names, *moving)
    check_names(what, known)
    chosen = what or (*(figures.usual if still else ()), *moving)
    unmoving = [name for name in chosen if name != ANIMATION]
    if not chosen or (unmoving and not still):
        reason = f"{unmoving[0] if unmoving else 'this result'} does not move"
        raise UnknownNameError(f"format {moving_formats[0]}: {reason}; choose from {', '.join(STILL)}")
    with adding(folder) as written:
        for name in chosen:
            if name == ANIMATION and figures.animation is not None:
                for extension in moving_formats:
                    path = folder / f"{ANIMATION}.{extension}"
                    write_whole(path, figures.animation(extension))
                    written.append(path)
            else:
                written += save_figure(figures.draw(name), folder / (figures.stem or name), still)
    return written


@contextmanager
def adding(folder: Path) -> Iterator[list[Path]]:
    """Write figures or pages into a folder, which is made if necessary; the block collects the files in the list.

    Files in a run folder get checksums.
    """
    for parent in (folder, *folder.resolve().parents):
        if _is_run(parent):
            with Run(parent).adding(folder) as written:
                yield written
            return
    make_folder(folder)
    clear_leftovers(folder)
    yield []


def _is_run(folder: Path) -> bool:
    """Whether a folder is a run that can be read; other programs write files of the name ``manifest.json`` too."""
    try:
        return (folder / MANIFEST_FILE).is_file() and bool(Run(folder).manifest())
    except StorageError:
        return False


def animate(result: Gait | Walk) -> Page:
    """Animate a gait or a walk as an offline page; a gait repeats, a walk plays from start to end."""
    page = figures_of(result).animation
    if page is None:
        raise TypeError(f"a {type(result).__name__} does not move")
    return Page(f"animation of {result.problem.name}", page(PAGE).decode(), page)


def report(*results: Any, replays: Sequence[Any] = ()) -> Page:
    """Report on a gait, several gaits side by side, a walk, a branch, an atlas or robustness, as one offline page.

    Parameters
    ----------
    replays : results of ``replay``, whose motions are drawn over that of the gait.
    """
    first = results[0]
    require_gait(first, "report")
    if isinstance(first, Branch):
        if not first.points:
            raise ValueError("a branch without points has no report")
        problem = first.points[0].gait.problem
        return Page(f"report of {problem.name}", branch_report(problem, first.parameter, first.to_records()))
    pages: Mapping[type, Callable[[Any], str]] = {
        Walk: walk_report, Atlas: atlas_report, Robustness: robustness_report,
    }  # fmt: skip
    if (page := pages.get(type(first))) is not None:
        return Page(f"report of {first.problem.name}", page(first))
    gaits = list(results) if isinstance(first, Gait) else list(first)
    records = [replay if isinstance(replay, Mapping) else replay.to_record() for replay in replays]
    return Page(f"report of {gaits[0].problem.name}", comparison_report(gaits, records))


def page_in(folder: Path) -> Page | None:
    """The page about the branch, walk, atlas or robustness in a folder; None if it contains another result."""
    kind = kind_of(folder)
    if kind == "branch":
        problem, parameter, records = stored_branch(folder)
        return Page(f"report of {problem.name}", branch_report(problem, parameter, records))
    return report(KINDS[kind][1](folder)) if kind in ("walk", "atlas", "robustness") else None


def html(result: Any) -> str:
    """A small picture and the table that the command line prints, for a notebook."""
    try:
        code = b64encode(encoded(draw(result), "png", PICTURE_RESOLUTION)).decode()
        picture = f'<img alt="" src="data:image/png;base64,{code}">'
    except (TypeError, ValueError):  # the result has no figure
        picture = ""
    return f"{picture}{printed(result, titled=isinstance(result, UNTITLED))}"


def write_page(page: Page, path: Path) -> Path:
    """Write a page, or the movie of an animation, in the format of the path's ending; the file is never incomplete."""
    endings = (PAGE, *(() if page.movie is None else MOVIES))
    extension = path.suffix.lower().removeprefix(".")
    if extension not in endings:
        raise UnknownNameError(f"{path}: the {page.title} is written as {', '.join(f'.{e}' for e in endings)}")
    check_file(path)
    content = page.text.encode() if page.movie is None or extension == PAGE else page.movie(extension)
    with adding(path.parent) as written:
        write_whole(path, content)
        written.append(path)
    return path
