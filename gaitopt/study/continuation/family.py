"""A family of gaits from one of its gaits: what a user calls."""

from collections.abc import Callable, Iterator
from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray

from gaitopt.errors import ProblemError, SolveError, UnknownNameError
from gaitopt.gait import Branch, BranchPoint, Gait, SpecialPoint
from gaitopt.nlp.arclength import Scales
from gaitopt.nlp.layout import layout
from gaitopt.nlp.rollout import roll_out
from gaitopt.nlp.transcription import Transcription
from gaitopt.study.continuation.follow import Follower, Limits, Record
from gaitopt.study.continuation.piece import Piece, Station

Array = NDArray[np.float64]


def continuation(
    gait: Gait,
    parameter: str,
    to: float,
    *,
    lower: float | None = None,
    upper: float | None = None,
    max_points: int = 2000,
    max_seconds: float | None = None,
    verify_every: int = 10,
    should_stop: Callable[[], bool] | None = None,
) -> Branch:
    """Continue a gait in a parameter, through folds and changes of the mode sequence.

    Parameters
    ----------
    gait : a converged gait.
    parameter : dotted key of any scalar of walker, friction or control.
    to : value of the parameter towards which to go, and at which to stop.
    lower, upper : further bounds of the parameter, for families that turn round; on the side away from ``to`` as far
        as ``to`` is on the other unless given.
    max_points, max_seconds : bounds on the work.
    verify_every : every so many points is confirmed by the simulator.

    Returns
    -------
    branch : points and special points.

    Raises
    ------
    UnknownNameError
        If there is no such parameter; the message lists the near misses.
    SolveError
        If ``gait`` is a failed attempt.
    """
    records = list(
        follow_family(
            gait,
            parameter,
            to,
            lower=lower,
            upper=upper,
            max_points=max_points,
            max_seconds=max_seconds,
            verify_every=verify_every,
            should_stop=should_stop,
        )
    )
    return Branch(
        parameter=parameter,
        points=tuple(record for record in records if isinstance(record, BranchPoint)),
        specials=tuple(record for record in records if isinstance(record, SpecialPoint)),
    )


def follow_family(
    gait: Gait,
    parameter: str,
    to: float,
    *,
    lower: float | None = None,
    upper: float | None = None,
    max_points: int = 2000,
    max_seconds: float | None = None,
    verify_every: int = 10,
    should_stop: Callable[[], bool] | None = None,
) -> Iterator[Record]:
    """As ``continuation``, point by point."""
    if gait.step is None:
        raise SolveError(f"{gait.problem.name} is {gait.status}, so there is nothing to continue: {gait.message}")
    value = float(gait.p[_index(gait, parameter)])
    _check_target(parameter, value, to, lower, upper)
    ahead = 1.0 if to > value else -1.0
    span = abs(to - value)
    limits = Limits(
        lower=to if ahead < 0 else (value - span if lower is None else lower),
        upper=to if ahead > 0 else (value + span if upper is None else upper),
        max_points=max_points,
        max_seconds=max_seconds,
        verify_every=verify_every,
    )
    scales = (float(np.abs(gait.state).max()), gait.step.period, span)
    piece, station = _first(gait, parameter, scales, ahead)
    return Follower(piece, station, limits, should_stop=should_stop).records()


def _index(gait: Gait, parameter: str) -> int:
    names = gait.system.parameters
    if parameter not in names:
        near = ", ".join(get_close_matches(parameter, names, n=3, cutoff=0.3)) or ", ".join(names)
        raise UnknownNameError(f"{parameter} is no parameter of {gait.problem.name}; did you mean {near}?")
    return names.index(parameter)


def _check_target(parameter: str, value: float, to: float, lower: float | None, upper: float | None) -> None:
    if to == value or not np.isfinite(to):
        raise ProblemError(f"{parameter} is {value:g} already: the target must be another finite value")
    for name, bound, beyond in (("lower", lower, min(to, value)), ("upper", upper, max(to, value))):
        if bound is not None and (beyond < bound if name == "lower" else beyond > bound):
            raise ProblemError(
                f"{parameter}: {beyond:g} lies beyond the {name} bound {bound:g}; move the bound or the target"
            )


def _first(gait: Gait, parameter: str, scales: Scales, ahead: float) -> tuple[Piece, Station]:
    """The branch of a gait, and its first point with the tangent in the wanted direction."""
    problem, system = gait.problem, gait.system
    assert gait.step is not None, "a gait has a step"
    durations = tuple(duration for _, duration in gait.step.phases)
    rolled = roll_out(system, gait.p, problem.sequence, gait.state, durations)
    plan = layout(problem.sequence, durations, system.control.breakpoints)
    transcription = Transcription(system, plan, (parameter,))
    piece = Piece(problem, parameter, transcription, gait.p, scales)
    value = gait.p[system.parameters.index(parameter)]
    w = transcription.pack(rolled.nodes(plan), np.array(durations), (value,))
    forward = np.zeros(w.size)
    forward[-1] = ahead
    station = piece.start(w, forward)
    if station is None:
        raise SolveError(f"{problem.name}: the gait cannot be continued in {parameter}: Newton's method fails at it")
    return piece, station
