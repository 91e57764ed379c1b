"""Designs: gaits with free parameters, an objective and constraints, optimal for the problem as it is stated."""

from gaitopt.nlp.design.design import design_gait as design_gait
from gaitopt.nlp.design.neighbourhood import Neighbourhood as Neighbourhood
from gaitopt.nlp.design.neighbourhood import neighbourhood as neighbourhood
