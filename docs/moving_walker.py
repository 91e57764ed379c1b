"""Draws docs/walker.svg: the compass biped of gait A on its slope, as an SVG that moves by itself; and a still one.

Run it from the root of a clone: ``python docs/moving_walker.py``.
"""

import re
from pathlib import Path

import numpy as np

import gaitopt as go
from gaitopt.show.film import skeleton, slope
from gaitopt.show.motion import motion_of, resampled

PICTURE, STILL = (Path(__file__).parent / f"walker{kind}.svg" for kind in ("", "-still"))
ANIMATION = re.compile(r"<(animate(?:Transform)?) .*?/>")
WIDTH, HEIGHT, SCALE, GROUND = 480, 250, 115, 215
SECONDS_PER_STEP = 2.2
FRAMES = 40
HIP = 3
"""Point of the hip in the drawing of the compass."""


def frames(gait):
    """Positions of the walker's points, and whether the foot slips, at equidistant times of one step."""
    motion = motion_of(gait)
    arcs = [resampled(arc, max(3, round(FRAMES * arc.duration / motion.period))) for arc in motion.steps[0].arcs]
    points = np.vstack([skeleton([arc]).points for arc in arcs])
    times = np.concatenate([arc.times for arc in arcs]) / motion.period
    slips = np.concatenate([np.full(len(arc.times), arc.mode != "stick") for arc in arcs])
    return times, points, slips, motion.steps[0].impact.step_length


def animated(tag, style, attributes, times, seconds):
    """An element whose attributes run through values, for ever."""
    keys = ";".join(f"{t:.4f}" for t in times)
    runs = "".join(
        f'<animate attributeName="{name}" dur="{seconds}s" repeatCount="indefinite" keyTimes="{keys}" '
        f'values="{";".join(f"{v:.1f}" for v in values)}"/>'
        for name, values in attributes.items()
    )
    first = " ".join(f'{name}="{values[0]:.1f}"' for name, values in attributes.items())
    return f'<{tag} class="{style}" {first}>{runs}</{tag}>'


def picture(gait):
    """The SVG: two steps, after which the legs have their roles again."""
    times, points, slips, length = frames(gait)
    times = np.concatenate([times / 2, 0.5 + times / 2])
    times[len(times) // 2] += 1e-4
    times = np.maximum.accumulate(times)
    camera = 2 * length * times
    world = np.concatenate([points, points + np.array([length, 0])])
    x = WIDTH / 2 + SCALE * (world[..., 0] - camera[:, None])
    y = GROUND - SCALE * world[..., 1]
    half = len(times) // 2
    stance = [0] * half + [1] * half
    feet = {"first": stance, "second": [1 - k for k in stance]}
    seconds, rows, body = 2 * SECONDS_PER_STEP, np.arange(len(times)), []
    tiles = SCALE * length / 4
    shift = [0.0, -SCALE * 2 * length]
    hatch = "".join(f"M{k * tiles:.1f} {GROUND}l-8 9" for k in range(-2, int(WIDTH / tiles) + 12))
    body.append(
        f'<g><path class="ground" d="M-40 {GROUND}H{WIDTH + 500}{hatch}"/><animateTransform attributeName="transform" '
        f'type="translate" dur="{seconds}s" repeatCount="indefinite" values="{shift[0]} 0;{shift[1]:.1f} 0"/></g>'
    )
    for style, foot in feet.items():
        ends = {"x1": x[:, HIP], "y1": y[:, HIP], "x2": x[rows, foot], "y2": y[rows, foot]}
        body.append(animated("line", f"leg {style}", ends, times, seconds))
    glow = np.where(np.concatenate([slips, slips]), 9.0, 0.1)
    body.append(animated("circle", "slip", {"cx": x[:, 0], "cy": y[:, 0], "r": glow}, times, seconds))
    for k, radius in ((2, 5), (4, 5), (HIP, 7)):
        body.append(animated("circle", "mass", {"cx": x[:, k], "cy": y[:, k], "r": [radius] * len(x)}, times, seconds))
    tilt = np.degrees(slope(motion_of(gait)))
    style = (
        ".ground{stroke:#808080;fill:none;stroke-width:1.2}.leg{stroke-width:5;stroke-linecap:round}"
        ".first{stroke:#0072b2}.second{stroke:#d55e00}.slip{fill:#e69f00;fill-opacity:.75}.mass{fill:#303030}"
        "@media(prefers-color-scheme:dark){.mass{fill:#e8e8e8}.first{stroke:#6cb8ee}.second{stroke:#ff9a4d}}"
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="A passive walker whose foot slips"><style>{style}</style>'
        f'<g transform="rotate({tilt:.2f} {WIDTH / 2} {GROUND})">{"".join(body)}</g></svg>\n'
    )


if __name__ == "__main__":
    moving = picture(go.solve(go.load_problem("compass-passive-a")))
    PICTURE.write_text(moving)
    STILL.write_text(ANIMATION.sub("", moving))  # for those who dislike motion
