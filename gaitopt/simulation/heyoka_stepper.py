"""Arcs by heyoka's Taylor series, with about ten steps a phase and events at roots of the series, to machine precision.

heyoka reports every simple root of a margin in a step, in order of time. Margins that start at their edge (level feet;
a slip at its onset, which is a double root) are lifted off it. Newton's method then leads from the root of the lifted
margin to that of the margin.
"""

from functools import lru_cache
from typing import Any

import heyoka as hy
import numpy as np

from gaitopt.arrays import Array
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.simulation.engine import MAX_ARC_STEPS, NOT_FINITE, Stepper
from gaitopt.simulation.events import EDGE, INSTANT, Point, coincides, is_armed, lift, priority, refine, smallest_lift
from gaitopt.simulation.heyoka_code import CORRECTED_TOLERANCE, VARIATIONAL_TOLERANCE, Integrator, integrator


class HeyokaStepper(Stepper):
    """Arcs by heyoka.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    precision : ``float``, or ``numpy.longdouble`` for a reference; states are returned in double precision.
    """

    def __init__(self, dynamics: Dynamics, *, precision: type = float) -> None:
        super().__init__(dynamics)
        self._precision = precision
        self._integrators: dict[tuple[str, Mode, int], tuple[Integrator, Array, Array, dict[int, Array]]] = {}

    def find_event(self, mode: Mode, segment: int, start: Point, limit: float) -> tuple[str | None, float, Array, str]:
        """First event after ``start``; see ``Stepper``."""
        natural, names = self.natural, self.natural.system.transitions.margin_names(mode)
        taylor = self._loaded("arc", mode, segment, start.time, start.state)
        lifts = list(_smallest_lifts(names))
        for k, margin in enumerate(start.margins):
            if margin <= EDGE:
                lifts[k] = lift(names[k], margin, start.rates[k])
        taylor.pars[-len(names) :] = lifts
        taylor.reset_cooldowns()
        outcome = taylor.propagate_until(self._precision(limit), max_steps=MAX_ARC_STEPS)[0]
        end, zeta = float(taylor.time), np.array(taylor.state, dtype=float)
        if outcome == hy.taylor_outcome.time_limit:
            return None, end, zeta, ""
        if outcome == hy.taylor_outcome.step_limit:
            return None, end, zeta, f"more than {MAX_ARC_STEPS} integration steps in one arc"
        k = -int(outcome) - 1
        if not 0 <= k < len(names):
            return None, start.time, start.state, NOT_FINITE  # heyoka gives no later state

        def flow(point: Point, duration: float) -> Point:
            taylor = self._loaded("flow", mode, segment, point.time, point.state)
            taylor.propagate_for(self._precision(duration))
            return natural.point(mode, segment, float(taylor.time), np.array(taylor.state, dtype=float))

        lifted = natural.point(mode, segment, end, zeta)
        end, zeta = refine(k, lifted, flow)
        shift = end - lifted.time
        simultaneous = [
            names[j]
            for j, rate in enumerate(lifted.rates)
            if rate < 0 and coincides(lifted.margins[j] + shift * rate, rate)
            if is_armed(names[j], start.margins[j]) or end > start.time + INSTANT
        ]
        return min((names[k], *simultaneous), key=priority), end, zeta, ""

    def states_at(self, mode: Mode, segment: int, zeta: Array, taus: Array) -> Array:
        """States at ascending times; see ``Stepper``."""
        taylor = self._loaded("flow", mode, segment, taus[0], zeta)
        return np.asarray(taylor.propagate_grid(taus.astype(self._precision))[-1], dtype=float)

    def propagate(self, mode: Mode, segment: int, y: Array, columns: int, start: float, end: float) -> Array:
        """State and deviations at ``end``; see ``Stepper``."""
        taylor = self._loaded("variational", mode, segment, start, y, columns)
        taylor.propagate_until(end)
        return np.array(taylor.state)

    def _loaded(self, kind: str, mode: Mode, segment: int, time: float, state: Array, columns: int = 0) -> Any:
        """The integrator of this kind with its parameters, time and state set."""
        natural, key = self.natural, (kind, mode, columns)
        if key not in self._integrators:
            if kind == "arc":
                compiled = integrator(natural.functions.arc(mode), precision=self._precision)
            elif kind == "flow":
                compiled = integrator(natural.functions.flow(mode), precision=self._precision, unrolled=False)
            else:
                function = natural.functions.variational(mode, columns)
                corrected = natural.system.correction is not None
                tolerance = CORRECTED_TOLERANCE if corrected else VARIATIONAL_TOLERANCE
                compiled = integrator(function, unrolled=False, tolerance=tolerance)
            # keep the views of its memory, because heyoka is slow to make them
            self._integrators[key] = compiled, compiled.taylor.state, compiled.taylor.pars, {}
        compiled, memory, pars, constants = self._integrators[key]
        if segment not in constants:
            constants[segment] = compiled.values(natural.parameters(mode), natural.system.data(segment))
        values, taylor = constants[segment], compiled.taylor
        pars[: values.size], taylor.time, memory[:] = values, self._precision(time), state
        return taylor


@lru_cache(maxsize=64)
def _smallest_lifts(names: tuple[str, ...]) -> tuple[float, ...]:
    return tuple(map(smallest_lift, names))
