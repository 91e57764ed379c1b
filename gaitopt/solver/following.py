"""A known gait at other parameter values: followed along a path, or solved repeatedly by chords.

    F(w, p) = 0      predicted by the polynomial through the last solutions, corrected by Newton's method

``follow`` goes from one problem to another along

    p(s) = p_start^(1 - s) p_end^s,      s from 0 to 1

The path is straight in the logarithms of the parameters, so that a mass may grow by a factor of a thousand as easily as
it may shrink by it; a parameter that changes its sign, or is zero at an end, is interpolated linearly. A step is
accepted if each of Newton's steps is at most half of the one before it, which keeps the solution on the family, and if
the state changes little; otherwise the step is halved. IPOPT is not used: it may find the gait of another family, and
rounding would then decide which one. The margins of the mode sequence only count at the end of the path; if they are
violated there, the message names the parameters at which they were first violated.

``Family`` solves one problem after another. The Jacobian of the last gait serves as a chord, w <- w - J^-1 F(w, p);
where chords do not converge, or lead to no gait, IPOPT takes over.
"""

import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.callbacks import Stop, Valued
from gaitopt.gait.gait import Cause, Gait, Status, describe_causes
from gaitopt.model.dynamics import Dynamics
from gaitopt.problem.problem import Problem
from gaitopt.requests import Method
from gaitopt.solver.arclength import ITERATIONS, Fixed, corrected, predictions
from gaitopt.solver.assembly import search_record, solution_of, solved_gait
from gaitopt.solver.diagnosis import RESIDUAL_TOLERANCE, rejection_reason, status_without_gait, vanishing_phase
from gaitopt.solver.newton import GaitEquations, Solution, polish, refine
from gaitopt.solver.program import feasibility, solved
from gaitopt.solver.rollout import reordered

MOST_EXTRAPOLATED = 5
"""Largest number of solutions from which the next one is extrapolated. With more, the rounding would be as large as the
error of the polynomial."""
LARGEST_STATE_CHANGE = 0.1
"""Largest change of the state after impact on one step, relative to its largest entry."""
SMALLEST_STEP = 1e-4
"""If a smaller step of s fails too, the family ends there."""
VANISHING_DISTANCE = 4 * SMALLEST_STEP
"""A phase vanishes at the end of a family if its duration, extrapolated, falls to zero within this change of s."""
LARGEST_DISTANCE_FROM_LINE = 1e-9
"""Parameters this close to a line, relative to their distance along it, lie on it up to rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _PathPoint:
    """A solution of the equations on the path; it is a gait if it violates no margin.

    Attributes
    ----------
    s : its position on the path, from 0 to 1.
    solution : the motion.
    causes : why it is not a gait; empty for a gait.
    history : s and w of the last solutions, the latest one first.
    """

    s: float
    solution: Solution
    causes: tuple[Cause, ...] = ()
    history: tuple[tuple[float, Array], ...]


def follow(start: Gait, problem: Problem, *, progress: Valued = None, should_stop: Stop = None) -> Gait:
    """The gait of ``problem`` on the family of ``start``.

    The result depends on the two arguments alone, not on other problems that were solved before.

    Parameters
    ----------
    start : a converged gait without free parameters, as ``solve_gait`` returns it.
    problem : a problem that differs from that of ``start`` in parameter values only.
    progress : called at every step with its number and the remaining fraction of the path.
    should_stop : polled at every step; True ends the search with the status ``interrupted``.

    Returns
    -------
    gait : ``infeasible`` if the family ends on the path; ``message`` says where. ``causes`` are the margins that the
        motion violates at the parameters of ``problem``; if it cannot be followed to these, those that it violates
        where it ceases to be a gait. ``solver["followed"]`` is the fraction of the path that was followed.

    Raises
    ------
    ValueError
        If ``start`` has free parameters, or comes from a file.
    """
    if start.freed:
        raise ValueError(f"{start.problem.name}: a gait with free parameters cannot be followed")
    began = time.perf_counter()
    goal, first = Dynamics.of(start.system, problem.parameters), solution_of(start)
    here, step, steps, iterations = _PathPoint(s=0.0, solution=first, history=((0.0, first.w),)), 1.0, 0, 0
    lost: tuple[_PathPoint, _PathPoint] | None = None  # the last point that is a gait, and the first that is not
    while here.s < 1 and step >= SMALLEST_STEP:
        if progress is not None:
            progress(steps, 1 - here.s)
        if should_stop is not None and should_stop():
            return Gait(problem=problem, dynamics=goal, status=Status.INTERRUPTED, message="interrupted")
        following, newton_steps = _next(here, min(here.s + step, 1.0), start.p, goal.p)
        steps, iterations = steps + 1, iterations + newton_steps
        if following is None:
            step /= 2
            continue
        if lost is None and following.causes:
            last, following = _loss(here, following, start.p, goal.p)
            lost = (last, following) if following.causes else None
        here, step = following, 2 * step
    solver = search_record(Method.NEWTON, iterations, began)
    if here.s == 1 and not here.causes:
        message = "solved" if steps == 1 else "solved, followed from the gait of the problem's file"
        return solved_gait(problem, here.solution, message=message, solver=solver)
    end = here if lost is None else lost[0]
    causes = (_end_of_family(here),) if lost is None else here.causes or lost[1].causes
    values = dict(zip(start.system.parameters, _between(start.p, goal.p, end.s), strict=True))
    changed = [key for key, value in problem.parameters.items() if start.problem.parameters[key] != value]
    end_values = ", ".join(f"{key} = {values[key]:.4g}" for key in changed if key in values)
    return Gait(
        problem=problem,
        dynamics=goal,
        status=Status.INFEASIBLE,
        message=f"the family of the file's own gait ends near {end_values}: {describe_causes(causes)}",
        causes=causes,
        solver={**solver, "followed": here.s},
    )


def _between(p_start: Array, p_end: Array, s: float) -> Array:
    """The parameters at ``s``. At 0 and 1 they are exactly those of the two problems."""
    if s in (0.0, 1.0):
        return p_end if s else p_start
    alike = p_start * p_end > 0
    ratio = np.divide(p_end, p_start, out=np.ones_like(p_end), where=alike)
    return np.where(alike, p_start * ratio**s, (1 - s) * p_start + s * p_end)


@overflow_allowed()
def _next(here: _PathPoint, s: float, p_start: Array, p_end: Array) -> tuple[_PathPoint | None, int]:
    """The motion at ``s``, None if it does not continue the one here; and the number of Newton steps."""
    p, equations = _between(p_start, p_end, s), here.solution.equations
    passed, solutions = zip(*here.history, strict=True)
    predicted = next(predictions([earlier - passed[0] for earlier in passed], solutions, s - passed[0]))
    near = corrected(Fixed(GaitEquations(equations, p)), predicted, slow=0.0)
    if near is None or not near.is_near:
        return None, ITERATIONS if near is None else near.iterations
    solution = refine(polish(near.at))
    before, after = (at.w[: equations.system.n_z] for at in (here.solution, solution))
    solved = solution.size <= RESIDUAL_TOLERANCE and solution.accurate
    if not (solved and np.abs(after - before).max() < LARGEST_STATE_CHANGE * np.abs(before).max()):
        return None, near.iterations
    ordered = reordered(solution)
    if ordered is None:
        return None, near.iterations
    solution = ordered
    history = ((s, solution.w), *(here.history if solution.equations is equations else ()))
    causes = rejection_reason(solution)
    return _PathPoint(s=s, solution=solution, causes=causes, history=history[:MOST_EXTRAPOLATED]), near.iterations


def _loss(gait: _PathPoint, motion: _PathPoint, p_start: Array, p_end: Array) -> tuple[_PathPoint, _PathPoint]:
    """The last gait, found by bisection between a gait and a motion that violates a margin, and the motion after it.

    A long step may end at another solution of the equations, in which a phase has no length. A short step from the
    last gait then leads to the motion of the family, which may be a gait.
    """
    end = motion
    while motion.s - gait.s > SMALLEST_STEP:
        middle, _ = _next(gait, (gait.s + motion.s) / 2, p_start, p_end)
        if middle is None:
            break
        gait, motion = (gait, middle) if middle.causes else (middle, motion)
    if motion is end:
        motion = _next(gait, end.s, p_start, p_end)[0] or end
    return gait, motion


def _end_of_family(last: _PathPoint) -> Cause:
    """Why the equations have no solution a little further: a phase vanishes there, or the family turns back."""
    equations = last.solution.equations
    if len(last.history) > 1:
        (s, w), (s_before, before), *_ = last.history
        durations = equations.unpack(w).durations
        rates = (equations.unpack(before).durations - durations) / (s - s_before)
        vanishing = np.flatnonzero(durations < VANISHING_DISTANCE * rates)
        if vanishing.size:
            return vanishing_phase(equations.mesh.cycle, int(vanishing[0]), float(durations[vanishing[0]]))
    return Cause(what="fold", description="Newton's method follows it no further; it turns back, or its motion fails")


class Family:
    """Gaits of one mode sequence at many parameter values; each is solved from the ones before it.

    Parameters
    ----------
    gait : a converged gait without free parameters, the first of the family.
    should_stop : polled at every iteration of IPOPT; True ends the search with the status ``interrupted``.

    Raises
    ------
    ValueError
        If ``gait`` is a failed attempt, or a design.
    """

    def __init__(self, gait: Gait, *, should_stop: Stop = None) -> None:
        if not gait.steps or gait.shooting is None or gait.freed:
            raise ValueError(f"{gait.problem.name}: a family begins with a converged gait without freed parameters")
        self.gait, self._should_stop, self._solving = gait, should_stop, threading.RLock()
        first = solution_of(gait)
        self._equations, self._solved = first.equations, deque([first], maxlen=MOST_EXTRAPOLATED)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles continue from the same solutions; they do not contain ``should_stop``."""
        return _resumed, (self.gait, tuple((solution.w, solution.p) for solution in self._solved))

    def solve(self, problem: Problem) -> Gait:
        """The gait of ``problem``, which differs from the first problem in parameter values only.

        Raises
        ------
        ValueError
            If its walker, kind of control, impact law or mode sequence differs.
        """
        first = self.gait.problem
        same = (problem.cycle, problem.impact_law, type(problem.walker)) == (
            first.cycle, first.impact_law, type(first.walker)
        )  # fmt: skip
        if not same or problem.reference != first.reference or tuple(problem.parameters) != tuple(first.parameters):
            raise ValueError(f"{problem.name} differs from {first.name} in more than parameter values: use solve")
        began = time.perf_counter()
        dynamics = Dynamics.of(self.gait.system, problem.parameters)
        with self._solving:
            refined, iterations = self._by_chords(dynamics.p)
            refined = None if refined is None else reordered(refined)
            causes = () if refined is None else rejection_reason(refined)
            status, message, method = Status.CONVERGED, "solved", Method.NEWTON
            if refined is None or causes:
                program = feasibility(problem, Solution(self._equations, self._solved[-1].w, dynamics.p))
                method, end = Method.IPOPT, solved(program, should_stop=self._should_stop)
                status, message, iterations = end.status, end.message, iterations + end.iterations
                if end.converged:
                    refined = refine(polish(end))
                    causes = rejection_reason(refined)
                    if causes:
                        status, message = status_without_gait(causes), describe_causes(causes)
            solver = search_record(method, iterations, began)
            if status is not Status.CONVERGED and self.gait.system.control.breakpoints:  # a switch may pass one
                return follow(self.gait, problem, should_stop=self._should_stop)
            if refined is None or status is not Status.CONVERGED:
                return Gait(problem=problem, dynamics=dynamics, status=status, message=message, solver=solver)
            if refined.equations is self._equations:  # a finer mesh is not kept
                self._solved.append(refined)
        return solved_gait(problem, refined, message=message, solver=solver)

    @overflow_allowed()
    def _by_chords(self, p: Array) -> tuple[Solution | None, int]:
        """The solution at ``p``, None if chords do not converge; and the number of chords."""
        last = self._solved[-1]
        system = Fixed(GaitEquations(self._equations, p))
        for w in (self._predicted(p), last.w):
            end = corrected(system, w, chord=last.scaled)
            if end is not None and end.is_near:
                return refine(polish(end.at)), end.iterations
        return None, ITERATIONS

    def _predicted(self, p: Array) -> Array:
        """The solution extrapolated to ``p`` from the last solutions, as far as their parameters lie on a line with it.

        If only the last solution lies on a line with ``p``, it is returned unchanged.
        """
        last = self._solved[-1]
        unit = np.maximum(np.abs(p), np.finfo(float).tiny)
        ahead = (p - last.p) / unit
        if not ahead.any():
            return last.w
        positions, solutions = [0.0], [last.w]  # on the line the last solution is at 0, and ``p`` at 1
        for before in list(self._solved)[-2::-1]:
            offset = (before.p - last.p) / unit
            position = float(offset @ ahead / (ahead @ ahead))
            if np.abs(offset - position * ahead).max() > LARGEST_DISTANCE_FROM_LINE * np.abs(offset).max():
                break
            positions, solutions = [*positions, position], [*solutions, before.w]
        return next(predictions(positions, solutions, 1.0))


def _resumed(gait: Gait, solved: Sequence[tuple[Array, Array]]) -> Family:
    """A family that continues from these solutions, given as pairs of unknowns and parameters."""
    family = Family(gait)
    family._solved.clear()
    family._solved.extend(Solution(family._equations, w, p) for w, p in solved)
    return family
