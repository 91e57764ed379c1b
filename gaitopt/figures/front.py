"""Pareto fronts: what one aim costs in terms of another."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gaitopt.figures.branches import is_stable
from gaitopt.figures.labels import label
from gaitopt.figures.style import COLOURS, NEUTRAL, entry, legend_below, panels
from gaitopt.problem import Problem

FAILURES = ("#d55e00", "#cc79a7", "#4d4d4d")
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
    for status, colour in zip(dict.fromkeys(point["status"] for point in failed), FAILURES, strict=False):
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
