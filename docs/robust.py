"""The picture of robust designs: cost and stability over friction, and what the width of the range costs.

The upper panels compare compass-torque-robust with the design for friction 0.16 alone, whose control is followed over
the same range. The lowest panel is the front of worst cost and width: each design holds from 0.16 - width/2 to
0.16 + width/2.
"""

from pathlib import Path

from matplotlib.figure import Figure

import gaitopt as go

COST, OWN = "absolute_cost_of_transport", 0.16
WIDTHS = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08)


def followed(gait: go.Gait, low: float, high: float) -> list[go.Gait]:
    """The gaits of a control over friction."""
    sides = (go.continuation(gait, "friction", to=to, progress=False).points for to in (low, high))
    return sorted((point.gait for side in sides for point in side), key=lambda one: one.dynamics.parameter("friction"))


def main() -> None:
    """Draw docs/robust.png."""
    problem = go.load_problem("compass-torque-robust")
    robust, single = go.solve(problem, progress=False), go.solve(problem.at_own_value(), progress=False)
    with go.figure_style():
        figure = Figure(figsize=(6.0, 6.2), layout="constrained")
        speed, radius, front = figure.subplots(3, 1)
    for words, gait in (("friction 0.12 to 0.2", robust), ("friction 0.16 alone", single)):
        gaits = followed(gait, 0.12, 0.2)
        frictions = [one.dynamics.parameter("friction") for one in gaits]
        speeds, radii = ([one.scalar(name) for one in gaits] for name in ("speed", "spectral_radius"))
        speed.plot(frictions, speeds, label=f"designed for {words}, cost {gait.scalar(COST):.6f}")
        radius.plot(frictions, radii)
    costs = [single.scalar(COST)]
    for width in WIDTHS:
        gait = go.solve(problem.replace({"over.friction": [OWN - width / 2, OWN + width / 2]}), progress=False)
        costs.append(gait.over.objective if gait.over and gait.over.objective else float("nan"))
    speed.axhline(0.48, color="0.6", linestyle=":")
    radius.axhline(0.85, color="0.6", linestyle=":")
    front.plot([0.0, *WIDTHS], costs, marker="o", markersize=4)
    speed.set_ylabel("speed [m/s]")
    radius.set(ylabel="spectral radius", xlabel="coefficient of friction")
    front.set(ylabel="worst absolute cost", xlabel="width of the range of friction")
    figure.legend(loc="outside upper center", ncols=1)
    figure.savefig(Path(__file__).parent / "robust.png", dpi=130)


if __name__ == "__main__":
    main()
