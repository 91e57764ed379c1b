"""The simplest walker of Garcia et al. (1998) takes long steps, stable on small slopes, or short ones, which are not.

Its mass is at the hip. Both families exist on any small slope; their steps shrink like its cube root.
"""

import numpy as np

import gaitopt as go

walker = {"leg_length": 1.0, "leg_mass": 1e-6, "leg_com": 1e-9, "hip_mass": 1.0, "gravity": 1.0, "slope": 0.009}
changes = {f"walker.{key}": value for key, value in walker.items()}
simplest = go.load_problem("compass-passive-stick").replace({**changes, "friction": 1.0})

long = go.solve(simplest.replace({"gait.guess.state": {"theta1": -0.2003, "dtheta1": 0.1998, "dtheta2": -0.0158}}))
short = go.solve(simplest.replace({"gait.guess.state": {"theta1": -0.1939, "dtheta1": 0.2040, "dtheta2": -0.0153}}))
print("periods:", long.period, short.period)
assert np.allclose([long.period, short.period], [3.883, 3.096], atol=1e-3)

families = {
    name: go.continuation(gait, "walker.slope", to=[0.0005, 0.03]) for name, gait in (("long", long), ("short", short))
}
(doubling,) = (point.value for point in families["long"].special("period_doubling"))
print("the long steps lose their stability on a slope of", doubling)
assert abs(doubling - 0.0151) < 1e-4

figure = go.plot(families, "step_length").figure
figure.set_size_inches(4.4, 3.4)
figure.savefig("two_families.png", dpi=160)
