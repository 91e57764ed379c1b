"""Floquet multipliers in the complex plane, of gaits or along a branch; a gait is stable inside the unit circle."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from gaitopt.show.labels import Parameter
from gaitopt.show.style import (
    COLOURS,
    NEUTRAL,
    entry,
    legend_below,
    panels,
)
from gaitopt.store.gaits import multipliers_of

CROSSINGS = ("fold", "period_doubling", "neimark_sacker", "branch_point")
"""Special points at which a multiplier lies on the unit circle."""
CROSSING, ON_CIRCLE = "#d55e00", 1e-3
"""Colour of the rings; and how near the circle a multiplier of such a point lies at most."""
MARKERS = "osD^v"
SMALLEST_REACH, LARGEST_REACH = 1.15, 2.0
"""Half width of the picture: the unit circle and a margin; and at most so much that the circle is still seen."""
SAME_PLACE = 0.1
"""Crossings this close share their text."""


def multiplier_plane(named: Mapping[str, NDArray[np.complex128]]) -> Figure:
    """Multipliers of one or several gaits by name."""
    figure, handles, reach = _plane()
    axes = figure.axes[0]
    for k, (name, values) in enumerate(named.items()):
        colour, marker = COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)]
        stable = bool(np.abs(values).max(initial=0.0) < 1)
        places = _inside(values)
        axes.plot(places.real, places.imag, marker, color=colour, markersize=7, fillstyle="full" if stable else "none")
        for place, value in zip(places[places != values], values[places != values], strict=True):
            side = "right" if place.real > 0 else "left"
            axes.annotate(
                f"{abs(value):.3g}", (place.real, place.imag), xytext=(0, 8), textcoords="offset points", ha=side
            )
        words = f"{name} ({'stable' if stable else 'unstable'})"
        handles.append(entry(words, color=colour, marker=marker, linestyle="", fillstyle="full" if stable else "none"))
        reach = max(reach, _reach(values))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    legend_below(figure, handles)
    return figure


def multiplier_paths(records: Sequence[Mapping[str, Any]], parameter: Parameter) -> Figure:
    """Multipliers of every point of a branch, coloured by the parameter; where they cross the circle it stands by."""
    records = parameter.shown(records)
    points = [record for record in records if record["record"] == "point"]
    specials = [record for record in records if record["record"] == "special" and record["type"] in CROSSINGS]
    figure, handles, reach = _plane()
    axes = figure.axes[0]
    z = np.concatenate([multipliers_of(point) for point in points])
    values = np.array([point["value"] for point in points for _ in point["multipliers"]])
    reach = max(reach, _reach(z))
    handles += _crossings(axes, specials)
    places = _inside(z)
    scatter = axes.scatter(places.real, places.imag, c=values, cmap="cividis", s=12, linewidths=0)
    figure.colorbar(scatter, ax=axes, label=str(parameter.label), shrink=0.85)
    if (places != z).any():
        largest = np.abs(z).max()
        handles.append(entry(f"at the edge: beyond it, |λ| up to {largest:.3g}", marker=".", linestyle=""))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    legend_below(figure, handles)
    return figure


def _crossings(axes: Axes, specials: Sequence[Mapping[str, Any]]) -> list[Line2D]:
    """Rings around the multipliers on the circle at special points, each with the value of the parameter."""
    texts = dict[complex, list[str]]()
    for special in specials:
        values = [complex(m["re"], m["im"]) for m in (special.get("gait") or {}).get("multipliers", ())]
        on_circle = [z for z in values if abs(abs(z) - 1) < ON_CIRCLE]
        axes.plot([z.real for z in on_circle], [z.imag for z in on_circle], "o", color=CROSSING, fillstyle="none")
        for z in on_circle[:1]:
            place = next((known for known in texts if abs(known - z) < SAME_PLACE), z)
            texts.setdefault(place, []).append(f"{special['value']:.4g}")
    for z, words in texts.items():
        axes.annotate("\n".join(words), (z.real, z.imag), xytext=(6, 6), textcoords="offset points")
    return [entry("stability changes", marker="o", linestyle="", color=CROSSING, fillstyle="none")] if specials else []


def _reach(values: NDArray[np.complex128]) -> float:
    """Half width of a picture of multipliers."""
    return min(LARGEST_REACH, 1.1 * float(np.abs(values).max(initial=0.0)))


def _inside(values: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Multipliers beyond the largest picture moved to its edge, towards the origin."""
    size = np.maximum(np.abs(values.real), np.abs(values.imag)) / LARGEST_REACH
    return np.asarray(values / np.maximum(size, 1.0))


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
