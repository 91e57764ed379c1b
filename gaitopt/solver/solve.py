"""The gait of a problem by multiple shooting, without unknown parameters: from the guess to a ``Gait``.

guess           the motion from the guessed state along the mode sequence           ``roll_out``
equations       F(w, p) = 0 on a mesh for that motion                               ``Rollout.on_mesh``
Newton          from there, while its steps halve                                   ``solve_nearby``
IPOPT           F = 0 and margins >= 0, if Newton's method finds no gait            ``Feasibility``
refinement      down to rounding, on a mesh that is fine enough                     ``polish``, ``refine``
check           every margin at the nodes, and no event between them                ``rejection_reason``
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from gaitopt.callbacks import Stop, Valued
from gaitopt.gait.gait import Cause, Gait, Status, describe_causes
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.problem.plausibility import NO_ENERGY, lacks_energy
from gaitopt.problem.problem import Problem
from gaitopt.solver.assembly import solved_gait
from gaitopt.solver.diagnosis import failure_causes, rejection_reason
from gaitopt.solver.ipopt import Feasibility
from gaitopt.solver.newton import Solution, polish, refine, solve_nearby
from gaitopt.solver.rollout import Rollout, roll_out, rolled_again, transit_time

MAX_REORDERS = 6
"""Changes of the order of switches and breakpoints in one search; each needs a new mesh."""
FAILURES = (Status.NOT_CONVERGED, Status.INFEASIBLE)


def free_parameters(problem: Problem, system: HybridSystem) -> dict[str, tuple[float, float]]:
    """Bounds of all unknown parameters by dotted key: those of the file, and those of the control law itself."""
    bounds = {key: (free.lower, free.upper) for key, free in problem.free.items()}
    return bounds | {f"control.{name}": limits for name, limits in system.control.unknowns.items()}


def solve_gait(problem: Problem, system: HybridSystem, *, progress: Valued = None, should_stop: Stop = None) -> Gait:
    """Solve ``problem`` for a periodic gait with its mode sequence.

    Parameters
    ----------
    problem : its guess starts the search.
    system : the hybrid system of the problem's walker and control.
    progress : called at every iteration with its number and the largest violation.
    should_stop : polled at every iteration; True ends the search with the status ``interrupted``.

    Returns
    -------
    gait : a numerical failure is a status of the gait, not an error.
    """
    dynamics, cycle, began = Dynamics(system, system.values(problem.parameters)), problem.cycle, time.perf_counter()
    if lacks_energy(problem):
        cause = Cause(what="energy", words=NO_ENERGY)
        return Gait(problem=problem, dynamics=dynamics, status=Status.INFEASIBLE, message=NO_ENERGY, causes=(cause,))
    state = np.array([problem.guess.state[name] for name in system.state_names])
    guess = roll_out(dynamics, cycle, state, problem.guess.durations)
    if guess.endless is None:
        _, near = _search(guess, partial(solve_nearby, progress=progress, should_stop=should_stop))
        if near.converged:
            gait = _gait(problem, near, began)
            if gait.converged:
                return gait

    def ipopt(start: Solution) -> Solution:
        return Feasibility(start.equations, progress=progress, should_stop=should_stop).solve(start.w, start.p)

    start, solution = _search(guess, ipopt)
    if solution.status in FAILURES and problem.guess.durations is None:  # the events of the guess may come too late
        shortened = np.array(guess.durations) * transit_time(dynamics, cycle, state) / guess.period
        start_again, retried = _search(roll_out(dynamics, cycle, state, shortened), ipopt)
        if retried.status not in FAILURES:
            start, solution = start_again, retried
    if solution.converged:
        return _gait(problem, solution, began)
    causes = () if solution.status is Status.INTERRUPTED else failure_causes(start, solution, guess)
    return Gait(
        problem=problem,
        dynamics=dynamics,
        status=solution.status,
        message=f"{solution.words}: {describe_causes(causes)}" if causes else solution.words,
        solver=_solver(solution, began),
        causes=causes,
    )


def _search(guess: Rollout, method: Callable[[Solution], Solution]) -> tuple[Solution, Solution]:
    """Start and end of a search; it begins again on a new mesh while a switch passes a breakpoint of the control."""
    start = guess.on_mesh()
    for _ in range(MAX_REORDERS):
        end = method(start)
        if not end.converged or end.in_order:
            break
        start = rolled_again(end).on_mesh()
    return start, end


def _gait(problem: Problem, solution: Solution, began: float) -> Gait:
    """The gait at a solution: polished, refined until its integration error is small, and checked."""
    refined, solver = refine(polish(solution)), _solver(solution, began)
    causes = rejection_reason(refined)
    if not causes:
        return solved_gait(problem, refined, message=solution.words, solver=solver)
    return Gait(
        problem=problem,
        dynamics=Dynamics(solution.equations.system, solution.p),
        status=Status.NOT_CONVERGED,
        message=describe_causes(causes),
        solver=solver,
        causes=causes,
    )


def _solver(solution: Solution, began: float) -> dict[str, float]:
    return {"iterations": float(solution.iterations), "seconds": time.perf_counter() - began}
