"""Return map and Floquet multipliers of simulated motion."""

from gaitopt.orbit.return_map import FixedPoint, Return, ReturnMap
from gaitopt.orbit.variational import return_map_jacobian

__all__ = ["FixedPoint", "Return", "ReturnMap", "return_map_jacobian"]
