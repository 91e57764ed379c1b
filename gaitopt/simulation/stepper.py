"""The seam between the hybrid simulator and the integrator: advance along one arc, until an event or a time limit.

A mode assumes its margins (``gaitopt.model.transitions``); an event is a margin falling through zero.

* ``touchdown`` is armed once it has been positive after the impact: the feet are level at the start of every step,
  and the legs pass each other in mid-swing, where this margin rises through zero.
* Every other margin must be positive all along the arc. One that starts at zero (the slip velocity at the onset of
  slip, a double root; the edge of the cone at re-sticking) is no event if it leaves zero upwards.
* A margin that only touches zero, by less than rounding, is no event.

States along an arc at Chebyshev points, as many as it takes to resolve it.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.simulation.natural import Units

Indices = NDArray[np.intp]

LIMIT, FAILURE = -1, -2
"""Codes of arcs that end at their time limit, or because the integrator cannot go on."""


class Arrival(NamedTuple):
    """Where an arc ends, and why.

    Attributes
    ----------
    time : time since the last impact [s].
    state : ndarray, shape (n_z,) - state there.
    event : the margin that fell to zero; None at the time limit.
    failure : what kept the integrator from going on, in words; empty if nothing did.
    """

    time: float
    state: Array
    event: str | None = None
    failure: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Arrivals:
    """Where arcs end, and why.

    Attributes
    ----------
    times : ndarray, shape (n,) - time since the last impact [s].
    states : ndarray, shape (n, n_z).
    events : ndarray, shape (n,) - index in ``margin_names`` of the margin that fell to zero, ``LIMIT`` or ``FAILURE``.
    """

    times: Array
    states: Array
    events: Indices


class Stepper(Protocol):
    """An integrator of one system at fixed parameters."""

    def at(self, dynamics: Dynamics) -> "Stepper":
        """The same integrator for the system at other parameters."""

    def advance(self, mode: Mode, data: Array, time: float, state: Array, limit: float) -> Arrival:
        """Integrate one arc from ``time`` to its first event, or to ``limit``.

        Parameters
        ----------
        mode : contact mode of the stance foot.
        data : ndarray, shape (n_r,) - segment data of the control.
        time, limit : times since the last impact [s].
        state : ndarray, shape (n_z,) - state at ``time``.
        """

    def sample(self, mode: Mode, data: Array, state: Array, times: Array) -> Array:
        """States at ascending ``times`` of an arc that starts with ``state`` at the first; shape (m, n_z)."""

    def propagate_variations(self, mode: Mode, data: Array, state: Array, deviations: Array, times: Array) -> Array:
        """Carry deviations along an arc by its variational equations; shape (n_z, m).

        Parameters
        ----------
        state : ndarray, shape (n_z,) - state at the start of the arc.
        deviations : ndarray, shape (n_z, m) - deviations there, one per column.
        times : ndarray, shape (2,) - start and end of the arc [s].
        """


class BatchStepper(Protocol):
    """A stepper of many states at once, each with its own time; what happens to one does not depend on the others."""

    def advance(self, mode: Mode, segments: Indices, times: Array, states: Array, limits: Array) -> Arrivals:
        """Integrate arcs in one mode to their first events or time limits.

        Parameters
        ----------
        mode : contact mode of the stance foot.
        segments : ndarray, shape (n,) - segments of the control.
        times, limits : ndarray, shape (n,) - times since the last impact [s].
        states : ndarray, shape (n, n_z) - states at ``times``.
        """


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
