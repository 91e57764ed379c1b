"""RABBIT walks on virtual constraints. With less friction its feet slip, and it walks on, stably, down to 0.36.

The control law still assumes feet that stick. Each picture shows one step at equal times; the stance foot is orange or
blue where it slips forward or backward.
"""

import numpy as np
from matplotlib.figure import Figure

import gaitopt as go
from gaitopt.show.film import skeleton
from gaitopt.show.motion import motion_of
from gaitopt.show.style import MODE_COLOURS

branch = go.continuation(go.solve("rabbit-hzd"), "friction", to=0.3, mode_changes=3)
changes = [round(point.value, 4) for point in branch.specials]
print("changes at friction", changes)
assert np.allclose(sorted(changes), [0.3602, 0.4609, 0.5667], atol=1e-4)
assert all(point.gait.stable for point in branch.points)

with go.figure_style():
    figure = Figure(figsize=(4.4, 3))
    for axes, point in zip(figure.subplots(1, 2), (branch.points[0], branch.points[-1]), strict=True):
        arcs = motion_of(point.gait).steps[0].arcs
        films = [skeleton([arc]) for arc in arcs]
        times, points = np.concatenate([arc.times for arc in arcs]), np.vstack([film.points for film in films])
        modes = [arc.mode for arc in arcs for _ in arc.times]
        for time in np.linspace(0, times[-1], 6):
            k = int(np.argmin(abs(times - time)))
            for one, other in films[0].legs:
                axes.plot(*points[k][[one, other]].T, color="#0072b2", alpha=0.3 + 0.7 * time / times[-1])
            axes.plot(*points[k][0], "o", color=MODE_COLOURS[modes[k]])
        axes.axhline(0, color="#757575", linewidth=0.8, zorder=0)
        axes.set(aspect="equal", title=f"friction {point.value:.2f}, {point.gait.measures['speed']:.2f} m/s")
        axes.axis("off")
    figure.savefig("rabbit_slips.png")
