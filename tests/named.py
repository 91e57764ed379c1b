"""Gaits of the named problems, each solved once in every process of the suite."""

from functools import cache

from gaitopt import Gait, Verification, load_problem, solve, verify


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
