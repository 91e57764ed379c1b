"""The two independent methods compared: points of the NLP's gait on the simulated step, and their difference.

Only what a run folder keeps is drawn, so that a gait that has been read back has the same figure.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.polynomial import chebyshev

from gaitopt.arrays import Array
from gaitopt.figures.labels import symbol
from gaitopt.figures.motion import Motion, position_label, running, time_label
from gaitopt.figures.style import COLOURS, NEUTRAL, dashes, entry, legend_below, mode_legend, panels
from gaitopt.gait import Gait, Step, curves
from gaitopt.simulation import Simulator

POINTS_SHOWN = 20
"""Markers of the gait's points; more would hide the curve."""
ROUNDING = 1e-17
"""A difference of exactly zero is drawn here, at the foot of the log axis."""


def simulated(gait: Gait) -> tuple[Step, ...]:
    """The steps that the forward simulator walks from the gait's state, choosing its modes by itself."""
    return Simulator(gait.dynamics).run(gait.state, steps=len(gait.steps), dense=True).steps


def method_comparison(motion: Motion, walked: Sequence[Step]) -> Figure:
    """Angles of a gait found by the NLP over those of the simulated steps, and all states' differences below.

    Parameters
    ----------
    motion : the gait.
    walked : the simulated steps.
    """
    figure, (upper, lower) = panels(2, heights=[3, 2], height=5.4)
    times, states = thinned(*points_of(motion.steps))
    handles: list[Line2D] = []
    for name, colour in zip(positions_of(motion), COLOURS, strict=False):
        column = motion.state_index(name)
        for began, step in running(walked):
            for arc in step.arcs:
                upper.plot(began + arc.times, arc.states[:, column], color=colour, linestyle=dashes(arc.mode))
        upper.plot(times, states[:, column], "o", color=colour, markersize=4, fillstyle="none")
        handles.append(entry(f"{symbol(name)}, simulation", color=colour))
    handles.append(entry("NLP", marker="o", linestyle="", fillstyle="none"))
    upper.set_ylabel(position_label([motion]))
    handles += _differences(lower, motion, walked)
    legend_below(figure, [*handles, *mode_legend([mode for step in walked for mode, _ in step.phases])])
    return figure


def positions_of(motion: Motion) -> tuple[str, ...]:
    """The shape coordinates, and the height of a foot that flies."""
    return tuple(name for name in motion.dynamics.system.state_names if name in (*motion.walker.shape, "y"))


def differences(ours: Sequence[Step], theirs: Sequence[Step]) -> Iterator[tuple[Array, Array]]:
    """Times since the start and differences of the states on each arc, compared at equal fractions of it."""
    pairs = zip(running(ours), theirs, strict=False)
    arcs = ((began, *pair) for (began, step), other in pairs for pair in zip(step.arcs, other.arcs, strict=False))
    for began, mine, other in arcs:
        if mine.mode is not other.mode or mine.duration <= 0:
            return
        fractions = 2 * (mine.times - mine.start) / mine.duration - 1
        states = chebyshev.chebval(fractions, curves.coefficients(other.states)).T
        yield began + mine.times, mine.states - np.asarray(states, dtype=np.float64)


def _differences(axes: Axes, motion: Motion, walked: Sequence[Step]) -> list[Line2D]:
    """Angles' and rates' differences along arcs that both methods have."""
    rate = motion.state_index(f"d{motion.walker.shape[0]}")
    kinds = {"positions": (slice(0, rate), "-"), "velocities": (slice(rate, None), ":")}
    entries = []
    for words, (columns, line) in kinds.items():
        for times, gap in differences(motion.steps, walked):
            size = np.maximum(np.abs(gap[:, columns]).max(axis=1), ROUNDING)
            axes.semilogy(times, size, color=NEUTRAL, linestyle=line, linewidth=1.1)
        entries.append(entry(f"difference, {words}", linestyle=line, linewidth=1.1))
    axes.set_xlabel(time_label([motion]))
    axes.set_ylabel("|NLP − simulation|\n[rad, m; per s]")
    return entries


def points_of(steps: Sequence[Step]) -> tuple[Array, Array]:
    """Times since the start of the first step (n,) and states (n, n_z) at all points of some steps."""
    arcs = [(began, arc) for began, step in running(steps) for arc in step.arcs]
    return np.concatenate([began + arc.times for began, arc in arcs]), np.vstack([arc.states for _, arc in arcs])


def thinned(times: Array, states: Array) -> tuple[Array, Array]:
    """At most twenty of many points, evenly among them, the first and the last with them."""
    shown = np.unique(np.linspace(0, len(times) - 1, min(len(times), POINTS_SHOWN)).round().astype(int))
    return times[shown], states[shown]
