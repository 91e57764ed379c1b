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

LABEL_DISTANCE = 14.0
"""Smallest distance of two labels of an axis [points]."""
POINTS = 72.0
"""Number of points in an inch."""
TOTAL_WIDTH = 330.0
"""Sum of the widths of one dot in every column with which the columns touch [points]."""


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
        for kind, chosen, colour in kinds:
            look: dict[str, Any] = {"linestyle": "", "marker": "s", "color": colour}
            axes.plot(columns[chosen], rows[chosen], markersize=max(0.6, TOTAL_WIDTH / n), markeredgewidth=0, **look)
            handles.append(entry(kind, markersize=5, **look))
        axes.set_xlim(-1, n)
        axes.set_ylim(m, -1)
        axes.grid(visible=False)
        axes.xaxis.tick_top()
        for groups, line in ((above, axes.axvline), (beside, axes.axhline)):
            for _, start, _ in groups[1:]:
                line(start - 0.5, color=NEUTRAL, linewidth=0.5)
        inch = axes.get_position().size * figure.get_size_inches()
        for axis, groups, size, turn in ((axes.xaxis, above, n / inch[0], 90), (axes.yaxis, beside, m / inch[1], 0)):
            shown = _separate_labels(groups, size * LABEL_DISTANCE / POINTS)
            axis.set_ticks([at for _, at in shown], [name for name, _ in shown], rotation=turn)
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


def _groups(names: Sequence[str]) -> list[tuple[str, int, int]]:
    """Groups of equal names next to each other, each with the index of its first entry and that after its last one."""
    groups, start = list[tuple[str, int, int]](), 0
    for name, run in groupby(names):
        end = start + len(list(run))
        groups.append((name, start, end))
        start = end
    return groups


def _separate_labels(groups: Sequence[tuple[str, int, int]], distance: float) -> list[tuple[str, float]]:
    """Names at the middle of their groups; groups that are closer than a distance share a label."""
    shown: list[tuple[str, float]] = []
    for name, start, end in groups:
        middle = (start + end - 1) / 2
        if shown and middle - shown[-1][1] < distance:
            before, at = shown.pop()
            name, middle = f"{before}, {name}", (at + middle) / 2
        shown.append((name, middle))
    return shown
