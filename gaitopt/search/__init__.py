"""Gaits found, not guessed: over all mode sequences, from the gait of a problem's file, and why there is none."""

from gaitopt.search.distinct import Gaits
from gaitopt.search.explain import Explanation, explain
from gaitopt.search.find import STARTS, find
from gaitopt.search.own import solve_as_own
from gaitopt.search.solve import solve

__all__ = ["STARTS", "Explanation", "Gaits", "explain", "find", "solve", "solve_as_own"]
