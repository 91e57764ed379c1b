"""Basins of attraction: which state goes to which gait, and how the others fail."""

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from gaitopt.figures.labels import symbol
from gaitopt.figures.style import COLOURS, entry, legend_below, panels, styled
from gaitopt.figures.sweep import shown
from gaitopt.problem.scalars import state_unit
from gaitopt.runs.basin import UNDECIDED
from gaitopt.runs.basin_tiles import Basin
from gaitopt.runs.grid import Axis
from gaitopt.simulation.batch.steps import ENDINGS

FAILURES = ("#ffffff", "#d9d9d9", "#bdbdbd", "#f0e0d0", "#969696", "#e5dbe5", "#d5e0d5", "#c8c0b0")
"""Shades of the ways to fail, in the order of how often they occur; pale, so that the gaits stand out."""

LINE_HEIGHT = 1.6
"""Of a figure over one coordinate [inch]."""


def basin(result: Basin) -> Figure:
    """The grid over one or two coordinates, coloured by where each state goes; fixed points as crosses.

    Raises
    ------
    ValueError
        If the grid is over more coordinates.
    """
    if len(result.grid.axes) > 2:
        raise ValueError(f"a picture needs a grid over one or two coordinates, not {len(result.grid.axes)}")
    first, *second = result.grid.axes
    classes, handles = _classes(result)
    colours = [handle.get_markerfacecolor() for handle in handles]
    figure, (axes,) = panels(height=4.6 if second else LINE_HEIGHT)
    rows = shown(second[0]) if second else np.array([-1.0, 1.0])
    cells = classes.T if second else np.vstack([classes, classes])
    with styled():
        axes.pcolormesh(
            shown(first), rows, cells, shading="nearest", rasterized=True,
            cmap=ListedColormap(colours), norm=BoundaryNorm(np.arange(len(colours) + 1) - 0.5, len(colours)),
        )  # fmt: skip
    names = result.problem.walker.section_names(slipping=True)
    for gait in result.attractors:
        values = [(axis, gait.state[names.index(axis.key)]) for axis in result.grid.axes]
        point = [np.degrees(value) if axis.unit == "deg" else value for axis, value in values]
        place = point if second else (*point, 0.0)
        axes.plot(*place, "+", color="white", markersize=12, markeredgewidth=3.5)
        axes.plot(*place, "+", color="black", markersize=11, markeredgewidth=1.4)
    axes.set_xlabel(_axis_label(first))
    if second:
        axes.set_ylabel(_axis_label(second[0]))
    else:
        axes.set_yticks([])
    axes.grid(visible=False)
    fixed = [entry("gait", marker="+", linestyle="", color="black")] if result.attractors else []
    legend_below(figure, [*handles, *fixed])
    return figure


def _axis_label(axis: Axis) -> str:
    unit = state_unit(axis.key)
    unit = unit.replace("rad", "°") if axis.unit == "deg" else unit
    return f"{symbol(axis.key)} after the impact [{unit}]"


def _classes(result: Basin) -> tuple[NDArray[np.int32], list[Line2D]]:
    """A number per state, and the legend's entry of every number."""
    classes = result.labels.copy()
    words = [f"{gait} {k}" if len(result.attractors) > 1 else str(gait) for k, gait in enumerate(result.attractors, 1)]
    colours = [COLOURS[k % len(COLOURS)] for k in range(len(words))]
    values, counts = np.unique(result.endings[result.labels < 0], return_counts=True)
    for rank, value in enumerate(values[np.argsort(-counts)]):
        classes[(result.labels < 0) & (result.endings == value)] = len(words)
        words.append("undecided" if value == UNDECIDED else str(ENDINGS[value]).replace("_", " "))
        colours.append(FAILURES[rank % len(FAILURES)])
    squares = [
        Line2D([], [], label=w, marker="s", linestyle="", markerfacecolor=c, markeredgecolor="#8c8c8c", markersize=8)
        for w, c in zip(words, colours, strict=True)
    ]
    return classes, squares
