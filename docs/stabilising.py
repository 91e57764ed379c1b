"""Draws docs/stabilising.png: torques of an optimum and of the law that walks it, and where its gait is stable.

Run it from the root of a clone: ``python docs/stabilising.py``.
"""

from pathlib import Path

from matplotlib.figure import Figure

import gaitopt as go
from gaitopt.show.style import MODE_COLOURS

HERE = Path(__file__).parent
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
SLOWEST = 0.1
"""Friction to which the family is followed."""


def draw_torques(axes, optimum, walked):
    """Torque of every motor versus time: dashed for the optimum, solid under the law."""
    for colour, motor in zip(COLOURS, optimum.system.walker.actuators, strict=True):
        for gait, style in ((optimum, "--"), (walked, "-")):
            table = gait.to_frame()
            axes.plot(table["t"], table[motor], style, color=colour, lw=1.6 if style == "-" else 1.1)
        axes.plot([], [], color=colour, label=motor.replace("_", " "))
    axes.plot([], [], "--", color="0.4", label="optimum")
    axes.plot([], [], "-", color="0.4", label="under the law")
    axes.set(xlabel="time since impact [s]", ylabel="torque [N m]")
    axes.legend(ncols=2, loc="upper center")


def draw_family(axes, branch):
    """Spectral radius versus friction, coloured by the modes of the stance foot."""
    for number in sorted({point.branch for point in branch.points}):
        points = [point for point in (*branch.points, *branch.specials) if point.branch == number and point.gait]
        points.sort(key=lambda point: point.value)
        modes = [str(mode) for mode in points[0].gait.problem.cycle.phases]
        label = " > ".join(mode.replace("_", " ") for mode in modes)
        colour = MODE_COLOURS[modes[-1]] if number < 2 else MODE_COLOURS[modes[0]]
        axes.plot([p.value for p in points], [p.gait.spectral_radius for p in points], color=colour, lw=2, label=label)
    for special in branch.specials:
        axes.axvline(special.value, color="0.75", lw=0.8, zorder=0)
    axes.set(xlabel="coefficient of friction", ylabel="spectral radius", ylim=(0.5, 0.7))
    axes.legend(loc="lower right", title="modes of the stance foot")


if __name__ == "__main__":
    optimum = go.solve(HERE / "examples" / "light-robot.yaml")
    walked = go.stabilise(optimum).gait
    branch = go.continuation(walked, "friction", to=SLOWEST)
    with go.figure_style():
        figure = Figure(figsize=(4.8, 6.4), layout="constrained")
        upper, lower = figure.subplots(2)
        draw_torques(upper, optimum, walked)
        draw_family(lower, branch)
        figure.savefig(HERE / "stabilising.png", dpi=200)
