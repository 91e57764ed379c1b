"""Goswami's compass doubles the period of its gait on steeper slopes, again and again, until it walks chaotically.

Dots are the states that walks settle on. Lines are the gaits of one, two and four steps, which continuation follows
through the period doublings even where they are unstable.
"""

from math import degrees, radians
from pathlib import Path

import numpy as np

import gaitopt as go
from gaitopt.show.attractors import bifurcation_diagram

PROBLEM = Path(__file__).parents[1] / "goswami.yaml"

gait = go.solve(PROBLEM)
branch = go.continuation(gait, "walker.slope", to=radians(5.2), doublings=2)
doublings = [degrees(point.value) for point in branch.special("period_doubling")]
print("periods double at", np.round(doublings, 4), "deg")
assert np.allclose(doublings, [4.3909, 4.9141, 5.0124], atol=1e-4)

settled = go.attractors(PROBLEM, {"walker.slope": ("4.2 deg", "5.2 deg", 80)}, starts=6)
exponents = [run["lyapunov"] for record in settled.records[-10:] for run in record["attractors"]]
print("Lyapunov exponents on the steepest slopes:", np.round(exponents, 2))
assert min(exponents) > 0.1  # chaos

figure = bifurcation_diagram(settled, "theta1", {"gaits": branch.to_records()})
figure.set_size_inches(4.4, 3.6)
figure.savefig("cascade.png", dpi=160)
