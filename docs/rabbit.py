"""Draws docs/rabbit.png, one step of four gaits of RABBIT, and docs/rabbit.gif, the last of them.

Run it from the root of a clone: ``python docs/rabbit.py``.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import gaitopt as go
from gaitopt.show.film import skeleton
from gaitopt.show.motion import motion_of
from gaitopt.show.style import MODE_COLOURS

PICTURE = Path(__file__).parent / "rabbit.png"
FRAMES = 9
"""Postures of a step, at equal times."""


def draw(axes, gait, title):
    """The step of a gait as postures at equal times; the last one is dark, and the stance leg has its mode's colour."""
    arcs = motion_of(gait).steps[0].arcs
    drawn = [skeleton([arc]) for arc in arcs]
    times = [time for arc in arcs for time in arc.times]
    points = np.vstack([part.points for part in drawn])
    modes = [str(arc.mode) for arc in arcs for _ in arc.times]
    for number, time in enumerate(np.linspace(0, times[-1], FRAMES)):
        k = int(np.argmin(np.abs(np.array(times) - time)))
        shade = 0.25 + 0.75 * number / (FRAMES - 1)
        for one, other in drawn[0].legs:
            axes.plot(*points[k][[one, other]].T, color="black", alpha=shade, lw=1.6, solid_capstyle="round")
        axes.plot(*points[k][0], "o", color=MODE_COLOURS[modes[k]], alpha=shade, ms=5)
    axes.plot(*points[:, 1].T, color="#0072b2", lw=1.2)  # path of the swing foot
    axes.axhline(0, color="black", lw=0.8)
    axes.set(aspect="equal", title=title, xlim=(-0.6, 0.8), ylim=(-0.08, 1.55))
    axes.axis("off")


if __name__ == "__main__":
    optimal, tracked, sticking = (go.solve(f"rabbit-{name}") for name in ("optimal", "tracked", "hzd"))
    branch = go.continuation(go.solve("rabbit-hzd-slip"), "friction", to=0.4)
    shown = (optimal, "rabbit-optimal"), (tracked, "rabbit-tracked"), (sticking, "rabbit-hzd, friction 0.6")
    with go.figure_style():
        figure = Figure(figsize=(6.0, 6.6), layout="constrained")  # readable on a phone
        for axes, (gait, title) in zip(
            figure.subplots(2, 2).flat, (*shown, (branch.points[-1].gait, "rabbit-hzd-slip, friction 0.4")), strict=True
        ):
            draw(axes, gait, title)
        figure.savefig(PICTURE, dpi=110)
    branch.points[-1].gait.animate().save(PICTURE.with_suffix(".gif"))
