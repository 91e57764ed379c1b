"""What is to be continued: the parameter, its targets and bounds, and how much of what begins on the way."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from gaitopt.errors import ProblemError, SolveError, UnknownNameError
from gaitopt.families.bifurcations import BIFURCATIONS, TestFunction
from gaitopt.gait import TERMINAL, Gait
from gaitopt.problem.faults import nearest_keys

FOLLOWS = {
    "period_doubling": "doublings",
    "branch_point": "branch_points",
    "mode_change": "mode_changes",
    "impact_change": "mode_changes",
}
"""Which number of a request says how many times in turn the other branches of a special point are followed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """Which family, how far, and which of the branches that begin on it.

    Attributes
    ----------
    parameter : dotted key of a scalar of walker, friction or control.
    to : values of the parameter at which to stop, one after the other, each time from the first gait.
    lower, upper : bounds for families that turn round; None as far beyond the first gait as the target is before it.
    events : functions of a gait, continuous along the family, whose zeros are located and named so.
    max_points, max_seconds : limits of the work towards each target, which only pause a branch.
    verify_every : every so many points is confirmed by the simulator, 0 for none.
    follow : how many times in turn the other branches of special points are followed as well, by kind (``FOLLOWS``).
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

    def exhausted(self, points: int, seconds: float = 0.0) -> str | None:
        """Why a walk of so many points pauses after so long, if it does; its branch stays open."""
        if points >= self.max_points:
            return f"paused at the limit of {self.max_points} points"
        if self.max_seconds is not None and seconds > self.max_seconds:
            return f"paused at the limit of {self.max_seconds:g} s"
        return None

    def to_record(self) -> dict[str, Any]:
        """One JSON object, the first line of a stored branch; events are functions, of a call and not of a file."""
        plain = asdict(replace(self, events={}, follow={}))
        record = {key: value for key, value in plain.items() if key not in ("events", "follow")}
        followed = {kind: times for kind, times in self.follow.items() if times}
        return {"record": "continuation", **record, "to": list(self.to), **followed}


def check_request(gait: Gait, request: Request) -> None:
    """Refuse a request that cannot be met.

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
