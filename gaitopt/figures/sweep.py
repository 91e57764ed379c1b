"""Sweeps: a scalar of the gait over one parameter as a curve, over two as a heat map."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gaitopt.arrays import Array
from gaitopt.figures.labels import Parameter, label
from gaitopt.figures.style import COLOURS, NEUTRAL, STYLE, entry, legend_below, panels
from gaitopt.runs.grid import Axis, Grid

MISSING, FAILED = "#e4e4e4", "#4d4d4d"
"""Where there is no gait: of the cell, and of the cross in it."""
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


def sweep(grid: Grid, records: Sequence[Mapping[str, Any]], scalar: str, *, searched: bool = False) -> Figure:
    """A scalar over the whole grid; crosses where there is no gait, and a line where the spectral radius is one.

    Between neighbouring points the spectral radius is interpolated for that line.

    Parameters
    ----------
    searched : whether any mode sequence would have been taken; else a cross says nothing about other phases.

    Raises
    ------
    ValueError
        If the grid has more than two axes.
    """
    if len(grid.axes) > 2:
        raise ValueError(f"a picture needs one or two axes, not {len(grid.axes)}")
    values = np.array([_value(record, scalar) for record in records]).reshape(grid.shape)
    figure, (axes,) = panels(height=4.6 if len(grid.axes) == 2 else 4.0)
    with mpl.rc_context(STYLE):
        if len(grid.axes) == 1:
            handles = _curve(axes, shown(grid.axes[0]), values, scalar)
        else:
            radii = np.array([_value(record, "spectral_radius") for record in records]).reshape(grid.shape)
            handles = _heat_map(figure, axes, grid, values, radii, scalar)
        if np.isnan(values).any():
            words = "no gait" if searched else "not with these phases"
            handles.append(entry(words, marker="x", linestyle="", color=FAILED, markeredgewidth=1.5))
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


def _curve(axes: Axes, first: Array, values: Array, scalar: str) -> list[Line2D]:
    axes.plot(first, values, ".-", color=COLOURS[0], linewidth=1.2)
    if scalar == "spectral_radius":
        axes.axhline(BOUNDARY, color=NEUTRAL, linewidth=0.8)
    failed = first[np.isnan(values)]
    axes.plot(
        failed, np.full(failed.size, FOOT), "x", color=FAILED, markeredgewidth=1.5,
        transform=axes.get_xaxis_transform(),
    )  # fmt: skip
    margin = MARGIN * np.ptp(first)
    axes.set_xlim(first.min() - margin, first.max() + margin)
    return []


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
    failed = np.argwhere(np.isnan(values))
    axes.plot(first[failed[:, 0]], second[failed[:, 1]], "x", color=FAILED, markeredgewidth=1.2, markersize=4)
    known = radii[np.isfinite(radii)]
    if min(radii.shape) < 2 or not known.size or not known.min() < BOUNDARY < known.max():
        return []
    line = axes.contour(first, second, np.ma.masked_invalid(radii.T), levels=[BOUNDARY], colors=LOST, linewidths=2)
    drawn_at_all = any(len(path.vertices) for path in line.get_paths())  # not where its neighbours have no gait
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


def _value(record: Mapping[str, Any], scalar: str) -> float:
    value = record.get(scalar) if record["status"] == "converged" else None
    return float("nan") if value is None else float(value)
