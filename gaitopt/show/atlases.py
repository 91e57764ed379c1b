"""The picture of an atlas: regions, the curves between them, and the points where curves meet.

Regions are tinted by their mode sequence, and hatched where the gait is unstable. Codimension-two points have their
names beside them, where these cover no curve and no other name.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path as Outline
from matplotlib.tri import Triangulation

from gaitopt.arrays import Array
from gaitopt.gait.regions import NO_GAIT, UNKNOWN, Curve, Junction, Region, signed_area
from gaitopt.problem.scalars import SCALARS
from gaitopt.runs.atlas import Atlas
from gaitopt.runs.grid import Axis
from gaitopt.show.branches import write_beside
from gaitopt.show.style import CURVES, NEUTRAL, Label, entry, figure_style, label, legend_below, panels

Record = Mapping[str, Any]

TINT = 0.42
"""Fraction of the colour in the tint of a region; the rest is white, so that curves and names stand out."""
EMPTY = {NO_GAIT: "#ffffff", UNKNOWN: "#d9d9d9"}
"""Colour where there is no gait, and where nothing is known."""
HATCH, HATCH_COLOUR = "////", "#00000038"
"""Hatch of unstable regions."""
LINES: Mapping[str, tuple[str, str, Any, float]] = {
    "fold": ("fold", "#000000", "-", 2.0),
    "period_doubling": ("period doubling", "#882255", "-", 1.8),
    "neimark_sacker": ("Neimark–Sacker", "#d55e00", "-", 1.8),
    "mode_change": ("other phases begin", "#1b1b1b", "-", 0.9),
    "impact_change": ("other impact begins", "#1b1b1b", (0, (5, 2)), 0.9),
    "branch_point": ("branches cross", "#117733", (0, (4, 1.5)), 1.4),
    "lift_off": ("foot lifts off", "#332288", (0, (1, 1)), 1.6),
    "painleve": ("Painlevé paradox", "#aa4499", (0, (1, 1)), 1.6),
    "vanishing": ("gait vanishes", "#999933", (0, (1, 1)), 1.6),
    "end": ("gaits end", NEUTRAL, (0, (1, 1.5)), 1.0),
}
"""Name, colour, style and width of every type of curve."""
NAMES = {
    "resonance_1_1": "1:1", "resonance_1_2": "1:2", "resonance_1_3": "1:3", "resonance_1_4": "1:4",
    "fold_flip": "fold–flip", "generalised_flip": "generalised flip", "chenciner": "Chenciner", "cusp": "cusp",
    "fold_neimark_sacker": "fold–NS", "flip_neimark_sacker": "flip–NS", "double_neimark_sacker": "double NS",
    "margin_crossing": "margins cross", "margin_fold": "fold–margin", "margin_period_doubling": "flip–margin",
    "margin_neimark_sacker": "NS–margin",
}  # fmt: skip
"""Names of codimension-two points beside their markers; NS stands for Neimark-Sacker."""
AWAY = (1.0, 2.0, 3.5, 6.0, 9.0, 13.0, 18.0)
"""Distances at which a name is tried; see ``branches.write_beside``."""
LETTER = (0.0155, 0.036)
"""Size of a letter of a name, relative to the axes."""
CONTOURS = 9
"""Number of contours of a scalar."""
HEIGHT = 5.2
"""Height of the picture without its legend [inch]."""
REGIONS = "regions"


def atlas_figure(atlas: Atlas, name: str = REGIONS) -> Figure:
    """The picture of one sheet of an atlas.

    Parameters
    ----------
    name : ``regions``; ``regions.K`` for the K-th sheet where there are several; or a scalar, for its contours.
    """
    sheet = int(name.partition(".")[2] or 0)
    figure, (axes,) = panels(height=HEIGHT)
    found, handles = atlas.arrangement, list[Any]()
    tints = dict(zip(sequences(atlas), map(_tint, cycle(CURVES)), strict=False)) | EMPTY
    shown = [region for region in found.regions if region.sheet in (sheet, -1) and region.pieces]
    with figure_style():
        for region in shown:
            _fill(axes, region, tints[region.modes], atlas.axes)
        drawn = [curve for curve in found.curves if curve.sheet == sheet]
        for curve in drawn:
            _, colour, style, width = LINES.get(curve.type, (curve.type, NEUTRAL, "-", 1.0))
            axes.plot(*shown_in(curve.points, atlas.axes).T, color=colour, linestyle=style, linewidth=width, zorder=3)
        junctions = [junction for junction in found.junctions if junction.sheet == sheet]
        points = [tuple(shown_in(np.array([junction.values]), atlas.axes)[0].tolist()) for junction in junctions]
        for point in points:
            axes.plot(*point, "o", color="black", markerfacecolor="white", markersize=5, zorder=5)
        if name in SCALARS:
            handles += _contours(axes, atlas, name, sheet)
    first, second = atlas.axes
    axes.set(xlim=_ends(first), ylim=_ends(second))
    axes.grid(visible=False)
    for side in ("top", "right"):
        axes.spines[side].set_visible(True)
    axes.set_xlabel(str(axis_label(first, atlas)))
    axes.set_ylabel(str(axis_label(second, atlas)))
    names = [point_name(junction) for junction in junctions]
    marks = sorted(zip(names, points, strict=True), key=lambda mark: len(mark[0]))  # long names find room last
    write_beside(axes, [(text, *point) for text, point in marks], AWAY, LETTER)
    patches = {region.modes: Patch(facecolor=tints[region.modes], edgecolor=NEUTRAL, linewidth=0.5) for region in shown}
    for text, patch in patches.items():
        patch.set_label(text.replace("_", " "))
        handles.append(patch)
    if any(region.unstable for region in shown):
        handles.append(Patch(facecolor="white", edgecolor=HATCH_COLOUR, hatch=HATCH, linewidth=0, label="unstable"))
    for kind, reason in dict.fromkeys((curve.type, end_reason(curve)) for curve in drawn):
        text, colour, style, width = LINES.get(kind, (kind, NEUTRAL, "-", 1.0))
        handles.append(entry(f"{text}: {reason}" if reason else text, color=colour, linestyle=style, linewidth=width))
    if points:
        text = "codimension-two point"
        handles.append(entry(text, marker="o", linestyle="", color="black", markerfacecolor="white", markersize=5))
    legend_below(figure, handles)
    return figure


def end_reason(curve: Curve) -> str:
    """Why gaits end on a curve: the condition that vanishes there; empty for curves of other types."""
    reason = str(curve.records[0].get("reason", "")) if curve.type == "end" and curve.records else ""
    return reason.partition(";")[0].replace("_", " ")


def point_name(junction: Junction) -> str:
    """The name of a codimension-two point beside its marker."""
    return NAMES.get(junction.name, junction.name.replace("_", " "))


def sequences(atlas: Atlas) -> tuple[str, ...]:
    """The mode sequences of an atlas, in the order of their colours."""
    return tuple(dict.fromkeys(r.modes for r in atlas.arrangement.regions if r.unstable is not None))


def axis_label(axis: Axis, atlas: Atlas) -> Label:
    """Label of an axis, in degrees if its range was given so; a parameter of the walker is described."""
    written = label(axis.key, atlas.problem)
    field = type(atlas.problem.walker).model_fields.get(axis.key.removeprefix("walker."))
    if axis.key.startswith("walker.") and field is not None and field.description:
        written = replace(written, name=field.description.partition(" [")[0].partition(",")[0])
    return replace(written, unit="°") if axis.unit == "deg" else written


def _ends(axis: Axis) -> tuple[float, float]:
    low, high = (axis.lower, axis.upper) if axis.unit != "deg" else np.degrees((axis.lower, axis.upper)).tolist()
    return low, high


def shown_in(points: Array, axes: tuple[Axis, Axis]) -> Array:
    """Points in the units of the axes of the picture; shape (n, 2)."""
    factors = [np.degrees(1.0) if axis.unit == "deg" else 1.0 for axis in axes]
    return np.asarray(points * factors)


def _tint(colour: str) -> str:
    r, g, b = (1 - TINT * (1 - channel) for channel in to_rgb(colour))
    return to_hex((r, g, b))


def _fill(axes: Axes, region: Region, tint: str, ranges: tuple[Axis, Axis]) -> None:
    """Fill the polygons of a region as one; the thin edge closes the gaps between them."""
    outlines = [shown_in(piece, ranges) for piece in region.pieces if len(piece) > 2]
    outlines = [outline if signed_area(outline) > 0 else outline[::-1] for outline in outlines]  # touching
    if not outlines:
        return
    vertices = np.concatenate([np.vstack([outline, outline[:1]]) for outline in outlines])
    codes = np.concatenate(
        [[Outline.MOVETO, *[Outline.LINETO] * (len(outline) - 1), Outline.CLOSEPOLY] for outline in outlines]
    )
    path = Outline(vertices, codes)
    axes.add_patch(PathPatch(path, facecolor=tint, edgecolor=tint, linewidth=0.6, zorder=1))
    if region.unstable:
        axes.add_patch(PathPatch(path, facecolor="none", edgecolor=HATCH_COLOUR, hatch=HATCH, linewidth=0, zorder=2))


def _contours(axes: Axes, atlas: Atlas, scalar: str, sheet: int) -> list[Line2D]:
    """Contours of a scalar within every region, with their values; returns the legend's entry."""
    drawn = False
    values = [
        point[scalar]
        for each in atlas.slices
        for segment in each.segments
        for point in segment.points
        if point.get(scalar) is not None
    ]
    if not values:
        return []
    low, high = np.percentile(values, [2, 98])
    levels = np.linspace(low, high, CONTOURS)
    for region in atlas.arrangement.regions:
        if region.sheet != sheet or region.unstable is None:
            continue
        rows = [
            (point["value"], atlas.slices[j].value, point[scalar])
            for j, i in region.segments
            for point in atlas.slices[j].segments[i].points
            if point.get(scalar) is not None
        ]
        if len({row[1] for row in rows}) < 2 or len(rows) < 3:
            continue
        points = shown_in(np.array(rows)[:, :2], atlas.axes)
        triangles = _triangles(points, region, atlas)
        lines = axes.tricontour(
            triangles, [row[2] for row in rows], levels=levels, colors="#333333", linewidths=0.6, linestyles=":"
        )
        axes.clabel(lines, fontsize=7, fmt="%.3g")
        drawn = True
    return [entry(str(label(scalar, atlas.problem)), color="#333333", linestyle=":", linewidth=0.8)] if drawn else []


def _triangles(points: Array, region: Region, atlas: Atlas) -> Triangulation:
    """Triangles between neighbouring branches; Delaunay's would connect distant parts of a long region."""
    starts, triangles, count = dict[tuple[int, int], tuple[int, int]](), list[tuple[int, int, int]](), 0
    for j, i in region.segments:
        size = len(atlas.slices[j].segments[i].points)
        starts[j, i] = count, size
        count += size
    for (j, _), (first, n) in starts.items():
        for (other, _), (second, m) in starts.items():
            if other != j + 1:
                continue
            k = p = 0
            while k < n - 1 or p < m - 1:  # a strip of triangles between two chains of points
                advance = p == m - 1 or (k < n - 1 and (k + 1) / n <= (p + 1) / m)
                corner = first + k + 1 if advance else second + p + 1
                triangles.append((first + k, second + p, corner))
                k, p = (k + 1, p) if advance else (k, p + 1)
    return Triangulation(points[:, 0], points[:, 1], np.array(triangles))


def scalar_names(atlas: Atlas) -> tuple[str, ...]:
    """Scalars that any gait of an atlas has."""
    points = [segment.middle for each in atlas.slices for segment in each.segments]
    return tuple(name for name in SCALARS if any(point.get(name) is not None for point in points))


def sheet_names(atlas: Atlas) -> Sequence[str]:
    """Names of the pictures of its sheets."""
    return (REGIONS, *(f"{REGIONS}.{k}" for k in range(1, atlas.sheets)))
