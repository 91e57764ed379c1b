"""The two roads over each other: shooting nodes of the NLP on the simulated step, their difference on a log axis."""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from gaitopt.figures.labels import label, symbol
from gaitopt.figures.motion import Motion
from gaitopt.figures.style import COLOURS, NEUTRAL, dashes, entry, legend_below, mode_legend, panels
from gaitopt.gait import Arc, Gait, Step, curves
from gaitopt.simulation import Simulator

Array = NDArray[np.float64]

ROUNDING = 1e-17
"""A difference of exactly zero is drawn here, at the foot of the log axis."""


def simulated(gait: Gait) -> Step:
    """The step that the forward simulator walks from the gait's state, choosing its modes by itself."""
    return Simulator(gait.system, gait.p).run(gait.state, steps=1, dense=True).steps[0]


def two_roads(motion: Motion, walked: Step, nodes: tuple[Array, Array] | None = None) -> Figure:
    """Angles of a gait found by the NLP over those of the simulated step, and all states' differences below.

    Parameters
    ----------
    motion : the gait.
    walked : the simulated step.
    nodes : times (K,) [s] and states (K, n_z) of the shooting nodes; without them the gait's own points are drawn.
    """
    figure, (upper, lower) = panels(2, heights=[3, 2], height=5.4)
    found = _points(motion.step) if nodes is None else nodes
    handles: list[Line2D] = []
    for name, colour in zip(motion.system.walker.shape, COLOURS, strict=False):
        column = motion.state_index(name)
        for arc in walked.arcs:
            upper.plot(arc.times, arc.states[:, column], color=colour, linestyle=dashes(arc.mode))
        upper.plot(found[0], found[1][:, column], "o", color=colour, markersize=4, fillstyle="none")
        handles.append(entry(f"{symbol(name)}, simulation", color=colour))
    handles.append(entry("NLP", marker="o", linestyle="", fillstyle="none"))
    upper.set_ylabel("angle [rad]")
    handles += _differences(lower, motion, walked)
    legend_below(figure, [*handles, *mode_legend([mode for mode, _ in walked.phases])])
    return figure


def differences(ours: Step, theirs: Step) -> Iterator[tuple[Array, Array]]:
    """Times and differences of the states on each arc, compared at equal fractions of it."""
    for mine, other in zip(ours.arcs, theirs.arcs, strict=False):
        if mine.mode is not other.mode or mine.duration <= 0:
            return
        yield mine.times, mine.states - _at(other, 2 * (mine.times - mine.start) / mine.duration - 1)


def _differences(axes: Axes, motion: Motion, walked: Step) -> list[Line2D]:
    """Angles' and rates' differences along arcs that both roads go through."""
    rate = motion.state_index(f"d{motion.system.walker.shape[0]}")
    kinds = {"positions": (slice(0, rate), "-"), "velocities": (slice(rate, None), ":")}
    entries = []
    for words, (columns, line) in kinds.items():
        for times, gap in differences(motion.step, walked):
            size = np.maximum(np.abs(gap[:, columns]).max(axis=1), ROUNDING)
            axes.semilogy(times, size, color=NEUTRAL, linestyle=line, linewidth=1.1)
        entries.append(entry(f"difference, {words}", linestyle=line, linewidth=1.1))
    axes.set_xlabel(str(label("time")))
    axes.set_ylabel("|NLP − simulation|\n[rad, m; per s]")
    return entries


def _at(arc: Arc, fractions: Array) -> Array:
    return np.asarray(chebyshev.chebval(fractions, curves.coefficients(arc.states)).T, dtype=np.float64)


def _points(step: Step) -> tuple[Array, Array]:
    return np.concatenate([arc.times for arc in step.arcs]), np.vstack([arc.states for arc in step.arcs])
