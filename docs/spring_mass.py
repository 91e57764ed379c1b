"""Draws docs/spring-mass.png: walking and running of the same springy legs, with their families over the energy.

Run it from the root of a clone: ``python docs/spring_mass.py``.
"""

from pathlib import Path

from matplotlib.figure import Figure

import gaitopt as go

PICTURE = Path(__file__).parent / "spring-mass.png"
COLOURS = {"walk": "#0072b2", "run": "#d55e00"}
WEIGHT = 80 * 9.81

if __name__ == "__main__":
    walk = go.solve("slip-walk")
    running = {
        "walker.energy": 1200,
        "gait.phases": [{"front": "stick"}, {}],
        "gait.impact": {"front": "stick"},
        "gait.guess.state.dy": -1.3,
        "gait.guess.state.dx": 3.2,
        "gait.guess.state.back_x": 0.358,
    }
    run = go.solve(walk.problem.replace(running))
    with go.figure_style():
        figure = Figure(figsize=(6.0, 5.6), layout="constrained")
        force, family = figure.subplots(2, 1)
        for name, gait, ends in (("walk", walk, (811, 833)), ("run", run, (1050, 1400))):
            steps = go.simulate(gait, steps=2, dense=True).to_frame()
            steps["whole"] = steps["f_n.front"] + steps["f_n.back"]
            label = f"{name}, {gait.measures['speed']:.3g} m/s"
            force.plot(steps["t"], steps["whole"] / WEIGHT, color=COLOURS[name], label=label)
            for end in ends:
                branch = go.continuation(gait, "walker.energy", to=end)
                speeds = [point.gait.measures["speed"] for point in branch.points]
                family.plot([point.value for point in branch.points], speeds, color=COLOURS[name])
        force.set(xlabel="time [s]", ylabel="ground force / weight")
        force.legend()
        family.set(xlabel="energy [J]", ylabel="speed [m/s]")
        figure.savefig(PICTURE, dpi=110)
