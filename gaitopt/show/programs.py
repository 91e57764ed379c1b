"""The sparsity of a nonlinear program: which constraints depend on which unknowns, by phase."""

from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np
from casadi import jacobian_sparsity
from matplotlib.figure import Figure

from gaitopt.building import BUILDING
from gaitopt.problem.scalars import SCALARS
from gaitopt.show.style import COLOURS, NEUTRAL, entry, figure_style, legend_below, panels
from gaitopt.solver.program import NonlinearProgram
from gaitopt.solver.shooting import Label

LINE = 14.0
"""Least distance of two labels of an axis [points]."""
POINTS = 72.0
"""Points of an inch."""
DOTS = 330.0
"""Width of the dots with which the columns would touch, in all [points]."""


def jacobian_pattern(program: NonlinearProgram) -> Figure:
    """Nonzero entries of the Jacobian of the constraints, with the phases at the axes."""
    with BUILDING:
        pattern = jacobian_sparsity(program.g, program.x)
        rows, columns = np.array(pattern.row()), np.array(pattern.get_col())
    m, n = pattern.shape
    equal = program.lbg == program.ubg
    above = _groups([_of_unknown(label) for label in program.x_labels])
    beside = _groups([_of_row(label, bool(fixed)) for label, fixed in zip(program.g_labels, equal, strict=True)])
    figure, (axes,) = panels(height=6.0 * min(1.6, max(0.8, m / n)))
    with figure_style():
        kinds = (("equations", equal[rows], COLOURS[0]), ("inequalities", ~equal[rows], COLOURS[1]))
        handles = []
        for words, chosen, colour in kinds:
            look: dict[str, Any] = {"linestyle": "", "marker": "s", "color": colour}
            axes.plot(columns[chosen], rows[chosen], markersize=max(0.6, DOTS / n), markeredgewidth=0, **look)
            handles.append(entry(words, markersize=5, **look))
        axes.set_xlim(-1, n)
        axes.set_ylim(m, -1)
        axes.grid(visible=False)
        axes.xaxis.tick_top()
        for groups, line in ((above, axes.axvline), (beside, axes.axhline)):
            for _, start, _ in groups[1:]:
                line(start - 0.5, color=NEUTRAL, linewidth=0.5)
        inch = axes.get_position().size * figure.get_size_inches()
        for axis, groups, size, turn in ((axes.xaxis, above, n / inch[0], 90), (axes.yaxis, beside, m / inch[1], 0)):
            shown = _apart(groups, size * LINE / POINTS)
            axis.set_ticks([place for _, place in shown], [words for words, _ in shown], rotation=turn)
        axes.tick_params(length=0, labelsize="small")
        axes.set_xlabel(f"{n} unknowns")
        axes.set_ylabel(f"{m} constraints, {rows.size} nonzero entries")
        legend_below(figure, handles)
    return figure


def _of_unknown(label: Label) -> str:
    if label.node is not None and label.phase is not None:
        return f"nodes of phase {label.phase + 1}\n{label.mode}".replace("_", " ")
    return "durations" if label.phase is not None else "parameters"


def _of_row(label: Label, equation: bool) -> str:
    phase = "" if label.phase is None else f", phase {label.phase + 1}"
    if label.name in SCALARS:
        return "scalars"
    if equation:
        motion, sums = f"motion{phase}", "scalars"
        kinds = {"defect": motion, "interpolation": motion, "reset": "impacts", "integral": sums, "lengths": sums}
        return kinds.get(label.name, "events")
    return f"margins{phase}" if phase else "impact" if label.mode is not None else "scalars"


def _groups(words: Sequence[str]) -> list[tuple[str, int, int]]:
    """Runs of equal words, each with its first entry and the one after its last."""
    groups, at = list[tuple[str, int, int]](), 0
    for word, run in groupby(words):
        end = at + len(list(run))
        groups.append((word, at, end))
        at = end
    return groups


def _apart(groups: Sequence[tuple[str, int, int]], least: float) -> list[tuple[str, float]]:
    """Words at the middle of their groups; groups that are too close to each other share a label."""
    shown: list[tuple[str, float]] = []
    for words, start, end in groups:
        place = (start + end - 1) / 2
        if shown and place - shown[-1][1] < least:
            before, at = shown.pop()
            words, place = f"{before}, {words}", (at + place) / 2
        shown.append((words, place))
    return shown
