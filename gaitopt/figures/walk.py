"""A walk step by step: the states just after each impact against those of the gait that it started from."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from gaitopt.figures.labels import symbol
from gaitopt.figures.style import COLOURS, entry, legend_below, panels
from gaitopt.gait import Ending
from gaitopt.problem.scalars import state_unit
from gaitopt.study.simulate import Walk

GAIT, FAILED = "#009e73", "#d55e00"
PANEL_HEIGHT, FOOT = 1.35, 1.1
"""Height of one panel, and of axis and legend below [inch]."""


def section_states(walk: Walk) -> Figure:
    """Every coordinate of the section over the number of the step; a broken line marks where the walk ended."""
    names = _names(walk)
    states = walk.trajectory.section_states
    figure, axes = panels(len(names), height=PANEL_HEIGHT * len(names) + FOOT)
    for name, panel in zip(names, axes, strict=True):
        column = walk.system.state_names.index(name)
        for state in walk.gait_states:
            panel.axhline(state[column], color=GAIT, linewidth=1.4)
        panel.plot(range(len(states)), states[:, column], ".-", color=COLOURS[0], linewidth=1.0, markersize=7)
        if walk.trajectory.ending is not Ending.COMPLETED:
            panel.axvline(len(states) - 0.5, color=FAILED, linestyle="--")
        panel.set_ylabel(f"{symbol(name)} [{state_unit(name)}]")
        panel.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes[-1].set_xlabel("steps since the start")
    figure.align_ylabels(axes)
    legend_below(figure, _legend(walk))
    return figure


def _names(walk: Walk) -> list[str]:
    """The section's coordinates; the slip velocity only where a foot ever slips after an impact."""
    names = list(walk.system.walker.section_names(slipping=True))
    slipping = bool(np.any(walk.trajectory.section_states[:, -1]))
    return names if slipping or len(names) == 1 else names[:-1]


def _legend(walk: Walk) -> list[Line2D]:
    handles = [entry("just after each impact", color=COLOURS[0], marker=".", linewidth=1.0)]
    if len(walk.gait_states):
        handles.append(entry("the gait", color=GAIT, linewidth=1.4))
    if walk.trajectory.ending is not Ending.COMPLETED:
        words = str(walk.trajectory.ending).replace("_", " ")
        handles.append(entry(f"the walk ends: {words}", color=FAILED, linestyle="--"))
    return handles
