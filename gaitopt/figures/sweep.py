"""Sweeps: a scalar of the gait over one parameter as a curve, over two as a heat map."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gaitopt.arrays import Array
from gaitopt.figures.labels import Parameter, label
from gaitopt.figures.style import COLOURS, NEUTRAL, entry, legend_below, panels, styled
from gaitopt.gait import Status
from gaitopt.runs.grid import Axis, Grid
from gaitopt.runs.sweep_table import Sweep

MISSING, FAILED = "#e4e4e4", ("#4d4d4d", "#882255", "#117733")
"""Where there is no gait: of the cell, and of the crosses in it, one for every reason."""
FOOT, MARGIN = 0.03, 0.02
"""Height of the crosses of a curve in the axes, and room beside the requested range."""
LOST = "#d55e00"
"""Of the line where stability is lost; it stands out from all colours of the map."""
OUTLYING = 2
"""Percentile beyond which values may be outliers: of another branch, most often."""
ROUNDING, AROUND = 1e-9, 0.01
"""Relative spread below which all values are one, and how far the scale then reaches around it."""
BOUNDARY = 1.0
"""Modulus of the largest multiplier at which stability is lost."""


def sweep(result: Sweep, scalar: str) -> Figure:
    """A scalar over the whole grid; crosses where there is no gait, and a line where the spectral radius is one.

    Between neighbouring points the spectral radius is interpolated for that line.

    Raises
    ------
    ValueError
        If the grid has more than two axes.
    """
    grid, values = result.grid, result.column(scalar)
    if len(grid.axes) > 2:
        raise ValueError(f"a picture needs one or two axes, not {len(grid.axes)}")
    figure, (axes,) = panels(height=4.6 if len(grid.axes) == 2 else 4.0)
    with styled():
        handles = []
        if len(grid.axes) == 1:
            _curve(axes, shown(grid.axes[0]), values, scalar)
        else:
            handles += _heat_map(figure, axes, grid, values, result.column("spectral_radius"), scalar)
        handles += _crosses(axes, result)
        if handles:
            legend_below(figure, handles)
        axes.set_xlabel(axis_label(grid.axes[0]))
        axes.set_ylabel(str(label(scalar)) if len(grid.axes) == 1 else axis_label(grid.axes[1]))
    return figure


def shown(axis: Axis) -> Array:
    """The values of an axis in the unit in which it was given."""
    return np.degrees(axis.values) if axis.unit == "deg" else axis.values


def axis_label(axis: Axis) -> str:
    """Name and unit of an axis, in degrees where it was given so."""
    return str(Parameter(key=axis.key, in_degrees=axis.unit == "deg").label)


def _crosses(axes: Axes, result: Sweep) -> Iterator[Line2D]:
    """Mark where there is no gait, one colour per reason; the legend's entries.

    A mode sequence that was stated says nothing about other phases.
    """
    grid, infeasible = result.grid, "no gait" if result.problem.is_open else "not with these phases"
    places = np.array([[float(v) for v in point] for point in grid.points(np.arange(grid.size))])
    places = np.where([axis.unit == "deg" for axis in grid.axes], np.degrees(places), places)
    flat = len(grid.axes) == 1
    pairs = [(record["status"], place) for record, place in zip(result.records, places, strict=True)]
    failed = [(status, place) for status, place in pairs if status != Status.CONVERGED]
    for status, colour in zip(dict.fromkeys(status for status, _ in failed), FAILED, strict=False):
        x = [place[0] for own, place in failed if own == status]
        y = [FOOT if flat else place[1] for own, place in failed if own == status]
        look: Any = {"marker": "x", "linestyle": "", "color": colour, "markeredgewidth": 1.5}
        height = axes.get_xaxis_transform() if flat else axes.transData
        axes.plot(x, y, **look, markersize=6 if flat else 4, transform=height)
        yield entry(infeasible if status == Status.INFEASIBLE else status.replace("_", " "), **look)


def _curve(axes: Axes, first: Array, values: Array, scalar: str) -> None:
    axes.plot(first, values, ".-", color=COLOURS[0], linewidth=1.2)
    if scalar == "spectral_radius":
        axes.axhline(BOUNDARY, color=NEUTRAL, linewidth=0.8)
    margin = MARGIN * np.ptp(first)
    axes.set_xlim(first.min() - margin, first.max() + margin)


def _heat_map(figure: Figure, axes: Axes, grid: Grid, values: Array, radii: Array, scalar: str) -> list[Line2D]:
    first, second = (shown(axis) for axis in grid.axes)
    low, high = _limits(values)
    axes.set_facecolor(MISSING)
    axes.grid(visible=False)
    drawn = axes.pcolormesh(
        first, second, values.T, shading="nearest", cmap="viridis", vmin=low, vmax=high, rasterized=True
    )
    beyond = (bool((values < low).any()), bool((values > high).any()))
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[beyond]
    figure.colorbar(drawn, ax=axes, label=str(label(scalar)), extend=extend)
    known = radii[np.isfinite(radii)]
    if min(radii.shape) < 2 or not known.size or not known.min() < BOUNDARY < known.max():
        return []
    line = axes.contour(first, second, np.ma.masked_invalid(radii.T), levels=[BOUNDARY], colors=LOST, linewidths=2)
    drawn_at_all = any(np.size(path.vertices) for path in line.get_paths())  # not where its neighbours have no gait
    return [entry("spectral radius 1: stability lost", color=LOST, linewidth=2)] if drawn_at_all else []


def _limits(values: Array) -> tuple[float, float]:
    """Ends of the colour scale: those of the values, but that a few far away from all others do not stretch it."""
    known = values[np.isfinite(values)]
    if not known.size or np.ptp(known) <= ROUNDING * np.abs(known).max():
        middle = float(known.mean()) if known.size else 0.0
        half = AROUND * abs(middle) or 1.0
        return middle - half, middle + half
    low, high = np.percentile(known, OUTLYING), np.percentile(known, 100 - OUTLYING)
    return float(max(known.min(), 2 * low - high)), float(min(known.max(), 2 * high - low))
