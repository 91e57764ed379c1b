"""What a user does with problems and gaits: solve, verify, simulate."""

from gaitopt.nlp import Neighbourhood, neighbourhood
from gaitopt.study.batch import Returns, return_map
from gaitopt.study.claims import Claim, Verification
from gaitopt.study.distinct import Gaits
from gaitopt.study.explain import Explanation, explain
from gaitopt.study.find import find
from gaitopt.study.own import solve_as_own
from gaitopt.study.simulate import Walk, simulate
from gaitopt.study.solve import solve
from gaitopt.study.system import build_system, gait_reference
from gaitopt.study.verify import verify

__all__ = [
    "Claim",
    "Explanation",
    "Gaits",
    "Neighbourhood",
    "Returns",
    "Verification",
    "Walk",
    "build_system",
    "explain",
    "find",
    "gait_reference",
    "neighbourhood",
    "return_map",
    "simulate",
    "solve",
    "solve_as_own",
    "verify",
]
