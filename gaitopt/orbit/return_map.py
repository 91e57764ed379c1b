"""The return map of the forward simulator on the section just after an impact, and its fixed points.

xi -> Pi(xi),      Newton:  xi - (DPi - I)^-1 (Pi(xi) - xi)                Gamus & Or (2013), section II.C
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitopt.gait import Ending, Step
from gaitopt.mechanics import Mode
from gaitopt.orbit.variational import StepVariation
from gaitopt.simulation import Simulator
from gaitopt.simulation.natural import units

Array = NDArray[np.float64]

ROUNDING = 1e-12
"""Error of a simulated step in natural units, as far as it is not amplified."""
NEWTON_STEPS = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Return:
    """One application of the return map.

    Attributes
    ----------
    xi : ndarray, shape (n_xi,) - section coordinates after the step, or None if it did not return to this section.
    step : the simulated step, or None where there is none.
    ending, message : ``completed``, or why it did not return.
    """

    xi: Array | None
    step: Step | None
    ending: Ending
    message: str


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedPoint:
    """Outcome of Newton's method on the return map.

    Attributes
    ----------
    xi : ndarray, shape (n_xi,) - last iterate.
    residual : largest entry of Pi(xi) - xi in natural units; infinite where the map is not defined.
    accuracy : residual below which rounding leaves nothing to improve; what happens early in a step is amplified by
        the derivative of the map.
    step : the step from ``xi``, or None.
    jacobian : ndarray, shape (n_xi, n_xi) - derivative of the map at ``xi``, or None.
    message : how it ended.
    """

    xi: Array
    residual: float
    accuracy: float
    step: Step | None
    jacobian: Array | None
    message: str

    @property
    def converged(self) -> bool:
        """Whether the residual is down at rounding."""
        return self.residual <= self.accuracy


class ReturnMap:
    """Return map of a simulator on the section of one kind of impact."""

    def __init__(self, simulator: Simulator, section_mode: Mode) -> None:
        self.simulator, self.section_mode = simulator, section_mode
        self._system, self._p = simulator.system, simulator.p
        self._indices = simulator.system.section(section_mode)
        self._units = units(self._system, self._p).state[self._indices]
        self._variation = StepVariation(self._system, self._p, section_mode, simulator.stepper)

    def __call__(self, xi: Array) -> Return:
        """Simulate one step from section coordinates ``xi``."""
        trajectory = self.simulator.run(self._system.lift_state(xi, self._p), steps=1)
        step = trajectory.steps[-1] if trajectory.steps else None
        if step is None or step.impact is None:
            return Return(xi=None, step=step, ending=trajectory.ending, message=trajectory.message)
        if (step.impact.mode is Mode.STICK) is not (self.section_mode is Mode.STICK):
            message = f"the impact ends with {step.impact.mode}, off the section of {self.section_mode}"
            return Return(xi=None, step=step, ending=trajectory.ending, message=message)
        return Return(
            xi=step.impact.state[self._indices], step=step, ending=trajectory.ending, message=trajectory.message
        )

    def jacobian(self, step: Step) -> Array:
        """Derivative of the map along one of its steps; shape (n_xi, n_xi)."""
        return self._variation.jacobian(step)

    def fixed_point(self, xi: Array) -> FixedPoint:
        """Newton's method from ``xi`` until Pi(xi) = xi up to rounding."""
        point = self._evaluate(xi)
        for _ in range(NEWTON_STEPS):
            if point.converged or point.jacobian is None or point.step is None or point.step.impact is None:
                break
            defect = (point.step.impact.state[self._indices] - point.xi) / self._units
            newton = np.linalg.lstsq(self._scaled(point.jacobian) - np.eye(xi.size), defect, rcond=None)[0]
            candidate = self._evaluate(point.xi - newton * self._units)
            if not candidate.residual < point.residual:
                break
            point = candidate
        return point

    def _evaluate(self, xi: Array) -> FixedPoint:
        result = self(xi)
        if result.xi is None or result.step is None:
            return FixedPoint(
                xi=xi, residual=np.inf, accuracy=ROUNDING, step=result.step, jacobian=None, message=result.message
            )
        residual = float(np.abs((result.xi - xi) / self._units).max())
        derivative = self.jacobian(result.step)
        if not np.isfinite(derivative).all():
            message = "the walk grazes an event, where the return map has no derivative"
            return FixedPoint(
                xi=xi, residual=residual, accuracy=ROUNDING, step=result.step, jacobian=None, message=message
            )
        accuracy = ROUNDING * max(1.0, float(np.linalg.norm(self._scaled(derivative), np.inf)))
        return FixedPoint(
            xi=xi,
            residual=residual,
            accuracy=accuracy,
            step=result.step,
            jacobian=derivative,
            message=result.message,
        )

    def _scaled(self, jacobian: Array) -> Array:
        """The derivative of the map in natural units."""
        return jacobian * self._units / self._units[:, None]
