"""The nearest values of parameters at which a mode sequence does exist: where families of gaits gain or lose it.

A family is followed from a gait that exists: from that of the problem's own file towards the new values, and
from the gaits that other mode sequences have at these values. The special point on the way is the answer, located to
rounding.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitopt.callbacks import Stop
from gaitopt.errors import ProblemError, SolveError
from gaitopt.families import Request, follow_family
from gaitopt.gait import BranchPoint, Gait, SpecialPoint
from gaitopt.mechanics import Cycle
from gaitopt.problem import Problem
from gaitopt.problem.parts import Free

ENDS = ("fold", "mode_change", "impact_change", "vanishing", "lift_off", "painleve", "end")
"""Special points beyond which a mode sequence does not continue, or not in the same direction."""
MAX_POINTS = 200
"""Bound on the work for one family, which answers within some tens of points if it does."""
WIDEST_FRICTION, WIDEST_SLOPE = 2.0, 0.35
"""Largest friction and slope [rad] of the search."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Nearest:
    """A value of one parameter at which the mode sequence begins to exist, the others being those of the problem.

    Attributes
    ----------
    parameter, value : dotted key, and the value in SI.
    type : of the special point there.
    reason : what happens there, in words.
    gait : at the special point, or None.
    """

    parameter: str
    value: float
    type: str
    reason: str = ""
    gait: Gait | None = None

    def to_record(self) -> dict[str, Any]:
        """One JSON object with the keys of the command line."""
        record = {"parameter": self.parameter, "value": self.value, "type": self.type, "reason": self.reason}
        return record | {"gait": None if self.gait is None else self.gait.to_record()}


def changed_parameters(problem: Problem, gait: Gait) -> list[str]:
    """Dotted keys whose values in the problem are not those of the gait."""
    values = gait.dynamics.parameters
    return [key for key, value in problem.parameters.items() if key in values and values[key] != value]


def end_of_family(gait: Gait, parameter: str, value: float, should_stop: Stop) -> Nearest | None:
    """Where a gait's mode sequence ends on the way to a value of a parameter; None where it gets there."""
    cycle, request = gait.problem.cycle, _request(parameter, value)
    for record in follow_family(gait, request, should_stop=should_stop):
        if isinstance(record, SpecialPoint) and record.type in ENDS:
            is_there = np.isclose(record.value, value, rtol=1e-12, atol=1e-14)
            return None if is_there else _nearest(parameter, record)
        if isinstance(record, BranchPoint) and record.gait.problem.cycle != cycle:
            return None
    return None


def begin_of_sequence(gait: Gait, parameter: str, value: float, cycle: Cycle, should_stop: Stop) -> Nearest | None:
    """Where the family of a gait changes to a mode sequence on the way to a value of a parameter."""
    for record in follow_family(gait, _request(parameter, value), should_stop=should_stop):
        if isinstance(record, SpecialPoint) and record.after == cycle:
            return _nearest(parameter, record)
    return None


def nearest_values(
    problem: Problem, own: Gait | None, others: Iterable[Gait], free: Mapping[str, Free], should_stop: Stop = None
) -> list[Nearest]:
    """For friction, slope, free numbers and what differs from the file the nearest value at which the modes exist.

    Parameters
    ----------
    problem : with all its numbers given.
    own : the gait of the problem's own file.
    others : gaits of other mode sequences at the problem's parameters.
    free : numbers that a design leaves free, with their ranges.
    """
    changed = [] if own is None else changed_parameters(problem, own)
    gaits, values = list(others), problem.parameters
    ranges = {key: _widened(problem, key, span) for key, span in free.items()}
    ranges |= {key: (0.0, WIDEST_FRICTION) for key in values if key.partition(".")[0] == "friction"}
    ranges |= {key: (-WIDEST_SLOPE, WIDEST_SLOPE) for key in values if key == "walker.slope"}
    answers = list[Nearest]()
    for parameter in dict.fromkeys([*changed, *ranges]):
        best: Nearest | None = None
        if own is not None and changed == [parameter]:
            best = _attempt(end_of_family, own, parameter, values[parameter], should_stop)
        for gait in gaits:
            for bound in ranges.get(parameter, ()):
                target = _no_further(values[parameter], bound, best)
                if target != values[parameter]:
                    closer = _attempt(begin_of_sequence, gait, parameter, target, problem.cycle, should_stop)
                    best = closer or best
        if best is not None:
            answers.append(best)
    return answers


def _no_further(value: float, bound: float, best: Nearest | None) -> float:
    """The bound, or the value on its side that is as far from ``value`` as what is known already."""
    reach = np.inf if best is None else abs(best.value - value)
    return float(np.clip(bound, value - reach, value + reach))


def _attempt(follow: Callable[..., Nearest | None], gait: Gait, *arguments: Any) -> Nearest | None:
    """The answer of a family; None where the family cannot be followed in this parameter at all."""
    try:
        return follow(gait, *arguments)
    except (ProblemError, SolveError):
        return None


def _widened(problem: Problem, key: str, span: Free) -> tuple[float, ...]:
    """The range of a free number and as much again on either side, where the walker can have it."""
    width = span.upper - span.lower
    wide = ((span.lower - width, span.lower), (span.upper + width, span.upper))
    return tuple(bound if problem.objection(key, beyond) else beyond for beyond, bound in wide)


def _request(parameter: str, value: float) -> Request:
    return Request(parameter=parameter, to=(value,), max_points=MAX_POINTS, verify_every=0)


def _nearest(parameter: str, special: SpecialPoint) -> Nearest:
    return Nearest(
        parameter=parameter, value=special.value, type=special.type, reason=special.reason, gait=special.gait
    )
