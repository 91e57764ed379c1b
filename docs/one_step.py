"""Draws docs/one-step.svg: one step of gait A, with the words of the glossary.

Run it from the root of a clone: ``python docs/one_step.py``.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import gaitopt as go
from gaitopt.model.modes import Mode
from gaitopt.show.film import skeleton
from gaitopt.show.motion import motion_of
from gaitopt.show.style import MODE_COLOURS

PICTURE = Path(__file__).parent / "one-step.svg"
SPACING = 1.35
"""Distance between two postures [m]; the real step is 0.45 m."""
STANCE, SWING = "#0072b2", "#8a8a8a"


def postures(gait):
    """Points of the walker at the start, in the middle of each phase, and at the end of the step; with the mode."""
    arcs = motion_of(gait).steps[0].arcs
    lines = [(skeleton([arc]).points, Mode(arc.mode)) for arc in arcs]
    first, last = lines[0][0][0], lines[-1][0][-1]
    return [(first, None), *((points[len(points) // 2], mode) for points, mode in lines), (last, None)]


def picture(gait):
    """The figure: five postures side by side."""
    figure = Figure(figsize=(8.0, 4.1))
    axes = figure.subplots()
    words = [
        "section\njust after\nthe impact",
        *(
            f"phase {k}\n{mode.replace('_', ' ')}\n{duration:.3f} s"
            for k, (mode, duration) in enumerate(gait.phases, 1)
        ),
        "guard\nthe swing foot\ntouches down",
    ]
    for k, ((points, mode), text) in enumerate(zip(postures(gait), words, strict=True)):
        foot, swing, hip = (points[j] + [k * SPACING, 0] for j in (0, 1, 3))
        axes.plot(*np.column_stack([hip, swing]), color=SWING, lw=2.5, solid_capstyle="round")
        axes.plot(*np.column_stack([foot, hip]), color=STANCE, lw=3.5, solid_capstyle="round")
        axes.plot(*hip, "o", color="black", ms=9)
        axes.plot([k * SPACING - 0.55, k * SPACING + 0.55], [0, 0], color="black", lw=1)
        axes.text(hip[0], -0.34, text, ha="center", va="top", fontsize=12)
        if mode is not None:
            axes.plot(*foot, "o", color=MODE_COLOURS[mode], ms=10, mec="black", mew=0.8)
            direction = {Mode.SLIP_FORWARD: 1, Mode.SLIP_BACKWARD: -1}.get(mode)
            if direction:
                axes.annotate(
                    "", (foot[0] + 0.32 * direction, -0.14), (foot[0] - 0.1 * direction, -0.14),
                    arrowprops={"arrowstyle": "-|>", "color": MODE_COLOURS[mode], "lw": 2.5},
                )  # fmt: skip
        if k == 0:
            axes.text(foot[0] + 0.08, 0.7, "stance\nleg", color=STANCE, fontsize=12)
            axes.text(swing[0] + 0.02, 0.7, "swing\nleg", color=SWING, fontsize=12, ha="right")
    axes.annotate(
        "", (-0.3, 1.85), (4 * SPACING + 0.3, 1.85),
        arrowprops={"arrowstyle": "-|>", "color": "black", "lw": 1.2, "connectionstyle": "arc3,rad=0.06"},
    )  # fmt: skip
    axes.text(2 * SPACING, 2.12, "reset: impact, then the feet swap roles", ha="center", va="bottom", fontsize=12)
    axes.set(xlim=(-0.75, 4 * SPACING + 0.75), ylim=(-1.15, 2.45), aspect="equal")
    axes.axis("off")
    return figure


if __name__ == "__main__":
    with go.figure_style():
        picture(go.solve(go.load_problem("compass-passive-a"))).savefig(PICTURE, metadata={"Date": None})
