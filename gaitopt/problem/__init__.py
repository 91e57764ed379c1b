"""Problems: YAML files that state which gait of which walker to compute, and how they are read, checked and changed."""

from gaitopt.problem.catalogue import problem_names
from gaitopt.problem.control_sections import CurveReference, PDSpec
from gaitopt.problem.parts import Range
from gaitopt.problem.plausibility import lacks_energy
from gaitopt.problem.problem import Problem, load_problem, parse_problem, restore_problem
from gaitopt.problem.record import cycle_data
from gaitopt.problem.scalars import SCALARS
from gaitopt.problem.schema import problem_schema
from gaitopt.problem.source import parse_value

__all__ = [
    "SCALARS",
    "CurveReference",
    "PDSpec",
    "Problem",
    "Range",
    "cycle_data",
    "lacks_energy",
    "load_problem",
    "parse_problem",
    "parse_value",
    "problem_names",
    "problem_schema",
    "restore_problem",
]
