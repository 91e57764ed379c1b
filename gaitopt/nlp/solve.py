"""The gait of a problem by multiple shooting, without unknown parameters: from the guess to a ``Gait``.

guess               the mode sequence rolled out from the guessed state         ``rollout``
F(w, p) = 0         Newton's method from there                                  ``newton.solve_nearby``
IPOPT where the guess is not close, or margins are negative ``Feasibility``
refinement          down to rounding, on a mesh that is fine enough             ``newton.polish, refine``
margins >= 0        otherwise the cause is reported                             ``diagnosis``
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from casadi import sum1, vertcat

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop, Valued
from gaitopt.gait.gait import Cause, Gait, Status, describe_causes
from gaitopt.iteration import overflow_allowed
from gaitopt.model.cycle import Cycle
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.nlp.assembly import solved_gait
from gaitopt.nlp.diagnosis import early_event, largest_residual, missing_event, violations
from gaitopt.nlp.ipopt import Ipopt
from gaitopt.nlp.layout import layout
from gaitopt.nlp.newton import Solution, polish, refine, solve_nearby
from gaitopt.nlp.rollout import Rollout, roll_out, transit_time
from gaitopt.nlp.shooting import MultipleShooting, transcribe
from gaitopt.problem.plausibility import NO_ENERGY, lacks_energy
from gaitopt.problem.problem import Problem

MAX_REORDERS = 6
"""Changes of the order of switches and breakpoints in one search; each needs a new layout."""
RESIDUAL_TOLERANCE = 1e-9
"""Largest violation, in natural units, of any equality or margin in a solution that is called converged."""
VANISHING = 1e-7
"""A phase shorter than this part of the period does not take place."""
SHORTEST = 0.1
"""Shortest period that IPOPT may find, relative to the guess: feet that stay together solve all equations."""
FAILURES = (Status.NOT_CONVERGED, Status.INFEASIBLE)

Search = Callable[[MultipleShooting, Array, Array], Solution]
"""From equations, a start and parameters to a solution."""


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
    dynamics, cycle = Dynamics(system, system.values(problem.parameters)), problem.cycle
    if lacks_energy(problem):
        cause = Cause(what="energy", words=NO_ENERGY)
        return Gait(problem=problem, dynamics=dynamics, status=Status.INFEASIBLE, message=NO_ENERGY, causes=(cause,))
    began = time.perf_counter()
    state = np.array([problem.guess.state[name] for name in system.state_names])
    guess = roll_out(dynamics, cycle, state, problem.guess.durations)
    if guess.endless is None:
        solution = _solve_in_order(
            cycle, dynamics, guess, partial(solve_nearby, progress=progress, should_stop=should_stop)
        )
        if solution.converged:
            gait = _gait(problem, solution, began)
            if gait.converged:
                return gait

    def search(equations: MultipleShooting, start: Array, p: Array) -> Solution:
        return Feasibility(equations, progress=progress, should_stop=should_stop).solve(start, p)

    solution = _solve_in_order(cycle, dynamics, guess, search)
    if solution.status in FAILURES and problem.guess.durations is None:
        shortened = np.array(guess.durations) * transit_time(dynamics, cycle, state) / guess.period
        retried = _solve_in_order(cycle, dynamics, roll_out(dynamics, cycle, state, shortened), search)
        solution = retried if retried.status not in FAILURES else solution
    if solution.converged:
        return _gait(problem, solution, began)
    causes = () if solution.status is Status.INTERRUPTED else _causes(solution, guess)
    return Gait(
        problem=problem,
        dynamics=dynamics,
        status=solution.status,
        message=f"{solution.words}: {describe_causes(causes)}" if causes else solution.words,
        solver=_solver(solution, began),
        causes=causes,
    )


class Feasibility:
    """The NLP of a gait for IPOPT: equalities and margins, nothing to minimise.

    The parameters are parameters of the NLP too, so that it is built once and solved for any of their values.

    Parameters
    ----------
    equations : without free parameters.
    progress, should_stop : called at every iteration.
    relaxed : leaves the margins out, and lets phases have negative durations.
    """

    def __init__(
        self,
        equations: MultipleShooting,
        *,
        progress: Valued = None,
        should_stop: Stop = None,
        relaxed: bool = False,
    ) -> None:
        self._equations, self._relaxed = equations, relaxed
        equalities, margins = equations.equalities, equations.inequalities[0]
        self._first_duration = equations.w.numel() - equations.n_phases
        period = sum1(equations.w[self._first_duration :])
        g = vertcat(equalities, period) if relaxed else vertcat(equalities, period, margins)
        self._n_equalities = equalities.numel()
        self._upper = np.where(np.arange(g.numel()) < self._n_equalities, 0.0, np.inf)
        self._ipopt = Ipopt(w=equations.w, p=equations.parameters, g=g, progress=progress, should_stop=should_stop)

    def solve(self, start: Array, p: Array) -> Solution:
        """Solve from ``start``, shape (n_w,), at parameters ``p``, shape (n_p,)."""
        equations = self._equations
        lower = np.zeros(self._upper.size)
        lower[self._n_equalities] = SHORTEST * start[self._first_duration :].sum()
        floor = np.full(start.size, -np.inf)
        floor[self._first_duration :] = -np.inf if self._relaxed else 0.0
        units = equations.units(p)
        rows = [units.equalities, units.unknowns[-1:], *([] if self._relaxed else [equations.margin_units(p)])]
        bounds_w, bounds_g = (floor, np.full(start.size, np.inf)), (lower, self._upper)
        end = self._ipopt.solve(start, p, bounds_w, bounds_g, (units.unknowns, np.concatenate(rows)))
        return Solution(equations, end.w, p, status=end.status, words=end.words, iterations=end.iterations, start=start)


def _solve_in_order(cycle: Cycle, dynamics: Dynamics, guess: Rollout, search: Search) -> Solution:
    """Search, and search again on a new layout while a switch passes a breakpoint of the control."""
    rolled, breakpoints = guess, dynamics.system.control.breakpoints
    for _ in range(MAX_REORDERS):
        durations = np.array(rolled.durations)
        plan = layout(cycle, durations, breakpoints)
        equations = transcribe(dynamics.system, plan)
        solution = search(equations, equations.pack(rolled.nodes(plan), durations), dynamics.p)
        if not solution.converged:
            break
        durations = equations.unpack(solution.w).durations
        if plan.in_order(durations, breakpoints):
            break
        rolled = roll_out(dynamics, cycle, solution.w[: dynamics.system.n_z], durations)
    return solution


def _gait(problem: Problem, solution: Solution, began: float) -> Gait:
    """The gait at a solution: polished, refined until its integration error is small, and checked."""
    refined, solver = refine(polish(solution.equations, solution.w, solution.p)), _solver(solution, began)
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


@overflow_allowed()
def rejection_reason(refined: Solution) -> tuple[Cause, ...]:
    """Why a solution of the equations is not a gait; empty for a gait."""
    equations = refined.equations
    durations = equations.unpack(refined.w).durations
    short = np.flatnonzero(durations < VANISHING * durations.sum())
    if short.size:
        return (vanishing_phase(equations.layout.cycle, int(short[0]), float(durations[short[0]])),)
    if not np.isfinite(refined.errors).all():
        words = "the equations are singular there: the gait is not isolated, or its motion breaks down"
        return (Cause(what="equations", words=words),)
    if not refined.size <= RESIDUAL_TOLERANCE:
        return (Cause(what="equations", words=f"the equations are only met to {refined.size:.2g}"),)
    if not refined.accurate:
        intervals = equations.layout.intervals
        words = f"the integration is only right to {refined.errors.max():.2g}, even with {intervals} intervals"
        return (Cause(what="integration", words=words),)
    margins = equations.margin_values(refined.w, refined.p)
    violated = violations(equations, refined.w, refined.p, margins, RESIDUAL_TOLERANCE)
    early = None if violated else early_event(equations, refined.w, refined.p)
    return tuple(violated) if early is None else (early,)


def vanishing_phase(cycle: Cycle, phase: int, duration: float) -> Cause:
    """The cause that a phase shrinks to nothing."""
    words = f"phase {phase + 1} ({cycle.phases[phase]}) shrinks to nothing: here the gait does without it"
    return Cause(what="duration", words=words, phase=phase, needed=0.0, available=duration)


@overflow_allowed()
def _causes(failed: Solution, guess: Rollout) -> tuple[Cause, ...]:
    """The margins that a periodic motion violates, solved with or without them; otherwise the worst equality.

    A reference that ends before the step explains more than the violations of motions beyond its end.
    """
    equations, p, missing = failed.equations, failed.p, None
    if guess.endless is not None:
        missing = missing_event(equations.system, equations.layout.cycle, guess.endless)
        if missing.what == "reference":
            return (missing,)
    start = failed.w if failed.start is None else failed.start
    relaxed = Feasibility(equations, relaxed=True).solve(start, p)
    for w in (relaxed.w, failed.w):
        residual = equations.violation(w, p)
        if np.abs(residual / equations.units(p).equalities).max() <= RESIDUAL_TOLERANCE:
            violated = violations(equations, w, p, equations.margin_values(w, p), RESIDUAL_TOLERANCE)
            if violated:
                return tuple(violated)
    return (missing or largest_residual(equations, failed.w, p, residual),)
