"""The gait of a problem by multiple shooting, without unknown parameters: from the guess to a ``Gait``.

guess           the motion from the guessed state along the mode sequence           ``roll_out``
equations       F(w, p) = 0 on a mesh for that motion                               ``Rollout.on_mesh``
Newton          from there, while its steps halve                                   ``solve_nearby``
IPOPT           F = 0 and margins >= 0, if Newton's method finds no gait            ``feasibility``
refinement      down to rounding, on a mesh that is fine enough                     ``polish``, ``refine``
check           every margin at the nodes, and no event between them                ``rejection_reason``
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from gaitopt.arrays import overflow_allowed
from gaitopt.callbacks import Stop, Valued
from gaitopt.gait.gait import Cause, Gait, Status, describe_causes
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.section import TOUCHDOWN
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import kind
from gaitopt.problem.problem import Problem
from gaitopt.problem.rules import NO_ENERGY, lacks_energy
from gaitopt.requests import DEFAULT_LIMITS, MOST_INTERVALS, Method, SearchLimits
from gaitopt.solver.assembly import search_record
from gaitopt.solver.diagnosis import AIRBORNE, RESIDUAL_TOLERANCE, SAMPLES, largest_residual, missing_event, violations
from gaitopt.solver.newton import Solution, solve_nearby
from gaitopt.solver.program import checked_gait, feasibility, solved
from gaitopt.solver.rollout import (
    FINE_ERROR,
    STABLE_STEP,
    Rollout,
    guessed_motion,
    roll_out,
    rolled_again,
    transit_time,
)

MAX_REORDERS = 6
"""Largest number of new meshes in one search. Each change of the order of switches and breakpoints needs one."""
LARGEST_RETURN_ERROR = 1e-6
"""A guess whose state changes by no more than this over a cycle, in natural units, is as good as a gait."""
FAILURES = (Status.NOT_CONVERGED, Status.INFEASIBLE)
OTHER_METHODS = "the methods auto and ipopt search farther"
"""What to try if Newton's method alone finds nothing."""


def free_parameters(problem: Problem, system: HybridSystem) -> dict[str, tuple[float, float]]:
    """Bounds of all unknown parameters by dotted key: those that the file frees, and those of the control law."""
    bounds = {key: (free.lower, free.upper) for key, free in problem.free.items()}
    return bounds | {f"control.{name}": limits for name, limits in system.control.unknowns(system.walker).items()}


def solve_gait(
    problem: Problem,
    system: HybridSystem,
    *,
    method: Method = Method.AUTO,
    limits: SearchLimits = DEFAULT_LIMITS,
    progress: Valued = None,
    should_stop: Stop = None,
) -> Gait:
    """Solve ``problem`` for a periodic gait with its mode sequence.

    Parameters
    ----------
    problem : its guess starts the search.
    system : the hybrid system of the problem's walker and control.
    method : ``auto`` runs IPOPT only if Newton's method finds no gait.
    limits : limits of the search; the gait records those that are not the defaults.
    progress : called at every iteration with its number and the largest violation.
    should_stop : polled at every iteration; True ends the search with the status ``interrupted``.

    Returns
    -------
    gait : a numerical failure is a status of the gait, not an error.
    """
    if limits.stated:
        gait = _solve(problem, system, method, limits, progress, should_stop)
        return replace(gait, solver={**gait.solver, **limits.stated})
    return _solve(problem, system, method, limits, progress, should_stop)


def _solve(
    problem: Problem,
    system: HybridSystem,
    method: Method,
    limits: SearchLimits,
    progress: Valued,
    should_stop: Stop,
) -> Gait:
    dynamics, cycle, began = Dynamics.of(system, problem.parameters), problem.cycle, time.perf_counter()
    if lacks_energy(problem):
        cause = Cause(what="energy", description=NO_ENERGY)
        return Gait(problem=problem, dynamics=dynamics, status=Status.INFEASIBLE, message=NO_ENERGY, causes=(cause,))

    if problem.guess.first is not None and method is not Method.NEWTON:
        return _first_gait(problem, dynamics, began, progress, should_stop)
    guess = guessed_motion(problem, dynamics)
    if method is not Method.IPOPT:
        gait = _newton_gait(problem, guess, began, limits, progress, should_stop)
        if gait.converged or gait.status is Status.INTERRUPTED or method is Method.NEWTON:
            return gait

    def ipopt(start: Solution) -> Solution:
        count = limits.ipopt_iterations
        end = solved(feasibility(problem, start), iterations=count, progress=progress, should_stop=should_stop)
        if end.status not in FAILURES or not start.equations.mesh.cycle.timed:
            return end
        # the torques of the guess may jump where those of the gait do not: a motion without margins shows it
        periodic = solved(feasibility(problem, start, relaxed=True), iterations=count, should_stop=should_stop)
        leaves = periodic.converged and not periodic.in_order
        return periodic if leaves or periodic.status is Status.INTERRUPTED else end

    tried = "IPOPT" if method is Method.IPOPT else "Newton's method and IPOPT"
    begin = guess.on_mesh(per_step=limits.intervals)
    stiff = _too_stiff(begin)
    if stiff is not None:
        solver = search_record(method if method is Method.IPOPT else Method.NEWTON, 0, began)
        return Gait(
            problem=problem, dynamics=dynamics, status=Status.NOT_CONVERGED, message=stiff.description, solver=solver,
            causes=(stiff,),
        )  # fmt: skip
    start, solution = _search(begin, ipopt)
    if solution.status in FAILURES and problem.guess.durations is None:  # the events of the guess may come too late
        state = guess.motions[0].states[0]
        shortened = np.array(guess.durations) * transit_time(dynamics, cycle, state) / guess.period
        tried += ", also from a shorter step"
        again = roll_out(dynamics, cycle, state, shortened).on_mesh(per_step=limits.intervals)
        if _too_stiff(again) is None:
            start_again, retried = _search(again, ipopt)
            if retried.status not in FAILURES:
                start, solution = start_again, retried
    if solution.converged:
        return checked_gait(problem, solution, search_record(Method.IPOPT, solution.iterations, began))
    causes = () if solution.status is Status.INTERRUPTED else _failure_causes(problem, start, solution, guess)
    message = f"{solution.message} (tried {tried}): {describe_causes(causes)}" if causes else solution.message
    return Gait(
        problem=problem,
        dynamics=dynamics,
        status=solution.status,
        message=message,
        solver=search_record(Method.IPOPT, solution.iterations, began),
        causes=causes,
    )


def _newton_gait(
    problem: Problem, guess: Rollout, began: float, limits: SearchLimits, progress: Valued, should_stop: Stop
) -> Gait:
    """The gait that Newton's method finds next to a guess, or the first failed attempt."""

    def failed(status: Status, message: str, iterations: int = 0, causes: tuple[Cause, ...] = ()) -> Gait:
        solver, dynamics = search_record(Method.NEWTON, iterations, began), guess.dynamics
        return Gait(problem=problem, dynamics=dynamics, status=status, message=message, solver=solver, causes=causes)

    failure: Gait | None = None
    newton = partial(solve_nearby, most_steps=limits.newton_steps, progress=progress, should_stop=should_stop)
    for start in _nearby_starts(problem, guess, limits.intervals):
        _, near = _search(start, newton)
        if near.status is Status.INTERRUPTED:
            return failed(near.status, near.message, near.iterations)
        gait = failed(near.status, f"{near.message}; {OTHER_METHODS}", near.iterations)
        if near.converged:
            gait = checked_gait(problem, near, search_record(Method.NEWTON, near.iterations, began))
            if gait.converged:
                return gait
        failure = failure or gait
    if failure is None:
        assert guess.endless is not None
        cause = _missing_event(guess, guess.endless)
        failure = failed(Status.NOT_CONVERGED, f"{cause.description}; {OTHER_METHODS}", causes=(cause,))
    return failure


def _first_gait(problem: Problem, dynamics: Dynamics, began: float, progress: Valued, should_stop: Stop) -> Gait:
    """The gait of a problem whose guess is not a known motion, by collocation."""
    from gaitopt.solver.first_gait import first_gait  # imports scipy.sparse; most guesses are known motions

    found, end, worst = first_gait(problem, dynamics, progress=progress, should_stop=should_stop)
    solver = search_record(Method.IPOPT, end.iterations, began)
    if found is not None:
        return checked_gait(problem, found, solver)
    message, causes = "; ".join((end.message, *(cause.description for cause in worst))), tuple(worst)
    return Gait(problem=problem, dynamics=dynamics, status=end.status, message=message, solver=solver, causes=causes)


def _nearby_starts(problem: Problem, guess: Rollout, intervals: int) -> Iterator[Solution]:
    """The starts of Newton's method: the guess and, if it is periodic, the walk from its state on a finer mesh.

    The phases of the walk end at their events, whatever durations the problem states.
    """
    if guess.endless is None:
        yield guess.on_mesh(per_step=intervals)
    walk = guess
    if problem.guess.durations is not None:
        walk = roll_out(guess.dynamics, problem.cycle, guess.motions[0].states[0])
    if walk.endless is None:
        start = walk.on_mesh(error=FINE_ERROR, per_step=intervals)
        resets = (start.residual / start.units.equalities)[-start.equations.system.n_z * len(walk.cycle.resets) :]
        if np.abs(resets).max() < LARGEST_RETURN_ERROR:
            yield start


def _search(start: Solution, method: Callable[[Solution], Solution]) -> tuple[Solution, Solution]:
    """Start and end of a search, which is repeated on a new mesh while a switch passes a breakpoint of the control."""
    for _ in range(MAX_REORDERS):
        end = method(start)
        if not end.converged or end.in_order:
            break
        start = rolled_again(end).on_mesh()
    return start, end


def _too_stiff(start: Solution) -> Cause | None:
    """Why a search would take too long, for instance a gain in wrong units that needs too many intervals; else None."""
    mesh = start.equations.mesh
    modes, (_, lengths) = start.equations.fastest_modes(start.w, start.p), mesh.interval_times(start.durations)
    known = np.isfinite(modes)  # the motion has broken down where they are not
    counts = np.maximum(modes[known] * lengths[known] / STABLE_STEP, 1.0)
    needed = max(float(mesh.intervals), float(counts.sum()))
    if not needed > MOST_INTERVALS:
        return None
    fastest = modes[known].max(initial=0.0)
    text = (
        f"the motion is too stiff for a search: its fastest mode, {fastest:.4g} 1/s, needs about {needed:.0f} "
        f"intervals, and {MOST_INTERVALS} are searched at most; check the units of the gains, or guess the state "
        "of the gait to five digits"
    )
    return Cause(what="integration", description=text, needed=float(MOST_INTERVALS), available=needed)


def _missing_event(guess: Rollout, phase: int) -> Cause:
    """Why a phase of a guess has no end, as its margins one integration step after its start show."""
    system, motion = guess.dynamics.system, guess.motions[phase]
    k = min(1, motion.times.size - 1)
    at = system.margins(guess.cycle.phases[phase])(motion.times[k], motion.states[k], motion.p, motion.data[k])
    return missing_event(system, guess.cycle, phase, np.asarray(at).ravel())


@overflow_allowed()
def _failure_causes(problem: Problem, start: Solution, failed: Solution, guess: Rollout) -> tuple[Cause, ...]:
    """Why a search found no gait: the margins that a periodic motion violates, or the worst equality if there is none.

    The periodic motion is sought with and without the margins. If the reference ends before the step, that is the
    cause, and not a violation beyond its end. If an event of the guess did not happen, that is the cause, and not a
    negative duration.

    Parameters
    ----------
    start, failed : start and end of IPOPT.
    guess : the motion from which the search began.
    """
    missing = None
    if guess.endless is not None:
        missing = _missing_event(guess, guess.endless)
        if missing.what == "reference":
            return (missing,)
    begin = Solution(failed.equations, start.w, failed.p)
    relaxed = feasibility(problem, begin, relaxed=True)
    for at in (solved(relaxed), failed):
        if at.size <= RESIDUAL_TOLERANCE:
            violated = violations(at)
            if missing is not None and any(cause.what == "duration" for cause in violated):
                break
            if violated:
                return tuple(violated)
    return (missing or _foot_below_ground(guess) or largest_residual(failed),)


def _foot_below_ground(guess: Rollout) -> Cause | None:
    """A landing of the guess before which the swing foot, or a contact, is below the ground; None if none is."""
    system, cycle, time = guess.dynamics.system, guess.cycle, 0.0
    for phase, (mode, duration) in enumerate(zip(cycle.phases, guess.durations, strict=True)):
        time = duration if phase in cycle.first_phases else time + duration
        motion, ending = guess.motions[phase], system.transitions.ending(cycle, phase).guard
        if kind(ending) != TOUCHDOWN or motion.end < time * (1 - AIRBORNE):
            continue
        row = system.transitions.margin_names(mode).index(ending)
        times = np.linspace(time - duration, time, SAMPLES)
        heights = [
            float(system.margins(mode)(t, z, motion.p, motion.data[-1])[row])
            for t, z in zip(times, motion(times).T, strict=True)
        ]
        if max(heights) > 0 > heights[-1] + AIRBORNE * guess.dynamics.margin_units(mode)[row]:
            passed = times[max(k for k, height in enumerate(heights) if height > 0)]
            reset = system.transitions.ending(cycle, phase).reset
            assert reset is not None
            foot = system.walker.called(reset.of)
            reason = (
                f"{cycle.phase_words(phase)}: at the landing of the guess, {time:.4g} s after the impact, {foot} is "
                f"below the ground, which it reaches about {passed:.4g} s after the impact; guess a shorter step"
            )
            return Cause(what=ending, description=reason, phase=phase, step=cycle.step_of(phase), time=float(passed))
    return None
