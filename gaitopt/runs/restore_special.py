"""A special point of a stored branch with its gait, so that the other branches through it can be followed."""

from collections.abc import Mapping
from typing import Any

from gaitopt.errors import ProblemError
from gaitopt.families.coefficients import with_friction
from gaitopt.families.records import restored_special
from gaitopt.gait import Gait, SpecialPoint, Status
from gaitopt.problem import Problem
from gaitopt.study.system import problem_dynamics


def restore_special(problem: Problem, parameter: str, record: Mapping[str, Any]) -> SpecialPoint:
    """The special point that a record of a branch of ``problem`` along ``parameter`` holds.

    Raises
    ------
    ProblemError
        If the branch is one of designs, whose free parameters it does not hold.
    """
    if problem.free:
        raise ProblemError(
            f"{problem.name} has free parameters: fix them at the values of the design, and continue that"
        )
    family = Gait(problem=problem, dynamics=problem_dynamics(problem), status=Status.CONVERGED, message="")
    return restored_special(with_friction(family, parameter), parameter, record)
