"""A gait followed to other values of its parameters, along the straight line between them.

    p(s) = (1 - s) p_start + s p_end,      F(w, p(s)) = 0,      s from 0 to 1

Each step is Newton's method from the polynomial through the last solutions. It is accepted where Newton's steps
contract by a half each, which keeps the solution on the family, the state changes little, and no margin of the mode
sequence is violated. Otherwise the step is halved. IPOPT is not asked: it may find the gait of another family, and
rounding then decides which one.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.gait import Cause, Gait, Status, in_words
from gaitopt.mechanics import Dynamics
from gaitopt.nlp.extrapolation import extrapolation
from gaitopt.nlp.ipopt import Progress
from gaitopt.nlp.layout import layout
from gaitopt.nlp.multiple_shooting import MultipleShooting, transcribe
from gaitopt.nlp.nearby import solve_nearby
from gaitopt.nlp.newton import linearise, polish
from gaitopt.nlp.refinement import Refined, refine
from gaitopt.nlp.rollout import roll_out
from gaitopt.nlp.solve import assembled, rejection_reason
from gaitopt.nlp.trial import overflow_allowed
from gaitopt.problem import Problem

JUMP = 0.1
"""Largest change of the state after impact on one step, relative to its largest entry."""
SMALLEST_STEP = 1e-4
"""Steps of s, below which the family is at its end."""
REMEMBERED = 5
"""Solutions that are extrapolated from: with more, what rounding adds is as much as what is left out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """A gait on the way, and the unknowns of the last ones up to it with their s, the latest first."""

    s: float
    solution: Refined[MultipleShooting]
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
    gait : where the family ends on the way, ``infeasible``; ``message`` and ``causes`` say where and why.
    """
    began = time.perf_counter()
    goal = Dynamics(start.system, start.system.values(problem.parameters))
    here, step, iterations, count = _first(start), 1.0, 0, 0
    wrong: tuple[Cause, ...] = ()

    def failed(status: Status, message: str, causes: tuple[Cause, ...] = ()) -> Gait:
        solver = {"iterations": float(iterations), "seconds": time.perf_counter() - began}
        return Gait(problem=problem, dynamics=goal, status=status, message=message, solver=solver, causes=causes)

    while here.s < 1:
        if progress is not None:
            progress(count, 1 - here.s)
        if should_stop is not None and should_stop():
            return failed(Status.INTERRUPTED, "interrupted")
        s = min(here.s + step, 1.0)
        p = goal.p if s == 1 else (1 - s) * start.p + s * goal.p
        following, wrong, newton = _next(here, s, p)
        iterations, count = iterations + newton, count + 1
        if following is not None and not wrong:
            here, step = following, 2 * step
        elif step / 2 < SMALLEST_STEP:
            causes = wrong or (Cause(what="fold", words="the family turns back, or its motion breaks down"),)
            place = _words(start, problem, here.s)
            return failed(
                Status.INFEASIBLE, f"the family of the file's own gait ends near {place}: {in_words(causes)}", causes
            )
        else:
            step /= 2
    return assembled(
        problem,
        here.solution,
        message="solved" if count == 1 else "solved, followed from the gait of the problem's file",
        solver={"iterations": float(iterations), "seconds": time.perf_counter() - began},
    )


def _first(start: Gait) -> _Place:
    """The gait with which a family begins, on the layout on which it was solved."""
    if start.shooting is None or start.freed:
        raise ValueError(f"{start.problem.name}: only a gait that was just solved, with no unknowns, can be followed")
    durations = np.array([duration for _, duration in start.phases])
    plan = layout(start.problem.cycle, durations, start.system.control.breakpoints)
    transcription = transcribe(start.system, plan.refined(list(start.shooting.intervals)))
    at = linearise(transcription, transcription.pack(start.shooting.states.T, durations), start.p)
    solution = Refined(transcription=transcription, at=at, errors=start.shooting.errors)
    return _Place(s=0.0, solution=solution, passed=((0.0, at.w),))


@overflow_allowed()
def _next(here: _Place, s: float, p: Array) -> tuple[_Place | None, tuple[Cause, ...], int]:
    """The gait at ``s``, where it continues the one here; what is wrong with it; and the number of Newton steps."""
    transcription = here.solution.transcription
    near = solve_nearby(transcription, _predicted(here.passed, s), p)
    if not near.settled:
        return None, (), near.steps
    solution = refine(transcription, polish(transcription, near.w, p).at)
    before, after = (at.w[: transcription.system.n_z] for at in (here.solution.at, solution.at))
    if not np.abs(after - before).max() < JUMP * np.abs(before).max():
        return None, (), near.steps
    ordered = _in_order(solution)
    if ordered is None:
        return None, (), near.steps
    passed = ((s, ordered.at.w), *(here.passed if ordered.transcription is transcription else ()))
    place = _Place(s=s, solution=ordered, passed=passed[:REMEMBERED])
    return place, rejection_reason(ordered), near.steps


def _predicted(passed: Sequence[tuple[float, Array]], s: float) -> Array:
    """The polynomial through the last solutions, of as many as let it reach ``s``."""
    for count in range(len(passed), 1, -1):
        places, solutions = zip(*passed[:count], strict=True)
        weights = extrapolation([place - places[0] for place in places], s - places[0])
        if weights is not None:
            return np.asarray(weights @ np.array(solutions))
    return passed[0][1]


def _in_order(solution: Refined[MultipleShooting]) -> Refined[MultipleShooting] | None:
    """The solution on a new layout where a switch has passed a breakpoint of the control; None if that fails."""
    transcription, at = solution.transcription, solution.at
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
    in_order = near.settled and changed.layout.in_order(changed.unpack(near.w).durations, breakpoints)
    return refine(changed, polish(changed, near.w, at.p).at) if in_order else None


def _words(start: Gait, problem: Problem, s: float) -> str:
    """The values of the changed parameters at a part ``s`` of the way."""
    before = start.problem.parameters
    values = {
        key: (1 - s) * before[key] + s * value for key, value in problem.parameters.items() if before[key] != value
    }
    return ", ".join(f"{key} = {value:.4g}" for key, value in values.items())
