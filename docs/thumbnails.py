"""Draws the moving thumbnails docs/gallery/*.gif: ``python docs/thumbnails.py``, from the root of a clone."""

from io import BytesIO
from pathlib import Path

from PIL import Image, ImageSequence

import gaitopt as go

FOLDER = Path(__file__).parent / "gallery"
SIZE, EVERY = (288, 192), 2
"""Size of a thumbnail [pixels]; every second picture of the animation is taken."""
GARCIA = {"leg_length": 1.0, "leg_mass": 1e-6, "leg_com": 1e-9, "hip_mass": 1.0, "gravity": 1.0, "slope": 0.009}
LONG = {"theta1": -0.2003, "dtheta1": 0.1998, "dtheta2": -0.0158}


def gaits():
    """The walker that moves in the thumbnail of each example."""
    garcia = go.load_problem("compass-passive-stick").replace({f"walker.{key}": value for key, value in GARCIA.items()})
    return {
        "cascade": go.solve("compass-passive-two-step"),
        "two_families": go.solve(garcia.replace({"friction": 1.0, "gait.guess.state": LONG})),
        "spring_mass_running": go.solve("slip-run"),
        "shaped_compass": go.solve("compass-shaped"),
        "designed_walker": go.solve("compass-pd-designed"),
        "basin": go.solve("compass-passive-a"),
        "proof": go.solve("compass-passive-b"),
        "rabbit_slips": go.solve("rabbit-hzd-slip"),
    }


if __name__ == "__main__":
    for name, gait in gaits().items():
        content = gait.animate().save(FOLDER / f"{name}.gif").read_bytes()
        with Image.open(BytesIO(content)) as whole:
            frames = [frame.convert("RGB").resize(SIZE) for frame in ImageSequence.Iterator(whole)][::EVERY]
            duration = EVERY * whole.info["duration"]
        first, *rest = (frame.quantize(32, dither=Image.Dither.NONE) for frame in frames)
        first.save(FOLDER / f"{name}.gif", save_all=True, append_images=rest, duration=duration, loop=0)
