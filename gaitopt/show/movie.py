"""The moving walker as a GIF or an MP4, whose picture follows the walker; and as a row of postures.

A gait is shown over an even number of steps, after which both legs have their colours again. It repeats without a jump,
because the distance of the marks on the ground divides a cycle's length. A step shorter than a second is shown in slow
motion. A GIF plays for ever; an MP4, which players show once, contains several repetitions. If a foot slips, a
magnifier shows it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from math import ceil, cos, degrees, sin
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from PIL import Image

from gaitopt.arrays import Array
from gaitopt.errors import UnknownNameError
from gaitopt.gait import curves
from gaitopt.gait.measures import observe
from gaitopt.gait.trajectory import Arc
from gaitopt.model.contacts import undetermined
from gaitopt.model.modes import Mode
from gaitopt.show.film import FAR, Skeleton, describe_contacts, ground_tiles, magnifier, rise, skeleton, slope
from gaitopt.show.motion import Motion
from gaitopt.show.style import COLOURS, MODE_COLOURS, NEUTRAL, figure_style, panels

MOVIES = ("gif", "mp4")
"""Formats of a movie."""
RATE = 25
"""Pictures per second. The time between them is four of the hundredths of a second in which a GIF counts."""
DPI, HEIGHT = 80, 4.0
"""Resolution [dots per inch] and height [inch] of a picture."""
SHOWN_STEP = 1.0
"""Smallest duration of a step on the screen [s]."""
SLOWER = (1, 2, 4, 10, 20)
"""Factors of slow motion."""
LENS_SIDE = 0.36
"""Side of the magnifier, relative to the picture."""
TRACE_HEIGHTS = {Mode.SLIP_FORWARD: -0.07, Mode.SLIP_BACKWARD: -0.13}
"""Heights of the traces of slips in the magnifier, relative to its side."""
RIM_WIDTH = 5.0
"""Width of the coloured rim of the magnifier [points]."""
LENS_GROUND, LENS_WEIGHT = 0.28, 0.5
"""Height of the ground in the magnifier, and length of the arrow of the weight, relative to its side."""
LENS_LEGS = 14.0
"""The legs in the magnifier are drawn as in a picture of this height [inch]."""
SCALE_BARS = (0.5, 1, 2, 5, 10, 20, 50, 100)
"""Lengths of the magnifier's scale [mm]."""
PALETTE, SAMPLED_PICTURES = 64, 8
"""Number of colours of a GIF, and of the pictures from which they are chosen."""
SHORTEST_MP4 = 5.0
"""Smallest duration of the MP4 of a gait [s]."""
ICY, STICKY = "#56b4e9", "#b07a3c"
"""Tints of tiles with less and with more than the nominal friction."""
TINT, FAINTEST = 0.025, 0.15
"""Depth of the tint of a tile, relative to the picture, and its opacity where the friction is nearly nominal."""
MARKS = 6
"""Number of marks on the ground per step."""
FORCE_COLOUR = "#b3246f"
"""Colour of the contact force, as on pages."""
ON_THE_SPOT = 1e-6
"""Length of a cycle below which the walker stays where it is, relative to the picture."""
SHORTEST_ARC = 1e-12
"""Divisor that replaces the duration of an arc of zero length; every arc with a picture lasts longer [s]."""
POSTURES = 6
"""Number of postures of a figure."""
LAST_POSTURE = 1e-9
"""Time from the last posture to the end of the motion, relative to its duration: at the end itself, the next step
begins."""
ROW_HEIGHT, NARROWEST = 2.6, 0.35
"""Height of a row of postures [inch], and smallest width of a posture relative to its height."""
CAPTION_CHARACTERS = 14
"""Number of characters in a line below a posture."""
ROOM = 0.15
"""Room on all sides of the walker, relative to its height or breadth."""
LARGEST_DISC = 0.07
"""Radius of a disc with the whole mass, relative to the height. The area of a disc is in proportion to its mass."""


def movie(motion: Motion, extension: str) -> bytes:
    """The bytes of a movie as a file.

    Parameters
    ----------
    extension : one of ``MOVIES``.

    Raises
    ------
    UnknownNameError
        If the program that writes it is not installed.
    """
    if extension == "mp4" and not FFMpegWriter.isAvailable():
        reason = "an MP4 is written by the program ffmpeg, which is not on the PATH"
        raise UnknownNameError(f"{reason}: install ffmpeg, or write a GIF or a page (.gif, .html)")
    cycles, slower = playing(motion)
    shown = cycles * motion.period
    count = max(ceil(shown * slower * RATE), 2)
    frames = list(_frames(motion, np.arange(count) * shown / count))  # the next one would be the first again
    heights = np.concatenate([frame.points[:, 1] - frame.lift for frame in frames])
    length = sum(step.impact.step_length for step in motion.steps if step.impact is not None)
    figure, (axes,) = panels(height=HEIGHT)
    across = [frame.points[:, 0] - frame.camera for frame in frames]
    breadth = 2 * max(float(np.abs(x).max()) for x in across)  # the picture follows the walker and contains all of it
    size = (1 + 2 * ROOM) * max(float(np.ptp(heights)), breadth * HEIGHT / figure.get_figwidth())
    width = size * figure.get_figwidth() / HEIGHT
    repeats = ceil(SHORTEST_MP4 * RATE / len(frames)) - 1 if motion.periodic else 0
    loop = ["-vf", f"loop={repeats}:{len(frames)}"] if repeats > 0 else []
    writer = _Gif(fps=RATE) if extension == "gif" else FFMpegWriter(fps=RATE, extra_args=loop)
    magnification, traces = magnifier(motion)[0], list[_Trace]()
    with TemporaryDirectory() as folder, figure_style():
        path = Path(folder) / f"movie.{extension}"
        axes.set_position((0, 0, 1, 1))
        figure.set_layout_engine("none")
        side = LENS_SIDE * HEIGHT / figure.get_figwidth()
        lens = figure.add_axes((0.015, 0.98 - LENS_SIDE, side, LENS_SIDE)) if magnification else None
        with writer.saving(figure, str(path), DPI):
            for frame in frames:
                axes.clear()
                axes.set_axis_off()
                axes.set_aspect("equal")
                low = float(heights.min()) - ROOM * size
                axes.set(xlim=(-width / 2, width / 2), ylim=(low, low + size))
                _draw(axes, motion, frame, (-frame.camera, -frame.lift), HEIGHT)
                stride = abs(length) if abs(length) > ON_THE_SPOT * width else width  # rounding of a hop on the spot
                spacing = stride / (MARKS * len(motion.steps))
                _draw_ground(axes, motion, (frame.camera, frame.lift), spacing, width)
                axes.text(0.02, 0.03, frame.caption, transform=axes.transAxes, color=NEUTRAL)
                if slower > 1:
                    caption = f"{slower} times slower"
                    axes.text(0.98, 0.03, caption, transform=axes.transAxes, ha="right", color=NEUTRAL)
                if lens is not None:
                    _magnify(lens, motion, frame, LENS_SIDE * size / magnification, traces)
                    lens.text(0.05, 0.95, f"×{magnification}", transform=lens.transAxes, va="top")
                writer.grab_frame()
        return path.read_bytes()


class _Gif(PillowWriter):
    """A GIF with few colours, which are the same in all pictures; only the changes between pictures are stored."""

    def setup(self, fig: Figure, outfile: Any, dpi: float | None = None) -> None:
        """Begin without pictures."""
        super().setup(fig, outfile, dpi)
        self.pictures: list[Image.Image] = []

    def grab_frame(self, **_: Any) -> None:
        """Add a picture."""
        content = BytesIO()
        self.fig.savefig(content, format="rgba", dpi=self.dpi)
        self.pictures.append(
            Image.frombuffer("RGBA", self.frame_size, content.getvalue(), "raw", "RGBA", 0, 1).convert("RGB")
        )

    def finish(self) -> None:
        """Write the file."""
        if not self.pictures:  # what went wrong before the first picture is raised by the writer
            return
        strips = np.hstack(
            [np.asarray(one) for one in self.pictures[:: max(1, len(self.pictures) // SAMPLED_PICTURES)]]
        )
        palette = Image.fromarray(strips).quantize(PALETTE, dither=Image.Dither.NONE)
        first, *rest = (one.quantize(palette=palette, dither=Image.Dither.NONE) for one in self.pictures)
        first.save(self.outfile, save_all=True, append_images=rest, duration=round(1000 / RATE), loop=0, optimize=False)


def playing(motion: Motion) -> tuple[int, int]:
    """Number of cycles of a gait that are shown, and the factor by which they are slower than in reality."""
    steps = len(motion.steps)
    if not motion.periodic:
        return 1, 1
    shortest = motion.period / steps
    slower = next((factor for factor in SLOWER if factor * shortest >= SHOWN_STEP), SLOWER[-1])
    return 1 + steps % 2, slower


_Trace = tuple[int, int, Mode, list[float]]
"""The trace of a slip under the magnifier: numbers of its arc and its contact, its mode, and x of its points [m]."""


def _magnify(lens: Axes, motion: Motion, frame: "_Frame", width: float, traces: list[_Trace]) -> None:
    """Draw the foot that slips in a picture of this width [m], with its trace, and its force in its cone."""
    lens.clear()
    lens.set(xticks=[], yticks=[], aspect="equal")
    lens.set(xlim=(-width / 2, width / 2), ylim=(-LENS_GROUND * width, (1 - LENS_GROUND) * width))
    lens.set_facecolor("white")
    mode = (
        None
        if frame.closeup is None
        else Mode(frame.arc.mode.contacts[motion.walker.contact_names()[frame.closeup[0]]])
    )
    for spine in lens.spines.values():
        spine.set(visible=True, color=MODE_COLOURS[mode] if mode and mode.slips else NEUTRAL)
        spine.set_linewidth(RIM_WIDTH if mode and mode.slips else 1.0)
    if frame.closeup is None or mode is None:
        return
    contact, middle = frame.closeup
    name = motion.walker.contact_names()[contact]
    foot = frame.points[frame.drawing.marks[contact]]
    base = float(foot[1]) if motion.floor else 0.0
    _draw(lens, motion, frame, (-middle, -base), LENS_LEGS)
    _draw_ground(lens, motion, (middle, base), width / MARKS, width, slopes=False)
    if mode.slips:
        if not traces or traces[-1][:3] != (frame.number, contact, mode):
            traces.append((frame.number, contact, mode, []))
        traces[-1][3].append(foot[0])
    for _, _, kind, xs in traces:
        ends = np.array([[x - middle, TRACE_HEIGHTS[kind] * width] for x in (xs[0], xs[-1])])
        lens.plot(*_turned(motion, ends).T, color=MODE_COLOURS[kind], linewidth=4, solid_capstyle="butt")
    foot = foot - [middle, base]
    lens.plot(*_turned(motion, foot), "o", color=MODE_COLOURS[mode], markeredgecolor="black", markersize=8, zorder=4)
    if name not in undetermined(motion.walker, frame.arc.mode):
        force = observe(frame.arc).force[0, 2 * contact : 2 * contact + 2]
        arrow = force * LENS_WEIGHT * width / float(motion.dynamics.system.weight(motion.dynamics.p))
        friction, *_ = motion.dynamics.system.contact_coefficients(motion.dynamics.p)[name]
        tall = min(1.0, 0.5 / float(friction)) * LENS_WEIGHT * width
        cone = foot + np.array([[float(friction) * tall, tall], [0, 0], [-float(friction) * tall, tall]])
        lens.fill(*_turned(motion, cone).T, color=FORCE_COLOUR, alpha=0.15, linewidth=0, zorder=3)
        lens.annotate(
            "", tuple(_turned(motion, foot + arrow)), tuple(_turned(motion, foot)), zorder=5,
            arrowprops={"arrowstyle": "-|>", "color": FORCE_COLOUR, "linewidth": 2, "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
    bar = next((one for one in SCALE_BARS if 1e-3 * one > 0.15 * width), SCALE_BARS[-1])
    ends = np.array([0.45 * width - 1e-3 * bar, 0.45 * width])
    lens.plot(ends, [(0.92 - LENS_GROUND) * width] * 2, color="black", linewidth=1.5)
    lens.annotate(
        f"{bar:g} mm", (ends[0], (0.92 - LENS_GROUND) * width), xytext=(-4, 0), textcoords="offset points",
        ha="right", va="center", fontsize="small",
    )  # fmt: skip


def postures(motions: Sequence[Motion]) -> Figure:
    """Draw the outlined walker at equal times from start to end, side by side, above the time and the mode."""
    figure, rows = panels(len(motions), height=ROW_HEIGHT * len(motions))
    for motion, axes in zip(motions, rows, strict=True):
        times = np.linspace(0, motion.period * (1 - LAST_POSTURE), POSTURES)
        frames = list(_frames(motion, times))
        points = [_turned(motion, frame.points - [frame.camera, 0]) for frame in frames]
        low, high = np.min([p.min(axis=0) for p in points], axis=0), np.max([p.max(axis=0) for p in points], axis=0)
        spacing = (1 + 2 * ROOM) * max(high[0] - low[0], NARROWEST * (high[1] - low[1]))
        height = figure.get_figwidth() * (high[1] - low[1]) / (POSTURES * spacing)  # of a walker, in inches
        for k, (time, frame) in enumerate(zip(times, frames, strict=True)):
            _draw(axes, motion, frame, (k * spacing - frame.camera, -frame.lift), height)
            middle = k * spacing + np.mean([points[k][:, 0].min(), points[k][:, 0].max()])
            x, y = _turned(motion, np.array([middle, 0.0]))
            axes.annotate(
                f"{time:.2f} s\n{fill(frame.caption, CAPTION_CHARACTERS)}", (x, y), xytext=(0, -8),
                textcoords="offset points", ha="center", va="top", fontsize="x-small", color=NEUTRAL,
            )  # fmt: skip
        ends = np.array([low[0], (POSTURES - 1) * spacing + high[0]])
        axes.plot(*_turned(motion, np.column_stack([ends, [0, 0]])).T, color=NEUTRAL, linewidth=1, zorder=0)
        axes.set_axis_off()
        axes.set(aspect="equal", title=motion.name if len(motions) > 1 else "")
    return figure


@dataclass(frozen=True, slots=True, kw_only=True)
class _Frame:
    """The walker at one time.

    Attributes
    ----------
    points : ndarray, shape (n, 2) - positions [m], x from the stance foot at the start.
    drawing : its lines and discs.
    camera, lift : x in the middle of the picture and height of the ground there, which move evenly from one impact to
        the next [m].
    number : number of the arc since the start.
    step : number of the step since the start; legs change their roles with every step.
    arc : the arc, at this time only.
    closeup : number of the contact that is magnified, and x in the middle of its trace [m].
    """

    points: Array
    drawing: Skeleton
    camera: float
    lift: float
    number: int
    step: int
    arc: Arc
    closeup: tuple[int, float] | None

    @property
    def caption(self) -> str:
        """A text with the mode of every contact."""
        return describe_contacts(self.arc.mode)


def _frames(motion: Motion, times: Array) -> Iterator[_Frame]:
    """The walker at increasing times, which may go beyond the first cycle of a gait."""
    _, closeups = magnifier(motion)
    origin, began, number, steps = 0.0, 0.0, 0, 0
    while began <= times[-1] and (motion.periodic or not number):
        for step in motion.steps:
            length = 0.0 if step.impact is None else step.impact.step_length
            low, high = rise(motion, steps), rise(motion, steps if step.impact is None else steps + 1)
            for arc in step.arcs:
                inside = times[(times >= began + arc.start) & (times < began + arc.end)] - began
                closeup = closeups[number % len(closeups)]
                if closeup is not None:
                    before = motion.steps[: steps % len(motion.steps)]
                    travelled = origin - sum(one.impact.step_length for one in before if one.impact is not None)
                    closeup = closeup[0], closeup[1] + travelled
                s = 2 * (inside - arc.start) / max(arc.duration, SHORTEST_ARC) - 1
                states = np.asarray(curves.evaluate(curves.coefficients(arc.states), s)) if inside.size else inside
                drawn = skeleton([replace(arc, times=inside, states=states)]) if inside.size else None
                for k, time in enumerate(inside):
                    assert drawn is not None, "times within an arc"
                    yield _Frame(
                        points=drawn.points[k] + [origin, low], drawing=drawn, number=number, step=steps,
                        camera=origin + length * float(time) / step.period, closeup=closeup,
                        lift=low + (high - low) * float(time) / step.period,
                        arc=replace(arc, times=inside[k : k + 1], states=states[k : k + 1]),
                    )  # fmt: skip
                number += 1
            origin, began, steps = origin + length, began + step.period, steps + 1


def _turned(motion: Motion, points: Array) -> Array:
    """Points in slope coordinates, seen by someone who stands upright; shape (..., 2)."""
    angle = slope(motion)
    return np.asarray(points @ np.array([[cos(angle), -sin(angle)], [sin(angle), cos(angle)]]))


def _draw(axes: Axes, motion: Motion, frame: _Frame, shift: tuple[float, float], height: float) -> None:
    """Draw the walker, moved by ``shift`` along the slope and normal to it [m], for a picture of a height [inch].

    A leg keeps its colour when the legs change their roles.
    """
    drawing, points = frame.drawing, _turned(motion, np.add(frame.points, shift))
    for number, (a, b) in reversed([*enumerate(drawing.legs)]):
        sides = drawing.sides or ((0, 1) if len(drawing.legs) == 2 else (0,) * len(drawing.legs))
        side = sides[number]
        exchanged = frame.step % 2 if drawing.sides or len(drawing.legs) == 2 else 0
        colour = NEUTRAL if side is None else COLOURS[(side + exchanged) % 2]
        width = 1 + height / 2
        outline = [Stroke(linewidth=width + 1.4, foreground=axes.get_facecolor(), capstyle="butt"), Normal()]
        axes.plot(*points[[a, b]].T, color=colour, linewidth=width, solid_capstyle="round", path_effects=outline)
    for a, b in drawing.ties:
        axes.plot(*points[[a, b]].T, color=NEUTRAL, linewidth=1)
    for point, share in drawing.discs:
        size = 2 * 72 * height * LARGEST_DISC * np.sqrt(share)
        axes.plot(*points[point], "o", color=NEUTRAL, markersize=size, clip_on=False)


def _draw_ground(
    axes: Axes, motion: Motion, origin: tuple[float, float], spacing: float, width: float, *, slopes: bool = True
) -> None:
    """Draw the ground with its marks, which do not move with the walker, its slope, and the tiles of a floor.

    The point ``origin`` of the cycle [m] is at the origin of the axes.
    """
    tiles = ground_tiles(motion) or [(origin[0] - FAR, origin[0] + FAR, origin[1], origin[1], 0.0)]
    for left, right, low, high, change in tiles:
        corners = np.array([[left, low], [right, high], [right, high - TINT * width], [left, low - TINT * width]])
        if change:
            opacity = min(1.0, FAINTEST + abs(change))
            tint = ICY if change < 0 else STICKY
            axes.fill(*_turned(motion, corners - origin).T, color=tint, alpha=opacity, linewidth=0, zorder=0)
    profile = np.array([corner for left, right, low, high, _ in tiles for corner in ((left, low), (right, high))])
    axes.plot(*_turned(motion, profile - origin).T, color="black", linewidth=1)
    first = ceil((origin[0] - width) / spacing)
    for number in range(first, first + ceil(2 * width / spacing)):
        left, right, low, high, _ = next(tile for tile in tiles if number * spacing <= tile[1])
        x = number * spacing
        y = low + (high - low) * (x - left) / (right - left)
        mark = _turned(motion, np.array([[x, y], [x - 0.02 * width, y - 0.02 * width]]) - origin)
        axes.plot(*mark.T, color="black", linewidth=1)
    angle = f"{degrees(slope(motion)):.3g}°"
    if slopes and slope(motion):
        axes.text(0.98, 0.97, angle, transform=axes.transAxes, va="top", ha="right", color=NEUTRAL)
