"""Problems: YAML files that state which gait of which walker to compute, and how they are read, checked and changed."""

from gaitopt.problem.catalogue import problem_names as problem_names
from gaitopt.problem.control_sections import CurveReference as CurveReference
from gaitopt.problem.control_sections import PDSpec as PDSpec
from gaitopt.problem.parts import Range as Range
from gaitopt.problem.plausibility import lacks_energy as lacks_energy
from gaitopt.problem.problem import Problem as Problem
from gaitopt.problem.problem import load_problem as load_problem
from gaitopt.problem.problem import parse_problem as parse_problem
from gaitopt.problem.problem import restore_problem as restore_problem
from gaitopt.problem.record import cycle_data as cycle_data
from gaitopt.problem.scalars import SCALARS as SCALARS
from gaitopt.problem.schema import problem_schema as problem_schema
from gaitopt.problem.source import parse_value as parse_value
