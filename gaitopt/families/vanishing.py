"""Gaits that vanish: the feet come down ever closer to each other, until there is no step left.

    stride = distance between the feet at touchdown / length of a leg  ->  0

The durations of phases, the rate of touchdown, and the impulse of the impact vanish with it, in different powers, so
that any of them may be the monitor that is lost first. Close to that point no simulation resolves the step.
"""

import numpy as np

from gaitopt.families.segment import Point
from gaitopt.gait import Gait

VANISHED = 1e-4
"""Stride of a gait that is lost together with its step; a mode sequence alone is lost in full stride."""
FADING = 1e-2
"""Stride below which a gait that the simulator does not confirm may be about to vanish."""
REASON = "the gait vanishes: its strides shrink to nothing, both feet come down in the same place"


def stride(gait: Gait) -> float:
    """Largest distance between the feet at a touchdown, in lengths of a leg; slip does not count.

    Infinite for a walker that flies, which may land where it took off.
    """
    if gait.system.walker.flies:
        return np.inf
    x = gait.system.n_shape
    apart = [
        abs(step.impact.step_length - step.arcs[-1].states[-1, x]) for step in gait.steps if step.impact is not None
    ]
    return float(max(apart)) / gait.dynamics.scales.length


def vanishing_value(before: Point, last: Point) -> float:
    """The parameter at which the stride is zero, extrapolated from the last two gaits."""
    first, second = stride(before.gait), stride(last.gait)
    if not second < first:
        return last.value
    return last.value + (last.value - before.value) * second / (first - second)
