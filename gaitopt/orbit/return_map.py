"""The return map of the forward simulator on the section just after an impact, and its fixed points.

xi -> Pi(xi),      Newton:  xi - (DPi - I)^-1 (Pi(xi) - xi)                Gamus & Or (2013), section II.C
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait import Ending, Step
from gaitopt.iteration import iterate
from gaitopt.mechanics import Mode
from gaitopt.orbit.step_sensitivity import StepSensitivity
from gaitopt.simulation import Simulator

ROUNDING = 1e-12
"""Error of a simulated step in natural units, as far as it is not amplified."""
NEWTON_STEPS = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Return:
    """One application of the return map.

    Attributes
    ----------
    xi : ndarray, shape (n_xi,) - section coordinates after the cycle, or None if it did not return to this section.
    steps : the simulated steps.
    ending, message : ``completed``, or why it did not return.
    """

    xi: Array | None
    steps: tuple[Step, ...]
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
    steps : the steps from ``xi``.
    jacobian : ndarray, shape (n_xi, n_xi) - derivative of the map at ``xi``, or None.
    message : how it ended.
    """

    xi: Array
    residual: float
    accuracy: float
    steps: tuple[Step, ...]
    jacobian: Array | None
    message: str

    @property
    def converged(self) -> bool:
        """Whether the residual is down at rounding."""
        return self.residual <= self.accuracy


class ReturnMap:
    """Return map of a simulator, after one or more steps, on the section of one kind of impact."""

    def __init__(self, simulator: Simulator, section_mode: Mode, n_steps: int = 1) -> None:
        self.simulator, self.section_mode, self.n_steps = simulator, section_mode, n_steps
        self._indices = simulator.system.section(section_mode)
        self._units = simulator.dynamics.state_units[self._indices]
        self._sensitivity = StepSensitivity(simulator.dynamics, section_mode, simulator.stepper)

    def __call__(self, xi: Array) -> Return:
        """Simulate one cycle from section coordinates ``xi``."""
        trajectory = self.simulator.run(self.simulator.dynamics.lift(xi), steps=self.n_steps)
        steps, ending = trajectory.steps, trajectory.ending
        impact = steps[-1].impact if len(steps) == self.n_steps else None
        if impact is None:
            return Return(xi=None, steps=steps, ending=ending, message=trajectory.message)
        if (impact.mode.sticks) is not (self.section_mode.sticks):
            message = f"the impact ends with {impact.mode}, off the section of {self.section_mode}"
            return Return(xi=None, steps=steps, ending=ending, message=message)
        return Return(xi=impact.state[self._indices], steps=steps, ending=ending, message=trajectory.message)

    def jacobian(self, steps: Sequence[Step]) -> Array:
        """Derivative of the map along one of its cycles; shape (n_xi, n_xi)."""
        return self._sensitivity.jacobian(steps)

    def fixed_point(self, xi: Array) -> FixedPoint:
        """Newton's method from ``xi`` until Pi(xi) = xi up to rounding."""

        def following(point: FixedPoint) -> FixedPoint | None:
            if point.jacobian is None:
                return None
            defect = (point.steps[-1].final_impact.state[self._indices] - point.xi) / self._units
            newton = np.linalg.lstsq(self._scaled(point.jacobian) - np.eye(xi.size), defect, rcond=None)[0]
            return self._evaluate(point.xi - newton * self._units)

        return iterate(
            self._evaluate(xi),
            following,
            size=lambda point: point.residual,
            solved=lambda point: point.converged,
            most=NEWTON_STEPS,
        ).at

    def _evaluate(self, xi: Array) -> FixedPoint:
        result = self(xi)
        if result.xi is None:
            return FixedPoint(
                xi=xi, residual=np.inf, accuracy=ROUNDING, steps=result.steps, jacobian=None, message=result.message
            )
        residual = float(np.abs((result.xi - xi) / self._units).max())
        derivative = self.jacobian(result.steps)
        if not np.isfinite(derivative).all():
            message = "the walk grazes an event, where the return map has no derivative"
            return FixedPoint(
                xi=xi, residual=residual, accuracy=ROUNDING, steps=result.steps, jacobian=None, message=message
            )
        accuracy = ROUNDING * max(1.0, float(np.linalg.norm(self._scaled(derivative), np.inf)))
        return FixedPoint(
            xi=xi,
            residual=residual,
            accuracy=accuracy,
            steps=result.steps,
            jacobian=derivative,
            message=result.message,
        )

    def _scaled(self, jacobian: Array) -> Array:
        """The derivative of the map in natural units."""
        return jacobian * self._units / self._units[:, None]
