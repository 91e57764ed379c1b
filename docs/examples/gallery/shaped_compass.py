"""A compass on level ground whose motors imitate a slope of 3 deg walks as it would there (Spong & Bullo, 2005).

It does so without slip above friction 0.3411. Below, its foot slips, and the symmetry is lost.
"""

import numpy as np

import gaitopt as go

gait = go.solve("compass-shaped")
slope = go.load_problem("compass-shaped").replace({"control": {"type": "none"}, "walker.slope": "3 deg"})
passive = go.solve(slope)
assert abs(gait.period - passive.period) < 1e-9
assert np.allclose(np.sort_complex(gait.multipliers), np.sort_complex(passive.multipliers), atol=1e-7)

branch = go.continuation(gait, "friction", to=0.2, mode_changes=2)
changes = [point.value for point in branch.special("mode_change")]
print("the foot begins to slip at friction", changes)
assert abs(changes[0] - 0.3411) < 1e-4

figure = branch.plot().figure
figure.set_size_inches(4.4, 4.2)
figure.savefig("shaped_compass.png", dpi=160)
