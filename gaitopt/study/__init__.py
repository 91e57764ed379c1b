"""One gait at a time: solve a given mode sequence, simulate, verify."""

from gaitopt.study.claims import Verification
from gaitopt.study.return_map import return_map
from gaitopt.study.simulate import Walk, simulate
from gaitopt.study.verify import verify

__all__ = [
    "Verification",
    "Walk",
    "return_map",
    "simulate",
    "verify",
]
