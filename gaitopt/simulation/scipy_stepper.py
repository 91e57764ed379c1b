"""Arcs by scipy's DOP853 on a compiled right-hand side. Hairer, Norsett & Wanner (1993), section II.5.

Inside, all is in natural units.
"""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from gaitopt.mechanics import HybridSystem, Mode, margin_names
from gaitopt.mechanics.buffered import BufferedFunction
from gaitopt.simulation.events import EDGE, INSTANT, LOOK, Point, fallen, first_event, is_armed
from gaitopt.simulation.natural import NaturalSystem, natural_system, units
from gaitopt.simulation.stepper import Arrival

Array = NDArray[np.float64]

RTOL = 1e-12
"""Relative tolerance: a walking step is then right to about 1e-12, in some 25 integration steps."""
ATOL = 1e-14
"""Absolute tolerance, far below rtol: a slip that sets in gently is integrated to its own digits, at no extra cost."""
VARIATIONAL_ATOL = 1e-13
"""Deviations are scaled to size one: two digits below the agreement that is asked of the multipliers."""
FIRST_STEP = 0.025
"""First integration step that is tried: about what walking takes; the step size control mends it at once."""
DEPARTURE_FACTOR = 4
"""Ratio of successive trial lengths when a margin must be seen leaving its edge."""
MAX_INTEGRATION_STEPS = 20_000
"""Bound on the work for one arc, two seconds: walking takes tens, only a very stiff control law takes more."""


class IntegrationError(ArithmeticError):
    """The integrator cannot go on; becomes ``Arrival.failure``."""


class ScipyStepper:
    """A ``Stepper`` by scipy's DOP853.

    Parameters
    ----------
    system : the walker under its control law.
    p : ndarray, shape (n_p,) - parameters.
    rtol, atol : tolerances of one integration step, ``atol`` in natural units.
    """

    def __init__(self, system: HybridSystem, p: Array, *, rtol: float = RTOL, atol: float = ATOL) -> None:
        self._natural, self._units = natural_system(system), units(system, p)
        self._tolerances = {"rtol": rtol, "atol": atol}
        self._fields: dict[Mode, _Field] = {}

    @np.errstate(all="ignore")  # a motion that blows up is told by the step size that vanishes
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
        unit, columns = self._units, deviations.shape[1]
        variational = BufferedFunction(self._natural.variational(mode, columns))
        variational.inputs[2][:], variational.inputs[3][:] = unit.parameters[mode], data
        start, end = times / unit.time
        y, sizes = unit.pack(state, deviations)
        solver = DOP853(_rate(variational), start, y, end, rtol=RTOL, atol=VARIATIONAL_ATOL)
        while solver.status == "running":
            solver.step()
        return unit.unpack(solver.y, sizes)

    def _first_event(self, field: "_Field", start: Point, limit: float) -> tuple[str | None, float, Array, str]:
        """Name, time and state of the first event, or those at the limit; and why the integration failed, if it did."""
        before = start
        armed = [is_armed(name, margin) for name, margin in zip(field.names, start.margins, strict=True)]
        try:
            for after in self._points(field, start, armed, limit):
                event = first_event(field.names, before, after, armed, partial(self._reach, field, before))
                if event is not None:
                    return (*event, "")
                armed = [was or margin > EDGE for was, margin in zip(armed, after.margins, strict=True)]
                before = after
        except IntegrationError as error:
            return None, before.time, before.state, str(error)
        return None, before.time, before.state, ""

    def _points(self, field: "_Field", start: Point, armed: list[bool], limit: float) -> Iterator[Point]:
        """The points that the integrator steps on, from ``start`` (exclusive) to ``limit``."""
        solver, point = self._depart(field, start, armed, limit)
        yield point
        for _ in range(MAX_INTEGRATION_STEPS):
            if solver.status == "finished":
                return
            yield field.step(solver)
        raise IntegrationError(f"more than {MAX_INTEGRATION_STEPS} integration steps in one arc")

    def _depart(self, field: "_Field", start: Point, armed: list[bool], limit: float) -> tuple[DOP853, Point]:
        """First integration step, so short that every margin that starts at its edge has just left it.

        A slip that sets in and ends again within one integration step is found this way. Where a margin falls at
        once, the step is as short as it gets, and the margin not positive at its end.
        """
        edge = [k for k, margin in enumerate(start.margins) if armed[k] and margin <= 0]
        length = min(FIRST_STEP, limit - start.time)
        while True:
            solver = self._solver(field, start, limit, length)
            point = field.step(solver)
            length = solver.step_size / DEPARTURE_FACTOR
            if length < INSTANT / 2 or all(point.margins[k] > 0 for k in edge):
                return solver, point

    def _reach(self, field: "_Field", start: Point, time: float) -> Point:
        """The motion at ``time``, by an integration of its own from ``start``."""
        if time <= start.time:
            return start
        solver = self._solver(field, start, time, time - start.time)
        point = field.step(solver)
        while solver.status == "running":
            point = field.step(solver)
        return point

    def _solver(self, field: "_Field", start: Point, limit: float, first_step: float) -> DOP853:
        if not np.isfinite(start.flow).all():
            raise IntegrationError("the equations of motion are not finite")
        solver = DOP853(field.rate, start.time, start.state, limit, first_step=first_step, **self._tolerances)
        solver.fun = field.rate  # past scipy's three layers of checks, which cost as much as the mechanics
        return solver

    def _field(self, mode: Mode, data: Array) -> "_Field":
        if mode not in self._fields:
            self._fields[mode] = _Field(self._natural, mode, self._units.parameters[mode])
        self._fields[mode].load(data)
        return self._fields[mode]


class _Field:
    """Right-hand side and margins of one mode, compiled."""

    def __init__(self, system: NaturalSystem, mode: Mode, p: Array) -> None:
        self.names = margin_names(mode)
        self._p = p
        self._flow, self._events = BufferedFunction(system.flow(mode)), BufferedFunction(system.events(mode))
        self.rate = _rate(self._flow)

    def load(self, data: Array) -> None:
        """Go over to a segment of the control."""
        self._data = data
        self._flow.inputs[2][:], self._flow.inputs[3][:] = self._p, data

    def point(self, t: float, z: Array, flow: Array | None = None) -> Point:
        """The point of the motion at ``t`` in state ``z``, where the rate may be known already."""
        margins, rates = self._events(t, z, self._p, self._data)
        return Point(t, z, self.rate(t, z) if flow is None else flow, margins.tolist(), rates.tolist())

    def look(self, point: Point) -> list[float]:
        """Rates of the margins a little later, from which their bends follow."""
        rates: list[float] = self._events(*point.shifted(LOOK), self._p, self._data)[1].tolist()
        return rates

    def step(self, solver: DOP853) -> Point:
        """One accepted step of the integrator."""
        solver.step()
        if solver.status == "failed":
            raise IntegrationError("the step size of the integrator vanishes: the motion is singular")
        return self.point(float(solver.t), solver.y, solver.f)


def _rate(flow: BufferedFunction) -> Callable[[float, Array], Array]:
    """(t, z) -> dz/dt, with its names bound once: it is called some 500 times in a walking step."""
    time, state, _, _ = flow.inputs
    (output,) = flow.outputs
    evaluate = flow.evaluate

    def rate(t: float, z: Array) -> Array:
        time[0] = t
        state[:] = z
        evaluate()
        return output.copy()

    return rate
