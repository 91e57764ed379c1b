"""Engines: integrators that advance a motion along an arc, in one mode, until an event or a time limit.

A mode assumes margins (``gaitopt.model.transitions``), each of which is positive while the mode holds. An event is a
margin that falls through zero:

* ``touchdown`` is armed once it has been positive after the impact: the feet are level at the start of every step, and
  this margin rises through zero again when the legs pass each other in mid-swing.
* Every other margin must be positive along the whole arc. If it starts at zero (the slip velocity at the onset of slip,
  which is a double root; the cone margin at re-sticking), it is not an event unless it falls.
* A margin that touches zero up to rounding is not an event.
* A margin that rises first and falls exactly at the time limit is an event, because it would not be armed in the next
  arc.

This module contains the rules for the start of an arc and the change to natural units for all engines. An engine adds
three methods. scipy's method is always available; heyoka is optional and compiles its code.
"""

from abc import ABC, abstractmethod
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np

from gaitopt.arrays import Array
from gaitopt.errors import UnknownNameError
from gaitopt.gait import curves
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.requests import Engine, choice
from gaitopt.simulation.events import LOOK_AHEAD, Point, event_at_start, falls_at_limit, priority
from gaitopt.simulation.natural import NaturalDynamics

MANY_STEPS = 1000
"""Smallest number of walking steps for which ``auto`` chooses heyoka: they take scipy as long as its compilation."""
INSTALL = "pip install 'gaitopt[fast]' on Linux, conda install heyoka.py elsewhere"
MAX_ARC_STEPS = 20_000
"""Largest number of integration steps of one arc. An arc of a walk takes tens, with a very stiff control law more."""
NOT_FINITE = "the equations of motion are not finite"
STRAIGHT = 1e-8
"""A shorter arc, in natural units, is straight up to rounding, so that its two ends are enough."""


def is_installed() -> bool:
    """Whether heyoka is installed."""
    return find_spec("heyoka") is not None


def choose_engine(engine: str, *, steps: int = 1) -> Engine:
    """The engine with this name; ``auto`` depends on the number of walking steps.

    Raises
    ------
    UnknownNameError
        If there is no such engine, or it is not installed.
    """
    chosen, installed = choice(Engine, engine), is_installed()
    if chosen is Engine.HEYOKA and not installed:
        raise UnknownNameError(f"the engine heyoka is not installed: {INSTALL}; or use the engine scipy")
    if chosen is Engine.AUTO:
        return Engine.HEYOKA if installed and steps >= MANY_STEPS else Engine.SCIPY
    return chosen


class Arrival(NamedTuple):
    """The end of an arc.

    Attributes
    ----------
    time : time since the last impact [s].
    state : ndarray, shape (n_z,) - state at this time.
    event : the margin that fell to zero; None at the time limit.
    failure : why the integrator could not continue; empty if it could.
    """

    time: float
    state: Array
    event: str | None = None
    failure: str = ""


class Stepper(ABC):
    """An engine for one system at fixed parameters.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.

    Attributes
    ----------
    natural : the same in natural units.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self.natural = NaturalDynamics(dynamics)

    @np.errstate(all="ignore")  # the engine detects motions that diverge
    def advance(self, mode: Mode, segment: int, time: float, state: Array, limit: float) -> Arrival:
        """Integrate one arc from ``time`` to its first event, or to ``limit``.

        Parameters
        ----------
        mode : mode of the walker.
        segment : segment of the control.
        time, limit : times since the last impact [s].
        state : ndarray, shape (n_z,) - state at ``time``.
        """
        natural = self.natural
        start = natural.point(mode, segment, time / natural.time, state / natural.state)

        def rates_ahead() -> list[float]:
            return list(natural.point(mode, segment, *start.after(LOOK_AHEAD)).rates)

        def event_at_limit(end: Point) -> str | None:
            falling = (
                name
                for name, margin, rate in zip(names, end.margins, end.rates, strict=True)
                if falls_at_limit(name, margin, rate)
            )
            return min(falling, key=priority, default=None)

        names = natural.system.transitions.margin_names(mode)
        event = event_at_start(names, start.margins, start.rates, rates_ahead)
        if event is not None:
            return Arrival(time, state, event)
        if limit <= time:
            return Arrival(time, state, event_at_limit(start))
        event, tau, zeta, failure = self.find_event(mode, segment, start, limit / natural.time)
        if event is None and not failure:
            event = event_at_limit(natural.point(mode, segment, tau, zeta))
            return Arrival(limit, zeta * natural.state, event)
        if tau <= start.time:
            return Arrival(time, state, event, failure)
        return Arrival(max(tau * natural.time, time), zeta * natural.state, event, failure)

    def sample(self, mode: Mode, segment: int, state: Array, times: Array) -> Array:
        """States at ascending ``times`` of an arc that starts with ``state`` at the first time; shape (m, n_z)."""
        natural = self.natural
        states = self.states_at(mode, segment, state / natural.state, times / natural.time) * natural.state
        states[0] = state
        return states

    def sample_arc(self, mode: Mode, segment: int, state: Array, start: float, end: float) -> tuple[Array, Array]:
        """Times (m,) and states (m, n_z) at Chebyshev points that resolve the arc that starts with ``state``."""
        for count in curves.COUNTS if end - start > STRAIGHT * self.natural.time else (2,):
            times = start + (end - start) * (curves.points(count) + 1) / 2
            times[-1] = end
            states = self.sample(mode, segment, state, times)
            if count > 2 and curves.tail(states / self.natural.state) < curves.RESOLVED:
                break
        return times, states

    def propagate_variations(
        self, mode: Mode, segment: int, state: Array, deviations: Array, times: Array, changes: Array | None = None
    ) -> Array:
        """Deviations at the end of an arc by the variational equations; shape (n_z, m).

        Parameters
        ----------
        state : ndarray, shape (n_z,) - state at the start of the arc.
        deviations : ndarray, shape (n_z, m) - deviations at the start of the arc, one per column.
        times : ndarray, shape (2,) - start and end of the arc [s].
        changes : ndarray, shape (n_u, m) - of the parameters that feedback from step to step corrects; zero by default.
        """
        unit, correction = self.natural.state, self.natural.system.correction
        n_u, m = 0 if correction is None else len(correction.entries), deviations.shape[1]
        changes = np.zeros((n_u, m)) if changes is None else changes
        scaled = deviations / unit[:, None]
        sizes = np.abs(np.vstack([scaled, changes])).max(axis=0)  # every column is scaled to size one
        sizes[sizes == 0] = 1.0
        y = np.concatenate([state / unit, (scaled / sizes).ravel(order="F"), (changes / sizes).ravel(order="F")])
        start, end = (times / self.natural.time).tolist()
        y = self.propagate(mode, segment, y, m, start, end)[unit.size : unit.size * (1 + m)]
        return np.asarray(y.reshape((unit.size, -1), order="F") * sizes * unit[:, None])

    @abstractmethod
    def find_event(self, mode: Mode, segment: int, start: Point, limit: float) -> tuple[str | None, float, Array, str]:
        """First event after ``start``, its time and state, and why the integration failed; all in natural units.

        Without an event, time and state are those at ``limit``, or the last ones before a failure.
        """

    @abstractmethod
    def states_at(self, mode: Mode, segment: int, zeta: Array, taus: Array) -> Array:
        """States at ascending times of a motion that starts with ``zeta`` at the first time; in natural units."""

    @abstractmethod
    def propagate(self, mode: Mode, segment: int, y: Array, columns: int, start: float, end: float) -> Array:
        """State and deviations, stacked in one vector, at ``end`` from ``y`` at ``start``; in natural units."""
