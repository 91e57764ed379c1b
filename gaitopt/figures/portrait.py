"""Phase portraits: every shape coordinate against its rate over one cycle, as in Figs 2, 6 and 8 of the paper."""

from collections.abc import Sequence
from itertools import cycle, pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gaitopt.arrays import Array
from gaitopt.figures.labels import symbol
from gaitopt.figures.motion import Motion, position_label, smooth
from gaitopt.figures.style import COLOURS, JUMP, dashes, entry, legend_below, mode_legend, panels
from gaitopt.gait import Step

VISIBLE = 1e-6
"""Jump of a state [rad, m; per s] that is none of rounding."""


def phase_portrait(motions: Sequence[Motion]) -> Figure:
    """Angles [rad] against rates [rad/s] of all motions in one plane; a dot marks the state just after the impact."""
    figure, (axes,) = panels(height=4.6)
    colours = cycle(COLOURS)
    handles: list[Line2D] = []
    for motion in motions:
        for name in motion.walker.shape:
            prefix = f"{motion.name}: " if len(motions) > 1 else ""
            colour = next(colours)
            handles.append(entry(f"{prefix}{symbol(name)}", color=colour))
            _draw(axes, motion, name, colour)
    lengths = any(motion.walker.lengths for motion in motions)
    axes.set_xlabel(position_label(motions))
    axes.set_ylabel("rate [rad/s, m/s]" if lengths else "angular rate [rad/s]")
    modes = [mode for motion in motions for mode in motion.modes]
    after = entry("just after the impact", marker="o", linestyle="", markersize=5)
    locks = any(_leaps(step) for motion in motions for step in motion.steps)
    jump = entry("impact, or a stop locks" if locks else "impact", **JUMP)
    legend_below(figure, [*handles, *mode_legend(modes), jump, after])
    return figure


def _draw(axes: Axes, motion: Motion, name: str, colour: str) -> None:
    angle, rate = motion.state_index(name), motion.state_index(f"d{name}")
    for _, arc in smooth(motion.steps):
        axes.plot(arc.states[:, angle], arc.states[:, rate], color=colour, linestyle=dashes(arc.mode))
    for before, after in (pair for step in motion.steps for pair in _leaps(step)):
        axes.plot([before[angle], after[angle]], [before[rate], after[rate]], color=colour, **JUMP)
    axes.plot(*motion.steps[0].arcs[0].states[0, [angle, rate]], "o", color=colour, markersize=5)
    for step, following in zip(motion.steps, (*motion.steps[1:], *motion.steps[: motion.periodic]), strict=False):
        last, first = step.arcs[-1].states[-1], following.arcs[0].states[0]
        angles, rates = (last[angle], last[angle], first[angle]), (last[rate], first[rate], first[rate])
        axes.plot(angles, rates, color=colour, **JUMP)  # first the rate jumps, then the angle
        axes.plot(first[angle], first[rate], "o", color=colour, markersize=5)


def _leaps(step: Step) -> list[tuple[Array, Array]]:
    """States before and after every jump within a step, as where a stop locks."""
    ends = [(before.states[-1], after.states[0]) for before, after in pairwise(step.arcs)]
    return [(before, after) for before, after in ends if np.abs(after - before).max() > VISIBLE]
