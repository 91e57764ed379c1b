"""A hybrid system in natural units, in which motions are integrated, events located and contact modes decided.

    d zeta / d tau = T D^-1 flow(T tau, D zeta),      margins / their units,      t = T tau,  z = D zeta

Tolerances are then plain numbers, and no result depends on the units of a problem. The unit of the margin ``painleve``
is the foot's apparent mass C_tt, the mean over both slip directions: a slip needs C_tt + mu s C_nt > SINGULAR C_tt.
"""

from collections.abc import Callable, Sequence

import numpy as np
from casadi import SX, Function, cse, repmat, vertcat

from gaitopt.arrays import Array
from gaitopt.building import BUILT, building, built_once
from gaitopt.model.buffered import Buffers
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.simulation.events import Point
from gaitopt.threads import cached_method

SINGULAR = 1e-5
"""A slip ends as singular if its apparent mass falls to this, relative to that of a sticking foot. Forces lose digits
in proportion to its inverse. At 1e-6 a Runge-Kutta method may need more than 20,000 steps for 1e-8 s of such a
slip, which is no problem for a Taylor series."""


class NaturalSystem:
    """Functions of a hybrid system in natural units; ``natural_system`` makes and caches them.

    Their arguments are (tau, zeta, parameters, r) with ``NaturalDynamics.parameters``, and r as in ``HybridSystem``.
    """

    @building
    def __init__(self, system: HybridSystem) -> None:
        self._system = system
        self._functions: dict[str, Function] = {}
        n_margins = system.transitions.most_margins
        self._tau, self._r = SX.sym("tau"), SX.sym("r", system.n_r)
        self._p, self._time = SX.sym("p", len(system.parameters)), SX.sym("T")
        self._state, self._margins = SX.sym("D", system.n_z), SX.sym("S", n_margins)
        angles = {*system.walker.shape} - {*system.walker.lengths}  # these have no unit
        self._d = vertcat(*(1 if name in angles else self._state[k] for k, name in enumerate(system.state_names)))
        self._parameters = vertcat(self._p, self._time, self._state, self._margins)
        BUILT.watch(vars(self))

    def flow(self, mode: Mode) -> Function:
        """Rate of the state."""
        return self._build(f"flow_{mode.key}", lambda a: [self._rate(mode, a)])

    def point(self, mode: Mode) -> Function:
        """Rate of the state, margins and their rates."""
        return self._build(f"point_{mode.key}", lambda a: cse([self._rate(mode, a), *self._events(mode, a)]))

    def arc(self, mode: Mode) -> Function:
        """Rate of the state, followed by the margins."""

        def outputs(a: list[SX]) -> list[SX]:
            return [cse(vertcat(self._rate(mode, a), self._scaled_margins(mode, a, self._margins)))]

        return self._build(f"arc_{mode.key}", outputs)

    @building
    def rest(self, mode: Mode, slips: Sequence[Mode]) -> Function:
        """``point`` of a sticking foot, and the margins of ``slips``, whose units are a further argument."""
        units = SX.sym("S_slip", self._margins.numel())

        def outputs(a: list[SX]) -> list[SX]:
            margins = [self._scaled_margins(slip, a, units) for slip in slips]
            return cse([self._rate(mode, a), *self._events(mode, a), *margins])

        return self._build(f"rest_{mode.key}", outputs, further=[units])

    @building
    def variational(self, mode: Mode, columns: int) -> Function:
        """Rate of the state and of ``columns`` deviations, stacked in one vector."""
        corrected = 0 if self._system.correction is None else len(self._system.correction.entries)
        scale = vertcat(repmat(self._d, 1 + columns, 1), SX.ones(corrected * columns))
        rates = self._system.variational(mode, columns)
        return self._build(
            f"variational_{mode.key}_{columns}", lambda a: [rates(*a) * (self._time / scale)], scale=scale
        )

    def _rate(self, mode: Mode, arguments: list[SX]) -> SX:
        return self._system.flow(mode)(*arguments) * (self._time / self._d)

    def _events(self, mode: Mode, arguments: list[SX]) -> list[SX]:
        """Margins and their rates."""
        margins, rates = self._system.events(mode)(*arguments)
        units = self._margins[: margins.numel()]
        scaled, scaled_rates = margins / units, rates * (self._time / units)
        if mode.slips and mode.direction:
            k, (other, other_rates) = self._index_painleve(mode), self._system.events(_reversed(mode))(*arguments)
            foot, foot_rate = (margins[k] + other[k]) / 2, (rates[k] + other_rates[k]) / 2
            scaled[k] = margins[k] / foot - SINGULAR
            scaled_rates[k] = (rates[k] - margins[k] / foot * foot_rate) * (self._time / foot)
        return [scaled, scaled_rates]

    def _scaled_margins(self, mode: Mode, arguments: list[SX], units: SX) -> SX:
        margins = self._system.margins(mode)(*arguments)
        scaled = margins / units[: margins.numel()]
        if mode.slips and mode.direction:
            k, other = self._index_painleve(mode), self._system.margins(_reversed(mode))(*arguments)
            scaled[k] = 2 * margins[k] / (margins[k] + other[k]) - SINGULAR
        return scaled

    def _index_painleve(self, mode: Mode) -> int:
        return self._system.transitions.margin_names(mode).index("painleve")

    def _build(
        self, name: str, outputs: Callable[[list[SX]], list[SX]], scale: SX | None = None, further: Sequence[SX] = ()
    ) -> Function:
        """The function of (tau, zeta, parameters, r, further), built on first use; ``scale`` is the unit of zeta."""
        if name in self._functions:
            return self._functions[name]
        return self._built(name, outputs, scale, further)

    @building
    def _built(
        self, name: str, outputs: Callable[[list[SX]], list[SX]], scale: SX | None, further: Sequence[SX]
    ) -> Function:
        if name not in self._functions:  # another thread may just have built it
            scale = self._d if scale is None else scale
            zeta = SX.sym("zeta", scale.numel())
            arguments = [self._time * self._tau, scale * zeta, self._p, self._r]
            inputs = [self._tau, zeta, self._parameters, self._r, *further]
            self._functions[name] = Function(name, inputs, outputs(arguments))
        return self._functions[name]


class NaturalDynamics:
    """A hybrid system at fixed parameters in natural units.

    It evaluates points of motions in its own memory, so that only one thread at a time can use it. It keeps the latest
    point, whose state must not be changed.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.

    Attributes
    ----------
    dynamics, system : the dynamics, and its hybrid system.
    functions : functions of the system in natural units.
    time, speed : units of time and speed [s], [m/s].
    state : ndarray, shape (n_z,) - units of the state.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self.dynamics, self.system, scales = dynamics, dynamics.system, dynamics.scales
        self.functions = natural_system(dynamics.system.shared)
        self.time, self.speed, self.state = scales.time, scales.speed, dynamics.state_units
        self._points: dict[Mode, Buffers] = {}
        self._rests: dict[Mode, Buffers] = {}
        self._latest: tuple[tuple[Mode, int] | None, Point] = None, Point(0.0, np.zeros(0), np.zeros(0), (), ())

    @cached_method
    def margins(self, mode: Mode) -> Array:
        """Units of the margins of a mode, padded with ones to the largest number of margins of a mode."""
        values = self.dynamics.margin_units(mode)
        return np.append(values, np.ones(self.system.transitions.most_margins - values.size))

    @cached_method
    def parameters(self, mode: Mode) -> Array:
        """Parameters of ``functions`` in a mode."""
        return np.concatenate([self.dynamics.p, [self.time], self.state, self.margins(mode)])

    def point(self, mode: Mode, segment: int, tau: float, zeta: Array) -> Point:
        """The point of a motion in a mode, on a segment of the control."""
        known, latest = self._latest
        if known == (mode, segment) and latest.time == tau and np.array_equal(latest.state, zeta):
            return latest
        if mode not in self._points:
            self._points[mode] = function = Buffers(self.functions.point(mode))
            function.inputs[2][:] = self.parameters(mode)
        flow, margins, rates = self._evaluate(self._points[mode], segment, tau, zeta)
        return self.keep(mode, segment, Point(tau, zeta, flow.copy(), margins.tolist(), rates.tolist()))

    def keep(self, mode: Mode, segment: int, point: Point) -> Point:
        """Keep the latest point: the end of an arc, the decision about contacts and the next arc ask for the same."""
        self._latest = (mode, segment), point
        return point

    def rest(
        self, mode: Mode, slips: Sequence[Mode], segment: int, tau: float, zeta: Array
    ) -> tuple[Point, list[list[float]]]:
        """The point of a motion with a sticking foot, and the margins of the ``slips`` at this point."""
        if mode not in self._rests:
            self._rests[mode] = function = Buffers(self.functions.rest(mode, slips))
            function.inputs[2][:] = self.parameters(mode)
            for slip in slips[:1]:
                function.inputs[4][:] = self.margins(slip)
        flow, margins, rates, *slipping = self._evaluate(self._rests[mode], segment, tau, zeta)
        point = Point(tau, zeta, flow.copy(), margins.tolist(), rates.tolist())
        return point, [values.tolist() for values in slipping]

    def _evaluate(self, function: Buffers, segment: int, tau: float, zeta: Array) -> tuple[Array, ...]:
        """Outputs at a point, valid until the next call; the parameters stay as they are."""
        time, state, _, data, *_ = function.inputs
        time[0], state[:], data[:] = tau, zeta, self.system.data(segment)
        function.evaluate()
        return function.outputs


def _reversed(mode: Mode) -> Mode:
    """The slip in the other direction."""
    return mode.with_contact(Mode.slip(-mode.direction))


@built_once(maxsize=16)
def natural_system(system: HybridSystem) -> NaturalSystem:
    """The functions of a system in natural units, built on first use and cached."""
    return NaturalSystem(system)
