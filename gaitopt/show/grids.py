"""Figures over a grid: sweeps, basins of attraction, and the Pareto front of a chain of designs.

A scalar of the gaits of a sweep is drawn as a curve or as a heat map; the states of a basin have the colour of the gait
on which they end. Crosses and ticks mark points without a gait, in one colour per reason.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gaitopt.arrays import Array
from gaitopt.display import spelled
from gaitopt.gait.gait import Status
from gaitopt.model.section import cycle_start
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import state_unit
from gaitopt.runs.basin import Basin, ending_name
from gaitopt.runs.grid import Axis
from gaitopt.runs.sweep import Sweep
from gaitopt.show.branches import is_stable
from gaitopt.show.style import (
    COLOURS,
    NEUTRAL,
    Parameter,
    entry,
    figure_style,
    label,
    legend_below,
    panels,
    symbol,
)

Record = Mapping[str, Any]

MISSING = "#e4e4e4"
"""Colour of a cell of a heat map without a gait."""
CROSSES, TICKS = ("#4d4d4d", "#882255", "#117733"), ("#d55e00", "#cc79a7", "#4d4d4d")
"""Colours of the reasons why there is no gait, in a sweep and along a front."""
CROSS_HEIGHT, MARGIN = 0.03, 0.02
"""Height of the crosses below a curve relative to the axes, and margin relative to the requested range."""
BOUNDARY_COLOUR = "#d55e00"
"""Colour of the line where stability is lost; it stands out from all colours of the map."""
OUTLIER_DISTANCE = 3.0
"""Distance from the quartiles, relative to the distance between them, beyond which a value is an outlier; most outliers
belong to another branch."""
EQUAL_SPREAD, HALF_SCALE = 1e-9, 0.01
"""Relative spread below which all values count as equal, and half width of the colour scale around them, relative to
them."""
BOUNDARY = 1.0
"""Modulus of the largest multiplier at which stability is lost."""
ON_FRONT, BEATEN = "o", "s"
"""Markers of the designs of a front, and of those that another design beats."""
FAILURES = (
    "#000000", "#ffffff", "#bdbdbd", "#d5e0d5", "#c8c0b0", "#f5f0c8", "#d9d9d9", "#c9d6e6", "#f0e0d0",
    "#6e6e6e", "#e5dbe5", "#e8c8c8", "#b8c8b8", "#d8c8e8", "#a8a8b8", "#c0b0a0", "#969696",
)  # fmt: skip
"""Shades of the endings of walks by their codes, so that every picture has the same. The last ones stand for walks
without an end. The shades are pale, so that the gaits stand out."""
MAP_HEIGHT, LINE_HEIGHT = 4.6, 1.6
"""Height of a map over two keys, and of a basin over one coordinate [inch]."""


def sweep(result: Sweep, scalar: str) -> Figure:
    """A scalar over the whole grid, with crosses at points without a gait.

    In a map, a line shows where the spectral radius, interpolated between neighbouring points, is one.

    Raises
    ------
    ValueError
        If the grid has more than two axes.
    """
    grid, values = result.grid, result.column(scalar)
    if len(grid.axes) > 2:
        raise ValueError(f"a picture needs one or two axes, not {len(grid.axes)}")
    curve = len(grid.axes) == 1
    figure, (axes,) = panels() if curve else panels(height=MAP_HEIGHT)
    named = (Parameter(key=a.key, in_degrees=a.unit == "deg", problem=result.problem) for a in grid.axes)
    labels = [str(parameter.label) for parameter in named]
    with figure_style():
        if curve:
            handles = []
            (abscissae,) = map(in_given_unit, grid.axes)
            axes.plot(abscissae, values, ".-", color=COLOURS[0], linewidth=1.2)
            if scalar == "spectral_radius":
                axes.axhline(BOUNDARY, color=NEUTRAL, linewidth=0.8)
            margin = MARGIN * np.ptp(abscissae)
            axes.set_xlim(abscissae.min() - margin, abscissae.max() + margin)
        else:
            handles = _heat_map(figure, axes, result, scalar)
        # a search with a given mode sequence says nothing about other phases
        infeasible = "no gait" if result.problem.is_open else "not with these phases"
        points = np.array([[float(v) for v in point] for point in grid.points(np.arange(grid.size))])
        points = np.where([axis.unit == "deg" for axis in grid.axes], np.degrees(points), points)
        failures = dict[str, list[tuple[float, float]]]()
        for record, point in zip(result.records, points, strict=True):
            if record["status"] != Status.CONVERGED:
                reason = infeasible if record["status"] == Status.INFEASIBLE else record["status"].replace("_", " ")
                failures.setdefault(reason, []).append((point[0], CROSS_HEIGHT if curve else point[1]))
        cross: dict[str, Any] = {"marker": "x", "markeredgewidth": 1.5}
        look = {**cross, "markersize": 6 if curve else 4}
        handles += _mark_failures(axes, failures, CROSSES, look, cross, at_foot=curve)
        if handles:
            legend_below(figure, handles)
        axes.set_xlabel(labels[0])
        axes.set_ylabel(str(label(scalar, result.problem)) if curve else labels[1])
    return figure


def in_given_unit(axis: Axis) -> Array:
    """The values of an axis in the unit in which it was given."""
    return np.degrees(axis.values) if axis.unit == "deg" else axis.values


def _mark_failures(
    axes: Axes,
    failures: Mapping[str, Sequence[tuple[float, float]]],
    colours: Sequence[str],
    look: Mapping[str, Any],
    legend_look: Mapping[str, Any],
    *,
    at_foot: bool,
) -> Iterator[Line2D]:
    """Mark the points without a gait by their reasons; yields the legend's entries.

    Parameters
    ----------
    failures : points by the text of the reason.
    look, legend_look : marker and its properties in the picture and in the legend.
    at_foot : whether heights are fractions of the axes.
    """
    for (reason, points), colour in zip(failures.items(), colours, strict=False):
        transform = axes.get_xaxis_transform() if at_foot else axes.transData
        x, y = zip(*points, strict=True)
        axes.plot(x, y, linestyle="", color=colour, transform=transform, **look)
        yield entry(reason, linestyle="", color=colour, **legend_look)


def _heat_map(figure: Figure, axes: Axes, result: Sweep, scalar: str) -> list[Line2D]:
    """Draw a scalar over two axes and the line where stability is lost; returns the legend's entries."""
    first, second = map(in_given_unit, result.grid.axes)
    values, radii = result.column(scalar), result.column("spectral_radius")
    low, high = _colour_range(values)
    axes.set_facecolor(MISSING)
    axes.grid(visible=False)
    drawn = axes.pcolormesh(
        first, second, values.T, shading="nearest", cmap="viridis", vmin=low, vmax=high, rasterized=True
    )
    beyond = (bool((values < low).any()), bool((values > high).any()))
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[beyond]
    figure.colorbar(drawn, ax=axes, label=str(label(scalar, result.problem)), extend=extend)
    known = radii[np.isfinite(radii)]
    if min(radii.shape) < 2 or not known.size or not known.min() < BOUNDARY < known.max():
        return []
    line = axes.contour(
        first, second, np.ma.masked_invalid(radii.T), levels=[BOUNDARY], colors=BOUNDARY_COLOUR, linewidths=2
    )
    has_line = any(np.size(path.vertices) for path in line.get_paths())  # none where the neighbours have no gait
    return [entry("spectral radius 1: stability lost", color=BOUNDARY_COLOUR, linewidth=2)] if has_line else []


def _colour_range(values: Array) -> tuple[float, float]:
    """Ends of the colour scale: the smallest and largest value, without a few that are far from all others."""
    known = values[np.isfinite(values)]
    if not known.size or np.ptp(known) <= EQUAL_SPREAD * np.abs(known).max():
        middle = float(known.mean()) if known.size else 0.0
        half = HALF_SCALE * abs(middle) or 1.0
        return middle - half, middle + half
    low, high = np.percentile(known, [25, 75])
    near = known[(known >= low - OUTLIER_DISTANCE * (high - low)) & (known <= high + OUTLIER_DISTANCE * (high - low))]
    return float(near.min()), float(near.max())


def basin(result: Basin) -> Figure:
    """The grid over one or two coordinates, coloured by the gait on which each state ends; fixed points as crosses.

    Raises
    ------
    ValueError
        If the grid is over more coordinates.
    """
    if len(result.grid.axes) > 2:
        raise ValueError(f"a picture needs a grid over one or two coordinates, not {len(result.grid.axes)}")
    first, *second = result.grid.axes
    classes, numbered = result.labels.copy(), len(result.attractors) > 1
    titles = [f"{gait} {k}" if numbered else str(gait) for k, gait in enumerate(result.attractors, 1)]
    colours = [COLOURS[k % len(COLOURS)] for k in range(len(titles))]
    endings, counts = np.unique(result.endings[result.labels < 0], return_counts=True)
    for ending in endings[np.argsort(-counts)]:
        classes[(result.labels < 0) & (result.endings == ending)] = len(titles)
        titles.append(spelled(ending_name(ending)))
        colours.append(FAILURES[ending])
    handles = [
        Line2D([], [], label=w, marker="s", linestyle="", markerfacecolor=c, markeredgecolor="#8c8c8c", markersize=8)
        for w, c in zip(titles, colours, strict=True)
    ]
    figure, (axes,) = panels(height=MAP_HEIGHT if second else LINE_HEIGHT)
    rows = in_given_unit(second[0]) if second else np.array([-1.0, 1.0])
    cells = classes.T if second else np.vstack([classes, classes])
    with figure_style():
        axes.pcolormesh(
            in_given_unit(first), rows, cells, shading="nearest", rasterized=True,
            cmap=ListedColormap(colours), norm=BoundaryNorm(np.arange(len(colours) + 1) - 0.5, len(colours)),
        )  # fmt: skip
    for gait in result.attractors:
        values = [(axis, gait.named_state[axis.key]) for axis in result.grid.axes]
        point = [np.degrees(value) if axis.unit == "deg" else value for axis, value in values]
        x_y = point if second else (*point, 0.0)
        axes.plot(*x_y, "+", color="white", markersize=12, markeredgewidth=3.5)
        axes.plot(*x_y, "+", color="black", markersize=11, markeredgewidth=1.4)
    axes.set_xlabel(_state_label(first, result.problem))
    if second:
        axes.set_ylabel(_state_label(second[0], result.problem))
    else:
        axes.set_yticks([])
    axes.grid(visible=False)
    fixed = [entry("gait", marker="+", linestyle="", color="black")] if result.attractors else []
    legend_below(figure, [*handles, *fixed])
    return figure


def _state_label(axis: Axis, problem: Problem) -> str:
    unit = state_unit(axis.key)
    unit = unit.replace("rad", "°") if axis.unit == "deg" else unit
    return f"{symbol(axis.key)} {cycle_start(problem)} [{unit}]"


def front_figure(problem: Problem, key: str, points: Sequence[Record]) -> Figure:
    """The objective versus the varied number; if a bound is varied, versus the scalar that it bounds.

    Requests without a design are ticks on the axis, with their reason in the legend.

    Parameters
    ----------
    key : dotted key of the number that is varied.
    points : records of the designs with ``value``, ``objective`` and ``pareto``.
    """
    designs = [point for point in points if point["objective"] is not None]
    bounded = key.removeprefix("constraints.").removesuffix(".min").removesuffix(".max")
    scalar = next(iter(problem.objective)) if len(problem.objective) == 1 else "objective"
    first = bounded if designs and bounded in designs[0] else "value"
    second = scalar if designs and scalar in designs[0] else "objective"
    failed = [point for point in points if point["objective"] is None]
    return pareto_front({problem.name: designs}, first, second, varied=bounded, failed=failed, problem=problem)


def pareto_front(
    fronts: Mapping[str, Sequence[Record]],
    first: str,
    second: str,
    *,
    varied: str = "value",
    failed: Sequence[Record] = (),
    problem: Problem | None = None,
) -> Figure:
    """Gaits of one or several fronts in the plane of two scalars.

    The markers of unstable gaits are hollow. A gait that another one beats in both scalars is not on the line.

    Parameters
    ----------
    fronts : records of gaits by their names in the legend; another gait beats those with ``pareto`` false.
    first, second : keys of the scalars, on the horizontal and the vertical axis.
    varied : dotted key of the number whose values are ``value`` in the records.
    failed : records of requests without a design.
    problem : the problem, whose motors determine units.
    """
    figure, (axes,) = panels()
    handles, looks = list[Line2D](), set[tuple[bool, bool]]()
    for (name, records), colour in zip(fronts.items(), cycle(COLOURS), strict=False):
        known = [record for record in records if record.get(first) is not None and record.get(second) is not None]
        known.sort(key=lambda record: record[first])
        line = [record for record in known if record.get("pareto", True)]
        axes.plot([r[first] for r in line], [r[second] for r in line], color=colour, linewidth=1.0)
        for record in known:
            stable, beaten = is_stable(record), not record.get("pareto", True)
            looks.add((stable, beaten))
            face = colour if stable else "white"
            marker = BEATEN if beaten else ON_FRONT
            axes.plot(record[first], record[second], marker, color=colour, markerfacecolor=face, markersize=6)
        handles.append(entry(name, color=colour))
    for stable, beaten in sorted(looks, key=lambda look: (look[1], not look[0])):
        face, stability = (NEUTRAL, "stable") if stable else ("white", "unstable")
        marker, more = (BEATEN, ", beaten by another") if beaten else (ON_FRONT, "")
        handles.append(entry(stability + more, marker=marker, linestyle="", markerfacecolor=face))
    reasons = {
        point["status"]: f"{point['status'].replace('_', ' ')}: {point['message']}" for point in reversed(failed)
    }
    failures = dict[str, list[tuple[float, float]]]()
    for point in failed:
        failures.setdefault(reasons[point["status"]], []).append((point["value"], 0.0))
    tick: dict[str, Any] = {"marker": "|", "markersize": 14, "markeredgewidth": 2, "clip_on": False}
    handles += _mark_failures(axes, failures, TICKS, tick, {"marker": "|", "markersize": 10}, at_foot=True)
    axes.set_xlabel(str(label(varied if first == "value" else first, problem)))
    axes.set_ylabel(str(label(second, problem)))
    legend_below(figure, handles)
    return figure
