"""Figures of replays: the motion of a gait in other physics engines, drawn over its own motion."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from gaitopt.problem.scalars import state_unit
from gaitopt.show.motion import Motion, smooth, time_label
from gaitopt.show.style import COLOURS, NEUTRAL, dashes, entry, legend_below, mode_legend, panels, symbol

Record = Mapping[str, Any]
ENGINE_DASHES = (0, (1, 1.2))
"""Line style of engines, whose curves coincide with that of the gait."""


def replayed_motion(motion: Motion, replays: Sequence[Record]) -> Figure:
    """Stance foot [mm] and shape coordinates along a gait, and along its replays at the smallest time step."""
    figure, (foot, shape) = panels(2, height=5.2)
    x = motion.dynamics.system.n_shape
    for began, arc in smooth(motion.steps):
        foot.plot(began + arc.times, 1e3 * arc.states[:, x], color=NEUTRAL, linestyle=dashes(arc.mode))
        for k, _ in enumerate(motion.walker.shape):
            shape.plot(began + arc.times, arc.states[:, k], color=NEUTRAL, linestyle=dashes(arc.mode))
    shown = [replay for replay in replays if replay["motion"]]
    for replay, colour in zip(shown, COLOURS * len(shown), strict=False):
        moved = replay["motion"]
        foot.plot(moved["t"], [1e3 * value for value in moved["x"]], color=colour, linestyle=ENGINE_DASHES)
        for name in motion.walker.shape:
            shape.plot(moved["t"], moved[name], color=colour, linestyle=ENGINE_DASHES)
    foot.set_ylabel("stance foot [mm]")
    unit = state_unit(motion.walker.shape[0])
    shape.set(ylabel=f"{', '.join(map(symbol, motion.walker.shape))} [{unit}]", xlabel=time_label([motion]))
    entries = [
        entry(
            f"{replay['engine']}, {replay['setting']}, {1e3 * replay['motion']['dt']:g} ms",
            color=colour,
            linestyle=ENGINE_DASHES,
        )
        for replay, colour in zip(shown, COLOURS * len(shown), strict=False)
    ]
    legend_below(figure, [*mode_legend(motion.modes), *entries])
    return figure
