"""What is to be continued: the parameter, its targets and bounds, and how much of what begins on the way.

Test functions that vanish where a gait loses or gains stability, where the branch folds or another crosses it.

    slope            d parameter / d arclength
    unit             prod (1 - lambda_i)
    period doubling  prod (lambda_i + 1)
    Neimark-Sacker   prod over i < j of (lambda_i lambda_j - 1), with a complex pair on the unit circle

A multiplier is 1 at folds and at branch points. With r the return map, A its derivative by the state, s the arclength,

    det [[1 - A, -dr/dparameter], [tangent]] = prod (1 - lambda_i) / (d parameter / ds)

vanishes at branch points only: at a fold, slope and unit change their signs together; where one of them does alone,
another branch crosses this one (unit alone: transcritical, or a pitchfork seen from its handle; slope alone: seen from
a prong).

References
----------
Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory, ch. 10.

Where a walk along a family stops.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitopt.errors import ProblemError, SolveError, UnknownNameError
from gaitopt.gait.branch import TERMINAL
from gaitopt.gait.gait import Gait
from gaitopt.problem.faults import nearest_keys

BIFURCATIONS = ("fold", "branch_point", "period_doubling", "neimark_sacker")
TestFunction = Callable[[Gait], float]
"""A function of the gaits of a family, continuous along it, whose zeros are of interest."""
NEUTRAL = 1e-6
"""Imaginary part below which a pair with product one is real: a neutral saddle, not a Neimark-Sacker point."""


def test_functions(multipliers: NDArray[np.complex128], slope: float) -> dict[str, float]:
    """Values by type of special point; ``slope`` is d parameter / d arclength."""
    pairs = [a * b - 1 for a, b in combinations(multipliers, 2)]
    return {
        "slope": slope,
        "unit": float(np.prod(1 - multipliers).real),
        "period_doubling": float(np.prod(multipliers + 1).real),
        "neimark_sacker": float(np.prod(pairs).real) if pairs else 1.0,
    }


def bifurcations_between(before: Mapping[str, float], after: Mapping[str, float]) -> dict[str, str]:
    """Types of the special points between two gaits with these test functions, each with the one that locates it."""
    changed = {name for name, value in after.items() if value * before[name] < 0}
    kinds: dict[str, str] = {kind: kind for kind in ("period_doubling", "neimark_sacker") if kind in changed}
    if {"slope", "unit"} <= changed:
        kinds["fold"] = "slope"
    elif changed & {"slope", "unit"}:
        kinds["branch_point"] = "slope" if "slope" in changed else "unit"
    return kinds


def is_bifurcation(kind: str, multipliers: NDArray[np.complex128]) -> bool:
    """Whether a zero of a test function is the special point that it is named for."""
    if kind != "neimark_sacker":
        return True
    a, b = min(combinations(multipliers, 2), key=lambda pair: abs(pair[0] * pair[1] - 1))
    return bool(abs(a.imag) > NEUTRAL and abs(b.imag) > NEUTRAL)


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


LARGEST_LENGTH = 0.025
"""Arclength is scaled so that the range of the parameter has length one: at least forty points for it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """A request, and the range of the parameter in which one of its walks stays."""

    request: Request
    lower: float
    upper: float

    def crossed(self, before: float, after: float) -> float | None:
        """The bound that a step of the parameter reaches or passes."""
        if after >= self.upper > before:
            return self.upper
        return self.lower if after <= self.lower < before else None

    def reached(self, value: float) -> str | None:
        """Why a walk ends at a value, if that is a bound."""
        if self.lower < value < self.upper:
            return None
        return f"reached {self.request.parameter} = {self.lower if value <= self.lower else self.upper:.12g}"

    def exhausted(self, points: int, seconds: float) -> str | None:
        """Why a walk of so many points pauses after so long, if it does."""
        return self.request.exhausted(points, seconds)
