"""Figures of robustness: strips of the disturbances from which a walk returns to its gait, and of the others.

A figure of patches has a strip for each of 1, 2 and 4 tiles; a figure of pushes has a strip for every rate.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gaitopt.display import counted
from gaitopt.runs.robustness import PUSH, Robustness
from gaitopt.show.style import COLOURS, NEUTRAL, WIDTH, entry, figure_style, given_axes, legend_below, panels, symbol
from gaitopt.show.tables import TILE_KINDS
from gaitopt.uncertainty.limits import Limit

RETURNS, FAILS = COLOURS[2], COLOURS[1]
"""Colours of walks that return, and of those that do not."""
LEGEND = (("returns to the gait", RETURNS), ("does not return", FAILS))
ROW, REST, COLUMNS = 0.32, 0.75, 2
"""Height of a strip and of the rest of its panel [inch], and number of columns of the figure of all strips."""
ALL = "strips"
"""Name of the figure with all strips."""
SINGLE = 0.0005
"""Half the width of a strip in which a single value was tried, in the unit of the axis."""
CLOSE_BEFORE = 0.15
"""A label is written to the left of its limit if the limit lies in this last fraction of the axis."""


def strips(result: Robustness, name: str) -> Figure:
    """Strips of one kind of patches, of the pushes, or all of them in one figure.

    Parameters
    ----------
    name : a kind of patches, ``push``, or ``strips`` for all.
    """
    kinds = tuple(result.strips) if name == ALL else (name,)
    if len(kinds) == 1:
        figure, axes = panels(height=1.1 + ROW * len(result.strips[kinds[0]]))
    else:
        figure, axes = _grid([len(result.strips[kind]) for kind in kinds])
    for kind, panel in zip(kinds, axes, strict=True):
        _draw_strips(panel, kind, result.strips[kind])
    legend_below(figure, [entry(title, color=colour, linewidth=6) for title, colour in LEGEND])
    return figure


def _grid(counts: Sequence[int]) -> tuple[Figure, list[Axes]]:
    """A figure with a panel for each number of strips; or the axes of ``drawing_into``."""
    given = given_axes(len(counts))
    if given is not None:
        return given
    rows = [counts[k : k + COLUMNS] for k in range(0, len(counts), COLUMNS)]
    heights = [REST + ROW * max(row) for row in rows]
    with figure_style():
        figure = Figure(figsize=(1.6 * WIDTH, 0.4 + sum(heights)))
        FigureCanvasAgg(figure)
        axes = figure.subplots(len(rows), COLUMNS, squeeze=False, height_ratios=heights).ravel().tolist()
    for spare in axes[len(counts) :]:
        spare.remove()
    return figure, axes[: len(counts)]


def _draw_strips(axes: Axes, kind: str, limits: Mapping[str, Sequence[Limit]]) -> None:
    """The strips of one kind, each with its limits; a limit of a size is drawn without its sign."""
    is_push = kind == PUSH
    for row, sides in enumerate(limits.values()):
        for found in sides:
            tried = np.array(found.tried) if is_push else np.abs(found.tried)
            half = (tried[1] - tried[0]) / 2 if len(tried) > 1 else SINGLE
            ends = [*np.flatnonzero(np.diff(found.survived)), len(tried) - 1]
            for first, last in zip([0, *(end + 1 for end in ends)], ends, strict=False):  # values with equal ends
                span = tried[first] - half, tried[last] - tried[first] + 2 * half
                colour = RETURNS if found.survived[first] else FAILS
                axes.broken_barh([span], (row - 0.35, 0.7), color=colour, linewidth=0)
    axes.autoscale_view()
    low, high = axes.get_xlim()
    for row, sides in enumerate(limits.values()):
        for value in (found.value for found in sides if found.value is not None):
            at = value if is_push else abs(value)
            late = at > high - CLOSE_BEFORE * (high - low)
            axes.plot([at, at], [row - 0.45, row + 0.45], color="black", linewidth=1)
            axes.annotate(
                f"{at:.4g}", (at, row), xytext=(-4 if late else 4, 0), textcoords="offset points", va="center",
                ha="right" if late else "left", fontsize="x-small", color="black",
            )  # fmt: skip
    axes.set_xlabel("push just after the impact [per s]" if is_push else TILE_KINDS[kind])
    names = [symbol(key) if is_push else counted(int(key), "tile") for key in limits]
    axes.set_yticks(range(len(limits)), names)
    axes.set_ylim(len(limits) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.spines[["left", "right", "top"]].set_color(NEUTRAL)
