"""A problem's gait by multiple shooting: guess, IPOPT, polish, error estimate, refinement."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from casadi import Function
from numpy.typing import NDArray

from gaitopt.gait import Cause, Gait, Status, in_words
from gaitopt.mechanics import HybridSystem
from gaitopt.nlp.assembly import assemble_gait
from gaitopt.nlp.diagnosis import early_touchdown, largest_residual, missing_event, violations
from gaitopt.nlp.feasibility import Feasibility
from gaitopt.nlp.ipopt import IpoptResult, Progress
from gaitopt.nlp.layout import layout
from gaitopt.nlp.newton import polish
from gaitopt.nlp.refinement import Refined, refine
from gaitopt.nlp.rollout import Rollout, roll_out, transit_time
from gaitopt.nlp.transcription import Transcription
from gaitopt.nlp.trial import overflow_allowed
from gaitopt.problem import NO_ENERGY, Problem, lacks_energy

Array = NDArray[np.float64]

MAX_REORDERS = 6
"""Times that switches and breakpoints may change their order; each is a new layout."""
RESIDUAL_TOLERANCE = 1e-9
"""Largest violation, in natural units, of any equality or margin in a solution that is called converged."""
VANISHING = 1e-7
"""A phase shorter than this part of the period does not take place."""
FAILURES = (Status.NOT_CONVERGED, Status.INFEASIBLE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One run of IPOPT on one layout."""

    transcription: Transcription
    p: Array
    start: Array
    result: IpoptResult


def solve_gait(
    problem: Problem,
    system: HybridSystem,
    *,
    progress: Progress | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Gait:
    """Solve ``problem`` for a periodic gait with its mode sequence.

    Parameters
    ----------
    problem : what is asked; its guess starts the search.
    system : the hybrid system of the problem's walker and control.
    progress : called at every iteration with its number and the largest violation.
    should_stop : polled at every iteration; True ends the search with the status ``interrupted``.

    Returns
    -------
    gait : its status says whether it is one; numerical failure is not an error.
    """
    p = system.values(problem.parameters)
    if lacks_energy(problem):
        no_energy = Cause(what="energy", words=NO_ENERGY)
        return Gait(
            problem=problem, system=system, p=p, status=Status.INFEASIBLE, message=NO_ENERGY, causes=(no_energy,)
        )
    began = time.perf_counter()
    state = np.array([problem.guess.state[name] for name in system.state_names])
    guess = roll_out(system, p, problem.cycle, state, problem.guess.durations)
    attempt = _attempt_in_order(problem, system, p, guess, progress, should_stop)
    if attempt.result.status in FAILURES and problem.guess.durations is None:
        shortened = np.array(guess.durations) * transit_time(system, p, problem.cycle, state) / guess.period
        second = roll_out(system, p, problem.cycle, state, shortened)
        retried = _attempt_in_order(problem, system, p, second, progress, should_stop)
        attempt = retried if retried.result.status not in FAILURES else attempt
    solver = {"iterations": float(attempt.result.iterations), "seconds": time.perf_counter() - began}
    if attempt.result.status is not Status.CONVERGED:
        status, message = attempt.result.status, attempt.result.words
        causes = () if status is Status.INTERRUPTED else _causes(attempt, guess)
        message = f"{message}: {in_words(causes)}" if causes else message
        return Gait(problem=problem, system=system, p=p, status=status, message=message, solver=solver, causes=causes)
    return _finish(problem, attempt, solver)


def _attempt_in_order(
    problem: Problem,
    system: HybridSystem,
    p: Array,
    guess: Rollout,
    progress: Progress | None,
    should_stop: Callable[[], bool] | None,
) -> Attempt:
    """Solve, and again with a new layout while a switch passes a breakpoint of the control."""
    rolled = guess
    for _ in range(MAX_REORDERS):
        durations = np.array(rolled.durations)
        plan = layout(problem.cycle, durations, system.control.breakpoints)
        transcription = Transcription(system, plan)
        start = transcription.pack(rolled.nodes(plan), durations)
        attempt = _attempt(transcription, p, start, progress, should_stop)
        durations = transcription.unpack(attempt.result.w)[1]
        if attempt.result.status is not Status.CONVERGED or plan.in_order(durations, system.control.breakpoints):
            break
        rolled = roll_out(system, p, problem.cycle, attempt.result.w[: system.n_z], durations)
    return attempt


def _attempt(
    transcription: Transcription,
    p: Array,
    start: Array,
    progress: Progress | None,
    should_stop: Callable[[], bool] | None,
    *,
    relaxed: bool = False,
) -> Attempt:
    """Run IPOPT; ``relaxed`` leaves the margins out."""
    program = Feasibility(transcription, progress=progress, should_stop=should_stop, relaxed=relaxed)
    result = program.solve(start, p)
    return Attempt(transcription=transcription, p=p, start=start, result=result)


def _finish(problem: Problem, attempt: Attempt, solver: dict[str, float]) -> Gait:
    """Polish, refine until the integration error is small, and assemble the gait."""
    p, system = attempt.p, attempt.transcription.system
    refined = refine(attempt.transcription, polish(attempt.transcription, attempt.result.w, p).at)
    wrong = rejection_reason(refined)
    if wrong:
        return Gait(
            problem=problem,
            system=system,
            p=p,
            status=Status.NOT_CONVERGED,
            message=in_words(wrong),
            solver=solver,
            causes=wrong,
        )
    return assemble_gait(
        problem,
        refined.transcription,
        refined.at,
        errors=refined.errors,
        message=attempt.result.words,
        solver=solver,
    )


@overflow_allowed()
def rejection_reason(refined: Refined) -> tuple[Cause, ...]:
    """What keeps a solution of IPOPT from being a gait, looked at without IPOPT; empty for a gait."""
    transcription, at = refined.transcription, refined.at
    _, durations, _ = transcription.unpack(at.w)
    modes = transcription.layout.cycle.phases
    for phase, (mode, duration) in enumerate(zip(modes, durations, strict=True), start=1):
        if duration < VANISHING * durations.sum():
            words = f"phase {phase} ({mode}) shrinks to nothing: here the gait does without it"
            return (Cause(what="duration", words=words, phase=phase - 1, needed=0.0, available=float(duration)),)
    if not np.isfinite(refined.errors).all():
        words = "the equations are singular there: the gait is not isolated, or its motion breaks down"
        return (Cause(what="equations", words=words),)
    if not at.size <= RESIDUAL_TOLERANCE:
        return (Cause(what="equations", words=f"the equations are only met to {at.size:.2g}"),)
    if not refined.accurate:
        intervals = transcription.layout.intervals
        words = f"the integration is only right to {refined.errors.max():.2g}, even with {intervals} intervals"
        return (Cause(what="integration", words=words),)
    found = violations(transcription, at.w, at.p, _margins(transcription, at.w, at.p), RESIDUAL_TOLERANCE)
    landing = None if found else early_touchdown(transcription, at.w, at.p)
    return tuple(found) if landing is None else (landing,)


def _margins(transcription: Transcription, w: Array, p: Array) -> Array:
    expression, _ = transcription.inequalities
    function = Function("margins", [transcription.w, transcription.parameters], [expression])
    return np.asarray(function(w, p)).ravel()


@overflow_allowed()
def _causes(attempt: Attempt, guess: Rollout) -> tuple[Cause, ...]:
    """What hurts most: margins that a periodic motion violates, be it found with or without them, or what is open."""
    transcription, p = attempt.transcription, attempt.p
    relaxed = _attempt(transcription, p, attempt.start, None, None, relaxed=True)
    for w in (relaxed.result.w, attempt.result.w):
        residual = np.asarray(transcription.violation(w, p)).ravel()
        if np.abs(residual / transcription.units(p).equalities).max() <= RESIDUAL_TOLERANCE:
            found = violations(transcription, w, p, _margins(transcription, w, p), RESIDUAL_TOLERANCE)
            if found:
                return tuple(found)
    if guess.endless is not None:
        return (missing_event(transcription.layout.cycle, guess.endless),)
    return (largest_residual(transcription, attempt.result.w, p, residual),)
