"""Sweeps: a scalar of the gait over one parameter as a curve, over two as a heat map."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitopt.figures.labels import label
from gaitopt.figures.style import COLOURS, NEUTRAL, STYLE, entry, legend_below, panels
from gaitopt.study.grid import Grid

MISSING = "#e4e4e4"
"""Where there is no gait."""
BOUNDARY = 1.0
"""Modulus of the largest multiplier at which stability is lost."""


def sweep(grid: Grid, records: Sequence[Mapping[str, Any]], scalar: str) -> Figure:
    """A scalar over the grid; grey where there is no gait, and a line where stability is lost.

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
            axes.plot(grid.axes[0].values, values, ".-", color=COLOURS[0], linewidth=1.2)
            if scalar == "spectral_radius":
                axes.axhline(BOUNDARY, color=NEUTRAL, linewidth=0.8)
        else:
            _heat_map(figure, axes, grid, values, scalar)
        axes.set_xlabel(str(label(grid.axes[0].key)))
        axes.set_ylabel(str(label(scalar if len(grid.axes) == 1 else grid.axes[1].key)))
    return figure


def _heat_map(figure: Figure, axes: Axes, grid: Grid, values: Any, scalar: str) -> None:
    first, second = (axis.values for axis in grid.axes)
    axes.set_facecolor(MISSING)
    axes.grid(visible=False)
    drawn = axes.pcolormesh(first, second, values.T, shading="nearest", cmap="viridis", rasterized=True)
    figure.colorbar(drawn, ax=axes, label=str(label(scalar)))
    handles = [entry("no gait", marker="s", linestyle="", color=MISSING)] if np.isnan(values).any() else []
    crosses = np.nanmin(values, initial=np.inf) < BOUNDARY < np.nanmax(values, initial=-np.inf)
    if scalar == "spectral_radius" and crosses and min(values.shape) > 1:
        axes.contour(first, second, values.T, levels=[BOUNDARY], colors="white", linewidths=1.5)
        handles.append(entry("stability lost", color="#a0a0a0"))
    if handles:
        legend_below(figure, handles)


def _value(record: Mapping[str, Any], scalar: str) -> float:
    value = record.get(scalar) if record["status"] == "converged" else None
    return float("nan") if value is None else float(value)
