"""Spring-mass running is stable in a narrow band of angles of attack: a stiffer leg must land at a steeper angle.

Nothing controls this runner but the fixed angle of its leg in flight. At each stiffness its gaits are stable between a
fold and a period doubling of their family.
"""

from math import degrees, radians

from matplotlib.figure import Figure

import gaitopt as go

problem = go.load_problem("slip-run").replace({"friction": 3.0})  # enough for any angle
family = go.continuation(go.solve(problem), "walker.attack", to=[radians(60), radians(75)])
steep = max(family.points, key=lambda point: point.value).gait
stiffer = go.continuation(steep, "walker.stiffness", to=[10, 40])

stiffnesses, folds, doublings, families = [], [], [], []
for point in sorted(stiffer.points, key=lambda point: point.value)[::7]:
    flatter = go.continuation(point.gait, "walker.attack", to=radians(50))
    families.append(flatter)
    stiffnesses.append(point.value)
    folds.append(degrees(flatter.special("fold")[0].value))
    doublings.append(degrees(flatter.special("period_doubling")[0].value))
    print(f"stiffness {point.value:.2f}: stable from {folds[-1]:.3f} to {doublings[-1]:.3f} deg")

assert min(high - low for low, high in zip(folds, doublings, strict=True)) > 0.6  # a band
assert abs(folds[0] - 57.679) < 1e-3 > abs(doublings[0] - 58.622)

# long simulations, which know no multipliers: inside the band a push dies out, beyond the period doubling it does not
inside = min(families[0].points, key=lambda point: point.gait.spectral_radius).gait
beyond = families[0].points[-1].gait
for runner, returns in ((inside, True), (beyond, False)):
    walk = go.simulate(runner, {"dtheta": 1.0001 * runner.to_record()["state"]["dtheta"]}, steps=100)
    distance = abs(walk.trajectory.section_states[-1] - runner.state).max()
    assert (walk.completed and distance < 1e-8) == returns

with go.figure_style():
    figure = Figure(figsize=(4.4, 3.2))
    axes = figure.subplots()
    axes.fill_betweenx(stiffnesses, folds, doublings, color="#0072b2", alpha=0.5)
    axes.set(xlabel="angle of attack [°]", ylabel="stiffness k l / (m g)")
    axes.annotate("stable running", (69.3, 23), xytext=(61, 30), arrowprops={"arrowstyle": "->"})
    figure.savefig("spring_mass_running.png")
