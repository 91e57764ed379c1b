"""Periodic gaits by multiple shooting with a fixed mode sequence, solved by IPOPT."""

from gaitopt.nlp.design import Neighbourhood, find_gait, neighbourhood
from gaitopt.nlp.family import Family
from gaitopt.nlp.integrator import integrate_to
from gaitopt.nlp.rollout import roll_out
from gaitopt.nlp.solve import solve_gait
from gaitopt.nlp.start import free_parameters

__all__ = [
    "Family",
    "Neighbourhood",
    "find_gait",
    "free_parameters",
    "integrate_to",
    "neighbourhood",
    "roll_out",
    "solve_gait",
]
