"""Draws docs/floors.png: which patches of ice, steps and slopes gait stick of the paper's compass survives.

Run it from the root of a clone: ``python docs/floors.py``.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

import gaitopt as go

HERE = Path(__file__).parent


def main() -> None:
    """Compute the limits of patches, and draw them."""
    with TemporaryDirectory() as folder:
        result = go.robustness("compass-passive-stick", what="patch", output=folder, workers=1)
        with go.figure_style():
            figure, axes = plt.subplots(3, 2, figsize=(8, 5.5), layout="constrained")
            for kind, panel in zip(result.to_record()["patch"], axes.flat, strict=True):
                legend = result.plot(kind, ax=panel).get_legend()
                handles, labels = legend.legend_handles, [text.get_text() for text in legend.get_texts()]
                legend.remove()
            figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
            figure.savefig(HERE / "floors.png", dpi=110)


if __name__ == "__main__":
    main()
