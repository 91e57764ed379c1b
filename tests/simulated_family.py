"""Special points of a family by the forward simulator alone, as an oracle for the continuation.

Fixed points of the simulated return map at one value of the parameter after the other, by chords. Between them:

    change of modes      bisection on the modes that the simulator goes through
    end of sticking      mu F_n - |F_t| = 0 at the impact, or of the force after it, approached from where it sticks
    loss of stability    |lambda| = 1 or lambda = -1, multipliers by saltation
    fold                 lambda = 1 along the curve, which a section coordinate parametrises
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from gaitopt import Gait, Mode
from gaitopt.gait.gait import floquet_multipliers
from gaitopt.gait.measures import observe
from gaitopt.gait.trajectory import Step
from gaitopt.model.dynamics import Dynamics
from gaitopt.simulation.simulator import Simulator
from gaitopt.verification.return_map import ReturnMap

Array = NDArray[np.float64]

CHORDS = 60
ROUNDING = 2e-13
"""Rounding of a simulated step."""
DIFFERENCE = 1e-5
"""Difference of the parameter for the derivative of a chord, which need not be accurate."""
CLOSER = 0.1
"""Ratio of successive distances in a one-sided approach."""


@dataclass
class SimulatedFamily:
    """Fixed points of the simulator along a parameter.

    Parameters
    ----------
    gait : its system, and the values of the other parameters.
    parameter : dotted key.
    section : the kind of impact, which decides whether the slip velocity is a section coordinate.
    xi : ndarray - a guess of the section coordinates, a few digits are enough.
    """

    gait: Gait
    parameter: str
    section: Mode
    xi: Array
    _inverse: Array | None = field(default=None, init=False)
    _solved: list[tuple[float, Array]] = field(default_factory=list, init=False)

    def map_at(self, value: float) -> ReturnMap:
        p = self.gait.p.copy()
        p[self.gait.system.parameters.index(self.parameter)] = value
        return ReturnMap(Simulator(Dynamics(self.gait.system, p)), self.section)

    def step_at(self, value: float) -> Step | None:
        """The periodic step at a value; None where there is none with this kind of impact."""
        walk, xi = self.map_at(value), self._predicted(value)
        if self._inverse is None:
            steps = walk(xi).steps
            self._inverse = np.linalg.inv(walk.jacobian(steps) - np.eye(xi.size))
        for _ in range(CHORDS):
            returned = walk(xi)
            if returned.xi is None:
                return None
            defect = returned.xi - xi
            if np.abs(defect).max() < ROUNDING:
                self._solved = [*self._solved[-1:], (value, xi)]
                return returned.steps[0]
            xi = xi - self._inverse @ defect
        raise AssertionError(f"chords leave a residual of {np.abs(defect).max():.2g} at {self.parameter} = {value}")

    def _predicted(self, value: float) -> Array:
        """The prediction on the line through the last two fixed points."""
        if len(self._solved) < 2:
            return self._solved[-1][1] if self._solved else self.xi
        (first, at_first), (second, at_second) = self._solved
        if first == second:
            return at_second
        return at_second + (at_second - at_first) * (value - second) / (second - first)

    def modes_at(self, value: float) -> tuple[Mode, ...]:
        step = self.step_at(value)
        return tuple(mode for mode, _ in step.phases)

    def multipliers_at(self, value: float) -> NDArray[np.complex128]:
        step = self.step_at(value)
        return floquet_multipliers(self.map_at(value).jacobian([step]))

    def change_of_modes(self, low: float, high: float) -> float:
        """The value between two others at which the modes change."""
        below = self.modes_at(low)
        assert self.modes_at(high) != below
        while high - low > 2e-10:
            middle = (low + high) / 2
            low, high = (middle, high) if self.modes_at(middle) == below else (low, middle)
        return (low + high) / 2

    def crossing(self, function: Callable[[NDArray[np.complex128]], float], low: float, high: float) -> float:
        """The value at which a function of the multipliers is zero."""
        return float(brentq(lambda value: function(self.multipliers_at(value)), low, high, xtol=1e-12))

    def impact_margin(self, value: float) -> float:
        """mu F_n - |F_t| of an impact that sticks [N s]."""
        step = self.step_at(value)
        assert step.impact is not None
        F_t, F_n = step.impact.stick_impulse
        return self._friction(value) * float(F_n) - abs(float(F_t))

    def start_margin(self, value: float) -> float:
        """mu f_n - |f_t| of a foot that sticks at the start of the step [N]."""
        step = self.step_at(value)
        assert step.arcs[0].mode is Mode.STICK
        f_t, f_n = observe(step.arcs[0]).force[0]
        return self._friction(value) * float(f_n) - abs(float(f_t))

    def approach(self, margin: Callable[[float], float], first: float, second: float) -> float:
        """The value at which a margin falls to zero, from two values where it is positive, the second one nearer."""
        values, margins, root = [first, second], [margin(first), margin(second)], np.inf
        while abs(values[-1] - root) > 1e-8:
            slope = (margins[-1] - margins[-2]) / (values[-1] - values[-2])
            root = values[-1] - margins[-1] / slope
            values.append(root + CLOSER * (values[-1] - root))
            margins.append(margin(values[-1]))
        return root

    def _friction(self, value: float) -> float:
        return self.map_at(value).simulator.dynamics.parameter("friction")

    def fold(self, value: float, reach: float) -> float:
        """The extremum of the parameter; the first section coordinate within ``reach`` of the guess leads over it."""
        centre, unknown = self.xi[0], np.append(self.xi[1:], value)
        steps = self.map_at(value)(self.xi).steps
        ahead, behind = (self.map_at(value + h)(self.xi).xi for h in (DIFFERENCE, -DIFFERENCE))
        by_state = self.map_at(value).jacobian(steps) - np.eye(self.xi.size)
        inverse = np.linalg.inv(np.column_stack([by_state[:, 1:], (ahead - behind) / (2 * DIFFERENCE)]))

        def solve(coordinate: float) -> tuple[float, Array]:
            u = unknown
            for _ in range(CHORDS):
                xi = np.append(coordinate, u[:-1])
                defect = self.map_at(u[-1])(xi).xi - xi
                if np.abs(defect).max() < ROUNDING:
                    return float(u[-1]), xi
                u = u - inverse @ defect
            raise AssertionError(f"chords leave a residual of {np.abs(defect).max():.2g} next to the fold")

        def from_one(coordinate: float) -> float:
            at, xi = solve(coordinate)
            walk = self.map_at(at)
            return float(np.linalg.det(walk.jacobian(walk(xi).steps) - np.eye(xi.size)))

        return solve(brentq(from_one, centre - reach, centre + reach, xtol=1e-10))[0]
