"""Where the passive compass walks, slips and is stable, over friction and slope.

Its stability ends on a Neimark-Sacker curve or by a period doubling; the two meet in a resonance 1:2.
"""

from math import degrees

import gaitopt as go

if __name__ == "__main__":  # the branches are computed in several processes
    over = {"friction": (0.05, 0.35), "walker.slope": ("0.2 deg", "5 deg")}
    atlas = go.atlas("compass-passive-a", over, output="compass")
    print(atlas)
    assert not atlas.unexplained
    places = {junction.name: junction.values for junction in atlas.arrangement.junctions if not junction.within}
    friction, slope = places["resonance_1_2"]
    assert abs(friction - 0.145018608) < 1e-8
    assert abs(degrees(slope) - 2.248926926) < 1e-8
    largest = atlas.arrangement.regions[0]
    assert (largest.modes, largest.unstable) == ("stick; stick", 0)
    assert abs(largest.area / atlas.area - 0.40) < 0.005
    assert abs(sum(region.area for region in atlas.arrangement.regions) / atlas.area - 1) < 1e-9

    figure = atlas.plot().figure
    figure.savefig("atlas.png", dpi=160)
