"""Return map and Floquet multipliers of simulated motion."""

from gaitopt.orbit.damped import damped_fixed_point
from gaitopt.orbit.return_map import FixedPoint, Return, ReturnMap
from gaitopt.orbit.step_sensitivity import StepSensitivity

__all__ = ["FixedPoint", "Return", "ReturnMap", "StepSensitivity", "damped_fixed_point"]
