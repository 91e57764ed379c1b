"""Gaits of the named problems, each solved once in every process of the suite."""

from functools import cache
from itertools import islice
from math import radians
from typing import Any

from gaitopt import Gait, Problem, Verification, load_problem, solve, verify
from gaitopt.branches.continuation import follow_family
from gaitopt.branches.request import Request
from gaitopt.gait.branch import SpecialPoint


@cache
def named(name: str) -> Gait:
    """The gait of a named problem; it is shared, so do not alter its arrays."""
    gait = solve(load_problem(name))
    assert gait.converged, gait.message
    return gait


@cache
def verification(name: str) -> Verification:
    """The verification of a named problem's gait."""
    return verify(named(name))


@cache
def steep(name: str, degrees: float = 5.345) -> Gait:
    """The sticking gait of a passive compass, by default just below the slope at which its period doubles."""
    guess = {"theta1": -0.2637, "dtheta1": 0.8969, "dtheta2": 0.1533}
    changes = {"walker.slope": radians(degrees), "friction": 0.6, "gait.guess.state": guess}
    gait = solve(load_problem(name).replace(changes))
    assert gait.converged, gait.message
    return gait


def solved(problem: Problem | str, **options: Any) -> Gait:
    """The gait of a problem that has one."""
    gait = solve(problem, progress=False, **options)
    assert gait.converged, gait.message
    return gait


def verified(problem: Problem | str, **options: Any) -> Gait:
    """The gait of a problem, every claim about which the simulator confirms."""
    gait = solved(problem, **options)
    assert [claim.summary for claim in verify(gait).claims if not claim.passed] == []
    return gait


def special_of(gait: Gait, parameter: str, to: float, kind: str, index: int = 0) -> SpecialPoint:
    """The special point of a kind, by its index, on the family of a gait, which is followed no further."""
    records = follow_family(gait, Request(parameter=parameter, to=(to,), verify_every=0))
    special = (record for record in records if isinstance(record, SpecialPoint) and record.type == kind)
    return next(islice(special, index, None))
