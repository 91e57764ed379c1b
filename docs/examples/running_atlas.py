"""Where spring-mass running is stable, over angle of attack and stiffness: an atlas beside a scan by the simulator.

The scan knows neither gaits nor curves. It maps one coordinate, the angular velocity of the leg at touchdown, by one
step. Where the map meets the diagonal there is a gait, which is stable where the slope of the map is between -1 and 1.
"""

from itertools import product
from math import degrees, radians

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.path import Path

import gaitopt as go

OVER = {"walker.attack": ("56 deg", "72 deg"), "walker.stiffness": (12.0, 24.0)}
CELLS = 40
SPEEDS = np.linspace(0.05, 1.6, 240)  # angular velocities at touchdown; a faster leg has more than the energy
FINER, ROUNDS = 12, 4
ENGINE = "heyoka"  # scipy takes ten times as long


def slopes(problem: go.Problem) -> list[float]:
    """Slopes of the return map at its fixed points, looked for with finer and finer samples.

    A fixed point may also lie beside the last speed from which the runner completes its step.
    """
    x = SPEEDS[None]
    for _ in range(ROUNDS):
        walked = go.return_map(problem, x.reshape(-1, 1), engine=ENGINE)
        y = np.where(walked.completed, walked.states[:, 0], np.nan).reshape(x.shape)
        before, after = (y - x)[:, :-1], (y - x)[:, 1:]
        chosen = (before * after < 0) | (np.isnan(before) != np.isnan(after))
        if not chosen.any():
            return []
        slope = (np.diff(y) / np.diff(x))[chosen]
        x = np.linspace(x[:, :-1][chosen], x[:, 1:][chosen], FINER, axis=1)
    return slope[np.isfinite(slope)].tolist()


def stability(atlas: go.Atlas, place: tuple[float, float]) -> list[bool]:
    """Whether the gaits of the atlas at a place are stable, one per sheet."""
    return sorted(
        region.unstable == 0
        for region in atlas.arrangement.regions
        if region.unstable is not None and any(Path(piece).contains_point(place) for piece in region.pieces)
    )


if __name__ == "__main__":  # the branches are computed in several processes
    runner = go.load_problem("slip-run").replace({"friction": 4.0})  # enough for any angle
    atlas = go.atlas(runner, OVER, slices=5, output="running")
    print(atlas)
    (flip,) = atlas.arrangement.junctions
    assert abs(degrees(flip.values[0]) - 67.0896) < 1e-4 > abs(flip.values[1] - 17.8021)

    low, high = np.array([(axis.lower, axis.upper) for axis in atlas.axes]).T
    middles = [a + (np.arange(CELLS) + 0.5) * (b - a) / CELLS for a, b in zip(low, high, strict=True)]
    stable, differing = np.zeros((CELLS, CELLS)), []
    for (i, attack), (j, stiffness) in product(enumerate(middles[0]), enumerate(middles[1])):
        found = slopes(runner.replace({"walker.attack": float(attack), "walker.stiffness": float(stiffness)}))
        by_scan = sorted(abs(slope) < 1 for slope in found)
        stable[j, i] = 2 if any(by_scan) else 1 if by_scan else 0
        if by_scan != stability(atlas, (attack, stiffness)):
            differing.append((degrees(attack), stiffness))
            print(
                f"{degrees(attack):.2f} deg, {stiffness:.3f}: {stability(atlas, (attack, stiffness))}, slopes {found}"
            )
    print(f"{len(differing)} of {CELLS**2} cells differ; {int((stable == 2).sum())} are stable")
    assert not differing
    assert int((stable == 2).sum()) == 81

    with go.figure_style():
        figure = Figure(figsize=(9.2, 4.4), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        atlas.plot(ax=left)
        edges = [np.linspace(a, b, CELLS + 1) for a, b in zip(low, high, strict=True)]
        colours = {"no gait": "#ffffff", "unstable gaits only": "#dddddd", "a stable gait": "#0072b2"}
        right.pcolormesh(
            np.degrees(edges[0]), edges[1], stable, cmap=ListedColormap([*colours.values()]), vmin=0, vmax=2
        )
        patches = [Patch(facecolor=colour, edgecolor="#808080", label=text) for text, colour in colours.items()]
        right.legend(handles=patches, fontsize="small", loc="upper left")
        for curve in atlas.arrangement.curves:
            right.plot(np.degrees(curve.points[:, 0]), curve.points[:, 1], color="black", linewidth=0.8)
        for attack, stiffness in differing:
            right.plot(attack, stiffness, "x", color="#d55e00")
        left.set_title("atlas", fontsize="medium")
        right.set_title(f"simulator: {CELLS} x {CELLS} return maps", fontsize="medium")
        right.set(xlabel=left.get_xlabel(), xlim=np.degrees([radians(56), radians(72)]), ylim=(12, 24))
        figure.savefig("atlas-running.png", dpi=130)
