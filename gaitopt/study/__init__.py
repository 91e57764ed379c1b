"""One gait at a time: solve a given mode sequence, simulate, verify."""

from gaitopt.study.claims import Claim, Verification
from gaitopt.study.return_map import Returns, return_map
from gaitopt.study.simulate import Walk, simulate
from gaitopt.study.system import build_system, gait_reference, problem_dynamics, solve_sequence
from gaitopt.study.verify import verify

__all__ = [
    "Claim",
    "Returns",
    "Verification",
    "Walk",
    "build_system",
    "gait_reference",
    "problem_dynamics",
    "return_map",
    "simulate",
    "solve_sequence",
    "verify",
]
