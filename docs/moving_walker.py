"""Draws docs/walker.svg: the compass biped of gait A on its slope, as an SVG that moves by itself; and a still one.

Run it from the root of a clone: ``python docs/moving_walker.py``.
"""

import re
from pathlib import Path

import numpy as np

import gaitopt as go
from gaitopt.gait.measures import observe
from gaitopt.show.film import magnifier, skeleton, slope
from gaitopt.show.motion import motion_of, resampled

PICTURE, STILL = (Path(__file__).parent / f"walker{kind}.svg" for kind in ("", "-still"))
ANIMATION = re.compile(r"<(animate(?:Transform)?) .*?/>")
WIDTH, HEIGHT, SCALE, GROUND = 480, 250, 115, 215
SECONDS_PER_STEP = 2.2
FRAMES = 40
HIP = 3
"""Point of the hip in the drawing of the compass."""
LENS, LENS_AT, LENS_GROUND = 104, (14, 12), 76
"""Side of the magnifier of the foot, its corner, and the ground in it [pixels]."""
WEIGHT = 46
"""Length of the arrow of the weight in the magnifier [pixels]."""


def frames(gait):
    """Positions of the walker's points, the mode and the force of the foot, at equidistant times of one step."""
    motion = motion_of(gait)
    arcs = [resampled(arc, max(3, round(FRAMES * arc.duration / motion.period))) for arc in motion.steps[0].arcs]
    points = np.vstack([skeleton([arc]).points for arc in arcs])
    times = np.concatenate([arc.times for arc in arcs]) / motion.period
    modes = np.concatenate([np.full(len(arc.times), str(arc.mode)) for arc in arcs])
    forces = np.vstack([observe(arc).force for arc in arcs]) / float(gait.system.weight(gait.dynamics.p))
    return times, points, modes, forces, motion.steps[0].impact.step_length


def animated(tag, style, attributes, times, seconds):
    """An element whose attributes run through values, for ever."""
    keys = ";".join(f"{t:.4f}" for t in times)
    runs = "".join(
        f'<animate attributeName="{name}" dur="{seconds}s" repeatCount="indefinite" keyTimes="{keys}" '
        f'values="{";".join(f"{v:.1f}" for v in values)}"/>'
        for name, values in attributes.items()
    )
    first = " ".join(f'{name}="{values[0]:.1f}"' for name, values in attributes.items())
    return f'<{tag} class="{style}" {first}>{runs}</{tag.split()[0]}>'


def lens(gait, times, points, modes, forces, seconds):
    """The foot under the magnifier: its trace on the ground, the two legs, and the force in its cone, twice."""
    factor, closeups = magnifier(motion_of(gait))
    middle = next(place for _, place in filter(None, closeups))
    scale = SCALE * factor

    def at(place):
        return LENS / 2 + scale * (place[..., 0] - middle), LENS_GROUND - scale * place[..., 1]

    x, y = at(points[:, 0])
    twice = [np.concatenate([column, column]) for column in (x, y)]
    body = [f'<path class="ground" d="M-60 {LENS_GROUND}H{LENS + 60}' + "".join(
        f"M{k * 16} {LENS_GROUND}l-7 7" for k in range(-3, 11)) + '"/>']  # fmt: skip
    for depth, mode in ((7, "slip_forward"), (14, "slip_backward")):
        rows = np.flatnonzero(modes == mode)
        begun, ended = rows[0], rows[-1]
        reach = np.where(np.arange(len(x)) < begun, x[begun], x[np.minimum(np.arange(len(x)), ended)])
        ends = {"x1": np.full(2 * len(x), x[begun]), "x2": np.concatenate([reach, reach])}
        body.append(animated(f'line y1="{LENS_GROUND + depth}" y2="{LENS_GROUND + depth}"', mode, ends, times, seconds))
    hip = at(points[:, HIP])
    near = [
        end - (end - start) * (1 - 2 * LENS / (SCALE * factor * 1.6)) for start, end in zip((x, y), hip, strict=True)
    ]
    for first, style in ((True, "first"), (False, "second")):
        shown = np.concatenate([np.full(len(x), 1.0 if first else 0.0), np.full(len(x), 0.0 if first else 1.0)])
        ends = {"x1": twice[0], "y1": twice[1], "x2": np.tile(near[0], 2), "y2": np.tile(near[1], 2), "opacity": shown}
        body.append(animated("line", f"thick {style}", ends, times, seconds))
    friction = gait.dynamics.static_friction
    tip = x + WEIGHT * forces[:, 0], y - WEIGHT * forces[:, 1]
    for side in (-friction, friction):
        edge = {"x1": x, "y1": y, "x2": x + side * 1.15 * WEIGHT, "y2": y - 1.15 * WEIGHT}
        body.append(animated("line", "cone", {name: np.tile(v, 2) for name, v in edge.items()}, times, seconds))
    arrow = {"x1": x, "y1": y, "x2": tip[0], "y2": tip[1]}
    body.append(animated("line", "force", {name: np.tile(v, 2) for name, v in arrow.items()}, times, seconds))
    body.append(
        animated(
            "circle",
            "tip",
            {"cx": np.tile(tip[0], 2), "cy": np.tile(tip[1], 2), "r": [3.5] * len(times)},
            times,
            seconds,
        )
    )
    body.append(animated("circle", "foot", {"cx": twice[0], "cy": twice[1], "r": [6] * len(times)}, times, seconds))
    slipping = np.tile(np.where(modes == "stick", 1.2, 6.0), 2)
    rim = animated(f'rect width="{LENS}" height="{LENS}" rx="7"', "rim", {"stroke-width": slipping}, times, seconds)
    tilt = np.degrees(slope(motion_of(gait)))
    return (
        f'<g transform="translate({LENS_AT[0]} {LENS_AT[1]})">'
        f'<rect class="glass" width="{LENS}" height="{LENS}" rx="7"/><svg width="{LENS}" height="{LENS}">'
        f'<g transform="rotate({tilt:.2f} {LENS / 2} {LENS_GROUND})">{"".join(body)}'
        f'</g></svg>{rim}<text x="{LENS - 8}" y="{LENS - 8}" text-anchor="end">×{factor}</text></g>'
    )


def picture(gait):
    """The SVG: two steps, after which the legs have their roles again."""
    times, points, modes, forces, length = frames(gait)
    own, slips = points, modes != "stick"
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
        ".glass{fill:#ffffff;fill-opacity:.85}.rim{fill:none;stroke:#e69f00}.thick{stroke-width:11}"
        ".slip_forward{stroke:#e69f00;stroke-width:6}.slip_backward{stroke:#56b4e9;stroke-width:6}"
        ".cone{stroke:#b3246f;stroke-width:1;stroke-dasharray:4 3}"
        ".force{stroke:#b3246f;stroke-width:2.5}.tip{fill:#b3246f}"
        ".foot{fill:#e69f00;stroke:#303030}text{font:13px sans-serif;fill:#303030}"
        "@media(prefers-color-scheme:dark){.glass{fill:#16181b}text{fill:#e8e8e8}"
        ".cone,.force{stroke:#ff7fbf}.tip{fill:#ff7fbf}}"
        ".first{stroke:#0072b2}.second{stroke:#d55e00}.slip{fill:#e69f00;fill-opacity:.75}.mass{fill:#303030}"
        "@media(prefers-color-scheme:dark){.mass{fill:#e8e8e8}.first{stroke:#6cb8ee}.second{stroke:#ff9a4d}}"
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="A passive walker whose foot slips"><style>{style}</style>'
        f'<g transform="rotate({tilt:.2f} {WIDTH / 2} {GROUND})">{"".join(body)}</g>'
        f"{lens(gait, times, own, modes, forces, seconds)}</svg>\n"
    )


if __name__ == "__main__":
    moving = picture(go.solve(go.load_problem("compass-passive-a")))
    PICTURE.write_text(moving)
    STILL.write_text(ANIMATION.sub("", moving))  # for those who dislike motion
