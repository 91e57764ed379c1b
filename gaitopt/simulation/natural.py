"""The hybrid system in natural units, in which the engines integrate, locate events and decide.

    d zeta / d tau = T D^-1 flow(T tau, D zeta),      margins / their scales,      t = T tau,  z = D zeta

A tolerance is then a plain number, and no result depends on the units in which a problem is stated. The scale of the
margin ``painleve`` is the apparent mass of the foot, C_tt + mu s C_nt > SINGULAR C_tt with C_tt the mean of both slips.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from casadi import SX, Function, cse, repmat, vertcat

from gaitopt.arrays import Array
from gaitopt.model.buffered import Buffers
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.simulation.events import Point

SINGULAR = 1e-5
"""Apparent mass of a slipping foot, relative to that of a sticking one, at which no engine goes on with its slip.
Forces lose digits in proportion to its inverse: from 1e-6 on a Runge-Kutta method may take more than 20,000 steps
through 1e-8 s of such a slip, where a Taylor series gets through."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Units:
    """Natural units of one system at fixed parameters.

    Attributes
    ----------
    time, speed : [s], [m/s].
    state : ndarray, shape (n_z,) - units of the state.
    margins : for each mode the units of its margins, with ones behind them up to the number of margins in stick.
    parameters : for each mode the parameters of the functions of ``NaturalSystem``; the last are ``margins``.
    """

    time: float
    speed: float
    state: Array
    margins: dict[Mode, Array]
    parameters: dict[Mode, Array]

    def pack(self, state: Array, deviations: Array) -> tuple[Array, Array]:
        """A state and deviations (n_z, m), each of them scaled to size one, as one vector; and their sizes (m,)."""
        scaled = deviations / self.state[:, None]
        sizes = np.abs(scaled).max(axis=0)
        sizes[sizes == 0] = 1.0
        return np.concatenate([state / self.state, (scaled / sizes).ravel(order="F")]), sizes

    def unpack(self, y: Array, sizes: Array) -> Array:
        """The deviations of such a vector; shape (n_z, m)."""
        n_z = self.state.size
        return np.asarray(y[n_z:].reshape((n_z, -1), order="F") * sizes * self.state[:, None])


def units(dynamics: Dynamics) -> Units:
    """Natural units of a walker under its control law."""
    p, scales, state = dynamics.p, dynamics.scales, dynamics.state_units
    own = {mode: dynamics.margin_units(mode) for mode in dynamics.system.transitions.modes}
    most = max(map(len, own.values()))
    margins = {mode: np.append(values, np.ones(most - values.size)) for mode, values in own.items()}
    parameters = {mode: np.concatenate([p, [scales.time], state, values]) for mode, values in margins.items()}
    return Units(time=scales.time, speed=scales.speed, state=state, margins=margins, parameters=parameters)


class NaturalSystem:
    """Functions of a hybrid system in natural units; use ``natural_system``, which keeps them.

    Their arguments are (tau, zeta, parameters, r) with the parameters of ``Units`` and r as in ``HybridSystem``.
    """

    def __init__(self, system: HybridSystem) -> None:
        self._system = system
        self._functions: dict[str, Function] = {}
        n_z = system.n_z
        self._tau, self._r = SX.sym("tau"), SX.sym("r", system.n_r)
        self._p, self._time = SX.sym("p", len(system.parameters)), SX.sym("T")
        n_margins = max(len(system.transitions.of(mode)) for mode in system.transitions.modes)
        self._state, self._margins = SX.sym("D", n_z), SX.sym("S", n_margins)
        angles = {*system.walker.shape} - {*system.walker.lengths}  # they are their own unit
        self._d = vertcat(*(1 if name in angles else self._state[k] for k, name in enumerate(system.state_names)))
        self._all = vertcat(self._p, self._time, self._state, self._margins)

    def flow(self, mode: Mode) -> Function:
        """Rate of the state."""
        return self._build(f"flow_{mode.key}", lambda a: [self._rate(mode, a)])

    def point(self, mode: Mode) -> Function:
        """Rate of the state, margins and their rates."""
        return self._build(f"point_{mode.key}", lambda a: cse([self._rate(mode, a), *self._events(mode, a)]))

    def arc(self, mode: Mode) -> Function:
        """Rate of the state, and the margins below it."""
        return self._build(
            f"arc_{mode.key}", lambda a: [cse(vertcat(self._rate(mode, a), self._scaled(mode, a, self._margins)))]
        )

    def rest(self, mode: Mode, slips: tuple[Mode, ...]) -> Function:
        """What ``point`` gives of a sticking foot, and the margins of ``slips``, whose units are another argument."""
        units = SX.sym("S_slip", self._margins.numel())

        def outputs(a: list[SX]) -> list[SX]:
            margins = [self._scaled(slip, a, units) for slip in slips]
            return cse([self._rate(mode, a), *self._events(mode, a), *margins])

        return self._build(f"rest_{mode.key}", outputs, further=[units])

    def variational(self, mode: Mode, columns: int) -> Function:
        """Rate of the state and of ``columns`` deviations one after the other."""
        scale = repmat(self._d, 1 + columns, 1)
        original = self._system.variational(mode, columns)
        return self._build(
            f"variational_{mode.key}_{columns}", lambda a: [original(*a) * (self._time / scale)], scale=scale
        )

    def _rate(self, mode: Mode, arguments: list[SX]) -> SX:
        return self._system.flow(mode)(*arguments) * (self._time / self._d)

    def _events(self, mode: Mode, arguments: list[SX]) -> list[SX]:
        margins, rates = self._system.events(mode)(*arguments)
        units = self._margins[: margins.numel()]
        scaled, scaled_rates = margins / units, rates * (self._time / units)
        if mode.slips:
            k, (other, other_rates) = self._place(mode, "painleve"), self._system.events(_reversed(mode))(*arguments)
            foot, foot_rate = (margins[k] + other[k]) / 2, (rates[k] + other_rates[k]) / 2
            scaled[k] = margins[k] / foot - SINGULAR
            scaled_rates[k] = (rates[k] - margins[k] / foot * foot_rate) * (self._time / foot)
        return [scaled, scaled_rates]

    def _place(self, mode: Mode, margin: str) -> int:
        return self._system.transitions.margin_names(mode).index(margin)

    def _scaled(self, mode: Mode, arguments: list[SX], units: SX) -> SX:
        margins = self._system.margins(mode)(*arguments)
        scaled = margins / units[: margins.numel()]
        if mode.slips:
            k, other = self._place(mode, "painleve"), self._system.margins(_reversed(mode))(*arguments)
            scaled[k] = 2 * margins[k] / (margins[k] + other[k]) - SINGULAR
        return scaled

    def _build(
        self,
        name: str,
        outputs: Callable[[list[SX]], list[SX]],
        scale: SX | None = None,
        further: Sequence[SX] = (),
    ) -> Function:
        if name not in self._functions:
            scale = self._d if scale is None else scale
            zeta = SX.sym("zeta", scale.numel())
            arguments = [self._time * self._tau, scale * zeta, self._p, self._r]
            inputs = [self._tau, zeta, self._all, self._r, *further]
            self._functions[name] = Function(name, inputs, outputs(arguments))
        return self._functions[name]


class PointFunctions:
    """Rate of the state, margins and their rates in every mode of a system at fixed parameters.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    units : its natural units.
    """

    def __init__(self, dynamics: Dynamics, units: Units) -> None:
        self._natural, self._units = natural_system(dynamics.system), units
        self._functions: dict[Mode, Buffers] = {}
        self._at_rest: dict[Mode, Buffers] = {}

    def __call__(self, mode: Mode, tau: float, zeta: Array, data: Array) -> Point:
        """The point of a motion in one mode."""
        if mode not in self._functions:
            self._functions[mode] = function = Buffers(self._natural.point(mode))
            function.inputs[2][:] = self._units.parameters[mode]
        flow, margins, rates = _evaluated(self._functions[mode], tau, zeta, data)
        return Point(tau, zeta, flow.copy(), margins.tolist(), rates.tolist())

    def at_rest(
        self, mode: Mode, slips: tuple[Mode, ...], tau: float, zeta: Array, data: Array
    ) -> tuple[Point, list[list[float]]]:
        """The point of a motion with the foot at rest, and the margins of the ``slips`` there."""
        if mode not in self._at_rest:
            self._at_rest[mode] = function = Buffers(self._natural.rest(mode, slips))
            function.inputs[2][:] = self._units.parameters[mode]
            for slip in slips[:1]:
                function.inputs[4][:] = self._units.margins[slip]
        flow, margins, rates, *slipping = _evaluated(self._at_rest[mode], tau, zeta, data)
        point = Point(tau, zeta, flow.copy(), margins.tolist(), rates.tolist())
        return point, [values.tolist() for values in slipping]


def _evaluated(function: Buffers, tau: float, zeta: Array, data: Array) -> tuple[Array, ...]:
    """Outputs at a point with the parameters as they are, valid until the next call."""
    time, state, _, segment, *_ = function.inputs
    time[0], state[:], segment[:] = tau, zeta, data
    function.evaluate()
    return function.outputs


def _reversed(mode: Mode) -> Mode:
    """The slip in the other direction."""
    return mode.with_contact(Mode.slip(-mode.direction))


@lru_cache(maxsize=16)
def natural_system(system: HybridSystem) -> NaturalSystem:
    """The functions of a system in natural units, built on first use and kept."""
    return NaturalSystem(system)
