"""States along an arc at Chebyshev points, as many as it takes to resolve it."""

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.mechanics import Mode
from gaitopt.simulation.natural import Units
from gaitopt.simulation.stepper import Stepper

COUNTS = (33, 65, 129, 257)
"""Numbers of points that are tried in turn; 33 resolve a phase of walking."""
RESOLVED = 1e-12
"""Size of the last Chebyshev coefficients, in natural units, below which an arc is resolved; forces lose two digits
against states."""
STRAIGHT = 1e-8
"""An arc this short, in natural units, is straight to rounding: its two ends are enough."""


def sample(
    stepper: Stepper, unit: Units, mode: Mode, data: Array, start: float, end: float, state: Array
) -> tuple[Array, Array]:
    """Times (m,) and states (m, n_z) at Chebyshev points of the arc that begins at ``start`` with ``state``."""
    for count in COUNTS if end - start > STRAIGHT * unit.time else (2,):
        times = start + (end - start) * (curves.points(count) + 1) / 2
        times[-1] = end
        states = stepper.sample(mode, data, state, times)
        if count > 2 and curves.tail(states / unit.state) < RESOLVED:
            break
    return times, states
