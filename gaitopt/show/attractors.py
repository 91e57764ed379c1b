"""The bifurcation diagram: the attractors of walks over a parameter, drawn over the branches of a continuation.

A point is a state just after an impact: a cycle of m steps has m points at a value of the parameter, and chaos fills
bands.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gaitopt.gait.branch import TERMINAL
from gaitopt.model.section import cycle_start
from gaitopt.problem.scalars import state_unit
from gaitopt.runs.attractors import Attractors
from gaitopt.show.branches import UNSTABLE, draw_branch, joined
from gaitopt.show.style import COLOURS, NEUTRAL, Parameter, entry, legend_below, panels, symbol, typeset

Record = Mapping[str, Any]

HEIGHT = 4.6
"""Height of the figure [inch]."""
ATTRACTOR_COLOUR = COLOURS[6]
STABLE_LINE: dict[str, Any] = {"color": COLOURS[0], "linewidth": 1.8}
UNSTABLE_LINE: dict[str, Any] = {"color": COLOURS[1], "linewidth": 1.2, "linestyle": UNSTABLE}
"""Lines of stable and of unstable gaits of branches."""
SMALLEST_RADIUS = 1e-300
"""Smallest spectral radius whose logarithm is drawn; that of zero would be infinite."""
CHAOTIC_EXPONENT = 0.0
"""Lyapunov exponent above which neighbouring walks diverge."""


def bifurcation_diagram(result: Attractors, name: str, branches: Mapping[str, Sequence[Record]]) -> Figure:
    """A section coordinate of all attractors, or their exponents (``lyapunov``), over the parameter.

    Parameters
    ----------
    branches : records of branches over the same parameter by their names in the legend.

    Raises
    ------
    ValueError
        If a branch is over another parameter.
    """
    figure, (axes,) = panels(height=HEIGHT)
    parameter = Parameter(key=result.axis.key, in_degrees=result.axis.unit == "deg", problem=result.problem)
    records = parameter.shown(result.records)
    handles, look = list[Line2D](), dict[str, Any](marker=".", markersize=4)
    for stored in branches.values():
        _draw_branch(axes, parameter.shown(stored), name)
    if branches:
        handles += [entry("stable gaits", **STABLE_LINE | {"linewidth": 2.2}), entry("unstable gaits", **UNSTABLE_LINE)]
    if name == "lyapunov":
        points = [
            (record["value"], run["lyapunov"])
            for record in records
            for run in record["attractors"]
            if run["lyapunov"] is not None
        ]
        axes.axhline(CHAOTIC_EXPONENT, color=NEUTRAL, linewidth=0.8, linestyle="-.")
        axes.set_ylabel("largest Lyapunov exponent per step")
    else:
        column = result.names.index(name)
        points = [
            (record["value"], state[column])
            for record in records
            for run in record["attractors"]
            for state in run["states"]
        ]
        look |= {"markersize": 2.5, "markeredgewidth": 0}
        axes.set_ylabel(f"{symbol(name)} {cycle_start(result.problem)} [{typeset(state_unit(name, result.problem))}]")
    if points:
        axes.plot(*np.array(points).T, linestyle="", color=ATTRACTOR_COLOUR, rasterized=True, zorder=3, **look)
    handles.append(entry("walks settle here", color=ATTRACTOR_COLOUR, marker=".", linestyle=""))
    axes.set_xlim(min(r["value"] for r in records), max(r["value"] for r in records))
    axes.set_xlabel(str(parameter.label))
    legend_below(figure, handles)
    return figure


def _draw_branch(axes: Axes, records: Sequence[Record], name: str) -> None:
    """Draw a state of every step of the gaits of a branch, or the logarithm of their spectral radius per step."""
    points = [record for record in records if record["record"] == "point"]
    specials = [record for record in records if record["record"] == "special" and record["type"] not in TERMINAL]

    def heights(gait: Record) -> list[float]:
        if name == "lyapunov":
            return [float(np.log(max(gait["spectral_radius"], SMALLEST_RADIUS)) / gait["n_steps"])]
        return [step["state"][name] for step in gait.get("steps", [gait])]

    for branch in sorted({point["branch"] for point in points}):
        own = sorted((point for point in points if point["branch"] == branch), key=lambda point: point["index"])
        line = joined(own, specials, "spectral_radius")
        draw_branch(axes, line, [heights(gait) for gait in line], STABLE_LINE, UNSTABLE_LINE)
