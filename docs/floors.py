"""Draws docs/floors.png: which tiles and pushes gait stick of the paper's compass survives.

Run it from the root of a clone: ``python docs/floors.py``.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import gaitopt as go

HERE = Path(__file__).parent


def main() -> None:
    """Compute the limits of patches and pushes, and draw them."""
    with TemporaryDirectory() as folder:
        result = go.robustness("compass-passive-stick", what="patch,push", output=folder, workers=1)
        with go.figure_style():
            result.plot().figure.savefig(HERE / "floors.png", dpi=110)


if __name__ == "__main__":
    main()
