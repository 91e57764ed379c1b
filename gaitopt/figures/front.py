"""Pareto fronts: what one aim costs in terms of another."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gaitopt.figures.branches import is_stable
from gaitopt.figures.labels import label
from gaitopt.figures.style import COLOURS, NEUTRAL, entry, legend_below, panels

ON_FRONT, BEATEN = "o", "s"
"""Markers."""


def pareto_front(
    fronts: Mapping[str, Sequence[Mapping[str, Any]]], first: str, second: str, *, varied: str = "value"
) -> Figure:
    """Gaits of one or several fronts in the plane of two scalars; unstable gaits are hollow, beaten ones off the line.

    Parameters
    ----------
    fronts : records of gaits by the name that the legend gives them; those with ``pareto`` false are beaten.
    first, second : keys of the scalars, on the horizontal and the vertical axis.
    varied : dotted key of what ``value`` stands for in the records.
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
    axes.set_xlabel(str(label(varied if first == "value" else first)))
    axes.set_ylabel(str(label(second)))
    legend_below(figure, handles)
    return figure
