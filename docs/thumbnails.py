"""Draws docs/gallery/*.gif and some small animations of docs/zoo.md: ``python docs/thumbnails.py [NAME ...]``.

Run it from the root of a clone.
"""

import sys
from io import BytesIO
from pathlib import Path

from PIL import Image, ImageSequence

import gaitopt as go

FOLDER = Path(__file__).parent / "gallery"
SIZE, EVERY = (288, 192), 2
"""Size of a thumbnail [pixels]; every second picture of the animation is taken."""
GARCIA = {"leg_length": 1.0, "leg_mass": 1e-6, "leg_com": 1e-9, "hip_mass": 1.0, "gravity": 1.0, "slope": 0.009}
LONG = {"theta1": -0.2003, "dtheta1": 0.1998, "dtheta2": -0.0158}


ZOO = ("kneed-passive", "round-feet-passive", "slip-run-foot", "hopper")
"""Walkers of the zoo."""


def gaits():
    """The walker that moves in the thumbnail of each example, or the name of its problem."""
    garcia = go.load_problem("compass-passive-stick").replace({f"walker.{key}": value for key, value in GARCIA.items()})
    return {
        "cascade": "compass-passive-two-step",
        "two_families": garcia.replace({"friction": 1.0, "gait.guess.state": LONG}),
        "spring_mass_running": "slip-run",
        "shaped_compass": "compass-shaped",
        "designed_walker": "compass-pd-designed",
        "basin": "compass-passive-a",
        "proof": "compass-passive-b",
        "rabbit_slips": "rabbit-hzd-slip",
    }


if __name__ == "__main__":
    files = {FOLDER / f"{name}.gif": problem for name, problem in gaits().items()}
    files |= {FOLDER.parent / f"{name}.gif": name for name in ZOO}
    for path, problem in files.items():
        if sys.argv[1:] and path.stem not in sys.argv[1:]:
            continue
        content = go.solve(problem).animate().save(path).read_bytes()
        with Image.open(BytesIO(content)) as whole:
            frames = [frame.convert("RGB").resize(SIZE) for frame in ImageSequence.Iterator(whole)][::EVERY]
            duration = EVERY * whole.info["duration"]
        first, *rest = (frame.quantize(32, dither=Image.Dither.NONE) for frame in frames)
        first.save(path, save_all=True, append_images=rest, duration=duration, loop=0)
