"""Return map and Floquet multipliers of simulated motion."""

from gaitopt.orbit.return_map import ReturnMap as ReturnMap
