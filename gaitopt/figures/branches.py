"""Any scalar of a gait along branches of gaits over a parameter, as in Figs 4, 9, 11 and 12 of the paper.

Works on the records that a continuation writes: ``point`` records with ``branch``, ``index`` and ``value``, and
``special`` records with ``type`` and ``value``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle, groupby, pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from gaitopt.figures.labels import Parameter, label
from gaitopt.figures.style import COLOURS, MORE_COLOURS, NEUTRAL, entry, legend_below, panels
from gaitopt.gait import TERMINAL
from gaitopt.gait.branch import ends_by_request
from gaitopt.mechanics.cycle import Cycle, mode_words

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
BIFURCATIONS = ("fold", "branch_point", "period_doubling", "neimark_sacker")
"""Special points that carry the value of the parameter."""
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
        if special["type"] in BIFURCATIONS:
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
