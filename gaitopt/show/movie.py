"""The moving walker as a GIF or an MP4, in real time, where the picture follows the walker; and as some postures.

A gait is shown over one cycle, which repeats without a jump: the marks on the ground are apart by a part of its length.
A GIF plays it for ever; an MP4, which players show once, contains several cycles.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import ceil, cos, degrees, sin
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import fill

import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke

from gaitopt.arrays import Array
from gaitopt.errors import UnknownNameError
from gaitopt.gait import curves
from gaitopt.show.film import Skeleton, contacts_words, skeleton, slope
from gaitopt.show.motion import Motion, with_start_times
from gaitopt.show.style import COLOURS, NEUTRAL, figure_style, panels

MOVIES = ("gif", "mp4")
"""Formats of a movie."""
RATE = 25
"""Pictures per second; a GIF counts hundredths of a second, of which this is four."""
DPI, HEIGHT = 100, 4.0
"""Resolution [dots per inch] and height [inch] of a picture."""
SHOWN = 5.0
"""Least duration of the MP4 of a gait [s]."""
MARKS = 6
"""Marks on the ground per step."""
POSTURES, ROUNDING = 6, 1e-9
"""Number of postures of a figure; the last is so much before the end, relative to the whole time."""
ROW, NARROWEST, WORDS = 2.6, 0.35, 14
"""Height of a row of postures [inch], least room of one relative to its height, and letters in a line below it."""
ROOM = 0.15
"""Room on all sides of the walker, relative to its height or breadth."""
LARGEST_DISC = 0.07
"""Radius of a disc with the whole mass, relative to the height; its area is the share of the mass."""


def movie(motion: Motion, extension: str) -> bytes:
    """The file of a movie.

    Parameters
    ----------
    extension : of ``MOVIES``.

    Raises
    ------
    UnknownNameError
        If there is no program that writes it.
    """
    if extension == "mp4" and not FFMpegWriter.isAvailable():
        words = "an MP4 is written by the program ffmpeg, which is not on the PATH"
        raise UnknownNameError(f"{words}: install ffmpeg, or write a GIF or a page (.gif, .html)")
    count = max(ceil(motion.period * RATE), 2)
    frames = list(_frames(motion, np.arange(count) * motion.period / count))  # the last is one before the first
    heights = np.concatenate([drawing.points[:, :, 1].ravel() for _, drawing, _, _ in frames])
    length = sum(step.impact.step_length for step in motion.steps if step.impact is not None)
    figure, (axes,) = panels(height=HEIGHT)
    across = [drawing.points[:, :, 0] + origin - place for place, drawing, origin, _ in frames]
    breadth = 2 * max(float(np.abs(x).max()) for x in across)  # the walker stays in the picture, which follows it
    size = (1 + 2 * ROOM) * max(float(np.ptp(heights)), breadth * HEIGHT / figure.get_figwidth())
    width = size * figure.get_figwidth() / HEIGHT
    repeats = ceil(SHOWN * RATE / len(frames)) - 1 if motion.periodic else 0
    loop = ["-vf", f"loop={repeats}:{len(frames)}"] if repeats > 0 else []
    writer = PillowWriter(fps=RATE) if extension == "gif" else FFMpegWriter(fps=RATE, extra_args=loop)
    with TemporaryDirectory() as folder, figure_style():
        path = Path(folder) / f"movie.{extension}"
        axes.set_position((0, 0, 1, 1))
        figure.set_layout_engine("none")
        with writer.saving(figure, str(path), DPI):
            for place, drawing, origin, words in frames:
                axes.clear()
                axes.set_axis_off()
                axes.set_aspect("equal")
                low = float(heights.min()) - ROOM * size
                axes.set(xlim=(-width / 2, width / 2), ylim=(low, low + size))
                _draw(axes, motion, drawing, origin - place, HEIGHT)
                spacing = abs(length) / (MARKS * len(motion.steps)) or width / MARKS
                _draw_ground(axes, motion, place, spacing, width)
                axes.text(0.02, 0.03, words, transform=axes.transAxes, color=NEUTRAL)
                writer.grab_frame()
        return path.read_bytes()


def postures(motions: Sequence[Motion]) -> Figure:
    """Draw the outlined walker at equal times from start to end, side by side, above the time and the mode."""
    figure, rows = panels(len(motions), height=ROW * len(motions))
    for motion, axes in zip(motions, rows, strict=True):
        times = np.linspace(0, motion.period * (1 - ROUNDING), POSTURES)
        frames = list(_frames(motion, times))
        points = [_turned(motion, drawing.points[0] + [origin - place, 0]) for place, drawing, origin, _ in frames]
        low, high = np.min([p.min(axis=0) for p in points], axis=0), np.max([p.max(axis=0) for p in points], axis=0)
        spacing = (1 + 2 * ROOM) * max(high[0] - low[0], NARROWEST * (high[1] - low[1]))
        height = figure.get_figwidth() * (high[1] - low[1]) / (POSTURES * spacing)  # of a walker, in inches
        for k, (time, (place, drawing, origin, words)) in enumerate(zip(times, frames, strict=True)):
            _draw(axes, motion, drawing, origin - place + k * spacing, height)
            middle = k * spacing + np.mean([points[k][:, 0].min(), points[k][:, 0].max()])
            x, y = _turned(motion, np.array([middle, 0.0]))
            axes.annotate(
                f"{time:.2f} s\n{fill(words, WORDS)}", (x, y), xytext=(0, -8), textcoords="offset points",
                ha="center", va="top", fontsize="x-small", color=NEUTRAL,
            )  # fmt: skip
        ends = np.array([low[0], (POSTURES - 1) * spacing + high[0]])
        axes.plot(*_turned(motion, np.column_stack([ends, [0, 0]])).T, color=NEUTRAL, linewidth=1, zorder=0)
        axes.set_axis_off()
        axes.set(aspect="equal", title=motion.name if len(motions) > 1 else "")
    return figure


def _frames(motion: Motion, times: Array) -> Iterator[tuple[float, Skeleton, float, str]]:
    """Place of the picture, drawing at one time, place of the stance foot's origin, and words, frame by frame."""
    origin = 0.0
    for began, step in with_start_times(motion.steps):
        length = 0.0 if step.impact is None else step.impact.step_length
        for arc in step.arcs:
            inside = times[(times >= began + arc.start) & (times < began + arc.end)] - began
            if not inside.size:
                continue
            s = 2 * (inside - arc.start) / arc.duration - 1
            states = np.asarray(curves.evaluate(curves.coefficients(arc.states), s))
            drawn = skeleton([replace(arc, times=inside, states=states)])
            for k, time in enumerate(inside):
                here = replace(drawn, points=drawn.points[k : k + 1])
                yield origin + length * float(time) / step.period, here, origin, contacts_words(arc.mode)
        origin += length


def _turned(motion: Motion, points: Array) -> Array:
    """Points in slope coordinates, seen by someone who stands upright; shape (..., 2)."""
    angle = slope(motion)
    return np.asarray(points @ np.array([[cos(angle), -sin(angle)], [sin(angle), cos(angle)]]))


def _draw(axes: Axes, motion: Motion, drawing: Skeleton, shift: float, height: float) -> None:
    """Draw the walker, ``shift`` along the slope [m], for a picture of a height [inch]."""
    points = _turned(motion, drawing.points[0] + [shift, 0.0])
    for number, (a, b) in reversed([*enumerate(drawing.legs)]):
        sides = drawing.sides or ((0, 1) if len(drawing.legs) == 2 else (0,) * len(drawing.legs))
        stands = sides[number] == 0
        colour = COLOURS[0] if stands else NEUTRAL
        width = 1 + height / 2
        outline = [Stroke(linewidth=width + 1.4, foreground=axes.get_facecolor(), capstyle="butt"), Normal()]
        axes.plot(*points[[a, b]].T, color=colour, linewidth=width, solid_capstyle="round", path_effects=outline)
    for a, b in drawing.ties:
        axes.plot(*points[[a, b]].T, color=NEUTRAL, linewidth=1)
    for point, share in drawing.discs:
        size = 2 * 72 * height * LARGEST_DISC * np.sqrt(share)
        axes.plot(*points[point], "o", color=NEUTRAL, markersize=size, clip_on=False)


def _draw_ground(axes: Axes, motion: Motion, place: float, spacing: float, width: float) -> None:
    """The ground with its marks, which stay where they are."""
    ends = _turned(motion, np.array([[-width, 0.0], [width, 0.0]]))
    axes.plot(*ends.T, color="black", linewidth=1)
    first = ceil((place - width) / spacing)
    for number in range(first, first + ceil(2 * width / spacing)):
        x = number * spacing - place
        mark = _turned(motion, np.array([[x, 0.0], [x - 0.02 * width, -0.02 * width]]))
        axes.plot(*mark.T, color="black", linewidth=1)
    words = f"{degrees(slope(motion)):.3g}°"
    if slope(motion):
        axes.text(0.98, 0.97, words, transform=axes.transAxes, va="top", ha="right", color=NEUTRAL)
