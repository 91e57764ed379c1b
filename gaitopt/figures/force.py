"""What the ground does: force ratio, foot slip and torques over one step, as in Figs 3, 7 and 10 of the paper.

sigma = f_t / f_n,      |sigma| <= mu        the friction cone; a sticking impact needs |F_t| / F_n <= mu too
"""

from collections.abc import Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from gaitopt.figures.labels import symbol
from gaitopt.figures.motion import Motion, running, smooth, time_label
from gaitopt.figures.style import (
    COLOURS,
    MODE_COLOURS,
    MODE_WORDS,
    NEUTRAL,
    dashes,
    entry,
    legend_below,
    mode_legend,
    panels,
)
from gaitopt.gait.measures import friction_ratio

OUTSIDE = "#f1ece4"
"""Colour of what friction cannot provide."""
CONE_ROOM = 1.35
"""Height of the axes over the largest ratio that is drawn."""


def force_ratio(motions: Sequence[Motion], against: str = "time") -> Figure:
    """Force ratio over time or over a shape coordinate, the impulse ratio of eq. (9) as a cross at its end.

    Of walkers that fly the normal force is drawn below.

    Parameters
    ----------
    against : ``time``, or the name of a shape coordinate.
    """
    flying = against == "time" and any(motion.walker.flies for motion in motions)
    figure, (axes, *normal) = panels(2, heights=[3, 2], height=5.4) if flying else panels()
    handles: list[Line2D | Patch] = []
    for motion, colour in zip(motions, cycle(COLOURS), strict=False):
        handles.append(entry(motion.name, color=colour))
        _draw_ratio(axes, motion, against, colour)
        for below in normal:
            _draw_normal_force(below, motion, colour)
    figure.axes[-1].set_xlabel(time_label(motions) if against == "time" else f"angle {symbol(against)} [rad]")
    axes.set_ylabel("force ratio σ = $f_t/f_n$")
    handles.extend(_cones(axes, motions))
    modes = [mode for motion in motions for mode in motion.modes]
    crosses = [line for line in axes.lines if line.get_marker() == "x"][:1]
    words = [entry("impulse ratio to stick", marker="x", linestyle="", markeredgewidth=1.8) for _ in crosses]
    legend_below(figure, [*handles, *mode_legend(modes), *words])
    return figure


def foot_slip(motions: Sequence[Motion]) -> Figure:
    """Where the stance foot has slipped to, downhill positive, over one cycle [mm]."""
    figure, (axes,) = panels(height=3.4)
    handles = []
    for motion, colour in zip(motions, cycle(COLOURS), strict=False):
        handles.append(entry(motion.name, color=colour))
        x = motion.state_index("x")
        for began, arc in smooth(motion.steps):
            if not arc.mode.flies:
                axes.plot(began + arc.times, 1000 * arc.states[:, x], color=colour, linestyle=dashes(arc.mode))
    axes.axhline(0, color="#808080", linewidth=0.8)
    axes.set_xlabel(time_label(motions))
    axes.set_ylabel("slip of the stance foot x [mm]")
    modes = [mode for motion in motions for mode in motion.modes]
    legend_below(figure, [*handles, *mode_legend(modes)])
    return figure


def torques(motions: Sequence[Motion]) -> Figure:
    """Torque of every actuator over one cycle [N m]; the strip on top says what the foot does."""
    figure, (strip, axes) = panels(2, heights=[len(motions), 14])
    colours = cycle(COLOURS)
    handles: list[Line2D | Patch] = []
    for motion in motions:
        for k, name in enumerate(motion.walker.actuators):
            prefix = f"{motion.name}: " if len(motions) > 1 else ""
            colour = next(colours)
            handles.append(entry(f"{prefix}{name}", color=colour))
            for began, arc in smooth(motion.steps):
                axes.plot(began + arc.times, motion.observe(arc).torque[:, k], color=colour)
    axes.set_xlabel(time_label(motions))
    axes.set_ylabel("torque [N m]")
    legend_below(figure, [*handles, *mode_strip(strip, motions)])
    return figure


def mode_strip(axes: Axes, motions: Sequence[Motion]) -> list[Patch]:
    """Draw the modes over time as coloured bars, one row for each motion; returns the legend's entries."""
    for row, motion in enumerate(motions):
        for began, step in running(motion.steps):
            for arc in step.arcs:
                axes.barh(row, arc.duration, left=began + arc.start, height=0.8, color=MODE_COLOURS[arc.mode.contact])
    named = len(motions) > 1
    axes.set_yticks(range(len(motions)) if named else [], [motion.name for motion in motions] if named else [])
    axes.tick_params(length=0, labelbottom=False)
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.invert_yaxis()
    present = {mode.contact for motion in motions for mode in motion.modes}
    return [Patch(color=MODE_COLOURS[mode], label=MODE_WORDS[mode]) for mode in MODE_COLOURS if mode in present]


def _draw_ratio(axes: Axes, motion: Motion, against: str, colour: str) -> None:
    ends = []
    for began, arc in smooth(motion.steps):
        force = motion.observe(arc).force
        where = began + arc.times if against == "time" else arc.states[:, motion.state_index(against)]
        if not arc.mode.flies:
            axes.plot(where, friction_ratio(force), color=colour, linestyle=dashes(arc.mode))
        ends.append(float(where[-1]))
    last_arcs = np.cumsum([len(step.arcs) for step in motion.steps]) - 1
    for step, last in zip(motion.steps, last_arcs, strict=True):
        if step.impact is None or step.impact.impulse_ratio is None:
            continue
        tangential, normal = step.impact.stick_impulse
        axes.plot(ends[last], tangential / normal, "x", color=colour, markeredgewidth=1.8, markersize=7, clip_on=False)


def _draw_normal_force(axes: Axes, motion: Motion, colour: str) -> None:
    """Normal force over time, in units of the weight."""
    weight = float(motion.dynamics.system.weight(motion.dynamics.p))
    for began, arc in smooth(motion.steps):
        force = motion.observe(arc).force[:, 1] / weight
        axes.plot(began + arc.times, force, color=colour, linestyle=dashes(arc.mode))
    axes.set_ylabel("normal force / weight\n$f_n/(m g)$")


def _cones(axes: Axes, motions: Sequence[Motion]) -> list[Line2D | Patch]:
    """Edges of the friction cone, shaded beyond where there is just one; returns the legend's entries."""
    own = [round(motion.dynamics.static_friction, 12) for motion in motions]
    frictions = sorted(set(own))
    reach = max(float(np.abs(axes.dataLim.intervaly).max()) * 1.1, min(frictions) * CONE_ROOM)
    entries: list[Line2D | Patch] = []
    for friction in frictions:
        if friction > reach * CONE_ROOM:
            continue  # a cone so wide would squeeze the curve into a line
        reach = max(reach, 1.1 * friction)
        colours = [colour for colour, value in zip(cycle(COLOURS), own, strict=False) if value == friction]
        colour = colours[0] if len(frictions) > 1 else NEUTRAL
        for side in (-friction, friction):
            axes.axhline(side, color=colour, linewidth=0.9, zorder=1.5, linestyle="-.")
        entries.append(entry(f"cone ±μ = ±{friction:g}", color=colour, linewidth=0.9, linestyle="-."))
    axes.set_ylim(-reach, reach)
    if len(frictions) == 1 and entries:
        for low, high in ((-reach, -frictions[0]), (frictions[0], reach)):
            axes.axhspan(low, high, color=OUTSIDE, zorder=-1, linewidth=0)
        entries.append(Patch(color=OUTSIDE, label="beyond friction"))
    return entries
