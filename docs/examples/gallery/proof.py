"""A proof that gait A exists, slips as stated and is stable: every claim holds with a margin.

The numbers are computed with balls that contain the exact value (extra ``proof``). Each cell is a claim with its proved
margin in SI units; two claims have no margin.
"""

from matplotlib.figure import Figure

import gaitopt as go

proof = go.prove(go.solve("compass-passive-a"))
print(proof, proof.spectral_radius)
assert proof.proved and proof.stable
assert abs(float(proof.spectral_radius) - 0.82060606671) < 1e-10

columns = ("arc 1, slip forward", "arc 2, stick", "arc 3, slip backward", "whole step")
cells = {}
for claim in proof.claims:
    arc, _, name = claim.name.replace("_", " ").rpartition(": ")
    cells.setdefault(name.strip(), {})[arc or "whole step"] = claim
with go.figure_style():
    figure = Figure(figsize=(5.9, 4.6))
    axes = figure.subplots()
    for row, claims in enumerate(cells.values()):
        for arc, claim in claims.items():
            column = columns.index(arc)
            axes.barh(row, 0.94, left=column - 0.47, height=0.84, color="#9bd1b3" if claim.proved else "#d55e00")
            margin = "proved" if claim.margin is None else f"> {0.999 * float(claim.margin):.3g}"
            axes.text(column, row, margin, ha="center", va="center", fontsize="small")
    axes.set_xticks(range(len(columns)), [words.replace(", ", "\n") for words in columns])
    axes.set_yticks(range(len(cells)), [name.replace("painleve", "Painlevé margin") for name in cells])
    axes.set(xlim=(-0.5, len(columns) - 0.5), ylim=(len(cells) - 0.5, -0.5))
    axes.set_title(f"{len(proof.claims)} claims proved, with their margins [SI]")
    axes.tick_params(length=0, top=True, labeltop=True, bottom=False, labelbottom=False)
    axes.grid(visible=False)
    figure.savefig("proof.png")
