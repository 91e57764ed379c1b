"""Problems: YAML files that state which gait of which walker to compute, and how they are read, checked and changed."""

from gaitopt.problem.catalogue import problem_names
from gaitopt.problem.control_sections import (
    ConstantTorqueSpec,
    ControlSpec,
    CurveReference,
    GaitReference,
    NoControlSpec,
    PDSpec,
)
from gaitopt.problem.parts import Free, Guess, OpenSequence, Range
from gaitopt.problem.plausibility import NO_ENERGY, lacks_energy
from gaitopt.problem.problem import Problem, load_problem, parse_problem, restore_problem
from gaitopt.problem.record import cycle_data
from gaitopt.problem.scalars import SCALARS
from gaitopt.problem.schema import problem_schema
from gaitopt.problem.sections import FrictionCoefficients
from gaitopt.problem.source import parse_value

__all__ = [
    "NO_ENERGY",
    "SCALARS",
    "ConstantTorqueSpec",
    "ControlSpec",
    "CurveReference",
    "Free",
    "FrictionCoefficients",
    "GaitReference",
    "Guess",
    "NoControlSpec",
    "OpenSequence",
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
