"""A walker that was designed: motors track curves that the design chose, so that it walks farther, faster and cheaper.

Gait III tracks the angles of another gait; its foot slips after the impact. The design keeps the slip, but takes steps
30 % longer at less cost, and disturbances die out faster.
"""

import gaitopt as go

before, designed = go.solve("compass-pd-impact-slip"), go.solve("compass-pd-designed")
for name, gait in (("gait III", before), ("designed", designed)):
    row = {key: round(gait.measures[key], 5) for key in ("step_length", "speed", "cost_of_transport")}
    print(name, row, "radius", round(gait.spectral_radius, 4))
assert designed.measures["step_length"] > 1.29 * before.measures["step_length"]
assert designed.measures["speed"] > 1.2 * before.measures["speed"]
assert designed.measures["cost_of_transport"] < before.measures["cost_of_transport"]
assert designed.spectral_radius < 0.5 < 0.9 < before.spectral_radius < 1
assert go.verify(designed).passed

figure = go.plot({"gait III": before, "designed": designed}, "portrait").figure
figure.set_size_inches(4.4, 3.8)
figure.savefig("designed_walker.png", dpi=160)
