"""The basin of attraction of gait A, whose foot slips twice in every step.

From the coloured states, just after an impact, the walker settles on gait A. From the others it falls, or the impact
has no consistent outcome.
"""

import gaitopt as go

gait = go.solve("compass-passive-a")
basin = go.basin(gait, {"dtheta1": (0.35, 0.9, 111), "dtheta2": (-1.5, 1.0, 101)})
(attractor,) = basin.attractors
print(basin)
assert attractor.period == 1 and attractor.phases == ("slip_forward", "stick", "slip_backward")
assert abs(attractor.count - 534) <= 5

figure = basin.plot().figure
figure.set_size_inches(4.4, 3.6)
figure.savefig("basin.png", dpi=160)
