"""The request of a continuation: the parameter, its targets and bounds, and which other branches to follow.

A coefficient of friction that the problem does not have by itself may be asked for as well: where the static and the
kinetic one are equal, a gait with one coefficient is a gait with two, and conversely.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from math import inf
from typing import Any

import numpy as np

from gaitopt.branches.monitors import BIFURCATIONS, TestFunction
from gaitopt.errors import ProblemError, SolveError, UnknownNameError
from gaitopt.gait.branch import TERMINAL
from gaitopt.gait.gait import Gait, Status
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import CoulombFriction, Friction, StaticKineticFriction
from gaitopt.model.system import HybridSystem
from gaitopt.problem.faults import nearest_keys
from gaitopt.problem.problem import Problem
from gaitopt.problem.schema import FrictionCoefficients
from gaitopt.systems import problem_dynamics

FOLLOWS = {
    "period_doubling": "doublings",
    "branch_point": "branch_points",
    "mode_change": "mode_changes",
    "impact_change": "mode_changes",
}
"""The kind of branches, a key of ``Request.follow``, that begin at a special point of some type."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """Which family, how far, and which of the branches that begin on it.

    Attributes
    ----------
    parameter : dotted key of a scalar of walker, friction or control.
    to : values of the parameter at which to stop, one after the other, each time from the first gait.
    lower, upper : bounds of the parameter for families that turn back; None stands for the target, and on the other
        side of the first gait for the same distance from it.
    events : functions of a gait, continuous along the family; their zeros are special points with these names.
    max_points, max_seconds : limits of the work towards each target; a branch that reaches one can be resumed.
    verify_every : every so many points is confirmed by the simulator, 0 for none.
    follow : by kind (see ``FOLLOWS``), to which depth the other branches of special points are followed as well.
    """

    parameter: str
    to: tuple[float, ...]
    lower: float | None = None
    upper: float | None = None
    events: Mapping[str, TestFunction] = field(default_factory=dict)
    max_points: int = 2000
    max_seconds: float | None = None
    verify_every: int = 10
    follow: Mapping[str, int] = field(default_factory=dict)

    def towards(self, targets: Sequence[float], gait: Gait) -> "Request":
        """The request of one walk from ``gait``, with both bounds set."""
        value = gait.dynamics.parameter(self.parameter)
        least, largest = _coefficient_bounds(gait, self.parameter)
        span = max(abs(to - value) for to in targets)
        lower = value - span if self.lower is None else self.lower
        upper = value + span if self.upper is None else self.upper
        return replace(
            self,
            to=tuple(targets),
            lower=max(min((to for to in targets if to < value), default=lower), least),
            upper=min(max((to for to in targets if to > value), default=upper), largest),
        )

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound; infinite where there is none."""
        return -inf if self.lower is None else self.lower, inf if self.upper is None else self.upper

    def crossed(self, before: float, after: float) -> float | None:
        """The bound that a step of the parameter reaches or passes from inside."""
        lower, upper = self.bounds
        if after >= upper > before:
            return upper
        return lower if after <= lower < before else None

    def reached(self, value: float) -> str | None:
        """Why a walk ends at a value of the parameter, if that is a bound."""
        lower, upper = self.bounds
        return None if lower < value < upper else f"reached {self.parameter} = {max(lower, min(value, upper)):.12g}"

    def exhausted(self, points: int, seconds: float = 0.0) -> str | None:
        """Why a walk pauses after this number of points and this time, if it does; its branch stays open."""
        if points >= self.max_points:
            return f"paused at the limit of {self.max_points} points"
        if self.max_seconds is not None and seconds > self.max_seconds:
            return f"paused at the limit of {self.max_seconds:g} s"
        return None

    def to_record(self) -> dict[str, Any]:
        """One JSON object, the first line of a stored branch; without the events, which are functions."""
        plain = asdict(replace(self, events={}, follow={}))
        record = {key: value for key, value in plain.items() if key not in ("events", "follow")}
        followed = {kind: times for kind, times in self.follow.items() if times}
        return {"record": "continuation", **record, "to": list(self.to), **followed}


def check_request(gait: Gait, request: Request) -> None:
    """Raise an error for a request that cannot be met.

    Raises
    ------
    UnknownNameError, ProblemError, SolveError
        As ``continuation``.
    """
    if not gait.steps:
        raise SolveError(f"{gait.problem.name} is {gait.status}, so there is nothing to continue: {gait.message}")
    names = gait.system.parameters
    if request.parameter not in names:
        near = nearest_keys(request.parameter, names)
        raise UnknownNameError(f"{request.parameter} is no parameter of {gait.problem.name}{near}")
    if isinstance(gait.problem.parameters.get(request.parameter), int):
        words = f"{request.parameter}: is a whole number, along which there is no family; solve for one value at a time"
        raise UnknownNameError(words).about("parameter")
    taken = set(request.events) & {*BIFURCATIONS, *TERMINAL, "mode_change", "impact_change"}
    if taken:
        raise UnknownNameError(f"events: {', '.join(sorted(taken))} is a special point already; choose another name")
    value = float(gait.p[names.index(request.parameter)])
    for to in request.to:
        if to == value or not np.isfinite(to):
            raise ProblemError(
                f"{request.parameter} is {value:g} at the start: the target must be another finite value"
            )
        why = gait.problem.objection(request.parameter, to)
        if why:
            raise ProblemError(f"{to:g}: {request.parameter}: {why}").about("to")
        if request.lower is not None and min(to, value) < request.lower:
            raise ProblemError(f"{request.parameter}: {min(to, value):g} lies below the bound {request.lower:g}")
        if request.upper is not None and max(to, value) > request.upper:
            raise ProblemError(f"{request.parameter}: {max(to, value):g} lies above the bound {request.upper:g}")


def family_of(problem: Problem, parameter: str) -> Gait:
    """A gait without a motion, with the problem and the dynamics of the family of ``problem`` along ``parameter``."""
    stated = Gait(problem=problem, dynamics=problem_dynamics(problem), status=Status.CONVERGED, message="")
    return with_friction(stated, parameter)


def with_friction(gait: Gait, parameter: str) -> Gait:
    """The same gait under the friction law that has ``parameter``; unchanged for all other parameters.

    Raises
    ------
    ProblemError
        If both coefficients are to be moved but differ, or there is viscous drag besides.
    """
    if parameter in gait.system.parameters or parameter.partition(".")[0] != "friction":
        return gait
    friction = gait.problem.friction
    if isinstance(friction, float):
        value = gait.dynamics.static_friction
        if parameter not in StaticKineticFriction().parameters:
            return gait
        return _restated(gait, FrictionCoefficients(static=value, kinetic=value), StaticKineticFriction())
    if friction.static != friction.kinetic or friction.viscous:
        numbers = ", ".join(f"{name} = {value:g}" for name, value in friction)
        raise ProblemError(
            f"friction has several coefficients, {numbers}: vary friction.static, friction.kinetic or friction.viscous"
        )
    return _restated(gait, friction.static, CoulombFriction())


def _coefficient_bounds(gait: Gait, parameter: str) -> tuple[float, float]:
    """Range of a coefficient of friction, static being at least kinetic; infinite for all other parameters."""
    known = gait.dynamics.parameters
    if parameter == "friction.static":
        return known["friction.kinetic"], inf
    return -inf, known["friction.static"] if parameter == "friction.kinetic" else inf


def _restated(gait: Gait, coefficients: float | FrictionCoefficients, law: Friction) -> Gait:
    problem = replace(gait.problem, friction=coefficients)
    system = HybridSystem(gait.system.walker, gait.system.control, gait.system.law, law)
    p = system.values({**problem.parameters, **gait.dynamics.parameters})
    return replace(gait, problem=problem).under(Dynamics(system, p))
