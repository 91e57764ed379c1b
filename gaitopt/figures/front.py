"""Pareto fronts: what one aim costs in terms of another."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gaitopt.figures.branches import is_stable
from gaitopt.figures.labels import label
from gaitopt.figures.style import COLOURS, NEUTRAL, entry, legend_below, panels


def pareto_front(fronts: Mapping[str, Sequence[Mapping[str, Any]]], first: str, second: str) -> Figure:
    """Gaits of one or several fronts in the plane of two scalars; unstable gaits are hollow.

    Parameters
    ----------
    fronts : records of gaits by the name that the legend gives them.
    first, second : keys of the scalars, on the horizontal and the vertical axis.
    """
    figure, (axes,) = panels()
    handles, stabilities = list[Line2D](), set[bool]()
    for (name, records), colour in zip(fronts.items(), cycle(COLOURS), strict=False):
        known = [record for record in records if record.get(first) is not None and record.get(second) is not None]
        known.sort(key=lambda record: record[first])
        axes.plot([r[first] for r in known], [r[second] for r in known], color=colour, linewidth=1.0)
        for record in known:
            stable = is_stable(record)
            stabilities.add(stable)
            face = colour if stable else "white"
            axes.plot(record[first], record[second], "o", color=colour, markerfacecolor=face, markersize=6)
        handles.append(entry(name, color=colour))
    for stable in sorted(stabilities, reverse=True):
        face, words = (NEUTRAL, "stable") if stable else ("white", "unstable")
        handles.append(entry(words, marker="o", linestyle="", markerfacecolor=face))
    axes.set_xlabel(str(label(first)))
    axes.set_ylabel(str(label(second)))
    legend_below(figure, handles)
    return figure
