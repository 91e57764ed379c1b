"""Arcs by the Runge-Kutta method DOP853 of scipy, with compiled steps (``gaitopt.integration``), in natural units."""

from functools import partial

import numpy as np
from casadi import SX, Function, if_else, logic_and, logic_or, sum1

from gaitopt.arrays import Array
from gaitopt.building import built_once
from gaitopt.integration import CompiledStep, Integration, StepSizeError
from gaitopt.model.buffered import Buffers
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.simulation.engine import MAX_ARC_STEPS, NOT_FINITE, Stepper
from gaitopt.simulation.events import EDGE, INSTANT, Point, first_event, is_armed, rests_at_edge

RTOL = 1e-12
"""Relative tolerance; a walking step is then accurate to about 1e-12, with some 25 integration steps."""
ATOL = 1e-14
"""Absolute tolerance. It is far below ``RTOL``, so that a slip that starts gently has accurate digits too, at no extra
cost."""
VARIATIONAL_ATOL = 1e-13
"""Absolute tolerance of deviations, which are scaled to size one; two digits below the required agreement of the
multipliers."""
CORRECTED_TOLERANCES = 3e-14, 3e-15
"""Relative and absolute tolerance of deviations under feedback from step to step. Its gains cancel the growth of the
deviations without it, which is 4,000 for an optimal gait of RABBIT: a relative error of 1e-12 would leave 4e-9."""
FIRST_STEP = 0.025
"""Length of the first trial step, typical for walking; the step size control corrects it at once."""
DEPARTURE_FACTOR = 4
"""The first step is shortened by this factor until every margin has just left its edge at its end."""


class ScipyStepper(Stepper):
    """Arcs by DOP853.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    rtol, atol : tolerances of one integration step, ``atol`` in natural units.
    """

    def __init__(self, dynamics: Dynamics, *, rtol: float = RTOL, atol: float = ATOL) -> None:
        super().__init__(dynamics)
        self._tolerances = rtol, atol
        self._steps: dict[Mode, CompiledStep] = {}
        self._variations: dict[tuple[Mode, int], tuple[CompiledStep, Buffers]] = {}

    def find_event(self, mode: Mode, segment: int, start: Point, limit: float) -> tuple[str | None, float, Array, str]:
        """First event after ``start``; see ``Stepper``."""
        if not np.isfinite(start.flow).all():
            return None, start.time, start.state, NOT_FINITE
        step, names = self._step(mode, segment), self.natural.system.transitions.margin_names(mode)
        armed = [is_armed(name, margin) for name, margin in zip(names, start.margins, strict=True)]
        before, last = start, (start.time, start.state)
        rests = [k for k, name in enumerate(names) if rests_at_edge(name, start.margins[k], start.rates[k])]
        try:
            integration, after = _depart(step, _lifted(start, rests), armed, limit)
            while True:
                within = _lifted(before, rests), _lifted(after, rests)
                motion_at = partial(_lifted_motion, step, before, rests) if rests else partial(_integrate, step, before)
                event = first_event(names, *within, armed, motion_at)
                if event is not None:
                    return (*event, "")
                if integration.finished:
                    self.natural.keep(mode, segment, after)
                    return None, after.time, after.state, ""
                armed = [was or margin > EDGE for was, margin in zip(armed, after.margins, strict=True)]
                margins, rates, flags = step.compared
                margins[:], rates[:], flags[:] = after.margins, after.rates, armed
                while True:  # until a step that may hold an event, see ``_watch``, or the last one
                    t, y, f = integration.t, integration.y, integration.f
                    last = t, y
                    if integration.steps >= MAX_ARC_STEPS:
                        raise StepSizeError(f"more than {MAX_ARC_STEPS} integration steps in one arc")
                    integration.advance()
                    new_margins, new_rates, may_fall = integration.outputs
                    if may_fall[0] or integration.finished:
                        break
                    margins[:], rates[:] = new_margins, new_rates
                before = Point(t, y, f, margins.tolist(), rates.tolist())
                after = _point(integration)
        except StepSizeError as error:
            return None, *last, str(error)

    def states_at(self, mode: Mode, segment: int, zeta: Array, taus: Array) -> Array:
        """States at ascending times; see ``Stepper``."""
        step, (first, *others) = self._step(mode, segment), taus.tolist()
        point = self.natural.point(mode, segment, first, zeta)
        states = [zeta]
        for tau in others:
            point = _integrate(step, point, tau)
            states.append(point.state)
        return np.array(states)

    def propagate(self, mode: Mode, segment: int, y: Array, columns: int, start: float, end: float) -> Array:
        """State and deviations at ``end``; see ``Stepper``."""
        if (mode, columns) not in self._variations:
            function = self.natural.functions.variational(mode, columns)
            corrected = self.natural.system.correction is not None
            rtol, atol = CORRECTED_TOLERANCES if corrected else (RTOL, VARIATIONAL_ATOL)
            step = CompiledStep(function, function, rtol=rtol, atol=atol)
            self._variations[mode, columns] = step, Buffers(function)
        step, rate = self._variations[mode, columns]
        p, data = self.natural.parameters(mode), self.natural.system.data(segment)
        step.load(p, data)
        (f,) = rate(start, y, p, data)
        integration = Integration(step, start, y, f.copy(), end, min(FIRST_STEP, end - start))
        while not integration.finished:
            integration.advance()
        return integration.y

    def _step(self, mode: Mode, segment: int) -> CompiledStep:
        """The integration step of a mode on a segment of the control."""
        natural = self.natural
        if mode not in self._steps:
            watch = _watch(len(natural.system.transitions.of(mode)))
            rtol, atol = self._tolerances
            functions = natural.functions.flow(mode), natural.functions.point(mode)
            self._steps[mode] = CompiledStep(*functions, rtol=rtol, atol=atol, compare=watch)
        self._steps[mode].load(natural.parameters(mode), natural.system.data(segment))
        return self._steps[mode]


def _depart(step: CompiledStep, start: Point, armed: list[bool], limit: float) -> tuple[Integration, Point]:
    """The first integration step, so short that every margin that starts at its edge has just left it.

    A slip that starts and ends within one integration step is detected in this way. If a margin falls at once, the step
    is as short as possible, and the margin is not positive at its end.
    """
    edge = [k for k, margin in enumerate(start.margins) if armed[k] and margin <= 0]
    length = min(FIRST_STEP, limit - start.time)
    while True:
        integration = Integration(step, start.time, start.state, start.flow, limit, length)
        integration.advance()
        point = _point(integration)
        length = integration.length / DEPARTURE_FACTOR
        if length < INSTANT / 2 or all(point.margins[k] > 0 for k in edge):
            return integration, point


def _integrate(step: CompiledStep, start: Point, time: float) -> Point:
    """The point of the motion at ``time``, by an integration from ``start``."""
    if time <= start.time:
        return start
    integration = Integration(step, start.time, start.state, start.flow, time, time - start.time)
    while not integration.finished:
        integration.advance()
    return _point(integration)


def _lifted(point: Point, rests: list[int]) -> Point:
    """The point, in which margins that rest at their edge are lifted, so that they fall when they leave it."""
    if not rests:
        return point
    margins = [margin + (k in rests) * 2 * EDGE for k, margin in enumerate(point.margins)]
    return point._replace(margins=margins)


def _lifted_motion(step: CompiledStep, start: Point, rests: list[int], time: float) -> Point:
    return _lifted(_integrate(step, start, time), rests)


def _point(integration: Integration) -> Point:
    margins, rates, _ = integration.outputs
    return Point(integration.t, integration.y, integration.f, margins.tolist(), rates.tolist())


@built_once(maxsize=128)
def _watch(n: int) -> Function:
    """Whether ``first_event`` may find an event of n margins within a step, or a margin has just been armed."""
    start, rates, end, end_rates, armed = (SX.sym(name, n) for name in ("m", "dm", "m1", "dm1", "armed"))
    dips, bulges = logic_and(rates < 0, end_rates > 0), logic_and(rates > 0, end_rates < 0)
    unarmed = logic_or(end > EDGE, logic_and(end <= 0, bulges))
    may_fall = sum1(if_else(armed, logic_or(end <= 0, dips), unarmed))
    return Function("watch", [start, rates, end, end_rates, armed], [may_fall])
