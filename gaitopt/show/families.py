"""Figures of families of gaits: branches, fronts, sweeps and basins of attraction.

Any scalar of a gait along branches over a parameter, as in Figs 4, 9, 11 and 12 of Gamus & Or (2013); the Pareto front
of two scalars; a scalar over a grid, as a curve or a heat map; and the gait to which each state of a grid leads.
Branches are drawn from the records that a continuation writes: ``point`` records with ``branch``, ``index`` and
``value``, and ``special`` records with ``type`` and ``value``.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import cycle, groupby, pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.gait.branch import TERMINAL, ends_by_request
from gaitopt.gait.gait import Status
from gaitopt.model.cycle import Cycle, mode_words
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import state_unit
from gaitopt.runs.basin import UNDECIDED, Basin
from gaitopt.runs.grid import Axis, Grid
from gaitopt.runs.sweep import Sweep
from gaitopt.show.labels import Parameter, label, symbol
from gaitopt.show.multipliers import CROSSINGS
from gaitopt.show.style import COLOURS, MORE_COLOURS, NEUTRAL, entry, legend_below, panels, styled
from gaitopt.simulation.outcomes import ENDINGS

Record = Mapping[str, Any]

UNSTABLE: Any = (0, (1.2, 1.4))
LOG = 10.0
"""Multipliers beyond this are drawn on a log axis, or those near the unit circle could not be distinguished."""
SPECIAL = {
    "fold": ("fold", "o"),
    "branch_point": ("branches cross", "p"),
    "period_doubling": ("period doubling", "s"),
    "neimark_sacker": ("Neimark–Sacker", "D"),
    "mode_change": ("other phases begin", "^"),
    "impact_change": ("other impact begins", "v"),
    "lift_off": ("foot lifts off", "P"),
    "painleve": ("Painlevé paradox", "X"),
    "vanishing": ("gait vanishes", "x"),
    "end": ("branch ends", "|"),
}
"""Words and marker of every type of special point."""
OF_EACH_STEP = ("period", "step_length")
"""Scalars that are drawn for every step of a cycle: at a period doubling the curve splits."""


def over_parameter(
    curves: Mapping[str, Sequence[Record]], parameter: Parameter, quantity: str = "spectral_radius"
) -> Figure:
    """A scalar over the continued parameter: stable gaits as thick lines, unstable ones as thin dots.

    Of cycles of several steps, the period and the length of every step are drawn.

    Parameters
    ----------
    curves : records of one or several continuations by the name that the legend gives them.
    parameter : that was continued.
    quantity : key of a scalar in the records.
    """
    figure, (axes,) = panels()
    curves = {name: parameter.shown(records) for name, records in curves.items()}
    handles, present = dict[str, Line2D](), set[str]()
    for (name, records), colour in zip(curves.items(), cycle(COLOURS), strict=False):
        points = _points(records, quantity)
        specials = [record for record in records if record["record"] == "special" and not ends_by_request(record)]
        if quantity == "spectral_radius":  # it may grow without bound to an end, which is drawn at the last point
            specials = [{**record, "gait": {}} if record["type"] in TERMINAL else record for record in specials]
        named = _sequences(points) if len(curves) == 1 else {}
        points.sort(key=lambda point: (point["branch"], point["index"]))
        for number, branch in groupby(points, key=lambda point: point["branch"]):
            words, own_colour = named.get(number, (name, colour))
            _draw(axes, joined(list(branch), specials, quantity), quantity, own_colour)
            if len(curves) > 1 or len(named) > 1:
                handles[words] = entry(words, color=own_colour)
        present |= _mark(axes, specials, points, quantity, colour if len(curves) > 1 else NEUTRAL)
    drawn = [point for records in curves.values() for point in _points(records, quantity)]
    if quantity == "spectral_radius":
        axes.axhline(1, color=NEUTRAL, linewidth=0.8, linestyle="-.")
        if any(point[quantity] > LOG for point in drawn):
            axes.set_yscale("log")
    axes.set_xlabel(str(parameter.label))
    written = label(quantity)
    split = any(len(_heights(point, quantity)) > 1 for point in drawn)
    axes.set_ylabel(str(replace(written, words=f"{written.words} of each step") if split else written))
    legend_below(figure, [*handles.values(), *_legend(present)])
    return figure


def joined(branch: Sequence[Record], specials: Sequence[Record], quantity: str) -> list[Record]:
    """The points of a branch with the gaits of its special points between them, so that lines reach the markers.

    A special point counts as stable where the point before it is: stability is lost at the marker.
    """
    line, number = list(branch), branch[0]["branch"]
    for special in specials:
        gait = special.get("gait") or {}
        if gait.get(quantity) is None or not (special["branch"] == number or number in special.get("next", ())):
            continue
        place = 0 if special["branch"] != number else _place(line, special["value"])
        before = line[max(place - 1, 0)]
        line.insert(place, {**gait, "value": special["value"], "branch": number, "stable": is_stable(before)})
    return line


def _place(line: Sequence[Record], value: float) -> int:
    """Where a value fits between the points of a line with the least detour; after the last one if it lies beyond."""
    values = [point["value"] for point in line]
    detours = [abs(value - a) + abs(b - value) - abs(b - a) for a, b in pairwise(values)]
    beyond = 2 * abs(value - values[-1])
    return len(line) if not detours or beyond <= min(detours) else int(np.argmin(detours)) + 1


def _sequences(points: Sequence[Record]) -> dict[int, tuple[str, str]]:
    """Mode sequence in words and colour of every branch; equal sequences share both."""
    words = {point["branch"]: _words(point) for point in points}
    colours = dict(zip(dict.fromkeys(words.values()), cycle((*COLOURS, *MORE_COLOURS)), strict=False))
    return {number: (sequence, colours[sequence]) for number, sequence in words.items()}


def _words(point: Record) -> str:
    steps = Cycle.from_record(point).steps
    words = [f"{mode_words(step.phases)}; impact {step.impact}".replace("_", " ") for step in steps]
    return f"{len(words)} times {words[0]}" if len(words) > 1 and len(set(words)) == 1 else " | ".join(words)


def is_stable(point: Record) -> bool:
    """Whether the gait of a record attracts its neighbours."""
    radius = point.get("spectral_radius")
    return bool(point.get("stable", radius is not None and radius < 1))


def _points(records: Sequence[Record], quantity: str) -> list[Record]:
    return [record for record in records if record["record"] == "point" and record.get(quantity) is not None]


def _heights(point: Record, quantity: str) -> list[float]:
    """The scalar of a gait, or of every step of a cycle where each has its own."""
    if quantity in OF_EACH_STEP and "steps" in point:
        return [step[quantity] for step in point["steps"]]
    return [point[quantity]]


def _same_length(heights: Sequence[list[float]]) -> NDArray[np.float64]:
    """One row per gait; where a doubled family begins, the cycle of its origin counts twice."""
    most = max(map(len, heights))
    return np.array([own * (most // len(own)) for own in heights])


def _draw(axes: Axes, branch: Sequence[Record], quantity: str, colour: str) -> None:
    """One branch in runs of equal stability; neighbouring runs share a point, so that no gap opens between them."""
    values = np.array([point["value"] for point in branch])
    heights = _same_length([_heights(point, quantity) for point in branch])
    stable = np.array([is_stable(point) for point in branch])
    cuts = [0, *(np.flatnonzero(np.diff(stable)) + 1), len(branch)]
    for first, last in pairwise(cuts):
        run = slice(max(first - 1, 0), last)
        line, width = ("-", 2.2) if stable[first] else (UNSTABLE, 1.3)
        axes.plot(values[run], heights[run], color=colour, linestyle=line, linewidth=width)


def _mark(axes: Axes, specials: Sequence[Record], points: Sequence[Record], quantity: str, colour: str) -> set[str]:
    """Markers of the special points, each at the height of its own record or of the nearest gait of its branch."""
    marked = set[str]()
    for special in specials:
        near = [point for point in points if point["branch"] == special["branch"]]
        if special.get("value") is None or not near:
            continue
        closest = min(near, key=lambda point: abs(point["value"] - special["value"]))
        own = (special.get("gait") or {}).get(quantity)
        heights = _heights(closest if own is None else special["gait"], quantity)
        marker = SPECIAL.get(special["type"], (special["type"], "*"))[1]
        values = [special["value"]] * len(heights)
        size = 7 if len(heights) == 1 else 4
        axes.plot(values, heights, marker, color=colour, markersize=size, markeredgewidth=1.4, markerfacecolor="white")
        marked.add(special["type"])
        if special["type"] in CROSSINGS:
            axes.annotate(
                f"{special['value']:.4g}", (special["value"], heights[0]), xytext=(7, 5),
                textcoords="offset points", fontsize="small", color=NEUTRAL,
            )  # fmt: skip
    return marked


def _legend(special: set[str]) -> list[Line2D]:
    entries = [
        entry("stable", linewidth=2.2),
        entry("unstable", linewidth=1.3, linestyle=UNSTABLE),
    ]
    for kind in sorted(special):
        words, marker = SPECIAL.get(kind, (kind, "*"))
        entries.append(entry(words, marker=marker, linestyle="", markerfacecolor="white"))
    return entries


FAILURES_FRONT = ("#d55e00", "#cc79a7", "#4d4d4d")
ON_FRONT, BEATEN = "o", "s"
"""Markers."""


def front_figure(problem: Problem, key: str, points: Sequence[Mapping[str, Any]]) -> Figure:
    """The objective over what is varied; where a bound is varied, over the scalar that it bounds.

    Requests without a design are ticks on the axis, named by their reason.

    Parameters
    ----------
    key : dotted key of the number that is varied.
    points : records of the designs with ``value``, ``objective`` and ``pareto``.
    """
    drawn = [point for point in points if point["objective"] is not None]
    bounded = key.removeprefix("constraints.").removesuffix(".min").removesuffix(".max")
    scalar = next(iter(problem.objective)) if len(problem.objective) == 1 else "objective"
    first = bounded if drawn and bounded in drawn[0] else "value"
    second = scalar if drawn and scalar in drawn[0] else "objective"
    failed = [point for point in points if point["objective"] is None]
    return pareto_front({problem.name: drawn}, first, second, varied=bounded, failed=failed)


def _mark_failures(axes: Axes, failed: Sequence[Mapping[str, Any]]) -> Iterator[Line2D]:
    """Ticks at the foot of the axes where there is no design, one colour per reason; the legend's entries name it."""
    for status, colour in zip(dict.fromkeys(point["status"] for point in failed), FAILURES_FRONT, strict=False):
        own = [point for point in failed if point["status"] == status]
        places = [point["value"] for point in own]
        axes.plot(
            places, [0.0] * len(own), "|", color=colour, markersize=14, markeredgewidth=2,
            transform=axes.get_xaxis_transform(), clip_on=False,
        )  # fmt: skip
        words = f"{status.replace('_', ' ')}: {own[0]['message']}"
        yield entry(words, marker="|", linestyle="", color=colour, markersize=10)


def pareto_front(
    fronts: Mapping[str, Sequence[Mapping[str, Any]]],
    first: str,
    second: str,
    *,
    varied: str = "value",
    failed: Sequence[Mapping[str, Any]] = (),
) -> Figure:
    """Gaits of one or several fronts in the plane of two scalars; unstable gaits are hollow, beaten ones off the line.

    Parameters
    ----------
    fronts : records of gaits by the name that the legend gives them; those with ``pareto`` false are beaten.
    first, second : keys of the scalars, on the horizontal and the vertical axis.
    varied : dotted key of what ``value`` stands for in the records.
    failed : records of requests without a design.
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
        face, words = (NEUTRAL, "stable") if stable else ("white", "unstable")
        marker, more = (BEATEN, ", beaten by another") if beaten else (ON_FRONT, "")
        handles.append(entry(words + more, marker=marker, linestyle="", markerfacecolor=face))
    handles += _mark_failures(axes, failed)
    axes.set_xlabel(str(label(varied if first == "value" else first)))
    axes.set_ylabel(str(label(second)))
    legend_below(figure, handles)
    return figure


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
