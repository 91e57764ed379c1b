"""Periodic gaits by multiple shooting with a fixed mode sequence, solved by IPOPT."""

from gaitopt.nlp.family import Family as Family
from gaitopt.nlp.following import follow as follow
from gaitopt.nlp.integrator import integrate_to as integrate_to
from gaitopt.nlp.rollout import roll_out as roll_out
from gaitopt.nlp.solve import find_gait as find_gait
from gaitopt.nlp.solve import free_parameters as free_parameters
from gaitopt.nlp.solve import solve_gait as solve_gait
