"""Draws docs/creep.gif: the foot of gait A while it should stick, in MuJoCo, in Drake and exactly.

The motions are those of ``benchmarks/engines/results.json``, with the default settings and a time step of 2 ms. Run it
from the root of a clone: ``python docs/creep.py``.
"""

import json
from pathlib import Path

import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.figure import Figure

import gaitopt as go

ROOT = Path(__file__).parents[1]
START, END, FRAMES, RATE = 0.2, 0.7, 50, 12
SCALE = 1e6
"""Micrometres per metre."""
COLOURS = {"mujoco": "#e69f00", "drake": "#e69f00", "exact": "#4d4d4d"}
NAMES = {"mujoco": "MuJoCo", "drake": "Drake", "exact": "exact"}


def feet():
    """Places of the foot [µm] since the start of the pictures, by engine, at their times."""
    stored = json.loads((ROOT / "benchmarks" / "engines" / "results.json").read_text())["motions"]
    times = np.linspace(START, END, FRAMES)
    places = {}
    for motion in stored:
        if motion["engine"] in NAMES and motion["setting"] == "default" and motion["dt"] == 0.002:
            places[motion["engine"]] = SCALE * np.interp(times, motion["t"], motion["x"])
    return times, {name: x - x[0] for name, x in places.items()} | {"exact": np.zeros(FRAMES)}


def draw(figure, times, places, frame):
    """One picture: a magnified foot for each engine."""
    figure.clear()
    reach = max(np.abs(x).max() for x in places.values())
    for axes, (name, x) in zip(figure.subplots(1, 3), places.items(), strict=True):
        axes.plot([-reach / 3, 1.4 * reach], [0, 0], color="black", lw=1)
        axes.plot([0, x[frame]], [-0.22 * reach] * 2, color="#e69f00", lw=6, solid_capstyle="butt")
        axes.plot([x[frame], x[frame] - 0.16 * reach], [0, 1.2 * reach], color="#0072b2", lw=10, solid_capstyle="round")
        axes.plot(x[frame], 0, "o", color=COLOURS[name], mec="black", ms=13)
        axes.text(0.5 * reach, -0.6 * reach, f"{x[frame]:.0f} µm".replace("-0", "0"), ha="center", fontsize=14)
        axes.set(xlim=(-reach / 3, 1.4 * reach), ylim=(-0.75 * reach, 1.3 * reach), xticks=[], yticks=[])
        axes.set_title(NAMES[name], fontsize=14)
    figure.suptitle(f"{times[frame]:.2f} s after the impact", fontsize=12)


if __name__ == "__main__":
    times, places = feet()
    writer, figure = PillowWriter(fps=RATE), Figure(figsize=(6.4, 2.9), layout="constrained")
    with go.figure_style(), writer.saving(figure, str(ROOT / "docs" / "creep.gif"), 90):
        for frame in range(FRAMES):
            draw(figure, times, places, frame)
            writer.grab_frame()
