"""Floquet multipliers in the complex plane, with the unit circle inside which a gait is stable."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from gaitopt.figures.labels import label
from gaitopt.figures.style import COLOURS, NEUTRAL, entry, legend_below, panels

CROSSINGS = ("fold", "period_doubling", "neimark_sacker", "branch_point")
"""Special points at which a multiplier lies on the unit circle."""
CROSSING, ON_CIRCLE = "#d55e00", 1e-3
"""Colour of the rings; and how near the circle a multiplier of such a point lies at most."""
MARKERS = "osD^v"
SMALLEST_REACH = 1.15
"""Half width of the picture: the whole unit circle and a margin."""


def multiplier_plane(named: Mapping[str, NDArray[np.complex128]]) -> Figure:
    """Multipliers of one or several gaits by name."""
    figure, handles, reach = _plane()
    axes = figure.axes[0]
    for k, (name, values) in enumerate(named.items()):
        colour, marker = COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)]
        stable = bool(np.abs(values).max(initial=0.0) < 1)
        axes.plot(values.real, values.imag, marker, color=colour, markersize=7, fillstyle="full" if stable else "none")
        words = f"{name} ({'stable' if stable else 'unstable'})"
        handles.append(entry(words, color=colour, marker=marker, linestyle="", fillstyle="full" if stable else "none"))
        reach = max(reach, 1.1 * float(np.abs(values).max(initial=0.0)))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    legend_below(figure, handles)
    return figure


def multiplier_paths(records: Sequence[Mapping[str, Any]], parameter: str) -> Figure:
    """Multipliers of every point of a branch, coloured by the parameter; where they cross the circle it stands by."""
    points = [record for record in records if record["record"] == "point"]
    specials = [record for record in records if record["record"] == "special" and record["type"] in CROSSINGS]
    figure, handles, reach = _plane()
    axes = figure.axes[0]
    z = np.array([complex(m["re"], m["im"]) for point in points for m in point["multipliers"]])
    values = np.array([point["value"] for point in points for _ in point["multipliers"]])
    reach = max(reach, 1.1 * float(np.abs(z).max(initial=0.0)))
    handles += _crossings(axes, specials)
    scatter = axes.scatter(z.real, z.imag, c=values, cmap="cividis", s=12, linewidths=0)
    figure.colorbar(scatter, ax=axes, label=str(label(parameter)), shrink=0.85)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    legend_below(figure, handles)
    return figure


def _crossings(axes: Axes, specials: Sequence[Mapping[str, Any]]) -> list[Line2D]:
    """Rings around the multipliers on the circle at special points, each with the value of the parameter."""
    for special in specials:
        values = [complex(m["re"], m["im"]) for m in (special.get("gait") or {}).get("multipliers", ())]
        on_circle = [z for z in values if abs(abs(z) - 1) < ON_CIRCLE]
        axes.plot([z.real for z in on_circle], [z.imag for z in on_circle], "o", color=CROSSING, fillstyle="none")
        for z in on_circle[:1]:
            axes.annotate(f"{special['value']:.4g}", (z.real, z.imag), xytext=(6, 6), textcoords="offset points")
    return [entry("stability changes", marker="o", linestyle="", color=CROSSING, fillstyle="none")] if specials else []


def _plane() -> tuple[Figure, list[Line2D], float]:
    figure, (axes,) = panels(height=5.2)
    turn = np.linspace(0, 2 * np.pi, 361)
    axes.plot(np.cos(turn), np.sin(turn), color=NEUTRAL, linewidth=1.0)
    axes.axhline(0, color="#b0b0b0", linewidth=0.7)
    axes.axvline(0, color="#b0b0b0", linewidth=0.7)
    axes.set_box_aspect(1)
    axes.set_xlabel("real part of λ")
    axes.set_ylabel("imaginary part of λ")
    return figure, [entry("unit circle", linewidth=1.0)], SMALLEST_REACH
