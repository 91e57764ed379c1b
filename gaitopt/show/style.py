"""The style of all figures: colours for the colour-blind, dashes where the foot slips, a legend below.

The colours are those of Okabe and Ito (2008), https://jfly.uni-koeln.de/color/. Figures are built without pyplot, which
would need a window system and global state.
"""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from textwrap import fill
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gaitopt.model.modes import Mode
from gaitopt.store.files import write_whole

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
MORE_COLOURS = ("#332288", "#999933", "#882255", "#44aa99", "#cc6677", "#117733", "#aa4499")
"""Where those are not enough: of P. Tol's muted scheme, https://personal.sron.nl/~pault/."""
MODE_COLOURS = {
    Mode.STICK: "#4d4d4d", Mode.SLIP_FORWARD: "#e69f00", Mode.SLIP_BACKWARD: "#56b4e9", Mode.FLIGHT: "#9bd1b3",
}  # fmt: skip
MODE_WORDS = {mode: mode.replace("_", " ") for mode in MODE_COLOURS}
NEUTRAL = "#4d4d4d"
"""Colour of legend entries that stand for all curves."""
SLIP_DASHES, FLIGHT_DOTS = (0, (3.5, 1.8)), (0, (1, 1.6))
JUMP: dict[str, Any] = {"linestyle": ":", "linewidth": 0.8}
"""Line of a jump at the impact."""

LEGEND_CHARACTERS, LEGEND_LINE = 96, 9
"""Characters that fit side by side under a figure, and how many of them a sample line and its gap take."""
LEGEND_ROWS, LEGEND_ROW = 3, 0.2
"""Rows of a legend for which a figure has room, and height of each further one [inch]."""
WIDTH, HEIGHT = 6.0, 4.0
"""Size of a figure with one panel [inch]."""
STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": "medium",
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": "small",
    "figure.constrained_layout.use": True,
    "savefig.dpi": 160,
    "svg.fonttype": "path",
    "svg.hashsalt": "gaitopt",
    "pdf.fonttype": 42,
}
_STYLING = threading.RLock()
"""Held while matplotlib's settings are those of ``STYLE``: they hold for the whole process."""
_NO_DATE: dict[str, dict[str, Any]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}


@contextmanager
def styled() -> Iterator[None]:
    """Draw in the style of this package within the block; one thread at a time."""
    with _STYLING, mpl.rc_context(STYLE):
        yield


def panels(
    rows: int = 1, *, heights: Sequence[float] | None = None, height: float = HEIGHT
) -> tuple[Figure, list[Axes]]:
    """A figure with panels one above the other that share their horizontal axis."""
    with styled():
        figure = Figure(figsize=(WIDTH, height))
        FigureCanvasAgg(figure)
        ratios = list(heights) if heights else [1.0] * rows
        axes = figure.subplots(rows, 1, sharex=True, squeeze=False, height_ratios=ratios)
    return figure, list(axes[:, 0])


def save(figure: Figure, stem: Path, formats: Sequence[str] = ("svg", "png")) -> list[Path]:
    """Write a figure in several formats; the same figure gives the same bytes."""
    paths = [stem.with_name(f"{stem.name}.{extension}") for extension in formats]
    for path, extension in zip(paths, formats, strict=True):
        write_whole(path, drawn(figure, extension))
    return paths


def drawn(figure: Figure, extension: str, dpi: float = STYLE["savefig.dpi"]) -> bytes:
    """A figure as a file of some format."""
    content = BytesIO()
    with styled():
        figure.savefig(content, format=extension, metadata=_NO_DATE[extension], dpi=dpi)
    return content.getvalue()


def dashes(mode: Mode) -> Any:
    """Line style of a mode: solid where the foot sticks, dashed where it slips, dotted in flight."""
    return "-" if mode.sticks else SLIP_DASHES if mode.slips else FLIGHT_DOTS


def entry(words: str, **style: Any) -> Line2D:
    """A legend's entry."""
    return Line2D([], [], label=words, **({"color": NEUTRAL} | style))


def mode_legend(modes: Sequence[Mode]) -> list[Line2D]:
    """Legend entries that say what solid, dashed and dotted mean, as far as they occur."""
    entries = []
    if any(mode.sticks for mode in modes):
        entries.append(entry("foot sticks"))
    if any(mode.slips for mode in modes):
        entries.append(entry("foot slips", linestyle=SLIP_DASHES))
    if not all(mode.touching for mode in modes):
        entries.append(entry("flight", linestyle=FLIGHT_DOTS))
    return entries


def legend_below(figure: Figure, handles: Sequence[Any]) -> None:
    """A legend under the axes, in as many columns as fit; long entries are wrapped, and the figure grows with it."""
    for handle in handles:
        handle.set_label(fill(str(handle.get_label()), LEGEND_CHARACTERS - LEGEND_LINE))
    lines = [str(handle.get_label()).split("\n") for handle in handles]
    longest = max(len(line) for own in lines for line in own)
    columns = max(1, min(len(handles), LEGEND_CHARACTERS // (longest + LEGEND_LINE)))
    rows = -(-sum(map(len, lines)) // columns)
    figure.set_figheight(figure.get_figheight() + LEGEND_ROW * max(0, rows - LEGEND_ROWS))
    with styled():
        figure.legend(handles=list(handles), loc="outside lower center", ncols=columns)
