"""How robust a gait is: which patches of ice a walk survives, and how far each disturbance may go.

A figure of patches has a strip for each length: the values at which a walk returns to the gait, and those at which it
does not. The limits of the other disturbances are bars from the nominal floor.
"""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitopt.runs.robustness import Robustness
from gaitopt.show.style import COLOURS, NEUTRAL, entry, legend_below, panels
from gaitopt.show.tables import TILE_KINDS
from gaitopt.uncertainty.limits import Limit

RETURNS, FAILS = COLOURS[2], COLOURS[1]
"""Colours of walks that return, and of those that do not."""
LEGEND = (("returns to the gait", RETURNS), ("does not return", FAILS))
ROW = 0.42
"""Height of a strip [inch]."""


def patches(result: Robustness, kind: str) -> Figure:
    """Strips of the values at which walks over 1, 2 and 4 tiles of a kind return, each with its limit."""
    limits = result.strips[kind]
    figure, (axes,) = panels(height=1.1 + ROW * len(limits))
    _draw_strips(axes, limits)
    axes.set_xlabel(TILE_KINDS[kind])
    axes.set_yticks(range(len(limits)), [f"{n} tile{'s' * (n > 1)}" for n in sorted(limits)])
    axes.set_ylim(len(limits) - 0.5, -0.5)
    returns, fails = (entry(words, color=colour, linewidth=6) for words, colour in LEGEND)
    legend_below(figure, [returns, fails])
    return figure


def _draw_strips(axes: Axes, limits: Mapping[int, Limit]) -> None:
    """A strip for each length, with its limit."""
    for row, (_, found) in enumerate(sorted(limits.items())):
        tried, survived = np.abs(found.tried), np.array(found.survived)
        half = abs(tried[1] - tried[0]) / 2 if len(tried) > 1 else 0.0005
        for good, colour in ((True, RETURNS), (False, FAILS)):
            spans = [(value - half, 2 * half) for value in tried[survived == good]]
            axes.broken_barh(spans, (row - 0.35, 0.7), color=colour, linewidth=0)
        if found.value is not None:
            axes.plot([abs(found.value)] * 2, [row - 0.45, row + 0.45], color="black", linewidth=1)
            axes.annotate(f"{abs(found.value):.4g}", (abs(found.value), row), xytext=(4, 0), va="center",
                          textcoords="offset points", fontsize="x-small", color="black")  # fmt: skip
    axes.spines[["left", "right", "top"]].set_color(NEUTRAL)
