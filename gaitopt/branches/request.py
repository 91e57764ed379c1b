"""The request of a continuation: the parameter, its targets and bounds, and which other branches to follow.

A problem with one coefficient of friction may be continued in the static or the kinetic coefficient, and a problem with
two equal coefficients in ``friction``, because the gait is the same under the other friction law.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any

import numpy as np

from gaitopt.branches.monitors import BIFURCATIONS, TestFunction
from gaitopt.errors import ProblemError, SolveError, UnknownNameError
from gaitopt.gait.branch import TERMINAL, SpecialPoint
from gaitopt.gait.gait import Gait, Status, require_gait
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import STATIC_KINETIC
from gaitopt.model.system import HybridSystem
from gaitopt.problem.faults import nearest_keys
from gaitopt.problem.problem import Problem
from gaitopt.problem.schema import FrictionCoefficients
from gaitopt.requests import ContinueRequest
from gaitopt.systems import problem_dynamics

FOLLOWS = {
    "period_doubling": "doublings",
    "branch_point": "branch_points",
    "mode_change": "mode_changes",
    "impact_change": "mode_changes",
}
"""The key of ``Request.follow`` for every type of special point at which other branches begin."""
LATER_PARAMETERS = ("friction.", "control.reference.", "control.step_feedback.")
"""Beginnings of parameters that a problem may only have under another friction law, or once its law is computed."""
LARGEST_LENGTH = 0.025
"""Largest arclength of a step: at least forty points for the range of the parameter."""


@dataclass(frozen=True, kw_only=True)
class Request(ContinueRequest):
    """The parameter of a family, its range, and which of the branches that begin on the family are followed too.

    By default the target is one bound; the other bound is as far from the first gait on the other side. A branch that
    reaches a limit of points or time can be resumed.

    Attributes
    ----------
    events : functions of a gait, continuous along the family; their zeros are special points with these names.
    follow : for each kind of branch (the values of ``FOLLOWS``), the number of levels to which branches are followed.
    largest_length : largest arclength of a step; the range of the parameter has length one.
    """

    events: Mapping[str, TestFunction] = field(default_factory=dict)
    follow: Mapping[str, int] = field(default_factory=dict)
    largest_length: float = LARGEST_LENGTH

    def begin(self, start: Gait | SpecialPoint) -> Gait | SpecialPoint:
        """The start of the continuation: the gait of a special point if its branch is in another parameter."""
        other = isinstance(start, SpecialPoint) and start.parameter not in ("", self.parameter)
        return start.gait if isinstance(start, SpecialPoint) and other and start.gait is not None else start

    def first_gait(self, start: Gait | SpecialPoint) -> Gait:
        """The gait at which the family begins, with the friction law that has the parameter.

        Raises
        ------
        UnknownNameError
            If the gait has no such continuous parameter, or if an event has the name of a type of special point.
        ProblemError
            If ``start`` is a problem, if the parameter cannot have the value of a target or has it already, or if a
            target lies beyond a bound.
        SolveError
            If there is no gait.
        """
        require_gait(start, "continuation")
        stated = start if isinstance(start, Gait) else start.gait
        if stated is None:
            raise SolveError(f"there is no gait at the special point {start!r}")
        if not stated.steps:
            raise SolveError(
                f"{stated.problem.name} is {stated.status}, so there is nothing to continue: {stated.message}"
            )
        gait = _with_friction(stated, self.parameter)
        check_parameter(gait.problem, self.parameter, gait.system.parameters)
        taken = ", ".join(sorted(set(self.events) & {*BIFURCATIONS, *TERMINAL, "mode_change", "impact_change"}))
        if taken:
            raise UnknownNameError(f"events: {taken} is a special point already; choose another name")
        value = gait.dynamics.parameter(self.parameter)
        for to in self.to:
            if to == value or not np.isfinite(to):
                raise ProblemError(
                    f"{self.parameter} is {value:g} at the start: the target must be another finite value"
                )
            objection = gait.problem.objection(self.parameter, to)
            if objection:
                raise ProblemError(f"{to:g}: {self.parameter}: {objection}").concerning("to")
            if self.lower is not None and min(to, value) < self.lower:
                raise ProblemError(f"{self.parameter}: {min(to, value):g} lies below the bound {self.lower:g}")
            if self.upper is not None and max(to, value) > self.upper:
                raise ProblemError(f"{self.parameter}: {max(to, value):g} lies above the bound {self.upper:g}")
        return gait

    def towards(self, targets: Sequence[float], gait: Gait) -> "Request":
        """The request of one continuation from ``gait``, with both bounds set."""
        value, known = gait.dynamics.parameter(self.parameter), gait.dynamics.parameters
        smallest = known["friction.kinetic"] if self.parameter == "friction.static" else -inf
        largest = known["friction.static"] if self.parameter == "friction.kinetic" else inf
        span = max(abs(to - value) for to in targets)
        lower = value - span if self.lower is None else self.lower
        upper = value + span if self.upper is None else self.upper
        return replace(
            self,
            to=tuple(targets),
            lower=max(min((to for to in targets if to < value), default=lower), smallest),
            upper=min(max((to for to in targets if to > value), default=upper), largest),
        )

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound; infinite if there is none."""
        return -inf if self.lower is None else self.lower, inf if self.upper is None else self.upper

    def crossed(self, before: float, after: float) -> float | None:
        """The bound that a step of the parameter reaches or passes from inside; None if it stays within the bounds."""
        lower, upper = self.bounds
        if after >= upper > before:
            return upper
        return lower if after <= lower < before else None

    def bound_reached(self, value: float) -> str | None:
        """The reason why a continuation ends at a value of the parameter; None if the value is within the bounds."""
        lower, upper = self.bounds
        return None if lower < value < upper else f"reached {self.parameter} = {max(lower, min(value, upper)):.12g}"

    def exhausted(self, points: int, seconds: float = 0.0) -> str | None:
        """The reason why a continuation pauses after this number of points and this time; None if it proceeds."""
        if points >= self.max_points:
            return f"paused at the limit of {self.max_points} points"
        if self.max_seconds is not None and seconds > self.max_seconds:
            return f"paused at the limit of {self.max_seconds:g} s"
        return None

    def to_record(self) -> dict[str, Any]:
        """One JSON object, the first line of a stored branch; events are left out, because they are functions."""
        followed = {kind: times for kind, times in self.follow.items() if times}
        return {"record": "continuation", **self.arguments, "to": list(self.to), **followed}


def check_parameter(problem: Problem, key: str, known: Sequence[str] = ()) -> None:
    """Refuse a parameter along which a problem has no family.

    Parameters
    ----------
    known : the parameters of its gait. By default those of the problem file; what a gait may have beyond them, see
        ``LATER_PARAMETERS``, is then not refused.

    Raises
    ------
    UnknownNameError
        If there is no such parameter, or if it is a whole number.
    """
    names, may_come = known or tuple(problem.parameters), key == "friction" or key.startswith(LATER_PARAMETERS)
    if key not in names and (known or not may_come):
        raise UnknownNameError(f"{key} is not a parameter of {problem.name}{nearest_keys(key, names)}")
    if isinstance(problem.parameters.get(key), int):
        fault = "is a whole number, along which there is no family; solve for one value at a time"
        raise UnknownNameError(f"{key}: {fault}").concerning("parameter")


def motionless_gait(problem: Problem, parameter: str) -> Gait:
    """A gait without a motion, with the problem and the dynamics of the family of ``problem`` along ``parameter``."""
    stated = Gait(problem=problem, dynamics=problem_dynamics(problem), status=Status.CONVERGED, message="")
    return _with_friction(stated, parameter)


def _with_friction(gait: Gait, parameter: str) -> Gait:
    """The same gait under the friction law that has ``parameter``; the gait itself for all other parameters.

    Raises
    ------
    ProblemError
        If ``parameter`` is ``friction`` and the coefficients differ.
    """
    if parameter in gait.system.parameters or parameter.partition(".")[0] != "friction":
        return gait
    friction = gait.problem.friction
    coefficients: float | FrictionCoefficients
    if isinstance(friction, float):
        if parameter not in STATIC_KINETIC.parameters:
            return gait
        value = gait.dynamics.static_friction
        coefficients = FrictionCoefficients(static=value, kinetic=value)
    elif isinstance(friction, Mapping):
        raise ProblemError(
            f"every contact has a friction of its own: vary one of {', '.join(gait.system.friction.parameters)}"
        )
    elif friction.static != friction.kinetic or friction.viscous:
        numbers = ", ".join(f"{name} = {value:g}" for name, value in friction)
        raise ProblemError(
            f"friction has several coefficients, {numbers}: vary friction.static, friction.kinetic or friction.viscous"
        )
    else:
        coefficients = friction.static
    problem = replace(gait.problem, friction=coefficients)
    law, end = problem.friction_law, problem.cycle_end
    system = HybridSystem(gait.system.walker, gait.system.control, gait.system.law, law, end)
    dynamics = Dynamics.of(system, {**problem.parameters, **gait.dynamics.parameters})
    return replace(gait, problem=problem, dynamics=dynamics)
