"""Periodic gaits by multiple shooting with a fixed mode sequence, solved by IPOPT."""

from gaitopt.nlp.family import Family
from gaitopt.nlp.find import find_gait
from gaitopt.nlp.integrator import integrate_to
from gaitopt.nlp.rollout import roll_out
from gaitopt.nlp.solve import solve_gait
from gaitopt.nlp.start import free_parameters

__all__ = [
    "Family",
    "find_gait",
    "free_parameters",
    "integrate_to",
    "roll_out",
    "solve_gait",
]
