"""Draws docs/angles.svg, cone.svg and saltation.svg: ``python docs/drawings.py``, from the root of a clone."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Arc

import gaitopt as go

FOLDER = Path(__file__).parent
STANCE, SWING, FORCE, GREY = "#0072b2", "#d55e00", "#b3246f", "#757575"


def arrow(axes, start, end, colour="black", width=1.6):
    """An arrow between two places."""
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": width, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=style)


def angles():
    """A compass on its slope, with coordinates, angles and their signs."""
    figure = Figure(figsize=(6, 4.6))
    axes = figure.add_axes((0, 0, 1, 1))
    foot, lean, swing = np.zeros(2), np.radians(15), np.radians(27)
    hip = foot + np.array([np.sin(lean), np.cos(lean)])
    tip = hip + np.array([np.sin(swing), -np.cos(swing)]) * 0.97
    axes.plot([-1.05, 1.05], [0, 0], color="black", lw=1.2)
    for k in np.arange(-1.0, 1.05, 0.12):
        axes.plot([k, k - 0.04], [0, -0.04], color="black", lw=0.8)
    axes.plot(*zip(hip, tip, strict=True), color=SWING, lw=4, solid_capstyle="round")
    axes.plot(*zip(foot, hip, strict=True), color=STANCE, lw=4, solid_capstyle="round")
    axes.plot(*hip, "o", color="black", ms=11)
    for base, height in ((foot, 1.12), (hip, -0.62)):
        axes.plot([base[0]] * 2, [base[1], base[1] + height], color=GREY, lw=1, ls="--")
    axes.add_patch(Arc(foot, 1.3, 1.3, theta1=75, theta2=90, color=STANCE, lw=1.5))
    axes.add_patch(Arc(hip, 0.9, 0.9, theta1=270, theta2=297, color=SWING, lw=1.5))
    style = {"fontsize": 14, "ha": "center", "va": "center"}
    axes.text(0.09, 0.72, "θ₁", color=STANCE, **style)
    axes.text(hip[0] + 0.12, hip[1] - 0.54, "θ₂", color=SWING, **style)
    axes.text(-0.12, 0.36, "stance\nleg", color=STANCE, **style)
    axes.text(0.68, 0.42, "swing\nleg", color=SWING, **style)
    axes.text(hip[0] + 0.13, hip[1] + 0.05, "hip", **style)
    axes.text(0, -0.13, "stance foot (x, y)", **style)
    axes.text(0, 1.19, "normal", color=GREY, **style)
    arrow(axes, (0.55, 0.0), (0.95, 0.0))
    axes.text(0.8, -0.13, "x, downhill", **style)
    arrow(axes, (-0.95, 0.0), (-0.95, 0.34))
    axes.text(-0.85, 0.2, "y", **style)
    axes.text(-0.62, 1.02, "θ₁ > 0: the leg\nleans downhill", color=STANCE, **style)
    axes.text(-0.62, 0.7, "θ₂ > 0: the foot is\nahead of the hip", color=SWING, **style)
    axes.set(xlim=(-1.1, 1.1), ylim=(-0.24, 1.28), aspect="equal")
    axes.axis("off")
    return figure


def cone():
    """The force that a foot needs, inside the cone and on its edge."""
    figure = Figure(figsize=(6, 3.0))
    axes = figure.add_axes((0, 0, 1, 1))
    words = ("stick: f inside the cone", "slip forward: f on the edge")
    for place, text, force in ((0.0, words[0], (0.12, 0.85)), (2.4, words[1], (-0.4, 0.8))):
        axes.fill([place, place - 0.5, place + 0.5], [0, 1, 1], color=FORCE, alpha=0.12, lw=0)
        for side in (-0.5, 0.5):
            axes.plot([place, place + side], [0, 1], color=FORCE, lw=1, ls="--")
        axes.plot([place - 0.9, place + 0.9], [0, 0], color="black", lw=1.2)
        arrow(axes, (place, 0), (place + force[0], force[1]), FORCE, 2.5)
        axes.plot(place, 0, "o", color=STANCE, ms=11)
        axes.text(place, -0.24, text, ha="center", va="center", fontsize=14)
        axes.text(
            place + force[0] + (0.14 if place == 0 else -0.12),
            force[1] - 0.02,
            "f",
            fontsize=15,
            color=FORCE,
            ha="center",
        )
    axes.text(0.62, 0.9, "slope μ", fontsize=13, color=FORCE, ha="left", va="center")
    arrow(axes, (2.55, 0.0), (3.15, 0.0), STANCE, 2.5)
    axes.text(2.95, 0.13, "velocity", fontsize=13, color=STANCE, ha="center")
    axes.set(xlim=(-1, 3.4), ylim=(-0.42, 1.1))
    axes.axis("off")
    return figure


def saltation():
    """A motion and a disturbed one at a guard, and how the deviation jumps."""
    figure = Figure(figsize=(6, 3.4))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.plot([2.015, 2.015], [0.35, 2.2], color="black", lw=2.5)
    axes.text(2.015, 2.4, "guard g = 0", ha="center", fontsize=14)
    for shift, colour, lw in ((0.0, STANCE, 3), (0.45, SWING, 2)):
        axes.plot([0.2, 2.0], [0.5 + shift, 1.25 + shift], color=colour, lw=lw)
        axes.plot([2.03, 3.8], [0.75 + 0.25 * shift, 1.1 + 0.25 * shift], color=colour, lw=lw)
        axes.plot([2.0, 2.03], [1.25 + shift, 0.75 + 0.25 * shift], color=colour, lw=1, ls=":")
    arrow(axes, (1.5, 1.04), (1.5, 1.49), GREY)
    arrow(axes, (3.2, 0.98), (3.2, 1.09), GREY)
    axes.text(1.36, 1.27, "δ⁻", fontsize=16, ha="right", va="center")
    axes.text(3.2, 1.32, "δ⁺ = S δ⁻", fontsize=16, ha="center", va="center")
    axes.text(0.3, 1.5, "disturbed motion", fontsize=13, color=SWING, ha="left")
    axes.text(0.95, 0.52, "motion", fontsize=13, color=STANCE, ha="left")
    axes.text(2.25, 0.48, "reset R", fontsize=13, ha="left")
    axes.set(xlim=(0, 4), ylim=(0.3, 2.65))
    axes.axis("off")
    return figure


if __name__ == "__main__":
    with go.figure_style(), mpl.rc_context({"figure.constrained_layout.use": False}):
        for draw in (angles, cone, saltation):
            draw().savefig(FOLDER / f"{draw.__name__}.svg", metadata={"Date": None})
