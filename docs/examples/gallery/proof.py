"""A proof that gait A exists, slips as stated and is stable: every claim holds with a margin.

The numbers are computed with balls that contain the exact value (extra ``proof``). A bar is the proved margin of a
claim in SI units.
"""

from matplotlib.figure import Figure

import gaitopt as go

proof = go.prove(go.solve("compass-passive-a"))
print(proof, proof.spectral_radius)
assert proof.proved and proof.stable
assert abs(float(proof.spectral_radius) - 0.82060606671) < 1e-10

claims = [claim for claim in reversed(proof.claims) if claim.margin is not None]
with go.figure_style():
    figure = Figure(figsize=(4.4, 3.6))
    axes = figure.subplots()
    names = [claim.name.replace("_", " ") for claim in claims]
    axes.barh(names, [float(claim.margin) for claim in claims], color="#0072b2")
    axes.set(xscale="log", xlabel="proved margin [SI]", title=f"{len(proof.claims)} claims proved")
    axes.tick_params(axis="y", labelsize="small")
    figure.savefig("proof.png")
