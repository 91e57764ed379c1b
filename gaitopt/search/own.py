"""A named gait stays itself: with other parameter values it is followed from those of its own file.

p(s) = (1 - s) p_file + s p_new,        s from 0 to 1, in steps that halve where the gait is lost or jumps
"""

from dataclasses import replace

import numpy as np

from gaitopt.callbacks import Stop, Valued
from gaitopt.errors import ProblemError
from gaitopt.gait import Gait, Status, in_words
from gaitopt.nlp import Family
from gaitopt.problem import Problem, lacks_energy, parse_problem
from gaitopt.search.solve import solve
from gaitopt.study.warm import guessed_from

CLEAR = 0.05
"""A solution whose state differs from that of the file's gait by less than this part is its continuation."""
JUMP = 0.1
"""Largest change of the state on one step, relative to its size: beyond it lies another family."""
FIRST_STEP, SMALLEST_STEP = 0.25, 1e-3
"""Steps of s."""


def solve_as_own(problem: Problem, *, progress: Valued = None, should_stop: Stop = None) -> Gait:
    """The gait of a problem; of one with overrides, the continuation of the gait of the file itself.

    Where the direct solution is close to the file's gait it is taken as it is. Otherwise the file's gait is followed to
    the new values; ``message`` says so, or where and why its family ends on the way.
    """
    direct = solve(problem, progress=progress, should_stop=should_stop)
    own = own_problem(problem)
    if direct.status is Status.INTERRUPTED or lacks_energy(problem):
        return direct
    if own is None or own.start != problem.start or own.free:
        return direct
    start = solve(own, should_stop=should_stop)
    if start.status is Status.INTERRUPTED:
        return start
    if not start.converged or (direct.converged and _change(start, direct) < CLEAR):
        return direct
    gait, s, reason = follow(start, problem, should_stop=should_stop)
    if s == 1:
        same = direct.converged and _change(direct, gait) < CLEAR
        return direct if same else replace(gait, message="solved, followed from the gait of the problem's file")
    place = ", ".join(f"{key} = {value:.6g}" for key, value in _between(own, problem, s).items())
    words = f"the family of the file's own gait ends near {place}: {reason}"
    return replace(direct, message=f"{direct.message}; {'another gait, ' if direct.converged else ''}{words}")


def own_problem(problem: Problem) -> Problem | None:
    """The problem of the file itself, if overrides have changed parameter values and nothing else but the guess."""
    if not problem.text or problem.is_open:
        return None
    own = parse_problem(problem.text, problem.path, walkers=(type(problem.walker),))
    fixed = ("modes", "impact_law", "reference", "free", "objective", "constraints")
    same = all(getattr(own, name) == getattr(problem, name) for name in fixed)
    before, after = own.parameters, problem.parameters
    return own if same and before.keys() == after.keys() and before != after else None


def follow(start: Gait, problem: Problem, *, should_stop: Stop = None) -> tuple[Gait, float, str]:
    """Follow a gait along the straight line to the parameters of a problem with the same modes.

    Returns
    -------
    gait : the last one; where ``s`` is 1, that of the new parameters.
    s : how far it got.
    reason : why it got no further, in words.
    """
    family, gait, s, step = Family(start, should_stop=should_stop), start, 0.0, FIRST_STEP
    while s < 1:
        ahead = min(s + step, 1.0)
        try:
            values = _between(start.problem, problem, ahead)
            following = family.solve(problem if ahead == 1 else start.problem.replace(values))
        except ProblemError as error:  # values between may not fit together
            return gait, s, str(error)
        if following.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if following.converged and _change(gait, following) < JUMP:
            gait, s, step = following, ahead, 2 * step
            continue
        step /= 2
        if step < SMALLEST_STEP:
            return gait, s, _why(gait, following, should_stop)
        family = Family(gait, should_stop=should_stop)
    return gait, s, ""


def _why(gait: Gait, following: Gait, should_stop: Stop) -> str:
    """What the next gait would violate."""
    if following.converged:
        return "the next gait is another one"
    attempt = solve(guessed_from(following.problem, gait.to_record(), {}), should_stop=should_stop)
    return in_words(attempt.causes) or following.message


def _between(own: Problem, problem: Problem, s: float) -> dict[str, float]:
    """Values of the parameters that differ, at a part ``s`` of the way."""
    before = own.parameters
    return {key: (1 - s) * before[key] + s * value for key, value in problem.parameters.items() if before[key] != value}


def _change(first: Gait, second: Gait) -> float:
    """Largest difference of the states after impact, relative to the largest entry."""
    return float(np.abs(first.state - second.state).max() / np.abs(first.state).max())
