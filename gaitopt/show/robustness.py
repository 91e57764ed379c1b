"""How robust a gait is: which patches of ice a walk survives, and how far each disturbance may go.

A figure of patches has a strip for each length: the values at which a walk returns to the gait, and those at which it
does not. The limits of the other disturbances are bars from the nominal floor.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitopt.display import spelled
from gaitopt.runs.robustness import Robustness
from gaitopt.show.style import COLOURS, NEUTRAL, entry, legend_below, panels
from gaitopt.uncertainty.limits import Limit

RETURNS, FAILS = COLOURS[2], COLOURS[1]
"""Colours of walks that return, and of those that do not."""
LEGEND = (("returns to the gait", RETURNS), ("does not return", FAILS))
ROW = 0.42
"""Height of a strip [inch]."""
LABELS = {
    "friction_low": "friction of icy tiles",
    "friction_high": "friction of sticky tiles",
    "step_up": "step up [m]",
    "step_down": "step down [m]",
    "slope_up": "slope of tiles, more [rad]",
    "slope_down": "slope of tiles, less [rad]",
}
UNITS = {"period": "s", "step_length": "m", "foot_clearance": "m", "cone_distance": "N"}
TILE_UNITS = {"friction": "", "height": "/m", "slope": "/rad"}


def patches(result: Robustness, kind: str) -> Figure:
    """Strips of the values at which walks over 1, 2 and 4 tiles of a kind return, each with its limit."""
    limits = result.strips[kind]
    figure, (axes,) = panels(height=1.1 + ROW * len(limits))
    _draw_strips(axes, limits)
    axes.set_xlabel(LABELS[kind])
    axes.set_yticks(range(len(limits)), [f"{n} tile{'s' * (n > 1)}" for n in sorted(limits)])
    axes.set_ylim(len(limits) - 0.5, -0.5)
    returns, fails = (entry(words, color=colour, linewidth=6) for words, colour in LEGEND)
    legend_below(figure, [returns, fails])
    return figure


def _draw_strips(axes: Axes, limits: Mapping[int, Limit]) -> None:
    """A strip for each length, with its limit."""
    for row, (_, found) in enumerate(sorted(limits.items())):
        tried, survived = np.abs(found.tried), np.array(found.survived)
        half = abs(tried[1] - tried[0]) / 2 if len(tried) > 1 else 0.0005
        for good, colour in ((True, RETURNS), (False, FAILS)):
            spans = [(value - half, 2 * half) for value in tried[survived == good]]
            axes.broken_barh(spans, (row - 0.35, 0.7), color=colour, linewidth=0)
        if found.value is not None:
            axes.plot([abs(found.value)] * 2, [row - 0.45, row + 0.45], color="black", linewidth=1)
            axes.annotate(f"{abs(found.value):.4g}", (abs(found.value), row), xytext=(4, 0), va="center",
                          textcoords="offset points", fontsize="x-small", color="black")  # fmt: skip
    axes.spines[["left", "right", "top"]].set_color(NEUTRAL)


def rows_of(record: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    """The table: figure, value or lower end, upper end, and how it was found."""
    rows = list[tuple[str, str, str, str]]()
    for key, found in record.get("range", {}).items():
        low, high = (_end(found[side], found[f"{side}_end"]) for side in ("low", "high"))
        rows.append((f"stable range of {key}", low, high, "continuation"))
    for kind, of_length in record.get("patch", {}).items():
        values = ", ".join(f"{_number(value)} ({length})" for length, value in of_length.items())
        rows.append((f"{LABELS[kind]}, by number of tiles", values, "", "simulated walks"))
    for rate, (low, high) in record.get("push", {}).items():
        rows.append((f"push of {rate}", _number(low), _number(high), "simulated walks"))
    nearest = record.get("nearest")
    if nearest is not None:
        state = nearest["state"] or {}
        words = ", ".join(f"{name} = {value:.6g}" for name, value in state.items())
        rows.append(("nearest state that does not return", _number(nearest["distance"]), words, "search along rays"))
    for quantity, outputs in record.get("sensitivity", {}).items():
        for name, value in outputs.items():
            unit = f"{UNITS[name]}{TILE_UNITS[quantity]}"
            words = f"norm from {quantity} to {name.replace('_', ' ')} [{unit}]"
            rows.append((words, _number(value), "", "exact derivatives"))
    falls = record.get("falls")
    if falls is not None:
        low, high = falls["interval"]
        words = f"{_number(low)} to {_number(high)}"
        rows.append((f"mean steps to a fall, {falls['floor']}", _number(falls["mean_steps"]), words, "random walks"))
        rows.append(("metastable eigenvalue", _number(falls["eigenvalue"], 8), "", "walks that go on as copies"))
    return rows


def _number(value: float | None, digits: int = 6) -> str:
    return "-" if value is None else f"{value:.{digits}g}"


def _end(value: float | None, kind: str) -> str:
    return "no end found" if value is None else f"{value:.9g} ({spelled(kind)})"


COLUMNS: Sequence[str] = ("figure", "value, lower end", "upper end", "found by")
