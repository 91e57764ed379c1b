"""Arcs by the Runge-Kutta pair DOP853; inside, all is in natural units."""

from functools import lru_cache, partial

import numpy as np
from casadi import SX, Function, if_else, logic_and, logic_or, sum1

from gaitopt.arrays import Array
from gaitopt.integration import CompiledStep, Integration, StepSizeError
from gaitopt.model.buffered import Buffers
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.simulation.events import EDGE, INSTANT, LOOK, Point, fallen, first_event, is_armed
from gaitopt.simulation.natural import NaturalSystem, natural_system, units
from gaitopt.simulation.stepper import Arrival

RTOL = 1e-12
"""Relative tolerance: a walking step is then right to about 1e-12, in some 25 integration steps."""
ATOL = 1e-14
"""Absolute tolerance, far below rtol: a slip that sets in gently is integrated to its own digits, at no extra cost."""
VARIATIONAL_ATOL = 1e-13
"""Deviations are scaled to size one: two digits below the agreement that is required of the multipliers."""
FIRST_STEP = 0.025
"""First integration step that is tried: about what walking takes; the step size control mends it at once."""
DEPARTURE_FACTOR = 4
"""Ratio of successive trial lengths when a margin must be seen leaving its edge."""
MAX_INTEGRATION_STEPS = 20_000
"""Bound on the work for one arc, half a second: walking takes tens, only a very stiff control law takes more."""


class IntegrationError(ArithmeticError):
    """The integrator cannot go on; becomes ``Arrival.failure``. ``reached`` is the last point, where it got further."""

    def __init__(self, words: str, reached: Point | None = None) -> None:
        super().__init__(words)
        self.reached = reached


class ScipyStepper:
    """A ``Stepper`` by DOP853, with the coefficients that scipy publishes.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    rtol, atol : tolerances of one integration step, ``atol`` in natural units.
    """

    def __init__(self, dynamics: Dynamics, *, rtol: float = RTOL, atol: float = ATOL) -> None:
        self._natural, self._units = natural_system(dynamics.system), units(dynamics)
        self._transitions, self._tolerances = dynamics.system.transitions, (rtol, atol)
        self._fields: dict[Mode, _Field] = {}
        self._variations: dict[tuple[Mode, int], tuple[CompiledStep, Buffers]] = {}

    def at(self, dynamics: Dynamics) -> "ScipyStepper":
        """The same tolerances at other parameters; see ``Stepper``."""
        rtol, atol = self._tolerances
        return ScipyStepper(dynamics, rtol=rtol, atol=atol)

    @np.errstate(all="ignore")  # a motion that blows up is seen from a vanishing step size
    def advance(self, mode: Mode, data: Array, time: float, state: Array, limit: float) -> Arrival:
        """Integrate one arc from ``time`` to its first event, or to ``limit``; see ``Stepper``."""
        unit, field = self._units, self._field(mode, data)
        start = field.point(time / unit.time, state / unit.state)
        name = fallen(field.names, start.margins, start.rates, partial(field.look, start))
        if name is not None or limit <= time:
            return Arrival(time=time, state=state, event=name)
        name, end, zeta, failure = self._first_event(field, start, limit / unit.time)
        if end <= start.time:
            return Arrival(time=time, state=state, event=name, failure=failure)
        at_limit = name is None and not failure
        return Arrival(
            time=limit if at_limit else end * unit.time, state=zeta * unit.state, event=name, failure=failure
        )

    def sample(self, mode: Mode, data: Array, state: Array, times: Array) -> Array:
        """States at ascending ``times`` by integration from each to the next; see ``Stepper``."""
        unit, field = self._units, self._field(mode, data)
        taus = (times / unit.time).tolist()
        point = field.point(taus[0], state / unit.state)
        states = [state]
        for tau in taus[1:]:
            point = self._reach(field, point, tau)
            states.append(point.state * unit.state)
        return np.array(states)

    def propagate_variations(self, mode: Mode, data: Array, state: Array, deviations: Array, times: Array) -> Array:
        """Deviations at the end of an arc from those at its start; see ``Stepper``."""
        unit = self._units
        step, rate = self._variational(mode, deviations.shape[1])
        step.load(unit.parameters[mode], data)
        start, end = (times / unit.time).tolist()
        y, sizes = unit.pack(state, deviations)
        (f,) = rate(start, y, unit.parameters[mode], data)
        integration = Integration(step, start, y, f.copy(), end, min(FIRST_STEP, end - start))
        while not integration.finished:
            integration.advance()
        return unit.unpack(integration.y, sizes)

    def _variational(self, mode: Mode, columns: int) -> tuple[CompiledStep, Buffers]:
        if (mode, columns) not in self._variations:
            rate = self._natural.variational(mode, columns)
            step = CompiledStep(rate, rate, rtol=RTOL, atol=VARIATIONAL_ATOL)
            self._variations[mode, columns] = step, Buffers(rate)
        return self._variations[mode, columns]

    def _first_event(self, field: "_Field", start: Point, limit: float) -> tuple[str | None, float, Array, str]:
        """Name, time and state of the first event, or those at the limit; and why the integration failed, if it did."""
        before = start
        armed = [is_armed(name, margin) for name, margin in zip(field.names, start.margins, strict=True)]
        try:
            integration, after = self._depart(field, start, armed, limit)
            while True:
                event = first_event(field.names, before, after, armed, partial(self._reach, field, before))
                if event is not None:
                    return (*event, "")
                before = after
                if integration.finished:
                    return None, before.time, before.state, ""
                armed = [was or margin > EDGE for was, margin in zip(armed, before.margins, strict=True)]
                before, after = field.stretch(integration, before, armed)
        except (IntegrationError, StepSizeError) as error:
            last = (error.reached if isinstance(error, IntegrationError) else None) or before
            return None, last.time, last.state, str(error)

    def _depart(self, field: "_Field", start: Point, armed: list[bool], limit: float) -> tuple[Integration, Point]:
        """First integration step, so short that every margin that starts at its edge has just left it.

        A slip that sets in and ends again within one integration step is found this way. Where a margin falls at
        once, the step is as short as it gets, and the margin not positive at its end.
        """
        edge = [k for k, margin in enumerate(start.margins) if armed[k] and margin <= 0]
        length = min(FIRST_STEP, limit - start.time)
        while True:
            integration = field.begin(start, limit, length)
            point = field.step(integration)
            length = integration.length / DEPARTURE_FACTOR
            if length < INSTANT / 2 or all(point.margins[k] > 0 for k in edge):
                return integration, point

    def _reach(self, field: "_Field", start: Point, time: float) -> Point:
        """The motion at ``time``, by an integration of its own from ``start``."""
        if time <= start.time:
            return start
        integration = field.begin(start, time, time - start.time)
        point = field.step(integration)
        while not integration.finished:
            point = field.step(integration)
        return point

    def _field(self, mode: Mode, data: Array) -> "_Field":
        if mode not in self._fields:
            names = self._transitions.margin_names(mode)
            self._fields[mode] = _Field(self._natural, names, mode, self._units.parameters[mode], *self._tolerances)
        self._fields[mode].load(data)
        return self._fields[mode]


class _Field:
    """Right-hand side and margins of one mode, compiled."""

    def __init__(
        self, system: NaturalSystem, names: tuple[str, ...], mode: Mode, p: Array, rtol: float, atol: float
    ) -> None:
        self.names = names
        self._p = p
        self._point = Buffers(system.point(mode))
        watch = _watch(len(self.names))
        self._step = CompiledStep(system.flow(mode), system.point(mode), rtol=rtol, atol=atol, compare=watch)

    def load(self, data: Array) -> None:
        """Go over to a segment of the control."""
        self._data = data
        self._step.load(self._p, data)

    def point(self, t: float, z: Array) -> Point:
        """The point of the motion at ``t`` in state ``z``."""
        flow, margins, rates = self._point(t, z, self._p, self._data)
        return Point(t, z, flow.copy(), margins.tolist(), rates.tolist())

    def look(self, point: Point) -> list[float]:
        """Rates of the margins a little later, from which their bends follow."""
        rates: list[float] = self._point(*point.shifted(LOOK), self._p, self._data)[2].tolist()
        return rates

    def begin(self, start: Point, limit: float, first_step: float) -> Integration:
        """An integration from a point, as yet without a step."""
        if not np.isfinite(start.flow).all():
            raise IntegrationError("the equations of motion are not finite")
        return Integration(self._step, start.time, start.state, start.flow, limit, first_step)

    def step(self, integration: Integration) -> Point:
        """One accepted step of the integrator."""
        integration.advance()
        margins, rates, _ = integration.outputs
        return Point(integration.t, integration.y, integration.f, margins.tolist(), rates.tolist())

    def stretch(self, integration: Integration, start: Point, armed: list[bool]) -> tuple[Point, Point]:
        """Steps from ``start`` until one needs a look, or is the last: the points before and after that one."""
        margins, rates, flags = self._step.compared
        margins[:], rates[:], flags[:] = start.margins, start.rates, armed
        while True:
            before = integration.t, integration.y, integration.f
            try:
                if integration.steps >= MAX_INTEGRATION_STEPS:
                    raise StepSizeError(f"more than {MAX_INTEGRATION_STEPS} integration steps in one arc")
                integration.advance()
            except StepSizeError as error:
                raise IntegrationError(str(error), Point(*before, margins.tolist(), rates.tolist())) from error
            new_margins, new_rates, look = integration.outputs
            if look[0] or integration.finished:
                after = Point(integration.t, integration.y, integration.f, new_margins.tolist(), new_rates.tolist())
                return Point(*before, margins.tolist(), rates.tolist()), after
            margins[:], rates[:] = new_margins, new_rates


@lru_cache
def _watch(n: int) -> Function:
    """Whether ``first_event`` may find any of n margins to fall within a step, or one has just been armed."""
    start, rates, end, end_rates, armed = (SX.sym(name, n) for name in ("m", "dm", "m1", "dm1", "armed"))
    dips, bulges = logic_and(rates < 0, end_rates > 0), logic_and(rates > 0, end_rates < 0)
    loose = logic_or(end > EDGE, logic_and(end <= 0, bulges))
    look = sum1(if_else(armed, logic_or(end <= 0, dips), loose))
    return Function("watch", [start, rates, end, end_rates, armed], [look])
