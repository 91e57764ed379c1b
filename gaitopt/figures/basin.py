"""Basins of attraction: which state goes to which gait, and how the others fail."""

import matplotlib as mpl
import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from gaitopt.figures.labels import symbol
from gaitopt.figures.style import COLOURS, STYLE, entry, legend_below, panels
from gaitopt.figures.sweep import shown
from gaitopt.problem.scalars import state_unit
from gaitopt.runs.basin import UNDECIDED
from gaitopt.runs.basin_tiles import Basin
from gaitopt.runs.grid import Axis
from gaitopt.simulation.batch.steps import ENDINGS

FAILURES = ("#ffffff", "#d9d9d9", "#bdbdbd", "#f0e0d0", "#969696", "#e5dbe5", "#d5e0d5", "#c8c0b0")
"""Shades of the ways to fail, in the order of how often they occur; pale, so that the gaits stand out."""


def basin(found: Basin) -> Figure:
    """The plane of a grid over two coordinates, coloured by where each state goes; fixed points as crosses.

    Raises
    ------
    ValueError
        If the grid is not over two coordinates.
    """
    if len(found.grid.axes) != 2:
        raise ValueError(f"a picture needs a grid over two coordinates, not {len(found.grid.axes)}")
    first, second = found.grid.axes
    classes, handles = _classes(found)
    colours = [handle.get_markerfacecolor() for handle in handles]
    figure, (axes,) = panels(height=4.6)
    with mpl.rc_context(STYLE):
        axes.pcolormesh(
            shown(first), shown(second), classes.T, shading="nearest", rasterized=True,
            cmap=ListedColormap(colours), norm=BoundaryNorm(np.arange(len(colours) + 1) - 0.5, len(colours)),
        )  # fmt: skip
    names = found.problem.walker.section_names(slipping=True)
    for gait in found.attractors:
        point = [_in_unit(axis, gait.state[names.index(axis.key)]) for axis in found.grid.axes]
        axes.plot(*point, "+", color="white", markersize=12, markeredgewidth=3.5)
        axes.plot(*point, "+", color="black", markersize=11, markeredgewidth=1.4)
    axes.set_xlabel(_axis_label(first))
    axes.set_ylabel(_axis_label(second))
    axes.grid(visible=False)
    fixed = [entry("gait", marker="+", linestyle="", color="black")] if found.attractors else []
    legend_below(figure, [*handles, *fixed])
    return figure


def _in_unit(axis: Axis, value: float) -> float:
    return float(np.degrees(value)) if axis.unit == "deg" else float(value)


def _axis_label(axis: Axis) -> str:
    unit = state_unit(axis.key)
    unit = unit.replace("rad", "°") if axis.unit == "deg" else unit
    return f"{symbol(axis.key)} after the impact [{unit}]"


def _classes(found: Basin) -> tuple[NDArray[np.int32], list[Line2D]]:
    """A number per state, and the legend's entry of every number."""
    classes = found.labels.copy()
    words = [f"{gait} {k}" if len(found.attractors) > 1 else str(gait) for k, gait in enumerate(found.attractors, 1)]
    colours = [COLOURS[k % len(COLOURS)] for k in range(len(words))]
    values, counts = np.unique(found.endings[found.labels < 0], return_counts=True)
    for rank, value in enumerate(values[np.argsort(-counts)]):
        classes[(found.labels < 0) & (found.endings == value)] = len(words)
        words.append("undecided" if value == UNDECIDED else str(ENDINGS[value]).replace("_", " "))
        colours.append(FAILURES[rank % len(FAILURES)])
    squares = [
        Line2D([], [], label=w, marker="s", linestyle="", markerfacecolor=c, markeredgecolor="#8c8c8c", markersize=8)
        for w, c in zip(words, colours, strict=True)
    ]
    return classes, squares
