"""A gait followed to other values of its parameters.

    F(w, p(s)) = 0,      p(s) = p_start^(1 - s) p_end^s,      s from 0 to 1

The path is straight in the logarithms of the parameters, so that a mass of tonnes is as near as one of grams; a
parameter that changes its sign or is zero at an end is interpolated linearly. Each step is Newton's method from the
polynomial through the last solutions. It is accepted where Newton's steps contract by a half each, which keeps the
solution on the family, and the state changes little; otherwise it is halved. IPOPT is not asked: it may find the gait
of another family, and rounding would then decide which one. The margins of the mode sequence decide at the end of the
path alone; where the gait is lost, they say where on the path they were first violated.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.gait.gait import Cause, Gait, Status, in_words
from gaitopt.iteration import overflow_allowed
from gaitopt.model.dynamics import Dynamics
from gaitopt.nlp.ipopt import Progress
from gaitopt.nlp.layout import layout
from gaitopt.nlp.newton import Solution, extrapolation, polish, refine, solve_nearby
from gaitopt.nlp.rollout import roll_out
from gaitopt.nlp.shooting import MultipleShooting, transcribe
from gaitopt.nlp.solve import RESIDUAL_TOLERANCE, assembled, rejection_reason, vanished
from gaitopt.problem.problem import Problem

JUMP = 0.1
"""Largest change of the state after impact on one step, relative to its largest entry."""
SMALLEST_STEP = 1e-4
"""Steps of s, below which the family is at its end."""
VANISHING = 4 * SMALLEST_STEP
"""A phase whose duration falls to zero within this part of the path vanishes at the end of the family."""
REMEMBERED = 5
"""Solutions that are extrapolated from: with more, what rounding adds is as much as what is left out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """A motion on the way, what keeps it from being a gait, and the last unknowns with their s, the latest first."""

    s: float
    solution: Solution[MultipleShooting]
    wrong: tuple[Cause, ...] = ()
    passed: tuple[tuple[float, Array], ...]


def follow(start: Gait, problem: Problem, *, progress: Progress | None = None, should_stop: Stop = None) -> Gait:
    """The gait of ``problem`` on the family of ``start``.

    The result depends on the two arguments alone, not on other problems that were solved before.

    Parameters
    ----------
    start : a converged gait without freed parameters, as ``solve_gait`` returns it.
    problem : differs from that of ``start`` in parameter values alone.
    progress : called at every step with its number and the part of the way that is left.
    should_stop : polled at every step; True ends the search with the status ``interrupted``.

    Returns
    -------
    gait : where the family ends on the way, ``infeasible``; ``message`` says where. ``causes`` are what the motion
        violates at the parameters of ``problem``; or, if it cannot be followed so far, where it is first no gait.
        ``solver["followed"]`` is the part of the way over which it could be followed.
    """
    began = time.perf_counter()
    goal = Dynamics(start.system, start.system.values(problem.parameters))
    here, step, steps, iterations = _first(start), 1.0, 0, 0
    causes: tuple[Cause, ...] = ()
    broken: tuple[_Place, _Place] | None = None  # the last place without a violated margin, and the first with one
    while here.s < 1 and step >= SMALLEST_STEP:
        if progress is not None:
            progress(steps, 1 - here.s)
        if should_stop is not None and should_stop():
            return _failed(problem, goal, Status.INTERRUPTED, "interrupted")
        following, newton = _next(here, min(here.s + step, 1.0), start.p, goal.p)
        steps, iterations = steps + 1, iterations + newton
        if following is None:
            step /= 2
            continue
        if broken is None and following.wrong:
            broken = here, following
        here, step = following, 2 * step
    solver = {"iterations": float(iterations), "seconds": time.perf_counter() - began}
    if here.s == 1 and not here.wrong:
        words = "solved" if steps == 1 else "solved, followed from the gait of the problem's file"
        return assembled(problem, here.solution, message=words, solver=solver)
    if broken is None:
        end, causes = here, (_lost(here),)
    else:
        end, causes = _last_gait(*broken, start.p, goal.p), here.wrong or broken[1].wrong
    values = dict(zip(start.system.parameters, _between(start.p, goal.p, end.s), strict=True))
    changed = [key for key, value in problem.parameters.items() if start.problem.parameters[key] != value]
    place = ", ".join(f"{key} = {values[key]:.4g}" for key in changed if key in values)
    message = f"the family of the file's own gait ends near {place}: {in_words(causes)}"
    return _failed(problem, goal, Status.INFEASIBLE, message, causes, {**solver, "followed": here.s})


def _failed(
    problem: Problem,
    dynamics: Dynamics,
    status: Status,
    message: str,
    causes: tuple[Cause, ...] = (),
    solver: Mapping[str, float] = MappingProxyType({}),
) -> Gait:
    return Gait(problem=problem, dynamics=dynamics, status=status, message=message, causes=causes, solver=dict(solver))


def _between(p_start: Array, p_end: Array, s: float) -> Array:
    """The parameters at ``s``; exactly those of the ends there."""
    if s in (0.0, 1.0):
        return p_end if s else p_start
    alike = p_start * p_end > 0
    ratio = np.divide(p_end, p_start, out=np.ones_like(p_end), where=alike)
    return np.where(alike, p_start * ratio**s, (1 - s) * p_start + s * p_end)


def _first(start: Gait) -> _Place:
    """The gait with which a family begins, on the layout on which it was solved."""
    if start.shooting is None or start.freed:
        raise ValueError(f"{start.problem.name}: only a gait that was just solved, with no unknowns, can be followed")
    durations = np.array([duration for _, duration in start.phases])
    plan = layout(start.problem.cycle, durations, start.system.control.breakpoints)
    transcription = transcribe(start.system, plan.refined(list(start.shooting.intervals)))
    solution = Solution(transcription, transcription.pack(start.shooting.states.T, durations), start.p)
    return _Place(s=0.0, solution=solution, passed=((0.0, solution.w),))


@overflow_allowed()
def _next(here: _Place, s: float, p_start: Array, p_end: Array) -> tuple[_Place | None, int]:
    """The gait at ``s``, None where it does not continue the one here; and the number of Newton steps."""
    p, transcription = _between(p_start, p_end, s), here.solution.transcription
    near = solve_nearby(transcription, _predicted(here.passed, s), p)
    if not near.converged:
        return None, near.iterations
    solution = refine(polish(transcription, near.w, p))
    before, after = (at.w[: transcription.system.n_z] for at in (here.solution, solution))
    solved = solution.size <= RESIDUAL_TOLERANCE and solution.accurate
    if not (solved and np.abs(after - before).max() < JUMP * np.abs(before).max()):
        return None, near.iterations
    ordered = _in_order(solution)
    if ordered is None:
        return None, near.iterations
    passed = ((s, ordered.w), *(here.passed if ordered.transcription is transcription else ()))
    wrong = rejection_reason(ordered)
    return _Place(s=s, solution=ordered, wrong=wrong, passed=passed[:REMEMBERED]), near.iterations


def _last_gait(gait: _Place, motion: _Place, p_start: Array, p_end: Array) -> _Place:
    """The last gait on the way from a gait to a motion that violates a margin, by bisection."""
    while motion.s - gait.s > SMALLEST_STEP:
        middle, _ = _next(gait, (gait.s + motion.s) / 2, p_start, p_end)
        if middle is None:
            break
        gait, motion = (gait, middle) if middle.wrong else (middle, motion)
    return gait


def _lost(here: _Place) -> Cause:
    """Why the equations have no solution a little further: a phase vanishes there, or the family turns back."""
    transcription = here.solution.transcription
    for (s, w), (s_before, before) in pairwise(here.passed):
        durations = transcription.unpack(w).durations
        rates = (transcription.unpack(before).durations - durations) / (s - s_before)
        vanishing = np.flatnonzero(durations < VANISHING * rates)
        if vanishing.size:
            return vanished(transcription.layout.cycle, int(vanishing[0]), float(durations[vanishing[0]]))
        break
    return Cause(what="fold", words="the family turns back, or its motion breaks down")


def _predicted(passed: Sequence[tuple[float, Array]], s: float) -> Array:
    """The polynomial through the last solutions, of as many as let it reach ``s``."""
    for count in range(len(passed), 1, -1):
        places, solutions = zip(*passed[:count], strict=True)
        weights = extrapolation([place - places[0] for place in places], s - places[0])
        if weights is not None:
            return np.asarray(weights @ np.array(solutions))
    return passed[0][1]


def _in_order(solution: Solution[MultipleShooting]) -> Solution[MultipleShooting] | None:
    """The solution on a new layout where a switch has passed a breakpoint of the control; None if that fails."""
    transcription, at = solution.transcription, solution
    system, plan = transcription.system, transcription.layout
    durations, breakpoints = transcription.unpack(at.w).durations, system.control.breakpoints
    if plan.in_order(durations, breakpoints):
        return solution
    rolled = roll_out(Dynamics(system, at.p), plan.cycle, at.w[: system.n_z], durations)
    if rolled.endless is not None:
        return None
    durations = np.array(rolled.durations)
    changed = transcribe(system, layout(plan.cycle, durations, breakpoints))
    near = solve_nearby(changed, changed.pack(rolled.nodes(changed.layout), durations), at.p)
    in_order = near.converged and changed.layout.in_order(changed.unpack(near.w).durations, breakpoints)
    return refine(polish(changed, near.w, at.p)) if in_order else None
